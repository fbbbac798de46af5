"""map.yaml: what each column of a file is, its unit and frame, and which rows form a state.

Keys of `columns`, `constants` and `files` are columns of trials.csv. A quantity of `constants` and `files` carries its unit
("20 mm"); a bare number is in SI.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat, model_validator

from diagnosis.data.levels import REST
from model.actuators import Words
from model.arrays import Array
from model.plain_yaml import FileTable
from recordings.trials import AXES, NO_MOUNT, TEXTS, Axis, Mapped, column_order, unit_of

from .config import ConfigError, check, in_si
from .config import Source as Parsed
from .units import KINDS, plain_unit, usual

Name = Annotated[str | int, Field(description="heading of a column, or its number from 1")]
SQUARE, EXACT = 1.0, 1e-9
"""deg by which the directions of a frame may be off a right angle, and parts of a direction that are rounding errors."""
ONE_CAMERA = "one camera: state the plane in which the robot moves"
Point = Annotated[str | tuple[Name, Name, Name], Field(description="a marker, or its three columns")]


class Source(FileTable):
    """How the file is read, if its ending and first lines do not tell."""

    separator: str | None = Field(default=None, min_length=1, max_length=1)
    """Between columns of a text table."""
    decimal: Literal[".", ","] | None = None
    heading: int | None = Field(default=None, ge=0, le=1000)
    """Line of the headings; 0: there are none."""
    units: int | None = Field(default=None, ge=1, le=1000)
    """Line of the units."""
    missing: tuple[str | FiniteFloat, ...] = ()
    """Further words and numbers for a missing value."""
    variable: str | None = None
    """The table in a file of several."""
    axes: dict[str, tuple[str, ...]] = {}
    """Of arrays: what each dimension counts; `point` and `axis` become columns."""
    rate: FiniteFloat | None = Field(default=None, gt=0, json_schema_extra={"unit": "Hz"})
    """Rows a second."""
    offset: FiniteFloat = Field(default=0.0, json_schema_extra={"unit": "s"})
    """Added to the times of this file where it is joined in time with another."""
    topic: str | None = None
    """Whose times count in a recording (default: the tip's)."""


def _as_texts(given: object) -> object:
    """A mapping with its numbers as texts."""
    if not isinstance(given, Mapping):
        return given
    return dict([f"{v:.17g}" if isinstance(v, int | float) else v for v in pair] for pair in given.items())


class Column(FileTable):
    """Where a column of trials.csv comes from: (value - zero) * scale, from its unit to SI."""

    column: Name
    """Its heading, or its number from 1."""
    unit: Annotated[str, AfterValidator(plain_unit)] = ""
    """By default as heading or file say, or SI. Of tendons also N, of their rate N/s."""
    scale: FiniteFloat = 1.0
    """A factor of the sensor's own."""
    zero: Literal["none", "first", "absolute"] | FiniteFloat = "none"
    """Subtracted: nothing, the first row, the atmosphere, or a number in the column's unit (of x, y, z also from `points`)."""
    values: Annotated[dict[str, str], BeforeValidator(_as_texts)] = {}
    """The file's word -> that of trials.csv: `{A: 1, B: 2}`."""

    @model_validator(mode="before")
    @classmethod
    def _named(cls, given: object) -> object:
        return {"column": given} if isinstance(given, str | int) else given


class Points(FileTable):
    """A place on the body: the middle of markers."""

    of: tuple[Point, ...] = Field(min_length=1)
    against: tuple[Point, ...] = ()
    """Markers at the base."""
    unit: Annotated[str, AfterValidator(plain_unit)] = ""
    """By default as the file says, or m."""
    turn: bool = False
    """Take the tip's orientation from three markers or more."""


Order = Literal[
    "wxyz", "xyzw", "rotation vector", "euler xyz", "euler XYZ", "euler zyx", "euler ZYX",
    "matrix rows", "matrix columns", "axes xy", "axes xz", "axes yz",
]  # fmt: skip
COLUMNS = {"wxyz": 4, "xyzw": 4, "matrix": 9, "axes": 6}
"""First word of an order -> columns that it has, else 3."""


class Orientation(FileTable):
    """How the tip is turned."""

    columns: tuple[Name, ...] = Field(min_length=3, max_length=9)
    order: Order = "wxyz"
    """Of angles, as in SciPy: small letters about fixed axes (extrinsic), capitals about turning axes (intrinsic). Of 9 columns a
    rotation matrix; of 6 directions of two of the tip's axes, as `axes xz`."""
    unit: Literal["rad", "deg"] | None = None
    """By default as the file says, or rad."""
    mount: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat] = NO_MOUNT
    """Inverse of its reading on the straight robot, along the base's axes: w, x, y, z. Of a body defined while the robot hung at
    rest: `lab.predict(robot, [0, 0, 0]).orientation`."""

    @model_validator(mode="after")
    def _counted(self) -> Orientation:
        needed = COLUMNS.get(self.order.split()[0], 3)
        if len(self.columns) != needed:
            raise ValueError(f"order {self.order!r} has {needed} columns, {len(self.columns)} are given")
        if not any(self.mount):
            raise ValueError("mount: (0, 0, 0, 0) is no turn")
        return self


