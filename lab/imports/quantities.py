"""What a map makes of the columns of one file: times, pressures, places and turns of all rows, in SI and in the robot's frame."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from model.actuators import Words
from model.arrays import Array, Ints, Mask
from model.rotation import turn_onto
from recordings.ambient import AMBIENT
from recordings.states.rules import BRANCHES
from recordings.trials import HEAD, ORIENTATION, TAIL, TEXTS, TIP, Table, marker_columns

from ..files.config import ConfigError
from ..files.jumps import at_rest
from ..files.map_file import ONE_CAMERA, Column, Map, Name, Order, Orientation, Point, Points, factor, quantities, units_for
from ..files.units import KINDS
from .clock import seconds, timeline
from .columns import is_missing
from .headings import chamber, heading, tendon
from .places import turn_misfit
from .series import CALL, FRAME, Series, axes_of, listed, name_of, numbers, texts, unit_in, unseen

ORDERS: Mapping[int, tuple[Order, ...]] = {
    3: ("euler xyz", "euler XYZ", "rotation vector", "euler zyx", "euler ZYX"), 4: ("wxyz", "xyzw"),
    6: ("axes xy", "axes xz", "axes yz"), 9: ("matrix rows", "matrix columns"),
}  # fmt: skip
"""Number of columns -> orders that they may have."""
TIMES_WORSE, DEGREES_WORSE = 3.0, 0.5
"""By how much more than another an order must miss to be asked about: factor and deg."""
FURTHER = re.compile("sensor_|sd_|tip_moment_")
"""Begin of the columns of sensors of the lab's own, of standard deviations and of moments."""
LEAST_WIDTH = 0.02
"""Share of the markers' extent along their line that they reach across it, below which they show no turn about it."""
HALF = 0.5
"""Norm below which a quaternion stands for an orientation that was not seen."""
SQUARE = 0.1
"""Largest product of two axes, and difference of their squares from 1, of an orientation that was seen."""


@dataclass(frozen=True)
class FileRows:
    """All rows (n) of one file."""

    path: Path
    table: Table
    """What the map names. Orientations are from the straight robot's frame, or from the recorded one's where nothing says which
    reading is straight."""
    constants: Mapping[str, Any]
    run: Ints
    """(n,) of runs that follow each other in one file, from 0."""
    row: Ints
    """(n,) in the file, from 0."""
    counts: Mapping[tuple[str, str], NDArray[np.str_]] = field(default_factory=dict)
    """Key of the map and heading -> cells of the columns whose changes begin trials; empty where they are missing."""
    notes: tuple[str, ...] = ()
    """What is missing."""
    questions: tuple[str, ...] = ()
    order: str = ""
    """What says that another order of the orientation's columns fits the places clearly better."""
    unit: str | None = None
    """Of the pressures; empty where nothing says it, and they were read as Pa."""
    base: tuple[float, ...] = (0.0, 0.0, 0.0)
    """m, the place of the base in the recorded axes that was subtracted from x, y, z."""

    @property
    def t(self) -> Array:
        """(n,) s"""
        return self.table.values["t"]

    @property
    def driven(self) -> Mask:
        """(n,) rows with all pressures."""
        return np.asarray(np.isfinite(self.table.pressures).all(axis=1))

    @property
    def seen(self) -> Mask:
        """(n,) rows with a tip and all pressures."""
        return np.asarray(np.isfinite(self.table.tip).all(axis=1) & self.driven)

    def with_columns(self, columns: Mapping[str, Array]) -> FileRows:
        """The same with these columns (n,) in place of their own."""
        return replace(self, table=self.table.replaced(columns))

    def of(self, rows: Ints) -> FileRows:
        """The same of these rows, in their order."""
        counts = {name: cells[rows] for name, cells in self.counts.items()}
        return replace(self, table=self.table.take(rows), run=self.run[rows], row=self.row[rows], counts=counts)


