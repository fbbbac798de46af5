"""Tables of poses of an arm: joint angles q1 .. and, where they were measured, the positions x, y, z reached."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from model.arm import Arm
from recordings.errors import BadTable
from recordings.table_file import MOST_STATES, read_columns
from recordings.trials import ORIENTATION

from .config import ConfigError
from .units import UnitError, to_si

POSITION = ("x", "y", "z")
OPTIONAL = ("repeat",)
MOST_NAMED = 5
"""Rows that a note names one by one."""


def read_poses(path: Path, arm: Arm, measured: bool = True) -> tuple[pd.DataFrame, tuple[str, ...], Callable[[int], str]]:
    """Columns in rad and m of the rows that have all angles and, if they are `measured`, a position; notes on the others; and
    what names a row, from 0, in messages. A heading may state a unit, `x [mm]`. Raises `BadTable`."""
    path = path / "trials.csv" if path.is_dir() else path
    needed = (*arm.joints, *(POSITION if measured else ()))
    before = tuple(f"{joint}_before" for joint in arm.joints)
    headings: dict[str, str] = {}

    def chosen(header: list[str]) -> list[str]:
        for name in header:
            bare = re.sub(r"\s*[\[(].*", "", name)
            if bare in (*needed, *before, *OPTIONAL) and headings.setdefault(bare, name) != name:
                raise BadTable(f"{path}: the columns {headings[bare]} and {name} are both {bare}: leave one out")
        for name in (name for name in needed if name not in headings):
            near = difflib.get_close_matches(name, [n for n in header if n not in headings.values()], 1, 0.5)
            hint = f" (is it the column {near[0]!r}?)" if near else ""
            wanted = f"{arm.joints[0]} .. {arm.joints[-1]} in rad{' and x, y, z in m' if measured else ''}"
            raise BadTable(f"{path}: no column {name}{hint}; the first line must name {wanted}")
        return list(headings.values())

    header, columns, place = read_columns(path, chosen, MOST_STATES, finite=False)
    table = pd.DataFrame({bare: columns[name] * _factor(path, bare, name) for bare, name in headings.items()})
    lacking = ~np.isfinite(table[list(needed)].to_numpy())
    rows = np.flatnonzero(lacking.any(axis=1)).tolist()
    notes = [f"{place(i)}, {needed[int(lacking[i].argmax())]}: holds no finite number; the row is left out" for i in rows]
    if len(notes) > MOST_NAMED:
        notes[MOST_NAMED:] = [f"{path}: {len(notes) - MOST_NAMED} more rows lack a number and are left out"]
    if measured and {*ORIENTATION} & {*header}:
        notes.append(f"{path}: {', '.join(ORIENTATION)} are not used: positions alone are weighed")
    whole = np.flatnonzero(~lacking.any(axis=1))
    if not len(whole):
        raise BadTable(f"{path}: no row has all of {', '.join(needed)}; fill in the cells")
    return table.iloc[whole].reset_index(drop=True), tuple(notes), lambda row: place(int(whole[row]))


def _factor(path: Path, bare: str, heading: str) -> float:
    """Of the unit that a heading states, to rad or m; raises ConfigError."""
    stated = re.search(r"[\[(](.*)[\])]", heading)
    try:
        return 1.0 if stated is None else to_si(f"1 {stated[1]}", "m" if bare in POSITION else "1" if bare in OPTIONAL else "rad")
    except UnitError as e:
        raise ConfigError(f"{path}, {heading}: {e}") from e
