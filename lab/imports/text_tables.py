"""Text tables as programs and spreadsheets of any country write them.

A line is data when it holds about as many numbers as most lines that hold some. Above the data stand, in any number, title
lines, headings and units; behind it footers. Lines among the data that are none of it are left out with a note.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from model.arrays import Mask
from recordings.bounded import read_bounded
from recordings.trials import present

from ..files.config import ConfigError
from ..files.map_file import Source
from .columns import Judged, is_missing, judge, looks_like_value, number
from .headings import heading, is_unit, name_tip_and_actuators, recognised, unit_named
from .joining import JOIN, of_one_file
from .series import LARGEST, Series, demand_columns, of_judged, unique

if TYPE_CHECKING:
    import pandas as pd

SEPARATORS = ("\t", ";", "|", ",", " ")
"""In the order in which they are preferred where several split the lines as well."""
WORD = 0.9
"""Numbers that a word beside them outweighs where a separator is judged: half of a row may be words."""
LONGEST_CELL = 20
"""Lines that a cell in quotation marks may have."""
SAMPLE = 100
"""Lines by which separator and width are judged."""
DATA_SHARE = 0.5
"""Of the most numbers of a line, from which a line is data."""
MOST_ABOVE = 3
"""Lines of numbers that may stand above a heading."""
COMMENT = re.compile(r"\s*(?:#+|%+|//+)\s*")
MOST_NOTED = 5
"""Lines left out that are named."""
DECIMAL_COMMA = r"\s*[-+]?(?:0?|\d{4,}),\d+\s*|\s*[-+]?\d+,(?:\d{1,2}|\d{4,})\s*"
"""A number whose comma stands between no thousands."""
WESTERN, OTHER_PAGES = "cp1252", ("cp932", "gb18030", "cp949", "cp1251")
"""Code pages of Windows: of western languages; of Japanese, Chinese, Korean and Russian, which one it is shows in a text's first
`ENOUGH` bytes."""
ENOUGH = 20_000
END_OF_HEADER = "***End_of_Header***"
"""Line of LabVIEW's measurement files (.lvm)."""


@dataclass(frozen=True)
class Line:
    """A line, or several where a cell in quotation marks holds line breaks."""

    number: int
    """In the file."""
    text: str
    comment: bool
    """Begins with #, % or //, which `text` does not hold."""
    cells: Sequence[str] = ()
    """Of one above the numbers."""


def read_text(path: Path, source: Source) -> Series:
    """The columns of a text table; raises ConfigError."""
    text = _decoded(path, read_bounded(path, LARGEST, ConfigError))
    records = list(_records(text))
    if not records:
        raise ConfigError(f"{path}: is empty; check the path, or export it again")
    records, heading = _labview(records)
    source = source if source.heading is not None else source.model_copy(update={"heading": heading})
    tables = [records] if source.heading is not None or source.units is not None else list(_tables(records))
    if len(tables) > 1:
        return of_one_file([_read_table(path, one, source, True) for one in tables])
    return _read_table(path, records, source, text.endswith("\n"))


def _read_table(path: Path, records: list[Line], source: Source, whole: bool) -> Series:
    """Read one table of a file; `whole`: its last line cannot be cut off. Raises ConfigError."""
    import pandas as pd

    stated = re.fullmatch(r"sep=(.)", records[0].text.strip())
    separator, width = _form(path, records, source.separator or (stated[1] if stated else None), source.missing)
    frame, records, wide = _split(records, separator, width)
    parsed = frame.apply(pd.to_numeric, errors="coerce")
    data, first = _data_rows(path, frame, parsed.notna().to_numpy(), records, source, separator)
    if data[-1] and not whole and _is_cut_off(_cells(records[-1].text, separator), frame[data][:-1]):
        data[-1] = False
    bare = ([" ".join(cell.split()).strip('"').strip() for cell in frame.iloc[i]] for i in range(first))
    above = [replace(line, cells=cells) for line, cells in zip(records, bare, strict=False)]
    head = head_of(path, above, frame.shape[1], source)
    _demand_one_table(path, frame, records, data, first, head)
    lines = np.array([r.number for r, is_data in zip(records, data, strict=True) if is_data], np.int64)
    columns = _columns(frame[data], parsed[data], head, source, separator)
    columns |= _times_of_frames(columns, records[:first])
    mark = {"\t": "tabs", " ": "spaces"}.get(separator, repr(separator))
    of_motive = MOTIVE.match(records[0].text)
    form = "Motive's export" if of_motive else f"columns separated by {mark}"
    series = of_judged(path, columns, form, tuple(_left_out(path, records, frame.shape[1], data, first, wide)))
    if of_motive and (stated := START.search(records[0].text)):
        times = judge(pd.Series([f"{stated['date']} {stated['clock'].replace('.', ':', 2)}"])).values
        series = replace(series, start=(stated["start"], float(times[0])) if times.dtype.kind == "f" else None)
    return replace(series, units={**head.units, **series.units}, common_units=head.common_units, lines=lines)


