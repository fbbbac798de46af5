"""What the guard makes of set-points, readings and forces, alone and through the real wire."""

import itertools
import math
import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import DeviceFault
from drivers.ft300s import driver as ft300s
from drivers.interfaces import GaugeSample, PressureSample, SpineSample, Vector6, WrenchSample
from lab.files.rig_file import RigFile, within_robot
from lab.guard.limit_monitor import LimitMonitor, NotHeld
from lab.guard.pulse import AGREE, BEAT, FORCE, FORCE_RANGE, FRESH, MOMENT, MOMENT_RANGE, ForceLimit, Listener, Pulse, overload

RIG = RigFile.model_validate(
    {
        "name": "desk",
        "robot": Path("robot.yaml"),
        "instruments": {
            "pressure": {"driver": "alicat", "port": "/dev/null"},
            "spine": {"driver": "dynamixel", "port": "/dev/null", "metres_per_turn": 0.1},
            "force": {"driver": "ft300s", "port": "/dev/null"},
        },
    }
)


def pressure(t: float, asked: float, measured: float) -> PressureSample:
    return PressureSample(t, (asked, 0.0, 0.0), (measured, 0.0, 0.0))


def steady(asked: float, measured: float, seconds: float) -> DeviceFault | None:
    """The last finding of a steady set-point."""
    monitor, found = LimitMonitor(RIG), None
    for i in range(round(seconds / 0.5) + 1):
        found = monitor.check("pressure", pressure(0.5 * i, asked, measured))
    return found


def test_setpoints_beyond_the_sum_over_the_chambers_alone_are_scaled_down_and_together() -> None:
    monitor = LimitMonitor(RIG)
    assert monitor.setpoints((150e3, 150e3, 150e3)) == (150e3, 150e3, 150e3)
    allowed = monitor.setpoints((300e3, 300e3, 150e3))
    assert sum(3 * p for p in allowed) == pytest.approx(RIG.limits.max_total_pressure)
    assert allowed[0] / allowed[2] == pytest.approx(2.0)
    assert math.isnan(monitor.setpoints((math.nan, 0.0, 0.0))[0])  # left to the driver to refuse


@pytest.mark.parametrize(
    ("asked", "measured", "act", "words"),
    [
        (200e3, 195e3, "", ""),
        (200e3, 0.0, "pause", "leak"),
        (200e3, 160e3, "pause", "leak"),
        (0.0, 60e3, "land", "does not vent"),
    ],
)
def test_a_pressure_that_stays_below_its_setpoint_asks_for_a_pause_and_above_it_lands(
    asked: float, measured: float, act: str, words: str
) -> None:
    found = steady(asked, measured, 6.0)
    assert ("" if found is None else "pause" if isinstance(found, NotHeld) else "land") == act
    if found is not None:
        assert words in str(found) and "channel 1" in str(found)


def spine(length: float, homed: bool) -> SpineSample:
    return SpineSample(0.0, length, 0.0, length, False, homed)


@pytest.mark.parametrize(
    ("sample", "words"),
    [
        (pressure(0.0, 300e3, math.nan), "channel 1"),
        (pressure(0.0, 300e3, math.inf), "channel 1"),
        (pressure(0.0, 300e3, 340e3), "channel 1"),
        (PressureSample(0.0, (300e3,) * 3, (300e3,) * 3), "sum"),
        (GaugeSample(0.0, 20e3), None),
        (GaugeSample(0.0, 5e3), ""),
        (GaugeSample(0.0, math.nan), ""),
        (spine(0.3, True), None),
        (spine(0.4, True), ""),
        (spine(-0.05, True), ""),
        (spine(9.0, False), None),
    ],
    ids=str,
)
def test_a_reading_that_cannot_be_or_must_not_be_lands_the_rig_at_once(sample: Any, words: str | None) -> None:
    name = {PressureSample: "pressure", GaugeSample: "gauge", SpineSample: "spine"}[type(sample)]
    found = LimitMonitor(RIG).check(name, sample)
    assert (found is not None) is (words is not None)
    if found is not None:
        assert type(found) is DeviceFault and str(words) in str(found)


