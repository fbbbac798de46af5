"""What was measured: inputs, outputs, which rows are repeats, and the noise they show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from ..arrays import Array, Ints, Mask
from ..errors import BadCase
from ..inference.discrepancy import eigenfunctions
from ..judgement import CORRELATION_PRESSURE, CORRELATION_TIME

FUNCTIONS = 24
"""Most smooth functions."""


@dataclass(frozen=True)
class Table:
    """n rows of inputs and the outputs measured there."""

    inputs: pd.DataFrame
    measured: Array
    """(n, outputs), NaN where not measured."""
    outputs: Mapping[str, str]
    """Name -> unit."""
    group: Ints
    """(n,) number of each row's group; 0 where there are no groups."""
    group_name: str | None
    ignored: tuple[str, ...]
    """Columns of the inputs that are labels, not settings."""
    notes: tuple[str, ...]

    @property
    def kept(self) -> Mask:
        """(n, outputs) which values were measured."""
        return np.isfinite(self.measured)

    @property
    def spread(self) -> Array:
        """(outputs,) standard deviation of the measured values; of an output that is constant its size."""
        spread, size = np.nanstd(self.measured, axis=0), np.nanmax(np.abs(self.measured), axis=0)
        return np.where(spread > 1e-12 * size, spread, np.where(size > 0, size, 1.0))

    @property
    def order(self) -> Array:
        """(n,) 0 .. 1, place of each row within its group."""
        count = pd.Series(self.group).groupby(self.group)
        return np.asarray(count.cumcount() / (count.transform("size") - 1).clip(lower=1), float)

    @cached_property
    def functions(self) -> Array:
        """(n, m) smooth functions of the numeric inputs."""
        numbers = self.inputs.drop(columns=list(self.ignored)).select_dtypes("number").to_numpy(float)
        numbers = numbers[:, np.ptp(numbers, axis=0) > 0] if len(numbers) else numbers
        return eigenfunctions(scaled(numbers, CORRELATION_PRESSURE), FUNCTIONS)

    def time(self) -> Array:
        """(n, 1 + groups) place within the group and the group, in correlation lengths."""
        groups = np.unique(self.group)
        told = groups if 1 < len(groups) <= FUNCTIONS else groups[:0]
        return np.hstack([self.order[:, None] / CORRELATION_TIME, 1.5 / np.sqrt(2) * (self.group[:, None] == told)])


def read(data: pd.DataFrame, outputs: Mapping[str, str], group: str | None, repeat: str | None) -> Table:
    """The table of a DataFrame. Raises `BadCase` where a column is missing, is no number, or nothing is measured."""
    if not isinstance(data, pd.DataFrame):
        raise BadCase(f"data: {type(data).__name__}, must be a pandas.DataFrame of inputs and measured outputs")
    if not isinstance(outputs, Mapping) or not outputs:
        raise BadCase('outputs: must map columns to units, such as {"x": "m"}')
    if unstated := [name for name, unit in outputs.items() if not isinstance(unit, str)]:
        raise BadCase(f"outputs: {unstated[0]} has no unit; write it as text, such as 'm', or '1' where there is none")
    if twice := [str(name) for name in data.columns[data.columns.duplicated()]]:
        raise BadCase(f"data: column {twice[0]!r} appears more than once; give each column a name of its own")
    for role, name in [*(("outputs", name) for name in outputs), ("group", group), ("repeat", repeat)]:
        if name is not None and name not in data.columns:
            raise BadCase(f"{role}: no column {name!r} in data; it has {', '.join(map(str, data.columns))}")
    labels = tuple(name for name in (group, repeat) if name is not None)
    inputs = data.drop(columns=list(outputs))
    try:
        measured = data[list(outputs)].to_numpy(float)
    except (TypeError, ValueError) as error:
        raise BadCase(
            f"outputs {', '.join(map(str, outputs))}: {error}; measured values must be numbers, empty where missing"
        ) from None
    measured = np.where(np.isfinite(measured), measured, np.nan)
    # a remark may be missing, and a column without any number is no input
    numbers = inputs.select_dtypes("number").dropna(axis=1, how="all").columns
    needed = inputs[[name for name in inputs if name in labels or name in numbers]]
    lacking = needed.isna() | needed.isin([np.inf, -np.inf])
    whole, notes = ~lacking.any(axis=1).to_numpy(bool), list[str]()
    if not whole.all():
        which = ", ".join(map(str, lacking.columns[lacking.any()]))
        notes.append(f"{int((~whole).sum())} of {len(whole)} rows lack {which} and are ignored: {rows_in_words(~whole)}")
    if missing := int(np.isnan(measured[whole]).any(axis=1).sum()):
        notes.append(f"{missing} rows lack an output, which is ignored: {rows_in_words(whole & np.isnan(measured).any(axis=1))}")
    inputs, measured = inputs[whole].reset_index(drop=True), measured[whole]
    if np.isfinite(measured).sum() < 3 or not np.isfinite(measured).any(axis=0).all():
        empty = [name for name, column in zip(outputs, measured.T, strict=True) if not np.isfinite(column).any()]
        why = f"too few measured values; give at least three rows{''.join(f'; {note}' for note in notes[:1])}"
        raise BadCase(f"data: {', '.join(map(str, empty)) or 'the outputs'}: {why}")
    number = np.zeros(len(inputs), np.int64) if group is None else pd.factorize(inputs[group])[0].astype(np.int64)
    return Table(inputs, measured, {str(name): unit for name, unit in outputs.items()}, number, group, labels, tuple(notes))


def rows_in_words(chosen: Mask) -> str:
    """The first few of the chosen rows, counted from 0."""
    rows = np.flatnonzero(chosen).tolist()
    return f"row{'s' * (len(rows) > 1)} " + ", ".join(map(str, rows[:5])) + (" .." if len(rows) > 5 else "")


def repeats(table: Table, by_row: bool) -> Ints:
    """(n,) number of what each row repeats: rows of equal inputs or, where the model integrates over a group, rows at one place
    of groups with equal inputs throughout."""
    if by_row:
        return np.asarray(pd.factorize(_hashed(table))[0], np.int64)
    place = pd.Series(table.group).groupby(table.group).cumcount()
    return np.asarray(pd.factorize(pd.MultiIndex.from_arrays([series(table), place]))[0], np.int64)


def series(table: Table) -> Ints:
    """(n,) number of each row's group, the same for groups with equal inputs throughout."""
    of_group = _hashed(table).groupby(table.group).agg(lambda own: hash(tuple(own)))
    return np.asarray(pd.factorize(of_group.to_numpy()[table.group])[0], np.int64)


def _hashed(table: Table) -> pd.Series:
    """(n,) a number for each row's inputs."""
    settings = table.inputs.drop(columns=list(table.ignored))
    return pd.util.hash_pandas_object(settings, index=False) if settings.shape[1] else pd.Series(0, index=range(len(settings)))


def scaled(columns: Array, correlation: float) -> Array:
    """(n, d) columns over their range, in correlation lengths, which are longer the more columns there are."""
    least, extent = columns.min(axis=0, initial=np.inf), np.ptp(columns, axis=0) if columns.size else np.ones(columns.shape[1])
    return np.asarray((columns - least) / np.where(extent > 0, extent, 1.0) / (correlation * np.sqrt(max(columns.shape[1], 1))))