@dataclass
class File:
    """One file while its map is applied."""

    series: Series
    drive: Words
    notes: list[str] = field(default_factory=list)
    contradicted: dict[str, dict[str, str]] = field(default_factory=dict)
    """Note on a unit -> column whose unit it is -> key of the map."""
    resting: Mask = field(default_factory=lambda: np.zeros(0, bool))
    """(n,) rows at rest, once pressures are known."""
    factors: dict[str, float] = field(default_factory=dict)
    """Key of the map -> how many SI units one of its column's is, once it is read."""
    recorded: dict[str, Array] = field(default_factory=dict)
    """Column of trials.csv -> in SI, but without its `zero`."""
    unit: str | None = None
    """Of the pressures that were read; empty where neither map nor file says it of one."""

    def numbers(self, column: Column, name: str, place: str) -> tuple[Array, str]:
        """The numbers of a column as the file has them, and their unit."""
        own = name_of(self.series, column.column, place)
        values = _of_words(self.series, name, column) if column.values else numbers(self.series, own, place)
        self.note_absent(own, place)
        unit = column.unit or unit_in(self.series, own, units_for(name, self.drive), place)
        self.factors[place] = factor(unit, name, self.drive, f"{place}.unit")
        if re.fullmatch(r"p\d+", name):
            self.unit = unit if self.unit != "" else ""
        _contradict(self, own, name, unit, place, column.scale)
        return values, unit

    def note_absent(self, own: str, place: str) -> None:
        """Note words in a column of numbers that were taken for missing values."""
        if said := self.series.read_as_missing(own):
            self.notes.append(f"column {own!r} ({place}): {said}")

    def places_of(self, columns: Sequence[str], values: Mapping[str, Array], name: str) -> Array:
        """(n, 3) m of three columns of trials.csv; what was not seen shows before their `zero` is subtracted."""
        recorded = np.column_stack([self.recorded.get(column, values[column]) for column in columns])
        return self.places(np.column_stack([values[column] for column in columns]), name, recorded)

    def places(self, xyz: Array, name: str, recorded: Array | None = None) -> Array:
        """(n, 3) without rows in which nothing was seen; `recorded`: the same as the file has them, in m."""
        gone = unseen(xyz if recorded is None else recorded, self.resting)
        if gone.any():
            first = self.series.place(int(np.argmax(gone)))
            self.notes.append(
                f"{name} is exactly 0, 0, 0 in {int(gone.sum())} of {len(gone)} rows (first in {first}): taken as missing"
            )
        return np.where(gone[:, None], np.nan, xyz)


