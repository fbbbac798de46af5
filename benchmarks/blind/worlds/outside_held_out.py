"""Causes outside the catalogue that nothing is developed on: drawn only where held-out causes are asked for by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .body import WorldBody
from .frames import apply, turn
from .gas import GasChambers
from .outside import Cause
from .robot import FULL
from .seen import Seeing, SeenPath

Array = NDArray[np.float64]


def thrust_eccentric(c: GasChambers, x: Array) -> None:
    """Chambers lie at radius (1 + x cos(az - a)): the ring of channels is no circle."""
    c.radius *= 1 + x[:, None] * np.cos(c.azimuths - c.body.lanes.places.other)


def swapped_hoses(c: GasChambers, x: Array) -> None:
    """The hoses of chambers 8 and 9 are swapped, to the share x."""

    def law(p: Array) -> Array:
        out = p.copy()
        share = np.clip(x, 0, 1)
        out[:, 7] += share * (p[:, 8] - p[:, 7])
        out[:, 8] += share * (p[:, 7] - p[:, 8])
        return out

    c.pressures.append(law)


def barometer(c: GasChambers, x: Array) -> None:
    """Inflated chambers hold x (Pa) more at the top of its course: gauges refer to another day's air."""
    c.pressures.append(lambda p: p + x[:, None] * (p > 1e3))


def wall_stiffening(b: WorldBody, x: Array) -> None:
    """All stiffness (1 + x p^2), p the mean of the three highest pressures / 250 kPa: inflated walls are stretched tight."""

    def factor(e: Array, pressures: Array) -> Array:
        p = np.sort(pressures, axis=1)[:, -3:].mean(axis=1) / FULL
        return np.broadcast_to((1 + x * p * p)[:, None], e.shape[:2])

    b.stiffening = factor


def spine_buckles(b: WorldBody, x: Array) -> None:
    """The sleeve folds where the body with spine bends beyond 0.9 /m: it loses x of its stiffness there."""
    length = b.cover

    def factor(e: Array, pressures: Array) -> Array:
        kappa = np.sqrt(np.sum(e[..., 3:5] ** 2, axis=-1))
        return 1 - x[:, None] * length / (1 + np.exp(-(kappa - 0.9) / 0.15))

    b.stiffening = factor


def body_taper(b: WorldBody, x: Array) -> None:
    """Radii (1 + x (1 - 2 a)): thicker at the base."""
    r = 1 + x[:, None] * (1 - 2 * b.along())
    b.stiff_silicone *= np.stack([r**2] * 3 + [r**4] * 3, axis=-1)
    b.line *= r**2


def base_slips_at_the_top(s: Seeing, x: Array) -> None:
    """The clamp gives by x (rad) once the pressure has passed 190 kPa, until the next trial."""
    a = s.lanes.places.other
    rotation = turn(x[:, None] * np.array([-np.sin(a), np.cos(a), 0.0]))

    def law(path: SeenPath) -> SeenPath:
        passed = np.maximum.accumulate(path.pressures.max(axis=1)) > 190e3
        tip, turns, markers = path.tip.copy(), path.turns.copy(), path.markers.copy()
        tip[passed] = apply(rotation, tip[passed])
        turns[passed] = rotation @ turns[passed]
        markers[passed] = apply(rotation[:, None], markers[passed])
        return replace(path, tip=tip, turns=turns, markers=markers)

    s.views.append(law)


def lens_distortion(s: Seeing, x: Array) -> None:
    """Ways aside are read (1 + x (d / 0.2 m)^2) times too long."""

    def law(path: SeenPath) -> SeenPath:
        d2 = np.sum(path.tip[..., :2] ** 2, axis=-1)
        tip = path.tip.copy()
        tip[..., :2] *= (1 + x * d2 / 0.04)[..., None]
        return replace(path, tip=tip)

    s.views.append(law)


def marker_sags(s: Seeing, x: Array) -> None:
    """The marker's stalk sags by x (m) times the sine of its tilt, downwards."""

    def law(path: SeenPath) -> SeenPath:
        tip = path.tip.copy()
        tip[..., 2] += x * np.sqrt(np.maximum(1 - path.turns[..., 2, 2] ** 2, 0.0))
        return replace(path, tip=tip)

    s.views.append(law)


def to_and_fro(u: Array) -> Array:
    """Up, back and the other way over the campaign u (0..1)."""
    return np.asarray(np.sin(1.5 * np.pi * u))


HELD_OUT = {
    c.id: c
    for c in (
        Cause("thrust_eccentric", "actuation", 0.08, thrust_eccentric, "chambers", one_way=False),
        Cause("swapped_hoses", "actuation", 1.0, swapped_hoses, "chambers"),
        Cause("barometer", "actuation", 5e3, barometer, "chambers", to_and_fro, one_way=False),
        Cause("wall_stiffening", "material", 0.25, wall_stiffening, "body"),
        Cause("spine_buckles", "structure", 0.3, spine_buckles, "body"),
        Cause("body_taper", "structure", 0.06, body_taper, "body", one_way=False),
        Cause("base_slips_at_the_top", "boundary", np.radians(1.2), base_slips_at_the_top, "seen", one_way=False),
        Cause("lens_distortion", "measurement", 0.03, lens_distortion, "seen", one_way=False),
        Cause("marker_sags", "measurement", 0.012, marker_sags, "seen"),
    )
}
"""By id."""