class Frame(FileTable):
    """Axes of the robot's base (x, y, z; z points from base to tip) and, for each, the axis of the file that points there, or its
    direction in the file: `{x: [0.8, 0.6, 0], y: z, z: [0.6, -0.8, 0]}`."""

    x: Axis = "x"
    y: Axis = "y"
    z: Axis = "z"

    @model_validator(mode="after")
    def _right_handed(self) -> Frame:
        wrong = [
            f"{k} = {v!r}" for k, v in zip("xyz", self.axes, strict=True) if v not in AXES and (isinstance(v, str) or not any(v))
        ]
        if wrong:
            raise ValueError(f"{', '.join(wrong)}: must be one of x, -x, y, -y, z, -z, or a direction such as [0.6, -0.8, 0]")
        handed = float(np.linalg.det(directions := self._directions))
        if abs(handed) < 0.5:
            raise ValueError("names an axis twice: x, y and z must be three different recorded axes")
        if handed < 0:
            raise ValueError("is a mirror image: change the sign of one axis, or swap two")
        askew = float(np.degrees(np.arcsin(np.abs(directions @ directions.T - np.eye(3)).max())))
        if askew > SQUARE:
            raise ValueError(f"axes are {askew:.2g} deg off a right angle, at most {SQUARE:g}: correct their directions")
        return self

    @property
    def axes(self) -> tuple[Axis, Axis, Axis]:
        """Of the file, along x, y and z of the base."""
        return self.x, self.y, self.z

    @property
    def _directions(self) -> Array:
        """(3, 3) of length 1, as stated."""
        stated = Mapped(self.axes).axes
        return stated / np.linalg.norm(stated, axis=1, keepdims=True)

    @property
    def matrix(self) -> Array:
        """(3, 3) from recorded to robot's coordinates: the rotation nearest to the directions stated."""
        u, _, v = np.linalg.svd(self._directions)
        return np.asarray(np.where(np.abs(turn := u @ v) < EXACT, 0.0, turn))


class Plateaus(FileTable):
    """States are stretches in which no pressure (and no force) changes by more than `steady` (`force`) within `shortest`;
    their mean is taken."""

    steady: FiniteFloat = Field(gt=0, json_schema_extra={"unit": "Pa"})
    """Of tendons also in N."""
    force: FiniteFloat | None = Field(default=None, gt=0, json_schema_extra={"unit": "N"})
    """The same for force_x, force_y, force_z; by default they may change."""
    shortest: FiniteFloat = Field(default=0.5, gt=0, json_schema_extra={"unit": "s"})
    settling: FiniteFloat = Field(default=0.3, ge=0, json_schema_extra={"unit": "s"})
    """Left out at the start."""


