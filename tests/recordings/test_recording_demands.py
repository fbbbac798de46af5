"""What a state demands, and what is marked: clipped set-points, its jammed spine, the force sensor's zero, bodies by name;
the same live, in the file and in replay."""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import Message, state

from recordings.ambient import AMBIENT
from recordings.campaign.replay import compare, replay, replay_states, table_of
from recordings.errors import BadMessage, BadTable, Misplaced, NoResistance, NotSettled, VacuumLost
from recordings.events import Mark
from recordings.file.reader import Recording
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from recordings.states.concluding import conclude
from recordings.states.demands import Bodies, VacuumBand, elsewhere, jumped
from recordings.states.rules import Probe, State, Window
from recordings.states.zeros import Drift, Unloaded, Zeros, drift, unloaded, without_drift
from recordings.table_file import read_csv, write_csv
from recordings.trials import Table, TrialRow
from tests.simulated.bench import raises

BAND = VacuumBand(1.0, 69e3, 91e3)
JAMMED = state(
    protocol="stiffness", specimen="spine", rule=Window(0.0, 1.0, 2), t_start=3.0, ramp_end=3.0, targets=(0.0,) * 9,
    topics=("/force", "/arm", "/vacuum"), probe=Probe((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), vacuum=BAND, least_force=1.0,
)  # fmt: skip
POLL = 0.1
Made = Callable[[Path, State], Recorder]


def recorded(messages: Iterable[Message], markers: int = 0) -> Made:
    """A recording with one state and these messages."""
    sent = list(messages)

    def made(path: Path, asked: State) -> Recorder:
        recorder = Recorder(path, start_wall_ns=10**18, markers=markers)
        recorder.state(0.0, asked)
        for topic, t, values in sent:
            recorder.push(topic, t, values)
        recorder.sync()
        return recorder

    return made


def pushing(vacuum: Callable[[float], float], force: float = 2.0) -> Made:
    """A recording of 6 s with one state: `vacuum` Pa below ambient by time, `force` N."""
    sent = list[Message]()
    for t in (round(POLL * k, 9) for k in range(1, 61)):
        sent.append(("/force", t, ((-force, *(0.0,) * 5), (0.0,) * 6)))
        sent.append(("/arm", t, (t, (0.0,) * 6, (0.001, *(0.0,) * 5), (0.0,) * 6, 1, True)))
        sent.append(("/vacuum", t, (AMBIENT - vacuum(t),)))
    return recorded(sent)


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
    trial=1, step=1, protocol="bending", repeat=1, branch="load", t=0.5, spine_length=0.1, pressures=(50e3,) * 9,
    tip=(0.0, 0.0, 0.4), clipped=True,
)  # fmt: skip
PUSHED = TrialRow(
    trial=1, step=1, protocol="stiffness", repeat=1, branch="load", t=30.0, spine_length=0.1, pressures=(0.0,) * 9,
    specimen="spine", force=2.0, deflection=0.001,
)  # fmt: skip
ZEROS = Zeros(1, (1.0, 0.0, 0.0), (0.0, 1.0), (15.0, 16.0), (40.0, 41.0), 20.0)


def test_a_line_is_removed_and_anything_else_marks_the_rows_of_that_time_only() -> None:
    others = [replace(PUSHED, trial=2), replace(PUSHED, t=10.0), replace(PUSHED, t=50.0)]
    (free, *same) = without_drift([PUSHED, *others], [(ZEROS, Drift(2.0, 0.08, True))])
    assert free.force == pytest.approx(2.0 - 0.08 * 10.0) and free.force_drift == 2.0 and free.doubt is None
    (marked, *_) = without_drift([PUSHED], [(ZEROS, Drift(2.0, 0.08, False))])
    assert (marked.force, marked.force_drift, marked.doubt) == (2.0, 2.0, "drift") and same == others


def test_zeros_and_marks_are_in_the_file_and_in_its_table(tmp_path: Path) -> None:
    plain = replace(JAMMED, vacuum=None, least_force=None)
    zeros = Zeros(1, (1.0, 0.0, 0.0), (0.05, 0.45), (0.5, 1.0), (5.0, 5.9), 1.5)
    with pushing(KEPT["within its band"])(tmp_path / "a.mcap", plain) as recorder:
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
    with pushing(KEPT["within its band"])(tmp_path / "a.mcap", JAMMED) as recorder:
        recorder.zero(6.0, zeros, Drift(1.0, 0.1, True))
        recorder.zero(6.0, replace(zeros, end=(7.0, 8.0)), Drift(1.0, 0.1, True))
    comparison = compare(Recording.open(tmp_path / "a.mcap"))
    assert len(comparison.differences) == 2 and "drift of the zero" in comparison.differences[0]


