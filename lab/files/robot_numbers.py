"""Warn about implausible numbers of robot.yaml and pressures above its limit, without refusing them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from diagnosis.data.plausible import differ_by
from model.body import annulus_second_moment, body_of
from model.robot import Robot
from model.section import body_mass
from model.stated import AREA_FACTOR
from recordings.trials import Table

from .units import sized

FAR_OUT, LARGE = 3.0, 0.15
"""Outer radii, and lengths of the robot, off the axis beyond both of which no actuator is expected: disks on a thin rod stand out
far, but are small beside its length."""
LEAST_DENSITY, MOST_BODIES = 20.0, 100.0
"""kg/m^3, and body masses at the tip, beyond which a number is probably in g."""
MOST_STIFF = 1e3
"""Times the bending stiffness of a section of one material, which a stiff rod inside a soft body does not reach."""
MOST_POISSON, LEAST_POISSON = 0.53, -0.05
"""Ratios of isotropic materials, 0 to 0.5, and what rounding of both moduli to two digits adds."""
ABOVE = 1.5
"""Times max_pressure beyond which a pressure is asked about; regulators overshoot by less."""
EQUAL, MOSTLY = 1e-6, 0.5
"""Pa within which readings are equal, and share of states in which readings that are not set-points have noise."""


def doubts(robot: Robot, table: Table, robot_name: str) -> tuple[str, ...]:
    """Return warnings about numbers of robot.yaml, read at `robot_name`, pressures above its limit, and those that never vary."""
    of_table = (text for judge in (_replaced, _above, _dead) for text in judge(robot, table))
    return (*(f"{robot_name}: {text}" for text in doubtful_numbers(robot)), *of_table)


def doubtful_numbers(robot: Robot) -> Iterator[str]:
    """Warnings about implausible numbers of robot.yaml: path radius, density, tip mass, Poisson's ratio, bending stiffness; and
    about a posterior of parameters that it no longer states."""
    given = robot.posterior.parameters if robot.posterior is not None else ()
    if absent := [name for name in given if name not in (AREA_FACTOR, *robot.stated)]:
        yield f"posterior: {', '.join(absent)} not stated in effects or tolerances, and ignored"
    section = robot.youngs_modulus * annulus_second_moment(outer := robot.outer_radius, robot.inner_radius)
    if (times := (robot.bending_stiffness or 0.0) / section) > MOST_STIFF:
        yield (
            f"bending_stiffness is {robot.bending_stiffness:g} N m^2, {times:.2g} times that of the section and youngs_modulus "
            f"({section:.3g} N m^2), more than any spine adds: if it is in N mm^2, divide by 1e6; else check radii and modulus"
        )
    driven, farthest = robot.actuators, float(np.max(robot.actuators.path_radius))
    if farthest > max(FAR_OUT * outer, LARGE * robot.length):
        yield (
            f"{driven.words.kind}.path_radius is {1e3 * farthest:.4g} mm, {farthest / outer:.2g} times the "
            f"outer_radius of {1e3 * outer:.4g} mm: check both and their units"
        )
    if 0 < robot.density < LEAST_DENSITY:
        yield f"density is {robot.density:g} kg/m^3, below a foam's ({LEAST_DENSITY:g}): if it is in g/cm^3, multiply by 1000"
    if robot.chambers is not None and robot.thrust != "walls" and (early := (along := body_of(robot)).uncapped):
        first, farthest, radius = (1e3 * x for x in (along.ended[early[0] - 1], max(along.ended), along.outer_radius[-1]))
        yield (
            f"chambers.ends: {driven.words.group(early)} from {first:.4g} mm, more than an outer radius ({radius:.4g} mm) before "
            f"the farthest end ({farthest:.4g} mm): a cap inside a body that others bend is not modelled, and their walls "
            "take the thrust; state `thrust: walls`, or let them end together"
        )
    body = body_mass(robot)
    if body > 0 and robot.tip_mass > MOST_BODIES * body:
        yield (
            f"tip_mass is {robot.tip_mass:g} kg, {robot.tip_mass / body:.3g} times the body's mass of {body:.2g} kg: if it is in "
            "g, divide by 1000"
        )
    poisson = robot.youngs_modulus / (2 * robot.shear_modulus) - 1
    if robot.bending_stiffness is None and not LEAST_POISSON <= poisson <= MOST_POISSON:
        yield (
            f"shear_modulus {sized(robot.shear_modulus, 'Pa')} with youngs_modulus {sized(robot.youngs_modulus, 'Pa')} means a "
            f"Poisson's ratio of {poisson:.2g}, outside 0 to 0.5: rubber has a third of its youngs_modulus, "
            f"{sized(float(f'{robot.youngs_modulus / 3:.4g}'), 'Pa')}"
        )


def _replaced(robot: Robot, table: Table) -> Iterator[str]:
    """A warning if column tip_mass replaces a larger tip_mass of robot.yaml; a specimen that is pushed carries none."""
    masses = table.get("tip_mass")[~table.pushed]
    if (masses < robot.tip_mass).any():
        shown, least, most = (f"{1e3 * kg:.4g}" for kg in (robot.tip_mass, np.nanmin(masses), np.nanmax(masses)))
        yield (
            f"column tip_mass ({least} to {most} g) replaces the tip_mass of {shown} g of robot.yaml: does it include them? If "
            f"not, add {shown} g to the column (in map.yaml by its `zero`)"
        )


def _above(robot: Robot, table: Table) -> Iterator[str]:
    """A warning if the highest pressure of a table exceeds the robot's limit."""
    pressures, words = np.nan_to_num(table.pressures).max(axis=0, initial=0.0), robot.actuators.words
    column = int(np.argmax(pressures / robot.pressure_limits))
    highest, most = float(pressures[column]), float(robot.pressure_limits[column])
    if highest > ABOVE * most:
        shown, limit = words.number(highest), words.number(most)
        yield (
            f"column p{column + 1}: {shown} {words.unit}, {highest / most:.2g} times the max_{words.pressure} of {limit} "
            f"{words.unit} of robot.yaml: check the unit{differ_by(highest / most, words)}, or max_{words.pressure}"
        )


def _dead(robot: Robot, table: Table) -> Iterator[str]:
    """A warning for each pressure that is one value without noise in all states, where those of other actuators have noise."""
    pressures, words = table.pressures, robot.actuators.words
    noise = np.column_stack([table.get(f"sd_p{k}") for k in range(1, pressures.shape[1] + 1)])
    constant = ((np.abs(pressures - pressures[:1]) <= EQUAL) & (noise <= EQUAL)).all(axis=0)
    if len(table) and not constant.all() and (noise > EQUAL)[:, ~constant].mean(axis=0).min() > MOSTLY:
        for k in np.flatnonzero(constant & (pressures[0] != 0.0)).tolist():
            yield (
                f"column p{k + 1}: {pressures[0, k] / words.pascal:.3g} {words.unit} in all {len(table)} states without noise, "
                f"unlike the other {words.pressures}: check its sensor and cable; what {words.actuator} {k + 1} does is unknown"
            )