def quantities_of(series: Series, wanted: Map, drive: Words) -> FileRows:
    """All rows of a file that have a time, in SI and the robot's frame, in the order of time, as the map `wanted` has them.

    `drive`: the words of what drives the robot. Raises ConfigError naming the column that is missing."""
    file, constants = File(series, drive), quantities(wanted.constants, drive)
    notes = file.notes
    constant = {n: np.full(len(series), constants.pop(n)) for n in [*constants] if re.fullmatch(r"(m\d+)?[xyz]", n)}
    values = constant | {n: in_si(file, n, c) for n, c in wanted.columns.items() if n not in TEXTS}
    words = {n: translated(series, n, c, wanted.source.missing) for n, c in wanted.columns.items() if n in TEXTS}
    frame = wanted.frame.matrix
    n = len(series)
    driven = {p: values[p] if p in values else np.full(n, constants[p]) for p in _chambers(file, values, constants)}
    pressures = np.column_stack([*driven.values()])
    file.resting = at_rest(pressures)
    if "tip" in wanted.points:
        tip = _place(file, "tip", wanted.points["tip"]) @ frame.T
    else:
        tip = file.places_of("xyz", values, "the tip") @ frame.T
    columns: dict[str, Array] = {name: v for name, v in values.items() if name in (*HEAD, *TAIL) or FURTHER.match(name)}
    columns |= driven | dict(zip(TIP, tip.T, strict=True)) | _turn(file, wanted, frame)
    order = _better_order(series, wanted, frame, tip, file.resting)
    names = [f"m{k}" for k in range(1, 100) if f"m{k}" in wanted.points or f"m{k}x" in values]
    for axes, name in zip(marker_columns(len(names)), names, strict=True):
        columns |= zip(axes, (_marker(file, wanted, values, name) @ frame.T).T, strict=True)
    t = columns["t"] = values["t"] if "t" in values else _time(series, wanted)
    given = "trial" if "trial" in wanted.columns else "repeat"
    counting = [(f"columns.{given}", wanted.columns[given].column)] if given in wanted.columns else []
    counting += [("trials.change", column) for column in wanted.trials.change]
    counts = {(key, name_of(series, c, key)): texts(series, c, key, wanted.source.missing) for key, c in counting}
    made = FileRows(series.path, Table(columns | words), constants, np.zeros(n, np.int64), np.arange(n), counts)
    for what, values_of in (("pressure", pressures), ("tip", tip)):
        missing = ~np.isfinite(values_of).all(axis=1)
        if missing.any():
            first = series.place(int(np.argmax(missing)))
            notes.append(f"{int(missing.sum())} of {n} rows have no {what} (first: {first}); they were skipped")
    averaged = wanted.states.plateaus is not None or bool(wanted.states.windows)
    tick = wanted.columns["t"].scale * file.factors["columns.t"] if "t" in wanted.columns else 1.0
    begins = np.any([np.append(False, cells[1:] != cells[:-1]) for cells in counts.values()], axis=0) | np.zeros(n, bool)
    line = timeline(t, tick, series.place, ~begins if averaged else None)
    made = replace(made.of(line.rows).with_columns({"t": line.t}), run=line.run)
    notes += line.notes
    if wanted.states.plateaus is not None and len(line.t) > 1 and not np.ptp(line.t):
        raise ConfigError(f"{series.path}: columns.t: all rows have the same time; name another column, or give source.rate")
    notes[:0] = [
        f"column{'s' * (len(keys) > 1)} {listed(keys)} ({', '.join(keys.values())}): {text}"
        for text, keys in file.contradicted.items()
    ]  # what changes all numbers comes first
    return replace(made, notes=tuple(dict.fromkeys(notes)), questions=tuple(line.questions), order=order, unit=file.unit,
                   base=tuple(wanted.base(file.factors).tolist()))  # fmt: skip


def _time(series: Series, wanted: Map) -> Array:
    if wanted.source.rate is not None:
        return np.asarray(np.arange(len(series)) / wanted.source.rate)
    if "time" in series.numbers and series.path.suffix.lower() in (".c3d", ".mcap"):
        return np.asarray(series.numbers["time"])
    if wanted.states.plateaus is not None:
        raise ConfigError(
            f"{series.path}: states need a duration, but there is no time: name its column (columns.t), or give the rows per "
            "second (source.rate)"
        )
    return np.arange(len(series), dtype=np.float64)


def in_si(file: File, name: str, column: Column) -> Array:
    """(n,) of a column of trials.csv in SI: its zero subtracted, times its scale and the size of its unit."""
    values, unit = file.numbers(column, name, f"columns.{name}")
    unit_in_si = file.factors[f"columns.{name}"]
    if name == "t":
        return seconds(values * column.scale, unit, unit_in_si)
    file.recorded[name] = values * column.scale * unit_in_si
    if column.zero == "first":
        finite = values[np.isfinite(values)]
        values = values - (finite[0] if finite.size else 0.0)
    if isinstance(column.zero, float):
        values = values - column.zero
    values = values * column.scale * unit_in_si
    if name == "repeat" and np.nanmin(values) == 0:
        values = values + 1  # a count from 0
    return values - AMBIENT if column.zero == "absolute" else values


