"""The table of trials: a row for each state, in the order in which they happened; without x, y, z it counts as history alone.

A column that was never measured is absent, a cell that was not measured is empty. `sensor_NAME_QUANTITY` is what a sensor
of the lab's own measured, in its unit; `sd_COLUMN` the standard deviation of the samples that were averaged, not of their
mean. `doubt` says why a state is unreliable:

- "soft": the jammed spine did not push back, or its shape shows that it was soft.
- "bodies": a body was elsewhere.
- "drift": the zero of the force sensor moved by `force_drift`, and not at a constant pace. A constant drift is removed
  from `force` as a line in time.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pandas import DataFrame

from .errors import BadTable
from .json_text import read_json

Cell = float | int | str
Vector3 = tuple[float, float, float]

HEAD: tuple[str, ...] = ("trial", "step", "protocol", "repeat", "branch", "t", "rate", "hold", "spine_length", "vacuum")
HEAD += ("tip_mass", "roll_deg", "force_x", "force_y", "force_z")
REQUIRED = ("trial", "step", "protocol", "repeat", "branch", "t", "spine_length", "p1")
INTEGERS = frozenset({"trial", "step", "repeat"})
TEXTS = frozenset({"protocol", "branch", "specimen", "doubt"})
DOUBTS = ("soft", "bodies", "drift")
"""Why a state is not to be relied on; the first that holds counts."""
TIP = ("x", "y", "z")
AXES: dict[str, Vector3] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
AXES |= {f"+{name}": axis for name, axis in AXES.items()} | {f"-{name}": (-x, -y, -z) for name, (x, y, z) in AXES.items()}
"""Name of an axis, as a frame has it -> its direction."""
Axis = str | Vector3
"""Of a frame: a name of `AXES`, or a direction."""
ORIENTATION = ("qw", "qx", "qy", "qz")
TAIL = ("specimen", "force", "deflection", "clipped", "force_drift", "doubt")
BESIDE_JSON = ("clipped", "force_drift", "doubt")
"""Columns that came after rows were first read cell by cell."""

_PRESSURE = re.compile(r"p([1-9][0-9]?)")
_MARKER = re.compile(r"m([1-9][0-9]?)([xyz])")
SENSOR = re.compile(r"sensor_[a-z][a-z0-9_]{0,60}|joint[1-9]|tip_moment_[xyz]")
"""Of chambers and markers no robot has a hundred."""
PRESSURES, MARKERS, SENSORS, SD = 1, 4, 6, 7
"""Where these groups of columns stand."""
LARGEST_INTEGER = 2**53


@lru_cache(maxsize=4096)
def column_order(name: str) -> tuple[int, int, int] | None:
    """Sort key of a column (group, number or place in it, axis); None for a name that is no column of the table."""
    for place, group in ((0, HEAD), (2, TIP), (3, ORIENTATION), (5, TAIL)):
        if name in group:
            return (place, group.index(name), 0)
    if match := _PRESSURE.fullmatch(name):
        return (PRESSURES, int(match[1]), 0)
    if match := _MARKER.fullmatch(name):
        return (MARKERS, int(match[1]), "xyz".index(match[2]))
    if SENSOR.fullmatch(name):
        return (SENSORS, 0, 0)
    if name.startswith("sd_") and (of := column_order(name[3:])) is not None and not name.startswith("sd_sd_"):
        return (SD + of[0], of[1], of[2])
    return None


COLUMNS = (
    (r"trial|step|repeat", "1", "number, from 1"),
    (r"protocol|branch|specimen|doubt", "1", "text"),
    (r"t", "s", "rig time, middle of the average"),
    (r"rate", "Pa/s", "of the pressure ramp that led here, negative downwards"),
    (r"hold", "s", "time from the end of the ramp to the reading; 0: while ramping"),
    (r"spine_length", "m", "length of the spine"),
    (r"vacuum", "Pa", "of the spine, below ambient"),
    (r"tip_mass", "kg", "mass hung at the tip, in place of robot.yaml's"),
    (r"roll_deg", "deg", "turn of the body in its mount about the robot's axis"),
    (r"force_[xyz]", "N", "known force on the tip, base frame"),
    (r"tip_moment_[xyz]", "N m", "known moment on the tip, base frame"),
    (r"p[0-9]+", "Pa", "pressure of this chamber, gauge, measured"),
    (r"[xyz]", "m", "position of the tip, base frame"),
    (r"q[wxyz]", "1", "orientation of the tip, unit quaternion, base frame"),
    (r"m[0-9]+[xyz]", "m", "position of this marker, base frame"),
    (r"joint[1-9]", "rad", "angle of this joint of the arm, whose flange then carries the tip's body"),
    (r"force", "N", "on the specimen along the push"),
    (r"deflection", "m", "of the specimen along the push"),
    (r"clipped", "1", "1 where the rig's limits clipped set-points on the way to this state"),
    (r"force_drift", "N", "by which the force sensor's zero moved over the trial; above 0: it reads more in the end"),
    (r"sensor_.*", "", ""),
)
"""Pattern, SI unit and meaning of columns; of a sensor of the lab's own the table does not tell them."""


