"""Identity of the bodies that the cameras report: reach, jumps, places at rest; the same live, in the file and in replay."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_run import state

from recordings.campaign.replay import compare, replay
from recordings.errors import BadMessage, Misplaced
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.states.concluding import conclude
from recordings.states.demands import Bodies, elsewhere, jumped
from recordings.states.rules import State, Window

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


def following(path: Path, places: Places, asked: State = ASKED) -> Recorder:
    """A recording of 5 s at 100 Hz with one state."""
    recorder = Recorder(path, start_wall_ns=10**18, markers=len(ARCS) - 1)
    recorder.state(0.0, asked)
    for k in range(1, 501):
        t = round(PERIOD * k, 9)
        tip, *markers = places(t)
        recorder.push("/tip", t, (t, k, tip, (1.0, 0.0, 0.0, 0.0), 1e-4, True, tuple(markers)))
    recorder.sync()
    return recorder


def bent(t: float) -> list[tuple[float, float, float]]:
    """The robot bends from 2.0 s on, within 0.2 s."""
    share = min(1.0, max(0.0, (t - 2.0) / 0.2))
    return [(0.6 * share * arc, 0.0, arc) for arc in ARCS]


def bent_with_a_marker_hidden(t: float) -> list[tuple[float, float, float]]:
    """The same; the second marker is hidden meanwhile."""
    return [(math.nan,) * 3 if k == 2 and 1.9 < t < 2.3 else place for k, place in enumerate(bent(t))]


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
    "a marker hidden while the robot bends": bent_with_a_marker_hidden,
    "markers not seen": lambda t: [straight(t)[0], *[(math.nan,) * 3] * 3],
}


@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_a_state_is_not_concluded_where_the_robot_cannot_be(kind: str, tmp_path: Path) -> None:
    places, says = IMPOSSIBLE[kind]
    with following(tmp_path / "a.mcap", places) as recorder, pytest.raises(Misplaced, match=says):
        conclude(recorder.buffers, ASKED)
    assert not list(replay(tmp_path / "a.mcap"))


@pytest.mark.parametrize("kind", POSSIBLE)
def test_a_state_is_concluded_where_the_robot_can_be(kind: str, tmp_path: Path) -> None:
    with following(tmp_path / "a.mcap", POSSIBLE[kind]) as recorder:
        row = conclude(recorder.buffers, ASKED)
        assert row is not None and row.tip is not None
        recorder.trial(4.5, 1, row)
    recording = Recording.open(tmp_path / "a.mcap")
    assert recording.states[0].state == ASKED and compare(recording).equal


def test_without_the_robot_s_limits_everything_counts(tmp_path: Path) -> None:
    free = replace(ASKED, bodies=None)
    with following(tmp_path / "a.mcap", swapped(0, 1, 1.5), free) as recorder:
        assert conclude(recorder.buffers, free) is not None
    assert Recording.open(tmp_path / "a.mcap").states[0].state == free
    with pytest.raises(BadMessage, match="need /tip"):
        replace(ASKED, topics=("/pressure",))


def test_states_at_rest_are_compared_body_by_body(tmp_path: Path) -> None:
    with following(tmp_path / "a.mcap", straight) as recorder:
        row = conclude(recorder.buffers, ASKED)
    assert row is not None and row.tip is not None
    assert not elsewhere(row, row)
    moved = replace(row, markers=(row.markers[1], row.markers[0], row.markers[2]))
    assert "marker" in elsewhere(row, moved) and "100 mm" in elsewhere(row, moved)
    assert not elsewhere(row, replace(row, tip=tuple(np.add(row.tip, (0.008, 0, 0)))))
    assert not elsewhere(row, replace(row, markers=((math.nan,) * 3, *row.markers[1:])))


@pytest.mark.parametrize(("stamped", "says"), [(0.1, ""), (0.0002, "the tip jumped by 90 mm")])
def test_frames_that_a_busy_computer_hands_over_together_are_no_jump(stamped: float, says: str) -> None:
    """Moving at 0.9 m/s; what counts is when they were taken."""
    samples = np.zeros(3, [("t", "f8"), ("device_time", "f8"), ("position", "f8", 3), ("markers", "f8", (0, 3))])
    samples["t"], samples["device_time"] = [1.0, 1.2, 1.2002], [0.9, 1.0, 1.0 + stamped]
    samples["position"][:, 0] = [0.0, 0.09, 0.18]
    assert jumped(samples).startswith(says) and bool(jumped(samples)) is bool(says)
