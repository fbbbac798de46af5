"""trials.csv: writing it exactly, and reading it with every doubt spelled out."""

from __future__ import annotations

import csv
import difflib
import io
import math
import os
import re
from collections import Counter
from pathlib import Path

from .bounded import read_bounded
from .errors import BadTable
from .numbers import number as number_in
from .own_files import replaced
from .states.rules import BRANCHES, PROTOCOL, PROTOCOL_IS, SPECIMENS
from .trials import DOUBTS, INTEGERS, LARGEST_INTEGER, TEXTS, Cell, Table, TrialRow, column_order

REQUIRED = ("trial", "step", "protocol", "repeat", "branch", "t", "spine_length", "p1")

MOST_COLUMNS = 2000
"""Of a table: a robot of a hundred chambers and markers has a thousand."""
MOST_ROWS = 50_000
LIMITS = (
    (r"p[0-9]+", -100e3, 2e6,
     "{value:g} Pa is outside {low:g} .. {high:g} Pa gauge; pressures are gauge, in Pa: check the unit"),
    (r"[xyz]|m[0-9]+[xyz]|spine_length|deflection", -5.0, 5.0,
     "{value:g} m exceeds {high:g} m: looks like mm or cm; lengths are in m: divide by 1000 or 100"),
    (r"vacuum", -5e3, 110e3, "{value:g} Pa: {looks}give Pa below ambient, from 0 (no vacuum) to about 101 325"),
    (r"hold", 0.0, math.inf, "{value:g} s is before the ramp's end"),
    (r"force_[xyz]", -500.0, 500.0, "{value:g} N exceeds {high:g} N: looks like mN or grams; forces are in N"),
    (r"tip_mass", 0.0, 10.0, "{value:g} kg is outside 0 .. 10 kg: looks like g; masses are in kg: divide by 1000"),
)  # fmt: skip
"""Columns, their least and greatest value, and what is said of any other: no robot of this kind can have it. No chamber can be
below vacuum, none of silicone lives above 20 bar."""

_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+([eE][-+]?[0-9]+)?")
_CHOICES = {"branch": BRANCHES, "specimen": SPECIMENS, "doubt": DOUBTS}


def write_csv(table: Table, path: str | os.PathLike[str]) -> None:
    """Write the table; numbers read back as the same floats. The file is replaced at once or not at all."""
    columns = table.columns
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in table.rows:
        cells = {name: repr(float(x)) if isinstance(x, float) else str(x) for name, x in row.cells().items()}
        writer.writerow([cells.get(name, "") for name in columns])
    replaced(Path(path), text.getvalue())


def read_csv(path: str | os.PathLike[str]) -> Table:
    """Read a table of trials.

    Columns it does not know are left out and named in `Table.ignored`; doubts go to `Table.warnings`. Raises `BadTable`
    naming file, line, column, value, unit and limit when a required column or value is missing or cannot be right.
    """
    path = Path(path)
    # bytes; a row has some 300, and a campaign some thousands of rows
    data = read_bounded(path, 20_000_000, BadTable)
    try:
        lines = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""))
        first = next(lines, [])
        header = [name.strip() for name in first]
        _check_separator(path, first)
        ignored = _check_header(path, header)
        known = frozenset(header) - frozenset(ignored)
        rows = []
        for number, line in enumerate(lines, 2):
            if any(cell.strip() for cell in line):
                rows.append(_row(f"{path} line {number}", header, known, line))
            if len(rows) > MOST_ROWS:
                raise BadTable(f"{path}: has more than {MOST_ROWS} rows, the limit for a table of trials")
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadTable(f"{path}: is not a text table: {error}") from error
    if not rows:
        raise BadTable(f"{path}: has a header but no rows")
    return Table(tuple(rows), ignored, tuple(_doubts(rows)))


def _check_separator(path: Path, first: list[str]) -> None:
    """Spreadsheets of many countries write semicolons, and commas in numbers; others tabs."""
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        names = [part.strip(' "') for cell in first for part in cell.split(mark)]
        if len(names) > len(first) and any(column_order(part) for part in names):
            raise BadTable(
                f"{path} line 1: columns are separated by {name} ({','.join(first)[:60]!r} ..); write commas between columns and "
                "points in numbers (0.40, not 0,40)"
            )


