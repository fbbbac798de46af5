"""Files and their map as one table of trials."""

from __future__ import annotations

import fnmatch
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress, pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from diagnosis.arrays import rows_by
from diagnosis.data import case as measured
from diagnosis.data.levels import MASS_GAP, OF_RANGE, REST, levels, pressure_gap
from diagnosis.data.plausible import LOWEST_USUAL
from diagnosis.data.shift import shifted
from diagnosis.errors import BadCase
from diagnosis.remedies import of_trials
from model.actuators import Words
from model.arrays import Array, Ints, Mask
from model.robot import Robot
from recordings.ambient import AMBIENT
from recordings.errors import RecordingError
from recordings.states.rules import BRANCHES
from recordings.table_file import checked
from recordings.trials import AXES, HEAD, TAIL, TEXTS, TIP, Table, marker_columns, pressure_columns

from ..files.config import ConfigError
from ..files.jumps import Jump, at_rest, jumps, loads, unusable, without
from ..files.map_file import Frame, Map, Name, named, units_for
from .clock import BETWEEN_RUNS, EPOCH
from .columns import DAY
from .formats import KNOWN, RECORDING, read
from .headings import ASKED_FOR, heading, quantity, tendon
from .joining import in_time, lag
from .places import at_rest_by_model, other_order, strays, turn_off
from .quantities import FURTHER, FileRows, orientation_columns, quantities_of
from .series import FRAME, Series
from .trials import Cut, cuts, trials_of_rows

FORCES = ("force_x", "force_y", "force_z")
AXES_UNSTATED = (
    "force_x, force_y, force_z are taken along the base's axes, and `frame` does not turn them: if they are along the file's "
    "axes, write `forces: file`; else `forces: base`"
)
MOST_JUMPS = 3
"""Jumps of places that are told one by one."""
FOLLOWS, FEW_SETTINGS = 0.9, 4
"""Share of a column's variance that the pressures account for in no table of mountings, and values of which there are fewer."""
LEAST_ACROSS = 1e-3
"""Share of the length by which tips are off a line, below which they show no turn about it."""
ZERO_SD, OF_GAUGE = 5.0, (0.01, 0.1)
"""Standard deviations at rest, and shares of the pressures' range, from and up to which a resting pressure is a gauge's zero."""
MOST_STRAY = 0.2
"""Share of a state's rows that may hold a place elsewhere; of more, none is taken for the right one."""
MOST_TRIALS = 0.9
"""Trials per state from which a column of trials is asked about: it changes with nearly every row."""
MOST_LOADS = 10
"""Values of a column of masses or forces that were set rather than read."""
SAME_ROLL = 2.0
"""deg of roll within which a mounting is the same."""


@dataclass(frozen=True)
class Imported:
    """A table, and what it was made from."""

    table: Table
    files: tuple[tuple[Series, FileRows, tuple[Cut, ...]], ...]
    notes: tuple[str, ...]
    """What was left out, or taken for granted."""
    unread: tuple[str, ...]
    """Files that cannot be read, and why; `notes` has them, too."""
    questions: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    """Where each state but those of stiffness trials, which come last, begins in the files."""


def _with(table: Table, names: Sequence[str], values: Array) -> Table:
    """The same states with columns (n, k) in place of their own."""
    return table.replaced(dict(zip(names, values.T, strict=True)))


def _turns(table: Table) -> tuple[scipy.spatial.transform.Rotation, Mask]:
    """Orientations of the tip, none where there is none, and (n,) where there is one."""
    turned = np.asarray(np.isfinite(table.orientation).all(axis=1))
    kept = np.where(turned[:, None], table.orientation, [1.0, 0.0, 0.0, 0.0])
    return scipy.spatial.transform.Rotation.from_quat(kept, scalar_first=True), turned


def _levered(table: Table, lever: Array) -> Table:
    """The same with the tip moved back by a lever (3,) m that turns with it."""
    return _with(table, TIP, table.tip - _turns(table)[0].apply(lever))


def _placed(table: Table, tip: Array, markers: Array) -> Table:
    """The same with other places, (n, 3) and (n, k, 3) m."""
    return _with(table, sum(marker_columns(markers.shape[1]), TIP), np.hstack([tip, markers.reshape(len(table), -1)]))


