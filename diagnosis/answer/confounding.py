"""How much of each effect a calibration swallows before anybody can see it.

The share of an effect's squared tip displacement (at its plausible scale) that refitting the calibration and the
nuisances takes away. A share near one means: whoever calibrates first and looks at the residual will not see this effect.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..inference.problem import Parameters

Array = NDArray[np.float64]


def absorbed(parameters: Parameters, slope: Array, weight: Array, calibration: Array) -> dict[str, float]:
    """Share 0..1 of each effect that `calibration` (n, c), columns of free parameters, absorbs.

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
