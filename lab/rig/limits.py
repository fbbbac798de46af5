"""What a plan asks for against everything that limits it, before anything moves: robot, instruments, and the rig as a whole."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.chambers import ChamberMap
from model.body import body_of
from model.robot import Robot
from model.section import annulus_second_moment, body_area, body_second_moment
from protocols.experiment import Ask, Plan, Push
from recordings.states.demands import Bodies

from ..files.config import ConfigError
from ..files.rig_file import RigFile, Stand
from ..files.units import shown

SLACK = 1 + 1e-9
"""A value at its limit is within it, however it was rounded."""


@dataclass(frozen=True)
class Excess:
    """Something asked for that cannot be kept."""

    value: float
    unit: str
    limit: str
    """Name, value and place of the limit."""
    over: float
    """How far beyond: the worst of several is told."""
    remedy: str
    subject: str = ""
    """What the value is, where the unit does not say it."""
    outside: bool = False
    """The limit is a range."""


def within_robot(rig: RigFile, robot: Robot) -> RigFile:
    """The rig whose regulators may not be told more than its robot bears (`max_pressure` of robot.yaml).

    The guard gets this one: it clips set-points and judges readings by the lower of the two limits.
    """
    pressure = rig.instruments.pressure
    if pressure is None:
        return rig
    most = robot.max_pressure
    if most is None or most >= pressure.max_pressure:
        return rig
    lower = pressure.model_copy(update={"max_pressure": most})
    return rig.model_copy(update={"instruments": rig.instruments.model_copy(update={"pressure": lower})})


def wiring(rig: RigFile, robot: Robot) -> ChamberMap:
    """Which channel feeds which chambers of the rig's robot; raises ConfigError."""
    driven = robot.chambers
    if driven is None:
        raise ConfigError(f"{rig.robot}: has tendons, and rigs drive chambers: measure elsewhere and `lab import` the table")
    count = len(driven.azimuths_deg)
    pressure = rig.instruments.pressure
    try:
        return ChamberMap(pressure.chambers if pressure is not None else (), count)
    except ValueError as e:
        where = f"{rig.path or 'rig.yaml'}: instruments.pressure.chambers: {e}"
        raise ConfigError(f"{where}; the robot of {rig.robot} has {count}") from e


def problems(plan: Plan, rig: RigFile, path: Path, robot: Robot) -> list[str]:
    """One line for each limit that the plan does not keep, with its worst step."""
    found: dict[str, list[tuple[int, Excess]]] = {}
    for number, step in enumerate(plan.steps, 1):
        for excess in _excesses(step.ask, rig, path, robot):
            found.setdefault(excess.limit, []).append((number, excess))
    lines = []
    if rig.instruments.pressure is not None and robot.max_pressure is None:
        lines.append(
            f"{rig.robot}: max_pressure: is missing; to run, write the highest pressure that the robot's chambers may hold, "
            "for example max_pressure: 150 kPa"
        )
    if rig.stand is None and any(step.ask.probe for step in plan.steps):
        lines.append(f"{path}: stand: is missing; {plan.protocol} needs to know where the specimen is clamped")
    for several in found.values():
        number, worst = max(several, key=lambda pair: pair[1].over)
        where = "outside" if worst.outside else "above"
        further = len(several) - 1
        others = f" (and {further} further step{'s' if further > 1 else ''})" if further else ""
        lines.append(
            f"{plan.protocol}, step {number} ({plan.steps[number - 1].label}): requires {worst.subject}"
            f"{shown(worst.value, worst.unit)}, {where} {worst.limit}; {worst.remedy}{others}"
        )
    return lines


def _excesses(ask: Ask, rig: RigFile, path: Path, robot: Robot) -> Iterator[Excess]:
    if ask.pressures:
        yield from _pressures(ask.pressures, rig, path, robot)
    instruments = rig.instruments
    for value, instrument, key, unit in (
        (ask.pressure_rate, instruments.pressure, "pressure.max_rate", "Pa/s"),
        (ask.spine_length, instruments.spine, "spine.max_length", "m"),
        (ask.spine_speed, instruments.spine, "spine.max_speed", "m/s"),
        (ask.arm_speed, instruments.arm, "arm.max_speed", "m/s"),
        (ask.arm_acceleration, instruments.arm, "arm.max_acceleration", "m/s^2"),
    ):
        most = getattr(instrument, key.partition(".")[2], None)
        if value is not None and most is not None:
            yield from _above(value, unit, f"instruments.{key}", most, path)
    if robot.spine is None and ask.spine_length:
        remedy = "write spine_lengths: [0], or describe the spine there"
        yield Excess(ask.spine_length, "m", f"what {rig.robot} allows: it has no spine", math.inf, remedy, "a spine of ")
    if ask.vacuum is not None:
        yield from _above(ask.vacuum, "Pa", "limits.max_vacuum", rig.limits.max_vacuum, path, "a vacuum of ")
    if rig.stand is not None and instruments.arm is not None:
        yield from _probe(ask.probe, rig.stand, instruments.arm.workspace_min, instruments.arm.workspace_max, path)
    if ask.push is not None:
        yield from _push(ask.push, rig, path, robot)


