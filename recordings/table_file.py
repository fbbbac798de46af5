"""trials.csv: writing it exactly, and reading it with every doubt spelled out."""

from __future__ import annotations

import contextlib
import csv
import difflib
import io
import math
import os
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bounded import read_bounded
from .errors import BadTable
from .numbers import number as number_in
from .own_files import replaced
from .states.rules import BRANCHES, PROTOCOL, PROTOCOL_IS, SPECIMENS
from .trials import DOUBTS, INTEGERS, LARGEST_INTEGER, REQUIRED, TEXTS, Cell, Table, column_order, highest, incomplete, present

MOST_COLUMNS = 2000
"""Of a table: a robot of a hundred chambers and markers has a thousand."""
MOST_ROWS, MOST_STATES, LARGEST = 50_000, 200_000, 50_000_000
"""Rows of a table of trials and of any other, and bytes of a table; a row has some 300."""
LIMITS = (
    (r"p[0-9]+", -100e3, 2e6,
     "{value:g} Pa is outside {low:g} .. {high:g} Pa gauge; pressures are gauge, in Pa: check the unit"),
    (r"[xyz]|m[0-9]+[xyz]|spine_length|deflection", -5.0, 5.0,
     "{value:g} m exceeds {high:g} m: looks like mm or cm; lengths are in m: divide by 1000 or 100"),
    (r"vacuum", -5e3, 110e3, "{value:g} Pa: {looks}give Pa below ambient, from 0 (no vacuum) to about 101 325"),
    (r"hold", 0.0, math.inf, "{value:g} s is before the ramp's end"),
    (r"force_[xyz]", -500.0, 500.0, "{value:g} N exceeds {high:g} N: looks like mN or grams; forces are in N"),
    (r"tip_mass", 0.0, 10.0, "{value:g} kg is outside 0 .. 10 kg: looks like g; masses are in kg: divide by 1000"),
    (r".*", -math.inf, math.inf, ""),
)  # fmt: skip
"""Columns, their least and greatest value, and what is said of any other: no robot of this kind can have it. No chamber can be
below vacuum, none of silicone lives above 20 bar."""

_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+([eE][-+]?[0-9]+)?")
_CHOICES = {"branch": BRANCHES, "specimen": SPECIMENS, "doubt": DOUBTS}


def write_csv(table: Table, path: str | os.PathLike[str]) -> None:
    """Write the table; numbers read back as the same floats. The file is replaced at once or not at all."""
    rows = zip(*(_texts(name, table[name]) for name in table.columns), strict=True)
    replaced(Path(path), csv_text([table.columns, *rows]))


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Rows as CSV; numbers read back as the same floats, and None is an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _texts(name: str, column: NDArray[Any]) -> list[str]:
    """The cells of a column."""
    if name in TEXTS:
        return [str(text) for text in column]
    whole = name in INTEGERS or name == "clipped"
    return ["" if x != x else str(int(x)) if whole else repr(x) for x in column.tolist()]


def read_csv(path: str | os.PathLike[str]) -> Table:
    """Read a table of trials.

    Columns it does not know are left out and named in `Table.ignored`; doubts go to `Table.warnings`. Raises `BadTable`
    naming file, line, column, value, unit and limit when a required column or value is missing or cannot be right.
    """
    path = Path(path)
    header, columns, place = read_columns(path, lambda names: _trials_columns(path, names), MOST_ROWS)
    return checked(columns, place, tuple(name for name in header if name not in columns))


def read_columns(
    path: Path, choose: Callable[[list[str]], Collection[str]], most_rows: int, finite: bool = True
) -> tuple[list[str], dict[str, NDArray[Any]], Callable[[int], str]]:
    """The first line of a CSV file, the columns (n,) that `choose` picks of it, and what names a row, from 0, in messages.

    Columns hold text, or numbers, NaN where a cell is empty. Raises `BadTable` naming the cell, if `finite` also of inf and NaN.
    """
    data = read_bounded(path, LARGEST, BadTable)
    try:
        lines = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""))
        first = next(lines, [])
        header = [name.strip() for name in first]
        _check_header(path, first, header)
        chosen = choose(header)
        rows = [(number, line) for number, line in enumerate(lines, 2) if any(map(str.strip, line))]
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadTable(f"{path}: is not a text table: {error}") from error
    if not rows:
        raise BadTable(f"{path}: has a header but no rows")
    if len(rows) > most_rows:
        raise BadTable(f"{path}: has {len(rows)} rows, must be at most {most_rows}: split the table")
    for number, line in rows:
        if len(line) != len(header):
            split = "; a decimal comma splits one number into two cells: write points (0.40)" if len(line) > len(header) else ""
            raise BadTable(f"{path} line {number}: {len(line)} cells under {len(header)} columns{split}")

    def place(row: int) -> str:
        return f"{path} line {rows[row][0]}"

    cells = zip(header, zip(*(line for _, line in rows), strict=True), strict=True)
    return header, {n: _parsed(n, [cell.strip() for cell in column], place, finite) for n, column in cells if n in chosen}, place


