"""The settings of a Dynamixel X servo on which the length unit's promises rest, and the values that they need.

All of them outlast a program and most outlast a power cut. Those that this driver may decide are written when they
differ, at `open` and after a restart; the others are refused. Torque goes off before the servo's EEPROM is written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..errors import BadReply, DeviceFault, WrongDevice
from .bus import ANSWER_ALL, STATUS_RETURN_LEVEL, Register, Servo
from .table import (
    CURRENT_BASED_POSITION,
    DRIVE_MODE,
    GOAL_PWM,
    HOMING_OFFSET,
    OPERATING_MODE,
    PLAIN_DRIVE,
    POSITION_P_GAIN,
    PROFILE_ACCELERATION,
    PWM_LIMIT,
    SECONDARY_ID,
    SHUTDOWN,
    STARTUP,
    TORQUE,
    Address,
)

FULL_PWM = 885
"""The whole supply voltage."""
SHUTDOWN_CAUSES = 1 << 2 | 1 << 4 | 1 << 5
"""Overheating, electrical shock, overload."""
NO_SECONDARY_ID, FIRST_INVALID_ID = 255, 253


@dataclass(frozen=True)
class Setting:
    """One register, the value that it needs given the one that was found, and why."""

    name: str
    register: Register
    needed: Callable[[int], int]
    why: str
    written: bool = True
    """False: it is refused instead."""
    may_lack: bool = False
    """True: older firmware has no such register."""


SETTINGS = (
    Setting("status return level", STATUS_RETURN_LEVEL, lambda found: ANSWER_ALL, "commands would not be confirmed"),
    Setting(
        "secondary ID",
        SECONDARY_ID,
        lambda found: found if found >= FIRST_INVALID_ID else NO_SECONDARY_ID,
        "the servo would obey commands meant for other servos",
    ),
    Setting(
        "homing offset",
        HOMING_OFFSET,
        lambda found: 0,
        "with older firmware a bus watchdog that trips would move the cord by it",
    ),
    Setting("drive mode", DRIVE_MODE, lambda found: PLAIN_DRIVE, "directions, speeds and torque would differ"),
    Setting(
        "operating mode",
        OPERATING_MODE,
        lambda found: CURRENT_BASED_POSITION,
        "positions or the current would not hold",
    ),
    Setting(
        "shutdown", SHUTDOWN, lambda found: found | SHUTDOWN_CAUSES, "overheating or overload would not end the torque"
    ),
    Setting(
        "startup configuration",
        STARTUP,
        lambda found: 0,
        "the servo would start with torque, or with settings of an earlier program",
        may_lack=True,
    ),
    Setting("profile acceleration", PROFILE_ACCELERATION, lambda found: 0, "a stop would take longer"),
    Setting(
        "PWM limit",
        PWM_LIMIT,
        lambda found: FULL_PWM,
        "the motor may not reach current_limit, and a stall would not show",
        written=False,
    ),
    Setting("goal PWM", GOAL_PWM, lambda found: FULL_PWM, "the motor may not reach current_limit"),
    Setting("position P gain", POSITION_P_GAIN, lambda found: max(1, found), "the motor would not hold", written=False),
)


def apply(servo: Servo) -> None:
    """Write what differs and read it back. Raises `WrongDevice` for what is refused, `DeviceFault` for what is not taken."""
    for setting, found, needed in _differing(servo):
        if not setting.written:
            raise _refused(servo, setting, found, needed)
        if setting.register.address < Address.EEPROM_END:
            servo.write(TORQUE, 0)
        servo.write(setting.register, needed)
        if (held := servo.read(setting.register)) != needed:
            raise DeviceFault(
                servo.name,
                f"{setting.name} (register {setting.register.address}) was set to {needed}, but the servo holds {held}; "
                "check that no other host writes to it",
            )


def confirm(servo: Servo) -> None:
    """Raise `WrongDevice` when a setting has changed since `apply`."""
    for setting, found, needed in _differing(servo):
        raise _refused(servo, setting, found, needed)


def _differing(servo: Servo) -> list[tuple[Setting, int, int]]:
    """The settings that differ, each with the value found and the value needed."""
    differing = []
    for setting in SETTINGS:
        try:
            found = servo.read(setting.register)
        except BadReply:
            if not setting.may_lack:
                raise
            continue
        if found != (needed := setting.needed(found)):
            differing.append((setting, found, needed))
    return differing


def _refused(servo: Servo, setting: Setting, found: int, needed: int) -> WrongDevice:
    remedy = "open the unit again" if setting.written else "set it with the maker's DYNAMIXEL Wizard"
    return WrongDevice(
        servo.name,
        f"{setting.name} (register {setting.register.address}) is {found}, needed {needed}: {setting.why}; {remedy}, and "
        "keep other hosts off the servo",
    )
