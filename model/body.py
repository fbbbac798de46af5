"""The body along its arc: sections of their own where robot.yaml has them, as pieces that the rod's elements are made of.

A section is known by its geometry and its material, or by what it does: EI, EA, GJ and mass per length. Both come to the same
few numbers a piece, referred to the robot's Young's modulus E and density rho, so that a body that is softer or heavier than
drawn is so everywhere:
    A = EA / E,  I = EI / E,  J = (stiffness against torsion) / E,  A_w = (mass per length) / rho.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from model.robot import Robot
from model.sections import Section

Array = NDArray[np.float64]
Number = TypeVar("Number", float, Array)

PIECES = 6
"""Of a whole body that tapers; each has the mean compliance of its length."""
NODES, WEIGHTS = (0.5 * (a + b) for a, b in zip(np.polynomial.legendre.leggauss(3), (1.0, 0.0), strict=True))
"""Of a quadrature over 0..1."""


@dataclass(frozen=True)
class Body:
    """k pieces from base to tip, each with one section; all (k,) unless said otherwise."""

    edges: Array
    """(k + 1,) m, where pieces begin and end."""
    area: Array
    """m^2, EA / E."""
    second: Array
    """m^4, EI / E about a diameter."""
    polar: Array
    """m^4, stiffness against torsion / E; 2 I where it is not given (the paper's eq. 3 has E there)."""
    weight_area: Array
    """m^2, mass per length / density."""
    outer_radius: Array
    """m."""
    chamber_area: Array
    """(k, actuators) m^2 of each chamber, geometric, 0 where it has ended; of tendons negative, see `Tendons.area`."""
    path_radius: Array
    """m."""
    tip_area: Array
    """(actuators,) m^2 with which the tip is pushed; none of tendons, which act along the arc alone."""

    def __len__(self) -> int:
        return len(self.area)

    @property
    def length(self) -> Array:
        """(k,) m."""
        return np.diff(self.edges)

    @property
    def mean_area(self) -> float:
        """m^2 of a uniform body that a pull stretches as much: 1 / mean(1 / A)."""
        return float(self.length.sum() / (self.length / self.area).sum())

    @property
    def mean_second(self) -> float:
        """m^4 of a uniform body that a moment turns as much: 1 / mean(1 / I)."""
        return float(self.length.sum() / (self.length / self.second).sum())

    @property
    def mean_weight_area(self) -> float:
        """m^2 of a uniform body that weighs as much."""
        return float(self.length @ self.weight_area / self.length.sum())

    @property
    def mean_chamber_area(self) -> Array:
        """(actuators,) m^2 over the body's length."""
        return np.asarray(self.length @ self.chamber_area / self.length.sum())

    @property
    def mean_arm(self) -> Array:
        """(actuators,) m^3, chamber area times path radius, over the body's length."""
        return np.asarray((self.length * self.path_radius) @ self.chamber_area / self.length.sum())


def annulus_second_moment(outer_radius: Number, inner_radius: Number | float = 0.0) -> Number:
    """I = pi (ro^4 - ri^4) / 4 about a diameter (m^4), radii in m; a solid round bar with inner_radius 0."""
    return math.pi / 4 * (outer_radius**4 - inner_radius**4)


def body_of(robot: Robot) -> Body:
    """The pieces of a robot's body; a uniform one has a single piece. Pieces end where sections do, chambers and tendons."""
    edges, values = [0.0], []
    ends = np.array(robot.actuators.ends or (robot.length,) * len(robot.actuators.azimuths_deg))
    start = 0.0
    for part in robot.sections or (Section(length=robot.length),):
        cuts = max(1, math.ceil(PIECES * part.length / robot.length)) if part.tapers else 1
        shares = [k / cuts for k in range(cuts)] + [(end - start) / part.length for end in ends]
        shares = [*sorted({round(x, 9) for x in shares if 0.0 <= x < 1.0 - 1e-9}), 1.0]
        for low, high in itertools.pairwise(shares):
            edges.append(start + high * part.length)
            values.append(_piece(robot, part, low + (high - low) * NODES))
        start += part.length
    edges[-1] = robot.length
    stretch, bend, twist, weight, outer, chamber, path = np.array(values).T
    reached = np.array(edges)[:-1, None] < ends[None, :] - 1e-9
    area = reached * chamber[:, None]
    at_tip = area[-1] if robot.tendons is None else np.zeros(len(ends))
    return Body(np.array(edges), stretch, bend, twist, weight, outer, area, path, at_tip)


def _piece(robot: Robot, part: Section, share: Array) -> tuple[float, ...]:
    """The fields of `Body` over the shares (m,) of a section: mean compliances, and means of all that is not stiffness."""

    def along(name: str, otherwise: float | Array) -> Array:
        stated = part.at(name, share)
        return np.broadcast_to(otherwise, share.shape) if stated is None else stated

    def known(name: str, otherwise: Array) -> Array:
        """A stiffness or mass that the section or the robot gives, over what makes it one of geometry; else that."""
        drawn = any(getattr(part, n) is not None for n in ("outer_radius", "inner_radius", own_material[name]))
        given = getattr(robot, name)
        over = robot.density if name == "mass_per_length" else robot.youngs_modulus
        return along(name, otherwise * over if given is None or drawn else given) / over

    own_material = dict.fromkeys(("bending_stiffness", "axial_stiffness", "torsional_stiffness"), "youngs_modulus")
    own_material["mass_per_length"] = "density"
    outer, inner = along("outer_radius", robot.outer_radius), along("inner_radius", robot.inner_radius)
    modulus = along("youngs_modulus", robot.youngs_modulus) / robot.youngs_modulus
    area, second = math.pi * (outer**2 - inner**2), annulus_second_moment(outer, inner)
    axial = known("axial_stiffness", modulus * area)
    bending = known("bending_stiffness", modulus * second)
    torsion = known("torsional_stiffness", 2 * bending)
    dense = along("density", robot.density) / robot.density if robot.density > 0 else np.ones(share.shape)
    line = known("mass_per_length", dense * area) if robot.density > 0 else area
    stated = part.at("chamber_radius", share)
    chamber = np.full(share.shape, robot.actuators.area) if stated is None else math.pi * stated**2
    path = along("path_radius", robot.actuators.path_radius)
    stretch, bend, twist = (1 / float(WEIGHTS @ (1 / x)) for x in (axial, bending, torsion))
    # What chambers do to a section goes with its compliance, so theirs are means weighted by it.
    pushed = stretch * float(WEIGHTS @ (chamber / axial))
    arm = bend * float(WEIGHTS @ (chamber * path / bending))
    radius = arm / pushed if pushed else float(WEIGHTS @ path)
    return (stretch, bend, twist, float(WEIGHTS @ line), float(WEIGHTS @ outer), pushed, radius)
