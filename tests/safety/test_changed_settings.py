"""A setting that changes at a panel, at the arm's pendant or in the spine's servo: the rig lands, or does not move."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import yaml
from house import House, until

from drivers.errors import InstrumentError, NoReply, NotReady, WrongDevice
from drivers.interfaces import PressureSample
from lab.guard.limit_monitor import DriverSettings
from lab.rig.assembly import Rig
from sim_fakes.alicat import AlicatFake
from sim_fakes.dynamixel import DynamixelFake
from tests.simulated.bench import raises

HELD = 60e3


@pytest.fixture
def rig(rig: Rig, house: House) -> Iterator[Rig]:
    """Its units of measure are kilopascal again afterwards."""
    yield rig
    for unit in units(house).device.values():
        unit.unit_code = 4


def units(house: House) -> AlicatFake:
    line = house.fakes.lines["pressure"]
    assert isinstance(line, AlicatFake)
    return line


def turn(house: House, letter: str, unit: str) -> None:
    """A person unlocks the panel (all four buttons for three seconds) and chooses another unit of measure."""
    units(house).panel(letter, "unlock")
    assert units(house).panel(letter, "unit", unit)


def inflate(rig: Rig, house: House, pressure: float = HELD) -> None:
    assert until(lambda: max(rig.actuators.pressure.set((pressure,) * 3)) > 0.99 * pressure)
    assert until(lambda: house.highest() > 0.9 * pressure)


@pytest.mark.parametrize(("letter", "unit"), [("A", "psi"), ("C", "bar")])
def test_a_unit_of_measure_changed_while_inflated_lands_the_rig(house: House, rig: Rig, letter: str, unit: str) -> None:
    inflate(rig, house)
    turn(house, letter, unit)
    assert until(lambda: rig.vital.landed is not None)
    assert f"unit {letter} shows" in rig.vital.landed.text and "register FPF 6" in rig.vital.landed.text
    assert rig.vital.landed.report is not None and rig.vital.landed.report.confirmed, str(rig.vital.landed.report)
    assert until(lambda: house.highest() < 5e3)
    raises(InstrumentError, f"unit {letter} shows", rig.actuators.pressure.set, (HELD,) * 3)


def test_one_changed_during_a_ramp_is_sent_at_most_one_more_pressure(house: House, rig: Rig) -> None:
    with pytest.raises(InstrumentError):
        for step in range(1, 400):
            rig.actuators.pressure.set((200.0 * step,) * 3)
            if step == 50:
                turn(house, "B", "psi")
                units(house).requests.clear()
    with units(house).lock:
        requests = list(units(house).requests)
    assert until(lambda: rig.vital.landed is not None and rig.vital.landed.report is not None)
    sent = [float(text[2:]) for text in requests if re.fullmatch(rb"BS ?[\d.]+", text)]
    assert requests and len([pressure for pressure in sent if pressure > 0]) <= 1, requests
    assert until(lambda: house.highest() < 5e3)


def test_one_changed_between_trials_is_refused_before_the_first_pressure(house: House, rig: Rig) -> None:
    inflate(rig, house)
    rig.actuators.pressure.vent()
    assert until(lambda: house.highest() < 1e3)
    turn(house, "A", "psi")
    raises(WrongDevice, "unit A shows PSI .*kPa is needed", rig.actuators.pressure.set, (HELD,) * 3)
    assert house.highest() < 1e3
    assert until(lambda: rig.vital.landed is not None)


# -- the guard's part, for every driver
class Driver:
    """One that counts how often it is asked, and answers what it is given."""

    def __init__(self, error: InstrumentError | None = None) -> None:
        self.error, self.asked = error, 0

    def confirm_settings(self) -> None:
        self.asked += 1
        if self.error is not None:
            raise self.error


def reading(*measured: float) -> PressureSample:
    return PressureSample(0.0, (0.0,) * len(measured), measured)


def test_settings_are_read_once_a_trial() -> None:
    driver = Driver()
    settings = DriverSettings({"pressure": driver, "spine": object()})
    for asked in (1, 2):
        settings.confirm("pressure", trial=True)
        settings.confirm("pressure", trial=True)
        settings.confirm("spine", trial=True)
        assert driver.asked == asked
        settings.vented()


def test_a_jump_while_venting_does_not_stand_for_the_next_trial() -> None:
    driver = Driver()
    settings = DriverSettings({"pressure": driver})
    settings.confirm("pressure", trial=True)
    settings.vented()
    assert not settings.may_have_changed("pressure", reading(60e3))
    assert settings.may_have_changed("pressure", reading(6e3))
    settings.confirm("pressure", trial=False)
    settings.confirm("pressure", trial=False)
    assert driver.asked == 2
    settings.confirm("pressure", trial=True)
    assert driver.asked == 3


@pytest.mark.parametrize("ratio", [6.894757, 1 / 6.894757, 10.0, 100.0, 1e3, 1e-3, 4.014, 0.0689, 2.036])
@pytest.mark.parametrize("pressure", [20e3, 150e3])
def test_a_jump_by_a_ratio_of_units_has_them_read_until_that_succeeds(ratio: float, pressure: float) -> None:
    driver = Driver(NoReply("pressure", "silent"))
    settings = DriverSettings({"pressure": driver})
    assert not settings.may_have_changed("pressure", reading(0.0, pressure))
    assert settings.may_have_changed("pressure", reading(0.0, pressure * ratio * 1.01))
    raises(NoReply, None, settings.confirm, "pressure", trial=True)
    assert settings.may_have_changed("pressure", reading(0.0, pressure * ratio * 1.01))
    driver.error = None
    settings.confirm("pressure", trial=True)
    assert not settings.may_have_changed("pressure", reading(0.0, pressure * ratio * 1.01))


@pytest.mark.parametrize("readings", [((100.0,), (650.0,)), ((20e3,), (22e3,)), ((0.0,), (0.0,)), ((float("nan"),), (1e3,))])
def test_noise_and_ramps_are_no_jump(readings: Any) -> None:
    settings = DriverSettings({"pressure": Driver()})
    found: Callable[[PressureSample], bool] = lambda sample: settings.may_have_changed("pressure", sample)  # noqa: E731
    assert not any(found(reading(*values)) for values in readings)


# -- what changes at the arm's pendant or in the spine's servo between two trials
SHUTDOWN, SHUTDOWN_AS_DELIVERED = 63, 52


@pytest.fixture
def with_arm(house: House) -> Iterator[Rig]:
    arm = yaml.safe_load(house.rig.read_text())["instruments"]["arm"]
    house.change(without=("mocap",), instruments={"arm": {**arm, "watchdog_frequency": 2.0, "timeout": 3.0}})
    with house.opened() as opened:
        yield opened


def move_the_arm(with_arm: Rig) -> None:
    pose = list(with_arm.streams["arm_state"].latest().tcp_pose)
    with_arm.actuators.arm.move_to((*pose[:2], pose[2] + 0.005, *pose[3:]), 0.05, 0.3)
    assert until(lambda: not with_arm.actuators.arm.moving())


@pytest.mark.parametrize(
    ("change", "back", "error", "message"),
    [
        ({"payload": 2.5}, {"payload": 0.8}, WrongDevice, "payload is now 2.500 kg, needed as at open 0.800 kg"),
        ({"slider": 0.0}, {"slider": 1.0}, NotReady, "speed slider is at 0%"),
    ],
    ids=["payload", "slider"],
)
def test_the_arm_does_not_move_after_the_pendant_was_changed(
    house: House, with_arm: Rig, change: dict[str, Any], back: dict[str, Any], error: type[InstrumentError], message: str
) -> None:
    ur = house.fakes.ur
    assert ur is not None
    move_the_arm(with_arm)
    with_arm.actuators.pressure.vent()
    ur.backdoor("set", **change)
    ur.backdoor("forget")
    try:
        raises(error, message, move_the_arm, with_arm)
        assert not any(command["name"] == "movel" for command in ur.backdoor()["commands"])
    finally:
        ur.backdoor("set", **back)


def test_the_spine_does_not_move_after_its_servo_was_changed(house: House, with_arm: Rig) -> None:
    servo = house.fakes.lines["spine"]
    assert isinstance(servo, DynamixelFake)
    with_arm.actuators.spine.home()
    with_arm.actuators.pressure.vent()
    servo.motor.put(SHUTDOWN, 0)
    try:
        raises(WrongDevice, r"shutdown \(register 63\) is 0, needed 52", with_arm.actuators.spine.home)
        assert until(lambda: with_arm.vital.landed is not None)
    finally:
        servo.motor.put(SHUTDOWN, SHUTDOWN_AS_DELIVERED)
