"""The stiffness stand: a specimen clamped at its base, and the arm's probe that pushes it sideways.

The probe is a flat frictionless face: it pushes along the specimen's +x, at the arc length that equals its z
coordinate (at the tip when it is a little beyond). It touches the specimen's flank, one radius from the axis. The bare
spine is an Euler-Bernoulli cantilever without weight, F = 3 E I y / L^3 at small deflection; with `spine_shear` its
shear stiffness is finite.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .balance import contact_force
from .chain import Chain, ChainLoads
from .effects import Laws
from .material import Sections, approach, without_friction
from .rod import ChainRod
from .spine import SHEAR_STIFFNESS, VirtualSpine
from .truth import RobotTruth

Array = NDArray[np.float64]

SHORTEST_SPINE = 0.02
"""m; a shorter spine offers nothing to push on."""
BIAS_RISE, BIAS_FALL = 0.2, 20.0
"""s in which the force sensor's zero moves when loaded, and returns."""

SOFT_STIFFNESS = 150.0
"""N/m of the soft layer that is squeezed before the probe meets the specimen."""
NO_CONTACT = np.zeros((0, 9))


class BareSpine:
    """The spine alone as a rod of its own length."""

    def __init__(self, truth: RobotTruth, laws: Laws) -> None:
        self._truth = truth
        self._laws = laws
        self._length = SHORTEST_SPINE
        self.rod = ChainRod(np.full(truth.segments, self._length / truth.segments))

    @property
    def present(self) -> bool:
        """True when there is enough spine to push on."""
        return self._length > SHORTEST_SPINE

    def fit(self, spine: VirtualSpine) -> None:
        """Take over the spine's true length; a new length starts straight."""
        length = max(spine.true_length, SHORTEST_SPINE)
        if abs(length - self._length) > 1e-9:
            self._length = length
            self.rod = ChainRod(np.full(self._truth.segments, length / self._truth.segments))

    def sections(self, spine: VirtualSpine, dt: float) -> Sections:
        """Material during a step of dt seconds."""
        n, radius, area = self._truth.segments, self._truth.spine_radius, self._truth.spine_area
        jamming = max(spine.jamming, 2e-3)  # an unjammed spine keeps a shape
        e = jamming * spine.modulus
        # a spine that does not shear adds below 3e-4 to its compliance
        shear = area / (1 / (1e3 * e) + self._laws.spine_shear / (jamming * SHEAR_STIFFNESS))
        inertia = math.pi / 4 * radius**4
        stiffness = np.array([shear, shear, e * area, e * inertia, e * inertia, 2 * e * inertia])
        return without_friction(np.tile(stiffness, (n, 1)), approach(dt, self._truth.settling_time))

    def loads(self, contacts: Array) -> ChainLoads:
        """Nothing but the probe."""
        n = self._truth.segments
        clamp = np.array([1.0, 0.0, 0.0, 0.0])
        return ChainLoads(np.zeros((n + 1, 3)), np.zeros(3), np.zeros((n + 1, 3)), np.zeros(4), contacts, clamp)


class VirtualStand:
    """Contact between probe and specimen, and what the force sensor makes of it."""

    def __init__(self, truth: RobotTruth, laws: Laws) -> None:
        pose = np.array(truth.stand)
        self._rotation, self._origin = pose[:3, :3], pose[:3, 3]
        if not np.allclose(self._rotation @ self._rotation.T, np.eye(3), atol=1e-6):
            raise ValueError("virtual robot: the upper left 3 x 3 of stand must be a rotation matrix")
        self._soft_depth = max(laws.contact_offset, 0.0)
        self._stiffness = 1 / (1 / truth.contact_stiffness + max(laws.arm_compliance, 0.0))
        self._bias_size = laws.force_bias
        self.reset()

    def reset(self) -> None:
        """Unloaded sensor."""
        self._bias = 0.0

    def reaches(self, chain: Chain, radius: float, probe: Array) -> tuple[float, float] | None:
        """Level (m, specimen x of the axis) and arc length (m) of a probe position in the arm base frame; None: misses."""
        x, y, z = self._rotation.T @ (probe - self._origin)
        length = float(chain.h.sum())
        # the probe still meets the specimen 2 cm beyond its end
        if not 0.005 < z < length + 0.02 or abs(y) > radius:
            return None
        return float(x) + radius, min(float(z), length)

    def contacts(self, chain: Chain, level: float, at: float) -> Array:
        """Contact row for `chain.Loads`: the axis at arc length `at` (m) is pushed to x = level (m)."""
        s = np.concatenate([[0.0], np.cumsum(chain.h)])
        k = min(max(int(np.searchsorted(s, at)) - 1, 0), len(chain.h) - 1)
        weight = min((at - s[k]) / chain.h[k], 1.0)
        return np.array([[k, weight, 1.0, 0.0, 0.0, level, self._soft_depth, SOFT_STIFFNESS, self._stiffness]])

    @staticmethod
    def force(chain: Chain, contacts: Array) -> float:
        """Contact force now, N, 0 or above."""
        total = 0.0
        for k, w, nx, ny, nz, level, soft_depth, soft, stiff in contacts:
            point = (1 - w) * chain.r[int(k)] + w * chain.r[int(k) + 1]
            total += contact_force(level - float(point @ (nx, ny, nz)), soft_depth, soft, stiff)[0]
        return total

    def sensed(self, force: float, dt: float) -> float:
        """Force as the sensor reports it after dt seconds, N: its zero moves while it is loaded."""
        if self._bias_size:
            goal, time = (self._bias_size, BIAS_RISE) if force > 0.02 else (0.0, BIAS_FALL)
            self._bias = goal + (self._bias - goal) * math.exp(-dt / time)
        return force + self._bias

    def on_probe(self, force: float) -> Array:
        """Force of the specimen on the probe, N (3), arm base frame, from its size along the specimen's x."""
        return np.asarray(self._rotation @ np.array([-force, 0.0, 0.0]))
