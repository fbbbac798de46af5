"""Small CSV tables of states to predict and of targets to reach."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.errors import BadTable
from recordings.table_file import read_columns

from .config import ConfigError

Columns = dict[str, NDArray[np.generic]]

MOST_ROWS = 200_000


def read_numbers(path: Path, wanted: Collection[str], pattern: str, needed: str) -> Columns:
    """The columns named in `wanted`, or that match `pattern`, of a CSV file in SI units; others are not read.

    `needed`: what a person has to give. An empty cell is NaN. Raises ConfigError naming file, line, column and value.
    """

    def used(header: list[str]) -> list[str]:
        if names := [name for name in header if name in wanted or (pattern and re.fullmatch(pattern, name))]:
            return names
        raise ConfigError(f"{path}: has no column that is known here; its first line must name {needed}")

    try:
        return read_columns(path, used, MOST_ROWS)[1]
    except BadTable as e:
        raise ConfigError(str(e)) from e
