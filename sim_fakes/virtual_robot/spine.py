"""The growing spine: its length, its vacuum, how stiff it is jammed.

vacuum            relaxes exponentially towards the pump (pump_time) or ambient (release_time)
jamming(v)        s (1 + c) / (s + c),  s = v / nominal vacuum,  c = 0.9: 1 at nominal, near a square root in between
modulus           Table II at the true length, times jamming, times what this jamming event drew
blocked           vacuum above the jam threshold holds the spine where it is
"""

from __future__ import annotations

import math

import numpy as np

from .effects import Laws
from .truth import RobotTruth

SHEAR_STIFFNESS = 0.09e6
"""Pa: the one modulus of the spine and its shear modulus times shear factor, at full `spine_shear`."""
GAUGE_SHARE = 0.8
"""Share of a vacuum leak that the gauge at the unit sees; the rest is lost along the spine."""


def table_modulus(truth: RobotTruth, length: float) -> float:
    """Apparent modulus of the spine at nominal vacuum, Pa, at a length in m."""
    lengths = sorted(truth.spine_modulus)
    values = [truth.spine_modulus[x] for x in lengths]
    if length > lengths[-1]:
        slope = (values[-1] - values[-2]) / (lengths[-1] - lengths[-2])
        return values[-1] + slope * (length - lengths[-1])
    return float(np.interp(length, lengths, values))


class VirtualSpine:
    """State of the spine; lengths in m, vacuum in Pa below ambient."""

    def __init__(self, truth: RobotTruth, laws: Laws, seed: int) -> None:
        self._truth = truth
        self._laws = laws
        self._seed = seed
        self.reset()

    def reset(self) -> None:
        """No spine out, no vacuum, and the same scatter to come as after construction."""
        self._rng = np.random.default_rng([self._seed, 2])
        self.length = 0.0
        self.vacuum = 0.0
        self.blocked = False
        self._jammed = False
        self._length_error = 0.0
        self._stiffness_factor = 1.0

    def step(self, drive: float, valve_on: bool, supply: float, dt: float) -> None:
        """Follow the unit (drive: m paid out) and the valve for dt seconds; `supply`: vacuum level of the pump, Pa."""
        t = self._truth
        goal, time = (self._pumped(supply), t.pump_time) if valve_on else (0.0, t.release_time)
        self.vacuum = goal + (self.vacuum - goal) * math.exp(-dt / time)
        self._lock_or_release()
        drive = max(0.0, drive)
        if self._jammed:
            self.blocked = abs(drive - self.length) > 5e-4  # m beyond a held spine at which the motor counts as stalled
        else:
            self.blocked = False
            step = 0.15 * dt  # m/s at which the spine catches up with the drive once it is free
            self.length += min(max(drive - self.length, -step), step)

    def place(self, length: float, vacuum: float) -> None:
        """Grow to a length without vacuum, then jam at a vacuum, at once."""
        self.vacuum = 0.0
        self._lock_or_release()
        self.length = length
        self.draw(vacuum)

    def draw(self, vacuum: float) -> None:
        """Bring a spine of the present length to a vacuum, at once; a leak keeps it from getting there."""
        self.vacuum = vacuum if self._laws.vacuum_leak == 0.0 else vacuum * (1 - GAUGE_SHARE * self._leak())
        self._lock_or_release()

    def _lock_or_release(self) -> None:
        """Draw this jamming's scatter when the granules lock; forget that they were locked when the vacuum is gone."""
        threshold = self._truth.jam_threshold
        if not self._jammed and self.vacuum > threshold:
            length, stiffness = self._rng.normal(size=2)
            self._length_error = self._truth.scatter_length * float(length)
            self._stiffness_factor = max(0.3, 1 + self._truth.scatter_stiffness * float(stiffness))
            self._jammed = True
        elif self._jammed and self.vacuum < 0.7 * threshold:
            self._jammed = False
            self._length_error, self._stiffness_factor = 0.0, 1.0

    def _leak(self) -> float:
        """Lost share of the vacuum; a longer spine leaks more, the effect's size holds at 15 cm."""
        return min(self._laws.vacuum_leak * (0.7 + 0.3 * self.true_length / 0.15), 0.95)

    def _pumped(self, supply: float) -> float:
        """Vacuum the pump reaches at the gauge, Pa."""
        return supply * (1 - GAUGE_SHARE * self._leak()) if self._laws.vacuum_leak else supply

    @property
    def jammed(self) -> bool:
        """True while the granules are locked."""
        return self._jammed

    @property
    def true_length(self) -> float:
        """Length inside the body, m."""
        return max(0.0, self.length + (self._length_error if self.length > 0 else 0.0))

    @property
    def jamming(self) -> float:
        """Jammed stiffness relative to nominal."""
        share = self.vacuum / self._truth.nominal_vacuum
        if self._laws.vacuum_leak:
            share *= (1 - self._leak()) / (1 - GAUGE_SHARE * self._leak())
        return share * (1 + 0.9) / (share + 0.9) * self._stiffness_factor

    @property
    def modulus(self) -> float:
        """Bending modulus at nominal vacuum, Pa."""
        table, blend = table_modulus(self._truth, self.true_length), self._laws.spine_shear
        return table if blend == 0.0 else 1 / ((1 - blend) / table + blend / 6.6e6)

    @property
    def shear_modulus(self) -> float:
        """Shear modulus times shear factor inside the body at nominal vacuum, Pa."""
        stiff, blend = self._truth.shear_ratio * table_modulus(self._truth, self.true_length), self._laws.spine_shear
        return stiff if blend == 0.0 else 1 / ((1 - blend) / stiff + blend / SHEAR_STIFFNESS)
