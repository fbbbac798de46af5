"""What a group of rods finds does not depend on where its arrays lie in memory."""

import numba
import numpy as np
from numpy.typing import NDArray

from model.rods.fast.direct import COARSE_DIVISIONS
from model.rods.fast.group import ROD, SECTION, Group, RowLayout, cut, gather
from model.rods.fast.lanes import LANES
from model.rods.fast.newton import first_guess
from tests.model.rods.cases import wild_robots

Array = NDArray[np.float64]


@numba.njit  # type: ignore[untyped-decorator]
def first_pass(rods: Array, layout: tuple[int, int, int], work: Array, elements: Array) -> None:
    """The first pass of one group whose arrays are these."""
    at = RowLayout(layout[0], layout[1], layout[2])
    parts = np.empty(elements.size // (SECTION * LANES), np.int64)
    group = Group(work, elements, None, parts, at.springs, LANES)
    gather(rods, at, group, 0)
    cut(group, COARSE_DIVISIONS)
    first_guess(group)


def test_arrays_side_by_side_give_the_same_bits_as_arrays_far_apart() -> None:
    # Compiled code takes another way where it cannot exclude that arrays overlap.
    robots = wild_robots(LANES, 3)
    size, found = robots.form.elements * SECTION * LANES, []
    for between in (0, 64, 10 * size):
        memory = np.zeros(2 * (size + ROD * LANES) + between)
        elements, work = memory[:size], memory[size + between : size + between + ROD * LANES]
        first_pass(robots.values, robots.form.columns, work, elements)
        found.append(work.copy())
        work, elements = memory[: ROD * LANES], memory[ROD * LANES + between : ROD * LANES + between + size]
        memory[:] = 0.0
        first_pass(robots.values, robots.form.columns, work, elements)
        found.append(work.copy())
    assert np.ptp(found[0]) > 0.0
    assert all(np.array_equal(one, found[0]) for one in found[1:])
