"""Turn a pandas DataFrame into trials, like `lab import` a file; the call states the map."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from model.robot import Robot
from recordings.errors import BadTable
from recordings.table_file import checked, lacks
from recordings.trials import ORIENTATION, REQUIRED, TEXTS, Mapped, Table, column_order, unit_of

from ..files.config import ConfigError, Source, check
from ..files.jumps import without_contradicted
from ..files.map_file import Column, Own, map_of
from .formats import of_data_frame
from .headings import heading, own_column, unit_named
from .joining import of_rows_in_turn
from .quantities import File, in_si, quantities_of, translated
from .series import CALL, FRAME, Series, name_of
from .table import conclude

if TYPE_CHECKING:
    from pandas import DataFrame


def trials_of(frame: DataFrame, robot: Robot, columns: Mapping[str, Any] | None = None, /, **keys: Any) -> Table:
    """Return the states of a DataFrame, with skipped rows and assumptions in `Table.warnings`. Raises ConfigError.

    `columns`: column of trials.csv -> heading, "heading [unit]", or an entry of map.yaml; other columns go by their names.
    `keys`: further keys of map.yaml. A frame with all columns that trials.csv requires is taken as it is; else, and by further
    keys, trials, steps, repeats and branches are worked out as those of a file."""
    columns = {} if columns is None else columns
    if not isinstance(columns, Mapping):
        raise ConfigError(f"{CALL}: columns: write columns of trials.csv and their headings, such as {{'p1': 'P_left [bar]'}}")
    if "files" in keys:
        raise ConfigError(f"{CALL}: files: does not apply to a DataFrame; give columns, constants and points directly")
    missing_words = _table(keys, "source").get("missing", ())
    missing = tuple(missing_words) if isinstance(missing_words, list | tuple) else ()
    series = of_data_frame(frame, missing)
    columns = {name: _entry(series, entry) for name, entry in columns.items()}
    entries = dict(columns)  # what the caller states goes before a column's own name, in SI where the frame states no unit
    for name in (*series.numbers, *series.words):
        stated = heading(name, series.units.get(name, ""))
        if (own := own_column(stated)) is not None:
            told = stated.unit or own in TEXTS or re.fullmatch(r"p\d+", own)  # pressures in Pa are noted
            entries.setdefault(own, {"column": name} | ({} if told else {"unit": unit_of(own)}))
    if not keys and set(REQUIRED) <= entries.keys():
        return _as_it_is(series, check(Source(CALL, {"columns": entries}, {}), Own).columns, robot)
    series = of_rows_in_turn(series, missing)
    wanted = map_of(Source(CALL, _as_map({**keys, "columns": columns}, entries), {}), robot.actuators.words)
    quantities = quantities_of(series, wanted, robot.actuators.words)
    result = conclude([(series, quantities, wanted)], wanted, robot, [*series.notes, *quantities.notes])
    taken = "orientation" not in keys and wanted.orientation is not None
    note = f"columns {', '.join(ORIENTATION)} were taken as the tip's orientation: give orientation=.., or drop them"
    doubts = (*[note] * taken, *result.table.warnings, *result.notes, *result.questions)
    return replace(result.table, warnings=tuple(re.sub(f"^{FRAME}[:,] ", "", text) for text in doubts))


def _as_it_is(series: Series, columns: Mapping[str, Column], robot: Robot) -> Table:
    """The table of these columns of trials.csv (by name), without rows that lack a required value; raises ConfigError."""
    if wrong := [name for name in columns if column_order(name) is None]:
        raise ConfigError(f"{CALL}: columns.{wrong[0]}: is not a column of trials.csv")
    file, values = File(series, robot.actuators.words), dict[str, NDArray[Any]]()
    for name, column in columns.items():
        values[name] = translated(series, name, column, ()) if name in TEXTS else in_si(file, name, column)
    values = {name: v if name in TEXTS else np.where(np.isfinite(v), v, np.nan) for name, v in values.items()}
    lacking = lacks(values)
    complete = np.flatnonzero([not why for why in lacking])
    if not len(complete):
        raise ConfigError(f"{FRAME}, {series.place(0)}: {lacking[0]}")
    used = {name_of(series, column.column, f"columns.{name}") for name, column in columns.items()}
    ignored = tuple(name for name in series.names if name not in used)
    try:
        usable = {name: column[complete] for name, column in values.items()}
        table = checked(usable, lambda row: f"{FRAME}, {series.place(int(complete[row]))}", ignored)
    except BadTable as e:
        raise ConfigError(str(e)) from e
    left_out = [(series.place(row), why) for row, why in enumerate(lacking) if why]
    left_out_notes = [f"{len(left_out)} of {len(lacking)} rows are left out, first {place}: {why}" for place, why in left_out[:1]]
    headings = tuple((name, str(column.column)) for name, column in columns.items())
    mapped = Mapped(call=True, headings=headings, unit=file.unit)
    table = replace(table, warnings=(*left_out_notes, *file.notes, *table.warnings), mapped=mapped)
    return without_contradicted(table, robot)


def _table(keys: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """A table of a map; empty where there is none, or something else, which its check refuses."""
    return found if isinstance(found := keys.get(name), Mapping) else {}


def _entry(series: Series, entry: Any) -> Any:
    """An entry of `columns` as map.yaml has it: a heading of the frame, "NAME [unit]" of its column NAME, or keys."""
    if not isinstance(entry, str | int):
        return entry
    if str(entry) in series.names:
        return {"column": str(entry)}
    stated = re.fullmatch(r"(.*\S)\s*[\[(]([^\])]+)[\])]", str(entry))
    if stated is None or stated[1] not in series.names:
        return {"column": entry}
    return {"column": stated[1], "unit": (unit_named(stated[2]) or ("", stated[2]))[1]}


def _as_map(keys: dict[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Add to the keys of a map those columns `own` (name -> entry) of which no other key says where they come from."""
    trials, points = _table(keys, "trials"), _table(keys, "points")
    described = {
        *_table(keys, "constants"),
        "step",
        *ORIENTATION,
        *(f"{body if body != 'tip' else ''}{a}" for body in points for a in "xyz"),
    }
    described |= {"trial"} if {"begin", "change"} & trials.keys() else set()
    columns = {name: entry for name, entry in own.items() if name in keys["columns"] or name not in described}
    no_quaternion = "orientation" in keys or not set(ORIENTATION) <= own.keys()
    orientation = (
        {} if no_quaternion else {"orientation": {"columns": [own[name]["column"] for name in ORIENTATION], "order": "wxyz"}}
    )
    return {**keys, "columns": columns, **orientation}
