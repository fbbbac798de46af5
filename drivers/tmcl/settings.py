"""The settings of a TMCM-1260 on which the length unit's promises rest, and the values that they need.

A module can keep all of them without power, and a program stored in it can change them. Those that this driver may
decide are written when they differ, at `open`; the others are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..errors import DeviceFault, WrongDevice
from .bus import Axis
from .parameters import Global, Parameter

STOPS_WITHIN = 1.0
"""s that the motor may take from its maximum speed to a standstill."""


@dataclass(frozen=True)
class Needs:
    """What the configuration asks of the module's settings: top speed and resolution in microsteps, heartbeat in ms."""

    speed: int
    microsteps_per_turn: int
    left_switch: bool
    """Whether the retracted end's switch is the left one."""
    heartbeat: int | None
    """None: the module's own setting holds."""


@dataclass(frozen=True)
class Setting:
    """One parameter of the axis, or of the module, the value that it needs given the one found, and why."""

    name: str
    number: int
    needed: Callable[[int], int]
    why: str
    of_module: bool = False
    written: bool = True
    """False: it is refused instead."""

    @property
    def where(self) -> str:
        return f"{self.name} ({'global' if self.of_module else 'axis'} parameter {self.number})"


def settings(needs: Needs) -> list[Setting]:
    """All of them but the resolution, which two parameters make."""
    switch = ("left", Parameter.LEFT_SWITCH_OFF) if needs.left_switch else ("right", Parameter.RIGHT_SWITCH_OFF)
    least = round(needs.speed / STOPS_WITHIN)
    slow = f"a stop would take longer than {STOPS_WITHIN:g} s"
    every = [
        Setting(
            "program stored in the module",
            Global.PROGRAM,
            lambda found: 0,
            "it would move the motor",
            of_module=True,
        ),
        Setting(
            "auto start",
            Global.AUTO_START,
            lambda found: 0,
            "a stored program would move the motor",
            of_module=True,
        ),
        Setting(
            "secondary address",
            Global.SECONDARY_ADDRESS,
            lambda found: 0,
            "the module would obey commands meant for another one",
            of_module=True,
        ),
        Setting(f"{switch[0]} limit switch disable", switch[1], lambda found: 0, "the motor would run past the switch"),
        Setting("soft stop", Parameter.SOFT_STOP, lambda found: 0, "the motor would run past the switch"),
        Setting("freewheeling mode", Parameter.FREEWHEELING, lambda found: 0, "the motor would not hold"),
        Setting("step/direction mode", Parameter.STEP_DIRECTION, lambda found: 0, "other signals would move the motor"),
        Setting("unit mode", Parameter.UNITS, lambda found: 1, "speeds would not be microsteps per second"),
        Setting(
            "maximum current",
            Parameter.MAX_CURRENT,
            lambda found: max(1, found),
            "the motor would not turn",
            written=False,
        ),
        Setting(
            "standby current",
            Parameter.STANDBY_CURRENT,
            lambda found: max(1, found),
            "the motor would not hold",
            written=False,
        ),
        Setting("maximum acceleration", Parameter.ACCELERATION, lambda found: max(least, found), slow, written=False),
        Setting("maximum deceleration", Parameter.DECELERATION, lambda found: max(least, found), slow, written=False),
    ]
    if needs.heartbeat is not None:
        beat = needs.heartbeat
        every.append(
            Setting(
                "heartbeat",
                Global.HEARTBEAT,
                lambda found: beat,
                "the motor would not stop without the host",
                of_module=True,
            )
        )
    return every


def apply(axis: Axis, needs: Needs) -> None:
    """Write what differs and read it back. Raises `WrongDevice` for what is refused, `DeviceFault` for what is not taken."""
    _check_resolution(axis, needs)
    for setting in settings(needs):
        found = _read(axis, setting)
        if found == (needed := setting.needed(found)):
            continue
        if not setting.written:
            raise _refused(axis, setting, found, needed)
        if setting.number == Global.PROGRAM:
            axis.stop_program()
        elif setting.of_module:
            axis.put_global(setting.number, needed)
        else:
            axis.put(setting.number, needed)
        if (held := _read(axis, setting)) != needed:
            raise DeviceFault(
                axis.name,
                f"{setting.where} was set to {needed}, but the module holds {held}; check that no other host writes to it",
            )


def confirm(axis: Axis, needs: Needs) -> None:
    """Raise `WrongDevice` when a setting has changed since `apply`."""
    _check_resolution(axis, needs)
    for setting in settings(needs):
        found = _read(axis, setting)
        if found != (needed := setting.needed(found)):
            raise _refused(axis, setting, found, needed)


def _read(axis: Axis, setting: Setting) -> int:
    return axis.get_global(setting.number) if setting.of_module else axis.get(setting.number)


def _check_resolution(axis: Axis, needs: Needs) -> None:
    full, micro = axis.get(Parameter.FULLSTEPS), axis.get(Parameter.MICROSTEPS)
    if full << micro != needs.microsteps_per_turn:
        raise WrongDevice(
            axis.name,
            f"resolution (axis parameters {Parameter.FULLSTEPS} and {Parameter.MICROSTEPS}) is {full} x 2^{micro} = "
            f"{full << micro} microsteps per turn, needed {needs.microsteps_per_turn}: lengths would be wrong; "
            "set it with the maker's TMCL-IDE, or correct microsteps_per_turn in rig.yaml",
        )


def _refused(axis: Axis, setting: Setting, found: int, needed: int) -> WrongDevice:
    remedy = "open the unit again" if setting.written else "set it with the maker's TMCL-IDE"
    return WrongDevice(
        axis.name,
        f"{setting.where} is {found}, needed {needed}: {setting.why}; {remedy}, and keep other hosts off the module",
    )
