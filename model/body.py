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
from functools import cached_property
from typing import TypeVar

import numpy as np

from model.arrays import Array
from model.robot import Robot
from model.sections import Section

Number = TypeVar("Number", float, Array)

PIECES = 6
"""Of a whole body that tapers; each has the mean compliance of its length."""
CAP_REACH = 1.0
"""Outer radii before the end of the chamber that reaches farthest within which others push on the same cap: over about as much a
force spreads in a section (Saint-Venant), and a rod does not resolve where it acts."""
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
    """m^4, GJ / E; where it is not given 2 I, as eq. 3 of the paper has E for G, but with thrust on the walls 2 I G / E."""
    weight_area: Array
    """m^2, mass per length / density."""
    outer_radius: Array
    """m."""
    chamber_area: Array
    """(k, actuators) m^2 of each chamber, geometric, 0 where it has ended; of tendons negative, see `Actuators.area`."""
    path_radius: Array
    """m, the mean of the actuators."""
    levers: Array
    """(actuators,) distance of each from the axis over that mean."""

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

    @cached_property
    def ended(self) -> Array:
        """(actuators,) m where each ends, 0 where it acts nowhere."""
        acts = self.chamber_area != 0
        return np.asarray(self.edges[len(self) - np.argmax(acts[::-1], axis=0)] * acts.any(axis=0))

    @cached_property
    def tip_area(self) -> Array:
        """(actuators,) m^2 with which a cap is pushed. No chamber bends what lies beyond it, so that a force along the tip is one
        along the cap. 0 of chambers that end before (`uncapped`), and of tendons, which act along the arc alone."""
        capped = self.ended >= self.ended.max() - CAP_REACH * self.outer_radius[-1]
        at_end = self.chamber_area[np.searchsorted(self.edges, self.ended) - 1, np.arange(len(self.ended))]
        return np.maximum(capped * at_end, 0.0)

    @property
    def uncapped(self) -> list[int]:
        """Numbers, from 1, of chambers beyond whose end others go on bending the body: their side walls take the thrust."""
        return (np.flatnonzero((self.ended > 0) & (self.tip_area == 0)) + 1).tolist()

    def mean(self, values: Array) -> Array:
        """The mean over the body's length of values (k, ..) of its pieces."""
        return np.asarray(self.length @ values / self.length.sum())


def annulus_second_moment(outer_radius: Number, inner_radius: Number | float = 0.0) -> Number:
    """I = pi (ro^4 - ri^4) / 4 about a diameter (m^4), radii in m; a solid round bar with inner_radius 0."""
    return math.pi / 4 * (outer_radius**4 - inner_radius**4)


def body_of(robot: Robot) -> Body:
    """Cut a robot's body into pieces where sections and actuators end, tapering sections finer; a uniform one is one piece."""
    edges, values = [0.0], []
    ends = np.array(robot.actuators.ends or (robot.length,) * len(robot.actuators.azimuths_deg))  # m, of the actuators
    start = 0.0
    for part in robot.sections or (Section(length=robot.length),):
        cuts = max(1, math.ceil(PIECES * part.length / robot.length)) if part.tapers else 1
        inner = [k / cuts for k in range(cuts)] + [(end - start) / part.length for end in ends]
        shares = [*sorted({round(x, 9) for x in inner if 0.0 <= x < 1.0 - 1e-9}), 1.0]  # of the section, where pieces meet
        for low, high in itertools.pairwise(shares):
            edges.append(start + high * part.length)
            values.append(_piece(robot, part, low + (high - low) * NODES))
        start += part.length
    edges[-1] = robot.length
    stretch, bend, twist, weight, outer, chamber, path = np.array(values).T
    acts = np.array(edges)[:-1, None] < ends[None, :] - 1e-9
    area = acts * chamber[:, None] * robot.actuators.shares
    return Body(np.array(edges), stretch, bend, twist, weight, outer, area, path, robot.actuators.levers)


def _piece(robot: Robot, part: Section, share: Array) -> tuple[float, ...]:
    """Fields of `Body`, area to path_radius: means over a piece at shares 0..1 (m,) of a section, stiffnesses by compliance."""

    def along(name: str, otherwise: float | Array) -> Array:
        """The section's own value at the shares, `otherwise` where it has none."""
        stated = part.at(name, share)
        return np.broadcast_to(otherwise, share.shape) if stated is None else stated

    def referred(name: str, from_geometry: Array) -> Array:
        """Stiffness / E or mass per length / density: the section's own, else the robot's unless the section has its own radii or
        material, else `from_geometry`."""
        redrawn = any(getattr(part, n) is not None for n in ("outer_radius", "inner_radius", material[name]))
        of_robot = getattr(robot, name)
        unit = robot.density if name == "mass_per_length" else robot.youngs_modulus
        return along(name, from_geometry * unit if of_robot is None or redrawn else of_robot) / unit

    material = dict.fromkeys(("bending_stiffness", "axial_stiffness", "torsional_stiffness"), "youngs_modulus")
    material["mass_per_length"] = "density"
    outer, inner = along("outer_radius", robot.outer_radius), along("inner_radius", robot.inner_radius)
    modulus = along("youngs_modulus", robot.youngs_modulus) / robot.youngs_modulus
    area, second = math.pi * (outer**2 - inner**2), annulus_second_moment(outer, inner)
    axial = referred("axial_stiffness", modulus * area)
    bending = referred("bending_stiffness", modulus * second)
    shear = robot.shear_modulus / robot.youngs_modulus if robot.thrust == "walls" else 1.0
    torsion = referred("torsional_stiffness", 2 * bending * shear)
    weighing = area
    if robot.density > 0:
        weighing = referred("mass_per_length", along("density", robot.density) / robot.density * area)
    chamber_radius = part.at("chamber_radius", share)
    chamber = np.full(share.shape, robot.actuators.area) if chamber_radius is None else math.pi * chamber_radius**2
    path = along("path_radius", float(np.mean(robot.actuators.path_radius)))
    stretch, bend, twist = (1 / float(WEIGHTS @ (1 / x)) for x in (axial, bending, torsion))
    # Chambers act on a section in proportion to its compliance, so their areas and radii are means weighted by it.
    pushed = stretch * float(WEIGHTS @ (chamber / axial))
    arm = bend * float(WEIGHTS @ (chamber * path / bending))
    radius = arm / pushed if pushed else float(WEIGHTS @ path)
    return (stretch, bend, twist, float(WEIGHTS @ weighing), float(WEIGHTS @ outer), pushed, radius)