# ------------------------------------------------------------------ tables below each other
def _tables(records: list[Line]) -> Iterator[list[Line]]:
    """Split lines into tables: another begins behind an empty line below numbers, with other headings and two rows of numbers."""
    begin = 0
    for i in range(1, len(records)):
        if records[i].number == records[i - 1].number + 1 or not _is_data(records[i - 1]) or _is_data(records[i]):
            continue
        first = next((k for k in range(i, len(records)) if _is_data(records[k])), len(records))
        heads = [r.text.strip() for r in records[i:first] if sum(not looks_like_value(c) for c in _any_cells(r.text)) > 1]
        known = {r.text.strip() for r in records[begin:i]} if heads else set()
        if first + 1 < len(records) and _is_data(records[first + 1]) and heads and not known & set(heads[-1:]):
            yield records[begin:i]
            begin = i
    yield records[begin:]


def _any_cells(text: str) -> list[str]:
    return [c for c in (cell.strip().strip('"') for cell in re.split(r"[;,\t|]|\s{2,}", text)) if c]


def _is_data(record: Line) -> bool:
    """Whether a line holds numbers, at least two, more than anything else."""
    cells = _any_cells(record.text)
    values = sum(map(looks_like_value, cells))
    return not record.comment and values > 1 and values > len(cells) / 2


def _times_of_frames(found: Mapping[str, Judged], above: Sequence[Line]) -> dict[str, Judged]:
    """Times of frames divided into samples, where a line above holds the samples a second alone, as Vicon Nexus writes it."""
    frame, sample = (next((found[n] for n in found if n.casefold() == name), None) for name in ("frame", "sub frame"))
    rates = [v for r in above if len(cells := _any_cells(r.text)) == 1 and (v := number(cells[0])) is not None and v > 0]
    if frame is None or sample is None or not rates or "time" in found or frame.values.dtype.kind != "f":
        return {}
    count, part = np.asarray(frame.values, np.float64), np.asarray(sample.values, np.float64)
    return {"time": Judged(((count - 1) * (np.nanmax(part) + 1) + part) / rates[-1], "s")}


