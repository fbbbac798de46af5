"""Judge one column of cells by itself: decimal mark, numbers, times, words, and missing cells."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array

from .headings import unit_named, word_set

if TYPE_CHECKING:
    import pandas as pd


MISSING = word_set("""
na n/a n.a. n.a nan -nan nan(ind) -nan(ind) 1.#qnan -1.#qnan -1.#ind 1.#ind 1.#inf -1.#inf
nan(snan) -nan(snan) nat null \\n nil none no nothing void empty blank undef
undefined invalid missing hidden lost occluded untracked unseen inf -inf +inf infinity -infinity dropout out_of_range
#n/a #na #value! #div/0! #num! #ref! #name? #null! <na> error err #error overflow over ovf ol o.l.
- -- --- ---- – — ― − * ** *** ? ?? ??? . .. ... … / \\ x xx xxx _ __ k.a. o.a. n.d. n/d nd nv n.v.
fehlt leer keine verdeckt ungültig ungueltig manquant absent vide falta vacío mancante
""") | {
    "not available", "not visible", "no data", "out of range", "not a number", "not tracked", "not measured", "no signal",
}  # fmt: skip
"""Words for a value that was not measured, in lower case; more in `source.missing`."""
FILLERS = frozenset([s * float(n) for n in (999, 9999, 99999, 999999, 9999999) for s in (1, -1)])
"""Numbers that programs write where nothing was measured."""
BEYOND = 1e25
"""Numbers from here on are none that anybody measured; ns since 1970 are below."""
WRITTEN = str.maketrans({"\u2212": "-", "\u2013": "-", "\u00a0": " ", "\u202f": " "})
"""How minus signs and blanks are written besides."""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:([.,' ’])\d{3})(?:\1\d{3})*(?=$|[.,]\d*$)")
"""A number with marks between its thousands."""
PLAIN = re.compile(r"[-+]?(?:\d++\.?\d*|\.\d+)(?:[eEdD][-+]?\d{1,4})?", re.ASCII)
CLOCK = re.compile(r"(?:(\d{1,3}):)?(\d{1,2}):(\d{2}(?:[.,]\d+)?)\s*([AaPp][Mm])?", re.ASCII)
HOURS = re.compile(r"(\d{1,2}):(\d{2})\s*([AaPp][Mm])?", re.ASCII)
DATE = re.compile(r"\d{1,4}[-/.](?:\d{1,2}|[A-Za-z]{3})[-/.]\d{1,4}(?:[T ,]+\d{1,2}:\d{2}.*)?|\d{8}T\d{6}.*", re.ASCII)
DAY = 86400.0
"""s"""
MOST_WORDS = 5
"""Strange words of a column that are listed."""


@dataclass(frozen=True)
class Strange:
    """Cells of a column of numbers that are neither numbers nor known words for a missing value."""

    row: int
    """The first one's, from 0."""
    words: tuple[str, ...]
    cells: int
    column: NDArray[np.str_]


@dataclass(frozen=True)
class Judged:
    """Content of a column."""

    values: Array | NDArray[np.str_]
    unit: str = ""
    """Written behind each number, or s for times of day and dates."""
    strange: Strange | None = None
    note: str = ""
    """Assumptions that were made."""
    absent: tuple[int, int, str] | None = None
    """Of cells of a column of numbers that hold known words for a missing value: count, the first one's row from 0, its word."""


def is_missing(word: str, more: Sequence[str | float] = ()) -> bool:
    """Whether a cell says that there is no value."""
    whole = word.strip().casefold()
    bare = whole.strip("[](){}<>\"'")
    return not bare or bool({bare, whole} & MISSING) or whole in {str(m).strip().casefold() for m in more}


def number(word: str, mark: str = ".", grouped: bool = False) -> float | None:
    """The number that a cell with this decimal mark holds; None where it is none."""
    text = (word if word.isascii() else word.translate(WRITTEN)).strip().strip("'=\"").strip()
    found = GROUPED.match(text) if grouped or " " in text or "'" in text or "’" in text else None
    if found and found[1] != mark:
        text = text.replace(found[1], "")
    if mark == ",":
        if "." in text and "," in text:
            return None
        text = text.replace(",", ".")
    if not PLAIN.fullmatch(text):
        return None
    value = float(text.replace("d", "e").replace("D", "e"))
    return value if np.isfinite(value) else None


@lru_cache(maxsize=10_000)
def looks_like_value(word: str) -> bool:
    """Whether a cell is a number with any decimal mark, one with a unit, or a time."""
    word = word.strip()
    return any(number(word, mark, grouped=True) is not None for mark in ".,") or _are_times([word]) or bool(_with_unit([word])[1])


