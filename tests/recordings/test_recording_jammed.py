"""What a state demands of its jammed spine, and how the force sensor's zero moved: the same live, in the file and in replay."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import state

from recordings.campaign.replay import compare, replay, replay_states, table_of
from recordings.errors import BadMessage, BadTable, NoResistance, VacuumLost
from recordings.events import Mark
from recordings.file.reader import Recording
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from recordings.states.concluding import conclude
from recordings.states.demands import VacuumBand
from recordings.states.rules import AMBIENT, Probe, State, Window
from recordings.states.zeros import Drift, Unloaded, Zeros, drift, unloaded, without_drift
from recordings.table_file import read_csv, write_csv
from recordings.trials import Table, TrialRow

BAND = VacuumBand(1.0, 69e3, 91e3)
STATE = state(
    protocol="stiffness", specimen="spine", rule=Window(0.0, 1.0, 2), t_start=3.0, ramp_end=3.0, targets=(0.0,) * 9,
    topics=("/force", "/arm", "/vacuum"), probe=Probe((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), vacuum=BAND, least_force=1.0,
)  # fmt: skip
POLL = 0.1


def pushing(path: Path, vacuum: Callable[[float], float], force: float = 2.0, asked: State = STATE) -> Recorder:
    """A recording of 6 s with one state: `vacuum` Pa below ambient by time, `force` N."""
    recorder = Recorder(path, start_wall_ns=10**18)
    recorder.state(0.0, asked)
    for k in range(1, 61):
        t = round(POLL * k, 9)
        recorder.push("/force", t, ((-force, *(0.0,) * 5), (0.0,) * 6))
        recorder.push("/arm", t, (t, (0.0,) * 6, (0.001, *(0.0,) * 5), (0.0,) * 6, 1, True))
        recorder.push("/vacuum", t, (AMBIENT - vacuum(t),))
    recorder.sync()
    return recorder


def between(begin: float, end: float, level: float) -> Callable[[float], float]:
    """80 kPa, but `level` (Pa) from `begin` to `end` (s)."""
    return lambda t: level if begin < t < end else 80e3


LOST = {
    "at once after it was jammed": between(1.05, 1.25, 10e3), "just before the window": between(2.8, 2.95, 10e3),
    "within the window": between(3.4, 3.6, 10e3), "at its very end": between(4.05, 9.0, 10e3),
    "in part": between(3.4, 3.6, 60e3), "too deep": between(3.4, 3.6, 94e3), "no number": between(3.4, 3.6, math.nan),
    "slowly": lambda t: 80e3 - 3e3 * t,
}  # fmt: skip
KEPT = {
    "before it was jammed": between(0.0, 0.95, 0.0), "after the window": between(4.15, 9.0, 0.0),
    "within its band": between(3.4, 3.6, 70e3),
}  # fmt: skip


@pytest.mark.parametrize("kind", LOST)
def test_a_state_whose_spine_lost_its_vacuum_is_not_concluded(tmp_path: Path, kind: str) -> None:
    with pushing(tmp_path / "a.mcap", LOST[kind]) as recorder, pytest.raises(VacuumLost, match=r"69\.0 to 91\.0 kPa"):
        conclude(recorder.buffers, STATE)
    (again,) = replay_states(Recording.open(tmp_path / "a.mcap"))
    assert again.row is None and "kPa below ambient" in again.reason


@pytest.mark.parametrize("kind", KEPT)
def test_one_whose_vacuum_stayed_is(tmp_path: Path, kind: str) -> None:
    with pushing(tmp_path / "a.mcap", KEPT[kind]) as recorder:
        row = conclude(recorder.buffers, STATE)
        assert row is not None and row.force == pytest.approx(2.0)
        recorder.trial(6.0, 1, row)
    assert compare(Recording.open(tmp_path / "a.mcap")).equal


def test_it_is_known_as_soon_as_the_vacuum_is_lost(tmp_path: Path) -> None:
    later = replace(STATE, rule=Window(100.0, 1.0, 2))
    with pushing(tmp_path / "a.mcap", LOST["within the window"], asked=later) as recorder, pytest.raises(VacuumLost):
        conclude(recorder.buffers, later)


def test_without_a_band_no_vacuum_is_judged(tmp_path: Path) -> None:
    plain = replace(STATE, vacuum=None)
    with pushing(tmp_path / "a.mcap", between(0.0, 9.0, 0.0), asked=plain) as recorder:
        assert conclude(recorder.buffers, plain) is not None


def test_a_specimen_that_hardly_pushes_back_is_not_concluded(tmp_path: Path) -> None:
    with pushing(tmp_path / "a.mcap", KEPT["within its band"], force=0.5) as recorder:
        with pytest.raises(NoResistance, match=r"0\.50 N"):
            conclude(recorder.buffers, STATE)
        assert conclude(recorder.buffers, replace(STATE, least_force=None)) is not None


def test_the_file_holds_what_is_demanded_and_older_readers_are_not_disturbed(tmp_path: Path) -> None:
    with pushing(tmp_path / "a.mcap", KEPT["within its band"]):
        pass
    (event,) = Recording.open(tmp_path / "a.mcap").states
    assert event.state == STATE
    assert STATE.to_json() == replace(STATE, vacuum=None, least_force=None).to_json()
    assert not {"vacuum", "least_force", "clipped"} & set(json.loads(STATE.to_json()))


def test_a_vacuum_needs_a_gauge_and_a_least_force_a_probe() -> None:
    with pytest.raises(BadMessage, match="needs /vacuum"):
        replace(STATE, topics=("/force", "/arm"))
    with pytest.raises(BadMessage, match="needs a probe"):
        replace(STATE, probe=None)


ERROR = 0.01


def moved(zero: Callable[[float], float]) -> Drift:
    """How a zero moved that is read at 0, 15 and 40 s."""
    before, start, end = (Unloaded(t, zero(t), ERROR) for t in (0.0, 15.0, 40.0))
    return drift(before, start, end)


def test_only_a_constant_drift_is_linear() -> None:
    assert moved(lambda t: 5.0).linear and moved(lambda t: 5.0 + 0.08 * t).linear and moved(lambda t: -0.08 * t).linear
    assert moved(lambda t: 0.08 * t).force == pytest.approx(2.0)
    assert not moved(lambda t: float(t > 20.0)).linear
    assert not moved(lambda t: 0.08 * max(0.0, t - 15.0)).linear
    assert not moved(lambda t: 0.08 * min(t, 20.0)).linear
    assert not moved(lambda t: 2.0 * (1 - math.exp(-t / 20.0))).linear


def test_noise_alone_is_never_marked() -> None:
    random = np.random.default_rng(1)
    for _ in range(1000):
        assert moved(lambda t: 0.08 * t + ERROR * random.normal()).linear


ROW = TrialRow(
    trial=1, step=1, protocol="stiffness", repeat=1, branch="load", t=30.0, spine_length=0.1, pressures=(0.0,) * 9,
    specimen="spine", force=2.0, deflection=0.001,
)  # fmt: skip
ZEROS = Zeros(1, (1.0, 0.0, 0.0), (0.0, 1.0), (15.0, 16.0), (40.0, 41.0), 20.0)


def test_a_line_is_removed_and_anything_else_marks_the_rows_of_that_time_only() -> None:
    others = [replace(ROW, trial=2), replace(ROW, t=10.0), replace(ROW, t=50.0)]
    (free, *same) = without_drift([ROW, *others], [(ZEROS, Drift(2.0, 0.08, True))])
    assert free.force == pytest.approx(2.0 - 0.08 * 10.0) and free.force_drift == 2.0 and free.doubt is None
    (marked, *_) = without_drift([ROW], [(ZEROS, Drift(2.0, 0.08, False))])
    assert (marked.force, marked.force_drift, marked.doubt) == (2.0, 2.0, "drift") and same == others


def test_zeros_and_marks_are_in_the_file_and_in_its_table(tmp_path: Path) -> None:
    plain = replace(STATE, vacuum=None, least_force=None)
    zeros = Zeros(1, (1.0, 0.0, 0.0), (0.05, 0.45), (0.5, 1.0), (5.0, 5.9), 1.5)
    with pushing(tmp_path / "a.mcap", KEPT["within its band"], asked=plain) as recorder:
        row = conclude(recorder.buffers, plain)
        assert row is not None
        recorder.trial(6.0, 1, row)
        read = [unloaded(recorder.buffers, zeros.direction, span) for span in (zeros.before, zeros.start, zeros.end)]
        before, start, end = (r for r in read if r is not None)
        recorder.zero(6.0, zeros, drift(before, start, end))
        recorder.mark(Mark(6.0, 1, "soft", "it was"))
    recording = Recording.open(tmp_path / "a.mcap")
    assert [event.zeros for event in recording.zeros] == [zeros] and [m.text for m in recording.marks] == ["it was"]
    assert compare(recording).equal and verify(tmp_path / "a.mcap").ok
    (live,), (again,) = table_of(recording), replay(tmp_path / "a.mcap")
    assert live.cells() == again.cells() and live.doubt == "soft" and live.force_drift == pytest.approx(0.0)
    assert live.to_json() == row.to_json()  # what older readers take apart


def test_a_drift_that_replay_gives_otherwise_is_a_difference(tmp_path: Path) -> None:
    zeros = Zeros(1, (1.0, 0.0, 0.0), (0.05, 0.45), (0.5, 1.0), (5.0, 5.9), 1.5)
    with pushing(tmp_path / "a.mcap", KEPT["within its band"]) as recorder:
        recorder.zero(6.0, zeros, Drift(1.0, 0.1, True))
        recorder.zero(6.0, replace(zeros, end=(7.0, 8.0)), Drift(1.0, 0.1, True))
    comparison = compare(Recording.open(tmp_path / "a.mcap"))
    assert len(comparison.differences) == 2 and "drift of the zero" in comparison.differences[0]


def test_the_table_has_both_columns_only_where_they_say_something(tmp_path: Path) -> None:
    assert not {"doubt", "force_drift"} & set(Table((ROW,)).columns)
    rows = (replace(ROW, force_drift=-0.25, doubt="drift"), replace(ROW, step=2))
    write_csv(Table(rows), tmp_path / "trials.csv")
    again = read_csv(tmp_path / "trials.csv")
    assert [row.cells() for row in again] == [row.cells() for row in rows] and again.doubtful == (again.rows[0],)
    text = (tmp_path / "trials.csv").read_text()
    (tmp_path / "trials.csv").write_text(text.replace("drift\n", "odd\n"))
    with pytest.raises(BadTable, match="doubt: 'odd' is not one of soft, bodies, drift"):
        read_csv(tmp_path / "trials.csv")
