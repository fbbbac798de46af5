"""The soft body with the spine inside: its material and its loads during one step.

Paper: modulus of the covered part by volume, E = Vc Ec + Vs Es, on the annulus; Kse = (GA, GA, EA), Kbt = (EI, EI, E
2I), weight of the body, mass at the tip. With `area_moment` b the spine's part is (1-b) Vs (A, I of the annulus) + b
(A, I of the spine's disc) and the silicone's share rises from Vc to 1. A spine without vacuum neither stiffens nor
displaces silicone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .chain import ChainLoads
from .effects import Directions, Laws
from .material import SLIP_CURVATURES, SLIP_SHARES, SLIP_STRAINS, Sections, approach
from .rod import ChainRod, mesh
from .spine import VirtualSpine
from .truth import RobotTruth

Array = NDArray[np.float64]


class VirtualBody:
    """The silicone body as a rod; `hanging` False is the stiffness stand (no tilt, no tether)."""

    def __init__(self, truth: RobotTruth, laws: Laws, directions: Directions, hanging: bool) -> None:
        self._truth = truth
        self._laws = laws
        self._directions = directions
        self._hanging = hanging
        h, self._cover = mesh(truth.length, truth.segments, 0.0)
        self.rod = ChainRod(h)

    def fit(self, spine: VirtualSpine) -> None:
        """Take over the spine's length."""
        h, self._cover = mesh(self._truth.length, self._truth.segments, min(spine.true_length, self._truth.length))
        self.rod.remesh(h)

    def sections(self, spine: VirtualSpine, dt: float) -> Sections:
        """Material during a step of dt seconds."""
        truth, laws, n = self._truth, self._laws, self._truth.segments
        jamming = spine.jamming
        x = min(jamming / 0.3, 1.0)  # from a relative jamming of 0.3 on, the spine has fully taken its share of the section
        volume_share = truth.spine_area / (truth.area + truth.spine_area)
        share_taken = (1 - laws.area_moment) * volume_share * x * x * (3 - 2 * x)
        shape = np.array([truth.area * truth.shear_ratio] * 2 + [truth.area] + [truth.second_moment] * 2 + [truth.torsion])
        silicone = truth.youngs_modulus * (1 - share_taken * self._cover)
        slip_moment = np.zeros((n, len(SLIP_CURVATURES)))
        slip_force = np.zeros((n, len(SLIP_STRAINS)))
        if laws.spine_slip and spine.jammed:
            h = self.rod.chain.h
            to_end = np.maximum(spine.true_length - (np.cumsum(h) - h / 2), 0.0)  # m, of each segment's middle
            fade = np.minimum(to_end / 0.03, 1.0)  # friction fades over 3 cm before the spine's end
            slip_moment = np.outer(fade, laws.spine_slip * jamming * np.array(SLIP_SHARES))
            # 20 / 0.15: N/m of friction force per N m of friction moment
            slip_force += ((20.0 / 0.15) * laws.spine_slip * jamming / len(SLIP_STRAINS) * to_end)[:, None]
        return Sections(
            stiffness=np.outer(silicone, shape) + np.outer(self._cover, self._spine_stiffness(spine, volume_share)),
            slip_moment=slip_moment,
            slip_force=slip_force,
            viscosity=approach(dt, truth.settling_time),
            slips=laws.spine_slip > 0.0,
        )

    def _spine_stiffness(self, spine: VirtualSpine, volume_share: float) -> Array:
        """(6) stiffness of a fully covered segment, laid out as `Sections.stiffness`."""
        truth, b = self._truth, self._laws.area_moment
        e, g = spine.jamming * spine.modulus, spine.jamming * spine.shear_modulus
        area = (1 - b) * volume_share * truth.area + b * truth.spine_area
        inertia = (1 - b) * volume_share * truth.second_moment + b * math.pi / 4 * truth.spine_radius**4
        return np.array([g * area, g * area, e * area, e * inertia, e * inertia, 2 * e * inertia])

    def loads(self, follower_force: Array, follower_moment: Array, tip_mass: float, contacts: Array) -> ChainLoads:
        """Loads now: chamber wrench (N, N m), mass at the tip (kg), contacts of the stand."""
        truth, laws = self._truth, self._laws
        h = self.rod.chain.h
        gravity = np.array(truth.gravity if self._hanging else truth.stand_gravity)
        segment_mass = truth.line_density * h
        mass = np.zeros(len(h) + 1)
        mass[1:] += segment_mass / 2
        mass[:-1] += segment_mass / 2
        mass[-1] += tip_mass
        force = mass[:, None] * gravity
        spring, base = np.array([0.0, 0.0, 0.0, truth.length]), np.array([1.0, 0.0, 0.0, 0.0])
        if self._hanging:
            if laws.tether_load:
                azimuth = self._directions.tether
                force[-1, :2] += laws.tether_load * np.array([math.cos(azimuth), math.sin(azimuth)])
                spring[0] = abs(laws.tether_load) / 0.3  # m of tip motion that takes the tether's force to zero
            azimuth, half = self._directions.tilt, laws.base_tilt / 2
            base = np.array([math.cos(half), -math.sin(azimuth) * math.sin(half), math.cos(azimuth) * math.sin(half), 0.0])
        return ChainLoads(force, follower_force, follower_moment, spring, contacts, base)
