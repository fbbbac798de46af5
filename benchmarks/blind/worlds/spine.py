"""Forms of the effects of the jammed spine: length, vacuum, shear, the composite section, friction.

x (n,) is the size in the unit of the form; l is the spine's length, s the arc length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .body import Slip, WorldBody, diagonal, table_modulus
from .robot import SPINE_AREA, SPINE_SECOND

Array = NDArray[np.float64]


def _grown(b: WorldBody, more: Array, modulus_by_true: bool) -> None:
    b.true_length = np.where(b.lanes.spine > 0, np.maximum(b.true_length + more, 2e-3), b.true_length)
    if modulus_by_true:
        b.modulus_length = b.true_length.copy()


# ------------------------------------------------------------------ spine_length_offset
def eccentric_reel(b: WorldBody, x: Array) -> None:
    """l + x (1 + 0.6 cos(2 pi l / 0.14 m)): the reel runs out of true; modulus of the length read."""
    _grown(b, x * (1 + 0.6 * np.cos(2 * np.pi * b.lanes.spine / 0.14)), False)


def encoder_scale(b: WorldBody, x: Array) -> None:
    """l (1 + x / 0.18 m): counts per turn are off."""
    _grown(b, x * b.lanes.spine / 0.18, True)


def slack_first(b: WorldBody, x: Array) -> None:
    """l + x (1 - exp(-l / 0.06 m)): slack that the first turns take up."""
    _grown(b, x * (1 - np.exp(-b.lanes.spine / 0.06)), True)


def wrinkled_tail(b: WorldBody, x: Array) -> None:
    """l + x (l / 0.2 m)^2: the tail wrinkles more, the longer it is; modulus of the length read."""
    _grown(b, x * (b.lanes.spine / 0.2) ** 2, False)


# ------------------------------------------------------------------ vacuum_leak
def _weaken(b: WorldBody, share: Array, exponent: float) -> None:
    factor = np.maximum(1 - share, 0.05) ** exponent
    b.spine_e *= factor
    b.spine_g *= factor


def leak_seams(b: WorldBody, x: Array) -> None:
    """Share 1.2 x (1 - exp(-l / 0.08 m)) lost, stiffness as what is left to the 0.75: seams leak until the pump keeps up."""
    _weaken(b, np.clip(1.2 * x * (1 - np.exp(-b.true_length / 0.08)), 0, 0.95)[:, None], 0.75)


def leak_along(b: WorldBody, x: Array) -> None:
    """Share 1.7 x s / l lost at s: the pump sits at the base, air comes in along the sleeve; stiffness as the root."""
    along = np.clip(b.s / np.maximum(b.true_length, 1e-3)[:, None], 0, 1)
    _weaken(b, np.clip(1.7 * x[:, None] * along, 0, 0.95), 0.5)


def leak_by_length(b: WorldBody, x: Array) -> None:
    """Share x (2 l / (l + 0.2 m)) lost, stiffness in proportion to what is left."""
    lost = x * 2 * b.true_length / (b.true_length + 0.2)
    _weaken(b, np.clip(lost, 0, 0.95)[:, None], 1.0)


def leak_to_the_threshold(b: WorldBody, x: Array) -> None:
    """Stiffness as (v - 0.2) / 0.8, rounded near 0.2, v = 1 - x (0.5 + l / 0.3 m): granules let go at a fifth of the vacuum."""
    lost = np.clip(x * (0.5 + b.true_length / 0.3), 0, 0.95)
    left = np.logaddexp(0.0, 20 * (1 - lost - 0.2)) / 20
    factor = (left / (np.logaddexp(0.0, 16.0) / 20))[:, None]
    b.spine_e *= factor
    b.spine_g *= factor


# ------------------------------------------------------------------ spine_shear
def _toward(b: WorldBody, x: Array, e: Array, g: Array, harmonic: bool) -> None:
    blend = np.clip(x, 0, 1)[:, None]
    jam = b.spine_e / table_modulus(b.modulus_length)[:, None]
    if harmonic:
        b.spine_e = 1 / ((1 - blend) / b.spine_e + blend / np.maximum(e * jam, 1.0))
        b.spine_g = 1 / ((1 - blend) / b.spine_g + blend / np.maximum(g * jam, 1.0))
    else:
        b.spine_e = (1 - blend) * b.spine_e + blend * e * jam
        b.spine_g = (1 - blend) * b.spine_g + blend * g * jam


def shear_soft(b: WorldBody, x: Array) -> None:
    """One E of 5.8 MPa and kappa G of 75 kPa (kappa 0.87 of a round bar), moduli blended."""
    _toward(b, x, np.full_like(b.spine_e, 5.8e6), np.full_like(b.spine_e, 75e3), False)


def shear_lag(b: WorldBody, x: Array) -> None:
    """E0 (1 - cosh(k (s - l/2)) / cosh(k l / 2)), k = 40 /m, E0 5.8 MPa: stress enters through the sleeve on some way."""
    k, length = 40.0, np.maximum(b.true_length, 1e-3)[:, None]
    e = 5.8e6 * (1 - np.cosh(k * (np.clip(b.s, 0, length) - length / 2)) / np.cosh(k * length / 2))
    _toward(b, x, np.maximum(e, 2e4), np.full_like(e, 95e3), False)


def shear_by_length(b: WorldBody, x: Array) -> None:
    """E of the whole spine 6.2 MPa l / (l + 0.09 m), kappa G 60 kPa, compliances blended."""
    length = np.maximum(b.true_length, 1e-3)[:, None]
    e = 6.2e6 * length / (length + 0.09) * np.ones_like(b.spine_e)
    _toward(b, x, e, np.full_like(e, 60e3), True)


# ------------------------------------------------------------------ area_moment
def composite(b: WorldBody, area: Array | float = SPINE_AREA, second: Array | float = SPINE_SECOND) -> tuple[Array, Array]:
    """Stiffness of annulus and disc beside one another, silicone and spine."""
    spine = diagonal(b.spine_g, b.spine_e, b.spine_e, area, second) * b.cover[..., None]
    return b.silicone_sections(), spine


def composite_compliance(b: WorldBody, x: Array) -> None:
    """Compliance x of the composite, 1 - x of the mix: bonded and loose stretches in series."""
    silicone, spine = composite(b)
    mixed, made = b.stiff_silicone + b.stiff_spine, silicone + spine
    blend = np.clip(x, 0, 1)[:, None, None]
    total = 1 / ((1 - blend) / mixed + blend / made)
    share = (1 - blend) * b.stiff_silicone / mixed + blend * silicone / made
    b.stiff_silicone, b.stiff_spine = total * share, total * (1 - share)


def composite_sliding(b: WorldBody, x: Array) -> None:
    """Bending by area moments, but the spine slides in its channel: of stretch it takes a quarter of its share."""
    silicone, spine = composite(b)
    spine[..., 2] *= 0.25
    blend = np.clip(x, 0, 1)[:, None, None]
    b.stiff_silicone += blend * (silicone - b.stiff_silicone)
    b.stiff_spine += blend * (spine - b.stiff_spine)


def composite_loose(b: WorldBody, x: Array) -> None:
    """A disc of 96 % of the radius, its stress built up over 25 mm from the spine's end."""
    reach = 1 - np.exp(-np.maximum(b.true_length[:, None] - b.s, 0.0) / 0.025)
    silicone, spine = composite(b, SPINE_AREA * 0.96**2 * reach, SPINE_SECOND * 0.96**4 * reach)
    blend = np.clip(x, 0, 1)[:, None, None]
    b.stiff_silicone += blend * (silicone - b.stiff_silicone)
    b.stiff_spine += blend * (spine - b.stiff_spine)


