"""What changes at the arm's pendant or in the spine's servo between two trials is named before the first motion."""

from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from house import House, until

from drivers.errors import InstrumentError, NotReady, WrongDevice
from lab.rig.assembly import Rig
from sim_fakes.dynamixel import DynamixelFake

SHUTDOWN, SHUTDOWN_AS_DELIVERED = 63, 52


@pytest.fixture
def rig(house: House) -> Iterator[Rig]:
    arm = yaml.safe_load(house.rig.read_text())["instruments"]["arm"]
    house.change(without=("mocap",), instruments={"arm": {**arm, "watchdog_frequency": 2.0, "timeout": 3.0}})
    with house.opened() as opened:
        yield opened


def move_the_arm(rig: Rig) -> None:
    pose = list(rig.streams["arm_state"].latest().tcp_pose)
    rig.actuators.arm.move_to((*pose[:2], pose[2] + 0.005, *pose[3:]), 0.05, 0.3)
    assert until(lambda: not rig.actuators.arm.moving())


@pytest.mark.parametrize(
    ("change", "back", "error", "message"),
    [
        ({"payload": 2.5}, {"payload": 0.8}, WrongDevice, "payload is now 2.500 kg, needed as at open 0.800 kg"),
        ({"slider": 0.0}, {"slider": 1.0}, NotReady, "speed slider is at 0%"),
    ],
    ids=["payload", "slider"],
)
def test_the_arm_does_not_move_after_the_pendant_was_changed(
    house: House, rig: Rig, change: dict[str, Any], back: dict[str, Any], error: type[InstrumentError], message: str
) -> None:
    ur = house.fakes.ur
    assert ur is not None
    move_the_arm(rig)
    rig.actuators.pressure.vent()
    ur.backdoor("set", **change)
    ur.backdoor("forget")
    try:
        with pytest.raises(error, match=message):
            move_the_arm(rig)
        assert not any(command["name"] == "movel" for command in ur.backdoor()["commands"])
    finally:
        ur.backdoor("set", **back)


def test_the_spine_does_not_move_after_its_servo_was_changed(house: House, rig: Rig) -> None:
    servo = house.fakes.lines["spine"]
    assert isinstance(servo, DynamixelFake)
    rig.actuators.spine.home()
    rig.actuators.pressure.vent()
    servo.motor.put(SHUTDOWN, 0)
    try:
        with pytest.raises(WrongDevice, match=r"shutdown \(register 63\) is 0, needed 52"):
            rig.actuators.spine.home()
        assert until(lambda: rig.vital.landed is not None)
    finally:
        servo.motor.put(SHUTDOWN, SHUTDOWN_AS_DELIVERED)
