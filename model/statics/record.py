"""What a pass writes down at each stage of a step, so that changes of the rod can follow it (`tangent`).

The desk is one array that begins as the `work` of a pass and goes on with the element that is being walked, the stages
of the step and the column that follows it. All of it is at places known to the compiler: between several arrays, or at
places that vary, it would have to check for overlap, and gives up on making vectors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.statics.algebra import Quaternion, Vector
from model.statics.jit import inline
from model.statics.lanes import ELEMENT, LANES, WORK, put

Array = NDArray[np.float64]

STEP_ON_DESK, ON_DESK = WORK, WORK + 1
SERIES_ON_DESK, RISES_ON_DESK, AT = ON_DESK + ELEMENT, ON_DESK + ELEMENT + 3, ON_DESK + ELEMENT + 12
"""Where the share of the step that a lane takes, the element, its hyperelastic and its graded terms, and the stages
are."""
STAGES = 7
ROWS, PULLED, MOMENT, FORCE, CURVATURE, STRAIN = 0, 9, 12, 15, 18, 21
"""R row by row (9), R^T dN of a column (3), m, n, u, v (3 each, section frame)."""
SERIES = 24
"""Elastic bending curvatures (2), 1 / D, axial strain e; what D and e change by with the first and with the second of
their equations (2 each); coefficients by which these equations change with the section: see `keep_softness`."""
SIZE = 40
COLUMN = AT + STAGES * SIZE


@inline
def if_any(terms: Array | None, desk: Array) -> Array | None:
    """The desk as the place of terms where there are such terms."""
    if terms is None:
        return None
    return desk


@inline
def lay_out(desk: Array, elements: Array, rises: Array | None, series: Array | None, e: int) -> None:
    """Put element e on the desk."""
    for k in range(ELEMENT * LANES):
        desk[ON_DESK * LANES + k] = elements[e * ELEMENT * LANES + k]
    if series is not None:
        for k in range(3 * LANES):
            desk[SERIES_ON_DESK * LANES + k] = series[3 * e * LANES + k]
    if rises is not None:
        for k in range(9 * LANES):
            desk[RISES_ON_DESK * LANES + k] = rises[9 * e * LANES + k]


@inline
def keep(stages: Array, i: int, q: Quaternion, m: Vector, n: Vector, u: Vector, v: Vector, l: int) -> None:
    """Write down stage i of lane l."""
    o = AT + i * SIZE
    w, x, y, z = q
    put(stages, o + ROWS, l, (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)))
    put(stages, o + ROWS + 3, l, (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)))
    put(stages, o + ROWS + 6, l, (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)))
    put(stages, o + MOMENT, l, m)
    put(stages, o + FORCE, l, n)
    put(stages, o + CURVATURE, l, u)
    put(stages, o + STRAIN, l, v)


@inline
def keep_softness(
    stages: Array,
    i: int,
    m: Vector,
    n: Vector,
    d: float,
    strain: float,
    flex: Vector,
    give: Vector,
    terms: Vector,
    l: int,
) -> None:
    """How D and e of `equations.softened` answer, at its solution, for stage i of lane l.

    With x = a Q / B the equations are
        F1 = D - 1 - g(x) - h(b e) = 0,   F2 = k(e) + b h'(b e) Q / (2 EA) - n3 / EA = 0,
    Q = T / D^2 and T = m1^2 / EI1 + m2^2 / EI2. Kept are -dD/dF1, .. (by Cramer's rule), and dF1/dT, dF2/dT,
    dF1/d(ln EI) by the root in B, dF1/da, dF2/db, dF2/d(1/EA), -dF1/db, dF2/dc.
    """
    a, b, c = terms
    root = np.sqrt(flex[0] * flex[1])
    total = flex[0] * m[0] * m[0] + flex[1] * m[1] * m[1]
    w = 1.0 / (d * d)
    x = a * total * root * w
    level = 1.0 / (1.0 - 2.0 * min(x, 0.0))
    steep = level * level
    coupled = 0.5 * total * give[2] * w
    loss, relief = 1.0 / (1.0 - min(b * strain, 0.0)), 1.0 / (1.0 - min(c * strain, 0.0))
    rise, curl = loss * loss, 2.0 * loss * loss * loss if b * strain < 0.0 else 0.0
    d1, e1 = 1.0 + 2.0 * x * steep / d, -b * rise
    d2 = -2.0 * b * rise * coupled / d
    e2 = relief * relief + 2.0 * max(c * strain, 0.0) + b * b * curl * coupled
    scale = -1.0 / (d1 * e2 - e1 * d2)
    o = AT + i * SIZE + SERIES
    put(stages, o, l, (flex[0] * m[0] / d, flex[1] * m[1] / d, 1.0 / d))
    put(stages, o + 3, l, (strain, scale * e2, -scale * d2))
    put(stages, o + 6, l, (-scale * e1, scale * d1, -steep * w * a * root))
    put(stages, o + 9, l, (0.5 * w * b * rise * give[2], -0.5 * steep * x, -steep * w * root * total))
    stages[(o + 12) * LANES + l] = coupled * (rise + b * strain * curl)
    stages[(o + 13) * LANES + l] = 0.5 * w * b * rise * total - n[2]
    stages[(o + 14) * LANES + l] = rise * strain
    stages[(o + 15) * LANES + l] = relief * relief * strain * strain
