"""A pandas DataFrame as trials: what `lab import` does with a file, by a map that the call states."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from model.robot import Robot
from recordings.errors import BadTable
from recordings.table_file import checked, lacks
from recordings.trials import ORIENTATION, REQUIRED, TEXTS, Table, column_order, unit_of

from ..files.config import ConfigError, Source, check
from .formats import of_data_frame
from .headings import heading, own_column, unit_named
from .joining import of_rows_in_turn
from .map_file import Map, demand_units
from .quantities import quantities_of
from .series import FRAME, Series, cleaned, numbers, texts
from .table import conclude

if TYPE_CHECKING:
    from pandas import DataFrame

CALL = "lab.case"
"""Stands for map.yaml in messages."""


def trials_of(frame: DataFrame, robot: Robot, columns: Mapping[str, Any] | None = None, /, **keys: Any) -> Table:
    """The states of a DataFrame, with what was left out or taken for granted in `Table.warnings`; raises ConfigError.

    `columns`: column of trials.csv -> heading, "heading [unit]", or an entry of map.yaml; other columns go by their names.
    `keys`: further keys of map.yaml. A frame with all columns that trials.csv requires is taken as it is; else trials, steps,
    repeats and branches are worked out as those of a file.
    """
    columns = {} if columns is None else columns
    if not isinstance(columns, Mapping):
        raise ConfigError(f"{CALL}: columns: write columns of trials.csv and their headings, such as {{'p1': 'P_left [bar]'}}")
    if "files" in keys:
        raise ConfigError(f"{CALL}: files: a DataFrame has none; give its columns, constants and points themselves")
    words = _table(keys, "source").get("missing", ())
    missing = tuple(words) if isinstance(words, list | tuple) else ()
    series = of_data_frame(frame, missing)
    if not columns and not keys and set(REQUIRED) <= set(series.names):
        return _as_it_is(series)
    series = of_rows_in_turn(cleaned(series, missing))
    columns = {name: _entry(series, entry) for name, entry in columns.items()}
    wanted = check(Source(CALL, _with_own_names(series, {**keys, "columns": columns}), {}), Map)
    demand_units(wanted, robot.actuators.words, f"{CALL}: ")
    quantities = quantities_of(series, wanted, robot.actuators.words)
    made = conclude([(series, quantities, wanted)], wanted, robot, [*series.notes, *quantities.notes])
    doubts = (*made.table.warnings, *made.notes, *made.questions)
    return replace(made.table, warnings=tuple(re.sub(f"^{FRAME}[:,] ", "", text) for text in doubts))


def _as_it_is(series: Series) -> Table:
    """The table of columns that bear the names of trials.csv, in SI, without rows that lack a value."""
    known = {name: column for name, column in series.columns.items() if column_order(name) is not None}
    ignored = tuple(name for name in series.names if name not in known)
    for name, column in known.items():
        if name in TEXTS:
            known[name] = texts(series, name, name)
        else:
            values = numbers(series, name, name) if name in {**series.numbers, **series.words} else np.full(len(column), np.nan)
            known[name] = np.where(np.isfinite(values), values, np.nan)
    lacking = lacks(known)
    kept = np.flatnonzero([not why for why in lacking])
    if not len(kept):
        raise ConfigError(f"{FRAME}, {series.place(0)}: {lacking[0]}")
    try:
        columns = {name: column[kept] for name, column in known.items()}
        table = checked(columns, lambda row: f"{FRAME}, {series.place(int(kept[row]))}", ignored)
    except BadTable as e:
        raise ConfigError(str(e)) from e
    left_out = [(series.place(row), why) for row, why in enumerate(lacking) if why]
    told = [f"{len(left_out)} of {len(lacking)} rows are left out, first {place}: {why}" for place, why in left_out[:1]]
    return replace(table, warnings=(*told, *table.warnings))


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


def _with_own_names(series: Series, keys: dict[str, Any]) -> dict[str, Any]:
    """Keys of a map, and those columns that bear names of trials.csv; in SI where the frame states no unit."""
    columns, trials = dict(keys["columns"]), _table(keys, "trials")
    given = {*columns, *_table(keys, "constants"), "step"}
    given |= {"trial"} if trials.get("begin") == "state" or "change" in trials else set()
    given |= {f"{body if body != 'tip' else ''}{axis}" for body in _table(keys, "points") for axis in "xyz"}
    for name in series.names:
        stated = heading(name, series.units.get(name, ""))
        own = own_column(stated)
        if own is None or own in given or own in ORIENTATION or (name not in series.numbers and name not in series.words):
            continue
        columns[own] = {"column": name} | ({} if stated.unit or own in TEXTS else {"unit": unit_of(own)})
    turned = "orientation" in keys or not set(ORIENTATION) <= set(series.names)
    return {**keys, "columns": columns} | ({} if turned else {"orientation": {"columns": list(ORIENTATION), "order": "wxyz"}})