def judge(cells: pd.Series[str], missing: Sequence[str | float] = (), decimal: str | None = None, *,
          parsed: pd.Series[float] | None = None, comma_splits: bool = False, commas: bool = False) -> Judged:  # fmt: skip
    """Read a column: as numbers where most cells that hold something are numbers, else as times (s), else as words.

    `missing`: further words for a missing value; `parsed`: what `pandas.to_numeric` makes of the cells, where that is known.
    `decimal` decides where commas and points both occur; `comma_splits`: commas separate columns, and none is a decimal mark;
    `commas`: another column of the file has decimal commas."""
    import pandas as pd

    if parsed is None:
        cells = cells.str.strip()
        parsed = pd.to_numeric(cells, errors="coerce")
    filled, values = np.array(cells != "", bool), np.array(parsed, np.float64)
    values[~np.isfinite(values)] = np.nan
    unread_cells = np.isnan(values) & filled
    known = {w: is_missing(w, missing) for w in map(str, pd.unique(cells[unread_cells]))}
    words, gone = [w for w in known if not known[w]], [w for w in known if known[w] and "nan" not in w.casefold()]
    told = any(re.search(r"[^\W\d_]{3}", w) for w in gone)  # more than a dash
    absent = (int(cells.isin(gone).sum()), cells.tolist().index(gone[0]), gone[0]) if told else None
    plain_numbers = [str(w) for w in pd.unique(cells[~unread_cells & filled])] if words or decimal == "," or commas else []
    if not words:
        dotted = [w for w in plain_numbers if "." in w]
        if decimal != "." and _in_thousands(dotted, plain_numbers):
            values = np.array(cells.map({w: number(w, ",", True) for w in plain_numbers}), np.float64)
            return Judged(values, note=_of_thousands(dotted[0], ","), absent=absent)
        return Judged(values, absent=absent)
    points = any("." in w for w in plain_numbers)
    with_commas = [w for w in words if "," in w]
    thousands = decimal is None and not points and _in_thousands(with_commas, plain_numbers)
    mark, grouped = _marks(words, points, "." if thousands else decimal, comma_splits)
    if mark == "," and grouped:  # points stand between thousands: "1.234", parsed as a fraction, is read again
        values[:], unread = np.nan, [str(w) for w in pd.unique(cells)]
    else:
        unread = words
    meanings = {w: v for w in unread if (v := number(w, mark, grouped)) is not None}
    unit = ""
    if not meanings and np.isnan(values).all():
        unit, meanings = _with_unit(words)
    values = np.where(np.isnan(values), np.array(cells.map(meanings), np.float64), values)
    unread_cells = np.array(cells.isin([w for w in words if w not in meanings]), bool)
    note = ""
    doubtful = decimal is None and not comma_splits and not (commas and mark == ",")
    if doubtful and with_commas and all(map(_is_grouped, with_commas)):
        note = _of_thousands(with_commas[0], mark)
    if not unread_cells.any():
        return Judged(values, unit, note=note, absent=absent)
    if unread_cells.sum() >= np.isfinite(values).sum():
        times = _times(cells, words)
        return Judged(np.array(cells, dtype=np.str_)) if times is None else Judged(times, "s")
    shown = tuple(dict.fromkeys(map(str, cells[unread_cells].head(1000))))[:MOST_WORDS]
    strange = Strange(int(np.argmax(unread_cells)), shown, int(unread_cells.sum()), np.array(cells, dtype=np.str_))
    return Judged(values, unit, strange, note)


def without_fillers(values: Array, missing: Sequence[str | float] = ()) -> tuple[Array, dict[float, int]]:
    """The column (n,) with NaN for numbers that stand for a missing value, and number -> how many cells held it.

    Such are those beyond `BEYOND`, those of `missing`, and `FILLERS` that lie far above all others."""
    declared = [v for m in missing if (v := number(str(m))) is not None]
    size = np.abs(values)
    counts = {float(v): int((values == v).sum()) for v in np.unique(values[size >= BEYOND])[:MOST_WORDS]}
    values = np.where(size >= BEYOND, np.nan, values)
    for filler in {*declared, *FILLERS}:
        filled = values == filler
        if not filled.any():
            continue
        rest = size[~filled & np.isfinite(size)]
        if filler in declared or (rest.size and float(rest.max()) < 0.1 * abs(filler)):
            counts[filler] = int(filled.sum())
            values = np.where(filled, np.nan, values)
    return values, counts