def _contradict(file: File, own: str, name: str, unit: str, place: str, scale: float = 1.0) -> None:
    """Note that the file's unit of its column `own` is not the map's (`unit`, at key `place`), and no `scale` explains it."""
    units = units_for(name, file.drive)
    stated = unit_in(file.series, own, units)
    if stated and units[stated] != units.get(unit, 1.0):
        times = units.get(unit, 1.0) / units[stated]
        text = f"the file says {stated}, the map {unit}, which is taken and {times:.6g} times as large: correct one of them"
    elif not stated and name != "t" and scale == 1.0:
        of_file = heading(own, file.series.units.get(own, ""))
        stated = of_file.unit or of_file.stated[:40]
        text = f"the file says {stated}, the map {unit or 'nothing'}, which is used: is it this quantity, and is the unit right?"
    else:
        return
    if stated:
        file.contradicted.setdefault(text, {})[own] = place


def translated(series: Series, name: str, column: Column, missing: Sequence[str | float]) -> NDArray[np.str_]:
    """(n,) words of a column of trials.csv, translated by the map; empty where missing. Raises ConfigError."""
    place = f"columns.{name}"
    own = name_of(series, column.column, place)
    cells = series.strange[own].column if column.values and own in series.strange else series.words.get(own)
    if cells is None:
        cells = np.array([f"{v:g}" if np.isfinite(v) else "" for v in numbers(series, own, place)], np.str_)
    meaning = {w: column.values.get(w, "" if is_missing(w, missing) else w) for w in dict.fromkeys(cells.tolist())}
    allowed = tuple(column.values.values()) if column.values else BRANCHES if name == "branch" else None
    for word, translation in meaning.items():
        if translation and allowed is not None and translation not in allowed:
            row = int(np.argmax(cells == word))
            raise ConfigError(
                f"{series.path}, {series.place(row)}, column {own!r} ({place}): says {word[:40]!r}, which {place}.values "
                f"does not translate; add {word[:40]!r}: {allowed[0]} (or another of {', '.join(dict.fromkeys(allowed))})"
            )
    return np.array([meaning[w] for w in cells.tolist()], np.str_)


def _of_words(series: Series, name: str, column: Column) -> Array:
    """(n,) numbers that the map gives for the words of a column; NaN where missing. Raises ConfigError."""
    try:
        return np.array([float(word or "nan") for word in translated(series, name, column, ()).tolist()])
    except ValueError as e:
        raise ConfigError(f"columns.{name}.values: {e}: write numbers, as in `values: {{A: 1, B: 2}}`") from e


def _chambers(file: File, values: Mapping[str, Array], constants: Mapping[str, Any]) -> list[str]:
    found: list[str] = []
    while (name := f"p{len(found) + 1}") in values or name in constants:
        found.append(name)
    if not found:
        drive, by_call = file.drive, file.series.form == FRAME
        likely = [n for n in file.series.numbers if tendon(heading(f"{n} [N]")) is not None or chamber(heading(n)) is not None]
        named = [(k, n, heading(n).unit) for k, n in enumerate(likely or ["HEADING"], 1)]
        call = (f'"p{k}": "{n}{"" if unit else f" [{drive.unit}]"}"' for k, n, unit in named)
        entries = ", ".join(call if by_call else (f"p{k}: {{column: {n!r}, unit: {u or drive.unit}}}" for k, n, u in named))
        write = f"columns={{{entries}}} in {CALL}" if by_call else f"`{entries}` under columns"
        raise ConfigError(f"columns: no {drive.pressure} is given; write {write} (constants.p1 for a body without {drive.kind})")
    return found


def _xyz(file: File, point: Point, unit: str, place: str) -> Array:
    """(n, 3) m of a marker, each column by its own unit."""
    names: Sequence[Name] = axes_of(file.series, point, place) if isinstance(point, str) else point
    shown = point if isinstance(point, str) else " / ".join(map(str, point))
    columns = [file.numbers(Column(column=name, unit=unit), "x", place)[0] * file.factors[place] for name in names]
    return file.places(np.column_stack(columns), f"marker {shown} ({place})")


def _place(file: File, name: str, points: Points) -> Array:
    """(n, 3) m of a point: the mean of its markers, from the mean of those that it is measured against."""
    of, against = ([_xyz(file, p, points.unit, f"points.{name}") for p in group] for group in (points.of, points.against))
    return np.asarray(np.mean(of, axis=0) - (np.mean(against, axis=0) if against else 0.0))


