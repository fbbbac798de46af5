"""Whether a table can have been measured on this robot, in the units and the frame that a table of trials has.

Tables come from other tools in kPa, mm, rad, g, upside down, or with quaternions that begin with x. A value is refused only where
nothing else can explain it, with its column, the value, what it looks like and what to write.

    tips            at rest near `length` from the base, along +z
    orientation     unit quaternions, near qw = 1 at rest; in the frame of the tips (see `attitudes`)
    pressures       what the tip's displacement needs, by beam theory, within a factor of 30 (see `plausible_pressures`)
    spine, masses   against length and tip_mass of robot.yaml
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from model.robot import Robot
from model.section import body_area, body_mass, body_second_moment
from recordings.trials import Table

from ..arrays import Ints
from ..errors import BadCase
from .attitudes import attitude_in_another_frame
from .plausible_pressures import Pressures, implausible_pressures, implausible_roll
from .units import LENGTH_UNITS, nearest

STRAIGHT, TURNED = 0.9, 75.0
"""Robot lengths and degrees: a body bent along an arc so that its tip lies 75 degrees off its axis is 0.74 lengths away."""
LIMP = 30.0
"""Weight over bending stiffness from which a body hangs down from its base."""


def require_plausible(robot: Robot, table: Table, name: str = "") -> None:
    """Raises `BadCase`, one line for each thing that is wrong, each beginning with `name` (file or files)."""
    if found := (*implausible_values(robot, table), *contradicting_attitudes(robot, table)):
        raise BadCase("\n".join(f"{name}: {text}" if name else text for text in found))


def implausible_values(robot: Robot, table: Table) -> tuple[str, ...]:
    """One message for each implausible value: column, value, what it looks like, what to write; empty when there is none."""
    if not len(table):
        return ()
    tips = table.take(table.with_tip & np.isfinite(table.spine_length))
    of_tips = _of_tips(robot, tips) if len(tips) else ()
    found = (_spines(robot, table), _masses(robot, table), *of_tips)
    return tuple(filter(None, found))


def contradicting_attitudes(robot: Robot, table: Table) -> tuple[str, ...]:
    """A message where attitudes contradict the tip's places; empty where they do not, or other values are implausible."""
    tips = table.take(table.with_tip & np.isfinite(table.orientation).all(axis=1))
    if not len(tips) or implausible_values(robot, tips):
        return ()
    resting = tips.take(Pressures.of(robot, tips).resting)
    return tuple(filter(None, [attitude_in_another_frame(robot.length, tips, resting, weight_ratio(robot) > LIMP)]))


def _of_tips(robot: Robot, states: Table) -> Iterator[str]:
    """Messages about states with a tip, of no stiffness trial; some are empty."""
    there, expected = set(pressures_of_each(states).tolist()), len(robot.actuators.azimuths_deg)
    if there != {expected}:
        yield (
            f"rows with {', '.join(map(str, sorted(there)))} pressures for a robot with {expected} chambers: tables of "
            "different robots cannot be used together; write one column p1.. for each of robot.yaml's azimuths_deg"
        )
    factor, note = _distances(robot, states)
    yield note
    if not factor or there != {expected}:
        return
    states = states.replaced({axis: states.get(axis) / factor for axis in "xyz"})
    pressures = Pressures.of(robot, states)
    yield from implausible_pressures(robot, pressures)
    yield implausible_roll(robot, pressures)
    resting = states.take(pressures.resting)
    yield _resting_tip(robot, resting) if len(resting) else ""
    yield _orientation(states, resting)


def pressures_of_each(states: Table) -> Ints:
    """(n,) number of pressures of each state: up to the last that was measured."""
    pressures = states.pressures
    return np.where(np.isnan(pressures), 0, np.arange(1, pressures.shape[1] + 1)).max(axis=1, initial=0)


# ------------------------------------------------------------------ lengths
def _distances(robot: Robot, states: Table) -> tuple[float, str]:
    """How many of the tips' unit make one m (0: unknown), and a message about it; empty where there is nothing to say."""
    distance = np.linalg.norm(states.tip, axis=1)
    worst = int(np.argmax(distance))
    # no tip of a rod that stretches by less than half is further from its base
    farthest = 1.5 * robot.length + tracked_beyond(robot)
    if distance[worst] <= farthest:
        return 1.0, ""
    far = int((distance > farthest).sum())
    head = (
        f"{states.place(worst)}, columns x, y, z: the tip lies {distance[worst]:.3g} m from the base of a robot that is "
        f"{robot.length:g} m long ({far} of {len(states)} states)"
    )
    unit = nearest(float(np.median(distance)) / robot.length, LENGTH_UNITS, within=1.6)
    if unit is None:
        return 0.0, f"{head}: check the unit (m) and the frame (base of the robot)"
    return unit.per_si, f"{head}: looks like {unit.name}; positions are in m: {unit.remedy}"


