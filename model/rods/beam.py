"""A cantilever under small deflections, by beam theory with shear (Timoshenko), in closed form; stiffness trials."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array


def bending_compliance(edges: Sequence[ArrayLike], bend_stiffness: Sequence[ArrayLike]) -> Array:
    """Deflection by bending per force at the tip (m/N) of a bar of parts: sum ((L - s_e)^3 - (L - s_e+1)^3) / (3 E I_e).

    `edges` are the arc lengths s_0 = 0, ..., L (m) where the parts begin and end, `bend_stiffness` E I of each (N m^2), of
    any shapes that broadcast.
    """
    tip = np.asarray(edges[-1], float)
    reach = [(tip - s) ** 3 for s in edges]
    return np.asarray(sum((a - b) / (3 * np.asarray(k)) for a, b, k in zip(reach[:-1], reach[1:], bend_stiffness, strict=True)))


def shear_compliance(edges: Sequence[ArrayLike], shear_stiffness: Sequence[ArrayLike]) -> Array:
    """Deflection by shear per force at the tip (m/N): sum (s_e+1 - s_e) / (G A_e), see `bending_compliance`; G A in N."""
    return np.asarray(
        sum((np.asarray(b) - a) / np.asarray(k) for a, b, k in zip(edges[:-1], edges[1:], shear_stiffness, strict=True))
    )