def _marker(file: File, wanted: Map, values: Mapping[str, Array], name: str) -> Array:
    if name in wanted.points:
        signs = [np.sign(wanted.columns[a].scale) if a in wanted.columns else 1.0 for a in "xyz"]  # of the tip's axes
        place = _place(file, name, wanted.points[name]) * signs
        return place if wanted.points[name].against else place - wanted.base(file.factors)
    missing = [f"{name}{a}" for a in "xyz" if f"{name}{a}" not in values]
    if missing:
        where = f"{ONE_CAMERA}, `constants: {{{missing[0]}: 0 mm}}`"
        raise ConfigError(f"columns: {missing[0]} is missing; marker needs x, y and z: {name}; {where}")
    return file.places_of([f"{name}{axis}" for axis in "xyz"], values, f"marker {name}")


def _turn(file: File, wanted: Map, frame: Array) -> dict[str, Array]:
    """Columns of orientations in the robot's axes."""
    if wanted.orientation is not None:
        for name in wanted.orientation.columns:
            file.note_absent(name_of(file.series, name, "orientation.columns"), "orientation.columns")
        made, there = stated(file.series, wanted.orientation)
        mount = scipy.spatial.transform.Rotation.from_quat(wanted.orientation.mount, scalar_first=True)
    elif (points := next((p for p in wanted.points.values() if p.turn), None)) is not None:
        (made, there), mount = _fitted(file, points), scipy.spatial.transform.Rotation.identity()
    else:
        return {}
    onto = scipy.spatial.transform.Rotation.from_matrix(frame)
    return orientation_columns(onto * made * onto.inv() * mount, there)


def orientation_columns(turn: scipy.spatial.transform.Rotation, there: Mask) -> dict[str, Array]:
    """Columns of the orientations (n,) of a table, NaN of states that have none."""
    values = np.where(there[:, None], turn.as_quat(canonical=True, scalar_first=True), np.nan)
    return dict(zip(ORIENTATION, values.T, strict=True))


def misfits(series: Series, given: Orientation, frame: Array, tip: Array, resting: Mask) -> dict[Order, float]:
    """Order of the columns -> deg (rms) by which the tip, (n, 3) m, then turns about another axis than the one across its
    displacement; empty where it hardly turns.

    A body that bends turns about no other axis; a wrong order adds turns about its own."""
    misfit_of = dict[Order, float]()
    onto = scipy.spatial.transform.Rotation.from_matrix(frame)
    for order in ORDERS[len(given.columns)]:
        turn, stated_rows = stated(series, given.model_copy(update={"order": order}))
        kept = stated_rows & np.isfinite(tip).all(axis=1)
        if (kept & resting).any() and (off := turn_misfit(tip[kept], onto * turn[kept] * onto.inv(), resting[kept])) is not None:
            misfit_of[order] = float(np.degrees(off))
    return misfit_of


def clearly_worse(off: float, other: float) -> bool:
    """Whether an order misses (deg) by so much more than another that it is asked about."""
    return off > max(TIMES_WORSE * other, other + DEGREES_WORSE)


def _better_order(series: Series, wanted: Map, frame: Array, tip: Array, resting: Mask) -> str:
    """Say which order of the orientation's columns fits the bending of the tip, (n, 3) m, clearly better; empty if none does."""
    given = wanted.orientation
    off_by = misfits(series, given, frame, tip, resting) if given is not None else {}
    if given is None or given.order not in off_by:
        return ""
    best = min(off_by, key=lambda order: off_by[order])
    return (
        f"orientation.order {given.order}: the tip turns by {off_by[given.order]:.1f} deg about axes other than its bending "
        f"axis; with {best}, by {off_by[best]:.1f} deg: check the order, and if it is this one, write `order: {best}` "
        "under orientation"
    ) * clearly_worse(off_by[given.order], off_by[best])


