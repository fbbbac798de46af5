"""Confounding: how much of each effect a calibration takes over.

The share is 1 - |e - P e|^2 / |e|^2, e the effect's tip displacements at its plausible scale and P the projection onto
what the calibration can fit. Near 1, a calibration leaves nothing of the effect in the residual.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..inference.problem import Parameters

Array = NDArray[np.float64]


def confounded_shares(parameters: Parameters, slope: Array, weight: Array, calibration: Array) -> dict[str, float]:
    """Share 0..1 of each effect that `calibration` (n, c), columns of free parameters, takes over.

    `slope` (n, k) derivatives by the parameters; `weight` (n,) of each value, 0 for values that are not looked at.
    """
    free = weight[:, None] * calibration
    basis, size, _ = np.linalg.svd(free, full_matrices=False)
    basis = basis[:, size > 1e-10 * max(float(size.max(initial=0.0)), 1e-300)]
    out = {}
    for effect in parameters.ids:
        own = [i for i, e in enumerate(parameters.effects) if e == effect]
        columns = weight[:, None] * slope[:, own] * parameters.sd[own]
        total = float((columns**2).sum())
        left = columns - basis @ (basis.T @ columns)
        out[effect] = 1.0 - float((left**2).sum()) / total if total > 0 else 1.0
    return out
