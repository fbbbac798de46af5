"""What every length unit must do, run against each driver through its maker's library."""

import math
from functools import partial
from typing import Any

import pytest

from drivers.dynamixel.driver import StallWatch
from drivers.errors import BadReply, DeviceFault, LimitExceeded, NotReady, WrongDevice
from drivers.interfaces import SpineSample
from tests.drivers.spines import DRIVERS, Make, arrive, fault_of, homed, make_pair, under_way, watch
from tests.simulated.bench import Bench, raises

pytestmark = pytest.mark.speed(5.0)  # at a speed at which motions are seen


@pytest.fixture(params=DRIVERS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def make(bench: Bench, kind: str) -> Make:
    return partial(make_pair, bench, kind)


def fastest(unit: Any) -> float:
    """Poll until it has arrived; the speed of largest size on the way, m/s."""
    speeds: list[float] = []

    def arrived(sample: SpineSample) -> bool:
        speeds.append(sample.speed)
        return not sample.moving

    watch(unit, arrived)
    return max(speeds, key=abs)


def test_homing_finds_length_zero_at_the_retracted_end(bench: Bench, make: Make) -> None:
    bench.clock.speed = 1.0
    unit, _ = make({"start_length": 0.04})
    unit.open()
    assert not unit.read().homed
    unit.home()
    started = unit.read()
    assert started.moving and not started.homed
    assert watch(unit, lambda s: s.homed).length == pytest.approx(0.0, abs=1e-4)
    assert bench.plant.spine_drive == pytest.approx(0.0, abs=5e-4)
    assert not unit.read().moving


@pytest.mark.parametrize("direction", [1, -1])
def test_length_grows_whichever_way_the_motor_is_mounted(bench: Bench, make: Make, direction: int) -> None:
    unit, _ = make({"direction": direction}, direction=direction)
    homed(unit)
    for length, fast in ((0.12, 0.01), (0.02, -0.01)):
        goal = unit.move_to(length, 0.05)
        assert goal == pytest.approx(length, abs=1e-4) and unit.read().moving
        assert fastest(unit) / fast > 1
        assert unit.read().goal == goal
        assert bench.plant.spine_drive == pytest.approx(length, abs=6e-4) == unit.read().length


def test_goals_and_speeds_are_clipped_and_the_clipped_goal_returned(make: Make) -> None:
    unit, _ = make(max_length=0.06, max_speed=0.02)
    homed(unit)
    assert unit.move_to(-0.2, 0.05) == pytest.approx(0.0, abs=1e-4)
    assert unit.move_to(0.9, 5.0) == pytest.approx(0.06, abs=1e-4)
    assert 0.01 < fastest(unit) < 0.025


@pytest.mark.parametrize(("length", "speed"), [(math.nan, 0.01), (0.1, 0.0), (0.1, -0.1), (0.1, math.nan)])
def test_what_is_no_motion_is_refused_before_anything_is_sent(make: Make, length: float, speed: float) -> None:
    unit, fake = make()
    homed(unit)
    before = len(fake.requests)
    raises(LimitExceeded, "not a valid motion", unit.move_to, length, speed)
    assert len(fake.requests) == before


def test_stop_holds_where_it_is(bench: Bench, make: Make) -> None:
    unit, _ = make()
    under_way(unit)
    unit.stop()
    arrive(unit)
    held = unit.read().length
    bench.clock.sleep(1.0)
    assert held < 0.2
    assert unit.read().length == pytest.approx(held, abs=1e-3)


def test_stop_ends_a_reference_run_without_result(bench: Bench, make: Make) -> None:
    unit, _ = make()
    unit.open()
    unit.home()
    unit.stop()
    bench.clock.sleep(3.0)
    sample = unit.read()
    assert not sample.homed and not sample.moving


@pytest.mark.parametrize(
    ("kind", "start", "changes", "says"),
    [("dynamixel", 0.39, {}, "no end stop"), ("tmcl", 0.05, {"max_deviation": 0.05}, "home")],
    indirect=["kind"],
)
def test_an_end_that_is_never_found_ends_the_homing(make: Make, start: float, changes: dict[str, float], says: str) -> None:
    unit, fake = make({"start_length": start}, max_length=0.1, homing_speed=0.05, **changes)
    fake.faults.extra["no_switch"] = True
    unit.open()
    unit.home()
    raises(DeviceFault, says, watch, unit, lambda s: s.homed)


def test_a_silent_host_lets_the_motor_stop_and_is_reported_and_a_stop_acknowledges_it(
    bench: Bench, kind: str, make: Make
) -> None:
    limit = {"dynamixel": "watchdog", "tmcl": "heartbeat"}[kind]
    unit, _ = make(**{limit: 0.3})
    homed(unit)
    unit.move_to(0.35, 0.02)
    bench.clock.sleep(30.0)  # nothing is sent, for longer than the motion takes
    assert bench.plant.spine_drive < 0.3
    raises(DeviceFault, limit, arrive, unit)
    if kind == "dynamixel":
        raises(DeviceFault, limit, unit.move_to, 0.35, 0.05)
    unit.stop()
    assert unit.read().homed
    unit.move_to(0.1, 0.05)
    assert arrive(unit).length == pytest.approx(0.1, abs=6e-4)


def test_a_jammed_spine_is_reported_as_a_stall_until_the_next_command(bench: Bench, make: Make) -> None:
    unit, _ = make()
    under_way(unit)
    bench.plant.spine_blocked = True
    fault_of(unit, "(?i)un-jam")
    raises(DeviceFault, None, unit.read)
    bench.plant.spine_blocked = False
    unit.move_to(0.1, 0.05)
    assert arrive(unit).length == pytest.approx(0.1, abs=6e-4)
    assert bench.plant.spine_drive == pytest.approx(0.1, abs=1e-3)


def test_a_unit_that_restarted_has_lost_its_zero(make: Make) -> None:
    unit, fake = make()
    homed(unit)
    fake.faults.extra["restart"] = True
    fault_of(unit, "restarted")
    raises(NotReady, None, unit.move_to, 0.1, 0.02)
    unit.home()
    assert watch(unit, lambda s: s.homed).length == pytest.approx(0.0, abs=1e-4)


def test_a_refusal_tells_the_units_reason(kind: str, make: Make) -> None:
    unit, fake = make()
    homed(unit)
    fake.faults.extra["nak"], says = {"dynamixel": (6, "beyond the limit"), "tmcl": (4, "Invalid Value")}[kind]
    raises(BadReply, says, unit.move_to, 0.1, 0.02)


def test_another_model_is_the_wrong_device_each_time_that_it_is_opened(kind: str, make: Make) -> None:
    model, named = {"dynamixel": ({"model": 1060}, "1060"), "tmcl": ({"model": 1140}, "TMCM-1140")}[kind]
    unit, _ = make(model)
    for _ in range(2):
        raises(WrongDevice, named, unit.open)


def test_close_stops_the_motion(bench: Bench, make: Make) -> None:
    unit, _ = make()
    under_way(unit)
    unit.close()

    def stands() -> bool:
        before = bench.plant.spine_drive
        bench.clock.sleep(2.0)
        return abs(bench.plant.spine_drive - before) < 1e-3

    assert any(stands() for _ in range(20))
    assert bench.plant.spine_drive < 0.25


def fed(readings: list[tuple[float, float, float]]) -> list[bool]:
    watch = StallWatch(allowed=1.0, window=10, duration=0.5)
    return [watch.update(t, position, current) for t, position, current in readings]


def test_pushing_without_moving_for_the_duration_is_a_stall() -> None:
    assert fed([(0.0, 0, 0.9), (0.3, 5, -0.9), (0.6, 3, 1.0)]) == [False, False, True]


@pytest.mark.parametrize("readings", [
    [(0.0, 0, 0.9), (0.3, 20, 0.9), (0.6, 40, 0.9), (0.9, 60, 0.9)],
    [(0.0, 0, 0.9), (0.3, 0, 0.1), (0.6, 0, 0.9), (0.9, 0, 0.9)],
    [(0.0, 0, 0.9), (5.0, 0, 0.9)],
], ids=["moving", "not pushing in between", "two late readings only"])  # fmt: skip
def test_anything_less_is_not(readings: list[tuple[float, float, float]]) -> None:
    assert not any(fed(readings))