def unit_of(name: str) -> str:
    """SI unit of a column.

    >>> unit_of("p1"), unit_of("sd_x"), unit_of("trial")
    ('Pa', 'm', '1')
    """
    return next((unit for pattern, unit, _ in COLUMNS if re.fullmatch(pattern, name.removeprefix("sd_"))), "m")


@dataclass(frozen=True)
class TrialRow:
    """One state that was read; None where a quantity was not measured, NaN for a marker that was never seen."""

    trial: int
    step: int
    protocol: str
    repeat: int
    branch: str
    t: float
    spine_length: float
    pressures: tuple[float, ...]
    """Pa gauge, measured, by chamber."""
    rate: float | None = None
    hold: float | None = None
    vacuum: float | None = None
    tip_mass: float | None = None
    roll_deg: float | None = None
    force_x: float | None = None
    """N, a known force on the tip, base frame, besides the weight of `tip_mass`."""
    force_y: float | None = None
    force_z: float | None = None
    tip: Vector3 | None = None
    orientation: tuple[float, float, float, float] | None = None
    """w, x, y, z"""
    markers: tuple[Vector3, ...] = ()
    specimen: str | None = None
    force: float | None = None
    deflection: float | None = None
    clipped: bool = False
    """The rig's limits clipped set-points on the way here."""
    force_drift: float | None = None
    """N, by which the force sensor's zero moved over the trial; removed from `force` unless `doubt` is "drift"."""
    doubt: str | None = None
    """One of `DOUBTS`."""
    sensors: Mapping[str, float] = field(default_factory=dict)
    """What sensors of the lab's own measured, and angles of the arm's joints that carries the tip's body, by column."""
    sd: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of the averaged samples, by column."""

    def cells(self) -> dict[str, Cell]:
        """Column -> value in the table's order, without what was not measured."""
        values: dict[str, Any] = {name: getattr(self, name) for name in (*HEAD, *TAIL)}
        values["clipped"] = 1 if self.clipped else None
        groups = [(pressure_columns(len(self.pressures)), self.pressures), (TIP, self.tip), (ORIENTATION, self.orientation)]
        groups += zip(marker_columns(len(self.markers)), self.markers, strict=True)
        values |= {name: value for names, group in groups if group is not None for name, value in zip(names, group, strict=True)}
        values |= self.sensors
        values |= {f"sd_{name}": value for name, value in self.sd.items()}
        measured = {name: v for name, v in values.items() if v is not None and v == v}
        return {name: measured[name] for name in _ordered(measured)}

    @classmethod
    def from_cells(cls, cells: Mapping[str, Cell]) -> TrialRow:
        """The row with these cells; raises `BadTable` for unknown columns, gaps in p1..pN, or half a position."""
        given: dict[str, Any] = {name: cells[name] for name in _ordered(cells)}
        for name, value in given.items():
            if not _fits(name, value):
                raise BadTable(f"{name}: {repr(value)[:80]} is not allowed in this column")
        plain = {name: given[name] for name in (*HEAD, *TAIL) if name in given} | {"clipped": bool(given.get("clipped", 0))}
        chambers, markers = highest(given)
        if lacking := incomplete(frozenset(given), chambers, markers):
            raise BadTable(lacking)
        return cls(
            **plain,
            pressures=_group(given, pressure_columns(chambers)),
            tip=_group(given, TIP),
            orientation=_group(given, ORIENTATION),
            markers=tuple(_group(given, names) or (math.nan,) * 3 for names in marker_columns(markers)),
            sensors={name: value for name, value in given.items() if SENSOR.fullmatch(name)},
            sd={name[3:]: value for name, value in given.items() if name.startswith("sd_")},
        )

    def to_json(self) -> str:
        """The cells but `BESIDE_JSON`, exactly: equal text means equal to the last bit. Older readers know no further cell."""
        return json.dumps({name: value for name, value in self.cells().items() if name not in BESIDE_JSON})

    @classmethod
    def from_json(cls, text: str) -> TrialRow:
        """The row written by `to_json`."""
        try:
            return cls.from_cells(read_json(text))
        except (ValueError, AttributeError, TypeError) as error:
            raise BadTable(f"not a row of the table of trials: {error}: {text[:200]!r}") from error


