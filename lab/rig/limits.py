"""What a plan asks for against everything that limits it, before anything moves: robot, instruments, and the rig as a whole."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from drivers.chambers import ChamberMap
from model.body import annulus_second_moment, body_of
from model.robot import Robot
from protocols.arm_accuracy import distance
from protocols.experiment import Ask, Plan, Push
from recordings.states.demands import Bodies

from ..files.config import ConfigError
from ..files.rig_file import RigFile
from ..files.units import shown

NO_TENDONS = "a rig can only drive chambers: measure elsewhere and `lab import` the table"
SLACK = 1 + 1e-9
"""A value at its limit is within it, however it was rounded."""


ACTIVE = ("pressure", "spine length", "deflection", "arm speed")
"""A plan that asks for none of these moves neither robot nor specimen."""
PUSHED = "a deflection of {mm:.2g} mm, for which the specimen should need "
SUBJECTS = {"total pressure": "a total over the chambers of ", "vacuum": "a vacuum of ", "expected force": PUSHED,
            "expected moment": PUSHED}  # fmt: skip
"""What a value is, where its unit does not say it."""
RAISE = "or raise the limit if the rig allows it"
RAISE_FORCE = "or raise the limit if specimen, sensor and arm allow it"
OTHERWISE = {
    "max_pressure": "since the robot bears no more",
    "limits.max_total_pressure": "or inflate fewer chambers, or raise the limit if the robot allows it",
    "limits.max_force": RAISE_FORCE, "limits.max_moment": RAISE_FORCE, "max_force": RAISE_FORCE,
}  # fmt: skip
"""What else to do about a value beyond a limit than to reduce it or `RAISE` the limit, by the limit's key."""


@dataclass(frozen=True)
class Margin:
    """The largest value of one kind in a plan, and the lowest limit that holds for it; in `unit`, SI."""

    name: str
    value: float
    unit: str
    limit: float | None = None
    """None: nothing limits it."""

    def __str__(self) -> str:
        """The line that a person reads."""
        value = f"{self.name} {shown(self.value, self.unit)}"
        return value if self.limit is None else f"{value} of {shown(self.limit, self.unit)} allowed: ok"


@dataclass(frozen=True)
class StepDemand(Margin):
    """A value that one step asks for, and one limit of it."""

    key: str = ""
    """Of the limit in its file."""
    file: Path | str = ""


@dataclass(frozen=True)
class Excess:
    """Something asked for that cannot be kept."""

    text: str
    """What is required, in words."""
    limit: str
    """Name, value and place of the limit, with above or outside."""
    over: float
    """What is required over its limit, to name the worst of several."""
    remedy: str
    unit: str = ""
    """Of a value that smaller numbers of the protocol keep within its limit."""
    channels: tuple[tuple[int, ...], ...] = ()
    """Chambers of each, where it is others that can be inflated."""


def wiring(rig: RigFile, robot: Robot) -> ChamberMap:
    """Which channel feeds which chambers of the rig's robot; raises ConfigError."""
    driven = robot.chambers
    if driven is None:
        raise ConfigError(f"{rig.robot}: has tendons, but {NO_TENDONS}")
    count = len(driven.azimuths_deg)
    pressure = rig.instruments.pressure
    try:
        return ChamberMap(pressure.chambers if pressure is not None else (), count)
    except ValueError as e:
        where = f"{rig.path or 'rig.yaml'}: instruments.pressure.chambers: {e}"
        raise ConfigError(f"{where}; the robot of {rig.robot} has {count}") from e


def unlimited(rig: RigFile, robot: Robot) -> list[str]:
    """The line about a robot.yaml that does not state how much pressure the rig's robot withstands."""
    need = "max_pressure: is missing; write the highest pressure that its chambers may hold, for example max_pressure: 150 kPa"
    return [f"{rig.robot}: {need}"] if rig.instruments.pressure is not None and robot.max_pressure is None else []


Excesses = dict[str, list[tuple[int, Excess]]]
"""By limit that a plan does not keep, the steps that exceed it, counted from 1, the worst first."""