def test_each_channel_has_a_limit_of_its_own() -> None:
    monitor = LimitMonitor(within_robot(RIG, (200e3,) * 8 + (100e3,)))  # chamber 9 is on the first channel
    assert monitor.check("pressure", PressureSample(0.0, (0.0,) * 3, (125e3, 225e3, 225e3))) is None
    found = monitor.check("pressure", PressureSample(0.1, (0.0,) * 3, (135e3, 0.0, 0.0)))
    assert "channel 1 measures 135.0 kPa, limit 130.0 kPa" in str(found)


def test_a_regulator_that_forgot_its_setpoint_lands_the_rig() -> None:
    monitor = LimitMonitor(RIG)
    monitor.confirmed((100e3, 0.0, 0.0))
    found = [monitor.check("pressure", pressure(t, held, 0.0)) for t, held in ((0.0, 100e3), (0.1, 0.0), (0.2, 0.0))]
    assert found[:2] == [None, None]
    assert type(found[2]) is DeviceFault and "restarted" in str(found[2])


def test_one_wrong_reading_of_two_channels_each_lands_nothing() -> None:
    monitor = LimitMonitor(RIG)
    monitor.confirmed((0.0, 0.0, 0.0))
    for k, wrong in enumerate((0, 1, 2, 0)):
        held = tuple(50e3 if channel == wrong else 0.0 for channel in range(3))
        assert monitor.check("pressure", PressureSample(0.1 * k, held, (0.0, 0.0, 0.0))) is None


# -- one channel that does not follow, while others and itself are ramped
Setpoints = Callable[[float], float]
LIMIT, PATIENCE = RIG.limits.pressure_error, RIG.limits.pressure_error_time
RATES = st.floats(5e3, 100e3)
"""Up to max_rate, Pa/s."""
PERIODS = st.sampled_from([0.05, 0.1, 0.35, 1.0])
"""s of rig time between two readings: 20 Hz, and the same with the rig's clock running faster."""


def sweep(rate: float, levels: tuple[float, ...], hold: float) -> Setpoints:
    """Set-point over time: from level to level at a rate, waiting at each; sent every 0.1 s as a ramp does."""

    def at(t: float) -> float:
        t = math.floor(t / 0.1 + 1e-9) * 0.1
        for a, b in itertools.pairwise(itertools.cycle((0.0, *levels))):
            way = abs(b - a) / rate
            if t < way:
                return a + (b - a) * t / way
            t -= way + hold
            if t < 0:
                return b
        raise AssertionError

    return at


def chamber(told: Setpoints, tau: float, period: float, noise: float, seed: int) -> Iterator[tuple[float, float, float]]:
    """(t, set-point, measured) of a sound chamber that follows with a lag of `tau`."""
    rng, p, step = random.Random(seed), 0.0, 0.05
    for i in itertools.count():
        t = i * period
        yield t, told(t), p + rng.gauss(0.0, noise)
        for k in range(round(period / step)):
            s = told(t + k * step)
            p = s + (p - s) * math.exp(-step / tau)


@settings(max_examples=20)
@given(
    rate=RATES, period=PERIODS, tau=st.floats(0.05, 1.0), hold=st.floats(0.0, 4.0), seed=st.integers(0, 99),
    levels=st.lists(st.floats(0.0, 300e3), min_size=1, max_size=5),
)  # fmt: skip
def test_no_sound_chamber_is_accused_in_any_sweep(
    rate: float, period: float, tau: float, hold: float, seed: int, levels: list[float]
) -> None:
    monitor = LimitMonitor(RIG)
    assert RIG.instruments.pressure is not None and tau <= RIG.instruments.pressure.time_constant
    told = sweep(rate, tuple(levels), hold + 0.1)
    for t, asked, p in itertools.takewhile(lambda s: s[0] < 60.0, chamber(told, tau, period, 1e3, seed)):
        assert monitor.check("pressure", pressure(t, asked, p)) is None