class Window(FileTable):
    """Rows at the start or the end of each trial that make one state."""

    first: int | None = Field(default=None, ge=1)
    last: int | None = Field(default=None, ge=1)
    at_rest: bool = False
    """All pressures are zero there."""

    @model_validator(mode="after")
    def _one(self) -> Window:
        if (self.first is None) == (self.last is None):
            raise ValueError("needs either `first` or `last`, the number of rows")
        return self


class States(FileTable):
    """Which rows make a state: each, stretches of steady pressure, or windows of each trial."""

    plateaus: Plateaus | None = None
    windows: tuple[Window, ...] = ()

    @model_validator(mode="after")
    def _one(self) -> States:
        if self.plateaus is not None and self.windows:
            raise ValueError("takes `plateaus` or `windows`, not both")
        return self


class Trials(FileTable):
    """Where a trial begins, unless `columns.trial` says: with each file and each change of `columns.repeat`, also each time all
    pressures come back to rest, or with each state, where settings follow each other in no order.

    The rest after a descent belongs to the trial that descends, the rest before a rise to the trial that rises; a single one
    belongs to the trial that rises, and so does all of a rest of `states.windows`."""

    begin: Literal["file", "rest", "state"] = "file"
    change: tuple[Name, ...] = ()
    """Columns that count runs or name the chambers inflated: each change begins a trial. With `begin: rest`
    none begins away from rest, and a note names the row."""
    below: FiniteFloat = Field(default=REST, gt=0, json_schema_extra={"unit": "Pa"})
    """What counts as at rest; of tendons also in N."""

    @model_validator(mode="after")
    def _one(self) -> Trials:
        if self.begin == "state" and self.change:
            raise ValueError("begin: state begins a trial with each state; leave out `change`")
        return self


class Stiffness(FileTable):
    """Rows of a stiffness trial from files with a `force`: deflection against the file of the same repeat without one."""

    specimen: Literal["spine", "body"] = "body"
    along: Literal["x", "-x", "y", "-y", "z", "-z", "+x", "+y", "+z"] = "-x"
    """Axis of the robot along which the force deflects."""


