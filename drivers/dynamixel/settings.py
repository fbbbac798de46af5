"""The settings of a Dynamixel X servo on which the length unit's promises rest, and the values that they need.

They are applied at `open` and after a restart. Torque goes off before the servo's EEPROM is written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..errors import BadReply
from ..kept_settings import Kept, Setting
from . import table
from .bus import ANSWER_ALL, STATUS_RETURN_LEVEL, Register, Servo

FULL_PWM = 885
"""The whole supply voltage."""
SHUTDOWN_CAUSES = 1 << 2 | 1 << 4 | 1 << 5
"""Overheating, electrical shock, overload."""
NO_SECONDARY_ID, FIRST_INVALID_ID = 255, 253


def settings(servo: Servo) -> Kept:
    """All of them."""

    def one(name: str, register: Register, needed: int | Callable[[int], int], why: str, written: bool = True) -> Setting:
        def write(value: int) -> None:
            if register.address < table.Address.EEPROM_END:
                servo.write(table.TORQUE, 0)
            servo.write(register, value)

        place = f"{name} (register {register.address})"
        return Setting(place, lambda: servo.read(register), needed, why, write if written else None)

    def startup() -> int | None:
        try:
            return servo.read(table.STARTUP)
        except BadReply:  # older firmware has no such register
            return None

    every = [
        one("status return level", STATUS_RETURN_LEVEL, ANSWER_ALL, "commands would not be confirmed"),
        one("secondary ID", table.SECONDARY_ID, lambda found: found if found >= FIRST_INVALID_ID else NO_SECONDARY_ID,
            "the servo would obey commands meant for other servos"),
        one("homing offset", table.HOMING_OFFSET, 0,
            "with older firmware a bus watchdog that trips would move the cord by it"),
        one("drive mode", table.DRIVE_MODE, table.PLAIN_DRIVE, "directions, speeds and torque would differ"),
        one("operating mode", table.OPERATING_MODE, table.CURRENT_BASED_POSITION,
            "positions or the current would not hold"),
        one("shutdown", table.SHUTDOWN, lambda found: found | SHUTDOWN_CAUSES,
            "overheating or overload would not end the torque"),
        replace(one("startup configuration", table.STARTUP, 0,
                    "the servo would start with torque, or with settings of an earlier program"), read=startup),
        one("profile acceleration", table.PROFILE_ACCELERATION, 0, "a stop would take longer"),
        one("PWM limit", table.PWM_LIMIT, FULL_PWM,
            "the motor may not reach current_limit, and a stall would not show", written=False),
        one("goal PWM", table.GOAL_PWM, FULL_PWM, "the motor may not reach current_limit"),
        one("position P gain", table.POSITION_P_GAIN, lambda found: max(1, found), "the motor would not hold",
            written=False),
    ]  # fmt: skip
    return Kept(servo.name, "servo", "DYNAMIXEL Wizard", every)