@settings(max_examples=20)
@given(
    seed=st.integers(0, 99), tau=st.floats(0.05, 1.0), commands=st.integers(1, 6),
    levels=st.lists(st.floats(0.0, 300e3), min_size=2, max_size=5),
)  # fmt: skip
def test_no_sound_chamber_is_accused_that_is_read_seldom_and_told_often(
    seed: int, tau: float, commands: int, levels: list[float]
) -> None:
    monitor, rng, p, t = LimitMonitor(RIG), random.Random(seed), 0.0, 0.0
    told = itertools.cycle(levels)
    for _ in range(80):
        for _ in range(rng.randint(1, commands)):
            setpoint = next(told)
            monitor.confirmed((setpoint, 0.0, 0.0))
            wait = rng.uniform(0.05, 4.0)
            p, t = setpoint + (p - setpoint) * math.exp(-wait / tau), t + wait
        if rng.random() < 0.5:  # the last one has only just been told
            setpoint = next(told)
            monitor.confirmed((setpoint, 0.0, 0.0))
        assert monitor.check("pressure", pressure(t, setpoint, p)) is None


def test_a_slow_regulator_is_sound_when_rig_yaml_says_how_slow() -> None:
    told = sweep(60e3, (300e3,), 10.0)
    assert RIG.instruments.pressure is not None
    slow = RIG.instruments.pressure.model_copy(update={"time_constant": 4.0})
    rig = RIG.model_copy(update={"instruments": RIG.instruments.model_copy(update={"pressure": slow})})
    stream = [s for s, _ in zip(chamber(told, 4.0, 0.1, 1e3, 1), range(1200), strict=False)]
    for known, accused in ((rig, False), (RIG, True)):
        monitor = LimitMonitor(known)
        assert any(monitor.check("pressure", pressure(*s)) is not None for s in stream) is accused


@settings(max_examples=30)
@given(
    rate=RATES, period=PERIODS, others=RATES, start=st.floats(0.0, 40.0), seed=st.integers(0, 99),
    level=st.floats(80e3, 300e3),
)  # fmt: skip
def test_a_channel_that_stops_following_is_told_in_time_whatever_ramps(
    rate: float, period: float, others: float, start: float, seed: int, level: float
) -> None:
    monitor, rng = LimitMonitor(RIG), random.Random(seed)
    mine, theirs = sweep(rate, (level,), 8.0), sweep(others, (100e3,), 0.1)
    sound, other = chamber(mine, 0.25, period, 100.0, seed), chamber(theirs, 0.25, period, 100.0, seed)
    stuck, off_since = math.nan, math.inf
    for (t, asked, p), (_, asked_too, p_too) in zip(sound, other, strict=True):
        if t >= start and math.isnan(stuck):
            stuck = p
        shown = p if math.isnan(stuck) else stuck + rng.gauss(0.0, 100.0)
        found = monitor.check("pressure", PressureSample(t, (asked, asked_too, 0.0), (shown, p_too, 0.0)))
        if found is not None:
            assert t > start and "channel 1" in str(found)
            assert type(found) is (NotHeld if shown < asked else DeviceFault)
            return
        off_since = min(off_since, t) if t >= start and abs(shown - asked) > LIMIT + 1e3 else math.inf
        assert t - off_since <= PATIENCE + 1.0, f"{shown - asked:.0f} Pa away since {off_since:.2f} s, now {t:.2f} s"
        assert t < start + 60.0 + 4 * level / rate, "it was held 8 s at levels that differ by more than twice the limit"


def test_of_two_channels_that_do_not_follow_the_one_that_holds_too_much_decides() -> None:
    monitor, found = LimitMonitor(RIG), None
    for i in range(120):
        found = monitor.check("pressure", PressureSample(0.1 * i, (200e3, 0.0, 0.0), (0.0, 100e3, 0.0)))
    assert type(found) is DeviceFault and "channel 2" in str(found)