def _fits(name: str, value: object) -> bool:
    if name in TEXTS:
        return isinstance(value, str)
    if name in INTEGERS:
        return type(value) is int and abs(value) <= LARGEST_INTEGER
    return type(value) is float or (type(value) is int and abs(value) <= LARGEST_INTEGER)


def _ordered(names: Iterable[str]) -> list[str]:
    """Columns in the table's order; raises `BadTable` for a name that is none."""
    orders = {name: column_order(name) or () for name in names}
    if unknown := [name for name, order in orders.items() if not order]:
        raise BadTable(f"unknown column {', '.join(unknown)}")
    return sorted(orders, key=lambda name: (*orders[name], name))


def pressure_columns(chambers: int) -> tuple[str, ...]:
    """The columns of the chambers' pressures."""
    return tuple(f"p{k}" for k in range(1, chambers + 1))


def marker_columns(markers: int) -> tuple[tuple[str, ...], ...]:
    """The three columns of each marker's place."""
    return tuple(tuple(f"m{k}{axis}" for axis in "xyz") for k in range(1, markers + 1))


def highest(names: Iterable[str]) -> tuple[int, int]:
    """The highest number of a chamber and of a marker in the names of columns; 0 where there is none."""
    orders = [order for name in names if (order := column_order(name)) is not None]
    chambers, markers = (max((n for place, n, _ in orders if place == group), default=0) for group in (PRESSURES, MARKERS))
    return chambers, markers


@lru_cache
def incomplete(given: frozenset[str], chambers: int, markers: int) -> str:
    """What a state with values in the given columns lacks, for people; empty where it has all, and no half a position."""
    if missing := [name for name in dict.fromkeys((*REQUIRED, *pressure_columns(chambers))) if name not in given]:
        return f"no value for {', '.join(missing)}"
    for group in (TIP, ORIENTATION, *marker_columns(markers)):
        rest = [name for name in group if name not in given]
        if 0 < len(rest) < len(group):
            return f"{', '.join(name for name in group if name in given)} without {', '.join(rest)}"
    return ""


def _group(cells: Mapping[str, Any], names: Sequence[str]) -> Any:
    """The values of columns that belong together; None when they are not there."""
    return tuple(cells[name] for name in names) if names[0] in cells else None


NO_MOUNT = (1.0, 0.0, 0.0, 0.0)
"""w, x, y, z of a tracked body that is mounted along the base's axes."""


@dataclass(frozen=True)
class Mapped:
    """How columns of another program became those of a table: the axis of the file for each axis of the base, the readings from
    which points were moved to the model (`straight`), whether keys of lab.case state it (else map.yaml), column of the table and
    its heading in the file, of those that are known, the unit of p1 .., empty where nothing says it, so that it is Pa, and the
    turn (w, x, y, z) of the tracked body in its mount, along the base's axes, and the place of the base in the file's axes (m),
    which was subtracted from x, y, z; None of files with several of them. Then the tracked point from the end of the straight
    body (m), by which x, y, z were moved back along the body's axes."""

    frame: tuple[Axis, ...] = ("x", "y", "z")
    straight: str = "as recorded"
    call: bool = False
    headings: tuple[tuple[str, str], ...] = ()
    unit: str | None = None
    mount: tuple[float, ...] | None = NO_MOUNT
    base: tuple[float, ...] | None = None
    sensor: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3) the base's axes in those of the file."""
        return np.array([AXES[axis] if isinstance(axis, str) else axis for axis in self.frame], np.float64)