RAISE = "reduce it, or raise the limit if the rig allows"


def _above(
    value: float, unit: str, key: str, most: float, path: Path | str, subject: str = "", remedy: str = RAISE
) -> Iterator[Excess]:
    if value > most * SLACK:
        yield Excess(value, unit, f"{key} = {shown(most, unit)} of {path}", value / most, remedy, subject)


def _pressures(pressures: Sequence[float], rig: RigFile, path: Path, robot: Robot) -> Iterator[Excess]:
    highest = max(pressures)
    if robot.max_pressure is not None:
        remedy = "reduce it: the robot withstands no more"
        yield from _above(highest, "Pa", "max_pressure", robot.max_pressure, rig.robot, remedy=remedy)
    regulators = rig.instruments.pressure
    if regulators is None:
        return
    yield from _above(highest, "Pa", "instruments.pressure.max_pressure", regulators.max_pressure, path)
    total = sum(max(0.0, p) for p in pressures)
    remedy = "inflate fewer chambers or to less, or raise the limit if the robot allows"
    limit = "limits.max_total_pressure"
    yield from _above(total, "Pa", limit, rig.limits.max_total_pressure, path, "a total over the chambers of ", remedy)
    try:
        wiring(rig, robot).setpoints(dict(enumerate(pressures, 1)))
    except ValueError as e:
        channels = f"what instruments.pressure.chambers of {path} can deliver"
        yield Excess(highest, "Pa", channels, 1.0, str(e), outside=True)


def _probe(
    places: Sequence[tuple[float, float | None]],
    stand: Stand,
    low: Sequence[float],
    high: Sequence[float],
    path: Path,
) -> Iterator[Excess]:
    """Each place against the arm's box; between two places inside of it the way is inside too."""
    for along, depth in places:
        deep = -stand.standoff if depth is None else depth
        for i, axis in enumerate("xyz"):
            x = stand.origin[i] + along * stand.axis[i] + deep * stand.push[i]
            over = max(low[i] - x, x - high[i])
            if over > 1e-9:
                free = f"{shown(low[i], 'm')} to {shown(high[i], 'm')}"
                box = f"the workspace of instruments.arm, {axis} = {free} of {path}"
                remedy = "correct stand, or widen workspace_min and workspace_max if there is room"
                yield Excess(round(x, 4), "m", box, over, remedy, f"the probe at {axis} = ", outside=True)


def _push(push: Push, rig: RigFile, path: Path, robot: Robot) -> Iterator[Excess]:
    force = expected_force(robot, push)
    if force is None:
        return
    remedy = "push less far (deflection_ratio), or raise the limit if specimen, sensor and arm allow"
    subject = f"a deflection of {push.deflection * 1e3:.2g} mm, for which the specimen should need "
    yield from _above(force, "N", "limits.max_force", rig.limits.max_force, path, subject, remedy)
    yield from _above(force, "N", "max_force", push.max_force, "the protocol", subject, remedy)
    moment = force * push.length
    yield from _above(moment, "N m", "limits.max_moment", rig.limits.max_moment, path, subject, remedy)


def bodies(rig: RigFile, robot: Robot) -> Bodies:
    """Return the bounds that the robot sets to the places of its tip and markers, to be judged from rig time 0 on.

    The stretch is three times the strain with all chambers at their highest pressure, because the area factor is not known
    better before a calibration, and a tenth more, because bodies and the cameras' base frame may be out of place. Markers
    count where robot.yaml states the arc length of each marker of rig.yaml.
    """
    names = getattr(rig.instruments.mocap, "markers", ())
    markers = robot.markers if len(names) == len(robot.markers) else ()
    strain = 0.0
    if robot.chambers is not None and rig.instruments.pressure is not None:
        factor = float(robot.area_factor_at([0.0, 0.0 if robot.spine is None else robot.length]).max())
        push = rig.instruments.pressure.max_pressure * factor * float(body_of(robot).tip_area.sum())
        strain = push / (robot.youngs_modulus * body_area(robot))
    return Bodies(0.0, (robot.length, *markers), 1 + 0.1 + 3.0 * strain)


