"""The spine's moduli: the baseline's table, and a spine of one modulus with low shear stiffness.

A cantilever of length L with shear looks, by deflection, like 1/E = 1/E0 + a/L^2 with a = 3 r^2 / (4 kappa G) for a
round bar (Timoshenko). E0 and a come from the table of apparent moduli by least squares on log E.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from model.arrays import Array
from model.effects.quantities import Quantities
from model.robot import Spine

SHORTEST = 1e-3
"""m; keeps the laws finite where there is no spine."""


@dataclass(frozen=True)
class ShearSpine:
    """One Young's modulus and one shear stiffness for all lengths."""

    modulus: float
    """E0, Pa."""
    shear: float
    """kappa G, Pa."""
    lag: float
    """m: a section that may turn against the wall takes up bending over this length, sqrt(E0 I / (kappa G A))."""

    def apparent(self, length: Array) -> Array:
        """Young's modulus (Pa) that a cantilever of this length (m) seems to have."""
        softer = 3 * self.lag**2 / np.maximum(length, SHORTEST) ** 2
        return self.modulus / (1 + softer)

    def engaged(self, length: Array) -> Array:
        """Share (0..1) of E0 I that free sections bring into a body bent to constant curvature.

        Their angle psi obeys lag^2 psi'' = psi - w', clamped at the base and free of moment at the spine's end.
        """
        ratio = np.maximum(length, SHORTEST) / self.lag
        return 1 - np.tanh(ratio) / ratio


def shear_spine(spine: Spine) -> ShearSpine:
    """Fit E0 and a of a shear-soft spine to the table of moduli; where that has one length, 10 % of its compliance is shear."""
    length = np.array(sorted(x for x in spine.modulus if x > SHORTEST))
    log_modulus = np.log([spine.modulus[x] for x in length])
    if length.size < 2:
        modulus = math.exp(float(log_modulus[0])) / 0.9 if length.size else next(iter(spine.modulus.values()))
        softness = 0.1 * (float(length[0]) ** 2 if length.size else 0.01)  # a E0, m^2; 0.1 m where no length is known
    else:
        tried = np.geomspace(1e-6 * length[0] ** 2, 1e6 * length[-1] ** 2, 99)
        for _ in range(8):  # each time between the neighbours of the best
            log_young = log_modulus + np.log1p(tried[:, None] / length**2)
            best = int(np.argmin(log_young.var(axis=1)))
            modulus, softness = math.exp(log_young[best].mean()), float(tried[best])
            tried = np.geomspace(tried[max(best - 1, 0)], tried[min(best + 1, 98)], 99)
    return ShearSpine(modulus, 3 * spine.radius**2 * modulus / (4 * softness), math.sqrt(softness / 3))


class SpineModuli(NamedTuple):
    """(v, n) Pa; 0 without spine."""

    young: Array
    """Within the body."""
    shear: Array
    """Within the body."""
    bare: Array
    """Young's modulus that the bare spine, a cantilever, seems to have."""


def moduli(q: Quantities, shear: ShearSpine) -> SpineModuli:
    """Moduli of the spine: those of the table blended with those of the shear-soft spine, times stiffness and jamming."""
    spine = q.robot.spine
    if spine is None:
        return SpineModuli(*np.zeros((3, 1, 1)))
    table = spine.modulus_at(q.tabulated_length)
    ratio = q.robot.shear_modulus / q.robot.youngs_modulus
    engaged = shear.modulus * (1 + q.shear_lag * (shear.engaged(q.spine_length) - 1))
    jammed = q.spine_stiffness * jamming(q)
    return SpineModuli(
        young=jammed * _blend(q, table, engaged),
        shear=jammed * _blend(q, ratio * table, np.asarray(shear.shear)),
        bare=jammed * _blend(q, table, shear.apparent(q.spine_length)),
    )


def _blend(q: Quantities, table: Array, other: Array) -> Array:
    """Power mean (v, n) of two moduli, Pa: ((1 - w) table^p + w other^p)^(1/p), w = `shear_blend`, p = `shear_mix` - 1.

    p = -1 puts compliances in series, p = 1 stiffnesses in parallel; p = 0, the geometric mean, is taken as p = 1e-4.
    """
    w, p = q.shear_blend, q.shear_mix - 1
    if not w.any():
        return table
    p = np.where(np.abs(p) < 1e-4, 1e-4, p)
    # divided by the table's modulus, so that at w = 0 the table comes out to the last bit
    return np.asarray(table * (1 + w * ((other / table) ** p - 1)) ** (1 / p))


def jamming(q: Quantities) -> Array:
    """Factor (v, n) on the spine's moduli: (vacuum that reaches the granules / nominal)^`jamming_exponent`."""
    share = (q.design.vacuum - q.vacuum_loss) / q.design.nominal_vacuum
    # Granules without vacuum still pack under the sleeve's tension: a small share levels off near 0.02 of the nominal vacuum,
    # over a width of 0.05, instead of becoming negative.
    low, width = 0.02, 0.05
    if (share > 0.25).all():
        return share**q.jamming_exponent
    smooth = low + 0.5 * (share - low + np.sqrt((share - low) ** 2 + width**2))
    return np.where(share > 0.25, share, smooth) ** q.jamming_exponent
