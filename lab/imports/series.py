"""A file of another program as columns, in the order and under the headings in which the file has them, and what is missing."""

from __future__ import annotations

import datetime
import difflib
import re
from collections.abc import Collection, Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from itertools import islice
from numbers import Number
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array, Mask
from recordings.file.budget import OPTION, lifted
from recordings.trials import REQUIRED, unit_of

from ..files.config import ConfigError
from ..files.map_file import Name
from .columns import MOST_WORDS, Judged, Strange, is_missing, without_fillers
from .headings import heading, unit_named

if TYPE_CHECKING:
    import pandas as pd

Texts = NDArray[np.str_]

LARGEST = 500_000_000
"""Bytes of a file."""
SMALL, PACKED = 32_000_000, 50
"""Bytes of memory that any file may take, and that a byte of a larger one may stand for: readings pack to a tenth."""
MOST_COLUMNS = 5000
CALL, FRAME = "lab.case", "DataFrame"
"""Of a table that comes from memory: what stands for map.yaml in messages; its form and file."""


@dataclass(frozen=True)
class Series:
    """Rows of a file (n): columns of numbers, NaN where a value is missing, and of words."""

    path: Path
    columns: Mapping[str, Array | Texts]
    form: str = ""
    """How it was read, as a person would say it."""
    units: Mapping[str, str] = field(default_factory=dict)
    """By column, where the file states them outside of the headings."""
    common_units: Mapping[str, str] = field(default_factory=dict)
    """SI unit -> the unit in which the file says that all such columns are."""
    strange: Mapping[str, Strange] = field(default_factory=dict)
    """By column of numbers, cells that are none."""
    absent: Mapping[str, tuple[int, int, str]] = field(default_factory=dict)
    """By column, `Judged.absent`."""
    lines: NDArray[Any] | None = None
    """(n,) of a text table: where in the file each row stands; of a DataFrame its index."""
    start: tuple[str, float] | None = None
    """Local time at which its times begin, where the file states it: as written, and in s since 1970."""
    notes: tuple[str, ...] = ()
    questions: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    @cached_property
    def numbers(self) -> dict[str, Array]:
        """Columns that hold numbers, at least one."""
        return {n: np.asarray(c, np.float64) for n, c in self.columns.items() if c.dtype.kind == "f" and np.isfinite(c).any()}

    @cached_property
    def words(self) -> dict[str, Texts]:
        """Columns of words."""
        return {n: np.asarray(c, np.str_) for n, c in self.columns.items() if c.dtype.kind == "U"}

    @property
    def names(self) -> tuple[str, ...]:
        """Of all columns, as numbered in the file."""
        return tuple(self.columns)

    def place(self, row: int) -> str:
        """Where a row stands in the file."""
        if self.lines is None:
            return f"row {row + 1}"
        return f"{'index' if self.form == FRAME else 'line'} {self.lines[row]}"

    def read_as_missing(self, name: str) -> str:
        """Count the words of a column of numbers that were read as missing and name the first; empty where there are none."""
        count, row, word = self.absent.get(name, (0, 0, "")) if name in self.numbers else (0, 0, "")
        return f"{count} cells are not numbers (first: {self.place(row)}, {word[:40]!r}); read as missing" if count else ""

    def unit_of(self, name: str, units: Container[str]) -> str:
        """The unit the file states for a column outside of its heading, or trials.csv, where it is one of `units`; else empty."""
        own = unit_named(self.units.get(name) or (unit_of(name) if self.columns.keys() >= set(REQUIRED) else ""))
        return next((unit for unit in ([own[1]] if own else self.common_units.values()) if unit in units), "")


def of_judged(path: Path, judged: Mapping[str, Judged], form: str, notes: Sequence[str] = ()) -> Series:
    """Columns that were judged one by one; `notes` come before those on columns."""
    return Series(
        path, {n: j.values for n, j in judged.items()}, form, {n: j.unit for n, j in judged.items() if j.unit}, {},
        {n: j.strange for n, j in judged.items() if j.strange}, {n: j.absent for n, j in judged.items() if j.absent},
        notes=(*notes, *(f"column {n!r}: {j.note}" for n, j in judged.items() if j.note)),
    )  # fmt: skip


