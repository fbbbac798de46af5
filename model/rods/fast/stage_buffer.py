"""What a pass saves at each stage of a step, so that changes of the rod can follow it (`tangent`).

The stage buffer is one array that begins as the `work` of a pass and goes on with the element that is being walked, the
stages of the step and the column that follows it. All of it is at places known to the compiler: between several arrays, or
at places that vary, it would have to check for overlap, and gives up on making vectors.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.rods.fast.algebra import Quaternion, Vector
from model.rods.fast.jit import inline
from model.rods.fast.lanes import ELEMENT, LANES, WORK, Group, put

Array = NDArray[np.float64]

STEP_SHARE, ELEMENT_AT = WORK, WORK + 1
STAGES_AT = ELEMENT_AT + ELEMENT
"""Where the share of the step that a lane takes, the element and the stages are."""
STAGES = 7
ROWS, DN_FIXED, MOMENT, FORCE, CURVATURE, STRAIN = 0, 9, 12, 15, 18, 21
"""R row by row (9), R^T dN of a column (3), m, n, u, v (3 each, section frame)."""
SOFTNESS = 24
"""Elastic bending curvatures (2), 1 / D, axial strain e; what D and e change by with the first and with the second of
their equations (2 each); coefficients by which these equations change with the section: see `save_softness`."""
STAGE = 40
"""Quantities of a stage."""
COLUMN_AT = STAGES_AT + STAGES * STAGE


@inline
def buffered_group(group: Group) -> Group:
    """A group whose work is a stage buffer, with the buffered element as its only one, which begins at ELEMENT_AT."""
    buffer = group.work
    return Group(buffer, buffer, group.full, group.parts, group.springs, group.active)


@inline
def load_element(group: Group, e: int) -> None:
    """Copy element e into the buffer."""
    for k in range(ELEMENT * LANES):
        group.work[ELEMENT_AT * LANES + k] = group.elements[e * ELEMENT * LANES + k]


@inline
def save_stage(
    stages: Array, i: int, l: int, q: Quaternion, wrench: tuple[Vector, Vector], strains: tuple[Vector, Vector]
) -> None:
    """Save stage i of lane l: orientation, (m, n) and (u, v)."""
    o = STAGES_AT + i * STAGE
    w, x, y, z = q
    put(stages, o + ROWS, l, (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)))
    put(stages, o + ROWS + 3, l, (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)))
    put(stages, o + ROWS + 6, l, (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)))
    put(stages, o + MOMENT, l, wrench[0])
    put(stages, o + FORCE, l, wrench[1])
    put(stages, o + CURVATURE, l, strains[0])
    put(stages, o + STRAIN, l, strains[1])


@inline
def save_softness(
    stages: Array, i: int, l: int, m: Vector, n: Vector, found: tuple[float, float],
    inverse: tuple[Vector, Vector], terms: Vector,
) -> None:  # fmt: skip
    """How D and e of `equations.softened` answer, at its solution `found`, for stage i of lane l.

    With x = a Q / B the equations are
        F1 = D - 1 - g(x) - h(b e) = 0,   F2 = k(e) + b h'(b e) Q / (2 EA) - n3 / EA = 0,
    Q = T / D^2 and T = m1^2 / EI1 + m2^2 / EI2. Saved are -dD/dF1, .. (by Cramer's rule), and dF1/dT, dF2/dT,
    dF1/d(ln EI) by the root in B, dF1/da, dF2/db, dF2/d(1/EA), -dF1/db, dF2/dc.
    """
    inv_bend, inv_stretch = inverse
    d, strain = found
    a, b, c = terms
    root = np.sqrt(inv_bend[0] * inv_bend[1])
    total = inv_bend[0] * m[0] * m[0] + inv_bend[1] * m[1] * m[1]
    w = 1.0 / (d * d)
    x = a * total * root * w
    level = 1.0 / (1.0 - 2.0 * min(x, 0.0))
    steep = level * level
    coupled = 0.5 * total * inv_stretch[2] * w
    loss, relief = 1.0 / (1.0 - min(b * strain, 0.0)), 1.0 / (1.0 - min(c * strain, 0.0))
    rise, curl = loss * loss, 2.0 * loss * loss * loss if b * strain < 0.0 else 0.0
    d1, e1 = 1.0 + 2.0 * x * steep / d, -b * rise
    d2 = -2.0 * b * rise * coupled / d
    e2 = relief * relief + 2.0 * max(c * strain, 0.0) + b * b * curl * coupled
    scale = -1.0 / (d1 * e2 - e1 * d2)
    o = STAGES_AT + i * STAGE + SOFTNESS
    put(stages, o, l, (inv_bend[0] * m[0] / d, inv_bend[1] * m[1] / d, 1.0 / d))
    put(stages, o + 3, l, (strain, scale * e2, -scale * d2))
    put(stages, o + 6, l, (-scale * e1, scale * d1, -steep * w * a * root))
    put(stages, o + 9, l, (0.5 * w * b * rise * inv_stretch[2], -0.5 * steep * x, -steep * w * root * total))
    stages[(o + 12) * LANES + l] = coupled * (rise + b * strain * curl)
    stages[(o + 13) * LANES + l] = 0.5 * w * b * rise * total - n[2]
    stages[(o + 14) * LANES + l] = rise * strain
    stages[(o + 15) * LANES + l] = relief * relief * strain * strain