def read_numbers(path: Path, wanted: Collection[str], pattern: str, needed: str) -> dict[str, NDArray[Any]]:
    """The columns named in `wanted`, or that match `pattern`, of a table of states to predict or of targets, in SI units; others
    are not read.

    `needed`: what a person has to give. Raises `BadTable` naming file, line, column and value.
    """

    def used(header: list[str]) -> list[str]:
        if names := [name for name in header if name in wanted or (pattern and re.fullmatch(pattern, name))]:
            return names
        raise BadTable(f"{path}: has no column that is known here; its first line must name {needed}")

    return read_columns(path, used, MOST_STATES)[1]


def _check_header(path: Path, first: list[str], header: list[str]) -> None:
    """Raise `BadTable` where a first line names no columns, or some twice; spreadsheets of many countries write semicolons, and
    commas in numbers, others tabs."""
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        names = [part.strip(' "') for cell in first for part in cell.split(mark)]
        if len(names) > len(first) and any(column_order(part) for part in names):
            raise BadTable(
                f"{path} line 1: columns are separated by {name} ({','.join(first)[:60]!r} ..); write commas between columns and "
                "points in numbers (0.40, not 0,40)"
            )
    if not header:
        raise BadTable(f"{path}: is empty; the first line must name the columns ({', '.join(REQUIRED)}, ..)")
    if len(header) > MOST_COLUMNS:
        raise BadTable(f"{path}: has {len(header)} columns, the limit for a table of trials is {MOST_COLUMNS}")
    twice = sorted(name for name, count in Counter(header).items() if count > 1)
    if twice:
        raise BadTable(f"{path}: column {', '.join(twice)[:200]} appears twice")


def _trials_columns(path: Path, header: list[str]) -> list[str]:
    """The columns of a table of trials; raises `BadTable` where one that is required is missing."""
    known = [name for name in header if column_order(name) is not None]
    for name in REQUIRED:
        if name not in known:
            near = difflib.get_close_matches(name, [n for n in header if n not in known], 1)
            hint = f" (is it the column {near[0]!r}?)" if near else ""
            raise BadTable(f"{path}: no column {name}{hint}; required are {', '.join(REQUIRED)}")
    return known


def _parsed(name: str, cells: Sequence[str], place: Callable[[int], str], finite: bool) -> NDArray[Any]:
    """A column as text or numbers, NaN where a cell is empty; raises `BadTable`."""
    if name in TEXTS:
        return np.array(cells, np.str_)
    if not "".join(cells).encode().translate(None, b"0123456789+-.eE"):  # of such texts float() reads the same numbers
        with contextlib.suppress(ValueError):
            values = np.array([float(text or "nan") for text in cells])
            if not np.isinf(values).any():
                return values
    values = np.full(len(cells), math.nan)
    for row, text in enumerate(cells):
        try:
            values[row] = number_in(text) if text else math.nan
        except ValueError:
            comma = f"; looks like a decimal comma: write {text.replace(',', '.')}" if _DECIMAL_COMMA.fullmatch(text[:80]) else ""
            raise BadTable(f"{place(row)}, {name}: {text[:80]!r} is not a number{comma}") from None
        if finite and text and not math.isfinite(values[row]):
            raise BadTable(f"{place(row)}, {name}: is {text[:80]}; leave the cell empty where nothing was measured")
    return values