def cleaned(series: Series, missing: Sequence[str | float]) -> Series:
    """The same without numbers that stand for a missing value, which are noted."""
    columns, notes = dict(series.columns), list(series.notes)
    for name, values in series.columns.items():
        if values.dtype.kind == "f":
            columns[name], found = without_fillers(np.where(np.isfinite(values), values, np.nan), missing)
            notes += [f"{n} of {len(values)} cells of {name!r} are {v:g}: taken as missing" for v, n in found.items()]
    series = replace(series, columns=columns, notes=tuple(notes))
    if not series.numbers:
        raise ConfigError(f"{series.path}: no column holds numbers; check the export and source.missing")
    return series


def package(name: str, path: Path) -> Any:
    """The library that reads a file; raises ConfigError where it is not installed."""
    try:
        return import_module(name)
    except ImportError as e:
        raise ConfigError(f"{path}: is read with {name}, which is not installed; pip install 'softlab[import]'") from e


def reason(error: Exception) -> str:
    """Kind and first line of an error."""
    return f"{type(error).__name__}: {next(iter(str(error).splitlines()), '')[:200]}"


@contextmanager
def readable(path: Path, kind: str) -> Iterator[None]:
    """Raise ConfigError where a library raises anything about a file of this kind."""
    try:
        yield
    except ConfigError:
        raise
    except Exception as e:
        raise ConfigError(f"{path}: is not a {kind} file ({reason(e)}); save or export it again") from e


def demand_bounded(path: Path, size: int) -> None:
    """Raise ConfigError where a file unpacks to more than `LARGEST` bytes, or to more than a file of its size can need."""
    file = path.stat().st_size
    if size > (most := min(LARGEST, max(SMALL, PACKED * file))) and not lifted():
        raise ConfigError(
            f"{path}: unpacked it has {size / 1e6:.0f} MB, at most {most / 1e6:.0f} MB are read of {file / 1e6:.3g} MB; "
            f"if you trust the file, {OPTION} lifts the limit"
        )


def demand_columns(path: Path, count: int) -> None:
    """Raise ConfigError where a file has more than `MOST_COLUMNS` columns."""
    if count > MOST_COLUMNS:
        raise ConfigError(f"{path}: has {count} columns, at most {MOST_COLUMNS} are read")


def unique(names: Sequence[str], width: int) -> list[str]:
    """Headings, or numbers from 1 where there is none; one that comes again gets the number of its column."""
    out: dict[str, int] = {}
    for i in range(width):
        name = names[i] if i < len(names) and names[i] else str(i + 1)
        while name in out:
            name = f"{name} {i + 1}"
        out[name] = i
    return [*out]


def listed(names: Iterable[str], most: int = 12) -> str:
    """Names as a message lists them."""
    every = list(names)
    return ", ".join(repr(n[:60]) for n in every[:most]) + (" .." if len(every) > most else "")


# ------------------------------------------------------------------ columns by name
def name_of(series: Series, name: Name, place: str) -> str:
    """The heading of a column that is given by its heading or by its number in the file; raises ConfigError."""
    names = series.names
    if isinstance(name, int):
        if 1 <= name <= len(names):
            return names[name - 1]
        if str(name) not in names:
            raise ConfigError(f"{series.path}: {place} = {name}: must be 1 .. {len(names)}, the columns of the file")
    if str(name) not in names:
        noted = f" ({'; '.join(series.notes)})" if series.notes else ""
        raise ConfigError(
            f"{series.path}: {place} = {str(name)[:80]!r}: no such column; there are "
            f"{_nearest_first(str(name), names, 3)}{noted}; name another"
            + f", for this file alone under files: {{{series.path.name!r}: {{columns: ..}}, '*': {{}}}}"
            * (series.form != FRAME)
        )
    return str(name)


def _nearest_first(name: str, names: Sequence[str], most: int) -> str:
    """Names as a message lists them, up to `most` that are like this one before the others."""
    return listed(dict.fromkeys((*difflib.get_close_matches(name, names, most, 0.4), *names)))


