"""What every length unit must do, run against each driver through its maker's library.

With LAB_TEST_DYNAMIXEL_PORT or LAB_TEST_TMCL_PORT (and LAB_TEST_SPINE_METRES_PER_TURN) the tests that need no fault run
against a real unit instead; those that move want LAB_TEST_ALLOW_MOTION=1 as well and a free spine of at least 60 mm.
"""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest

import timing
from drivers.dynamixel import driver as dynamixel
from drivers.errors import DeviceFault, InstrumentError, LimitExceeded, NoReply, NotReady, Unreachable
from drivers.interfaces import SpineSample
from drivers.tmcl import driver as tmcl
from sim_fakes.dynamixel import DynamixelFake
from sim_fakes.numato import NumatoFake
from sim_fakes.plant import Plant
from sim_fakes.tmcl import TmclFake
from timing import RigClock

Fake = DynamixelFake | TmclFake
DRIVERS: dict[str, tuple[Any, Any, Any]] = {
    "dynamixel": (dynamixel.DynamixelSpine, dynamixel.Config, DynamixelFake),
    "tmcl": (tmcl.TmclSpine, tmcl.Config, TmclFake),
}
METRES_PER_TURN = float(os.environ.get("LAB_TEST_SPINE_METRES_PER_TURN", "0.1"))


@dataclass
class Bench:
    """One driver, its fake unless a real unit is there, and what was made with them."""

    kind: str
    plant: Plant = field(default_factory=Plant)
    made: list[Any] = field(default_factory=list)
    lines: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.hardware = os.environ.get(f"LAB_TEST_{self.kind.upper()}_PORT")
        self.clock = RigClock(1.0 if self.hardware else 5.0)

    def fake(self, **options: Any) -> Any:
        """Start a fake; a real unit cannot take its place."""
        if self.hardware:
            pytest.skip("needs the fake unit")
        fake = DRIVERS[self.kind][2](self.plant, self.clock, **options)
        fake.start()
        self.lines.append(fake)
        return fake

    def unit(self, fake: Fake | None = None, **changes: Any) -> Any:
        """A driver for this fake, or for the real unit."""
        port = self.hardware or (fake or self.fake()).port
        driver, config, _ = DRIVERS[self.kind]
        values = {"port": port, "metres_per_turn": METRES_PER_TURN, "timeout": 1.0} | changes
        unit = driver("spine", config(**values), self.clock)
        self.made.append(unit)
        return unit

    def may_move(self) -> None:
        """Skip on a real unit unless motion is allowed."""
        if self.hardware and os.environ.get("LAB_TEST_ALLOW_MOTION") != "1":
            pytest.skip("moves: set LAB_TEST_ALLOW_MOTION=1 when the spine is free")

    def homed(self, fake: Fake | None = None, **changes: Any) -> Any:
        """A driver, opened and homed."""
        self.may_move()
        unit = self.unit(fake, **changes)
        unit.open()
        unit.home()
        watch(unit, lambda sample: sample.homed)
        return unit


@pytest.fixture(params=DRIVERS)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    bench = Bench(request.param)
    yield bench
    for unit in bench.made:
        unit.close()
    for line in bench.lines:
        line.stop()


def watch(unit: Any, until: Callable[[SpineSample], bool], within: float = 60.0) -> SpineSample:
    """Poll until the sample is as wanted; `within` is host time."""
    deadline = timing.now() + within
    while not until(sample := unit.read()):
        assert timing.now() < deadline, f"still {sample}"
        timing.sleep(0.01)
    return sample


def arrive(unit: Any) -> SpineSample:
    return watch(unit, lambda sample: not sample.moving)


def fastest(unit: Any) -> float:
    """Poll until it has arrived; the speed of largest size on the way, m/s."""
    speeds: list[float] = []

    def arrived(sample: SpineSample) -> bool:
        speeds.append(sample.speed)
        return not sample.moving

    watch(unit, arrived)
    return max(speeds, key=abs)


def fault_of(unit: Any, within: float = 10.0) -> str:
    """Poll until the unit reports a fault; its message."""
    with pytest.raises(DeviceFault) as caught:
        watch(unit, lambda _: False, within)
    return str(caught.value)


def test_homing_finds_length_zero_at_the_retracted_end(bench: Bench) -> None:
    bench.clock = RigClock(1.0)  # slow enough to be seen
    fake = bench.fake(start_length=0.04)
    unit = bench.unit(fake)
    unit.open()
    assert not unit.read().homed
    unit.home()
    started = unit.read()
    assert started.moving
    assert not started.homed
    sample = watch(unit, lambda s: s.homed)
    assert sample.length == pytest.approx(0.0, abs=1e-4)
    assert bench.plant.spine_drive == pytest.approx(0.0, abs=5e-4)
    assert not unit.read().moving


def test_it_moves_to_lengths_in_metres(bench: Bench) -> None:
    unit = bench.homed()
    goal = unit.move_to(0.05, 0.05)
    assert goal == pytest.approx(0.05, abs=1e-4)
    assert unit.read().moving
    sample = arrive(unit)
    assert sample.goal == goal
    assert sample.length == pytest.approx(0.05, abs=6e-4)
    if not bench.hardware:
        assert bench.plant.spine_drive == pytest.approx(0.05, abs=6e-4)


@pytest.mark.parametrize("direction", [1, -1])
def test_length_grows_whichever_way_the_motor_is_mounted(bench: Bench, direction: int) -> None:
    fake = bench.fake(direction=direction)
    unit = bench.homed(fake, direction=direction)
    unit.move_to(0.12, 0.05)
    assert fastest(unit) > 0.01
    assert bench.plant.spine_drive == pytest.approx(0.12, abs=6e-4)
    unit.move_to(0.02, 0.05)
    assert fastest(unit) < -0.01
    assert bench.plant.spine_drive == pytest.approx(0.02, abs=6e-4)


