"""The settings of a TMCM-1260 on which the length unit's promises rest, and the values that they need.

A module can keep all of them without power, and a program stored in it can change them. They are applied at `open`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..errors import WrongDevice
from ..kept_settings import Kept, Setting
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


def apply(axis: Axis, needs: Needs) -> None:
    """Write what differs and read it back. Raises `WrongDevice` for what is refused, `DeviceFault` for what is not taken."""
    _check_resolution(axis, needs)
    _settings(axis, needs).apply()


def confirm(axis: Axis, needs: Needs) -> None:
    """Raise `WrongDevice` when a setting has changed since `apply`."""
    _check_resolution(axis, needs)
    _settings(axis, needs).confirm()


def _settings(axis: Axis, needs: Needs) -> Kept:
    """All of them but the resolution, which two parameters make."""

    def of_module(name: str, number: Global, needed: int, why: str) -> Setting:
        def write(value: int) -> None:
            axis.put_global(number, value)

        return Setting(f"{name} (global parameter {number})", lambda: axis.get_global(number), needed, why, write)

    def of_axis(name: str, number: Parameter, needed: int | Callable[[int], int], why: str, written: bool = True) -> Setting:
        def write(value: int) -> None:
            axis.put(number, value)

        place = f"{name} (axis parameter {number})"
        return Setting(place, lambda: axis.get(number), needed, why, write if written else None)

    switch = ("left", Parameter.LEFT_SWITCH_OFF) if needs.left_switch else ("right", Parameter.RIGHT_SWITCH_OFF)
    least = round(needs.speed / STOPS_WITHIN)
    slow = f"a stop would take longer than {STOPS_WITHIN:g} s"
    program = of_module("program stored in the module", Global.PROGRAM, 0, "it would move the motor")
    every = [
        replace(program, write=lambda _: axis.stop_program()),
        of_module("auto start", Global.AUTO_START, 0, "a stored program would move the motor"),
        of_module("secondary address", Global.SECONDARY_ADDRESS, 0,
                  "the module would obey commands meant for another one"),
        of_axis(f"{switch[0]} limit switch disable", switch[1], 0, "the motor would run past the switch"),
        of_axis("soft stop", Parameter.SOFT_STOP, 0, "the motor would run past the switch"),
        of_axis("freewheeling mode", Parameter.FREEWHEELING, 0, "the motor would not hold"),
        of_axis("step/direction mode", Parameter.STEP_DIRECTION, 0, "other signals would move the motor"),
        of_axis("unit mode", Parameter.UNITS, 1, "speeds would not be microsteps per second"),
        of_axis("maximum current", Parameter.MAX_CURRENT, lambda found: max(1, found), "the motor would not turn", False),
        of_axis("standby current", Parameter.STANDBY_CURRENT, lambda found: max(1, found), "the motor would not hold", False),
        of_axis("maximum acceleration", Parameter.ACCELERATION, lambda found: max(least, found), slow, False),
        of_axis("maximum deceleration", Parameter.DECELERATION, lambda found: max(least, found), slow, False),
    ]  # fmt: skip
    if needs.heartbeat is not None:
        why = "the motor would not stop without the host"
        every.append(of_module("heartbeat", Global.HEARTBEAT, needs.heartbeat, why))
    return Kept(axis.name, "module", "TMCL-IDE", every)


def _check_resolution(axis: Axis, needs: Needs) -> None:
    full, micro = axis.get(Parameter.FULLSTEPS), axis.get(Parameter.MICROSTEPS)
    if full << micro != needs.microsteps_per_turn:
        raise WrongDevice(
            axis.name,
            f"resolution (axis parameters {Parameter.FULLSTEPS} and {Parameter.MICROSTEPS}) is {full} x 2^{micro} = "
            f"{full << micro} microsteps per turn, needed {needs.microsteps_per_turn}: lengths would be wrong; "
            "set it with the maker's TMCL-IDE, or correct microsteps_per_turn in rig.yaml",
        )
