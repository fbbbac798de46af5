"""Small CSV tables of states to predict and of targets to reach: numbers by column, every doubt told with its line."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings.bounded import read_bounded
from recordings.numbers import number

from .config import ConfigError

Columns = dict[str, NDArray[np.generic]]

MOST_ROWS = 200_000
TEXTS = ("branch", "protocol")


def read_numbers(path: Path, wanted: Collection[str], pattern: str, needed: str) -> Columns:
    """The columns named in `wanted`, or that match `pattern`, of a CSV file in SI units; others are not read.

    `needed`: what a person has to give. An empty cell is NaN. Raises ConfigError naming file, line, column and value.
    """
    data = read_bounded(path, 50_000_000, ConfigError)  # bytes
    try:
        lines = list(csv.reader(io.StringIO(data.decode("utf-8-sig"), newline="")))
    except (UnicodeDecodeError, csv.Error) as e:
        raise ConfigError(f"{path}: is not a CSV file ({e})") from e
    header = [name.strip() for name in lines[0]] if lines else []
    twice = [name for name in dict.fromkeys(header) if header.count(name) > 1]
    if twice:
        raise ConfigError(f"{path}: the column {twice[0]} stands there twice")
    used = [name for name in header if name in wanted or (pattern and re.fullmatch(pattern, name))]
    if not used:
        raise ConfigError(f"{path}: has no column that is known here; its first line must name {needed}")
    rows = [(k, line) for k, line in enumerate(lines[1:], 2) if any(cell.strip() for cell in line)]
    if not rows:
        raise ConfigError(f"{path}: has no rows below its first line")
    if len(rows) > MOST_ROWS:
        raise ConfigError(f"{path}: has {len(rows)} rows, must be at most {MOST_ROWS}: split the table")
    for k, line in rows:
        if len(line) != len(header):
            raise ConfigError(f"{path}:{k}: has {len(line)} cells, the first line names {len(header)} columns")
    out: Columns = {}
    for name in used:
        position = header.index(name)
        cells = [(k, line[position].strip()) for k, line in rows]
        if name in TEXTS:
            out[name] = np.array([text for _, text in cells])
        else:
            out[name] = np.array([_number(path, k, name, text) for k, text in cells])
    return out


def _number(path: Path, line: int, name: str, text: str) -> float:
    if not text:
        return math.nan
    try:
        value = number(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{path}:{line}: {name} = {text[:40]!r} is not a finite number; write a number in SI units")
    return value
