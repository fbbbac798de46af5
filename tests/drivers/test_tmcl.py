"""What is particular to the Trinamic length unit, through pytrinamic against the fake module."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivers.errors import BadReply, DeviceFault, NotReady, Unreachable, WrongDevice
from drivers.interfaces import SpineSample
from drivers.tmcl.driver import Config, TmclSpine
from sim_fakes.clock import SimClock
from sim_fakes.plant import Plant
from sim_fakes.tmcl import MAX_DEVIATION, TmclFake

Make = Callable[..., tuple[TmclSpine, TmclFake]]


@pytest.fixture
def plant() -> Plant:
    return Plant()


@pytest.fixture
def make(plant: Plant) -> Iterator[Make]:
    made: list[tuple[TmclSpine, TmclFake]] = []

    def make(fake: dict[str, Any] | None = None, **changes: Any) -> tuple[TmclSpine, TmclFake]:
        clock = SimClock(20.0)
        module = TmclFake(plant, clock, **(fake or {}))
        module.start()
        spine = TmclSpine(
            "spine", Config(**{"port": module.port, "metres_per_turn": 0.1, "timeout": 1.0} | changes), clock
        )
        made.append((spine, module))
        return made[-1]

    yield make
    for spine, module in made:
        spine.close()
        module.stop()


def watch(spine: TmclSpine, until: Callable[[SpineSample], bool]) -> SpineSample:
    deadline = time.monotonic() + 20
    while not until(sample := spine.read()):
        assert time.monotonic() < deadline, f"still {sample}"
        time.sleep(0.01)
    return sample


def stands(module: TmclFake) -> None:
    """Wait until the drum, once it turns, stands again; nothing is sent meanwhile."""
    deadline = time.monotonic() + 60
    for turning in (True, False):
        while (module.drum.speed != 0) != turning:
            assert time.monotonic() < deadline, f"never so: turning {turning}"
            time.sleep(0.001)


def homed(spine: TmclSpine) -> None:
    spine.open()
    spine.home()
    watch(spine, lambda s: s.homed)


def test_open_names_the_module_and_switches_the_deviation_stop_on(make: Make) -> None:
    spine, module = make(max_deviation=0.002)
    identity = spine.open()
    assert (identity.model, identity.firmware) == ("TMCM-1260", "1.16")
    assert module.drum.parameters[MAX_DEVIATION] == 1024
    assert module.drum.heartbeat == 2.0


def test_another_module_is_the_wrong_device(make: Make) -> None:
    spine, _ = make({"module": 1140})
    with pytest.raises(WrongDevice, match="TMCM-1140"):
        spine.open()


def test_an_address_that_nobody_has_is_unreachable(make: Make) -> None:
    spine, _ = make(address=9, timeout=0.3)
    with pytest.raises(Unreachable, match="module 9"):
        spine.open()


@pytest.mark.parametrize("fault", ["wrong_address", "wrong_command"])
def test_an_answer_to_somebody_elses_question_is_not_taken(make: Make, fault: str) -> None:
    spine, module = make()
    spine.open()
    module.faults.extra[fault] = True
    with pytest.raises(BadReply, match="answered command"):
        spine.read()


def test_a_refusal_tells_the_modules_reason(make: Make) -> None:
    spine, module = make()
    homed(spine)
    module.faults.extra["nak"] = 4
    with pytest.raises(BadReply, match="Invalid Value"):
        spine.move_to(0.1, 0.02)


def test_after_damaged_answers_both_ends_agree_again_on_frames(make: Make) -> None:
    spine, module = make()
    homed(spine)
    module.faults.garbage = b"\x01\x02"
    with pytest.raises(BadReply):
        spine.read()
    module.faults.garbage = b""
    assert spine.read().length == 0.0


def test_a_broken_coupling_is_noticed_by_the_encoder(make: Make) -> None:
    spine, module = make()
    homed(spine)
    module.faults.extra["stuck"] = True
    spine.move_to(0.1, 0.05)
    with pytest.raises(DeviceFault, match="did not follow"):
        watch(spine, lambda s: not s.moving)


def test_a_silent_host_lets_the_module_stop_and_is_reported(make: Make, plant: Plant) -> None:
    spine, module = make(heartbeat=0.3)
    homed(spine)
    spine.move_to(0.35, 0.005)
    stands(module)
    assert plant.spine_drive < 0.3
    with pytest.raises(DeviceFault, match="heartbeat"):
        watch(spine, lambda s: not s.moving)
    spine.stop()
    spine.move_to(0.1, 0.05)
    assert watch(spine, lambda s: not s.moving).length == pytest.approx(0.1, abs=6e-4)


def test_a_search_that_was_cut_short_is_not_taken_for_homed(make: Make) -> None:
    spine, module = make({"start_length": 0.3}, heartbeat=0.1)
    spine.open()
    spine.home()
    stands(module)
    with pytest.raises(DeviceFault, match="without reaching the switch"):
        watch(spine, lambda s: s.homed)
    with pytest.raises(NotReady):
        spine.move_to(0.1, 0.02)


def test_a_switch_that_never_closes_ends_the_homing(make: Make) -> None:
    spine, module = make({"start_length": 0.05}, max_length=0.1, max_deviation=0.05, homing_speed=0.05)
    module.faults.extra["no_switch"] = True
    spine.open()
    spine.home()
    with pytest.raises(DeviceFault, match="home"):
        watch(spine, lambda s: s.homed)


def test_a_damaged_motor_driver_costs_the_zero(make: Make) -> None:
    spine, module = make()
    homed(spine)
    module.faults.extra["driver"] = 1 << 1
    with pytest.raises(DeviceFault, match="overheated"):
        spine.read()
    with pytest.raises(NotReady):
        spine.move_to(0.1, 0.02)