def files_of(given: Sequence[Path], wanted: Map) -> list[tuple[Path, Map]]:
    """Files to read, with the map of each: the files of `given`, and of its folders those that fit a pattern of `files` (without
    patterns: all of a known kind), run2 before run10. Raises ConfigError."""
    files: list[tuple[Path, Map]] = []
    for path in given:
        inside = sorted((p for p in path.iterdir() if p.is_file()), key=_counted) if path.is_dir() else [path]
        if path.is_dir() and not wanted.files:
            inside = [p for p in inside if p.suffix.lower() in KNOWN]
        for file in inside:
            fitting = [v for k, v in wanted.files.items() if fnmatch.fnmatch(file.name, k)]
            if wanted.files and not fitting and file.exists():  # the reader says of one that is missing
                if path.is_dir():
                    continue
                patterns = ", ".join(wanted.files)
                raise ConfigError(
                    f"{file}: no pattern of `files` in the map fits; there are {patterns}; add {file.name!r} or '*'"
                )
            made = wanted.of_file(fitting)
            if wrong := made.wrong_places():
                raise ConfigError(f"{file}: the map of this file (files): {'; '.join(wrong)}")
            files.append((file, made))
    if not files:
        raise ConfigError(f"{', '.join(map(str, given))}: contains no file named in the map")
    return files