@pytest.mark.parametrize(("asked", "clipped"), [(0.9, 0.06), (-0.2, 0.0)])
def test_a_goal_is_clipped_and_the_clipped_goal_returned(bench: Bench, asked: float, clipped: float) -> None:
    unit = bench.homed(max_length=0.06)
    assert unit.move_to(asked, 0.05) == pytest.approx(clipped, abs=1e-4)


def test_speed_is_clipped_to_its_limit(bench: Bench) -> None:
    unit = bench.homed(max_speed=0.02)
    unit.move_to(0.05, 5.0)
    assert 0.01 < fastest(unit) < 0.025


@pytest.mark.parametrize(("length", "speed"), [(float("nan"), 0.01), (0.1, 0.0), (0.1, -0.1), (0.1, float("nan"))])
def test_what_is_no_motion_is_refused_before_anything_is_sent(bench: Bench, length: float, speed: float) -> None:
    fake = bench.fake()
    unit = bench.homed(fake)
    before = len(fake.requests)
    with pytest.raises(LimitExceeded, match="not a valid motion"):
        unit.move_to(length, speed)
    assert len(fake.requests) == before


def test_stop_holds_where_it_is(bench: Bench) -> None:
    unit = bench.homed()
    unit.move_to(0.3, 0.02)
    watch(unit, lambda s: s.length > 0.02)
    unit.stop()
    arrive(unit)
    held = unit.read().length
    bench.clock.sleep(1.0)
    assert held < 0.2
    assert unit.read().length == pytest.approx(held, abs=1e-3)


def test_stop_ends_a_reference_run_without_result(bench: Bench) -> None:
    bench.may_move()
    unit = bench.unit()
    unit.open()
    unit.home()
    unit.stop()
    bench.clock.sleep(3.0)
    sample = unit.read()
    assert not sample.homed
    assert not sample.moving


def test_a_jammed_spine_is_reported_as_a_stall_until_the_next_command(bench: Bench) -> None:
    gentle = {"current_limit": 0.8} if bench.kind == "dynamixel" else {}  # with more it overloads when read too late
    unit = bench.homed(bench.fake(), **gentle)
    unit.move_to(0.3, 0.02)
    watch(unit, lambda s: s.length > 0.02)
    bench.plant.spine_blocked = True
    message = fault_of(unit)
    assert "un-jam" in message.lower()
    with pytest.raises(DeviceFault):
        unit.read()
    bench.plant.spine_blocked = False
    unit.move_to(0.1, 0.05)
    assert arrive(unit).length == pytest.approx(0.1, abs=6e-4)
    assert bench.plant.spine_drive == pytest.approx(0.1, abs=1e-3)


def test_a_unit_that_restarted_has_lost_its_zero(bench: Bench) -> None:
    fake = bench.fake()
    unit = bench.homed(fake)
    fake.faults.extra["restart"] = True
    assert "restarted" in fault_of(unit)
    with pytest.raises(NotReady):
        unit.move_to(0.1, 0.02)
    unit.home()
    assert watch(unit, lambda s: s.homed).length == pytest.approx(0.0, abs=1e-4)


def test_close_stops_the_motion_and_may_be_called_twice(bench: Bench) -> None:
    fake = bench.fake()
    unit = bench.homed(fake)
    unit.move_to(0.3, 0.02)
    watch(unit, lambda s: s.length > 0.01)
    unit.close()
    unit.close()

    def stands() -> bool:
        before = bench.plant.spine_drive
        bench.clock.sleep(2.0)
        return abs(bench.plant.spine_drive - before) < 1e-3

    assert any(stands() for _ in range(20))
    assert bench.plant.spine_drive < 0.25


def test_close_without_open_and_after_a_lost_line_never_raises(bench: Bench) -> None:
    fake = bench.fake()
    unit = bench.unit(fake)
    unit.close()
    unit.open()
    fake.stop()
    unit.close()


def test_a_lost_line_is_reported_as_unreachable(bench: Bench) -> None:
    fake = bench.fake()
    unit = bench.unit(fake)
    unit.open()
    fake.stop()
    with pytest.raises((Unreachable, NoReply)):
        unit.read()


def test_another_device_on_the_port_is_reported_quickly(bench: Bench) -> None:
    other = NumatoFake(bench.plant, bench.clock)
    other.start()
    bench.lines.append(other)
    driver, config, _ = DRIVERS[bench.kind]
    unit = driver("spine", config(port=other.port, metres_per_turn=0.1), bench.clock)
    start = timing.now()
    with pytest.raises(InstrumentError, match="spine"):
        unit.open()
    assert timing.now() - start < 20.0
    unit.close()


def test_a_silent_unit_gives_no_reply_within_the_time_out(bench: Bench) -> None:
    fake = bench.fake()
    unit = bench.unit(fake, timeout=0.3)
    unit.open()
    fake.faults.silent = True
    start = timing.now()
    with pytest.raises(NoReply):
        unit.read()
    assert timing.now() - start < 20.0


@pytest.mark.parametrize("fault", ["corrupt", "truncate"])
def test_damaged_answers_are_never_taken_for_readings(bench: Bench, fault: str) -> None:
    fake = bench.fake()
    unit = bench.unit(fake, timeout=0.5)
    unit.open()
    setattr(fake.faults, fault, True)
    with pytest.raises(InstrumentError):
        unit.read()
    setattr(fake.faults, fault, False)
    assert not unit.read().homed


def test_answers_in_two_pieces_are_put_together(bench: Bench) -> None:
    fake = bench.fake()
    unit = bench.unit(fake)
    unit.open()
    fake.faults.split = True
    assert not unit.read().homed
