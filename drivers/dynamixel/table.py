"""The part of the Dynamixel X series' control table (ROBOTIS) that the length unit uses, and its units."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from enum import IntEnum

from ..errors import BadReply
from ..kept_settings import KeptSettings, Setting
from .bus import ANSWER_ALL, STATUS_RETURN_LEVEL, Register, Servo


class Address(IntEnum):
    """Where several registers are read or written together, and where those end that are kept without power."""

    EEPROM_END = 64
    PROFILE_AND_GOAL = 112
    STATE = 98


FIRMWARE = Register(6, 1)
DRIVE_MODE = Register(10, 1)
OPERATING_MODE = Register(11, 1)
SECONDARY_ID = Register(12, 1)
HOMING_OFFSET = Register(20, 4, signed=True)
PWM_LIMIT = Register(36, 2)
CURRENT_LIMIT = Register(38, 2)
STARTUP = Register(60, 1)
SHUTDOWN = Register(63, 1)
TORQUE = Register(64, 1)
HARDWARE_ERROR = Register(70, 1)
POSITION_P_GAIN = Register(84, 2)
WATCHDOG = Register(98, 1)
GOAL_PWM = Register(100, 2, signed=True)
GOAL_CURRENT = Register(102, 2, signed=True)
PROFILE_ACCELERATION = Register(108, 4)
PROFILE_AND_GOAL = struct.Struct("<Ii")
"""Profile velocity and goal position: both are written and read back with one instruction."""
PRESENT_POSITION = Register(132, 4, signed=True)
STATE = struct.Struct("<B21xHBBhhii")
"""Bus watchdog, what follows up to the realtime tick, that, moving, moving status, PWM, current, velocity, position: one
reading of all is quicker than two of what is needed."""

CURRENT_BASED_POSITION = 5
PLAIN_DRIVE = 0
"""Normal direction, velocity-based profile."""
COUNTS_PER_TURN = 4096
RPM = 0.229
"""Unit of velocity registers, revolutions per minute."""
WATCHDOG_UNIT = 0.02
"""s"""
WATCHDOG_TRIPPED = 255
MODELS = {
    1000: ("XH430-W350", 2.69e-3), 1010: ("XH430-W210", 2.69e-3), 1020: ("XM430-W350", 2.69e-3),
    1030: ("XM430-W210", 2.69e-3), 1100: ("XH540-W270", 2.69e-3), 1110: ("XH540-W150", 2.69e-3),
    1120: ("XM540-W270", 2.69e-3), 1130: ("XM540-W150", 2.69e-3), 1190: ("XL330-M077", 1e-3),
    1200: ("XL330-M288", 1e-3), 1210: ("XC330-T181", 1e-3), 1220: ("XC330-T288", 1e-3),
    1230: ("XC330-M181", 1e-3), 1240: ("XC330-M288", 1e-3),
}  # fmt: skip
"""Model number -> name and unit of current (A): the X servos with a current-based position mode."""
HARDWARE_ERRORS = {0: "supply voltage", 1: "hall sensor", 2: "overheated", 3: "encoder", 4: "electrical shock", 5: "overload"}


def hardware_errors(bits: int) -> str:
    """The hardware error byte in words."""
    return ", ".join(text for bit, text in HARDWARE_ERRORS.items() if bits >> bit & 1) or f"bits {bits:#04x}"


FULL_PWM = 885
"""The whole supply voltage."""
SHUTDOWN_CAUSES = 1 << 2 | 1 << 4 | 1 << 5
"""Overheating, electrical shock, overload."""
NO_SECONDARY_ID, FIRST_INVALID_ID = 255, 253


def settings(servo: Servo) -> KeptSettings:
    """The settings on which the length unit relies, for `open` and after a restart; torque goes off before EEPROM is written."""

    def one(name: str, register: Register, needed: int | Callable[[int], int], why: str, written: bool = True) -> Setting:
        """One setting in a register; `written`: the driver may set it right, else another value is refused."""

        def write(value: int) -> None:
            if register.address < Address.EEPROM_END:
                servo.write(TORQUE, 0)
            servo.write(register, value)

        place = f"{name} (register {register.address})"
        return Setting(place, lambda: servo.read(register), needed, why, write if written else None)

    def startup() -> int | None:
        try:
            return servo.read(STARTUP)
        except BadReply:  # older firmware has no such register
            return None

    every = [
        one("status return level", STATUS_RETURN_LEVEL, ANSWER_ALL, "commands would not be confirmed"),
        one("secondary ID", SECONDARY_ID, lambda value: value if value >= FIRST_INVALID_ID else NO_SECONDARY_ID,
            "the servo would obey commands meant for other servos"),
        one("homing offset", HOMING_OFFSET, 0,
            "with older firmware a bus watchdog that trips would move the cord by it"),
        one("drive mode", DRIVE_MODE, PLAIN_DRIVE, "directions, speeds and torque would differ"),
        one("operating mode", OPERATING_MODE, CURRENT_BASED_POSITION,
            "positions or the current would not hold"),
        one("shutdown", SHUTDOWN, lambda value: value | SHUTDOWN_CAUSES,
            "overheating or overload would not end the torque"),
        replace(one("startup configuration", STARTUP, 0,
                    "the servo would start with torque, or with settings of an earlier program"), read=startup),
        one("profile acceleration", PROFILE_ACCELERATION, 0, "a stop would take longer"),
        one("PWM limit", PWM_LIMIT, FULL_PWM,
            "the motor may not reach current_limit, and a stall would not show", written=False),
        one("goal PWM", GOAL_PWM, FULL_PWM, "the motor may not reach current_limit"),
        one("position P gain", POSITION_P_GAIN, lambda value: max(1, value), "the motor would not hold",
            written=False),
    ]  # fmt: skip
    return KeptSettings(servo.name, "servo", "DYNAMIXEL Wizard", every)