def _counted(path: Path) -> list[tuple[int, str]]:
    """A key by which run2 comes before run10."""
    return [(int(part[:18]), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", path.name.casefold())]


def _recordings(files: Sequence[tuple[Path, Map]]) -> list[tuple[tuple[Path, ...], Map]]:
    """Files as they are read: recordings in the order of time, the parts of each together."""
    bags = [(path, own) for path, own in files if path.suffix.lower() == RECORDING]
    others = [((path,), own) for path, own in files if path.suffix.lower() != RECORDING]
    if len(bags) < 2:
        return [*others, *(((path,), own) for path, own in bags)]
    from .recording_topics import together

    return [*others, *together(bags)]


def _read(
    given: Sequence[Path], wanted: Map, drive: Words, progress: Callable[[float, float], None]
) -> tuple[list[tuple[Series, FileRows, Map]], list[str], list[str]]:
    """Files with rows and maps, in order of time; notes; files that cannot be read. Raises ConfigError if a named one fails."""
    files, made, read_files = _recordings(files_of(given, wanted)), [], []
    failed: list[ConfigError] = []
    for number, (parts, own_map) in enumerate(files):
        progress(number, len(files))
        try:
            series = read(parts, own_map.source, named(own_map))
        except ConfigError as e:
            if set(parts) & set(given) or wanted.files:  # asked for by name
                raise
            failed.append(e)
            continue
        read_files.append((series, own_map))
    if not read_files:
        raise failed[0]
    for series, own_map in (runs := in_time(read_files)):
        q = quantities_of(series, own_map, drive)
        late = lag(q.t, q.table.pressures, q.table.tip) if len(runs) < len(read_files) else None
        questions = [*series.questions, *q.questions]
        if late is not None:
            when = f"{abs(late):.3g} s {'after' if late > 0 else 'before'} the pressures change"
            questions.append(
                f"the tip moves {when}: do the clocks of these files differ? If so, add {late:.3g} to the file of the pressures' "
                "offset: files: {FILE: {source: {offset: ..}}}"
            )
        made.append((series, replace(q, questions=tuple(questions)), own_map))
    files_of_note: dict[str, list[str]] = {}
    for series, q, _ in made:
        for text in (*series.notes, *q.notes):
            files_of_note.setdefault(text, []).append(series.path.name)
    unread = [f"not read: {e}" for e in failed]
    notes = [*unread] + [f"{', '.join(names)}: {text}" for text, names in files_of_note.items()]
    ordered = sorted(made, key=lambda file: float(file[1].t[0]))
    if [s.path for s, _, _ in ordered] != [s.path for s, _, _ in made]:
        first, last = float(ordered[0][1].t[0]), float(ordered[-1][1].t[0])
        apart = all(float(np.nanmax(a.t)) < float(b.t[0]) for (_, a, _), (_, b, _) in pairwise(ordered))
        names = ", ".join(s.path.name for s, _, _ in ordered)
        if first >= EPOCH[0] or (apart and last - first < DAY / 2):
            made = ordered
            notes.append(f"files are read in the order of their times: {names}")
        elif apart:
            notes.append(
                f"files are read in the order of their names; by their times the order would be (midnight aside): {names}"
            )
    return made, notes, unread


def imported(
    given: Sequence[Path], wanted: Map, robot: Robot, progress: Callable[[float, float], None] = lambda done, of: None
) -> Imported:
    """Read files by a map, cut their rows into states and put these into the robot's frame; raises ConfigError."""
    read_files, notes, unread = _read(given, wanted, robot.actuators.words, progress)
    return conclude(read_files, wanted, robot, notes, unread)


def conclude(
    every: Sequence[tuple[Series, FileRows, Map]], wanted: Map, robot: Robot, notes: list[str], unread: Sequence[str] = ()
) -> Imported:
    """The states of files (columns as read, rows in SI, own map) as one table in the robot's frame; raises ConfigError.

    Per file: times made to follow those of the file before, rows cut into states and numbered in groups, one per trial. Then of
    all: orientation and place of the straight robot, numbers of trials, checks, stiffness. `notes` are added to."""
    straight = _straight_point(robot)
    read_files, parts, rows, places = [], list[Table](), list[tuple[int, int]](), list[str]()
    group, start, origin = 0, 0.0, 0.0  # first trial of a file; s: end of the file before, begin of the first with dates
    for number, (series, q, own_map) in enumerate(every):
        path = series.path
        absolute = bool(q.t[0] >= EPOCH[0])
        origin = float(q.t[0]) if not number and absolute else origin
        q = q.with_columns({"t": q.t - (origin if absolute else 0.0)})
        if wanted.straight == "first row":
            q = replace(q, table=_mounted(q.table, robot, wanted.straight, wanted.sensor))
        if number and ("t" not in own_map.columns and not absolute or q.t[0] < start):
            q = q.with_columns({"t": q.t - q.t[0] + start + BETWEEN_RUNS})
        trial, doubts = trials_of_rows(series, q, own_map, robot.actuators.words)
        notes += [*doubts, *_unused_loads(series, own_map)]
        pushed = [q.table.values[name] for name in FORCES if name in q.table.values]
        own_cuts = cuts(wanted.states, q.t, q.table.pressures, trial, np.column_stack(pushed) if pushed else None)
        trial_per_state = wanted.trials.begin == "state" and "trial" not in q.table.values
        numbers = range(len(own_cuts)) if trial_per_state else [int(trial[c.rows][0]) for c in own_cuts]
        q, torn = _without_strays(q, own_cuts, float(straight[2]), series, notes)
        whole = [(group + k, c) for k, c in zip(numbers, own_cuts, strict=True) if c not in torn]
        seen, driven = q.seen, q.driven
        count = sum(seen[c.rows].any() for _, c in whole)
        if count < len(whole) < len(q.t):  # states of one row each: `quantities_of` has named the rows
            notes.append(f"{path.name}: {len(whole) - count} of {len(whole)} states have no tip or pressure and are left out")
        if not count:
            raise ConfigError(f"{path}: no state was found; {_why(wanted, q, robot.actuators.words)}")
        kept = [(k, c) for k, c in whole if driven[c.rows].any()]
        parts.append(_states(q, kept))
        rows += [(number, c.rows.start) for _, c in kept]
        places += [f"{path.name}, {series.place(int(q.row[c.rows.start]))}" for _, c in kept]
        group += max(numbers) + 1
        start = float(np.nanmax(q.t))
        read_files.append((series, q, tuple(own_cuts)))
    states = Table.stacked(parts)
    gone, said = unusable(states, robot, places.__getitem__, written_twice=True)
    notes += said
    states, kept_states = without([(state, 0) for state in gone], states)
    rows, places = list(compress(rows, kept_states)), list(compress(places, kept_states))
    named = _with_branches(states)
    states, read = named.take(named.with_tip), np.flatnonzero(named.with_tip)
    found = list(jumps(states, float(straight[2]), robot.actuators.words))
    notes += _jump_notes(found, [places[k] for k in read])
    states, kept_states = without([(j.state, body) for j in found if j.against for body in j.bodies], states)
    read = read[kept_states]
    if wanted.straight in ("first state", "at rest"):
        states = _mounted(states, robot, wanted.straight, wanted.sensor)
    elif any(wanted.sensor) and wanted.straight == "as recorded":
        states = _levered(states, np.array(wanted.sensor))
    rows, places = [rows[k] for k in read], [places[k] for k in read]
    if wanted.forces != "base":
        turn, turned = _turns(states)
        if wanted.forces == "tip" and not turned.all():
            t = float(states.get("t")[~turned][0])
            raise ConfigError(f"forces: the state at t = {t:.3f} s has no orientation, which its force needs")
        turn = turn if wanted.forces == "tip" else turn.identity()
        states = _with(states, FORCES, turn.apply(states.tip_force @ wanted.frame.matrix.T))
    elif "forces" not in wanted.model_fields_set and wanted.frame != Frame() and states.tip_force.any():
        notes.append(AXES_UNSTATED)
    counted = {n: c.column for _, _, own_map in every for n, c in own_map.columns.items() if n in ("trial", "repeat")}
    table = _numbered(states, counted, notes, partial(_unmapped, rows, every))
    orders = [f"{series.path.name}: {q.order}" for series, q, _ in every if q.order]
    notes += *_contradictions(table, float(straight[2]), orders), *orders
    _demand_mounted(table)
    if wanted.stiffness is not None:
        file, forces = np.array([file for file, _ in rows]), [q.constants.get("force") for _, q, _ in every]
        table = _with_pushes(table, file, forces, wanted)
    try:
        table = checked({name: table[name] for name in table.columns}, table.place, limits=False)
        unit = min((q.unit for _, q, _ in every if q.unit is not None), default=None)
        base, *others = {q.base for _, q, _ in every}
        table = replace(table, mapped=replace(wanted.mapped(unit, every[0][0].form == FRAME), base=None if others else base))
    except RecordingError as e:
        raise ConfigError(f"the map makes no valid table: {e}") from e
    trials, remedy = len(np.unique(table.trial)), of_trials(table)
    if "trial" in counted and trials > MOST_TRIALS * len(table) and "rest" in remedy:
        about = f"columns.trial: {trials} trials in {len(table)} states, though the robot rests in between"
        notes.append(f"{about}: does it count something else? If so, {remedy}")
    notes += map(str, shifted(table, robot.length, places.__getitem__))
    with suppress(BadCase):  # which is said where the table is used
        notes += [str(f) for f in measured.states(measured.Case(robot, table))[1] if f.code == "repeated_within_trials"]
    points = ((q, np.concatenate([q.table.tip[:, None], q.table.markers], axis=1)) for _, q, _ in every)
    resting = (np.ma.masked_invalid(own[at_rest(q.table.pressures)]).mean(axis=0) for q, own in points)
    rests = [(series.path.name, rest.filled(np.nan)) for (series, _, _), rest in zip(every, resting, strict=True)]
    questions_of_order = other_order(rests, float(straight[2]), moved=wanted.straight != "as recorded")
    questions = [*questions_of_order, *(f"{series.path.name}, {text}" for series, q, _ in every for text in q.questions)]
    if robot.chambers is not None:
        questions += _ambient(table, wanted, robot.actuators.words)
    across = float(np.linalg.norm(np.linalg.svd(states.tip, compute_uv=False)[1:])) / np.sqrt(len(states.tip))
    if across < LEAST_ACROSS * robot.length:
        line = f"the tip stays within {1e3 * across:.2g} mm (rms) of one line through the base: these states do not determine "
        remedy = "the frame's turn about this line; add some in which one {actuator} is {inflated}"
        questions.append(robot.actuators.words.fill(line + remedy))
    asked = tuple(q for q in questions if q not in wanted.confirmed)
    return Imported(table, tuple(read_files), tuple(notes), tuple(unread), asked, tuple(places))


def _unused_loads(series: Series, wanted: Map) -> Iterator[str]:
    """Name columns of masses and forces that were set, and that the map does not use, with what to write."""
    used = named(wanted)
    for name in () if used is None else series.numbers.keys() - used:
        of, set_to = heading(name, series.units.get(name, "")), np.unique(np.nan_to_num(series.numbers[name]))
        key = "tip_mass" if quantity(of) == "tip_mass" or of.kind == "kg" else "force_z" if of.kind == "N" else ""
        stated = key in {*wanted.columns, *wanted.constants} or of.says(ASKED_FOR) or tendon(of) is not None
        if key and not stated and len(set_to) <= MOST_LOADS and set_to.any():
            unit, axis = f", unit: {of.unit}" * bool(of.unit), " (or force_x, force_y)" * (key != "tip_mass")
            yield f"column {name!r} is not used: if it loads the tip, write `{key}: {{column: {name}{unit}}}`{axis} under columns"


def _ambient(states: Table, wanted: Map, words: Words) -> Iterator[str]:
    """Ask, with the `zero` to write, whether all chambers read the room's pressure at rest, or some their gauge's zero."""
    column, unit, below = wanted.columns.get("p1"), states.mapped.unit if states.mapped else None, wanted.trials.below
    resting = states.pressures[at_rest(states.pressures)]
    if column is None or column.zero == "first" or not len(resting) or np.ptp(states.pressures) <= below:
        return
    level, each, size = float(np.median(resting)), np.median(resting, axis=0), units_for("p1", words).get(unit or "", 1.0)
    if abs(level) > below and (np.abs(each - level) < below).all():
        zero = column.zero if isinstance(column.zero, float) else 0.0
        zero += (level + AMBIENT * (column.zero == "absolute")) / column.scale / size
        yield (
            f"all {words.actuators} read {words.number(level, 1)} {words.unit} at rest, which is then not found as rest: is this "
            f"the pressure of the room? If so, write `zero: {zero:.4g}` ({unit or 'Pa'}) under columns.p1 .."
        )
        return
    noise, (low, high) = resting.std(axis=0), np.array(OF_GAUGE) * np.ptp(states.pressures)
    constant, zeros = (noise > 0) & (np.abs(each) > ZERO_SD * noise), dict[str, str]()
    for k in np.flatnonzero(constant).tolist():
        if (own := wanted.columns.get(f"p{k + 1}")) is not None and own.zero == "none":
            zeros[f"p{k + 1}"] = f"{each[k] / own.scale / size:.3g}"
    if len(resting) >= FEW_SETTINGS and zeros and low < np.abs(each[constant]).max() < high:
        remedies = ", ".join(f"`zero: {zero}` under columns.{name}" for name, zero in zeros.items())
        yield (
            f"at rest {', '.join(zeros)} read {', '.join(zeros.values())} {unit or 'Pa'}, constant within their noise: are these "
            f"the zeros of gauges? If so, write {remedies}"
        )


def _contradictions(states: Table, length: float, orders: Sequence[str]) -> Iterator[str]:
    """Ask about orientations that do not fit places (`length`: m of the body), and mountings that vary with the pressures. Raises
    ConfigError where `orders` name another order of the orientation's columns that fits them."""
    if (off := turn_off(states, length)) is not None:
        if orders:
            raise ConfigError(*orders)
        yield (
            f"the turn of the tip does not fit its place (agreement of directions {round(off[0], 2) + 0.0:.2f} of 1, and the tip "
            f"moves {off[1]:.2g} times as far as the end of an arc that turns as much): check orientation (columns, order, "
            "unit), the frame, and columns x, y, z"
        )
    for name, same in (("roll_deg", SAME_ROLL), ("tip_mass", MASS_GAP)):
        values, terms = states.get(name, 0.0), np.column_stack([states.pressures, np.ones(len(states))])
        if len(states) < 3 * terms.shape[1] or len(np.unique(levels(values, same))) < FEW_SETTINGS:
            continue
        missed = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
        if (share := 1 - missed.var() / values.var()) > FOLLOWS:
            yield (
                f"columns.{name}: the pressures account for {100 * share:.0f} % of its changes, but a mounting does not change "
                "with pressure: is this column another quantity?"
            )
    within = np.diff(states.trial) == 0
    changed = int((np.abs(np.diff(states.get("tip_mass", 0.0)))[within] > MASS_GAP).sum())
    if changed > within.sum() / 2:
        yield f"tip_mass changes {changed} times between states of one trial: is this column really a mass at the tip?"


def _demand_mounted(states: Table) -> None:
    """Raise ConfigError where the turn of the body in its mount changes within a trial."""
    roll = states.get("roll_deg")
    for rows in rows_by(states.trial):
        low, high = np.fmin.reduce(roll[rows]), np.fmax.reduce(roll[rows])  # NaN where no state has one
        if high - low > SAME_ROLL:
            raise ConfigError(
                f"columns.roll_deg: from {low:.4g} to {high:.4g} deg within trial {states.trial[rows[0]]}, but the body does "
                "not turn in its mount. If this column is an angle of the tip, write it under orientation (columns, order, unit)"
            )


def _why(wanted: Map, q: FileRows, words: Words) -> str:
    if wanted.states.plateaus is None:
        return "its rows have no tip or pressure"
    if q.unit == "" and np.nanmax(q.table.pressures) < LOWEST_USUAL:
        unit = f"write 'p1 [{words.unit}]', or `unit: {words.unit}` under columns.p1 .."
        return f"nothing says the unit of the {words.pressures}, which were read as Pa: {unit}"
    if (apart := float(np.nanmax(q.table.pressures) - np.nanmin(q.table.pressures))) < wanted.states.plateaus.steady:
        near = f"{words.number(apart, 3)} {words.unit}, read as {q.unit}"
        return f"all {words.pressures} lie within {near}: check their unit, and states.plateaus.steady"
    jump = float(np.nanmedian(np.abs(np.diff(q.table.pressures, axis=0)).max(axis=1))) if len(q.t) > 1 else 0.0
    band, change = (f"{words.number(size, 3)} {words.unit}" for size in (wanted.states.plateaus.steady, jump))
    return (
        f"no {words.pressure}, read as {q.unit or 'Pa'}, stands within {band} for {wanted.states.plateaus.shortest:g} s (from "
        f"row to row the median change is {change}): check unit, states.plateaus"
    )


def _without_strays(
    q: FileRows, states: Sequence[Cut], length: float, series: Series, notes: list[str]
) -> tuple[FileRows, list[Cut]]:
    """Rows without places (NaN) that jump away within a state and back, and the states of which most rows do; noted."""
    tip, markers, torn, stray_count, first = q.table.tip, q.table.markers, [], 0, None
    for cut in states:
        of_state = cut.rows
        stray = strays(tip[of_state], markers[of_state], length)
        if not stray.any():
            continue
        first = int(np.argmax(np.diff(stray))) + 1 + of_state.start if first is None else first
        rows = np.flatnonzero(stray) + of_state.start
        if len(rows) > MOST_STRAY * len(tip[of_state]):
            torn.append(cut)
        else:
            tip[rows], markers[rows], stray_count = np.nan, np.nan, stray_count + len(rows)
    if first is not None:
        notes.append(
            f"{series.path.name}, {series.place(int(q.row[first]))}: a marker jumps within a state: was it confused with "
            f"another? {stray_count} rows and {len(torn)} states are left out"
        )
    return replace(q, table=_placed(q.table, tip, markers)), torn


def _jump_notes(found: Sequence[Jump], places: Sequence[str]) -> Iterator[str]:
    """What to ask about points that moved farther than the body can; `places`: where each state begins in the files."""
    for number, jump in enumerate(found[: MOST_JUMPS + 1]):
        place = places[jump.state]
        if number == MOST_JUMPS:
            yield f"{place}: the first of {len(found) - MOST_JUMPS} further points that move farther than the body can"
            return
        doubt = "was it another marker, or was something moved?" if len(jump.bodies) == 1 else "were they confused?"
        remedy = "put these rows into a separate file and name its columns under files: {PATTERN: {columns: ..}}"
        asked = f": {doubt} If so, {remedy}, or leave them out" * (not jump.against)
        yield f"{place}: {jump.text}{asked}"


# ------------------------------------------------------------------ frames
def _straight_point(robot: Robot) -> Array:
    """(3,) m: the end of the straight body, or the point beside it that robot.yaml states as tracked (marker_offset)."""
    stated = robot.effects.get("marker_offset", {})
    return np.array([stated[a].value if a in stated else 0.0 for a in "xyz"]) + [0.0, 0.0, robot.length]


def _mounted(
    table: Table, robot: Robot, straight: Literal["first row", "first state", "at rest"], sensor: Sequence[float]
) -> Table:
    """States moved so that those with the lowest pressures (the first, or the mean of all) or the first row are where the robot
    then stands; a marker not seen there stays where it is."""
    level = np.round(np.abs(table.pressures).max(axis=1) / REST)
    resting = np.flatnonzero(level == level.min())
    turns, turned = _turns(table)
    if straight != "at rest":
        resting = np.arange(1) if straight == "first row" else resting[:1]
        tip, turn = _straight_point(robot)[None], turns[:0].identity(1)
        places = robot.marker_places(np.radians(table.get("roll_deg", 0.0)[resting]))
    else:
        beginning = resting[np.diff(table.trial, prepend=-1)[resting] != 0]
        resting = beginning if len(beginning) else resting
        tip, turn, places = at_rest_by_model(robot, table.take(resting))
    known = turned[resting]
    mount = (turn[known].inv() * turns[resting[known]]).mean().inv() if known.any() else turns.identity()
    table = _levered(table.replaced(orientation_columns(turns * mount, turned & known.any())), np.array(sensor))
    shift = np.mean(tip - table.tip[resting], axis=0)
    markers, marker_shift = table.markers, np.zeros(table.markers.shape[1:])
    both = min(len(marker_shift), places.shape[1])  # of the file and of robot.yaml
    marker_shift[:both] = np.ma.masked_invalid(places[:, :both] - markers[resting, :both]).mean(axis=0).filled(0.0)
    return _placed(table, table.tip + shift, markers + marker_shift)


# ------------------------------------------------------------------ states
def _states(q: FileRows, kept: Sequence[tuple[int, Cut]]) -> Table:
    """One row per cut of a file: means, standard deviations (sd_..), the last word; its group is `trial`. Raises ConfigError."""
    import pandas as pd

    n, cut_rows = len(kept), [np.arange(cut.rows.start, cut.rows.stop) for _, cut in kept]
    q_seen, q_driven = q.seen, q.driven
    seen = [of_cut[(q_seen if q_seen[of_cut].any() else q_driven)[of_cut]] for of_cut in cut_rows]
    turn, turned = _turns(q.table)
    driven, markers = pressure_columns(q.table.pressures.shape[1]), marker_columns(q.table.markers.shape[1])
    every, words = pd.DataFrame({**q.table.values}), [name for name in q.table.values if name in TEXTS]
    every[words] = every[words].where(every[words] != "")
    for axes in map(list, (TIP, *markers)):  # what lacks an axis was not seen
        every.loc[every[axes].isna().any(axis=1), axes] = np.nan
    of_cuts, of_seen = (
        every.take(np.concatenate(own)).groupby(np.repeat(np.arange(n), [*map(len, own)])) for own in (cut_rows, seen)
    )
    means = of_cuts.mean(numeric_only=True)
    of_state = of_seen[["t", *driven, *TIP]].mean().join(means[[*sum(markers, ())]])
    filled = of_seen[[*driven, *TIP]].std().add_prefix("sd_")
    at_rest = np.array([cut.at_rest for _, cut in kept])  # windows at rest have no pressure, whatever was read
    of_state.loc[at_rest, [*driven]], filled.loc[at_rest, [f"sd_{name}" for name in driven]] = 0.0, np.nan
    for further in (means, of_cuts[words].last(), pd.DataFrame({**q.constants}, index=range(n))):
        filled = filled.combine_first(further)  # where a column has no value, that of all rows stays
    columns: dict[str, NDArray[Any]] = {
        str(name): column.fillna("").to_numpy(np.str_) if name in TEXTS else column.to_numpy() for name, column in filled.items()
    }
    several = np.array([len(rows) > 1 for rows in seen])
    held = columns.pop("hold", np.full(n, np.nan))
    columns["hold"] = np.where(np.isnan(held) & several, [cut.since for _, cut in kept], held)
    if wrong := sorted(set(columns.get("branch", np.array([""])).tolist()) - {"", *BRANCHES}):
        raise ConfigError(
            f"{q.path}: branch {wrong[0][:40]!r} is not one of {', '.join(BRANCHES)}; translate it with columns.branch.values"
        )
    columns = {"spine_length": np.zeros(n), "protocol": np.full(n, "bending"), "branch": np.full(n, "")} | {
        name: column for name, column in columns.items()
        if name not in ("force", "deflection") and (name in (*HEAD, *TAIL) or FURTHER.match(name))
    }  # fmt: skip
    columns |= {"trial": np.array([group for group, _ in kept]), "step": np.zeros(n, np.int64)}
    columns |= {str(name): mean.to_numpy() for name, mean in of_state.items()}
    columns["repeat"] = np.nan_to_num(columns.get("repeat", np.zeros(n))).astype(np.int64)
    if "clipped" in columns:
        columns["clipped"] = np.where(np.nan_to_num(columns["clipped"]) != 0, 1.0, np.nan)
    oriented = [rows[turned[rows]] for rows in seen]
    turns = turn[[int(rows[0]) if len(rows) else 0 for rows in oriented]]
    for k in [k for k, rows in enumerate(oriented) if len(rows) > 1]:
        turns[k] = turn[oriented[k]].mean()
    return Table(columns | orientation_columns(turns, np.array([len(rows) > 0 for rows in oriented])))


def _unmapped(rows: Sequence[tuple[int, int]], files: Sequence[tuple[Series, FileRows, Map]]) -> dict[str, NDArray[np.str_]]:
    """Cells (n,), one for each state (file, first row), of columns that all files have and their maps do not use."""
    names = [(series.names, named(own_map)) for series, _, own_map in files]
    free = [set[str]() if used is None else {*of_file} - used for of_file, used in names]
    return {
        name: np.array([str(files[file][0].columns[name][files[file][1].row[row]]) for file, row in rows])
        for name in names[0][0] if all(name in own for own in free)
    }  # fmt: skip


def _with_branches(states: Table) -> Table:
    """States with the branch of each that states none: whether its trial's highest pressure, also without a tip, fell last."""
    highest, branch = states.pressures.max(axis=1), states.get("branch").astype(object)
    for of_trial in rows_by(states.trial):
        level, falls, gap = 0.0, False, max(pressure_gap(states), OF_RANGE * float(highest[of_trial].max()))
        for state in of_trial.tolist():
            if abs(highest[state] - level) > gap:
                level, falls = highest[state], highest[state] < level
            branch[state] = branch[state] or ("unload" if falls else "load")
    return states.replaced({"branch": branch.astype(np.str_)})


def _numbered(
    states: Table, counted: Mapping[str, Name], notes: list[str], unmapped: Callable[[], Mapping[str, NDArray[np.str_]]]
) -> Table:
    """Number trials, steps and repeats (of the same inflation), unless a column of `counted` does."""
    gap, trial = pressure_gap(states), np.unique(states.trial, return_inverse=True)[1]
    step, repeat = np.zeros(len(states), np.int64), states.get("repeat").copy()
    repeats_of_kind: dict[tuple[int, ...], list[tuple[int, int]]] = {}  # (number of the trial, its repeat)
    again, of_trials = [], rows_by(trial)
    first = np.array([rows[0] for rows in of_trials])
    inflated = [levels(chamber, gap) for chamber in np.maximum.reduceat(states.pressures, first, axis=0).T]
    kinds = np.column_stack([*inflated, loads(states.take(first))]).tolist()  # those that repeat each other are of one
    for k, (of_trial, kind) in enumerate(zip(of_trials, map(tuple, kinds), strict=True)):
        earlier = repeats_of_kind.setdefault(kind, [])
        stated = Counter(repeat[of_trial][repeat[of_trial] != 0].tolist())
        usual = stated.most_common(1)[0][0] if stated else 1 + len(earlier)
        again += [(other, k + 1, usual) for other, same in earlier if same == usual and stated and len(of_trial) > 1]
        earlier.append((k + 1, usual))
        step[of_trial] = 1 + np.arange(len(of_trial))
        repeat[of_trial] = np.where((repeat[of_trial] != 0) & ("trial" in counted), repeat[of_trial], usual)
    if again and "repeat" in counted:
        pairs = [(of_trials[a - 1], of_trials[b - 1]) for a, b, _ in again]
        differing = [name for name, cells in unmapped().items() if _sets_apart(cells, pairs)]
        remedy = "correct it, or leave out columns.repeat to have equal trials counted"
        if differing:
            remedy = f"column {differing[0]!r} differs between them and is not used: map it, e.g. as tip_mass; or correct repeat"
        notes.append(
            f"trials {again[0][0]} and {again[0][1]} inflate the same chambers as far, and column "
            f"{counted['repeat']!r} says that both are repeat {again[0][2]}: {remedy}"
        )
    return states.replaced({"trial": trial + 1, "step": step, "repeat": repeat})


def _sets_apart(cells: NDArray[np.str_], pairs: Sequence[tuple[Ints, Ints]]) -> bool:
    """Whether a column has one word a trial, which comes again in others, and differs between most pairs of trials (states)."""
    words = [({*cells[a].tolist()}, {*cells[b].tolist()}) for a, b in pairs]
    apart = sum(len(a) == len(b) == 1 and a != b for a, b in words)
    return 2 * apart > len(pairs) and len(set().union(*(a | b for a, b in words))) <= max(2, len(pairs))


def _with_pushes(states: Table, file: Ints, forces: Sequence[float | None], wanted: Map) -> Table:
    """Append stiffness rows, one per file with a force (N), deflected from that of the repeat with 0 N. Raises ConfigError."""
    assert wanted.stiffness is not None
    first = states.take(np.unique(file, return_index=True)[1])
    repeat, force = first.get("repeat"), np.array([np.nan if f is None else f for f in forces])
    order = np.array([k for k in np.lexsort((force, repeat)).tolist() if force[k] and not np.isnan(force[k])], np.int64)
    unloaded = {r: k for k, r in reversed(list(enumerate(repeat.tolist()))) if force[k] == 0}
    if lacking := [r for r in repeat[order].tolist() if r not in unloaded]:
        raise ConfigError(f"stiffness: repeat {lacking[0]} has no file with force: 0 N as the reference for deflections")
    pushed, position = first.take(order), first.tip @ AXES[wanted.stiffness.along]
    n, number = len(order), np.unique(pushed.get("repeat"), return_inverse=True)[1]
    columns = {name: pushed.get(name) for name in ("repeat", "t", "spine_length")}
    columns |= {name: np.zeros(n) for name in pressure_columns(states.pressures.shape[1])}
    columns |= {"trial": states.trial.max() + 1 + number, "step": 1 + np.arange(n) - np.searchsorted(number, number),
                "protocol": np.full(n, "stiffness"), "branch": np.full(n, "load"), "force": force[order],
                "specimen": np.full(n, wanted.stiffness.specimen),
                "deflection": position[order] - position[[unloaded[r] for r in pushed.get("repeat").tolist()]]}  # fmt: skip
    return Table.stacked([states, Table(columns)])