def stated(series: Series, given: Orientation) -> tuple[scipy.spatial.transform.Rotation, Mask]:
    """Rotations (n,) in the recorded axes, and the rows that have one; raises ConfigError."""
    values = np.column_stack([numbers(series, c, "orientation.columns") for c in given.columns])
    known_rows = np.asarray(np.isfinite(values).all(axis=1), bool)
    if len(given.columns) == 4:
        known_rows &= np.linalg.norm(values, axis=1) > HALF
        filled = np.where(known_rows[:, None], values, [1.0, 0, 0, 0] if given.order == "wxyz" else [0, 0, 0, 1.0])
        return scipy.spatial.transform.Rotation.from_quat(filled, scalar_first=given.order == "wxyz"), known_rows
    if len(given.columns) > 4:
        return _of_axes(values.reshape(len(values), -1, 3), given.order)
    filled = np.where(known_rows[:, None], values, 0.0)
    unit = given.unit or unit_in(series, name_of(series, given.columns[0], "orientation.columns"), KINDS["deg"]) or "rad"
    # rad, about two turns: larger angles without a unit are asked about
    if given.unit is None and unit == "rad" and (largest := float(np.abs(filled).max(initial=0.0))) > 12.0:
        raise ConfigError(
            f"{series.path}: orientation: angles up to {largest:.4g} rad; write unit: deg, or unit: rad if they are"
        )
    if given.order == "rotation vector":
        return scipy.spatial.transform.Rotation.from_rotvec(filled, degrees=unit == "deg"), known_rows
    return scipy.spatial.transform.Rotation.from_euler(given.order.split()[1], filled, degrees=unit == "deg"), known_rows


def _of_axes(vectors: Array, order: Order) -> tuple[scipy.spatial.transform.Rotation, Mask]:
    """Rotations (n,) whose axes, or the rows of whose matrices, are (n, 2 or 3, 3), and where these are at right angles."""
    axes = vectors.swapaxes(1, 2) if order == "matrix rows" else vectors
    if order.startswith("axes"):
        i, j = ("xyz".index(axis) for axis in order[-2:])
        third = np.cross(axes[:, 0], axes[:, 1]) * (1 if j - i == 1 else -1)
        axes = np.stack([axes[:, 0], axes[:, 1], third], axis=1)[:, np.argsort([i, j, 3 - i - j])]
    with np.errstate(invalid="ignore"):
        square = np.abs(axes @ axes.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2)) < SQUARE
        square &= np.linalg.det(axes) > 0
    made = np.where(square[:, None, None], axes.swapaxes(1, 2), np.eye(3))
    return scipy.spatial.transform.Rotation.from_matrix(made), square


def _fitted(file: File, points: Points) -> tuple[scipy.spatial.transform.Rotation, Mask]:
    """From the first row with all markers to each other one; none of rows in which they lie on one line."""
    every = np.stack([_xyz(file, p, points.unit, "points.tip") for p in points.of], axis=1)
    seen = np.asarray(np.isfinite(every).all(axis=(1, 2)))
    if len(points.of) < 3 or not seen.any():
        raise ConfigError("points.tip.turn: needs three markers or more, seen together at least once")
    about = np.where(seen[:, None, None], every - every.mean(axis=1, keepdims=True), 0.0)
    extent = np.linalg.svd(about, compute_uv=False)
    there = extent[:, 1] > LEAST_WIDTH * extent[:, 0]
    if (flat := seen & ~there).any():
        where = f"{int(flat.sum())} of {int(seen.sum())} rows (first: {file.series.place(int(np.argmax(flat)))})"
        lost = f"points.tip.turn: the markers lie on one line in {where}, so that the turn about it is not determined"
        if not there.any():
            raise ConfigError(f"{file.series.path}: {lost}; add a marker beside the line, or leave out `turn`")
        file.notes.append(f"{lost}: no orientation is taken from them")
    return scipy.spatial.transform.Rotation.from_matrix(turn_onto(about, about[np.argmax(there)])), there
