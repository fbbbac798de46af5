"""The compiled solver's memory: numbers in lanes are read and written by their names, wherever the arrays lie."""

from typing import Annotated

import numba
import numpy as np
from numpy.typing import NDArray

from benchmarks.rod_cases import wild_rods
from model.rods.fast.algebra import Vector
from model.rods.fast.compiler import fused
from model.rods.fast.direct import COARSE_DIVISIONS
from model.rods.fast.group import ROD, SECTION, Group, cut, gather
from model.rods.fast.lanes import LANES, Record, copy, copy_lanes, record
from model.rods.fast.newton import first_guess

Array = NDArray[np.float64]


@record
class Inner(Record):
    a: Vector
    b: float


@record
class Outer(Record):
    first: float
    inner: Inner
    many: Annotated[list[Inner], 2]
    rows: Annotated[list[Vector], 2]


def test_a_fused_operation_rounds_once() -> None:
    @numba.njit
    def call(a: float, b: float, c: float) -> float:
        return fused(a, b, c)

    small = 2.0**-30
    # (1 + s)(1 - s) - 1 is -s^2, of which rounding the product first would leave nothing.
    assert call(1.0 + small, 1.0 - small, -1.0) == -(small**2)
    assert call(2.0, 3.0, 4.0) == 10.0


def lane(numbers: Array, l: int, record: int = 0) -> list[float]:
    """The numbers of a lane of one of several records."""
    found: list[float] = numbers.reshape(-1, Outer.size, LANES)[record, :, l].tolist()
    return found


def test_numbers_of_a_record_are_read_and_written_by_name_in_their_lane_only() -> None:
    size = Outer.size

    @numba.njit
    def call(numbers: Array, l: int) -> None:
        one = Outer(numbers, l, size)
        one.inner.a = (one.first, 2.0, 3.0)
        one.inner.b += 4.0
        one.many[1].b = one.inner.a[0]
        one.many[0][1] = 5.0
        one.rows[1] = (6.0, 7.0, one.rows[0][2])

    numbers = np.ones(2 * size * LANES)
    call(numbers, 3)
    assert lane(numbers, 3, 1) == [1.0, 1.0, 2.0, 3.0, 5.0, 1.0, 5.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 6.0, 7.0, 1.0]
    numbers.reshape(2, size, LANES)[1, :, 3] = 1.0
    assert (numbers == 1.0).all()


def test_records_are_copied_in_one_lane_or_in_all() -> None:
    size = Inner.size

    @numba.njit
    def call(source: Array, into: Array) -> None:
        copy(Inner(source, 1), Inner(into, 1), size - 1)
        copy_lanes(Inner(source, 0), Inner(into, 0, size), size)

    source, into = np.arange(1.0, size * LANES + 1), np.zeros(2 * size * LANES)
    call(source, into)
    one, all_lanes = into[: size * LANES].reshape(size, LANES), into[size * LANES :]
    assert one[:3, 1].tolist() == source.reshape(size, LANES)[:3, 1].tolist() and np.count_nonzero(one) == 3
    assert all_lanes.tolist() == source.tolist()


@numba.njit  # type: ignore[untyped-decorator]
def first_pass(rods: Array, springs: int, work: Array, elements: Array) -> None:
    """The first pass of one group whose arrays are these."""
    parts = np.empty(elements.size // (SECTION * LANES), np.int64)
    group = Group(work, elements, parts, springs, True, LANES)
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
