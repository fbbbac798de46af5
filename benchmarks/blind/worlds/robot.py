"""The robot of the paper without any effect, and the rods that are solved beside one another. SI units."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LENGTH, OUTER, INNER = 0.40, 0.05, 0.029
DENSITY = 1300.0
MODULUS, SHEAR = 507_147.0, 169_049.0
GRAVITY = 9.81
SPINE_RADIUS = 0.029
SPINE_LENGTHS = (0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
SPINE_MODULI = (0.318e6, 1.323e6, 2.032e6, 3.069e6, 3.763e6, 4.389e6)
"""Table II of the paper: apparent modulus (Pa) over spine length (m), straight in between."""
NOMINAL_VACUUM = 80e3
CHAMBER_AREA = math.pi * 0.005**2
PATH_RADIUS = 0.04
AZIMUTHS = np.radians(40.0 * np.arange(9))
FULL = 250e3
"""Pa: the highest pressure of the paper's sweep."""
AREA = math.pi * (OUTER**2 - INNER**2)
SECOND = math.pi / 4 * (OUTER**4 - INNER**4)
SPINE_AREA = math.pi * SPINE_RADIUS**2
SPINE_SECOND = math.pi / 4 * SPINE_RADIUS**4
MARKERS = (0.1, 0.2, 0.3)


@dataclass(frozen=True)
class Places:
    """What the size of an effect leaves open: directions (rad), places and a chamber, drawn once for a robot."""

    tether: float = 0.0
    tilt: float = 0.0
    precurvature: float = 0.0
    marker: float = 0.0
    other: float = 0.0
    axis: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """Of the camera frame's turn, unit vector."""
    obstacle: float = 0.06
    """m from the axis to the obstacle's face."""
    chamber: int = 0
    """One of those inflated in the base sweep."""


def draw_places(rng: np.random.Generator) -> Places:
    """Directions and places at random."""
    a = rng.uniform(-np.pi, np.pi, 5)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    return Places(
        float(a[0]), float(a[1]), float(a[2]), float(a[3]), float(a[4]),
        (float(axis[0]), float(axis[1]), float(axis[2])),
        float(rng.uniform(0.04, 0.10)), int(rng.choice([8, 0, 1])),
    )  # fmt: skip


@dataclass(frozen=True)
class Lanes:
    """n rods that are solved together: states of one robot, with and without an effect."""

    spine: Array
    """(n,) m, as read."""
    area_factor: Array
    sizes: Mapping[str, Array]
    """(n,) of each effect, in its plausible scale."""
    places: Places
    vacuum: Array
    tip_mass: Array
    roll: Array
    """rad, the chamber pattern and the base turned about z."""
    length: Array
    """(n,) m of the body."""
    grown: Array
    """m of spine beyond what is read, in this trial."""
    jammed: Array
    """Stiffness of the spine relative to its usual one, in this trial."""
    tilt: Array
    """(n, 2) rad about x and y: how the base was mounted this time."""

    def __len__(self) -> int:
        return len(self.spine)


def lanes(
    spine: Array,
    sizes: Mapping[str, Array],
    places: Places,
    *,
    area_factor: float = 1.6,
    vacuum: float | Array = NOMINAL_VACUUM,
    tip_mass: float = 0.053,
    roll: float = 0.0,
    length: float = LENGTH,
) -> Lanes:
    """Lanes at one area factor, vacuum (Pa), mass (kg) and roll (rad), each as it is without trial-to-trial scatter."""
    n = len(spine)

    def each(value: float | Array) -> Array:
        return np.broadcast_to(np.asarray(value, float), (n,)).copy()

    return Lanes(
        np.asarray(spine, float), each(area_factor), sizes, places, each(vacuum), each(tip_mass), each(roll),
        each(length), each(0.0), each(1.0), np.zeros((n, 2)),
    )  # fmt: skip
