"""Single instructions of kernels say what Python's words say."""

import numba
import numpy as np

from model.rods.fast.instructions import fused, number_at, put_number


def test_a_fused_operation_rounds_once() -> None:
    @numba.njit
    def call(a: float, b: float, c: float) -> float:
        return fused(a, b, c)

    small = 2.0**-30
    # (1 + s)(1 - s) - 1 is -s^2, of which rounding the product first would leave nothing.
    assert call(1.0 + small, 1.0 - small, -1.0) == -(small**2)
    assert call(2.0, 3.0, 4.0) == 10.0


def test_numbers_are_read_and_put_in_their_places() -> None:
    @numba.njit
    def call(array: np.ndarray, i: int) -> None:
        put_number(array, i, 2.0 * number_at(array, i - 1))

    array = np.arange(4.0)
    call(array, 3)
    assert array.tolist() == [0.0, 1.0, 2.0, 4.0]
    call(array[1:], 1)
    assert array.tolist() == [0.0, 1.0, 2.0, 4.0]