def tracked_beyond(robot: Robot) -> float:
    """m from the body's end to the point that robot.yaml states as tracked."""
    return float(np.linalg.norm([p.value for p in robot.effects.get("marker_offset", {}).values()]))


def _spines(robot: Robot, table: Table) -> str:
    lengths = table.spine_length
    if not np.nanmax(lengths) > 1.001 * robot.length:
        return ""
    worst = int(np.nanargmax(lengths))
    head = f"{table.place(worst)}, column spine_length: {lengths[worst]:g} m, longer than the robot ({robot.length:g} m)"
    times = float(lengths[worst]) / robot.length
    # a longer spine is another unit rather than another robot
    if times < 4.0:
        return f"{head}: check the unit (m), or the length in robot.yaml"
    # What fits the robot in cm may be a short spine in mm as well.
    looks, divisor = ("cm or mm", "100 or 1000") if times <= 100 else ("mm", "1000")
    return f"{head}: looks like {looks}; lengths are in m: divide by {divisor}"


# ------------------------------------------------------------------ masses
def _masses(robot: Robot, table: Table) -> str:
    """Grams: a thousand times robot.yaml's tip mass, or a weight under which the body would be twice as long."""
    masses = table.get("tip_mass", 0.0)
    heaviest = int(np.argmax(masses))
    mass, described, carried = float(masses[heaviest]), robot.tip_mass, robot.youngs_modulus * body_area(robot) / 9.81
    if not (mass > carried or (described > 0 and abs(mass / described / 1000 - 1) < 0.05)):
        return ""
    beside = f"robot.yaml has {described:g} kg" if described > 0 else f"the body would be twice as long under {carried:.3g} kg"
    return f"{table.place(heaviest)}, column tip_mass: {mass:g} kg, {beside}: looks like g; masses are in kg: divide by 1000"


# ------------------------------------------------------------------ frame and orientation
def _resting_tip(robot: Robot, resting: Table) -> str:
    """A message where the median tip of the states without pressure (`resting`) is near the base, or not along +z from it."""
    tip = np.median(resting.tip, axis=0)
    away = float(np.linalg.norm(tip)) / robot.length  # robot lengths from the base
    place = f"{resting.place(0)}, columns x, y, z: at rest the tip lies at ({tip[0]:.3g}, {tip[1]:.3g}, {tip[2]:.3g}) m"
    meant = f"at rest it must be near (0, 0, {robot.length:g}) m, the robot's length along +z from its base"
    if away < 0.05:  # no soft arm at rest is curled up this far
        return f"{place}: looks like the displacement from the rest position; {meant}: add {robot.length:g} to z"
    # a bent arm, or one so heavy that it hangs down from its base, may point in any direction
    if away < STRAIGHT or weight_ratio(robot) > LIMP:
        return ""
    angle = np.degrees(np.arccos(np.clip(tip[2] / (away * robot.length), -1, 1)))  # between tip and +z
    if angle < TURNED:
        return ""
    if angle > 180 - TURNED:
        return (
            f"{place}: z seems to point the wrong way; {meant}: change the sign of z and of y (half a turn about x, in "
            "orientations and robot.yaml's gravity too)"
        )
    axis = "xy"[int(np.argmax(np.abs(tip[:2])))]
    return f"{place}: {axis} seems to be the robot's axis; {meant}: turn the frame so that z points from base to tip"


def weight_ratio(robot: Robot) -> float:
    """Weight of body and tip against bending stiffness, W L^2 / E I."""
    weight = (body_mass(robot) + robot.tip_mass) * float(np.linalg.norm(robot.gravity))
    return weight * robot.length**2 / (robot.youngs_modulus * body_second_moment(robot))


def _orientation(states: Table, resting: Table) -> str:
    turned, at_rest = (s.take(~np.isnan(s.orientation[:, 0])) for s in (states, resting))
    if not len(turned):
        return ""
    lengths = np.linalg.norm(turned.orientation, axis=1)
    worst = int(np.argmax(np.abs(lengths - 1)))
    # rounding to two digits makes less
    if abs(lengths[worst] - 1) > 0.05:
        return (
            f"{turned.place(worst)}, columns qw, qx, qy, qz: {_numbers(turned, worst)} has norm "
            f"{lengths[worst]:.3g}, must be 1: looks like angles or a rotation vector; write a unit quaternion, w first"
        )
    still = at_rest if len(at_rest) else turned
    # qz: bending and sagging turn about x and y, not about z
    if not float(np.median(np.abs(still.orientation[:, 3]))) > 0.8:
        return ""
    return (
        f"{still.place(0)}, columns qw, qx, qy, qz: {_numbers(still, 0)} of a robot at rest: looks like the "
        "order x, y, z, w; at rest the tip has the base's orientation, (1, 0, 0, 0): write w first, not last"
    )


def _numbers(states: Table, state: int) -> str:
    return f"({', '.join(f'{c:.3g}' for c in states.orientation[state])})"
