"""Whether a table's pressures are Pa gauge: compared with the tip displacement that they cause.

A beam under the moment M = sum p A_eff r and the force F = sum p A_eff moves its tip by kappa L^2 / 2 and eps L, with
kappa = M / (E I), eps = F / (E A). Robots, models and effects differ from that by a factor of a few; another unit differs by
100 (mbar), 1000 (kPa), 6895 (psi) or more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from model.body import body_of
from model.condition import HIGHEST_PRESSURE
from model.robot import Robot
from model.section import body_area, body_mass, combined_modulus
from recordings.trials import Table

from ..arrays import Array, Ints, Mask
from .levels import MASS_GAP, ROLL_GAP, SPINE_GAP, VACUUM_GAP, distinct, levels
from .units import PRESSURE_UNITS, Unit, units_near

LEAST_DISPLACEMENT = 0.015
"""Robot lengths; smaller displacements of the tip are not evaluated."""
FARTHEST = 30.0
"""Measured to expected displacement that no modulus, area factor or effect exceeds."""
SHARE_AT_REST, AT_REST = 0.03, 500.0
"""Of the highest pressure, and Pa, within which a state counts as without pressure."""
VISIBLE_STRETCH, STRETCH_SHARE = 0.02, 0.3
"""Robot lengths by which 100 kPa gauge in every chamber must stretch the body to be distinguished from ambient, and the share
of that which a body at ambient stays below."""


@dataclass(frozen=True)
class Pressures:
    """n states: what was read, and what a beam would do."""

    states: Table
    pressure: Array
    """(n, chambers) as the table has them."""
    displacement: Array
    """(n, 3) m: of the tip from the lowest state of its own setting (spine, mass, roll, vacuum)."""
    unit: float
    """Pa per unit of the table as far as the displacement of the tip tells it; 1 where it does not."""
    ratio: float
    """Measured to expected displacement; 1 where it cannot be determined."""
    resting: Mask
    """(n,) without pressure, be it gauge or absolute."""

    @classmethod
    def of(cls, robot: Robot, states: Table) -> Pressures:
        """Of states with a tip in m and a pressure for each chamber."""
        pressure, setting, tip = states.pressures, setting_of_each(states), states.tip
        rising = np.lexsort((np.abs(pressure).max(axis=1), setting))
        low = rising[np.unique(setting[rising], return_index=True)[1]][setting]
        displacement = tip - tip[low]
        ratio = _ratio(robot, displacement, expected_displacement(robot, states.spine_length, pressure - pressure[low]))
        # in mbar or a larger unit, no soft robot has such large numbers
        implausible = ratio > FARTHEST and np.abs(pressure).max() < 20e3
        unit = 1 / units_near(1 / ratio, _units(robot), 1.0)[0].per_si if implausible else 1.0
        return cls(states, pressure, displacement, unit, ratio, _resting(pressure * unit))


def _units(robot: Robot) -> tuple[Unit, ...]:
    """In which a table may hold what drives the robot."""
    words = robot.actuators.words
    own = Unit(words.unit, 1 / words.pascal)
    return PRESSURE_UNITS if own.name in {u.name for u in PRESSURE_UNITS} else (own,)


def setting_of_each(states: Table) -> Ints:
    """(n,) index of each state's setting: spine length, tip mass, roll and vacuum; only pressure differs within one."""
    gaps = {"spine_length": SPINE_GAP, "tip_mass": MASS_GAP, "roll_deg": ROLL_GAP, "vacuum": VACUUM_GAP}
    return distinct(*(levels(states.get(name, 0.0), gap) for name, gap in gaps.items()))


def expected_displacement(robot: Robot, spine_length: Array, pressure: Array) -> Array:
    """(n,) m: tip's displacement of a straight beam, with a spine of (n,) m in its first part, under (n, chambers) Pa."""
    body, spine = body_of(robot), np.clip(spine_length, 0.0, robot.length)
    push = pressure * robot.area_factor_at(spine)[:, None]
    azimuth = np.radians(robot.actuators.azimuths_deg)
    moment = np.hypot(push @ (body.mean_arm * np.cos(azimuth)), push @ (body.mean_arm * np.sin(azimuth)))
    inner, outer = combined_modulus(robot, spine), robot.youngs_modulus
    rest = robot.length - spine
    aside = moment / body.mean_second * (spine * (robot.length - spine / 2) / inner + rest**2 / (2 * outer))
    along = push @ body.mean_chamber_area / body.mean_area * (spine / inner + rest / outer)
    return np.asarray(np.hypot(aside, along))


def _ratio(robot: Robot, displacement: Array, expected: Array) -> float:
    """Measured to expected displacement in the states that move most; 1 where it does not follow the pressure."""
    moved = np.linalg.norm(displacement, axis=1)
    still = len(moved) < 4 or moved.max() < LEAST_DISPLACEMENT * robot.length or not expected.max() > 0
    if still or np.ptp(expected) == 0 or np.corrcoef(moved, expected)[0, 1] < 0.9:
        return 1.0
    most = expected >= 0.5 * expected.max()
    return float(np.median(moved[most] / expected[most]))


def _resting(pressure: Array) -> Mask:
    """(n,) states in which no chamber holds pressure (n, chambers) Pa, or all hold what looks like ambient pressure."""

    def low(level: Array) -> Mask:
        return np.asarray(level <= max(SHARE_AT_REST * level.max(), AT_REST))

    least, out = pressure.min(axis=0), low(np.abs(pressure).max(axis=1))
    return low((pressure - least).max(axis=1)) if not out.any() and _like_ambient(least) else out


def _like_ambient(least: Array) -> bool:
    # Pa absolute, from high places to a high on the coast
    return bool((least > 75e3).all() and (least < 107e3).all() and np.ptp(least) < 3e3)