def composite_from_the_base(b: WorldBody, x: Array) -> None:
    """Composite over the first x of the spine, the mix beyond, 20 mm in between: it is bonded as far as it was pressed."""
    reach = x[:, None] * b.true_length[:, None]
    blend = (1 / (1 + np.exp(np.clip((b.s - reach) / 0.008, -50, 50))) * (x > 0)[:, None])[..., None]
    silicone, spine = composite(b)
    b.stiff_silicone += blend * (silicone - b.stiff_silicone)
    b.stiff_spine += blend * (spine - b.stiff_spine)


# ------------------------------------------------------------------ spine_slip
def _friction(b: WorldBody, x: Array, yields: float, rule: str, share: Array | float = 1.0, **more: float) -> None:
    b.slips.append(Slip(x[:, None] * share * b.cover, yields, rule, **more))


def slip_dahl(b: WorldBody, x: Array) -> None:
    """Dahl's element, yield 0.25 /m; the moment falls towards the spine's end with what is left of it to hold."""
    length = np.maximum(b.true_length, 1e-3)[:, None]
    _friction(b, x, 0.25, "dahl", np.clip(1.5 * (1 - b.s / length) + 0.25, 0, 1.5))


def slip_bouc_wen(b: WorldBody, x: Array) -> None:
    """Bouc and Wen's element, n = 2, yield 0.4 /m, over the whole spine."""
    _friction(b, x, 0.4, "bouc_wen")


def slip_prandtl(b: WorldBody, x: Array) -> None:
    """Three of Prandtl's sliders (0.08, 0.3, 1.1 /m), the hold of each growing with pressure."""
    for yields, share in ((0.08, 0.25), (0.3, 0.4), (1.1, 0.35)):
        _friction(b, x, yields, "prandtl", 0.6 * share, by_pressure=1.2)


def slip_lugre(b: WorldBody, x: Array) -> None:
    """Dahl's element, yield 0.3 /m, 40 % stronger at rest than sliding (Stribeck at 0.02 /(m s))."""
    _friction(b, x, 0.3, "dahl", 0.85, rate=0.02)