ARCS = (0.4, 0.1, 0.2, 0.3)
"""The tip and three markers."""
ASKED = state(rule=Window(0.0, 1.0, 2), t_start=3.0, ramp_end=3.0, topics=("/tip",), bodies=Bodies(1.0, ARCS, 1.2))
PERIOD = 0.01
Places = Callable[[float], list[tuple[float, float, float]]]


def straight(t: float) -> list[tuple[float, float, float]]:
    """The robot hangs still: the tip, then the markers."""
    return [(0.0, 0.0, arc) for arc in ARCS]


def swapped(first: int, second: int, begin: float, end: float = math.inf) -> Places:
    """Two bodies exchanged from `begin` to `end` (s)."""

    def places(t: float) -> list[tuple[float, float, float]]:
        at = straight(t)
        if begin < t < end:
            at[first], at[second] = at[second], at[first]
        return at

    return places


def shifted(body: int, by: float, begin: float, within: float = 0.0) -> Places:
    """One body moved aside by `by` (m) from `begin` (s) on, evenly `within` (s)."""

    def places(t: float) -> list[tuple[float, float, float]]:
        at = straight(t)
        share = 0.0 if t <= begin else min(1.0, (t - begin) / within) if within else 1.0
        at[body] = (share * by, 0.0, at[body][2])
        return at

    return places


def following(places: Places) -> Made:
    """A recording of 5 s at 100 Hz with one state."""
    sent = list[Message]()
    for k in range(1, 501):
        t = round(PERIOD * k, 9)
        tip, *markers = places(t)
        sent.append(("/tip", t, (t, k, tip, (1.0, 0.0, 0.0, 0.0), 1e-4, True, tuple(markers))))
    return recorded(sent, markers=len(ARCS) - 1)


def bent(t: float) -> list[tuple[float, float, float]]:
    """The robot bends from 2.0 s on, within 0.2 s."""
    return [(0.6 * min(1.0, max(0.0, (t - 2.0) / 0.2)) * arc, 0.0, arc) for arc in ARCS]


IMPOSSIBLE = {
    "tip and first marker": (swapped(0, 1, 1.5), r"marker 1 are \d+ mm apart, the stretched robot allows 125 mm"),
    "two markers": (swapped(1, 3, 1.5), r"marker \d"),
    "a strange body at the tip": (shifted(0, 0.6, 1.5, 0.5), r"the tip and marker 3 are 608 mm apart"),
    "a jump within reach": (shifted(2, 0.05, 2.0), r"marker 2 jumped by 50 mm within 10 ms at 2\.01 s and is still 50 mm away"),
}
POSSIBLE = {
    "at rest": straight,
    "a swap before the last state": swapped(0, 1, 0.2, 0.8),
    "a swap that came back": swapped(0, 1, 2.0, 2.4),
    "bent quickly": bent,
    "a marker hidden meanwhile": lambda t: [(math.nan,) * 3 if k == 2 and 1.9 < t < 2.3 else p for k, p in enumerate(bent(t))],
    "markers not seen": lambda t: [straight(t)[0], *[(math.nan,) * 3] * 3],
}


CLIPPED = state(rule=Window(0.0, 0.5, 3), targets=(50e3,) * 9, topics=("/pressure",), clipped=True)


