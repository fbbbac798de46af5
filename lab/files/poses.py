"""Tables of poses of an arm: joint angles q1 .. and, where they were measured, the positions x, y, z reached; as a run of
`arm_accuracy` writes them, and as `lab diagnose poses.csv --robot arm.yaml` takes them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.frames import alignment, matrix_from_quaternion, quaternion_from_matrix
from model.arm import Arm
from model.errors import alike
from recordings.errors import BadTable
from recordings.file.reader import Recording
from recordings.own_files import replacing
from recordings.table_file import MOST_STATES, read_columns
from recordings.trials import ORIENTATION, TIP, Table

from .config import in_si

OPTIONAL = ("repeat",)
MOST_NAMED = 5
"""Rows that a note names one by one."""
SAME = 1e-3
"""rad; a pose whose joints differ by less is the same one, visited again."""
FEWEST = 8
"""Poses with which the cameras' frame is aligned: ten numbers are fitted to three of each."""


def read_poses(path: Path, arm: Arm, measured: bool = True) -> tuple[pd.DataFrame, tuple[str, ...], Callable[[int], str]]:
    """Columns in rad and m of the rows that have all angles and, if they are `measured`, a position; notes on the others; and
    what names a row, from 0, in messages. A heading may state a unit, `x [mm]`. Raises `BadTable`."""
    path = path / "trials.csv" if path.is_dir() else path
    needed = (*arm.joints, *(TIP if measured else ()))
    before = tuple(f"{joint}_before" for joint in arm.joints)
    headings: dict[str, str] = {}

    def chosen(header: list[str]) -> list[str]:
        for name in header:
            bare = re.sub(r"\s*[\[(].*", "", name)
            if bare in (*needed, *before, *OPTIONAL) and headings.setdefault(bare, name) != name:
                raise BadTable(f"{path}: the columns {headings[bare]} and {name} are both {bare}: leave one out")
        for name in (name for name in needed if name not in headings):
            near = alike(name, [n for n in header if n not in headings.values()])
            hint = f" (is it the column {near!r}?)" if near else ""
            wanted = f"{arm.joints[0]} .. {arm.joints[-1]} in rad{' and x, y, z in m' if measured else ''}"
            raise BadTable(f"{path}: no column {name}{hint}; the first line must name {wanted}")
        return list(headings.values())

    header, columns, place = read_columns(path, chosen, MOST_STATES, finite=False)
    table = pd.DataFrame({bare: columns[name] * _factor(path, bare, name) for bare, name in headings.items()})
    lacking = ~np.isfinite(table[list(needed)].to_numpy())
    rows = np.flatnonzero(lacking.any(axis=1)).tolist()
    notes = [f"{place(i)}, {needed[int(lacking[i].argmax())]}: is not a finite number; the row is skipped" for i in rows]
    if len(notes) > MOST_NAMED:
        notes[MOST_NAMED:] = [f"{path}: {len(notes) - MOST_NAMED} more rows lack a number and were skipped"]
    if measured and {*ORIENTATION} & {*header}:
        notes.append(f"{path}: {', '.join(ORIENTATION)} are not used: only positions are fitted")
    whole = np.flatnonzero(~lacking.any(axis=1))
    if not len(whole):
        raise BadTable(f"{path}: no row has all of {', '.join(needed)}; fill in the cells")
    return table.iloc[whole].reset_index(drop=True), tuple(notes), lambda row: place(int(whole[row]))


def _factor(path: Path, bare: str, heading: str) -> float:
    """Of the unit that a heading states, to rad or m; raises ConfigError."""
    stated = re.search(r"[\[(](.*)[\])]", heading)
    unit = "m" if bare in TIP else "1" if bare in OPTIONAL else "rad"
    return 1.0 if stated is None else in_si(f"{path}, {heading}", f"1 {stated[1]}", unit)


def write_poses(recording: Recording, table: Table, file: Path) -> dict[str, Any]:
    """Write the states of the arm: q1 .. (rad; visits of one pose have their mean), in its base frame x, y, z (m) and qw .. qz of
    the body, and repeat. Nothing where there are too few.

    Returns `poses`: the file; `tool`: place of the body, m from the TCP; `position_sd` (m): of the arm's error along each axis.
    The cameras' frame is aligned so that the body fits the TCP of the controller's kinematics best."""
    table = table.take(~np.isnan(table.get("joint1")) & ~np.isnan(table.tip).any(axis=1) & ~table.doubtful)
    if len(table) < FEWEST:
        return {}
    arm = recording.stream("/arm")
    fit = alignment(arm["tcp_pose"][np.clip(np.searchsorted(arm["t"], table.get("t")), 0, len(arm) - 1)], table.tip)
    names = [name for name in table.columns if name.startswith("joint")]
    joints = np.column_stack([table[name] for name in names])
    same = np.abs(joints[:, None] - joints).max(axis=2) < SAME
    turns = [quaternion_from_matrix(fit.rotation.T @ matrix_from_quaternion(tuple(q))) for q in table.orientation.tolist()]
    values = np.column_stack([same / same.sum(axis=1)[:, None] @ joints, fit.back(table.tip), turns])
    frame = pd.DataFrame(values, columns=[*(f"q{k + 1}" for k in range(len(names))), *"xyz", "qw", "qx", "qy", "qz"]).assign(
        repeat=table["repeat"]
    )
    with replacing(file) as (stream, _):
        frame.to_csv(stream, index=False, lineterminator="\n", mode="wb")
    return {"poses": str(file), "tool": fit.point.tolist(), "position_sd": fit.rmse / math.sqrt(3)}
