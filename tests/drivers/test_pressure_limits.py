"""Range and rate of set-points, and the wiring between channels and chambers."""

import math

import pytest

from drivers.chambers import PAPER_WIRING, ChamberMap
from drivers.errors import LimitExceeded
from drivers.pressure_limits import PressureLimits
from tests.simulated.bench import raises


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


def test_each_channel_may_have_a_limit_of_its_own(clock: HandClock) -> None:
    limits = PressureLimits("pressure", 2, max_pressure=(50e3, 80e3), max_rate=100e3, clock=clock)
    clock.sleep(1.0)
    assert send(limits, (90e3, 90e3)) == (50e3, 80e3)


def test_a_long_pause_does_not_buy_a_long_step(clock: HandClock, limits: PressureLimits) -> None:
    clock.sleep(60.0)
    assert send(limits, (300e3, 0.0)) == (100e3, 0.0)


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
    raises(LimitExceeded, message, limits.allow, wrong)


NINE = [[i] for i in range(1, 10)]


def test_a_set_of_three_is_made_by_its_channel_alone() -> None:
    assert ChamberMap(PAPER_WIRING).setpoints({9: 5e4, 1: 5e4, 2: 5e4}) == (5e4, 0.0, 0.0)


def test_nine_separate_channels_make_any_pattern() -> None:
    assert ChamberMap(NINE).setpoints({i: 1e3 * i for i in range(1, 10)}) == tuple(1e3 * i for i in range(1, 10))


ONE_OF_NINE = ChamberMap([[1], [2]], 9)


@pytest.mark.parametrize(
    ("wiring", "wanted", "message"),
    [
        (ChamberMap(PAPER_WIRING), {9: 1e4, 1: 1e4, 2: 2e4},
         r"channel 1 feeds chambers 9, 1, 2 .* chamber 1: 10000 Pa, chamber 2: 20000 Pa"),
        # a chamber left out counts as zero, so it cannot follow its neighbours unasked
        (ChamberMap(PAPER_WIRING), {9: 1e4, 1: 1e4}, "chamber 2: 0 Pa"),
        (ONE_OF_NINE, {7: 1e4}, "chamber 7 is not connected.*connected are 1, 2"),
        (ChamberMap([[1], [2], [3]], 3), {4: 1e4}, "4 is not a chamber; chambers are numbered 1 to 3"),
    ],
)  # fmt: skip
def test_pressures_that_the_wiring_cannot_make_are_refused(wiring: ChamberMap, wanted: dict[int, float], message: str) -> None:
    raises(ValueError, message, wiring.setpoints, wanted)


def test_a_chamber_that_is_not_connected_may_stay_flat() -> None:
    assert ONE_OF_NINE.setpoints({1: 1e4, 7: 0.0}) == (1e4, 0.0)


def test_channel_values_are_spread_over_the_chambers_and_unconnected_ones_read_zero() -> None:
    assert ChamberMap([[9, 1], [4]]).by_chamber((7.0, 3.0)) == (7.0, 0, 0, 3.0, 0, 0, 0, 0, 7.0)


def test_a_wrong_number_of_channel_values_is_refused() -> None:
    raises(ValueError, "2 values for 3 channels", ChamberMap(PAPER_WIRING).by_chamber, (1.0, 2.0))


@pytest.mark.parametrize(
    ("chambers", "message"),
    [
        ([[1, 2], [2, 3]], "chamber 2 is listed for channel 1 and for channel 2"),
        ([[1, 1]], "chamber 1 is listed for channel 1 and for channel 1"),
        ([[0]], "0 is not a chamber"),
        ([[10]], "10 is not a chamber"),
        ([[1], []], "channel 2 feeds no chamber"),
    ],
)
def test_a_wiring_that_cannot_be_is_refused(chambers: list[list[int]], message: str) -> None:
    raises(ValueError, message, ChamberMap, chambers, 9)