def checked(
    columns: Mapping[str, NDArray[Any]], place: Callable[[int], str], ignored: tuple[str, ...] = (), limits: bool = True
) -> Table:
    """The table of columns (n,) of text or of numbers in SI, NaN where there is none: what every table from outside passes.

    Doubts go to `Table.warnings`. Raises `BadTable` with the place of the first row, from 0, whose value cannot stand in its
    column, or that lacks one. `limits`: whether values are held against `LIMITS`, which know no robot.
    """
    for name, column in columns.items():
        for row in _suspects(name, column, limits):
            if wrong := _wrong(name, column[row].item(), limits):
                raise BadTable(f"{place(row)}, {name}: {wrong}")
    for row, lacking in enumerate(lacks(columns)):
        if lacking:
            raise BadTable(f"{place(row)}: {lacking}")
    table = Table({name: column.astype(np.int64) if name in INTEGERS else column for name, column in columns.items()}, ignored)
    first = np.unique(np.column_stack([table.trial, table["step"]]), axis=0, return_index=True)[1]
    again = ~np.isin(np.arange(len(table)), first)
    copy = table.to_frame().duplicated().to_numpy() if again.any() else again
    said = f" appears more than once (such rows: {again.sum()}; of these equal in every cell, and left out: {copy.sum()})"
    doubts = _doubts(table) + [f"{table.place(i)}{said}" for i in np.flatnonzero(again)[:1].tolist()]
    return replace(table.take(~copy), warnings=tuple(doubts))


def lacks(columns: Mapping[str, NDArray[Any]]) -> list[str]:
    """What each row of columns (n,) of a table lacks; empty for a row that has all."""
    counts, protocols = highest(columns), columns.get("protocol")  # of chambers and markers
    pushed = protocols == "stiffness" if protocols is not None else np.zeros(len(next(iter(columns.values()))), bool)
    # rows with values in the same columns lack the same
    patterns, of_row = np.unique(np.column_stack([pushed, *map(present, columns.values())]), axis=0, return_inverse=True)
    by_pattern = []
    for of_stiffness, *has_value in patterns.tolist():
        given = frozenset(compress(columns, has_value))
        pushes = {"specimen", "force", "deflection"} <= given or not of_stiffness
        by_pattern.append(incomplete(given, *counts) or "a stiffness row needs specimen, force and deflection" * (not pushes))
    return [by_pattern[k] for k in of_row.ravel().tolist()]


def _suspects(name: str, column: NDArray[Any], limits: bool) -> list[int]:
    """The rows whose value may be wrong, ascending: numbers beyond the column's limits; of other values the first row of each."""
    rows = np.flatnonzero(present(column))
    if column.dtype.kind == "f" and name not in (*INTEGERS, "clipped", "protocol"):
        low, high, _ = _limits(name) if limits else LIMITS[-1][1:]
        return list(map(int, rows[~((column[rows] >= low) & (column[rows] <= high))]))
    return sorted(map(int, rows[np.unique(column[rows], return_index=True)[1]]))


def _wrong(name: str, value: Cell, limits: bool) -> str:
    """Why a value cannot stand in a column; empty where it can."""
    if name == "protocol":
        return "" if PROTOCOL.fullmatch(str(value)) else f"{str(value)[:80]!r} {PROTOCOL_IS}"
    if isinstance(value, str):
        choices = _CHOICES.get(name, (value,))
        return "" if value in choices else f"{value[:80]!r} is not one of {', '.join(choices)}"
    if name in INTEGERS and abs(value) > LARGEST_INTEGER:
        return f"{value:g} exceeds {LARGEST_INTEGER}"
    if name in INTEGERS and value != int(value):
        return f"{value:g} is not a whole number"
    if name == "clipped" and value not in (0, 1):
        return f"{value:g} is neither 0 nor 1; 1 where set-points were clipped, else 0 or empty"
    low, high, text = _limits(name) if limits else LIMITS[-1][1:]
    looks = "looks like gauge pressure: change the sign; " if -110e3 <= value < 0 else ""
    return "" if low <= value <= high else text.format(value=value, low=low, high=high, looks=looks)


@cache
def _limits(name: str) -> tuple[float, float, str]:
    """Least and greatest value of a column, and what is said of any other."""
    return next((low, high, text) for pattern, low, high, text in LIMITS if re.fullmatch(pattern, name))


def _doubts(table: Table) -> list[str]:
    """What may be right but looks like another unit or a mistake."""
    doubts = []
    vacuum = float(table.get("vacuum", 0.0).max())
    if 5 < vacuum < 150 and (table.spine_length > 0).any():
        doubts.append(f"no vacuum is above {vacuum:g} Pa below ambient: if these are kPa, multiply vacuum by 1000")
    if (unread := table.unread).any() and table.with_tip.any():
        doubts.append(f"{unread.sum()} of {len(table)} states have no tip: they count as history alone")
    for name in np.unique(table["protocol"]).tolist():
        near = difflib.get_close_matches(name, ("bending", "elongation", "stiffness"), 1, 0.8)
        if near and not name.startswith(near[0]):
            doubts.append(f"protocol {name[:40]!r}: did you mean {near[0]!r}?")
    return doubts