def excesses(plan: Plan, rig: RigFile, path: Path, robot: Robot) -> Excesses:
    """Each limit that the plan does not keep."""
    found: Excesses = {}
    for number, step in enumerate(plan.steps, 1):
        for excess in _excesses(step.ask, rig, path, robot):
            found.setdefault(excess.limit, []).append((number, excess))
    return {limit: sorted(several, key=lambda pair: -pair[1].over) for limit, several in found.items()}


def problems(plan: Plan, rig: RigFile, path: Path, robot: Robot, settings: Callable[[], Mapping[str, str]]) -> list[str]:
    """One line for each limit that the plan does not keep, with its worst step. `settings`: limit -> what keeps it."""
    lines, found = unlimited(rig, robot), excesses(plan, rig, path, robot)
    if rig.stand is None and any(step.ask.probe for step in plan.steps):
        lines.append(f"{path}: stand: is missing; {plan.protocol} needs to know where the specimen is clamped")
    keeping = settings() if found else {}
    for limit, several in found.items():
        number, worst = several[0]
        further = len(several) - 1
        lower = "reduce it" if worst.unit and limit.startswith("above") else ""
        add, remedy = f"add {keeping[limit]}" if limit in keeping else lower, worst.remedy
        remedy = (
            f"{remedy}{'; ' * bool(add)}{add}" if worst.channels else f"{add}, {remedy}" if add else remedy.removeprefix("or ")
        )
        more = f" (and {further} further step{'s' if further > 1 else ''})" if further else ""
        lines.append(
            f"{plan.protocol}, step {number} ({plan.steps[number - 1].label}): requires {worst.text}, {worst.limit}; "
            f"{remedy}{more}"
        )
    return lines


def margins(plan: Plan, rig: RigFile, robot: Robot) -> list[Margin]:
    """Return the largest value of each kind that the steps of an accepted plan ask for, with its limit."""
    demands: dict[str, list[StepDemand]] = {}
    for step in plan.steps:
        for demand in _demands(step.ask, rig, "", robot):
            demands.setdefault(demand.name, []).append(demand)
    largest = {name: max(demand.value for demand in of) for name, of in demands.items()}
    limits = {name: min((d.limit for d in of if d.limit is not None), default=None) for name, of in demands.items()}
    return [Margin(name, value, demands[name][0].unit, limits[name]) for name, value in largest.items() if value > 0]


def _demands(ask: Ask, rig: RigFile, path: Path | str, robot: Robot) -> Iterator[StepDemand]:
    """Each value that a step asks for (0 where it asks for none), in the order of the plan's listing, once for each limit."""
    push = ask.push
    force = None if push is None else expected_force(robot, push)
    yield from _pressures(ask, rig, path, robot)
    for name, value, unit, key in (
        ("total pressure", sum(max(0.0, p) for p in ask.pressures), "Pa", "limits.max_total_pressure"),
        ("pressure rate", ask.pressure_rate, "Pa/s", "instruments.pressure.max_rate"),
        ("spine length", ask.spine_length, "m", "instruments.spine.max_length"),
        ("spine speed", None if robot.spine is None else ask.spine_speed, "m/s", "instruments.spine.max_speed"),
        ("vacuum", ask.vacuum, "Pa", "limits.max_vacuum"),
        ("deflection", None if push is None else push.deflection, "m", ""),
        ("expected force", force, "N", "limits.max_force"),
        ("expected moment", None if push is None or force is None else force * push.length, "N m", "limits.max_moment"),
        ("arm speed", ask.arm_speed, "m/s", "instruments.arm.max_speed"),
        ("arm acceleration", ask.arm_acceleration, "m/s^2", "instruments.arm.max_acceleration"),
        ("tip mass", None if ask.setup is None else ask.setup.tip_mass, "kg", ""),
    ):
        parts: list[Any] = [rig, *key.split(".")]
        limit = reduce(lambda found, name: getattr(found, name, None), parts) if key else None
        yield StepDemand(name, value or 0.0, unit, limit, key, path)
    if push is not None:
        yield StepDemand("expected force", force or 0.0, "N", push.max_force, "max_force", "the protocol")


