"""Stations of the implicit differentiation: the columns are saved where the walk from tip to base passes an arc length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from model.rods.fast.algebra import turned, turned_back
from model.rods.fast.derivatives.column_layout import COLUMN, TIP_COLUMNS
from model.rods.fast.derivatives.columns_walk import Columns, section_change
from model.rods.fast.derivatives.tangent import step_all
from model.rods.fast.equations import section_of, strains
from model.rods.fast.jit import allocating, inline
from model.rods.fast.lanes import LANES, STATE, Group, M, N, copy_numbers, put, vector_of
from model.rods.fast.passes import unit_quaternion
from model.rods.fast.stage_buffer import ELEMENT_AT, STEP_SHARE
from model.rods.fast.walk import share_at

Array = NDArray[np.float64]


@allocating
def visit_station(group: Group, columns: Columns, arcs: Array, first: int, step: tuple[int, int, int], s: int) -> None:
    """Look at station s from the lanes where the step (e, j, pieces) passes it, then bring them back."""
    work, x, saved = group.work, columns.x, columns.saved
    passed, walked, section, slopes = columns.passed[s], columns.walked[s], columns.sections[s], columns.slopes[s]
    e, j, pieces = step
    z = 1.0 - j / pieces
    inside = np.zeros(LANES, np.bool_)
    for l in range(group.active):
        share = share_at(group.elements, step, len(x), arcs[first + l, s], l)
        inside[l] = share >= 0.0
        work[STEP_SHARE * LANES + l] = max(share, 0.0)
    if not inside.any():
        return
    own = x[e]
    copy_numbers(work, saved[0], STATE * LANES)
    for c in range(len(own)):
        copy_numbers(own[c], saved[1 + c], COLUMN * LANES)
    step_all(group, x[e if j > 0 else max(e - 1, 0)], own, step)
    for l in range(group.active):
        if not inside[l]:
            continue
        share = work[STEP_SHARE * LANES + l] / pieces
        write_slopes(group, z - share, slopes, l)
        for c in range(TIP_COLUMNS):
            section_change(work, own[c], section[c], l)
        for i in range(len(x)):
            walked[i, l] = 1.0 if i < e else 1.0 - z + share if i == e else 0.0
            for c in range(len(own)):
                for k in range(COLUMN):
                    passed[i, c, k * LANES + l] = x[i, c, k * LANES + l] if i <= e else 0.0
    copy_numbers(saved[0], work, STATE * LANES)
    for c in range(len(own)):
        copy_numbers(saved[1 + c], own[c], COLUMN * LANES)


@inline
def write_slopes(group: Group, z: float, slopes: Array, l: int) -> None:
    """R v and R u (mount frame) where lane l stands, at the place z of the buffered element."""
    work = group.work
    q, n, m = unit_quaternion(work, l), vector_of(work, N, l), vector_of(work, M, l)
    section = section_of(work, group.full, ELEMENT_AT, l)
    u, v, _ = strains(m, turned_back(q, n), section, z, l, None, 0, None)
    put(slopes, 0, l, turned(q, v))
    put(slopes, 3, l, turned(q, u))
