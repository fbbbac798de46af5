"""The floor of the rod's arithmetic: how long a solve would take were nothing but its sums and products in the way.

A step's operations are counted by running the equations themselves with numbers that count; the processor's rate is measured
with chains of fused operations in registers. A solve takes two passes at least, one to see where the base comes out and one
after the step of Newton's method that this asks for, of as many steps as `Fast.divisions` says.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numba
import numpy as np

from model.rods import FAST
from model.rods.fast.equations import Section
from model.rods.fast.instructions import fused
from model.rods.fast.runge_kutta import Step, step

PASSES = 2
CHAINS, ROUNDS, TRIES = 128, 200_000, 9


class Counting:
    """A number of which only the operations with it count; a change of sign is none."""

    done = 0

    def _one(self, other: object) -> Counting:
        Counting.done += 1
        return self

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _one

    def __neg__(self) -> Counting:
        return self


def as_python(piece: Any, known: dict[Any, Callable[..., Any]]) -> Callable[..., Any]:
    """A piece of a kernel, and all that it calls, as plain Python."""
    if piece not in known:
        names = dict(piece.py_func.__globals__)
        known[piece] = FunctionType(piece.py_func.__code__, names, piece.py_func.__name__)
        for name in piece.py_func.__code__.co_names:
            value = names.get(name)
            if value is fused:
                names[name] = lambda a, b, c: a * b + c
            elif hasattr(value, "py_func"):
                names[name] = as_python(value, known)
    return known[piece]


def operations_of_step() -> int:
    """Sums and products of one step of one rod without hyperelastic terms."""
    one: Any = Counting()
    three = (one, one, one)
    section = Section(three, three, three, three, None, 0)
    Counting.done = 0
    as_python(step, {})((one,) * 10, Step(one, one, one, three, three), section, 0, None)
    return Counting.done


@numba.njit(error_model="numpy")
def _chains(rounds: int) -> float:
    numbers = np.ones(CHAINS)
    for _ in range(rounds):
        for l in range(CHAINS):
            numbers[l] = fused(numbers[l], 0.999, 0.001)
    return float(numbers.sum())


def operations_a_second() -> float:
    """The most that one thread of this processor was seen to do."""
    _chains(1)
    least = np.inf
    for _ in range(TRIES):
        start = time.thread_time()
        _chains(ROUNDS)
        least = min(least, time.thread_time() - start)
    return 2.0 * CHAINS * ROUNDS / float(least)


def floor() -> tuple[float, str]:
    """Seconds a solve, and what they are made of."""
    count, rate, steps = operations_of_step(), operations_a_second(), PASSES * FAST.divisions
    return steps * count / rate, f"{steps:.0f} steps of {count} operations at {1e-9 * rate:.0f} a nanosecond"