def _pressures(ask: Ask, rig: RigFile, path: Path | str, robot: Robot) -> Iterator[StepDemand]:
    """The highest pressure of the chambers that share a limit, of robot.yaml and of rig.yaml."""
    regulators = rig.instruments.pressure
    groups = () if regulators is None else zip(regulators.limits, regulators.chambers, strict=True)
    of_rig = {chamber: limit for limit, group in groups for chamber in group}
    of_robot = {} if robot.max_pressure is None else dict(enumerate(robot.pressure_limits.tolist(), 1))
    for limits, key, file in ((of_robot, "max_pressure", rig.robot), (of_rig, "instruments.pressure.max_pressure", path)):
        for limit in dict.fromkeys(limits.values()) or (None,):
            alike = [chamber for chamber, own in limits.items() if own == limit]
            kind = f" of {robot.actuators.words.group(alike)}" if len(alike) < len(limits) else ""
            held = (p for chamber, p in enumerate(ask.pressures, 1) if not kind or chamber in alike)
            yield StepDemand(f"pressure{kind}", max(held, default=0.0), "Pa", limit, key, file)


def _excesses(ask: Ask, rig: RigFile, path: Path, robot: Robot) -> Iterator[Excess]:
    """What of a step is beyond a limit, or what the rig cannot do: chambers, a spine, places of the probe."""
    for d in _demands(ask, rig, path, robot):
        if d.limit is not None and d.value > d.limit * SLACK:
            of_some = f"a {d.name} of " if d.name.startswith("pressure of") else ""
            subject = SUBJECTS.get(d.name, of_some).format(mm=0.0 if ask.push is None else ask.push.deflection * 1e3)
            limit = f"above {d.key} = {shown(d.limit, d.unit)} of {d.file}"
            yield Excess(f"{subject}{shown(d.value, d.unit)}", limit, d.value / d.limit, OTHERWISE.get(d.key, RAISE), d.unit)
    if ask.pressures and rig.instruments.pressure is not None:
        try:
            (wired := wiring(rig, robot)).setpoints(dict(enumerate(ask.pressures, 1)))
        except ValueError as e:
            channels = f"outside what instruments.pressure.chambers of {path} can deliver"
            yield Excess(shown(max(ask.pressures), "Pa"), channels, 1.0, str(e), channels=wired.channels)
    if robot.spine is None and ask.spine_length:
        remedy = "or describe the spine there"
        limit = f"above what {rig.robot} allows: it has no spine"
        yield Excess(f"a spine of {shown(ask.spine_length, 'm')}", limit, math.inf, remedy, "m")
    if rig.instruments.arm is not None:
        yield from _places(ask, rig, robot, path)


def _places(ask: Ask, rig: RigFile, robot: Robot, path: Path) -> Iterator[Excess]:
    """Places of the TCP outside of the arm's box, and ways of its poses that are nearer to the stand than the stand-off."""
    stand, places = rig.stand, arm_places(rig, robot.length)
    (low, high), base = places["box"], (0.0, 0.0, 0.0)
    points: list[tuple[tuple[float, ...], tuple[float, ...]]] = [(base, pose[:3]) for pose in ask.poses]
    if stand is not None:
        for along, depth in ask.probe:
            deep = -stand.standoff if depth is None else depth
            place = (o + along * a + deep * p for o, a, p in zip(stand.origin, stand.axis, stand.push, strict=True))
            points.append((stand.origin, tuple(place)))
        ways = [np.linspace(a[:3], b[:3], 100) for a, b in itertools.pairwise(ask.poses)]
        near = min((float(distance(way, places["keep_out"]).min()) for way in ways), default=math.inf)
        if near < stand.standoff - 1e-9:  # m, rounding
            limit = f"below stand.standoff = {shown(stand.standoff, 'm')} of {path}"
            subject = f"a way {shown(round(near, 4), 'm')} from the stand's axis"
            yield Excess(subject, limit, stand.standoff / max(near, 1e-9), "use the usual keep_out and keep_out_radius")
    for start, point in points:
        for axis, a, b, o, x in zip("xyz", low, high, start, point, strict=True):
            if not a - 1e-9 <= x <= b + 1e-9:  # m, rounding
                room = (a if x < a else b) - o
                over = math.inf if not room or (x - o) / room < 1 else (x - o) / room  # inf: where it starts is outside, too
                box = f"outside the workspace of instruments.arm, {axis} = {shown(a, 'm')} to {shown(b, 'm')} of {path}"
                remedy = "or correct stand, or widen workspace_min and workspace_max if there is room"
                yield Excess(f"the probe at {axis} = {shown(round(x, 4), 'm')}", box, over, remedy, "m")