# ------------------------------------------------------------------ characters and lines
def _decoded(path: Path, data: bytes) -> str:
    """Text in UTF-8, UTF-16, UTF-32 or a code page of Windows, with one kind of line break."""
    half = max(1, len(data.rstrip(b"\0")) // 2)  # letters, if each takes two bytes
    if data.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        encoding = "utf-32"
    elif data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif data[1::2].count(0) > 0.6 * half:
        encoding = "utf-16-le"
    elif data[0::2].count(0) > 0.6 * half:
        encoding = "utf-16-be"
    else:
        encoding = "utf-8-sig"
        data = data.rstrip(b"\0")  # of a logger that lost its power
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode(_code_page(data) if encoding == "utf-8-sig" else encoding, "replace")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    begin = text[:10_000]
    if sum(c < " " and c not in "\t\n\0\f\x1a" for c in begin) + begin.count("\ufffd") > 0.1 * len(begin):
        raise ConfigError(f"{path}: is not a text table; export the data as CSV")
    return text.replace("\0", "")


def _code_page(data: bytes) -> str:
    """Of text that is no Unicode: Windows' western one, unless letters beyond ASCII stand together as in no western word."""
    if not re.search(rb"[\x80-\xff]{3}", data):
        return WESTERN
    from charset_normalizer import from_bytes

    found = from_bytes(data[:ENOUGH], cp_isolation=list(OTHER_PAGES)).best()
    return found.encoding if found is not None else WESTERN


def _records(text: str) -> Iterator[Line]:
    """Lines that hold anything, those of one cell in quotation marks joined."""
    lines = text.split("\n")
    i = 0
    while i < len(lines):
        line, begin = lines[i], i
        i += 1
        if line.count('"') % 2:
            end = next((k for k in range(i, min(i + LONGEST_CELL, len(lines))) if lines[k].count('"') % 2), None)
            if end is None:  # a stray mark, such as that of inches
                line = line.replace('"', "")
            else:
                line, i = " ".join([line, *lines[i : end + 1]]), end + 1
        mark = COMMENT.match(line)
        bare = line[mark.end() :] if mark else line
        if bare.strip(" \t,;|\x1a\f"):
            yield Line(begin + 1, bare, mark is not None)


def _labview(records: list[Line]) -> tuple[list[Line], int | None]:
    """Lines of a file of LabVIEW without the headers of its later segments, and the line of its headings; None of others."""
    ends = [i for i, r in enumerate(records) if r.text.startswith(END_OF_HEADER) and i + 1 < len(records)]
    if not ends:
        return records, None
    begins = [i for i, r in enumerate(records) if i > ends[0] and r.text.startswith("Channels")]
    segments = [(i, next((e for e in ends if e > i), i)) for i in begins]
    first = segments[0][1] if segments else ends[0]
    dropped = {k for i, end in segments[1:] for k in range(i, end + 2)}
    return [r for k, r in enumerate(records) if k not in dropped], records[first + 1].number


def _cells(text: str, separator: str) -> list[str]:
    """One line split."""
    if separator == " ":
        text = " ".join(text.split())
    if '"' not in text:
        return text.split(separator)
    try:
        return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return text.replace('"', "").split(separator)


def _form(path: Path, records: Sequence[Line], given: str | None, missing: Sequence[str | float]) -> tuple[str, int]:
    """Separator (`given`: as stated) and number of columns that hold most values and fewest words. Raises ConfigError."""
    lines = [r for r in records if not r.comment]
    sample = lines[:SAMPLE] + (lines[-SAMPLE:] if len(lines) > 2 * SAMPLE else [])
    best: tuple[float, str, int] = (0.0, "", 0)
    for separator in [given] if given else SEPARATORS:
        score: dict[int, float] = {}  # number of cells of a line -> score of all such lines
        for record in sample:
            cells = _cells(record.text, separator)
            values = sum(map(looks_like_value, cells))
            other = sum(not looks_like_value(c) and not is_missing(c, missing) for c in cells)
            if values and len(cells) > 1:
                score[len(cells)] = score.get(len(cells), 0.0) + values - WORD * other
        width, points = max(score.items(), key=lambda s: s[1], default=(0, 0.0))
        # blanks, of which a tab is one, must split the lines better than another separator
        if points > best[0] * (1.2 if separator == " " else 1.0):
            best = (points, separator, width)
    if not best[1]:
        tried = f"not split by {given!r}" if given else "no separator splits the lines into columns of numbers"
        raise ConfigError(
            f"{path}, line {records[0].number}: {records[0].text.strip()[:40]!r} ..: {tried}; "
            "name the separator (source.separator), or export the data as CSV"
        )
    demand_columns(path, best[2])
    return best[1], best[2]


def _split(records: list[Line], separator: str, width: int) -> tuple[pd.DataFrame, list[Line], list[Line]]:
    """Cells as text (lines, columns), their lines, and lines of data left out, as they have more cells than columns (`width`)."""
    import pandas as pd

    lines, rows, wide = [], [], []
    for record in records:
        cells = [cell.strip() for cell in _cells(record.text, separator)]
        if any(cells[width:]):
            values = sum(map(looks_like_value, cells))
            if values > DATA_SHARE * width and values > DATA_SHARE * sum(map(bool, cells)):
                wide.append(record)
                continue
            cells = _heading_cells(record.text, width) if separator == " " else cells
        lines.append(record)
        rows.append((cells + [""] * width)[:width])
    return pd.DataFrame(rows, columns=range(width), dtype=str), lines, wide


def _heading_cells(text: str, width: int) -> list[str]:
    """Headings of columns separated by spaces, which may hold spaces themselves."""
    for way in (r"\s{2,}|\t", r"(?<=[\])])\s+"):
        cells = re.split(way, text.strip())
        if len(cells) == width:
            return cells
    cells = re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", text)
    return cells if len(cells) == width else [text]


# ------------------------------------------------------------------ which lines are data
def _data_rows(
    path: Path, frame: pd.DataFrame, number: Mask, records: Sequence[Line], source: Source, separator: str
) -> tuple[Mask, int]:
    """(lines,) whether each is data, and the index of the first that is; `number` (lines, columns): cells that are plain numbers.
    Data are lines with about as many numbers as most, or with fewer but no word in a column of numbers; not comments, lines up to
    the stated heading or units, numbers above headings, nor sums and means below the table. Raises ConfigError where none is."""
    import pandas as pd

    number, (missing, filled) = number.copy(), (np.zeros(frame.shape, bool) for _ in range(2))
    for k in frame:
        cells = frame[k]
        filled[:, k] = cells != ""
        rest = pd.unique(cells[~number[:, k] & filled[:, k]])
        missing[:, k] = cells.isin([w for w in rest if is_missing(w, source.missing)])
        number[:, k] |= np.array(cells.isin([w for w in rest if looks_like_value(w)]), bool) & ~missing[:, k]
    number[[r.comment for r in records]] = False
    after = source.units or source.heading or 0  # line below which data begin
    number[[r.number <= after for r in records]] = False
    if _counted_headings(frame, number, source):
        number[int(np.argmax(number.any(axis=1)))] = False
    count = number.sum(axis=1)
    least = DATA_SHARE * count.max(initial=0)
    full = count >= max(least, 1)
    words = filled & ~number & ~missing
    number_columns = number[full].sum(axis=0) > words[full].sum(axis=0)
    has_word = np.asarray(words[:, number_columns].any(axis=1), bool)
    commented = np.array([r.comment for r in records], bool)
    data = ~commented & (full | ((count >= 1) & ~has_word & (count + missing.sum(axis=1) >= min(least, 2))))
    if not data.any():
        raise ConfigError(
            f"{path}: no line below line {after} holds numbers; correct source.{'units' if source.units else 'heading'}" if after
            else f"{path}: no line holds numbers; is {separator!r} its separator (source.separator)?"
        )  # fmt: skip
    # lines of numbers, of channels say, may stand above a heading: the table's own rows begin below it
    data_lines, headed = np.flatnonzero(data), ~data & ~commented & (words.sum(axis=1) >= DATA_SHARE * words.shape[1])
    above = range(min(MOST_ABOVE, len(data_lines) // 2), 0, -1)
    data[: next((data_lines[k] for k in above if headed[data_lines[k - 1] : data_lines[k]].any()), 0)] = False
    clean = np.flatnonzero(data & full & ~has_word)
    behind = np.arange(len(has_word)) > (clean[-1] if len(clean) else len(has_word))
    # behind the last clean line, words that stand nowhere else ("mean", "total") begin what sums the table up
    for k in np.flatnonzero(number_columns & words[behind].any(axis=0)).tolist():
        data &= ~(behind & words[:, k] & ~frame[k].duplicated(keep=False).to_numpy())
    return data, int(np.argmax(data))


def _is_cut_off(last: Sequence[str], above: pd.DataFrame) -> bool:
    """Whether a last line ends before its last number does: it has fewer cells, or decimals in its last cell, than rows above."""
    if len(above) < 2 or len(last) > above.shape[1]:
        return False
    if len(last) < above.shape[1]:
        return bool(above.iloc[:, len(last) :].ne("").any(axis=1).all())
    known = above.iloc[:, -1].map(_decimals)
    return bool(known.min() == known.max() > _decimals(last[-1]))


def _decimals(cell: str) -> int:
    """Digits behind a decimal mark at the end of a cell."""
    found = re.search(r"[.,](\d+)\s*$", cell)
    return len(found[1]) if found else 0


def _counted_headings(frame: pd.DataFrame, number: Mask, source: Source) -> bool:
    """Whether the first line of numbers only counts the columns, from 0 or 1."""
    rows = np.flatnonzero(number.all(axis=1))
    if source.heading is not None or len(rows) < 2 or frame.shape[1] < 3:
        return False
    first, second = (frame.iloc[int(i)].tolist() for i in rows[:2])
    counts = [[str(i + begin) for i in range(frame.shape[1])] for begin in (0, 1)]
    return first in counts and second not in counts


def _left_out(path: Path, records: Sequence[Line], width: int, data: Mask, first: int, wide: Sequence[Line]) -> Iterator[str]:
    """Notes on lines that look like part of the table and are not read; raises ConfigError where they are many."""
    if len(wide) > 0.1 * int(data.sum()):
        raise ConfigError(
            f"{path}, line {wide[0].number}: has more than the {width} cells of other lines: "
            f"{wide[0].text.strip()[:40]!r}; correct the line, or name separator and decimal mark "
            "(source.separator, source.decimal)"
        )
    skipped = [r for r, ok in zip(records[first:], data[first:], strict=True) if not ok and not r.comment]
    empty = [r for r in skipped if all(map(looks_like_value, _any_cells(r.text)))]
    if empty:
        words = f"{len(empty)} lines" if len(empty) > 1 else "a line"
        yield f"{words} with values in few of the {width} columns, the first line {empty[0].number}, taken as missing"
    odd = [(r, "is not a row of numbers") for r in skipped if r not in empty]
    odd += [(r, f"has more than {width} cells") for r in wide]
    for record, why in odd[:MOST_NOTED]:
        yield f"line {record.number} {why} and is skipped: {record.text.strip()[:40]!r}"
    if len(odd) > MOST_NOTED:
        yield f"{len(odd) - MOST_NOTED} further lines are skipped, the last one line {odd[-1][0].number}"


def _unit(cell: str) -> str:
    """The unit that a cell of a line of units names; empty where it names none of this software."""
    return (unit_named(cell) or ("", ""))[1]


def _demand_one_table(path: Path, frame: pd.DataFrame, records: Sequence[Line], data: Mask, first: int, head: Head) -> None:
    """Raise ConfigError where other headings or units stand among the data: below them the columns are others."""
    unit_of = {n: head.units.get(n) or heading(n).unit for n in head.names}
    last = len(data) - int(np.argmax(data[::-1]))
    for i in (np.flatnonzero(~data[first:last]) + first).tolist():
        cells = [" ".join(str(c).split()).strip('"') for c in frame.iloc[i]]
        headings_here = sum(c in head.stated for c in cells)
        in_place = sum(c == name for c, name in zip(cells, head.names, strict=True))
        pairs = [(_unit(c), unit_of[n]) for c, n in zip(cells, head.names, strict=True)]
        other_units = are_units(cells) and any(here and above and here != above for here, above in pairs)
        enough = max(1, int(0.3 * len(head.stated)))
        # headings in their own columns repeat the head; some of them in other columns begin another table
        if other_units or (headings_here >= enough and in_place < sum(map(bool, cells)) and in_place < len(head.stated)):
            unlike = (c for c, n in zip(cells, head.names, strict=True) if c and c != n and _unit(c) != unit_of[n])
            other = next(unlike, records[i].text.strip())
            raise ConfigError(
                f"{path}, line {records[i].number}: says {other[:40]!r} and begins another table than line "
                f"{records[first].number}; put each table into a separate file and give all of them, or {JOIN}"
            )


# ------------------------------------------------------------------ what stands above the numbers
MOST_LINES = 4
"""Of headings."""
LABELS = ("id", "type", "parent")
"""Lines of headings, by the word at their begin, that name nothing: Motive writes them."""
MOTIVE = re.compile(r"\W*Format Version\W.*Take Name")
"""Begin of the files that Motive exports."""
START = re.compile(r"Capture Start Time\W(?P<start>(?P<date>[\d-]{8,10}) (?P<clock>\d+\.\d+\.\d+(\.\d+)?( [AP]M)?))")
ABOUT_UNITS = re.compile(r"unit|einheit|unité|unidad|\bin\b|\[", re.IGNORECASE)
SINGLE = frozenset({"m", "s", "g", "n", "h", "in", "at"})
"""Units that are letters or words: read as units only where `in`, `:`, `=` or a bracket stands before them."""


@dataclass(frozen=True)
class Head:
    """Names of the columns, and what is said of their units."""

    names: list[str]
    stated: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)
    common_units: Mapping[str, str] = field(default_factory=dict)
    """SI unit -> unit of all such columns."""


def head_of(path: Path, above: Sequence[Line], width: int, source: Source) -> Head:
    """Names and units of `width` columns from the lines above the data; `source.heading` and `source.units` name lines by number.

    Else the units are the last line of units, and headings the lines that name most quantities; other lines may list units or
    state a common one. Raises ConfigError where a named line is not there, or commas are both marks and separators."""
    named = {line.number: line.cells for line in above}
    for key, line in (("heading", source.heading), ("units", source.units)):
        if line and line not in named:
            raise ConfigError(f"{path}: source.{key} = {line}: this line has no words above the numbers; correct the line")
    wide = [line for line in above if sum(map(bool, line.cells)) >= max(1, 0.5 * width) and not MOTIVE.match(line.text)]
    labels = {line.number for line in above if _is_label(line.cells)}
    units = named[source.units] if source.units else None
    if units is None:
        last = [line for line in above[-1:] if wide and sum(map(bool, line.cells)) > 1]  # perhaps of few columns
        unit_lines = [line for line in (*wide, *last) if line.number != source.heading and are_units(line.cells)]
        other_lines = [line for line in wide if line not in unit_lines]
        units = unit_lines[-1].cells if unit_lines and (other_lines or source.heading) else None
    heads = [line for line in wide if line.cells is not units]
    if source.heading is not None:
        heads = [line for line in above if line.number == source.heading]
    elif units is not None and heads:  # below a line of units may stand comments
        unit_number = next(line.number for line in above if line.cells is units)
        heads = [line for line in heads if line.number < unit_number] or heads[:1]
    cells = _joined(heads, labels)
    if source.heading is None and not labels:
        heads, cells = _telling(above, units, heads, cells)
    stated = [c for c in cells if c]
    if len(stated) * 2 == width and len(cells[: width // 2]) == len(stated) and width > 3:
        raise ConfigError(
            f"{path}, line {heads[-1].number}: {len(stated)} headings for {width} columns: commas seem to be both decimal marks "
            "and separators; export with semicolons or tabs"
        )
    names = unique(cells, width)
    used = {id(line.cells) for line in heads} | {id(units)}
    by_column = {n: u for n, u in zip(names, units or [], strict=False) if u}
    common: dict[str, str] = {}
    for other in above:
        if id(other.cells) not in used and ABOUT_UNITS.search(other.text):
            listed = _listed_units(other.text, width)
            by_column |= {n: u for n, u in zip(names, listed, strict=False) if n not in by_column}
            if not listed:
                for si, unit in _units_in(other.text).items():
                    common.setdefault(si, unit)
    return Head(names, frozenset(n for n, c in zip(names, cells, strict=False) if c), by_column, common)


def are_units(cells: Sequence[str]) -> bool:
    """Whether a line is one of units."""
    said = [c for c in cells if c]
    return bool(said) and any(unit_named(c) for c in said) and sum(map(is_unit, said)) > len(said) / 2


def _joined(heads: Sequence[Line], labels: Collection[int]) -> list[str]:
    """A name for each column: that of the last of `heads`, with those above where it is not unique; not of `labels`."""
    if not heads:
        return []
    names = heads[-1].cells
    stated = [n for n in names if n]
    if len(set(stated)) == len(stated):
        return list(names)
    for k in range(len(heads) - 2, -1, -1):
        cells = heads[k].cells
        if any(number not in labels for number in range(heads[k].number + 1, heads[k + 1].number)):
            break
        if _is_label(cells):
            continue
        names = [f"{a} {b}".strip() for a, b in zip(_carried(cells), names, strict=False)]
    return [re.sub(r"^(Name|Type) ", "", n) for n in names]


def _telling(
    above: Sequence[Line], units: Sequence[str] | None, heads: list[Line], names: list[str]
) -> tuple[list[Line], list[str]]:
    """Lines, and the names made of them, that name most columns: those given, a line alone, or the last ones together."""
    near = [x for x in above if x.cells is not units and sum(map(bool, x.cells)) > 1 and not MOTIVE.match(x.text)][-MOST_LINES:]
    ways = [(heads, names), *(([line], list(line.cells)) for line in near)]
    joins = bool(near) and not name_tip_and_actuators(near[-1].cells, units or ())  # else what stands above is a title
    for k in range(len(near) - 1 if joins else 0):
        columns = zip(*(_carried(line.cells) for line in near[k:-1]), near[-1].cells, strict=False)
        ways.append((near[k:], [" ".join(filter(None, cells)) for cells in columns]))
    return max(ways, key=lambda way: recognised(way[1], units or ()))


def _is_label(cells: Sequence[str]) -> bool:
    """Whether a line above the headings names nothing that tells columns apart."""
    return any(c.casefold() in LABELS for c in cells[:2])


def _carried(cells: Sequence[str]) -> list[str]:
    """A line of headings in which a name stands above the first of its columns only, or above each."""
    return list(accumulate(cells, lambda last, cell: cell or last, initial=""))[1:]


def _listed_units(text: str, width: int) -> list[str]:
    """A unit for each column, as in "units: s, kPa, kPa, mm"; empty where the line does not list as many."""
    rest = re.split(r"[:=]", text, maxsplit=1)[-1]
    for way in (r"[;\t|]", r",", r"[\s,;|]+"):
        parts = [p.strip().strip('"') for p in re.split(way, rest.strip())]
        for cells in (parts, parts[1:]):
            if len(cells) == width and are_units(cells):
                return cells
    return []


def _units_in(text: str) -> dict[str, str]:
    """SI unit -> the one unit of it that a line names."""
    found: dict[str, set[str]] = {}
    for said in re.finditer(r"(?P<before>\bin\s+|[:=(\[,;]\s*|\s|^)(?P<word>[^\s,;:=()\[\]]+)", text):
        unit = unit_named(said["word"])
        if unit is None or (said["word"].casefold() in SINGLE and not re.search(r"in\s|[:=(\[]", said["before"])):
            continue
        found.setdefault(unit[0], set()).add(unit[1])
    return {si: units.pop() for si, units in found.items() if len(units) == 1}


# ------------------------------------------------------------------ columns
def _columns(kept: pd.DataFrame, parsed: pd.DataFrame, head: Head, source: Source, separator: str) -> dict[str, Judged]:
    """What each column of cells, parsed where they are plain numbers, holds; separators at the end of lines make none."""
    commas = any(kept[k][parsed[k].isna()].str.fullmatch(DECIMAL_COMMA).any() for k in kept)
    splits = separator == "," and not commas
    judged = {
        name: judge(kept[k], source.missing, source.decimal, parsed=parsed[k], comma_splits=splits, commas=commas)
        for k, name in enumerate(head.names)
    }
    while len(judged) > 1 and (name := next(reversed(judged))) not in head.stated and not present(judged[name].values).any():
        del judged[name]
    return judged
