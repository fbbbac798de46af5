"""A file of another program as columns of numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Texts = NDArray[np.str_]

LARGEST = 500_000_000
"""Bytes of a file."""


@dataclass(frozen=True)
class Series:
    """Rows of a file: numbers (n,) by column, NaN where there is none, and columns of words."""

    path: Path
    numbers: Mapping[str, Array]
    words: Mapping[str, Texts] = field(default_factory=dict)
    form: str = ""
    """How it was read, as a person would say it."""

    def __len__(self) -> int:
        return len(next(iter(self.numbers.values()), ()))

    @property
    def names(self) -> tuple[str, ...]:
        """Of all columns."""
        return (*self.numbers, *self.words)


def unique(names: Sequence[str], width: int) -> list[str]:
    """Headings, or numbers from 1 where there is none; one that comes again gets the number of its column."""
    out: list[str] = []
    for i in range(width):
        name = names[i] if i < len(names) and names[i] else str(i + 1)
        out.append(name if name not in out else f"{name} {i + 1}")
    return out
