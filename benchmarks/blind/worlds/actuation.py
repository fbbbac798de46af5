"""Forms of the effects of the chambers: pressures, areas, azimuths, winding, and where the thrust acts.

x (n,) is the size in the unit of the form, P in Pa, p = P / 250 kPa.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .gas import GasChambers
from .robot import FULL

Array = NDArray[np.float64]


# ------------------------------------------------------------------ pressure_offset
def regulator_leak(c: GasChambers, x: Array) -> None:
    """P + x tanh(P / 80 kPa): a regulator that is open leaks through, a chamber that is vented holds nothing."""
    c.pressures.append(lambda p: p + x[:, None] * np.tanh(np.maximum(p, 0.0) / 80e3))


def falling_offset(c: GasChambers, x: Array) -> None:
    """P + x (1 - p / 2) in all chambers: a zero off with a span that was set at the top."""
    c.pressures.append(lambda p: p + x[:, None] * (1 - 0.5 * p / FULL))


def warming_offset(c: GasChambers, x: Array) -> None:
    """P + x (0.6 + 0.8 p^2): the sensor's zero moves as it warms under load."""
    c.pressures.append(lambda p: p + x[:, None] * (0.6 + 0.8 * (p / FULL) ** 2))


# ------------------------------------------------------------------ pressure_deadband
def seating_band(c: GasChambers, x: Array) -> None:
    """P - x tanh(P / 2x) (1 - 0.4 p): what is lost at first comes back as the chamber seats itself."""

    def law(p: Array) -> Array:
        width = np.maximum(x[:, None], 1e-3)
        return p - x[:, None] * np.tanh(np.maximum(p, 0.0) / (2 * width)) * (1 - 0.4 * p / FULL)

    c.pressures.append(law)


def slow_band(c: GasChambers, x: Array) -> None:
    """P - x (1 - exp(-P / 70 kPa)): the slack of a wrinkled chamber is taken up little by little."""
    c.pressures.append(lambda p: p + x[:, None] * np.expm1(-np.maximum(p, 0.0) / 70e3))


def rational_band(c: GasChambers, x: Array) -> None:
    """P^2 / (P + x)."""
    c.pressures.append(lambda p: np.where(p > 0, p * p / np.maximum(p + x[:, None], 1e-9), p))


def play_band(c: GasChambers, x: Array) -> None:
    """Play of x in all, half of it lost when loading and given back late when unloading: a sticking valve."""
    held: list[Array] = []

    def law(p: Array) -> Array:
        last = held[-1] if held else np.zeros_like(p)
        half = 0.5 * x[:, None]
        now = np.clip(last, p - 2 * half, p)
        held[:] = [now]
        return np.maximum(0.5 * (now + np.maximum(p - half, 0.0)), 0.0)

    c.pressures.append(law)


# ------------------------------------------------------------------ chamber_ballooning
def _grows(shape: Callable[[Array], Array]) -> Callable[[GasChambers, Array], None]:
    def form(c: GasChambers, x: Array) -> None:
        c.areas.append(lambda p: 1 + x[:, None] * shape(np.maximum(p, 0.0) / FULL))

    return form


balloon_saturating = _grows(lambda p: (1 - np.exp(-2.5 * p)) / (1 - np.exp(-2.5)))
"""A (1 + x (1 - exp(-2.5 p)) / (1 - exp(-2.5))): the fibres tighten."""
balloon_threshold = _grows(lambda p: np.logaddexp(0.0, 12 * (p - 0.4)) / 12 / 0.6)
"""A (1 + x softplus(p - 0.4) / 0.6): nothing until the wall gives."""
balloon_tube = _grows(lambda p: 0.55 * p / (1 - 0.45 * p))
"""A (1 + x 0.55 p / (1 - 0.45 p)): thin tube of rubber on the way to its instability."""


# ------------------------------------------------------------------ chamber_azimuth
def uneven_azimuth(c: GasChambers, x: Array) -> None:
    """az + x (1 + 0.4 cos az): the pattern is turned, and more so on one side."""
    c.azimuths += x[:, None] * (1 + 0.4 * np.cos(c.azimuths))


def turned_off_centre(c: GasChambers, x: Array) -> None:
    """az + x about a centre that lies 12 mm/rad x off the axis: the mould was turned about a wrong point."""
    c.azimuths += x[:, None]
    c.aside[:, 1] += 0.012 * x


def cap_azimuth(c: GasChambers, x: Array) -> None:
    """Chambers straight, the end cap turned by x against them: winding of the last tenth."""
    along = c.body.along()
    c.winding += x[:, None] * (0.7 + 0.3 * np.clip((along - 0.8) / 0.2, 0, 1))


# ------------------------------------------------------------------ chamber_twist
def twist_late(c: GasChambers, x: Array) -> None:
    """x s^2 / L (rad): the winding grows towards the tip."""
    c.winding += x[:, None] * c.body.s * c.body.along()


def twist_middle(c: GasChambers, x: Array) -> None:
    """x L (3 a^2 - 2 a^3), a = s / L: wound between two straight ends."""
    a = c.body.along()
    c.winding += x[:, None] * c.body.lanes.length[:, None] * a * a * (3 - 2 * a)


def twist_early(c: GasChambers, x: Array) -> None:
    """x L (1 - exp(-3 a)) / (1 - exp(-3)): wound near the base, where the body was cast first."""
    a = c.body.along()
    c.winding += x[:, None] * c.body.lanes.length[:, None] * (1 - np.exp(-3 * a)) / (1 - np.exp(-3.0))


# ------------------------------------------------------------------ chamber_thrust
def walls_to_the_tip(c: GasChambers, x: Array) -> None:
    """Share x (0.8 + 0.2 a): fittings at the base keep the walls from moving there."""
    c.on_walls += np.clip(x, 0, 1)[:, None] * (0.8 + 0.2 * c.body.along())


def walls_but_the_cap(c: GasChambers, x: Array) -> None:
    """Share x but for the last tenth, where the stiff cap holds the gas."""
    a = c.body.along()
    c.on_walls += np.clip(x, 0, 1)[:, None] * (1 - 0.5 * np.clip((a - 0.9) / 0.1, 0, 1))


def walls_from_the_base(c: GasChambers, x: Array) -> None:
    """Share x (1 - 0.2 a): hoses that end inside hand part of their thrust to the base."""
    c.on_walls += np.clip(x, 0, 1)[:, None] * (1 - 0.2 * c.body.along())


# ------------------------------------------------------------------ on request
def chambers_by_side(c: GasChambers, x: Array) -> None:
    """A (1 + x (1 - 2 |d| / pi)), d the angle to one side: the mould closes askew."""
    off = np.angle(np.exp(1j * (c.azimuths[0] - c.body.lanes.places.other)))
    factor = 1 + x[:, None] * (1 - 2 * np.abs(off) / np.pi)
    c.areas.append(lambda p: factor)


def hoses_exchanged(c: GasChambers, x: Array) -> None:
    """From 0.25 on: two of the regulators (9 1 2, 3 4 5, 6 7 8) feed one another's chambers."""
    groups = [[8, 0, 1], [2, 3, 4], [5, 6, 7]]
    stays = groups.pop({8: 0, 0: 1, 1: 2}[c.body.lanes.places.chamber])
    order = np.arange(len(stays) + sum(map(len, groups)))
    order[groups[0]], order[groups[1]] = groups[1], groups[0]
    c.pressures.append(lambda p: np.where(x[:, None] > 0.25, p[:, order], p))