def axes_of(series: Series, marker: str, place: str) -> list[str]:
    """The headings of a marker's x, y and z: NAME.x, or as the file writes them, NAME_x [mm]; raises ConfigError."""
    columns = [f"{marker}.{axis}" for axis in "xyz"]
    if not set(columns) <= set(series.names):
        patterns = [re.compile(rf"{re.escape(marker)}[\s._-]*{axis}(?:[\s_\[(/,].*)?", re.IGNORECASE) for axis in "xyz"]
        columns = [name for pattern in patterns for name in series.names if pattern.fullmatch(name)]
    if len(columns) != 3:
        raise ConfigError(
            f"{series.path}: {place} = {marker[:80]!r}: has no columns x, y and z; there are "
            f"{_nearest_first(f'{marker}.x', series.names, 6)}; name its three columns, as in "
            f"[[{', '.join(f'{marker[:40]}_{axis}' if marker not in series.names else axis for axis in 'xyz')}]]"
        )
    return columns


def numbers(series: Series, name: Name, place: str) -> Array:
    """A column of numbers; raises ConfigError naming the first cell that is none and what to write."""
    head = name_of(series, name, place)
    if (strange := series.strange.get(head)) is not None:
        words = ", ".join(repr(w[:40]) for w in strange.words)
        raise ConfigError(
            f"{series.path}, {series.place(strange.row)}, column {head!r} ({place}): {strange.words[0][:40]!r} is not a number "
            f"({strange.cells} such cells); correct it, or if it means a missing value write source: {{missing: [{words}]}}"
        )
    if head in series.words:
        texts = series.words[head]
        row, every = int(np.argmax(texts != "")), list(dict.fromkeys(filter(None, texts.tolist())))
        few = [f"{word[:40]}: {k}" for k, word in enumerate(every[:MOST_WORDS], 1)]
        pairs = ", ".join([*few, *[".."] * (len(few) < len(every))])
        write = f"; write `values: {{{pairs}}}`, with your numbers, under {place}, or" * place.startswith("columns.")
        raise ConfigError(
            f"{series.path}, {series.place(row)}, column {head!r} ({place}): holds words ({str(texts[row])[:40]!r}), "
            f"not numbers{write or ';'} name another column"
        )
    if head not in series.numbers:
        raise ConfigError(f"{series.path}: column {head!r} ({place}): is empty; name another column")
    return series.numbers[head]


def texts(series: Series, name: Name, place: str, missing: Sequence[str | float] = ()) -> NDArray[np.str_]:
    """A column as words, numbers too; empty where they are missing. Raises ConfigError where there is no such column."""
    own = name_of(series, name, place)
    found = series.strange[own].column if own in series.strange else series.words.get(own)
    if found is None:
        values = series.numbers.get(own, np.full(len(series), np.nan))
        return np.array([f"{v:g}" if np.isfinite(v) else "" for v in values.tolist()], np.str_)
    said = {w: "" if is_missing(w, missing) and w.strip().casefold() != "x" else w.strip() for w in set(found.tolist())}
    return np.array([said[w] for w in found.tolist()], np.str_)


def unit_in(series: Series, name: str, units: Collection[str], place: str = "") -> str:
    """The unit of a column as its heading or the file says it; empty where neither names one of `units`.

    With a `place` in the map, raises ConfigError where they name another kind of unit, which `place` must then translate."""
    said = heading(name, series.units.get(name, ""))
    unit = said.unit if said.unit in units else series.unit_of(name, units)
    if place and not unit and said.stated and len(units) > 1:
        raise ConfigError(
            f"{series.path}: column {name!r} ({place}): the file says {said.stated[:40]!r} of it, which is not one of "
            f"{', '.join(units)}; write {place}.unit, and {place}.scale if the numbers need a factor"
        )
    return unit


# ------------------------------------------------------------------ rows
def unseen(xyz: Array, resting: Mask | None = None) -> Mask:
    """(n,) rows at exactly 0, 0, 0, which programs write where nothing was seen; `xyz` (n, 3), `resting` (n,) rows at rest.

    No row is where zeros may be positions: others come as near to the origin, or the rows at zero are exactly those at rest."""
    zero = np.asarray((xyz == 0).all(axis=1))
    seen = xyz[~zero & np.isfinite(xyz).all(axis=1)]
    if not zero.any() or not len(seen) or (resting is not None and (zero == resting).all()):
        return np.zeros(len(xyz), bool)
    spread = float(np.linalg.norm(seen - np.median(seen, axis=0), axis=1).max())
    return zero & (float(np.linalg.norm(seen, axis=1).min()) >= 0.05 * spread)


