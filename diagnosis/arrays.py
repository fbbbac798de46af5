"""Arrays by the type of what they hold, and their root mean square."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]
DIGITS = 7  # significant digits of numbers that are written


def rows_by(number: Ints) -> list[Ints]:
    """The rows of each number of (n,), ascending, numbers in their order."""
    order = np.argsort(number, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(number[order])) + 1) if len(order) else []


def equal_rows(rows: Array) -> tuple[Ints, Ints]:
    """The first (k,) of each set of equal rows (n, columns), and the set (n,) of each row."""
    keys, first = rows.view(f"V{rows.itemsize * rows.shape[1]}").ravel().tolist(), dict[bytes, int]()
    return np.unique(list(map(first.setdefault, keys, range(len(keys)))), return_inverse=True)


def scattered(shape: tuple[int, ...], at: Any, values: Array) -> Array:
    """An array of this shape with `values` at the indices `at`, NaN elsewhere."""
    out = np.full(shape, np.nan)
    out[at] = values
    return out


def rms(values: Array) -> float:
    """Root mean square of the finite values, of rows (n, k) that of their lengths; NaN of nothing."""
    distance = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
    known = distance[np.isfinite(distance)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


def rounded(value: float, digits: int = DIGITS) -> float:
    """Round a number to this many significant digits."""
    return float(f"{value:.{digits}g}")
