"""Forms of the effects of the silicone: modulus, other fibre laws, time, and shape without load.

x (n,) is the size in the unit of the form.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from .body import Fibre, WorldBody

Array = NDArray[np.float64]
Form = Callable[[WorldBody, Array], None]


# ------------------------------------------------------------------ body_modulus
def modulus_of_layers(b: WorldBody, x: Array) -> None:
    """E (1 + x) in bending, (1 + 0.4 x) in stretch, G as it was: layers that were cast one after another."""
    b.silicone_axial *= 1 + 0.4 * x[:, None]
    b.silicone_bending *= 1 + x[:, None]


def modulus_of_the_skin(b: WorldBody, x: Array) -> None:
    """E (1 + 0.8 x) in stretch, (1 + 1.1 x) in bending: the outside cured further than the inside."""
    b.silicone_axial *= 1 + 0.8 * x[:, None]
    b.silicone_bending *= 1 + 1.1 * x[:, None]
    b.silicone_shear *= 1 + 0.9 * x[:, None]


def modulus_of_the_mix(b: WorldBody, x: Array) -> None:
    """E and G by exp(x), by 0.7 x where the spine is: there its granules carried part of the test."""
    factor = np.exp(x[:, None] * (1 - 0.3 * b.cover))
    b.silicone_axial *= factor
    b.silicone_bending *= factor
    b.silicone_shear *= factor


# ------------------------------------------------------------------ hyperelastic
def _fibres(law: Callable[[Array], tuple[Array, Array]]) -> Form:
    def form(b: WorldBody, x: Array) -> None:
        b.fibres.append(Fibre(law, x))

    return form


def _mooney_rivlin(e: Array) -> tuple[Array, Array]:
    stretch, share = np.maximum(1 + e, 0.3), 0.9
    stress = ((1 - share) + share / stretch) * (stretch - stretch**-2) / 3
    slope = ((1 - share) + share / stretch) * (1 + 2 * stretch**-3) / 3
    return stress, slope - share / stretch**2 * (stretch - stretch**-2) / 3


def _gent(e: Array) -> tuple[Array, Array]:
    stretch, limit = np.maximum(1 + e, 0.3), 0.12
    invariant = stretch**2 + 2 / stretch - 3
    lock = 1 / np.maximum(1 - invariant / limit, 0.2)
    pull, slope = (stretch - stretch**-2) / 3, (1 + 2 * stretch**-3) / 3
    return pull * lock, slope * lock + pull * lock**2 * (2 * stretch - 2 / stretch**2) / limit


def _payne(e: Array) -> tuple[Array, Array]:
    # E falls to 70 % over 5 % of strain of either sign: filler lets go
    width, lost = 0.05, 0.3
    keep = np.exp(-(e * e) / width**2)
    return e * (1 - lost + lost * keep), 1 - lost + lost * keep * (1 - 2 * e * e / width**2)


def _exponential(e: Array) -> tuple[Array, Array]:
    # Fung's, softer in tension than in compression
    b = -3.5
    return np.expm1(b * e) / b, np.exp(b * e)


mooney_rivlin, gent, payne, fung = _fibres(_mooney_rivlin), _fibres(_gent), _fibres(_payne), _fibres(_exponential)
"""Share x of the section's fibres obeys Mooney and Rivlin's (C2 = 9 C1), Gent's (J = 0.12), Payne's, or Fung's law."""


# ------------------------------------------------------------------ viscoelastic
TIMES = np.geomspace(0.6, 600.0, 7)
"""Relaxation times (s) that carry the spectra below."""


def _branches(relaxation: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Shares of `TIMES` that sum to one and follow a relaxation from 0.3 to 300 s."""
    t = np.geomspace(0.3, 300.0, 60)
    shares, _ = nnls(np.exp(-t[:, None] / TIMES), relaxation(t))
    return shares / shares.sum(), TIMES


def _creeps(relaxation: Callable[[Array], Array]) -> Form:
    shares, times = _branches(relaxation)
    kept = [(float(s), float(t)) for s, t in zip(shares, times, strict=True) if s > 1e-3]

    def form(b: WorldBody, x: Array) -> None:
        b.creep += [(x * share, tau) for share, tau in kept]

    return form


power_law = _creeps(lambda t: (t / 0.3) ** -0.3)
"""Overstress that fades as t^-0.3: a fractional element."""
stretched = _creeps(lambda t: np.exp(-((t / 20.0) ** 0.5)))
"""exp(-(t / 20 s)^0.5): Kohlrausch."""
logarithmic = _creeps(lambda t: np.maximum(1 - np.log(t / 0.3) / np.log(1000.0), 0.0))
"""Falls evenly with log t from 0.3 to 300 s."""


def one_slow_branch(b: WorldBody, x: Array) -> None:
    """One Maxwell element of 75 s, longer than a ramp."""
    b.creep.append((1.6 * x, 75.0))


# ------------------------------------------------------------------ precurvature
def _curved(b: WorldBody, amount: Array, angle: Array | float) -> None:
    turned = np.asarray(angle) + b.lanes.places.precurvature + b.lanes.roll[:, None]
    b.rest[..., 3] += -amount * np.sin(turned)
    b.rest[..., 4] += amount * np.cos(turned)


def curved_half_sine(b: WorldBody, x: Array) -> None:
    """1.57 x sin(pi a): cured over a bow."""
    _curved(b, x[:, None] * 1.57 * np.sin(np.pi * b.along()), 0.0)


def curved_helix(b: WorldBody, x: Array) -> None:
    """x, in a direction that turns by one radian along the body."""
    _curved(b, x[:, None] * np.ones_like(b.s), b.along() - 0.5)


def curved_at_the_base(b: WorldBody, x: Array) -> None:
    """1.9 x exp(-1.5 a): sagged where it was clamped."""
    _curved(b, x[:, None] * 1.9 * np.exp(-1.5 * b.along()), 0.0)