# ------------------------------------------------------------------ values inside each other
MOST_ELEMENTS = 500
"""Elements of a list that are read."""
LEAVES = (float, int, str, np.generic, Number, datetime.date, datetime.time, datetime.timedelta)
IDENTITY = re.compile(r"(?!parent|frame_id)(?:.*_)?(?:name|label|id|key|index)|(?!parent).*(?:Name|Label|Id|Key|Index)")
"""Fields of an element of a list that say which it is."""


def leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of each number, text or time inside a list, structure or message (`value`); bytes are left out.

    A path is NAME.FIELD..; elements of a list go by their names where they have some, so that their order does not matter, else
    from 1. Names are an element's own field (`IDENTITY`), or the one list of texts as long as the list beside it."""
    if isinstance(value, bytes | bytearray | memoryview) or value is None:
        return
    if (fields := None if isinstance(value, LEAVES) else _fields(value)) is not None:
        lists_of_names = [v for v in map(_texts, fields.values()) if v]
        for key, inner in fields.items():
            only = lists_of_names[0] if len(lists_of_names) == 1 else ()
            names = only if _is_list(inner) and len(inner) == len(only) else ()
            yield from _elements(f"{name}.{key}", inner, names) if names else leaves(f"{name}.{key}", inner)
    elif hasattr(value, "__iter__") and not isinstance(value, LEAVES):
        inside = list(islice(value, MOST_ELEMENTS))
        yield from _elements(name, inside, _names(inside))
    else:
        yield name, value


def flat(name: str, cells: pd.Series[Any]) -> Iterator[tuple[str, pd.Series[Any]]]:
    """A column, or what its lists, maps and structures hold; raises ValueError where it holds no values."""
    import pandas as pd

    if cells.dtype != object or not any(hasattr(cell, "__len__") and not isinstance(cell, str) for cell in cells):
        yield name, cells
        return
    rows = [dict(leaves(name, value)) for value in cells]
    labels = dict.fromkeys(label for row in rows for label in row)
    if not labels:
        raise ValueError("it holds no number, time or word")
    if len(labels) >= MOST_ELEMENTS:
        raise ValueError(f"it holds {MOST_ELEMENTS} or more values in a row; write those you need as separate columns")
    for label in labels:
        yield label, pd.Series([row.get(label) for row in rows])


def _elements(name: str, inside: Sequence[Any], names: Sequence[str]) -> Iterator[tuple[str, Any]]:
    """Values of a list under the names of its elements, or from 1."""
    for label, inner in zip(names or range(1, len(inside) + 1), inside, strict=False):
        yield from leaves(f"{name}.{label}", inner)


def _fields(value: Any) -> dict[str, Any] | None:
    """What a message or a part of one holds, by field; without fields of protobuf that were not set. None for a list."""
    if isinstance(value, Mapping):
        return {str(key): inner for key, inner in value.items()}
    if hasattr(value, "DESCRIPTOR"):
        return {f.name: getattr(value, f.name) for f in value.DESCRIPTOR.fields if not f.has_presence or value.HasField(f.name)}
    return {slot: getattr(value, slot, None) for slot in value.__slots__} if hasattr(value, "__slots__") else None


def _is_list(value: Any) -> bool:
    return hasattr(value, "__len__") and not isinstance(value, str | bytes | bytearray | memoryview | Mapping)


def _texts(value: Any) -> tuple[str, ...]:
    """The texts of a list of texts that are all different; else nothing."""
    if not _is_list(value) or len(value) == 0 or not isinstance(value[0], str):
        return ()
    texts = tuple(map(str, value))
    return texts if all(texts) and len(set(texts)) == len(texts) else ()


def _names(inside: Sequence[Any]) -> tuple[str, ...]:
    """What tells the elements of a list apart; nothing where nothing does."""
    if not inside or isinstance(inside[0], int | float | str | np.number):
        return ()
    elements = [_fields(inner) or {} for inner in inside]
    said = [k for k, v in elements[0].items() if IDENTITY.fullmatch(k) and isinstance(v, str | int)]
    ways = (_texts([str(e.get(k, "")) for e in elements]) for k in sorted(said, key=lambda k: isinstance(elements[0][k], int)))
    return next(filter(None, ways), ())


def name_in(message: Any) -> str:
    """The word by which a message names what it is about; empty where it has none."""
    return next((v for k, v in (_fields(message) or {}).items() if v and isinstance(v, str) and IDENTITY.fullmatch(k)), "")
