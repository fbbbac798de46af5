"""Range and rate of set-points."""

import math

import pytest

from drivers.errors import LimitExceeded
from drivers.pressure_limits import PressureLimits


class HandClock:
    """A clock that a test turns."""

    time = 0.0

    def now(self) -> float:
        return self.time

    def sleep(self, duration: float) -> None:
        self.time += duration


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def limits(clock: HandClock) -> PressureLimits:
    return PressureLimits("pressure", 2, max_pressure=300e3, max_rate=100e3, clock=clock)


def send(limits: PressureLimits, pressures: tuple[float, float]) -> tuple[float, ...]:
    allowed = limits.allow(pressures)
    for channel, pressure in enumerate(allowed):
        limits.sent(channel, pressure)
    return allowed


def test_a_step_is_cut_to_the_rate_times_the_time_since_the_last_one(clock: HandClock, limits: PressureLimits) -> None:
    clock.sleep(0.25)
    assert send(limits, (200e3, 10e3)) == (25e3, 10e3)
    clock.sleep(0.5)
    assert send(limits, (200e3, 0.0)) == (75e3, 0.0)


def test_a_long_pause_does_not_buy_a_long_step(clock: HandClock, limits: PressureLimits) -> None:
    clock.sleep(60.0)
    assert send(limits, (300e3, 0.0)) == (100e3, 0.0)


def test_values_outside_the_range_are_clipped(clock: HandClock, limits: PressureLimits) -> None:
    for _ in range(4):
        clock.sleep(1.0)
        last = send(limits, (1e6, -50e3))
    assert last == (300e3, 0.0)


def test_held_set_points_above_the_limit_come_down_to_it_at_once(clock: HandClock, limits: PressureLimits) -> None:
    limits.start_from((400e3, 0.0))
    assert limits.allow((400e3, 0.0)) == (300e3, 0.0)


def test_a_channel_that_failed_is_judged_from_what_it_last_took(clock: HandClock, limits: PressureLimits) -> None:
    clock.sleep(0.5)
    limits.sent(0, limits.allow((50e3, 50e3))[0])
    clock.sleep(0.1)
    assert limits.allow((50e3, 50e3)) == pytest.approx((50e3, 10e3))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [((0.0, math.nan), "channel 2"), ((0.0, math.inf), "channel 2"), ((0.0, 0.0, 0.0), "3 pressures for 2 channels")],
)
def test_what_are_no_pressures_is_refused(limits: PressureLimits, wrong: tuple[float, ...], message: str) -> None:
    with pytest.raises(LimitExceeded, match=message):
        limits.allow(wrong)