class Own(BaseModel):
    """What is different in some of the files; further keys are constants."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, FiniteFloat | str]

    source: Source | None = None
    """In place of the common one."""
    columns: dict[str, Column] = {}
    """Besides the common ones, or in their place."""
    points: dict[str, Points] = {}
    """Besides the common ones, or in their place."""
    orientation: Orientation | None = None
    """In place of the common one."""

    @property
    def constants(self) -> dict[str, float | str]:
        """By column of trials.csv."""
        return dict(self.__pydantic_extra__)


class Map(FileTable):
    """What a file of measurements holds."""

    robot: str = "robot.yaml"
    """Its robot.yaml, next to this file."""
    unconfirmed: tuple[str, ...] = ()
    """Guesses and questions of `lab import` that nobody has checked: move each to `confirmed` once settled."""
    confirmed: tuple[str, ...] = ()
    """Questions of `lab import` that are settled; it does not ask them again."""
    source: Source = Source()
    """How a file is read."""
    columns: dict[str, Column] = {}
    """Column of trials.csv -> source."""
    constants: dict[str, FiniteFloat | str] = {}
    """Column of trials.csv -> value of all rows, with unit."""
    points: dict[str, Points] = {}
    """`tip`, `m1`, `m2` .. as markers."""
    orientation: Orientation | None = None
    """How the tip is turned."""
    frame: Frame = Frame()
    """Which axis of the file each axis of the robot's base is."""
    sensor: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = Field(default=(0.0, 0.0, 0.0), json_schema_extra={"unit": "m"})
    """Tracked point on the straight robot, from the end of the body; needs an orientation."""
    forces: Literal["base", "file", "tip"] = "base"
    """Axes of force_x, force_y, force_z: of the base, of the file (turned by `frame`), or of a sensor that turns with the tip."""
    straight: Literal["as recorded", "at rest", "first state", "first row"] = "as recorded"
    """Readings from which all points, the tip and markers, are moved to the model: those at rest, else with the lowest pressures,
    under its weight; or the first state, or the first row of each file, of a straight robot."""
    states: States = States()
    """Which rows make a state."""
    trials: Trials = Trials()
    """Where a trial begins."""
    files: dict[str, Own] = {}
    """Pattern of file names -> constants, columns, points, orientation, source; others are not read."""
    stiffness: Stiffness | None = None
    """Rows of a stiffness trial."""

    @model_validator(mode="after")
    def _known(self) -> Map:
        """Check that columns and constants, of all files and of some, are those of trials.csv; raises ValueError."""
        stated: list[tuple[str, Iterable[str]]] = [("columns", self.columns), ("constants", self.constants)]
        for pattern, own in self.files.items():
            stated += [(f"files.{pattern}", own.constants), (f"files.{pattern}.columns", own.columns)]
        wrong = [f"{place}.{n}: is no column of trials.csv" for place, names in stated for n in names if column_order(n) is None]
        if wrong:
            raise ValueError("; ".join(wrong))
        return self

    def mapped(self, unit: str | None, call: bool = False) -> Mapped:
        """How it makes a table, whose pressures are read in `unit`; `call`: stated by keys of lab.case."""
        of_files = [own.orientation for own in self.files.values() if own.orientation is not None]
        mount, *others = {o.mount for o in (self.orientation, *of_files) if o is not None} or {NO_MOUNT}
        headings = tuple((name, str(column.column)) for name, column in self.columns.items())
        stated = {f"columns.{name}": KINDS["m"].get(column.unit, np.nan) for name, column in self.columns.items()}
        known = None if self.files or np.isnan(base := self.base(stated)).any() else tuple(base.tolist())
        return Mapped(self.frame.axes, self.straight, call, headings, unit, None if others else mount, known, self.sensor)

    def base(self, units: Mapping[str, float]) -> Array:
        """(3,) m in the recorded axes: the place of the base that `columns`, in these units (m), subtract as a number."""
        zeros = {a: c.zero * c.scale * units[f"columns.{a}"] for a, c in self.columns.items() if isinstance(c.zero, float)}
        return np.array([zeros.get(axis, 0.0) for axis in "xyz"])

    def wrong_places(self) -> list[str]:
        """What is wrong with tip, orientation and trials."""
        wrong = [f"points.{n}: must be tip, m1, m2 .." for n in self.points if not re.fullmatch(r"tip|m[1-9]\d?", n)]
        missing = [a for a in "xyz" if a not in {*self.columns, *self.constants}]
        if "tip" in self.points and len(missing) < 3:
            wrong.append("points.tip: columns x, y, z also give the tip; keep one")
        if "tip" not in self.points and missing:
            lacking = f"{missing[0]} is missing, {ONE_CAMERA}, `constants: {{{missing[0]}: 0 mm}}`; else "
            wrong.append(f"columns: {lacking if len(missing) == 1 else ''}give the tip by x, y and z, or by points.tip")
        turned = self.orientation is not None or any(p.turn for p in self.points.values())
        if "trial" in self.columns and self.trials.change:
            wrong.append("trials.change: columns.trial also states where trials begin; keep one")
        if self.forces == "tip" and not turned:
            wrong.append("forces: a sensor that turns with the tip needs an orientation")
        if any(self.sensor) and not turned:
            wrong.append("sensor: a point beyond the body needs an orientation; on its axis give robot.yaml a rigid last section")
        return wrong

    def of_file(self, owns: Iterable[Own]) -> Map:
        """The map of a file, of which `owns` say what is different."""
        made = self.model_copy(update={"files": {}})
        for own in owns:
            tip_here = "tip" in own.points or any(a in own.columns for a in "xyz")
            columns = {n: c for n, c in made.columns.items() if not (tip_here and n in "xyz")}
            constants = {n: c for n, c in made.constants.items() if not ("tip" in own.points and n in "xyz")}
            points = {n: p for n, p in made.points.items() if not (tip_here and n == "tip")}
            update: dict[str, Any] = {
                "columns": columns | own.columns, "points": points | own.points, "constants": constants | own.constants,
                "source": own.source or made.source, "orientation": own.orientation or made.orientation,
            }  # fmt: skip
            made = made.model_copy(update=update)
        return made


