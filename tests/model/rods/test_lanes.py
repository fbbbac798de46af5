"""The compiled solver's numbers are the same wherever its arrays lie, and a fused operation rounds once."""

import numba
import numpy as np
from numpy.typing import NDArray

from benchmarks.rod_cases import wild_rods
from model.rods.fast.compiler import fused
from model.rods.fast.direct import COARSE_DIVISIONS
from model.rods.fast.group import ROD, SECTION, RodGroup, cut, gather
from model.rods.fast.lanes import LANES
from model.rods.fast.newton import first_guess

Array = NDArray[np.float64]


def test_a_fused_operation_rounds_once() -> None:
    @numba.njit
    def call(a: float, b: float, c: float) -> float:
        return fused(a, b, c)

    small = 2.0**-30
    # (1 + s)(1 - s) - 1 is -s^2, of which rounding the product first would leave nothing.
    assert call(1.0 + small, 1.0 - small, -1.0) == -(small**2)
    assert call(2.0, 3.0, 4.0) == 10.0


@numba.njit  # type: ignore[untyped-decorator]
def first_pass(rods: Array, springs: int, work: Array, elements: Array) -> None:
    """The first pass of one group whose arrays are these."""
    parts = np.empty(elements.size // (SECTION * LANES), np.int64)
    group = RodGroup(work, elements, parts, springs, True, LANES)
    gather(rods, group, 0)
    cut(group, COARSE_DIVISIONS)
    first_guess(group)


def test_arrays_side_by_side_give_the_same_bits_as_arrays_far_apart() -> None:
    # Compiled code takes another way where it cannot exclude that arrays overlap.
    robots = wild_rods(LANES, 3)
    size, found = robots.form.elements * SECTION * LANES, []
    for between in (0, 64, 10 * size):
        memory = np.zeros(2 * (size + ROD * LANES) + between)
        elements, work = memory[:size], memory[size + between : size + between + ROD * LANES]
        first_pass(robots.values, robots.form.springs, work, elements)
        found.append(work.copy())
        work, elements = memory[: ROD * LANES], memory[ROD * LANES + between : ROD * LANES + between + size]
        memory[:] = 0.0
        first_pass(robots.values, robots.form.springs, work, elements)
        found.append(work.copy())
    assert np.ptp(found[0]) > 0.0
    assert all(np.array_equal(one, found[0]) for one in found[1:])