def of_frame(cells: pd.Series[Any], missing: Sequence[str | float] = ()) -> Judged:
    """A column of a table that knows types: numbers, times as s, anything else judged as text."""
    import pandas as pd

    if pd.api.types.is_datetime64_any_dtype(cells):
        seconds = (pd.to_datetime(cells, utc=True) - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
        return Judged(np.array(seconds, np.float64), "s")
    if pd.api.types.is_timedelta64_dtype(cells):
        return Judged(np.array(cells / pd.Timedelta(seconds=1), np.float64), "s")
    if pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_complex_dtype(cells):
        return Judged(cells.astype("float64").to_numpy(np.float64, na_value=np.nan))
    return judge(cells.map(lambda v: "" if v is None or v is pd.NA or v is pd.NaT or v != v else str(v)).astype(str), missing)


# ------------------------------------------------------------------ decimal marks
def _is_grouped(word: str) -> bool:
    """Whether a mark stands where one of thousands would."""
    found = GROUPED.fullmatch(word)
    return found is not None and found[1] in ",."


def _in_thousands(marked: Sequence[str], plain: Sequence[str]) -> bool:
    """Whether all marks stand where those of thousands would, beside whole numbers below 1000 that need none."""
    return bool(marked) and any(re.fullmatch(r"[-+]?\d{1,3}", w) for w in plain) and all(map(_is_grouped, marked))


def _of_thousands(word: str, mark: str) -> str:
    value, other = number(word, mark, True), {",": ".", ".": ","}[mark]
    return f"{word!r} is read as {value:.10g}; if that is wrong, write source: {{decimal: '{other}'}}"


def _marks(words: Sequence[str], points: bool, decimal: str | None, comma_splits: bool) -> tuple[str, bool]:
    """The decimal mark of a column, and whether the other mark stands between thousands; `points`: numbers have points."""
    if both := [w for w in words if "," in w and "." in w]:
        return "," if all(w.rindex(",") > w.rindex(".") for w in both) else ".", True
    commas = [w for w in words if "," in w]
    if not commas:
        return ".", False
    thousands = all(map(_is_grouped, commas))
    told = points or comma_splits or any(w.count(",") > 1 for w in commas)
    if decimal == "." or (decimal is None and thousands and told):
        return ".", True
    return ",", False


def _with_unit(words: Sequence[str]) -> tuple[str, dict[str, float]]:
    """The one unit that stands behind every number, and the numbers; nothing where there is none."""
    out: dict[str, float] = {}
    units: set[str] = set()
    for word in words:
        found = re.fullmatch(r"([-+\u2212]?[\d.,]+(?:[eE][-+]?\d+)?)\s*([^\d\s].*)", word)
        value = None if found is None else number(found[1], "," if "," in found[1] else ".")
        unit = None if found is None else unit_named(found[2])
        if value is None or unit is None:
            return "", {}
        out[word] = value
        units.add(unit[1])
    return (units.pop(), out) if len(units) == 1 else ("", {})


# ------------------------------------------------------------------ times
def _are_times(words: Sequence[str]) -> bool:
    return all(CLOCK.fullmatch(w) or DATE.fullmatch(w) for w in words)


def _times(cells: Any, words: Sequence[str]) -> Array | None:
    """s of dates and times of day; None where a cell is neither."""
    if not _are_times(words):
        return None
    if all(DATE.fullmatch(w) for w in words):
        return _dates(cells, words)
    seconds = np.array(cells.map({w: _clock(w) for w in words}), np.float64)
    steps = np.diff(seconds[np.isfinite(seconds)])
    hours = any(HOURS.fullmatch(w) or ((found := CLOCK.fullmatch(w)) and found[1]) for w in words)
    turn = DAY if hours else 3600.0  # after which they begin again
    if steps.size and (steps < -turn / 2).any():
        seconds[np.flatnonzero(np.isfinite(seconds))] += turn * np.concatenate([[0], np.cumsum(steps < -turn / 2)])
    return seconds


def _clock(word: str) -> float:
    if (found := CLOCK.fullmatch(word)) is None:
        return float("nan")
    h, m, s = float(found[1] or 0), float(found[2]), float(found[3].replace(",", "."))
    if HOURS.fullmatch(word):
        h, m, s = m, s, 0.0
    if found[4]:
        h = h % 12 + 12 * (found[4].casefold() == "pm")
    return 3600 * h + 60 * m + s


def _dates(cells: Any, words: Sequence[str]) -> Array | None:
    import pandas as pd

    for day_first in (any(re.match(r"\d{1,2}\.", w) for w in words), True):
        try:
            known = pd.to_datetime(pd.Series(words), errors="coerce", format="mixed", dayfirst=day_first, utc=True)
            seconds = (known - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
        except (ValueError, OverflowError):  # no date, or one outside of the years that are counted in ns
            return None
        if not known.isna().any():
            return np.array(cells.map(dict(zip(words, seconds, strict=True))), np.float64)
    return None