def arm_places(rig: RigFile, length: float) -> dict[str, Any]:
    """Where the arm may go, as parameters of `arm_accuracy`: in its box, and away from a specimen of `length` (m)."""
    arm, stand = rig.instruments.arm, rig.stand
    box = {} if arm is None else {"box": [arm.workspace_min, arm.workspace_max], "speed": min(0.1, arm.max_speed)}
    if stand is None:
        return box
    end = tuple(o + length * a for o, a in zip(stand.origin, stand.axis, strict=True))
    azimuth = math.degrees(math.atan2(stand.origin[1], stand.origin[0]))
    return {**box, "keep_out": [stand.origin, end], "keep_out_radius": stand.standoff, "azimuth_deg": azimuth}


def bodies(rig: RigFile, robot: Robot) -> Bodies:
    """Return the bounds that the robot sets to the places of its tip and markers, to be judged from rig time 0 on.

    The stretch is three times the strain with all chambers at their highest pressure, because the area factor is not known
    better before a calibration, and a tenth more, because bodies and the cameras' base frame may be out of place. Markers
    count where robot.yaml states the arc length of each marker of rig.yaml."""
    names, known = getattr(rig.instruments.mocap, "markers", ()), robot.marker_places()
    known = known if len(names) == len(known) else known[:0]
    strain = 0.0
    if robot.chambers is not None and rig.instruments.pressure is not None:
        factor = float(robot.area_factor_at([0.0, 0.0 if robot.spine is None else robot.length]).max())
        highest = wiring(rig, robot).by_chamber(rig.instruments.pressure.limits)
        push = factor * float(body_of(robot).tip_area @ highest)
        strain = push / (robot.youngs_modulus * body_of(robot).mean_area)
    arcs, off = (robot.length, *known[:, 2].tolist()), (0.0, *np.hypot(known[:, 0], known[:, 1]).tolist())
    return Bodies(0.0, arcs, 1 + 0.1 + 3.0 * strain, off)


def expected_force(robot: Robot, push: Push) -> float | None:
    """Force (N) of a cantilever bent at its end, F = 3 E I d / L^3, a body with spine inside stiffer; None without a spine."""
    from model.rods.beam import bending_compliance  # with a compiler, which few runs need

    if push.specimen == "spine" and robot.spine is None:
        return None
    spine_stiffness = 0.0  # E I, N m^2
    if robot.spine is not None and push.spine > 0:
        spine_stiffness = float(robot.spine.modulus_at(push.spine)) * annulus_second_moment(robot.spine.radius)
    if push.specimen == "spine":
        stiffness_inside, stiffness_beyond, reach = spine_stiffness, spine_stiffness, push.length
    else:
        stiffness_beyond = robot.youngs_modulus * body_of(robot).mean_second
        stiffness_inside, reach = stiffness_beyond + spine_stiffness, min(push.spine, push.length)
    if push.length <= 0 or stiffness_inside <= 0:
        return math.inf  # nothing that could give way
    return push.deflection / float(bending_compliance((0.0, reach, push.length), (stiffness_inside, stiffness_beyond)))
