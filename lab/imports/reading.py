"""Columns of a file by their heading or number, and what is missing in them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from ..files.config import ConfigError
from .clock import EPOCH
from .columns import is_missing
from .headings import heading
from .map_file import Name
from .series import FRAME, Series, listed

Array = NDArray[np.float64]

DAYS = ((36_526.0, 73_050.0, 25_569.0), (730_486.0, 767_010.0, 719_529.0))
"""Days as spreadsheets and as MATLAB count them: those of 2000 and of 2100, and that of 1970."""
DAY_STEP = 5e-4
"""Days from row to row below which such numbers are days: no clock in s that has run so long steps by as little."""
EPOCH_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
"""s of the units in which computers count time."""


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
            f"{series.path}: {place} = {str(name)[:80]!r}: this column is not there; there are "
            f"{_nearest_first(str(name), names, 3)}{noted}; name another"
            + f", of this file alone under files: {{{series.path.name!r}: {{columns: ..}}, '*': {{}}}}"
            * (series.form != FRAME)
        )
    return str(name)


def _nearest_first(name: str, names: Sequence[str], most: int) -> str:
    """Names as a message lists them, up to `most` that are like this one before the others."""
    return listed(dict.fromkeys((*difflib.get_close_matches(name, names, most, 0.4), *names)))


def axes_of(series: Series, marker: str, place: str) -> list[str]:
    """The headings of a marker's x, y and z: NAME.x, or as the file writes them, NAME_x [mm]; raises ConfigError."""
    found = [f"{marker}.{axis}" for axis in "xyz"]
    if not set(found) <= set(series.names):
        own = [re.compile(rf"{re.escape(marker)}[\s._-]*{axis}(?:[\s_\[(/,].*)?", re.IGNORECASE) for axis in "xyz"]
        found = [name for one in own for name in series.names if one.fullmatch(name)]
    if len(found) != 3:
        raise ConfigError(
            f"{series.path}: {place} = {marker[:80]!r}: has no columns x, y and z of its own; there are "
            f"{_nearest_first(f'{marker}.x', series.names, 6)}; name its three columns, as in [[{marker[:40]}_x, "
            f"{marker[:40]}_y, {marker[:40]}_z]]"
        )
    return found


def numbers(series: Series, name: Name, place: str) -> Array:
    """A column of numbers; raises ConfigError naming the first cell that is none and what to write."""
    own = name_of(series, name, place)
    strange = series.strange.get(own)
    if strange is not None:
        words = ", ".join(repr(w[:40]) for w in strange.words)
        raise ConfigError(
            f"{series.path}, {series.place(strange.row)}, column {own!r} ({place}): {strange.words[0][:40]!r} is no "
            f"number ({strange.cells} such cells); correct it, or where it stands for a missing value write "
            f"source: {{missing: [{words}]}}"
        )
    if own in series.words:
        texts = series.words[own]
        row = int(np.argmax(texts != ""))
        raise ConfigError(
            f"{series.path}, {series.place(row)}, column {own!r} ({place}): holds words ({str(texts[row])[:40]!r}), not numbers; "
            "name another column"
        )
    if own not in series.numbers:
        raise ConfigError(f"{series.path}: column {own!r} ({place}): is empty; name another column")
    return series.numbers[own]


def texts(series: Series, name: Name, place: str, missing: Sequence[str | float] = ()) -> NDArray[np.str_]:
    """A column as words, numbers too; empty where they are missing. Raises ConfigError where there is no such column."""
    own = name_of(series, name, place)
    if own in series.strange:
        found = series.strange[own].column
    elif own in series.words:
        found = series.words[own]
    else:
        values = series.numbers.get(own, np.full(len(series), np.nan))
        return np.array([f"{v:g}" if np.isfinite(v) else "" for v in values.tolist()], np.str_)
    said = {w: "" if is_missing(w, missing) and w.strip().casefold() != "x" else w.strip() for w in set(found.tolist())}
    return np.array([said[w] for w in found.tolist()], np.str_)


def unit_in(series: Series, name: str, units: Collection[str], place: str = "") -> str:
    """The unit of a column as its heading or the file says it; empty where neither names one of `units`.

    With a `place` in the map, raises ConfigError where they name another kind of unit, which `place` must then translate.
    """
    said = heading(name, series.units.get(name, ""))
    unit = said.unit if said.unit in units else series.unit_of(name, units)
    if place and not unit and said.stated and len(units) > 1:
        raise ConfigError(
            f"{series.path}: column {name!r} ({place}): the file says {said.stated[:40]!r} of it, which is none of "
            f"{', '.join(units)}; write {place}.unit, and {place}.scale where the numbers need a factor"
        )
    return unit


def seconds(values: Array, unit: str, factor: float) -> Array:
    """Times in s: by their unit; dates as numbers without one, or beyond what it allows, by their size."""
    middle = float(np.nanmedian(np.abs(values)))
    if not unit or middle * factor >= EPOCH[1]:
        size = next((s for s in EPOCH_UNITS if EPOCH[0] <= middle * s < EPOCH[1]), None)
        zero = 0.0
        steps = np.diff(values[np.isfinite(values)])
        if not unit and len(steps) and float(np.median(np.abs(steps))) < DAY_STEP:
            zero = next((day for first, last, day in DAYS if first <= middle < last), 0.0)
            size = 86_400.0 if zero else size
        if size is not None:
            start = float(values[np.isfinite(values)][0])
            return (values - start) * size + (start - zero) * size
    return values * factor


def unseen(xyz: Array, resting: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """(n,) rows at exactly 0, 0, 0 among others that are not: there nothing was seen.

    Zeros are positions where others come as near to the origin, or where all rows at rest, and no others, are zero.
    """
    zero = np.asarray((xyz == 0).all(axis=1))
    others = xyz[~zero & np.isfinite(xyz).all(axis=1)]
    if not zero.any() or not len(others):
        return np.zeros(len(xyz), bool)
    if resting is not None and (zero == resting).all():
        return np.zeros(len(xyz), bool)
    spread = float(np.linalg.norm(others - np.median(others, axis=0), axis=1).max())
    # then 0, 0, 0 is a position
    if float(np.linalg.norm(others, axis=1).min()) < 0.05 * spread:
        return np.zeros(len(xyz), bool)
    return zero


def at_rest(pressures: Array) -> NDArray[np.bool_]:
    """(n,) rows in which every pressure is the lowest of its chamber, but for noise."""
    low, high = _range(pressures)
    above = np.nan_to_num(pressures - low, nan=np.inf).max(axis=1, initial=0.0)
    return np.asarray(above <= 0.03 * max(float((high - low).max(initial=0.0)), 1e-300))


def _range(pressures: Array) -> tuple[Array, Array]:
    finite = np.where(np.isfinite(pressures), pressures, np.inf)
    return finite.min(axis=0, initial=np.inf), np.where(np.isfinite(pressures), pressures, -np.inf).max(axis=0, initial=-np.inf)
