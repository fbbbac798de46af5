"""A state is concluded once and for all: live or from the file, early or late, to the last bit."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_run import TARGETS, Message, Run
from synthetic_run import state as plain_state

from recordings.campaign.replay import compare, replay, table_of
from recordings.errors import BadMessage, NotSettled
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.messages import streams
from recordings.states.averaging import from_rotation_vector, mean_quaternion
from recordings.states.buffer import Buffers
from recordings.states.concluding import conclude
from recordings.states.rules import Crossing, Probe, Settled, State, Window
from tests.simulated.bench import raises

REST = Settled(band=1500.0, still=0.8, still_distance=0.8e-3, smooth=8, average=0.5, min_samples=4, timeout=20.0)
PROBE = Probe(direction=(0.0, 0.0, -1.0), origin=(0.4, 0.1, 0.31))


LOADED: dict[str, Any] = {"step": 2, "t_start": 3.0, "ramp_end": 3.0, "rate": 26667.0, "spine_length": 0.2, "tip_mass": 0.053}


def state(rule: Settled | Window | Crossing, **changes: object) -> State:
    return plain_state(rule=rule, **LOADED | changes)


PUSH = state(
    Window(delay=1.0, average=0.4), protocol="stiffness", specimen="body", probe=PROBE, topics=("/pressure", "/force", "/arm")
)
RAMP = state(Crossing(level=40e3, chambers=(0, 1, 2), rising=True), t_start=0.5)
STATES = {"settled": state(REST), "window": state(Window(delay=2.0)), "push": PUSH, "crossing": RAMP}


KINDS = streams(markers=2)


def fill(buffers: Buffers, messages: Iterable[Message], after: float = -math.inf, until: float = math.inf) -> None:
    """Append what came later than `after`, and not later than `until`, as the recorder does."""
    for topic, t, values in messages:
        if after < t <= until:
            stamp = round(t * 1e9) / 1e9
            buffers[topic].append(stamp, KINDS[topic].encode(stamp, values))


def filled(messages: Iterable[Message]) -> Buffers:
    """Buffers as the recorder fills them, of the whole run."""
    buffers = Buffers(KINDS)
    fill(buffers, messages)
    return buffers


def outcome(buffers: Buffers, asked: State) -> str | None:
    try:
        row = conclude(buffers, asked)
    except NotSettled as error:
        return str(error)
    return None if row is None else row.to_json()


@pytest.mark.parametrize("name", STATES)
@settings(max_examples=12)
@given(
    seed=st.integers(0, 10**6),
    lag=st.sampled_from([0.2, 0.8, 3.0]),
    dropout=st.sampled_from([0.0, 0.05]),
    looks=st.lists(st.floats(2.0, 12.0), min_size=1, max_size=8),
)
def test_what_is_concluded_does_not_depend_on_when_one_asks(
    name: str, seed: int, lag: float, dropout: float, looks: list[float]
) -> None:
    messages = list(Run(seed=seed, lag=lag, dropout=dropout).messages())
    final = outcome(filled(messages), STATES[name])
    buffers, filled_until, concluded = Buffers(KINDS), -math.inf, False
    for until in sorted(looks):
        fill(buffers, messages, filled_until, until)
        filled_until = until
        now = outcome(buffers, STATES[name])
        assert now is None or now == final
        assert not (concluded and now is None)
        concluded = now is not None


@pytest.mark.parametrize("name", STATES)
def test_a_live_run_and_its_file_agree_to_the_last_bit(name: str, tmp_path: Path) -> None:
    asked = STATES[name]
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=1_700_000_000_000_000_000, markers=2)
    number, row = 0, None
    for topic, t, values in Run(seed=5).messages():
        recorder.push(topic, t, values)
        if not number and t >= asked.t_start:
            number = recorder.state(t, asked)
        if number and row is None and (row := conclude(recorder.buffers, asked)) is not None:
            recorder.trial(t, number, row)
    recorder.close("completed")
    recording = Recording.open(tmp_path / "a.mcap")
    comparison = compare(recording)
    assert (comparison.live, comparison.replayed, comparison.differences) == (1, 1, ())
    assert [r.to_json() for r in table_of(recording)] == [r.to_json() for r in replay(tmp_path / "a.mcap")] == [row.to_json()]
    assert recording.states[0].state == asked


def test_a_row_that_differs_by_one_bit_is_told_with_its_column(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=0, markers=2) as recorder:
        asked = STATES["window"]
        number = recorder.state(0.0, asked)
        recorder.state(0.0, asked)
        for topic, t, values in Run().messages():
            recorder.push(topic, t, values)
        row = conclude(recorder.buffers, asked)
        assert row is not None and row.tip is not None
        x, y, z = row.tip
        recorder.trial(12.0, number, replace(row, tip=(np.nextafter(x, 1.0).item(), y, z)))
    comparison = compare(Recording.open(tmp_path / "a.mcap"))
    assert not comparison.equal and "x was" in comparison.differences[0] and comparison.replayed == 2


def test_a_settled_reading_is_the_mean_of_a_time_at_rest() -> None:
    row = conclude(filled(Run(lag=0.5).messages()), state(REST))
    assert row is not None and row.tip is not None and row.orientation is not None and row.vacuum is not None
    assert row.pressures == pytest.approx(TARGETS, abs=200)
    assert row.tip == pytest.approx(Run(lag=0.5).tip(row.t), abs=0.2e-3)
    assert row.vacuum == pytest.approx(101_325 - 21e3, abs=100) and row.spine_length == pytest.approx(0.2, abs=1e-4)
    expected = np.array([1, 0, 0.3, 0]) / np.hypot(1, 0.3)
    assert row.orientation == pytest.approx(expected, abs=1e-3)
    assert row.markers[0] == (0.0, 0.0, 0.1) and row.markers[1] == pytest.approx((0.01, 0.0, 0.2))
    assert row.hold == row.t - 3.0 and 0.2e-3 < row.sd["x"] < 0.4e-3


def test_a_stream_that_is_polled_seldom_is_taken_from_before_the_window() -> None:
    """On a rig of 20 times real speed a late poll leaves out a second."""

    def polled(late: float) -> Iterator[Message]:
        return (m for m in Run().messages() if m[0] != "/spine" or not 5.5 - late < m[1] < 5.5)

    asked = state(Window(delay=2.0, average=0.4))
    row = conclude(filled(polled(3.0)), asked)
    assert row is not None and row.spine_length == pytest.approx(0.2, abs=1e-4)
    raises(NotSettled, "0 usable samples of /spine from -4.60", conclude, filled(polled(9.0)), asked)


def test_a_hidden_tip_delays_the_reading_until_it_is_seen_again() -> None:
    row = conclude(filled(Run(lag=0.3, hidden=(3.2, 6.0)).messages()), state(REST))
    assert row is not None and row.t > 6.0 + REST.still / 2 - REST.max_hidden


def test_a_state_that_never_settles_says_what_stood_in_the_way() -> None:
    short = replace(REST, timeout=5.0)
    for run, changes, word in (
        (Run(), {"targets": (90e3, *TARGETS[1:])}, "channel 1 is .* kPa from its set-point 90.0 kPa, band 1.5 kPa"),
        (Run(lag=20.0), {}, r"not settled within 5 s: the tip still moved .* mm in 0.8 s, limit 0.80 mm"),
        (Run(hidden=(0.0, 99.0)), {}, "the tip was not tracked"),
    ):
        told = raises(NotSettled, word, conclude, filled(run.messages()), state(short, **changes))
        assert "trial 1 step 2" in told and ("channel" in told) == ("channel" in word)


def test_what_was_at_rest_is_not_named_among_what_was_not() -> None:
    wrong = state(replace(REST, timeout=8.0), targets=(90e3, 60e3, 95e3, 0.0, 0.0, 0.0, 0.0, 0.0, 5e3))
    said = raises(NotSettled, None, conclude, filled(Run().messages()), wrong)
    assert said.startswith("trial 1 step 2: not settled within 8 s: channel 2 is 2") and "set-point 60.0 kPa" in said
    assert said.endswith("1 further channels are off") and "the tip" not in said


def test_a_stream_that_stands_still_keeps_the_reading_waiting() -> None:
    messages = [m for m in Run().messages() if m[0] != "/vacuum" or m[1] < 3.1]
    assert conclude(filled(messages), state(REST)) is None
    assert conclude(filled(messages), state(REST, topics=("/pressure", "/tip"))) is not None


def test_a_crossing_is_read_where_the_pressure_passes_the_level() -> None:
    run = Run(seed=9)
    row = conclude(filled(run.messages()), RAMP)
    assert row is not None and row.tip is not None and row.hold == 0.0
    assert row.t == pytest.approx(1.5, abs=0.01)
    assert row.pressures[:3] == pytest.approx((40e3,) * 3, abs=200)
    assert row.tip == pytest.approx(run.tip(row.t), abs=0.5e-3)


def test_streams_polled_seldom_are_taken_from_just_before_a_crossing() -> None:
    row = conclude(filled([m for m in Run().messages() if m[0] != "/vacuum" or abs(m[1] - 1.5) > 0.4]), RAMP)
    assert row is not None and row.vacuum == pytest.approx(101_325 - 21e3, abs=200)


def test_a_level_passed_before_or_never_is_not_a_crossing() -> None:
    raises(NotSettled, "already above", conclude, filled(Run().messages()), replace(RAMP, t_start=2.0))
    never = replace(RAMP, rule=Crossing(level=95e3, chambers=(0,), rising=True, timeout=8.0))
    raises(NotSettled, "did not get above", conclude, filled(Run().messages()), never)


def test_force_and_deflection_are_taken_along_the_push() -> None:
    """The TCP looks down (turned by pi about x, written as +pi and -pi): the sensor's +z is the arm's -z, the push."""
    row = conclude(filled(Run().messages()), PUSH)
    assert row is not None and row.force is not None and row.deflection is not None
    assert row.force == pytest.approx(-2.0, abs=0.05)
    assert row.deflection == pytest.approx(5e-3, abs=1e-4)
    assert row.tip is None and row.specimen == "body"


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300, -1e20])
@pytest.mark.parametrize(("topic", "field"), [("/arm", 2), ("/force", 0), ("/pressure", 1)])
@pytest.mark.parametrize("every", [False, True])
def test_a_sample_that_cannot_be_is_told_and_not_averaged_away(topic: str, field: int, value: float, every: bool) -> None:
    wrong, sent = 0, list[Message]()
    for name, t, values in Run().messages():
        spoilt = list(values)
        if name == topic and (every or not wrong and t > PUSH.t_start + 1.2):
            spoilt[field] = (value,) * len(spoilt[field])  # type: ignore[arg-type]
            wrong += 1
        sent.append((name, t, tuple(spoilt)))
    raises(NotSettled, f"{topic}: .*not a number{'' if every else ' in 1 of'}", conclude, filled(iter(sent)), PUSH)


def test_a_state_that_cannot_be_right_is_refused(tmp_path: Path) -> None:
    for change in ({"branch": "up"}, {"topics": ("/tips",)}, {"specimen": "arm"}):
        raises(BadMessage, "unknown", state, REST, **change)
    raises(BadMessage, "letters, digits", state, REST, protocol="bend, twice")
    raises(BadMessage, "unit vector", Probe, direction=(0.0, 0.0, 2.0), origin=(0.0, 0.0, 0.0))
    raises(BadMessage, "/force", state, Window(1.0), probe=PROBE)
    with Recorder(tmp_path / "a.mcap", start_wall_ns=0) as recorder, pytest.raises(BadMessage, match="9 chambers"):
        recorder.state(0.0, state(REST, targets=(0.0,)))


@given(st.lists(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.booleans()), min_size=1, max_size=20))
def test_the_mean_rotation_is_the_eigenvector_of_the_largest_eigenvalue(items: list[tuple[float, float, bool]]) -> None:
    quaternions = []
    for a, b, flip in items:
        q = from_rotation_vector((math.pi / 2 + a, b, a * b))
        quaternions.append(tuple(-c for c in q) if flip else q)
    values, vectors = np.linalg.eigh(np.einsum("ni,nj->ij", quaternions, quaternions))
    mean = np.array(mean_quaternion(quaternions))
    assert abs(mean @ vectors[:, -1]) == pytest.approx(1.0, abs=1e-12) and mean[0] >= 0
