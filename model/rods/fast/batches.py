"""How a batch of rods is handed to the kernels: fixed steps, threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from model.arrays import Ints
from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.fast.lanes import LANES

_NO_STEPS = np.zeros((0, 1), np.int64)


def steps_of(rods: Rods, steps: Ints | None) -> Ints:
    """Fixed steps as the kernels take them, none as no rows; raises `BadCondition` when they do not fit the rods."""
    if steps is None:
        return _NO_STEPS
    if steps.shape != (len(rods), rods.form.elements) or steps.dtype != np.int64 or (steps < 1).any():
        raise BadCondition(f"steps: shape {steps.shape} of {steps.dtype}, must be positive int64 for each element")
    return np.ascontiguousarray(steps)


def share_out(part: Callable[[slice], None], n: int, cores: int) -> None:
    """Call `part` on slices that cover n rows, on `cores` threads (kernels release the interpreter lock)."""
    if cores == 1 or n < 2 * LANES:
        part(slice(0, n))
        return
    edges = np.linspace(0, -(-n // LANES), cores + 1).astype(int) * LANES
    slices = [slice(int(a), min(int(b), n)) for a, b in zip(edges[:-1], edges[1:], strict=True) if a < n]
    with ThreadPoolExecutor(len(slices)) as pool:
        list(pool.map(part, slices))
