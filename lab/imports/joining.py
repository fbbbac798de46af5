"""Join streams of one experiment in time: of several files, of several tables in one file, or of alternating rows.

The rows of the stream with the tip remain. The others are interpolated at its times, and are missing where the nearest reading is
older than the stream's own period.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from model.arrays import Array, Ints, Mask
from recordings.trials import present

from ..files.config import ConfigError
from ..files.map_file import Column, Map, Name
from ..files.units import KINDS
from .clock import EPOCH, HALF_HOUR, LARGEST_CHANGE, period, seconds, timeline, unit_of_steps
from .headings import heading, is_unit, own_column, quantity, triples
from .series import Series, axes_of, cleaned, listed, name_of, numbers, unit_in

JOIN = "join them in time first (docs: data from elsewhere)"
"""The remedy where tables cannot be joined here."""
AGE = 1.5
"""Periods of a stream that its nearest reading may be old."""
MOST_STREAMS = 20
"""Groups of columns that take turns."""
OWN_ROWS, TOGETHER, TURNS = 0.8, 0.2, 0.2
"""Share of rows up to which a column is one of a stream, share of the smaller one's rows that two streams have in common at most,
and least share of rows with which the stream changes where they take turns."""
LEAST_LAG, CLEAR, CLEARER = 1.0, 0.2, 1.5
"""s, correlation, and how many times that at once, from which another offset between pressures and tip is proposed."""
LONGEST_LAG = 120.0
"""s of offset that is looked for."""


@dataclass(frozen=True)
class Stream:
    """A table and its times."""

    series: Series
    label: str
    t: Array
    """(n,) s, NaN of rows without a time."""
    questions: tuple[str, ...] = ()
    """About its times."""
    aligned: bool = False
    """Whether the map states by how much to move them."""

    @property
    def span(self) -> tuple[float, float]:
        """First and last time."""
        return float(np.nanmin(self.t)), float(np.nanmax(self.t))

    @property
    def absolute(self) -> bool:
        """Whether its times are dates."""
        return self.span[0] >= EPOCH[0]


def stream_of(series: Series, label: str, given: Map | None = None) -> Stream:
    """A table with its times by the map, or by its headings; raises ConfigError where it has none."""
    source, column = (given.source, given.columns.get("t")) if given else (None, None)
    if column is not None and _has(series, column.column):
        t, tick = _seconds(series, column)
    elif source is not None and source.rate is not None:
        t, tick = np.arange(len(series)) / source.rate, 1.0
    elif (name := time_heading(series)) is not None:
        t, tick = _seconds(series, Column(column=name))
    else:
        raise ConfigError(
            f"{label}: no time column to join it by; there are {listed(series.names)}; name it under "
            f"files: {{{label!r}: {{columns: {{t: ..}}}}, '*': {{}}}}, or {JOIN}"
        )
    if not np.isfinite(t).any():
        raise ConfigError(f"{label}: no row has a time; {JOIN}")
    line = timeline(t, tick, series.place)
    true_times = np.full(len(t), np.nan)
    true_times[line.rows] = line.t + (source.offset if source else 0.0)
    questions = tuple(f"{label}, {text}" for text in line.questions)
    return Stream(series, label, true_times, questions, source is not None and "offset" in source.model_fields_set)


def on_one_clock(streams: Sequence[Stream]) -> list[Stream]:
    """The same streams; where some have dates, the others count from the start that their file states, with a note."""
    dated, made = listed(s.label for s in streams if s.absolute), list[Stream]()
    for stream in streams:
        if dated and not stream.absolute and (start := stream.series.start) is not None:
            words = f"time 0 of {stream.label} is taken as its start, {start[0]}, in the time zone of {dated}"
            stream = replace(stream, series=replace(stream.series, notes=(*stream.series.notes, words)), t=stream.t + start[1])
        made.append(stream)
    return made


def time_heading(series: Series) -> str | None:
    """The first column whose heading is one of times."""
    headings = (heading(name, series.units.get(name, "")) for name in series.numbers)
    return next((h.name for h in headings if own_column(h) in (None, "t") and (quantity(h) == "t" or h.kind == "s")), None)


def _has(series: Series, name: Name) -> bool:
    return isinstance(name, int) or name in series.names


def _seconds(series: Series, column: Column) -> tuple[Array, float]:
    """Times of a column in s, and its unit in s."""
    name = name_of(series, column.column, "columns.t")
    values = numbers(series, name, "columns.t") * column.scale
    unit = column.unit or unit_in(series, name, KINDS["s"]) or unit_of_steps(values)
    return seconds(values, unit, KINDS["s"].get(unit, 1.0)), column.scale * KINDS["s"].get(unit, 1.0)


# ------------------------------------------------------------------ values at other times
def at_times(at: Array, times: Array, values: Array, oldest: float) -> Array:
    """Values at other times, on the line between two readings; NaN where the nearest reading is older than `oldest` (s).

    A count or a switch, whole numbers that mostly stand still, keeps its last reading. Where two readings are further apart than
    half of all that the column ever passes through (an angle that has turned past 180 deg), the nearer one counts."""
    seen = np.isfinite(values) & np.isfinite(times)
    if not seen.any():
        return np.full(len(at), np.nan)
    times, values = times[seen], values[seen]
    last, after, nearest, far = _around(at, times, oldest)
    steps = np.diff(values)
    if np.all(values == np.round(values)) and 2 * np.count_nonzero(steps) < steps.size:
        return np.where(far, np.nan, values[last])
    leaps = np.abs(values[after] - values[last]) > 0.5 * np.ptp(values)
    return np.where(far, np.nan, np.where(leaps, values[nearest], np.interp(at, times, values)))


def _around(at: Array, times: Array, oldest: float) -> tuple[Ints, Ints, Ints, Mask]:
    """Of times in order, those before, after and nearest to each of `at`, and whether the nearest is older than `oldest`."""
    before = np.clip(np.searchsorted(times, at, side="right") - 1, 0, None)
    after = np.clip(before + (times[before] < at), 0, len(times) - 1)
    nearest = np.where(np.abs(times[after] - at) < np.abs(times[before] - at), after, before)
    return before, after, nearest, ~(np.abs(times[nearest] - at) <= oldest)


def joined(lead: Stream, others: Sequence[Stream]) -> Series:
    """The rows of `lead` with the columns of `others` at its times; raises ConfigError where they have no time in common."""
    columns, units, notes = dict(lead.series.columns), dict(lead.series.units), list(lead.series.notes)
    common = dict(lead.series.common_units)
    added: set[str] = set()
    for other in others:
        if lead.absolute != other.absolute or _overlap(lead, other) <= 0:
            raise ConfigError(_apart(lead, other))
        order = np.argsort(other.t, kind="stable")  # rows without a time come last
        times, oldest = other.t[order], AGE * max(period(np.sort(other.t)), 1e-9)
        for name, values in other.series.columns.items():
            heading_here = f"{name} ({other.label})" if name in columns and name not in added else name
            # a column here, too, whose numbers never fall counts rows or time
            rising = heading_here != name and values.dtype.kind == "f" and (np.diff(values[present(values)]) >= 0).all()
            if rising or name == time_heading(other.series):
                continue
            earlier = columns.get(heading_here)  # added by an earlier table of the same kind, which covers other times
            if values.dtype.kind == "U":
                texts, columns[heading_here] = np.asarray(values[order], np.str_), np.full(len(lead.t), "", np.str_)
                if (seen := (texts != "") & np.isfinite(times)).any():  # the last words before each of the times
                    before, _, _, far = _around(lead.t, times[seen], oldest)
                    columns[heading_here] = np.where(far, "", texts[seen][before])
            else:
                columns[heading_here] = at_times(lead.t, times, np.asarray(values[order], np.float64), oldest)
            if earlier is not None and earlier.dtype.kind == values.dtype.kind:
                columns[heading_here] = np.where(present(columns[heading_here]), columns[heading_here], earlier)
            added.add(heading_here)
            if unit := other.series.units.get(name):
                units[heading_here] = unit
            if strange := other.series.strange.get(name):
                words = ", ".join(repr(w[:40]) for w in strange.words)
                notes.append(f"{other.label}: {strange.cells} cells of {name!r} are not numbers ({words}): taken as missing")
            elif said := other.series.read_as_missing(name):
                notes.append(f"{other.label}: column {name!r}: {said}")
        notes += [n for n in other.series.notes if n not in notes]
        common = {**other.series.common_units, **common}
    return replace(lead.series, columns=columns, units=units, common_units=common, notes=tuple(notes))


def _overlap(a: Stream, b: Stream) -> float:
    """s that both have in common."""
    return min(a.span[1], b.span[1]) - max(a.span[0], b.span[0])


def _apart(lead: Stream, other: Stream) -> str:
    """State that two tables do not overlap in time, and what to do."""
    spans = " and ".join(f"{s.label} ({s.span[0]:.10g} .. {s.span[1]:.10g} s)" for s in (lead, other))
    zones = [k * HALF_HOUR for k in range(-LARGEST_CHANGE, LARGEST_CHANGE + 1)]
    moved = [z for z in zones if min(lead.span[1], other.span[1] + z) > max(lead.span[0], other.span[0] + z)]
    zone = min(moved, key=abs) if moved and lead.absolute == other.absolute else None
    start = lead.span[0] - other.span[0], "if both started together"
    proposed, why = start if zone is None else (zone, "if one clock is set to another time zone")
    return (
        f"{spans} do not overlap in time. State by how many seconds to shift one of them; {why}, write files: "
        f"{{{other.label!r}: {{source: {{offset: {proposed:.10g}}}}}, '*': {{}}}}, or {JOIN}"
    )


# ------------------------------------------------------------------ which belong together
def experiments(
    streams: Sequence[Stream], lacked: Sequence[frozenset[str]], leads: Callable[[frozenset[str]], bool]
) -> tuple[list[tuple[Stream, list[Stream]]], list[Stream]]:
    """Return each leading table with the tables that belong to it, and the tables that belong to none; raises ConfigError.

    Tables that lack the same keys of the map (`lacked`, of each) are of one kind; the first kind for which `leads` is true
    leads. Tables with dates belong together where they have time in common, others in their order."""
    kinds = {kind: [s for s, keys in zip(streams, lacked, strict=True) if keys == kind] for kind in dict.fromkeys(lacked)}
    first = next((kind for kind in kinds if leads(kind)), next(iter(kinds)))
    runs: list[tuple[Stream, list[Stream]]] = [(lead, []) for lead in kinds.pop(first)]
    unused: list[Stream] = []
    for tables in kinds.values():
        if all(s.absolute for s in (*tables, *(lead for lead, _ in runs))):
            for lead, companions in runs:
                overlapping = sorted((s for s in tables if _overlap(lead, s) > 0), key=lambda s: s.span)
                # without any, the nearest: `joined` refuses it and says how far its clock is off
                companions += overlapping or [max(tables, key=lambda s: _overlap(lead, s))]
            unused += [s for s in tables if all(_overlap(lead, s) <= 0 for lead, _ in runs)]
        elif len(tables) == len(runs):
            for (_, companions), table in zip(runs, tables, strict=True):
                companions.append(table)
        else:
            raise ConfigError(
                f"{len(runs)} tables such as {runs[0][0].label} and {len(tables)} such as {tables[0].label} have no dates that "
                f"show which belong together: give the files of one run at a time, or {JOIN}"
            )
    return runs, unused


def in_time(read: Sequence[tuple[Series, Map]]) -> list[tuple[Series, Map]]:
    """Files with their maps; where each lacks columns that another one holds, joined in time. Raises ConfigError."""
    lacked_keys = list[frozenset[str]]()  # keys of the map whose column a file has not, but for its times
    for series, own in read:
        names: dict[str, list[Name | tuple[Name, Name, Name]]] = {n: [c.column] for n, c in own.columns.items() if n != "t"}
        names |= {n: [*p.of, *p.against] for n, p in own.points.items()}
        names |= {"orientation": list(own.orientation.columns)} if own.orientation else {}
        lacked_keys.append(frozenset(k for k, of in names.items() if not all(_there(series, n, k in own.points) for n in of)))
    if len(read) < 2 or not all(lacked_keys) or frozenset.intersection(*lacked_keys):
        named = []  # some file is whole, or a key is in none of them
        for (series, own_map), keys in zip(read, lacked_keys, strict=True):
            lost = f"this file lacks the columns for {', '.join(sorted(keys))}: if another file holds them, give it too"
            named.append((replace(series, notes=(*series.notes, *[lost] * (len(keys) > 1))), own_map))
        return named
    streams = on_one_clock([stream_of(series, series.path.name, own_map) for series, own_map in read])
    maps = {id(stream): own_map for stream, (_, own_map) in zip(streams, read, strict=True)}
    runs, unused = experiments(streams, lacked_keys, lambda keys: not keys & {"x", "y", "z", "tip"})
    notes = [f"{s.label} is not read: it does not overlap in time with {listed(lead.label for lead, _ in runs)}" for s in unused]
    made = []
    for lead, others in runs:
        columns = {n: c for other in others for n, c in maps[id(other)].columns.items() if n != "t"} | maps[id(lead)].columns
        spans = (f"{s.label} ({s.span[0] - lead.span[0]:.4g} .. {s.span[1] - lead.span[0]:.4g} s)" for s in (lead, *others))
        clocks = () if any(stream.aligned for stream in (lead, *others)) else (
            f"joined by their clocks: do these agree? {', '.join(spans)}, from the start of {lead.label}. State it, "
            f"0 if they do: files: {{{others[0].label!r}: {{source: {{offset: SECONDS}}}}, '*': {{}}}}",
        )  # fmt: skip
        doubts = (*clocks, *(q for stream in (lead, *others) for q in stream.questions))
        series = joined(lead, others)
        series = replace(series, questions=doubts, notes=(*notes, *series.notes))
        made.append((series, maps[id(lead)].model_copy(update={"columns": columns})))
    return made


def _there(series: Series, name: Name | tuple[Name, Name, Name], point: bool) -> bool:
    try:
        if isinstance(name, tuple):
            return all(_has(series, one) for one in name)
        return bool(axes_of(series, name, "")) if point and isinstance(name, str) else _has(series, name)
    except ConfigError:
        return False


# ------------------------------------------------------------------ tables in one file
def of_one_file(tables: Sequence[Series]) -> Series:
    """Tables that stand below each other in one file, joined in time; raises ConfigError where one has no times."""
    streams = [stream_of(table, f"table {k}") for k, table in enumerate(tables, 1)]
    lead = max(streams, key=lambda s: (_holds_places(s.series), len(s.series)))
    made = joined(lead, [s for s in streams if s is not lead])
    return replace(made, notes=(f"{len(tables)} tables below each other are joined in time", *made.notes))


def _holds_places(series: Series) -> bool:
    return bool(triples([heading(n, series.units.get(n, "")) for n in series.numbers]))


def of_rows_in_turn(series: Series, missing: Sequence[str | float]) -> Series:
    """Join, in time, columns that are filled in different rows to the rows that hold places; a table of times, names and values
    gets a column for each name first. Any other series is returned as it is, without numbers that stand for `missing` values."""
    series = _by_name(cleaned(series, missing))
    groups = list(_in_turn(series))
    if not groups:
        return series
    times = time_heading(series)
    row_times = _seconds(series, Column(column=times))[0] if times else np.arange(len(series), dtype=np.float64)
    in_groups = {name for _, names in groups for name in names}
    lead = max(range(len(groups)), key=lambda k: (_holds_places(_part(series, *groups[k])), len(groups[k][0])))
    streams = []
    for k, (rows, names) in enumerate(groups):
        names_kept = [n for n in series.names if n in names or (k == lead and n not in in_groups)]
        streams.append(Stream(_part(series, rows, names_kept), ", ".join(names[:3]), row_times[rows]))
    table = joined(streams[lead], [s for k, s in enumerate(streams) if k != lead])
    note = (
        f"{len(streams)} groups of columns have values in separate rows ({'; '.join(s.label for s in streams)}): joined in "
        f"{'time' if times else 'the order of rows'} to the {len(table)} rows of {streams[lead].label}"
    )
    said = (f"column {n!r}: {text}" for n in series.absent if (text := series.read_as_missing(n)))
    return replace(table, columns={n: table.columns[n] for n in series.names}, notes=(note, *said, *series.notes))


def _by_name(series: Series) -> Series:
    """Turn a table of times, names and values into one with a column for each name; return any other as it is."""
    times = time_heading(series)
    values = [n for n in series.numbers if n != times]
    units = next((n for n, w in series.words.items() if all(map(is_unit, set(w.tolist())))), None)
    names = [n for n in series.words if n != units]
    if times is None or len(values) != 1 or len(names) != 1:
        return series
    row_names, row_values = series.words[names[0]], series.numbers[values[0]]
    names_found = [n for n in dict.fromkeys(row_names.tolist()) if n]
    if not 1 < len(names_found) <= MOST_STREAMS or (row_names[1:] != row_names[:-1]).mean() < TURNS or set(names_found) & {times}:
        return series
    columns = {times: series.numbers[times]} | {n: np.where(row_names == n, row_values, np.nan) for n in names_found}
    stated = {n: str(series.words[units][np.argmax(row_names == n)]) for n in names_found} if units else {}
    return replace(series, columns=columns, units={**series.units, **stated})


def _part(series: Series, rows: Ints, names: Sequence[str]) -> Series:
    """Some rows and columns."""
    strange = {
        n: replace(s, row=int(np.argmax(np.isin(s.column[rows], s.words))), column=s.column[rows])
        for n, s in series.strange.items()
        if n in names
    }
    lines = None if series.lines is None else series.lines[rows]
    return replace(series, columns={n: series.columns[n][rows] for n in names}, lines=lines, strange=strange, absent={}, notes=())


def _in_turn(series: Series) -> Iterator[tuple[Ints, list[str]]]:
    """Rows and filled columns of each stream where the rows of several stand in one table in turn; else nothing."""
    masks: list[tuple[Mask, list[str]]] = []
    for name, values in series.numbers.items():
        filled = np.isfinite(values)
        if name in series.strange or filled.mean() > OWN_ROWS:
            continue
        for k, (mask, names) in enumerate(masks):
            if (mask & filled).sum() > 0.5 * min(mask.sum(), filled.sum()):
                masks[k] = (mask | filled, [*names, name])
                break
        else:
            if len(masks) > MOST_STREAMS:
                return
            masks.append((filled, [name]))
    if not 1 < len(masks) <= MOST_STREAMS:
        return
    filled_rows = np.array([mask for mask, _ in masks])
    if any((a & b).sum() > TOGETHER * min(a.sum(), b.sum()) for i, a in enumerate(filled_rows) for b in filled_rows[:i]):
        return
    turns = np.argmax(filled_rows, axis=0)[filled_rows.any(axis=0)]
    if sum(a != b for a, b in pairwise(turns.tolist())) < TURNS * len(turns) or len(turns) < OWN_ROWS * len(series):
        return
    yield from ((np.flatnonzero(mask), names) for mask, names in masks)


# ------------------------------------------------------------------ whether clocks agree
def lag(t: Array, pressures: Array, tip: Array) -> float | None:
    """s by which the tip (n, 3) follows the pressures (n, k): the lag at which their speeds correlate clearly best, or None."""
    from scipy.signal import correlate  # only files that are joined wait for it

    span, period_s = float(np.ptp(t)) if len(t) else 0.0, period(t)
    if period_s <= 0 or span < 20 * period_s:
        return None
    grid = np.linspace(t[0], t[-1], int(min(span / period_s, 20_000)) + 1)
    activity = []
    for values in (pressures, tip):
        known = np.isfinite(values).all(axis=1)
        if known.sum() < 10:
            return None
        interpolated = np.column_stack([np.interp(grid, t[known], column) for column in values[known].T])
        speed = np.linalg.norm(np.diff(interpolated, axis=0), axis=1)
        activity.append((speed - speed.mean()) / max(float(speed.std()), 1e-300))
    step, size = float(grid[1] - grid[0]), len(activity[0])
    agreement = correlate(activity[1], activity[0], method="fft") / size
    lags = np.arange(1 - size, size)
    in_range = np.abs(lags) * step <= min(LONGEST_LAG, span / 4)
    lags, agreement = lags[in_range], agreement[in_range]
    best = int(np.argmax(agreement))
    at_once = float(agreement[np.abs(lags) <= 1].max())  # within a step of the grid
    best_lag = float(lags[best]) * step
    clear = agreement[best] > CLEAR and agreement[best] > CLEARER * at_once
    return best_lag if clear and abs(best_lag) > max(LEAST_LAG, 3 * period_s) else None
