"""What a column of `tangent` holds, and where it lies in the stage buffer while it is stepped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.rods.columns import BLOCK
from model.rods.fast.algebra import Vector, along
from model.rods.fast.instructions import put_number
from model.rods.fast.jit import inline
from model.rods.fast.lanes import LANES, number_of, put, vector_of
from model.rods.fast.stage_buffer import COLUMN_AT, ELEMENT_AT, STAGES, STEP_SHARE

Array = NDArray[np.float64]

BY_TURN, BY_MOMENT, BY_FORCE, TIP_COLUMNS = 0, 3, 6, 9
"""Columns that start at the tip; forced ones come behind."""
THETA, DM, SHIFT, MEAN_STRAIN, WORK_BY = 0, 3, 6, 9, 10
"""What a column holds: theta, dm, p, mean of dv3 over the element so far, T of the element so far (BLOCK)."""
COLUMN = WORK_BY + BLOCK
STRETCH_BY = COLUMN
ANSWERS_AT = COLUMN_AT + COLUMN + 1
DM_HERE, DN_HERE, MOVED, ANSWER = 0, 3, 6, 9
"""In the buffer behind the column: the axial force that forced columns add, and what the section answers at each stage, by the
stage's weight: dm, dn (section frame) and -R^T dp/dt. Sums over the stages are made from these afterwards, few at a time: there
are more of them than a processor has registers."""
BUFFER = ANSWERS_AT + STAGES * ANSWER


@inline
def step_of(buffer: Array, dz: float, l: int) -> tuple[float, float]:
    """Share of the element that lane l passes in a step, and its length (m)."""
    share = -dz * number_of(buffer, STEP_SHARE, l)
    return share, share * number_of(buffer, ELEMENT_AT, l)


@inline
def add_number(x: Array, k: int, l: int, more: float) -> None:
    """Add to a quantity."""
    put_number(x, k * LANES + l, number_of(x, k, l) + more)


@inline
def add_to(x: Array, k: int, l: int, h: float, a: Vector) -> None:
    """Add h a to three quantities."""
    put(x, k, l, along(vector_of(x, k, l), h, a))