def _check_header(path: Path, header: list[str]) -> tuple[str, ...]:
    if not header:
        raise BadTable(f"{path}: is empty; the first line must name the columns ({', '.join(REQUIRED)}, ..)")
    if len(header) > MOST_COLUMNS:
        raise BadTable(f"{path}: has {len(header)} columns, the limit for a table of trials is {MOST_COLUMNS}")
    twice = sorted(name for name, count in Counter(header).items() if count > 1)
    if twice:
        raise BadTable(f"{path}: column {', '.join(twice)[:200]} appears twice")
    ignored = tuple(name for name in header if column_order(name) is None)
    for name in REQUIRED:
        if name not in header:
            near = difflib.get_close_matches(name, ignored, 1, 0.5)
            hint = f" (is it the column {near[0]!r}?)" if near else ""
            raise BadTable(f"{path}: no column {name}{hint}; required are {', '.join(REQUIRED)}")
    return ignored


def _row(where: str, header: list[str], known: frozenset[str], line: list[str]) -> TrialRow:
    if len(line) != len(header):
        split = "; a decimal comma splits one number into two cells: write points (0.40)" if len(line) > len(header) else ""
        raise BadTable(f"{where}: {len(line)} cells under {len(header)} columns{split}")
    cells: dict[str, Cell] = {}
    for name, text in zip(header, (cell.strip() for cell in line), strict=True):
        if not text or name not in known:
            continue
        cells[name] = _value(where, name, text)
    try:
        row = TrialRow.from_cells(cells)
    except BadTable as error:
        raise BadTable(f"{where}: {error}") from error
    if row.protocol == "stiffness":
        if row.force is None or row.deflection is None or row.specimen is None:
            raise BadTable(f"{where}: a stiffness row needs specimen, force and deflection")
    elif row.tip is None:
        raise BadTable(f"{where}: a {row.protocol} row needs the tip's x, y, z")
    return row


def _value(where: str, name: str, text: str) -> Cell:
    """One cell, checked."""
    if name in TEXTS:
        if name == "protocol":
            if not PROTOCOL.fullmatch(text):
                raise BadTable(f"{where}, {name}: {text[:80]!r} {PROTOCOL_IS}")
        elif text not in _CHOICES[name]:
            raise BadTable(f"{where}, {name}: {text[:80]!r} is not one of {', '.join(_CHOICES[name])}")
        return text
    try:
        number = number_in(text)
    except ValueError:
        comma = f"; looks like a decimal comma: write {text.replace(',', '.')}" if _DECIMAL_COMMA.fullmatch(text[:80]) else ""
        raise BadTable(f"{where}, {name}: {text[:80]!r} is not a number{comma}") from None
    if not math.isfinite(number):
        raise BadTable(f"{where}, {name}: is {text[:80]}; leave the cell empty where nothing was measured")
    if name in INTEGERS:
        if abs(number) > LARGEST_INTEGER:
            raise BadTable(f"{where}, {name}: {number:g} exceeds {LARGEST_INTEGER}")
        if number != int(number):
            raise BadTable(f"{where}, {name}: {text} is not a whole number")
        return int(number)
    if name == "clipped" and number not in (0, 1):
        text = "is neither 0 nor 1; 1 where set-points were clipped, else 0 or empty"
        raise BadTable(f"{where}, {name}: {number:g} {text}")
    for pattern, low, high, text in LIMITS:
        if re.fullmatch(pattern, name) and not low <= number <= high:
            looks = "looks like gauge pressure: change the sign; " if -110e3 <= number < 0 else ""
            raise BadTable(f"{where}, {name}: {text.format(value=number, low=low, high=high, looks=looks)}")
    return number


def _doubts(rows: list[TrialRow]) -> list[str]:
    """What may be right but looks like another unit or a mistake."""
    doubts = []
    highest = max(abs(p) for row in rows for p in row.pressures)
    if 20 < highest < 1000 and any(row.protocol != "stiffness" for row in rows):
        doubts.append(f"no pressure is above {highest:g} Pa: if these are kPa, multiply p1.. by 1000")
    tips = [max(abs(c) for c in row.tip) for row in rows if row.tip is not None]
    if tips and max(tips) < 0.005:
        doubts.append(f"no tip is further than {max(tips) * 1e3:g} mm from the base: are x, y, z in m?")
    vacuum = max((row.vacuum or 0.0 for row in rows), default=0.0)
    if 5 < vacuum < 150 and any(row.spine_length > 0 for row in rows):
        doubts.append(f"no vacuum is above {vacuum:g} Pa below ambient: if these are kPa, multiply vacuum by 1000")
    for name in sorted({row.protocol for row in rows}):
        near = difflib.get_close_matches(name, ("bending", "elongation", "stiffness"), 1, 0.8)
        if near and not name.startswith(near[0]):
            doubts.append(f"protocol {name[:40]!r}: did you mean {near[0]!r}?")
    seen: set[tuple[int, int]] = set()
    for row in rows:
        if (row.trial, row.step) in seen:
            doubts.append(f"trial {row.trial} step {row.step} appears more than once")
        seen.add((row.trial, row.step))
    return doubts