@dataclass(frozen=True, repr=False, eq=False)
class Table:
    """States as columns, in the order in which they were read. `trials["x"]` is a numpy column: NaN (or an empty text) where a
    state has no value.

    >>> row = TrialRow(1, 1, "bending", 1, "load", 0.0, 0.1, (60e3, 0.0, 0.0), tip=(-0.02, 0.0, 0.39))
    >>> Table.of([row])["p1"], Table.of([row]).columns[-3:]
    (array([60000.]), ('x', 'y', 'z'))
    """

    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Column -> (n,) float64, int64 for trial, step and repeat, or text; SI units."""
    ignored: tuple[str, ...] = ()
    """Columns of the file that are no columns of this table."""
    warnings: tuple[str, ...] = ()
    """What looked odd when the file was read, but may be right."""
    sensor_units: Mapping[str, str] = field(default_factory=dict)
    """Unit of each sensor's column, where the input states it: a recording does, trials.csv does not."""
    mapped: Mapped | None = None
    """None where nothing states it: of recordings, and of a trials.csv without map.yaml. Of several one that moved points."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", {name: self.values[name] for name in _ordered(self.values)})

    @classmethod
    def of(cls, rows: Iterable[TrialRow], warnings: tuple[str, ...] = (), sensor_units: Mapping[str, str] | None = None) -> Table:
        """The columns of rows."""
        cells = [row.cells() for row in rows]
        names = {name for row in cells for name in row}
        columns = {name: column_of(name, [row.get(name) for row in cells]) for name in names}
        return cls(columns, warnings=warnings, sensor_units=sensor_units or {})

    @classmethod
    def joined(cls, tables: Iterable[Table]) -> Table:
        """The states of several tables one after the other, trials numbered on."""
        renumbered, last_trial = [], 0
        for table in tables:
            trial = table.trial + last_trial
            last_trial = int(trial.max(initial=last_trial))
            renumbered.append(table.replaced({"trial": trial}))
        return cls.stacked(renumbered)

    @classmethod
    def stacked(cls, tables: Sequence[Table]) -> Table:
        """The states of several tables one after the other, with their own numbers."""
        tables = [table for table in tables if len(table)]
        names = {name for table in tables for name in table.values}
        columns = {name: np.concatenate([table.get(name) for table in tables]) for name in names}
        stated = [table.mapped for table in tables if table.mapped is not None]
        moved = (mapped for mapped in stated if mapped.straight != Mapped.straight)
        return cls(columns, mapped=next(moved, stated[0] if stated else None))

    def replaced(self, columns: Mapping[str, NDArray[Any]]) -> Table:
        """The same states with these columns (n,) in place of their own."""
        return replace(self, values={**self.values, **columns})

    def take(self, states: NDArray[Any]) -> Table:
        """The states picked by a mask (n,) or by indices (m,)."""
        return replace(self, values={name: column[states] for name, column in self.values.items()})

    def __iter__(self) -> Iterator[TrialRow]:
        return iter(self.rows)

    @cached_property
    def rows(self) -> tuple[TrialRow, ...]:
        """The states as rows, as journals hold them; what computes uses columns."""
        columns = {name: self.values[name].tolist() for name in self.columns}
        cells = (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True))
        return tuple(TrialRow.from_cells({n: v for n, v in row.items() if v == v and v != ""}) for row in cells)

    # -- columns
    def __len__(self) -> int:
        return len(next(iter(self.values.values()), ()))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Table):
            return NotImplemented
        same, names = (len(self), self.columns) == (len(other), other.columns), self.columns
        return same and all(np.array_equal(self[n], other[n], equal_nan=n not in TEXTS) for n in names)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns that at least one state has a value for, in order."""
        return tuple(name for name, column in self.values.items() if present(column).any())

    def __getitem__(self, name: str) -> NDArray[Any]:
        """One column, shape (n,): float64, int64 for trial, step and repeat, or text."""
        if name not in self.columns:
            raise BadTable(f"no column {name}; the table has {', '.join(self.columns)}")
        return self.values[name]

    def get(self, name: str, missing: float = math.nan) -> NDArray[Any]:
        """(n,) the column, also where there is none; `missing` stands where a state has no number."""
        column = self.values.get(name)
        if column is None:
            return np.full(len(self), "" if name in TEXTS else missing)
        return column if name in TEXTS | INTEGERS else np.where(np.isnan(column), missing, column)

    def place(self, state: int) -> str:
        """The name of a state (an index from 0) in messages."""
        return f"trial {self.trial[state]} step {self.get('step')[state]}"

    @property
    def trial(self) -> NDArray[np.int64]:
        """(n,) number of the trial."""
        return self.get("trial").astype(np.int64)

    @property
    def pushed(self) -> NDArray[np.bool_]:
        """(n,) states of stiffness trials: force and deflection of a cantilever."""
        return np.asarray(self.get("protocol") == "stiffness")

    @property
    def clipped(self) -> NDArray[np.bool_]:
        """(n,) states on whose way the rig's limits clipped set-points."""
        return np.asarray(self.get("clipped") == 1)

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """(n,) states that are not to be relied on; the column `doubt` says why."""
        return np.asarray(self.get("doubt") != "")

    @property
    def with_tip(self) -> NDArray[np.bool_]:
        """(n,) states of the robot with a tip."""
        return np.asarray(~self.pushed & np.isnan(self.get("joint1")) & ~np.isnan(self.tip).all(axis=1))

    @property
    def unread(self) -> NDArray[np.bool_]:
        """(n,) states of the robot whose pressures were read and whose tip was not: history alone."""
        known = np.isfinite(np.column_stack([self.pressures, self.spine_length])).all(axis=1)
        return np.asarray(known & ~self.pushed & np.isnan(self.get("joint1")) & ~self.with_tip)

    @property
    def moved_to_model(self) -> str:
        """The readings from which the map moved all points to the model; empty where it did not."""
        return "" if self.mapped is None or self.mapped.straight == Mapped.straight else self.mapped.straight

    @property
    def spine_length(self) -> NDArray[np.float64]:
        """(n,) m."""
        return self.get("spine_length")

    @property
    def pressures(self) -> NDArray[np.float64]:
        """(n, chambers) Pa gauge, measured."""
        return self._together(pressure_columns(highest(self.values)[0]))

    @property
    def tip(self) -> NDArray[np.float64]:
        """(n, 3) m, base frame."""
        return self._together(TIP)

    @property
    def orientation(self) -> NDArray[np.float64]:
        """(n, 4) w, x, y, z of the tip, base frame."""
        return self._together(ORIENTATION)

    @property
    def markers(self) -> NDArray[np.float64]:
        """(n, k, 3) m, base frame."""
        return self._together(sum(marker_columns(highest(self.values)[1]), ())).reshape(len(self), -1, 3)

    @property
    def tip_force(self) -> NDArray[np.float64]:
        """(n, 3) N, what is known to pull at the tip besides the weight of `tip_mass`."""
        return self._together(("force_x", "force_y", "force_z"), 0.0)

    def _together(self, names: Sequence[str], missing: float = math.nan) -> NDArray[np.float64]:
        return np.array([self.get(name, missing) for name in names], np.float64).reshape(len(names), len(self)).T

    # -- for people
    @property
    def units(self) -> dict[str, str]:
        """Unit of each column; "1" for a pure number, empty where the input does not state it."""
        return {name: unit_of(name) or self.sensor_units.get(name.removeprefix("sd_"), "") for name in self.columns}

    def to_frame(self) -> DataFrame:
        """A DataFrame with a row per state, SI units; `.attrs["units"]` has the unit of each column."""
        import pandas  # a second, which most uses of a table do not need

        frame = pandas.DataFrame({name: self[name] for name in self.columns})
        frame.attrs["units"] = self.units
        return frame

    def __repr__(self) -> str:
        kinds, lengths = self.get("protocol"), self.spine_length
        spine = f", spine {lengths.min() * 100:.3g} to {lengths.max() * 100:.3g} cm" if lengths.any() else ""
        each = (counted(len(np.unique(self.trial[kinds == kind])), f"{kind} trial".strip()) for kind in np.unique(kinds))
        columns = {unit: ", ".join(name for name, own in self.units.items() if own == unit) for unit in self.units.values()}
        measured = "; ".join(f"{names} [{unit}]" for unit, names in columns.items() if unit.strip("1"))
        return f"<Table: {counted(len(self), 'state')} in {' and '.join(each) or 'no trial'}{spine}; {measured}>"

    def _repr_html_(self) -> str:
        return str(self.to_frame().to_html(max_rows=20))


def counted(number: int, noun: str) -> str:
    """A number of things in words.

    >>> counted(1, "state"), counted(3, "state")
    ('1 state', '3 states')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def column_of(name: str, values: Sequence[Cell | None]) -> NDArray[Any]:
    """(n,) a column of these values, None where there is none."""
    if name in TEXTS:
        return np.array([value or "" for value in values], dtype=np.str_)
    if name in INTEGERS:
        return np.array(values, dtype=np.int64)
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


def present(column: NDArray[Any]) -> NDArray[np.bool_]:
    """(n,) where a column has a value."""
    return np.asarray(column != "" if column.dtype.kind == "U" else column == column)
