"""From the regulators to the force and moment at the tip.

chamber pressure   relaxes exponentially towards its regulator (fill_time), never beyond the supply
dead band          Q(P) = (P0 / k) [log(1 + exp(k (P / P0 - 1))) - log(1 + exp(-k))],  k = 4
ballooning         A(P) = A (1 + b sign(P) |P / 250 kPa|^1.5)
tip                force sum_i A P_i e3, moment sum_i r_i x A P_i e3, turning with the tip (the paper's eq. 4)
cores              A_i = A (1 + g / 2 [cos(az_i - a) + 0.35 cos(2 az_i - b)])^2: the radius of a chamber follows its core
hoses              each third of the chambers, from -60, 60 and 180 deg on, hangs on the regulator of another
twist              chamber i lies at azimuth_i + c s (1 + 0.3 s / L); moments act where they change
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .directions import Directions
from .effects import Laws
from .truth import RobotTruth

Array = NDArray[np.float64]

DEADBAND_SHARPNESS = 4.0
BALLOON_POWER = 1.5
BALLOON_AT = 250e3
TWIST_GROWTH = 0.3
UNLIKE = 0.35
CONNECTED = 0.5
"""Size from which hoses are exchanged."""


class Pneumatics:
    """The chambers; pressures in Pa gauge, in the order of their numbers."""

    def __init__(self, truth: RobotTruth, laws: Laws, directions: Directions) -> None:
        self._truth = truth
        self._laws = laws
        # Drawn from the three that bend the paper's robot; another robot is bent by its first.
        self._chamber = directions.chamber if len(truth.chamber_azimuths_deg) == 9 else 0
        self._cores, self._hoses = directions.cores, directions.hoses
        self._azimuths = np.radians(np.array(truth.chamber_azimuths_deg)) + laws.chamber_azimuth
        self.reset()

    def reset(self) -> None:
        """All chambers at ambient."""
        self.seen = np.zeros(len(self._azimuths))
        """What the sensors read."""

    def step(self, regulator: Array, dt: float) -> None:
        """Fill or vent for dt seconds towards what the regulators drive to."""
        goal = np.clip(regulator, 0.0, self._truth.supply_pressure)
        self.seen = goal + (self.seen - goal) * math.exp(-dt / self._truth.fill_time)
        # a chamber within a hundredth of a pascal has arrived; otherwise nothing would ever be at rest
        self.seen = np.where(np.abs(self.seen - goal) < 0.01, goal, self.seen)

    @property
    def pressures(self) -> Array:
        """What is in the chambers."""
        p = self.seen.copy()
        if self._laws.pressure_offset:
            p = np.maximum(p + self._laws.pressure_offset, 0.0)
        if self._laws.chamber_order >= CONNECTED:
            p = p[self._exchanged()]
        if self._laws.chamber_leak:
            p[self._chamber] *= 1 - self._laws.chamber_leak
        return p

    def forces(self) -> Array:
        """Axial force of each chamber, N."""
        p = self.pressures
        if self._laws.pressure_deadband:
            k, p0 = DEADBAND_SHARPNESS, self._laws.pressure_deadband
            p = p0 / k * (np.logaddexp(0.0, k * (p / p0 - 1)) - math.log1p(math.exp(-k)))
        area = np.full(len(p), self._truth.chamber_area)
        if self._laws.chamber_ballooning:
            area = area * (1 + self._laws.chamber_ballooning * np.sign(p) * np.abs(p / BALLOON_AT) ** BALLOON_POWER)
        if self._laws.chamber_gain:
            place = np.radians(np.array(self._truth.chamber_azimuths_deg))
            off = np.cos(place - self._cores[0]) + UNLIKE * np.cos(2 * place - self._cores[1])
            area = area * (1 + self._laws.chamber_gain / 2 * off) ** 2
        if self._laws.weak_chamber:
            area[self._chamber] *= 1 - self._laws.weak_chamber
        return np.asarray(area * p)

    def azimuths(self, roll: float) -> Array:
        """Of the chambers, rad, with the robot rolled by so much."""
        return np.asarray(self._azimuths + roll)

    def _exchanged(self) -> NDArray[np.intp]:
        """Chamber whose regulator each chamber hangs on; thirds are numbered alike from their first chamber on."""
        place = np.mod(np.array(self._truth.chamber_azimuths_deg) + 60.0, 360.0)
        thirds = [np.flatnonzero((place // 120).astype(int) == k) for k in range(3)]
        thirds = [own[np.argsort(place[own])] for own in thirds]
        out = np.arange(len(place))
        for own, other in zip(thirds, (thirds[k] for k in self._hoses), strict=True):
            out[own] = other[np.arange(len(own)) % len(other)] if len(other) else own
        return out

    def wrench(self, roll: float, h: Array) -> tuple[Array, Array]:
        """Follower force at the tip (3) in N and follower moments at the nodes (n+1, 3) in N m, for segments of
        lengths h."""
        moments = np.zeros((len(h) + 1, 3))
        if self._truth.tendons:  # they act along the body, and press on nothing at its tip
            return np.zeros(3), moments
        forces, azimuths = self.forces(), self.azimuths(roll)
        path = self._truth.chamber_path_radius
        mx = path * float(np.sum(forces * np.sin(azimuths)))
        my = -path * float(np.sum(forces * np.cos(azimuths)))
        if self._laws.chamber_twist == 0.0 and self._truth.taper == 1.0:
            moments[-1, :2] = mx, my
        else:
            s = np.cumsum(h) - h / 2
            wound = self._laws.chamber_twist * s * (1 + TWIST_GROWTH * s / self._truth.length)
            mid = np.stack([mx * np.cos(wound) - my * np.sin(wound), mx * np.sin(wound) + my * np.cos(wound)], axis=1)
            mid *= (1 + (self._truth.taper - 1) * s / self._truth.length)[:, None]
            moments[1:, :2] = mid
            moments[1:-1, :2] -= mid[1:]
        return np.array([0.0, 0.0, float(forces.sum())]), moments
