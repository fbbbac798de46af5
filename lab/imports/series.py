"""A file of another program as columns of numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..files.config import ConfigError

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


def package(name: str, path: Path) -> Any:
    """The library that reads a file; raises ConfigError where it is not installed."""
    try:
        return import_module(name)
    except ImportError as e:
        raise ConfigError(f"{path}: is read with {name}, which is not installed; pip install 'softlab[import]'") from e


def demand_bounded(path: Path, size: int) -> None:
    """Raise ConfigError where a file unpacks to more than `LARGEST` bytes."""
    if size > LARGEST:
        raise ConfigError(f"{path}: unpacked it has {size / 1e6:.0f} MB, at most {LARGEST / 1e6:g} MB are read")


def unique(names: Sequence[str], width: int) -> list[str]:
    """Headings, or numbers from 1 where there is none; one that comes again gets the number of its column."""
    out: list[str] = []
    for i in range(width):
        name = names[i] if i < len(names) and names[i] else str(i + 1)
        out.append(name if name not in out else f"{name} {i + 1}")
    return out
