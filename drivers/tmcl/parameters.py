"""Numbers of a TMCM-1260's parameters, as far as the length unit uses them."""

from __future__ import annotations

from enum import IntEnum


class Parameter(IntEnum):
    """Parameters of the motor."""

    TARGET_POSITION = 0
    ACTUAL_POSITION = 1
    ACTUAL_SPEED = 3
    MAX_SPEED = 4
    ACCELERATION = 5
    MAX_CURRENT = 6
    STANDBY_CURRENT = 7
    RIGHT_SWITCH_OFF = 12
    LEFT_SWITCH_OFF = 13
    DECELERATION = 17
    SOFT_STOP = 26
    MICROSTEPS = 140
    SEARCH_MODE = 193
    SEARCH_SPEED = 194
    SWITCH_SPEED = 195
    FULLSTEPS = 202
    FREEWHEELING = 204
    ERROR_FLAGS = 207
    DRIVER_STATUS = 208
    ENCODER = 209
    MAX_DEVIATION = 212
    STEP_DIRECTION = 254
    UNITS = 255


class Global(IntEnum):
    """Parameters of the module."""

    HEARTBEAT = 68
    """ms of silence on the serial line after which the motor stops; 0 = never."""
    HOST_ADDRESS = 76
    AUTO_START = 77
    SECONDARY_ADDRESS = 87
    PROGRAM = 128
    TICK_TIMER = 132
    """ms since the module started, or since it was set."""


class SearchMode(IntEnum):
    """Which limit switch a reference search looks for."""

    LEFT_SWITCH = 1
    RIGHT_SWITCH = 65