def implausible_pressures(robot: Robot, s: Pressures) -> Iterator[str]:
    """Another unit, or absolute pressures."""
    row, chamber = np.unravel_index(int(np.argmax(np.abs(s.pressure))), s.pressure.shape)
    highest = float(s.pressure[row, chamber])
    place = f"{s.states.place(int(row))}, column p{chamber + 1}"
    # Models miss by a factor of three, so two units may come into question.
    if abs(highest) > HIGHEST_PRESSURE and robot.chambers is None:
        words = robot.actuators.words
        yield (
            f"{place}: {highest / words.pascal:g} {words.unit}, must be at most {HIGHEST_PRESSURE / words.pascal:g} "
            f"{words.unit}: check its unit"
        )
    elif abs(highest) > HIGHEST_PRESSURE:
        # 60 kPa: the highest pressure of most soft robots
        units = units_near(s.ratio if s.ratio != 1.0 else 60e3 / abs(highest), PRESSURE_UNITS, 3.0)
        looks = " or ".join(f"{unit.name} (divide by {1 / unit.per_si:.4g})" for unit in units)
        yield (
            f"{place}: {highest:g} Pa gauge, must be at most {HIGHEST_PRESSURE:g} Pa: check its unit, "
            f"it looks like Pa read as {looks}"
        )
    if s.unit != 1.0:
        units = units_near(1 / s.ratio, _units(robot), 3.0)
        moved = np.linalg.norm(s.displacement, axis=1).max()
        looks = " or ".join(unit.name for unit in units)
        remedy = ", ".join(f"{unit.remedy}{f' ({unit.name})' if len(units) > 1 else ''}" for unit in units)
        yield (
            f"{place}: largest value {highest:g} in a sweep that moves the tip by {moved * 1e3:.3g} mm: looks like {looks}; "
            f"{robot.actuators.words.pressures} are in Pa gauge: {remedy}"
        )
    elif s.ratio > FARTHEST:
        given = robot.bending_stiffness or robot.youngs_modulus
        name, unit = ("bending_stiffness", "N m^2") if robot.bending_stiffness else ("youngs_modulus", "Pa")
        yield (
            f"{place}: the tip moves {s.ratio:.2g} times as far as a beam with the numbers of robot.yaml, must be at most "
            f"{FARTHEST:g} times: check {name} ({given:.4g} {unit}; {given / s.ratio:.2g} {unit} would fit), outer_radius and "
            "path_radius, and their units"
        )
    least = (s.pressure * s.unit).min(axis=0)
    if _like_ambient(least) and _at_its_length(robot, s):
        ambient = float(np.median(s.pressure.min(axis=0)))
        yield (
            f"column{'s p1..' if len(least) > 1 else ' '}p{len(least)}: never below {ambient:.6g} with the tip at rest: looks "
            f"like absolute pressure; pressures are in Pa gauge: subtract ambient pressure ({ambient * s.unit:.6g} Pa)"
        )


def _at_its_length(robot: Robot, s: Pressures) -> bool:
    """Whether the body at its least pressures is shorter than that much gauge pressure would make it: it is at ambient."""
    resting = s.states.take(s.resting)
    if not len(resting):
        return False
    low = (s.pressure * s.unit)[s.resting]
    by_gauge = float(np.median(expected_displacement(robot, resting.spine_length, low))) / robot.length
    if by_gauge < VISIBLE_STRETCH:
        return False
    weight = body_mass(robot) / 2 + robot.tip_mass
    by_weight = weight * abs(robot.gravity[2]) / (robot.youngs_modulus * body_area(robot))
    longer = float(np.median(np.linalg.norm(resting.tip, axis=1))) / robot.length - 1
    return longer < STRETCH_SHARE * by_gauge + by_weight


def implausible_roll(robot: Robot, s: Pressures) -> str:
    """A message where the tip turns about the axis by 57 times what roll_deg says, as it is in rad; else empty."""
    roll = s.states.get("roll_deg", 0.0)
    if not 0 < np.abs(roll).max() < 2 * np.pi + 0.01:
        return ""
    push = (s.pressure @ robot.bending_directions) * np.exp(1j * np.radians(roll))
    aside = s.displacement[:, 0] + 1j * s.displacement[:, 1]
    turn: dict[float, float] = {}
    """Roll -> degrees by which the tip goes elsewhere than the pressures push it."""
    for one in np.unique(roll).tolist():
        own = roll == one
        along = aside[own] * push[own].conj()
        total, coherent = complex(np.sum(along)), float(np.sum(np.abs(along)))
        bent = np.abs(aside[own]).max() > LEAST_DISPLACEMENT * robot.length
        if bent and coherent > 0 and abs(total) > 0.8 * coherent:
            turn[one] = float(np.degrees(np.angle(total)))
    if len(turn) < 2:
        return ""  # the base may stand turned by as much
    first_roll = min(turn, key=abs)
    rolled = {one: _wrapped(t - turn[first_roll]) for one, t in turn.items() if one != first_roll}
    missed = {one: _wrapped(np.degrees(one - first_roll) - (one - first_roll)) for one in rolled}
    # a roll read in the wrong unit that is off by less is not seen
    seen = max(map(abs, missed.values())) >= 30.0
    if not seen or not all(abs(_wrapped(rolled[one] - missed[one])) < 15.0 for one in rolled):
        return ""
    most = max(rolled, key=abs)
    first = s.states.place(int(np.argmax(roll == most)))
    return (
        f"{first}, column roll_deg: {most:g}, but the direction of bending turns "
        f"by {np.degrees(most):.0f} degrees: looks like rad; roll_deg is in degrees: multiply by 57.2958"
    )


def _wrapped(degrees: float) -> float:
    return float((degrees + 180) % 360 - 180)
