"""Units of force and deflection in stiffness trials, judged by the beam F = 3 E I d / L^3:

    p(unit) ~ prior exp(-ln^2(m) / 2 s^2),    m: slope of F over d in this unit, over the slope expected,

and s, by specimen: how far from robot.yaml its modulus may be.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import softmax

from model.robot import Robot
from model.section import annulus_second_moment, body_second_moment
from recordings.trials import Table

from .. import judgement
from ..data.pushes import SHORTEST, cantilevers, complete
from ..data.units import FORCE_UNITS, LENGTH_UNITS
from ..findings import Finding, finding

UNITS = [*(("force", "N", unit) for unit in FORCE_UNITS), *(("deflection", "m", unit) for unit in LENGTH_UNITS)]
PRIOR, MODULUS_SD = 0.01, {"body": np.log(3.0), "spine": np.log(6.0)}
"""Of each unit; s: a body's modulus is known within a few, a jammed spine's may be a guess."""
FOLLOWS = 0.9
"""Correlation of force and deflection from which there is a slope."""


def wrong_units(robot: Robot, table: Table) -> Iterator[Finding]:
    """The units that forces and deflections probably have, where these are not N and m."""
    trials = table.take(complete(table))
    for specimen, sd in MODULUS_SD.items():
        own = trials.take((trials.get("specimen") == specimen) & (cantilevers(robot, trials) >= SHORTEST))
        if not (ratio := _stiffness_ratio(robot, own, specimen)) > 0:
            continue
        factors = np.array([1.0, *(unit.per_si if column == "force" else 1 / unit.per_si for column, _, unit in UNITS)])
        prior = np.log([1 - PRIOR * len(UNITS), *[PRIOR] * len(UNITS)])
        p = softmax(prior - np.log(ratio / factors) ** 2 / (2 * sd**2))
        if p[0] > 1 - judgement.CAUSE_PROBABILITY:
            continue
        column, si, unit = UNITS[int(np.argmax(p[1:]))]
        largest = int(np.argmax(np.abs(own.get(column))))
        yield finding(
            "stiffness_unit", place=own.place(largest), column=column, value=float(own.get(column)[largest]), si=si,
            looks=unit.name, p=float(p[1:].max()), ratio=ratio, remedy=unit.remedy,
        )  # fmt: skip


def _stiffness_ratio(robot: Robot, own: Table, specimen: str) -> float:
    """Slope of force over deflection, of 3 E I / L^3; 0 where they do not follow each other, or the robot has no spine."""
    long, force, deflection = cantilevers(robot, own), own.get("force"), own.get("deflection")
    if specimen == "body":
        bending = np.full(len(own), robot.youngs_modulus * body_second_moment(robot))
    elif robot.spine is not None:
        bending = robot.spine.modulus_at(long) * annulus_second_moment(robot.spine.radius)
    else:
        return 0.0
    expected = 3 * bending / long**3 * deflection
    if len(own) < judgement.EDIT_FEWEST or np.ptp(expected) == 0 or np.ptp(force) == 0:
        return 0.0
    return abs(float(np.polyfit(expected, force, 1)[0])) if abs(np.corrcoef(force, expected)[0, 1]) > FOLLOWS else 0.0