def expected_force(robot: Robot, push: Push) -> float | None:
    """Force (N) of a cantilever bent at its end, F = 3 E I d / L^3, with the moduli of robot.yaml; None where it has none.

    A body is stiffer as far as the spine reaches inside it; there both bend together.
    """
    spine = 0.0
    if robot.spine is not None and push.spine > 0:
        spine = float(robot.spine.modulus_at(push.spine)) * annulus_second_moment(robot.spine.radius)
    if push.specimen == "spine":
        inner, outer, reach = spine, spine, push.length
    else:
        outer = robot.youngs_modulus * body_second_moment(robot)
        inner, reach = outer + spine, min(push.spine, push.length)
    if push.specimen == "spine" and robot.spine is None:
        return None
    if push.length <= 0 or inner <= 0:
        return math.inf  # nothing that could give way
    rest = (push.length - reach) ** 3
    give = (push.length**3 - rest) / (3 * inner) + rest / (3 * outer)
    return push.deflection / give


@dataclass(frozen=True)
class Margin:
    """The largest value of one kind in a plan, and the lowest limit that holds for it; in `unit`, SI."""

    name: str
    value: float
    unit: str
    limit: float | None
    """None: nothing limits it."""

    def __str__(self) -> str:
        """The line that a person reads."""
        value = f"{self.name} {shown(self.value, self.unit)}"
        return value if self.limit is None else f"{value} of {shown(self.limit, self.unit)} allowed: ok"


UNITS = {
    "pressure": "Pa",
    "total pressure": "Pa",
    "pressure rate": "Pa/s",
    "spine length": "m",
    "spine speed": "m/s",
    "vacuum": "Pa",
    "deflection": "m",
    "expected force": "N",
    "arm speed": "m/s",
    "arm acceleration": "m/s^2",
    "tip mass": "kg",
}
"""What steps can ask for, in the order in which it is listed, with the SI unit."""
ACTIVE = ("pressure", "spine length", "deflection")
"""A plan that asks for none of these moves neither robot nor specimen."""


def margins(plan: Plan, rig: RigFile, robot: Robot) -> list[Margin]:
    """Return the largest value of each kind that the steps of an accepted plan ask for, with its limit."""
    asked = [_asked(step.ask, robot) for step in plan.steps]
    largest = {name: max((of[name] or 0.0 for of in asked), default=0.0) for name in UNITS}
    limits = _limits(within_robot(rig, robot))
    return [Margin(name, value, UNITS[name], limits.get(name)) for name, value in largest.items() if value > 0]


def _asked(ask: Ask, robot: Robot) -> dict[str, float | None]:
    """What a step asks for, by the names of `UNITS`."""
    return {
        "pressure": max(ask.pressures, default=None),
        "total pressure": sum(max(0.0, p) for p in ask.pressures),
        "pressure rate": ask.pressure_rate,
        "spine length": ask.spine_length,
        "spine speed": ask.spine_speed if robot.spine is not None else None,
        "vacuum": ask.vacuum,
        "deflection": None if ask.push is None else ask.push.deflection,
        "expected force": None if ask.push is None else expected_force(robot, ask.push),
        "arm speed": ask.arm_speed,
        "arm acceleration": ask.arm_acceleration,
        "tip mass": None if ask.setup is None else ask.setup.tip_mass,
    }


def _limits(rig: RigFile) -> dict[str, float]:
    """The limit of each thing, where rig.yaml or robot.yaml states one; SI units."""
    found = {
        "total pressure": rig.limits.max_total_pressure,
        "vacuum": rig.limits.max_vacuum,
        "expected force": rig.limits.max_force,
    }
    for name, instrument, key in (
        ("pressure", rig.instruments.pressure, "max_pressure"),
        ("pressure rate", rig.instruments.pressure, "max_rate"),
        ("spine length", rig.instruments.spine, "max_length"),
        ("spine speed", rig.instruments.spine, "max_speed"),
        ("arm speed", rig.instruments.arm, "max_speed"),
        ("arm acceleration", rig.instruments.arm, "max_acceleration"),
    ):
        most = getattr(instrument, key, None)
        if most is not None:
            found[name] = most
    return found