def stated_map(source: Parsed, words: Words) -> Map:
    """What a map states, perhaps not all that reading a file takes; raises ConfigError."""
    return check(replace(source, units=(("Pa", units_for("p1", words)),)), Map)


def map_of(source: Parsed, words: Words) -> Map:
    """The map of a robot driven as `words` say; raises ConfigError, also where a unit is none of its column."""
    made, before = stated_map(source, words), f"{source.name}: "
    alike = not any(own.columns or own.points or own.orientation for own in made.files.values())
    if alike and (wrong := made.wrong_places()):  # else judged for each file, as several patterns may fit one
        raise ConfigError(f"{before}{'; '.join(wrong)}", placed=True)
    places: list[tuple[str, Map | Own]] = [("", made), *((f"files.{pattern}.", own) for pattern, own in made.files.items())]
    for place, own in places:
        for name, column in own.columns.items():
            factor(column.unit, name, words, f"{before}{place}columns.{name}.unit")
        for name, points in own.points.items():
            factor(points.unit, "x", words, f"{before}{place}points.{name}.unit")
        quantities(own.constants, words, f"{before}{place.rstrip('.') or 'constants'}")
    return made


def named(wanted: Map) -> frozenset[str] | None:
    """The headings that a map names, of columns and markers; None where it counts columns instead."""
    found: list[str | int] = [column.column for column in wanted.columns.values()]
    found += [] if wanted.orientation is None else wanted.orientation.columns
    found += wanted.trials.change
    for points in wanted.points.values():
        for point in (*points.of, *points.against):
            found += [point] if isinstance(point, str) else point
    return None if any(isinstance(name, int) for name in found) else frozenset(map(str, found))


def units_for(name: str, words: Words) -> Mapping[str, float]:
    """Units of a column of trials.csv, and their size in its SI unit: of what drives the robot also that of `words`."""
    needed = unit_of(name)
    known = KINDS.get(needed, {needed: 1.0})
    if not _drives(name):
        return known
    own = KINDS.get(words.unit + needed.removeprefix("Pa"), {})
    return known | {unit: size * words.pascal for unit, size in own.items()}


def _drives(name: str) -> bool:
    """Whether a column holds what drives the robot, or its rate."""
    return name == "rate" or re.fullmatch(r"(sd_)?p\d+", name) is not None


def factor(unit: str, name: str, words: Words, place: str) -> float:
    """How many SI units one of `unit` is, for a column of trials.csv; raises ConfigError."""
    known = units_for(name, words)
    if unit in ("", unit_of(name)):
        return 1.0
    if unit not in known:
        whose = f"; the robot has {words.kind}" if _drives(name) else ""
        usual_unit = "mm" if unit_of(name) == "m" else usual(unit_of(name))[1] or "1"
        scaled = f"; or write `unit: {usual_unit}` and `scale`, how many {usual_unit} are one {unit[:40]}"
        raise ConfigError(f"{place} = {unit[:40]!r}: {name} needs one of {', '.join(known)}{whose}{scaled}")
    return known[unit]


def quantities(given: Mapping[str, float | str], words: Words, place: str = "constants") -> dict[str, Any]:
    """Constants in SI, texts as they are; raises ConfigError."""
    return {
        name: in_si(f"{place}.{name}", value, unit_of(name), units_for(name, words))
        if isinstance(value, str) and name not in TEXTS else value
        for name, value in given.items()
    }  # fmt: skip