INFLATED = recorded(("/pressure", 0.1 * k, ((50e3,) * 9, (49e3 + k,) * 9)) for k in range(1, 12))
"""A recording of 1 s with one state of a robot whose pressures hardly rise."""
REFUSED: dict[str, tuple[Made, State, type[NotSettled], str]] = {
    **{f"vacuum lost {kind}": (pushing(vacuum), JAMMED, VacuumLost, r"69\.0 to 91\.0 kPa") for kind, vacuum in LOST.items()},
    "vacuum lost long before the window": (
        pushing(LOST["within the window"]), replace(JAMMED, rule=Window(100.0, 1.0, 2)), VacuumLost, "kPa below ambient"),
    "hardly a push": (pushing(KEPT["within its band"], force=0.5), JAMMED, NoResistance, r"0\.50 N"),
    **{kind: (following(places), ASKED, Misplaced, says) for kind, (places, says) in IMPOSSIBLE.items()},
}  # fmt: skip
CONCLUDED: dict[str, tuple[Made, State]] = {
    **{f"vacuum lost {kind}": (pushing(vacuum), JAMMED) for kind, vacuum in KEPT.items()},
    "no vacuum demanded": (pushing(between(0.0, 9.0, 0.0)), replace(JAMMED, vacuum=None)),
    "no force demanded": (pushing(KEPT["within its band"], force=0.5), replace(JAMMED, least_force=None)),
    **{kind: (following(places), ASKED) for kind, places in POSSIBLE.items()},
    "a marker on a stalk": (following(shifted(2, 0.08, 0.0)), replace(ASKED, bodies=Bodies(1.0, ARCS, 1.2, (0.0, 0.0, 0.08)))),
    "without the robot's limits": (following(swapped(0, 1, 1.5)), replace(ASKED, bodies=None)),
    "clipped": (INFLATED, CLIPPED),
    "not clipped": (INFLATED, replace(CLIPPED, clipped=False)),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_a_state_that_does_not_meet_its_demands_is_not_concluded(kind: str, tmp_path: Path) -> None:
    made, asked, error, says = REFUSED[kind]
    with made(tmp_path / "a.mcap", asked) as recorder, pytest.raises(error, match=says):
        conclude(recorder.buffers, asked)
    (again,) = replay_states(Recording.open(tmp_path / "a.mcap"))
    assert again.row is None and again.reason


@pytest.mark.parametrize("kind", CONCLUDED)
def test_a_state_that_meets_its_demands_is_concluded_live_and_again_and_is_in_the_file(kind: str, tmp_path: Path) -> None:
    made, asked = CONCLUDED[kind]
    with made(tmp_path / "a.mcap", asked) as recorder:
        row = conclude(recorder.buffers, asked)
        assert row is not None
        recorder.trial(6.0, 1, row)
    recording = Recording.open(tmp_path / "a.mcap")
    assert recording.states[0].state == asked and compare(recording).equal
    assert [row.clipped for row in table_of(recording)] == [asked.clipped]


def test_demands_that_no_stream_can_show_are_refused() -> None:
    for asked, change, said in (
        (JAMMED, {"topics": ("/force", "/arm")}, "needs /vacuum"),
        (JAMMED, {"probe": None}, "needs a probe"),
        (ASKED, {"topics": ("/pressure",)}, "need /tip"),
    ):
        raises(BadMessage, said, replace, asked, **change)


def test_the_text_that_older_readers_take_apart_does_not_mention_what_came_later() -> None:
    later = {"vacuum": None, "least_force": None, "clipped": False}
    for marked, plain in ((JAMMED, replace(JAMMED, **later)), (CLIPPED, replace(CLIPPED, clipped=False))):  # type: ignore[arg-type]
        assert not set(later) & set(json.loads(marked.to_json())) and marked.to_json() == plain.to_json()
    assert "clipped" not in json.loads(ROW.to_json()) and ROW.to_json() == replace(ROW, clipped=False).to_json()


@pytest.mark.parametrize(
    ("rows", "new", "last", "wrong", "said"),
    [
        ((ROW, replace(ROW, step=2, clipped=False)), {"clipped"}, "1", "2", "clipped: 2 is neither 0 nor 1"),
        (
            (replace(PUSHED, force_drift=-0.25, doubt="drift"), replace(PUSHED, step=2)), {"doubt", "force_drift"},
            "drift", "odd", "doubt: 'odd' is not one of soft, bodies, drift",
        ),
    ],
    ids=["clipped", "doubtful"],
)  # fmt: skip
def test_the_table_has_the_columns_only_where_they_say_something(
    tmp_path: Path, rows: tuple[TrialRow, TrialRow], new: set[str], last: str, wrong: str, said: str
) -> None:
    path = tmp_path / "trials.csv"
    assert not new & set(Table.of(rows[1:]).columns)
    write_csv(Table.of(rows), path)
    again = read_csv(path)
    assert [row.cells() for row in again] == [row.cells() for row in rows]
    assert (again.clipped | again.doubtful).tolist() == [True] + [False] * (len(again) - 1)
    head, first, second = path.read_text().splitlines()
    assert new <= set(head.split(",")) and first.endswith(f",{last}") and second.endswith(",")
    path.write_text(path.read_text().replace(f",{last}\n", f",{wrong}\n"))
    raises(BadTable, said, read_csv, path)


def test_states_at_rest_are_compared_body_by_body(tmp_path: Path) -> None:
    with following(straight)(tmp_path / "a.mcap", ASKED) as recorder:
        row = conclude(recorder.buffers, ASKED)
    assert row is not None and row.tip is not None
    assert not elsewhere(row, row)
    moved = replace(row, markers=(row.markers[1], row.markers[0], row.markers[2]))
    assert "marker" in elsewhere(row, moved) and "100 mm" in elsewhere(row, moved)
    assert not elsewhere(row, replace(row, tip=tuple(np.add(row.tip, (0.008, 0, 0)))))
    assert not elsewhere(row, replace(row, markers=((math.nan,) * 3, *row.markers[1:])))


@pytest.mark.parametrize(("stamped", "says"), [(0.1, ""), (0.0002, "the tip jumped by 90 mm")])
def test_frames_that_a_busy_computer_hands_over_together_are_no_jump(stamped: float, says: str) -> None:
    samples = np.zeros(3, [("t", "f8"), ("device_time", "f8"), ("position", "f8", 3), ("markers", "f8", (0, 3))])
    samples["t"], samples["device_time"] = [1.0, 1.2, 1.2002], [0.9, 1.0, 1.0 + stamped]
    samples["position"][:, 0] = [0.0, 0.09, 0.18]
    assert jumped(samples).startswith(says) and bool(jumped(samples)) is bool(says)
