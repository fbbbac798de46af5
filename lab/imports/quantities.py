"""What a map makes of the columns of one file: times, pressures, places and turns of all rows, in SI and in the robot's frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recordings.trials import TEXTS

from ..files.config import ConfigError
from .map_file import Column, Map, Name, Orientation, Point, Points, factor
from .series import Series

Array = NDArray[np.float64]

ATMOSPHERE = 101_325.0
"""Pa, taken off absolute pressures."""
HALF = 0.5
"""Norm below which a quaternion stands for an orientation that was not seen."""
MOST_NAMED = 12
"""Columns of a file that a message lists."""


@dataclass(frozen=True)
class Quantities:
    """All rows (n) of one file."""

    path: Path
    t: Array
    """s"""
    pressures: Array
    """(n, chambers) Pa gauge."""
    tip: Array
    """(n, 3) m"""
    turn: Rotation | None
    """From the straight robot's frame, or from the recorded one's where nothing says which reading is straight."""
    turned: NDArray[np.bool_]
    """(n,) rows with an orientation."""
    markers: Array
    """(n, k, 3) m"""
    others: Mapping[str, Array]
    """Further numbers by column of trials.csv."""
    words: Mapping[str, NDArray[np.str_]]
    constants: Mapping[str, Any]
    """By column, for all rows."""


def quantities_of(series: Series, wanted: Map, constants: Mapping[str, Any]) -> Quantities:
    """Read a file by its map; raises ConfigError naming the column that is missing."""
    values = {n: _number(series, n, c) for n, c in wanted.columns.items() if n not in TEXTS}
    words = {n: _words(series, n, c) for n, c in wanted.columns.items() if n in TEXTS}
    frame = wanted.frame.matrix
    n = len(series)
    chambers = _chambers(values, constants)
    pressures = np.column_stack([values.pop(p) if p in values else np.full(n, constants[p]) for p in chambers])
    if "tip" in wanted.points:
        tip = _place(series, "tip", wanted.points["tip"]) @ frame.T
    else:
        tip = np.column_stack([values.pop(a) for a in "xyz"]) @ frame.T
    turn, turned = _turn(series, wanted, frame)
    names = [f"m{k}" for k in range(1, 100) if f"m{k}" in wanted.points or f"m{k}x" in values]
    markers = [_marker(series, wanted, values, m) @ frame.T for m in names]
    t = values.pop("t", None)
    if t is None:
        t = _time(series, wanted)
    return Quantities(
        series.path, t, pressures, tip, turn, turned,
        np.stack(markers, axis=1) if markers else np.zeros((n, 0, 3)), values, words, constants,
    )  # fmt: skip


def _time(series: Series, wanted: Map) -> Array:
    if wanted.source.rate is not None:
        return np.asarray(np.arange(len(series)) / wanted.source.rate)
    if "time" in series.numbers and series.path.suffix.lower() in (".c3d", ".mcap"):
        return np.asarray(series.numbers["time"])
    if wanted.states.plateaus is not None:
        raise ConfigError(
            f"{series.path}: states are cut by their duration, but nothing tells the time: name its column (columns.t), or give "
            "the rows a second (source.rate)"
        )
    return np.arange(len(series), dtype=np.float64)


def numbers(series: Series, name: Name, place: str) -> Array:
    """A column by its heading or its number; raises ConfigError."""
    names = series.names
    if isinstance(name, int) and str(name) not in names:
        if not 1 <= name <= len(names):
            raise ConfigError(f"{series.path}: {place} = {name}: must be 1 .. {len(names)}, the columns of the file")
        name = names[name - 1]
    found = series.numbers.get(str(name))
    if found is None:
        there = ", ".join(repr(n) for n in names[:MOST_NAMED]) + (" .." if len(names) > MOST_NAMED else "")
        what = "holds words, not numbers" if str(name) in series.words else f"is not there; there are {there}"
        raise ConfigError(f"{series.path}: {place} = {str(name)[:80]!r}: this column {what}")
    return found


def _number(series: Series, name: str, column: Column) -> Array:
    found = numbers(series, column.column, f"columns.{name}")
    one = factor(column.unit, name, f"columns.{name}.unit")
    if column.zero == "first":
        finite = found[np.isfinite(found)]
        found = found - (finite[0] if finite.size else 0.0)
    found = found * column.scale * one
    return found - ATMOSPHERE if column.zero == "absolute" else found


def _words(series: Series, name: str, column: Column) -> NDArray[np.str_]:
    key = str(column.column)
    if isinstance(column.column, int) and key not in series.names and 1 <= column.column <= len(series.names):
        key = series.names[column.column - 1]
    found = series.words.get(key)
    if found is None:
        found = np.array([f"{v:g}" for v in numbers(series, column.column, f"columns.{name}")])
    unknown = [str(w) for w in dict.fromkeys(found.tolist()) if column.values and w not in column.values]
    if unknown:
        raise ConfigError(
            f"{series.path}: columns.{name}: says {unknown[0][:40]!r}, which columns.{name}.values does not translate"
        )
    return np.array([column.values.get(w, w) for w in found.tolist()])


def _chambers(values: Mapping[str, Array], constants: Mapping[str, Any]) -> list[str]:
    found: list[str] = []
    while (name := f"p{len(found) + 1}") in values or name in constants:
        found.append(name)
    if not found:
        raise ConfigError("columns: no pressure is given; name p1 .. (or constants.p1 for a body without chambers)")
    return found


def _xyz(series: Series, point: Point, place: str) -> Array:
    names: Sequence[Name] = [f"{point}.{a}" for a in "xyz"] if isinstance(point, str) else point
    return np.column_stack([numbers(series, name, place) for name in names])


def _place(series: Series, name: str, points: Points) -> Array:
    one = factor(points.unit, "x", f"points.{name}.unit")

    def middle(of: Sequence[Point]) -> Array:
        return np.asarray(np.mean([_xyz(series, p, f"points.{name}") for p in of], axis=0))

    return one * (middle(points.of) - (middle(points.against) if points.against else 0.0))


def _marker(series: Series, wanted: Map, values: dict[str, Array], name: str) -> Array:
    if name in wanted.points:
        return _place(series, name, wanted.points[name])
    missing = [f"{name}{a}" for a in "xyz" if f"{name}{a}" not in values]
    if missing:
        raise ConfigError(f"columns: {missing[0]} is missing beside the others of marker {name}")
    return np.column_stack([values.pop(f"{name}{a}") for a in "xyz"])


def _turn(series: Series, wanted: Map, frame: Array) -> tuple[Rotation | None, NDArray[np.bool_]]:
    """Rotations in the robot's axes."""
    if wanted.orientation is not None:
        made, there = _stated(series, wanted.orientation)
    elif (points := next((p for p in wanted.points.values() if p.turn), None)) is not None:
        made, there = _fitted(series, points)
    else:
        return None, np.zeros(len(series), bool)
    onto = Rotation.from_matrix(frame)
    return onto * made * onto.inv(), there


