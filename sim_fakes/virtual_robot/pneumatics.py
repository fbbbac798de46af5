"""From the regulators to the force and moment at the tip.

chamber pressure   relaxes exponentially towards its regulator (fill_time), never beyond the supply
ballooning         A(P) = A (1 + b sign(P) |P / 250 kPa|^1.5)
tip                force sum_i A P_i e3, moment sum_i r_i x A P_i e3, turning with the tip (the paper's eq. 4)
twist              chamber i lies at azimuth_i + c s (1 + 0.3 s / L); moments act where they change
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .effects import Laws
from .truth import RobotTruth

Array = NDArray[np.float64]


class Pneumatics:
    """The chambers; pressures in Pa gauge, in the order of their numbers."""

    def __init__(self, truth: RobotTruth, laws: Laws) -> None:
        self._truth = truth
        self._laws = laws
        self._azimuths = np.radians(np.array(truth.chamber_azimuths_deg)) + laws.chamber_azimuth
        self.reset()

    def reset(self) -> None:
        """All chambers at ambient."""
        self.pressures = np.zeros(len(self._azimuths))

    def step(self, regulator: Array, dt: float) -> None:
        """Fill or vent for dt seconds towards what the regulators drive to."""
        goal = np.clip(regulator, 0.0, self._truth.supply_pressure)
        self.pressures = goal + (self.pressures - goal) * math.exp(-dt / self._truth.fill_time)
        # a chamber within a hundredth of a pascal has arrived; otherwise nothing would ever be at rest
        self.pressures = np.where(np.abs(self.pressures - goal) < 0.01, goal, self.pressures)

    def forces(self) -> Array:
        """Axial force of each chamber, N."""
        p, area = self.pressures, np.full(len(self.pressures), self._truth.chamber_area)
        if self._laws.chamber_ballooning:
            area = area * (1 + self._laws.chamber_ballooning * np.sign(p) * np.abs(p / 250e3) ** 1.5)
        return np.asarray(area * p)

    def wrench(self, roll: float, h: Array) -> tuple[Array, Array]:
        """Follower force at the tip (3) in N and follower moments at the nodes (n+1, 3) in N m, for segments of
        lengths h and the robot rolled by so much (rad)."""
        moments = np.zeros((len(h) + 1, 3))
        forces, azimuths = self.forces(), self._azimuths + roll
        path = self._truth.chamber_path_radius
        mx = path * float(np.sum(forces * np.sin(azimuths)))
        my = -path * float(np.sum(forces * np.cos(azimuths)))
        if self._laws.chamber_twist == 0.0:
            moments[-1, :2] = mx, my
        else:
            s = np.cumsum(h) - h / 2
            wound = self._laws.chamber_twist * s * (1 + 0.3 * s / self._truth.length)
            mid = np.stack([mx * np.cos(wound) - my * np.sin(wound), mx * np.sin(wound) + my * np.cos(wound)], axis=1)
            moments[1:, :2] = mid
            moments[1:-1, :2] -= mid[1:]
        return np.array([0.0, 0.0, float(forces.sum())]), moments