# -- what the force sensor's thread tells the guard, through the pipe that carries it
TOOL: Vector6 = (1.5, -2.25, 30.0, 0.1, -0.5, 1.0)
ZERO: Vector6 = (0.0,) * 6


@pytest.fixture
def line() -> Iterator[tuple[ForceLimit, Listener]]:
    receive, send = os.pipe()
    pulse, listener = Pulse(send), Listener(receive)
    yield ForceLimit(RIG.limits, ft300s.Config(port="/dev/null"), pulse), listener
    pulse.close()
    os.close(receive)


def loaded(axis: int, by: float, zero: Vector6 = ZERO) -> WrenchSample:
    raw = list(TOOL)
    raw[axis] += by
    return WrenchSample(0.0, (raw[0], raw[1], raw[2], raw[3], raw[4], raw[5]), zero)


def told(listener: Listener) -> list[bytes]:
    return [kind for kind, _ in listener.take() if kind not in (BEAT, FRESH)]


@pytest.mark.parametrize(
    ("samples", "expected"),
    [
        pytest.param([(3, loaded(0, 0.0)), (AGREE, loaded(0, 250.0))], [FORCE], id="before the sensor has its zero"),
        pytest.param([(3, loaded(0, 0.0)), (AGREE, loaded(2, 65.0))], [FORCE], id="the same along z"),
        pytest.param([(3, loaded(0, 0.0)), (AGREE, loaded(4, 12.0))], [MOMENT], id="a moment"),
        pytest.param([(100, loaded(2, 60.0))], [], id="a tool as heavy as the limit is no load"),
        pytest.param(
            [(1, loaded(0, 200.0)), (10, loaded(0, 0.0)), (1, loaded(0, 200.0)), (10, loaded(0, 0.0))], [],
            id="a knock of one sample is none, not even the first",
        ),
        pytest.param(
            [(1, loaded(0, 200.0)), (10, loaded(0, 0.0)), (AGREE, loaded(0, 65.0))], [FORCE], id="after a knock"
        ),
        pytest.param([(AGREE, loaded(1, 305.0))], [FORCE_RANGE], id="beyond the range from the first sample"),
        pytest.param([(AGREE, loaded(3, 31.0))], [MOMENT_RANGE], id="the same of a moment"),
        pytest.param([(5, loaded(0, 0.0)), (5, loaded(0, 59.0, TOOL))], [], id="59 N beyond the zero"),
        pytest.param([(5, loaded(0, 0.0)), (AGREE, loaded(0, 61.0, TOOL))], [FORCE], id="61 N beyond the zero"),
        # The guard lets pass what it hears while nothing is energised; it must hear it again afterwards.
        pytest.param([(5, loaded(0, 0.0)), (AGREE + 10, loaded(0, 250.0))], [FORCE] * 11, id="as long as it lasts"),
    ],
)  # fmt: skip
def test_which_loads_are_told(
    line: tuple[ForceLimit, Listener], samples: list[tuple[int, WrenchSample]], expected: list[bytes]
) -> None:
    limit, listener = line
    for times, sample in samples:
        for _ in range(times):
            limit.judge(sample)
    assert told(listener) == expected


def test_a_value_beyond_the_range_is_told_as_such() -> None:
    assert "range" in overload(FORCE_RANGE, 305.0, RIG) and "range" in overload(MOMENT_RANGE, 31.0, RIG)


def test_a_new_stream_begins_with_its_own_tool(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    limit.judge(loaded(0, 0.0))
    limit.begin()
    for _ in range(5):
        limit.judge(loaded(0, 80.0))
    assert told(listener) == []


def test_samples_alone_are_no_sign_of_life_of_the_program(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    listener.heard = 0.0
    limit.judge(loaded(0, 0.0))
    records = listener.take()
    assert FRESH in [kind for kind, _ in records]
    assert (listener.heard > 0.0) is any(kind == BEAT for kind, _ in records)