def _stated(series: Series, given: Orientation) -> tuple[Rotation, NDArray[np.bool_]]:
    values = np.column_stack([numbers(series, c, "orientation.columns") for c in given.columns])
    there = np.asarray(np.isfinite(values).all(axis=1), bool)
    if len(given.columns) == 4:
        there &= np.linalg.norm(values, axis=1) > HALF
        kept = np.where(there[:, None], values, [1.0, 0, 0, 0] if given.order == "wxyz" else [0, 0, 0, 1.0])
        return Rotation.from_quat(kept, scalar_first=given.order == "wxyz"), there
    kept = np.where(there[:, None], values, 0.0)
    if given.order == "rotation vector":
        return Rotation.from_rotvec(kept, degrees=given.unit == "deg"), there
    return Rotation.from_euler(given.order.split()[1], kept, degrees=given.unit == "deg"), there


def _fitted(series: Series, points: Points) -> tuple[Rotation, NDArray[np.bool_]]:
    """From the first row with all markers to each other one."""
    every = np.stack([_xyz(series, p, "points.tip") for p in points.of], axis=1)
    there = np.asarray(np.isfinite(every).all(axis=(1, 2)), bool)
    if len(points.of) < 3 or not there.any():
        raise ConfigError("points.tip.turn: needs three markers or more, seen together at least once")
    first = every[np.argmax(there)] - every[np.argmax(there)].mean(axis=0)
    matrix = np.tile(np.eye(3), (len(every), 1, 1))
    for i in np.flatnonzero(there):
        matrix[i] = Rotation.align_vectors(every[i] - every[i].mean(axis=0), first)[0].as_matrix()
    return Rotation.from_matrix(matrix), there
