"""The order of messages by what they say of themselves, whatever their order in the file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def ordered(keys: Sequence[NDArray[Any]], content: Callable[[int], bytes]) -> NDArray[np.int64]:
    """Indices of n messages by keys of shape (n,), the last one first.

    Messages that are equal in all keys are told apart by `content`; which of two equal ones comes first does not matter.
    """
    order = np.lexsort(keys).astype(np.int64)
    same = np.all([np.diff(key[order]) == 0 for key in keys], axis=0)
    for first, last in _runs(same):
        order[first:last] = sorted(order[first:last].tolist(), key=content)
    return order


def _runs(same: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First and one past the last of each run of equal neighbours; same[i]: item i equals item i + 1."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False])).astype(np.int8)))
    for first, last in edges.reshape(-1, 2).tolist():
        yield first, last + 1
