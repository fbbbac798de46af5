"""Files and their map as one table of trials."""

from __future__ import annotations

import fnmatch
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.data.levels import SPINE_GAP, levels, pressure_gap
from model.actuators import Words
from model.robot import Robot
from recordings.errors import RecordingError
from recordings.states.rules import BRANCHES
from recordings.trials import HEAD, TAIL, Table, TrialRow

from ..files.config import ConfigError
from ..questions.table import doubtful_gravity
from .clock import BETWEEN_RUNS, EPOCH
from .columns import DAY
from .formats import KNOWN, RECORDING, read
from .joining import in_time, lag
from .map_file import AXES, Map, Name, named
from .places import Jump, Stands, beside_at_rest, jumps, length_at_rest, lever_off, moves_within, other_order, strays, turn_off
from .quantities import Quantities, quantities_of
from .reading import at_rest
from .series import Series
from .trials import Cut, cuts, trials_of_rows

Array = NDArray[np.float64]

FORCES = ("force_x", "force_y", "force_z")
MOST_JUMPS = 3
"""Jumps of places that are told one by one."""
FOLLOWS, FEW_SETTINGS = 0.9, 4
"""Share of a column's variance that the pressures account for in no table of mountings, and values of which there are fewer."""
SAME_MASS, SAME_ROLL = 2e-3, 2.0
"""kg at the tip, deg of roll: the same of these."""


@dataclass(frozen=True)
class Imported:
    """A table, and what it was made from."""

    table: Table
    files: tuple[tuple[Series, Quantities, tuple[Cut, ...]], ...]
    notes: tuple[str, ...]
    """What was left out, or taken for granted."""
    unread: tuple[str, ...]
    """Files that cannot be read, and why; `notes` has them, too."""
    questions: tuple[str, ...] = ()
    """What a person has to check."""


@dataclass(frozen=True)
class _State:
    """One state, not numbered yet."""

    file: int
    rows: slice
    """Of the file's quantities."""
    group: int
    """Of states that were read one after the other: a trial."""
    row: TrialRow
    turn: Rotation | None


def files_of(given: Sequence[Path], wanted: Map) -> list[tuple[Path, Map]]:
    """Files to read and the map of each: those given, or in a folder given those that the map names, as people count them."""
    out: list[tuple[Path, Map]] = []
    for path in given:
        inside = sorted((p for p in path.iterdir() if p.is_file()), key=_counted) if path.is_dir() else [path]
        if path.is_dir() and not wanted.files:
            inside = [p for p in inside if p.suffix.lower() in KNOWN]
        for file in inside:
            own = [v for k, v in wanted.files.items() if fnmatch.fnmatch(file.name, k)]
            if wanted.files and not own:
                if path.is_dir():
                    continue
                patterns = ", ".join(wanted.files)
                raise ConfigError(
                    f"{file}: no pattern of `files` in the map fits; there are {patterns}; add {file.name!r} or '*'"
                )
            made = wanted.of_file(own)
            if wrong := made.wrong_places():
                raise ConfigError(f"{file}: the map of this file (files): {'; '.join(wrong)}")
            out.append((file, made))
    if not out:
        raise ConfigError(f"{', '.join(map(str, given))}: holds no file that the map names")
    return out


def _counted(path: Path) -> list[tuple[int, str]]:
    """A key by which run2 comes before run10."""
    parts = re.split(r"(\d+)", path.name.casefold())
    return [(int(part[:18]), "") if part.isdecimal() else (0, part) for part in parts]


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
) -> tuple[list[tuple[Series, Quantities, Map]], list[str], list[str]]:
    """Every file, in the order of their times where these tell it, notes, and what cannot be read."""
    files, made, read_files = _recordings(files_of(given, wanted)), [], []
    failed: list[ConfigError] = []
    for number, (parts, own) in enumerate(files):
        progress(number, len(files))
        try:
            series = read(parts, own.source, named(own))
        except ConfigError as e:
            if set(parts) & set(given) or wanted.files:  # asked for by name
                raise
            failed.append(e)
            continue
        read_files.append((series, own))
    if not read_files:
        raise failed[0]
    for series, own in in_time(read_files):
        q = quantities_of(series, own, drive)
        late = lag(q.t, q.pressures, q.tip) if series.questions else None
        asked = [*series.questions, *q.questions, *([_lag_question(late)] if late is not None else [])]
        made.append((series, replace(q, questions=tuple(asked)), own))
    said: dict[str, list[str]] = {}
    for series, q, _ in made:
        for text in (*series.notes, *q.notes):
            said.setdefault(text, []).append(series.path.name)
    unread = [f"not read: {e}" for e in failed]
    notes = [*unread] + [f"{', '.join(names)}: {text}" for text, names in said.items()]
    ordered = sorted(made, key=lambda one: float(one[1].t[0]))
    if [s.path for s, _, _ in ordered] != [s.path for s, _, _ in made]:
        first, last = float(ordered[0][1].t[0]), float(ordered[-1][1].t[0])
        apart = all(float(np.nanmax(a.t)) < float(b.t[0]) for (_, a, _), (_, b, _) in pairwise(ordered))
        names = ", ".join(s.path.name for s, _, _ in ordered)
        if first >= EPOCH[0] or (apart and last - first < DAY / 2):
            made = ordered
            notes.append(f"files are read in the order of their times: {names}")
        elif apart:
            notes.append(f"files are read in the order of their names; by their times, unless over midnight, it is: {names}")
    return made, notes, unread


def _lag_question(late: float) -> str:
    return (
        f"the tip moves {abs(late):.3g} s {'after' if late > 0 else 'before'} the pressures change: do the clocks of these files "
        f"differ? If so, write source: {{offset: {late:.3g}}} for the file of the pressures, under files"
    )


def imported(
    given: Sequence[Path],
    wanted: Map,
    robot: Robot,
    progress: Callable[[float, float], None] = lambda done, of: None,
) -> Imported:
    """Read, cut and put into the robot's frame; raises ConfigError."""
    straight, arcs = _straight_point(robot), robot.markers
    every, notes, unread = _read(given, wanted, robot.actuators.words, progress)
    read_files, states = [], []
    group, start, origin = 0, 0.0, 0.0
    for number, (series, q, own_map) in enumerate(every):
        path = series.path
        absolute = bool(q.t[0] >= EPOCH[0])
        origin = float(q.t[0]) if not number and absolute else origin
        q = replace(q, t=q.t - (origin if absolute else 0.0))
        if wanted.straight == "first row":
            q = _straightened(q, straight, wanted.sensor, arcs)
        if number and ("t" not in own_map.columns and not absolute or q.t[0] < start):
            q = replace(q, t=q.t - q.t[0] + start + BETWEEN_RUNS)
        trial, doubts = trials_of_rows(series, q, own_map, robot.actuators.words)
        notes += doubts
        pushed = [q.others[name] for name in FORCES if name in q.others]
        own = cuts(wanted.states, q.t, q.pressures, trial, np.column_stack(pushed) if pushed else None)
        each = wanted.trials.begin == "state" and "trial" not in q.others
        numbers = range(len(own)) if each else [int(trial[c.rows][0]) for c in own]
        q, torn = _without_strays(q, own, float(straight[2]), series, notes)
        made = [_state(number, group + k, q, c) for k, c in zip(numbers, own, strict=True) if c not in torn]
        kept = [s for s in made if s is not None]
        if len(kept) < len(made) < len(q.t):  # else the rows were named
            notes.append(f"{path.name}: {len(made) - len(kept)} of {len(made)} states have no tip or pressure and are left out")
        if not kept:
            raise ConfigError(f"{path}: no state was found; {_why(wanted, q)}")
        states += kept
        group += max(numbers) + 1
        start = float(np.nanmax(q.t))
        read_files.append((series, q, tuple(own)))
    if wanted.straight == "at rest":
        notes += doubtful_gravity(robot, Table.of(s.row for s in states))
    if wanted.straight in ("first state", "at rest"):
        states = _mounted(states, robot, wanted.straight, wanted.sensor)
    elif any(wanted.sensor) and wanted.straight == "as recorded":
        states = [_moved(s, np.array(wanted.sensor), np.zeros(3)) for s in states]
    if wanted.forces == "tip":
        states = [_force_turned(s, wanted.frame.matrix) for s in states]
    counted = {n: c.column for _, _, own in every for n, c in own.columns.items() if n in ("trial", "repeat")}
    rows = _numbered(states, counted, notes)
    if wanted.straight != "as recorded" and (off := lever_off(rows, float(straight[2]))) is not None:
        notes.append(_lever_note(wanted.sensor[2], *off))
    notes += _contradictions(rows, float(straight[2]))
    if wanted.straight == "as recorded" and (rests := beside_at_rest(rows, straight)) is not None:
        aside, away = (1e3 * m for m in rests)
        notes.append(
            f"at rest the tip is {aside:.0f} mm off the axis and {away:.0f} mm from the origin, the robot is "
            f"{1e3 * straight[2]:.0f} mm long: add `straight: at rest` to the map, or check the frame and the unit"
        )
    notes += _jump_notes(list(jumps(rows, float(straight[2]))), states, every, robot.actuators.words)
    _demand_mounted(rows)
    if wanted.stiffness is not None:
        rows += _pushes(rows, read_files, wanted)
    try:
        table = Table.of(TrialRow.from_cells(r.cells()) for r in rows)
    except RecordingError as e:
        raise ConfigError(f"the table made by the map is none: {e}") from e
    asked = other_order(
        [(series.path.name, _rest(q)) for series, q, _ in every], float(straight[2]), wanted.straight != "as recorded"
    )
    questions = [*asked, *(f"{series.path.name}, {text}" for series, q, _ in every for text in q.questions)]
    return Imported(table, tuple(read_files), tuple(notes), tuple(unread), tuple(questions))


def _contradictions(rows: Sequence[TrialRow], length: float) -> Iterator[str]:
    """What to ask about turns that do not fit the places, a tip that is not the body's end, and mountings that vary."""
    if (off := turn_off(rows, length)) is not None:
        yield (
            f"the turn of the tip does not fit its place (agreement of directions {round(off[0], 2) + 0.0:.2f} of 1, and the tip "
            f"moves {off[1]:.2g} times as far as the end of an arc that turns as much): check orientation (columns, order, "
            "unit), the frame and the columns x, y, z"
        )
    if (other := length_at_rest(rows, length)) is not None:
        yield (
            f"at rest the tip lies on the axis, {1e3 * other:.0f} mm from the base of a robot of {1e3 * length:.0f} mm: is this "
            "marker the tip, and its unit right?"
        )
    for name, same in (("roll_deg", SAME_ROLL), ("tip_mass", SAME_MASS)):
        share = follows_pressure(rows, name, same)
        if share > FOLLOWS:
            yield (
                f"columns.{name}: the pressures account for {100 * share:.0f} % of its changes, but what is mounted does not "
                "follow them: is this column another quantity?"
            )
    masses = [(a.tip_mass or 0.0, b.tip_mass or 0.0) for a, b in pairwise(rows) if a.trial == b.trial]
    changed = sum(abs(a - b) > SAME_MASS for a, b in masses)
    if changed > len(masses) / 2:
        yield f"tip_mass changes {changed} times between states of one trial: is this column a mass that was hung there?"


def follows_pressure(rows: Sequence[TrialRow], name: str, same: float) -> float:
    """Share of the variance of a column that is linear in the pressures; 0 where it has few values, those within `same` alike."""
    values = np.array([getattr(r, name) or 0.0 for r in rows])
    terms = np.column_stack([np.array([r.pressures for r in rows]), np.ones(len(rows))])
    if len(rows) < 3 * terms.shape[1] or len(np.unique(levels(values, same))) < FEW_SETTINGS:
        return 0.0
    missed = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
    return float(1 - missed.var() / values.var())


def _demand_mounted(rows: Sequence[TrialRow]) -> None:
    """Raise ConfigError where the turn of the body in its mount changes within a trial."""
    for trial in dict.fromkeys(r.trial for r in rows):
        own = [r.roll_deg for r in rows if r.trial == trial and r.roll_deg is not None]
        if own and max(own) - min(own) > SAME_ROLL:
            raise ConfigError(
                f"columns.roll_deg: from {min(own):.4g} to {max(own):.4g} deg within trial {trial}, but the body stays in its "
                "mount; if this column is an angle of the tip, write it under orientation (columns, order, unit) instead"
            )


def _why(wanted: Map, q: Quantities) -> str:
    if wanted.states.plateaus is None:
        return "its rows have no tip or pressure"
    jump = float(np.nanmedian(np.abs(np.diff(q.pressures, axis=0)).max(axis=1))) if len(q.t) > 1 else 0.0
    return (
        f"no pressure stands within {wanted.states.plateaus.steady:g} Pa for {wanted.states.plateaus.shortest:g} s "
        f"(from row to row the median change is {jump:.3g} Pa): change states.plateaus"
    )


def _without_strays(
    q: Quantities, states: Sequence[Cut], length: float, series: Series, notes: list[str]
) -> tuple[Quantities, list[Cut]]:
    """The same without places that jump within a state and back, and the states whose places are two."""
    tip, markers, torn, stray, first = q.tip.copy(), q.markers.copy(), [], 0, None
    for cut in states:
        own = cut.rows
        row = moves_within(tip[own], markers[own], length)
        if row is None:
            continue
        first = row + own.start if first is None else first
        rows = np.flatnonzero(strays(tip[own], markers[own], length)) + own.start
        if len(rows) > 0.2 * (own.stop - own.start):
            torn.append(cut)
            continue
        tip[rows], markers[rows] = np.nan, np.nan
        stray += len(rows)
    if first is not None:
        notes.append(
            f"{series.path.name}, {series.place(int(q.row[first]))}: a marker jumps within a state: was it taken for another? "
            f"{stray} rows and {len(torn)} states are left out"
        )
    return replace(q, tip=tip, markers=markers), torn


def _jump_notes(
    found: Sequence[Jump], states: Sequence[_State], files: Sequence[tuple[Series, Quantities, Map]], words: Words
) -> Iterator[str]:
    """What to ask about places that moved farther than the body can."""
    exchanged = {(j.state, *sorted((j.body, j.exchanged))) for j in found if j.exchanged is not None}
    told = [j for j in found if j.exchanged is None or (j.state, j.body, j.exchanged) in exchanged]
    for jump in told[:MOST_JUMPS]:
        series, q, _ = files[states[jump.state].file]
        body = ["the tip", *(f"marker {k}" for k in range(1, 100))]
        what = (
            f"{body[jump.body]} moves by {1e3 * jump.distance:.1f} mm while no {words.pressure} changes by more than "
            f"{jump.pressure / words.pascal:.3g} {words.unit}, farther than the body can: was it another marker, or was "
            "something moved?"
            if jump.exchanged is None
            else f"{body[jump.body]} and {body[jump.exchanged]} change places: were they exchanged?"
        )
        place = series.place(int(q.row[states[jump.state].rows.start]))
        yield (
            f"{series.path.name}, {place}: {what} If so, write these rows to a file of their own and name its columns under "
            "files: {PATTERN: {columns: ..}}, or leave them out"
        )
    if len(told) > MOST_JUMPS:
        yield f"{len(told) - MOST_JUMPS} further places move farther than the body can"


def _lever_note(sensor: float, off: float, without: float, best: float) -> str:
    return (
        f"place and turn of the tip fit one arc to {1e3 * best:.1f} mm for a sensor {1e3 * (sensor + off):.1f} mm beyond "
        f"the end of the body, but to {1e3 * without:.1f} mm where the map has it ({1e3 * sensor:.1f} mm): check sensor, frame "
        "and orientation"
    )


def _rest(q: Quantities) -> Array:
    """(1 + k, 3) m, the mean of tip and markers at rest; NaN of those that were not seen then."""
    places = np.concatenate([q.tip[:, None], q.markers], axis=1)[at_rest(q.pressures)]
    seen = np.isfinite(places).all(axis=2)
    total = np.where(seen[:, :, None], places, 0.0).sum(axis=0)
    return np.asarray(np.where(seen.any(axis=0)[:, None], total / np.maximum(seen.sum(axis=0), 1)[:, None], np.nan))


# ------------------------------------------------------------------ frames
def _straight_point(robot: Robot) -> Array:
    """(3,) m: the end of the straight body, or the point beside it that robot.yaml states as tracked (marker_offset)."""
    stated = robot.effects.get("marker_offset", {})
    return np.array([stated[a].value if a in stated else 0.0 for a in "xyz"]) + [0.0, 0.0, robot.length]


def _straightened(q: Quantities, straight: Array, sensor: Sequence[float], arcs: Sequence[float]) -> Quantities:
    """Places and turns against those of the first row, which is the straight robot; a marker not seen there stays where it is."""
    lever = np.array(sensor)
    turn = None if q.turn is None else q.turn * q.turn[0].inv()
    moved = q.tip - q.tip[0]
    if turn is not None:
        moved = moved - (turn.apply(lever) - lever)
    known = min(len(arcs), q.markers.shape[1])
    on_axis = np.array([(0.0, 0.0, s) for s in arcs[:known]]).reshape(-1, 3)
    shift = np.zeros_like(q.markers[0])
    shift[:known] = np.nan_to_num(on_axis - q.markers[0, :known])
    return replace(q, tip=moved + straight, turn=turn, markers=q.markers + shift)


def _mounted(
    states: list[_State], robot: Robot, straight: Literal["first state", "at rest"], sensor: Sequence[float]
) -> list[_State]:
    """States moved so that those at rest are where the robot stands then; a marker not seen there stays where it is.

    first state: the first one at rest is the straight robot. at rest: the mean of those at rest, of those that begin a trial
    where there are any, is where the model stands under its weight.
    """
    # in steps of 2 kPa, of which the first of equals is taken
    level = [round(max(map(abs, s.row.pressures)) / 2e3) for s in states]
    resting = [i for i, own in enumerate(level) if own == min(level)]
    if straight == "first state":
        resting, end = resting[:1], _straight_point(robot)
        stands = Stands.straight(end, robot.markers)
    else:
        beginning = [i for i in resting if not i or states[i].group != states[i - 1].group]
        resting = beginning or resting
        stands = Stands.of(robot, [states[i].row for i in resting])
    lever, known = np.array(sensor), [k for k, i in enumerate(resting) if states[i].turn is not None]
    if known:
        recorded = Rotation.concatenate([turn for k in known if (turn := states[resting[k]].turn) is not None])
        mount = (stands.turn[known].inv() * recorded).mean().inv()
        states = [replace(s, turn=None if s.turn is None else s.turn * mount) for s in states]
    else:
        states = [replace(s, turn=None) for s in states]
    states = [_moved(s, lever, np.zeros(3)) for s in states]
    shift = np.mean(stands.tip - [states[i].row.tip for i in resting], axis=0)
    places = np.array([_places(states[i].row) for i in resting])
    beside = np.zeros(places.shape[1:])
    both = min(len(beside), stands.markers.shape[1])
    missed = stands.markers[:, :both] - places[:, :both]
    seen = np.isfinite(missed).all(axis=2)
    for k in np.flatnonzero(seen.any(axis=0)).tolist():
        beside[k] = missed[seen[:, k], k].mean(axis=0)
    out = []
    for state in states:
        moved = _moved(state, np.zeros(3), shift)
        own = (_places(state.row) + beside).tolist()
        out.append(replace(moved, row=replace(moved.row, markers=tuple((x, y, z) for x, y, z in own))))
    return out


def _places(row: TrialRow) -> Array:
    """(k, 3) m of the markers of a state; NaN where one was not seen."""
    return np.array(row.markers, np.float64).reshape(-1, 3)


def _moved(state: _State, lever: Array, shift: Array) -> _State:
    """A state with its tip moved: by a lever that turns with it, and by a shift."""
    own = shift - (state.turn.apply(lever) if state.turn is not None else lever)
    x, y, z = (np.array(state.row.tip) + own).tolist()
    return replace(state, row=replace(state.row, tip=(x, y, z), orientation=_quaternion(state.turn)))


def _force_turned(state: _State, frame: Array) -> _State:
    """A state with its force brought from the tip's axes into those of the base."""
    if state.turn is None:
        raise ConfigError(f"forces: the state at t = {state.row.t:.3f} s has no orientation to turn its force with")
    x, y, z = state.turn.apply(frame @ np.array(state.row.tip_force)).tolist()
    return replace(state, row=replace(state.row, force_x=x, force_y=y, force_z=z))


def _quaternion(turn: Rotation | None) -> tuple[float, float, float, float] | None:
    if turn is None:
        return None
    w, x, y, z = turn.as_quat(canonical=True, scalar_first=True).tolist()
    return (w, x, y, z)


# ------------------------------------------------------------------ states
def _state(file: int, group: int, q: Quantities, cut: Cut) -> _State | None:
    own = cut.rows
    tip, pressure = q.tip[own], q.pressures[own]
    seen = np.isfinite(tip).all(axis=1) & np.isfinite(pressure).all(axis=1)
    if not seen.any():
        return None
    held = np.zeros(pressure.shape[1]) if cut.at_rest else pressure[seen].mean(axis=0)
    x, y, z = tip[seen].mean(axis=0).tolist()
    turned = q.turned[own] & seen
    turn = q.turn[own][turned].mean() if q.turn is not None and turned.any() else None
    markers = tuple(
        tuple(m[np.isfinite(m).all(axis=1)].mean(axis=0).tolist()) if np.isfinite(m).all(axis=1).any() else (np.nan,) * 3
        for m in np.swapaxes(q.markers[own], 0, 1)
    )
    cells: dict[str, Any] = dict(q.constants)
    cells |= {name: float(np.nanmean(v[own])) for name, v in q.others.items() if np.isfinite(v[own]).any()}
    cells |= {name: str(said[-1]) for name, w in q.words.items() if len(said := w[own][w[own] != ""])}
    if int(seen.sum()) > 1:
        if not cut.at_rest:
            cells |= {f"sd_p{k}": s for k, s in enumerate(pressure[seen].std(axis=0, ddof=1).tolist(), 1)}
        cells |= {f"sd_{a}": s for a, s in zip("xyz", tip[seen].std(axis=0, ddof=1).tolist(), strict=True)}
        cells.setdefault("hold", cut.since)
    numbered = ("trial", "step", "repeat", "branch", "force", "deflection")
    plain: dict[str, Any] = {"spine_length": 0.0, "protocol": "bending", "t": float(q.t[own][seen].mean())}
    plain |= {n: cells[n] for n in (*HEAD, *TAIL) if n in cells and n not in numbered}
    branch = str(cells.get("branch", ""))
    if branch and branch not in BRANCHES:
        raise ConfigError(
            f"{q.path}: branch {branch[:40]!r} is not one of {', '.join(BRANCHES)}; translate it with columns.branch.values"
        )
    row = TrialRow(
        **plain,
        trial=group, step=0, repeat=int(cells.get("repeat", 0)), branch=branch, pressures=tuple(held.tolist()),
        tip=(x, y, z), orientation=_quaternion(turn), markers=markers,  # type: ignore[arg-type]
        sd={n[3:]: v for n, v in cells.items() if n.startswith("sd_")},
        sensors={n: v for n, v in cells.items() if n.startswith("sensor_")},
    )  # fmt: skip
    return _State(file, own, group, row, turn)


def _numbered(states: Sequence[_State], counted: Mapping[str, Name], notes: list[str]) -> list[TrialRow]:
    """Trials, steps and, where no column tells them, repeats (of the same inflation) and branches, from 1 on.

    `counted`: the columns of trial and repeat, if any. Unless one counts the trials, each is of one repeat: that of most states.
    """
    groups = list(dict.fromkeys(s.group for s in states))
    trials = [[s.row for s in states if s.group == g] for g in groups]
    rows: list[TrialRow] = []
    before: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    gap = pressure_gap(Table.of(r for own in trials for r in own))
    again = []
    for trial, (own, kind) in enumerate(zip(trials, _kinds(trials), strict=True), 1):
        others = before.setdefault(kind, [])
        told = Counter(r.repeat for r in own if r.repeat)
        usual = told.most_common(1)[0][0] if told else 1 + len(others)
        again += [(other, trial, usual) for other, repeat in others if repeat == usual and told and len(own) > 1]
        others.append((trial, usual))
        for step, (row, falls) in enumerate(zip(own, _falling(own, gap), strict=True), 1):
            repeat = row.repeat if row.repeat and "trial" in counted else usual
            branch = row.branch or ("unload" if falls else "load")
            rows.append(replace(row, trial=trial, step=step, repeat=repeat, branch=branch))
    if again and "repeat" in counted:
        notes.append(
            f"trials {again[0][0]} and {again[0][1]} inflate the same chambers as far, and column "
            f"{counted['repeat']!r} says that both are repeat {again[0][2]}: correct it, or leave columns.repeat "
            "out of the map, and trials alike are counted"
        )
    return rows


def _falling(trial: Sequence[TrialRow], gap: float) -> list[bool]:
    """Whether the highest pressure came down to each state, or stood since it did; changes below `gap` (Pa) are none."""
    out: list[bool] = []
    level, falls = 0.0, False
    for row in trial:
        highest = max(row.pressures)
        if abs(highest - level) > gap:
            level, falls = highest, highest < level
        out.append(falls)
    return out


def _kinds(trials: Sequence[Sequence[TrialRow]]) -> list[tuple[int, ...]]:
    """What trials that repeat each other have in common: how far each chamber is inflated, spine, mass and roll."""
    highest = np.array([np.max([r.pressures for r in own], axis=0) for own in trials])
    gap = pressure_gap(Table.of(r for own in trials for r in own))
    settings = [levels(chamber, gap) for chamber in highest.T]
    first = [own[0] for own in trials]
    settings.append(levels(np.array([r.spine_length for r in first]), SPINE_GAP))
    settings.append(levels(np.array([r.tip_mass or 0.0 for r in first]), SAME_MASS))
    settings.append(levels(np.array([r.roll_deg or 0.0 for r in first]), SAME_ROLL))
    return [tuple(int(v) for v in kind) for kind in zip(*settings, strict=True)]


def _pushes(rows: Sequence[TrialRow], files: Sequence[tuple[Series, Quantities, tuple[Cut, ...]]], wanted: Map) -> list[TrialRow]:
    """Stiffness rows: what each file's force adds to the place of the tip without it."""
    assert wanted.stiffness is not None
    axis, sign = AXES[wanted.stiffness.along]
    numbered = []
    at = 0
    for _, q, own in files:
        numbered.append((rows[at], q.constants.get("force")))
        at += len(own)
    out: list[TrialRow] = []
    trials: dict[int, int] = {}
    for row, force in sorted(numbered, key=lambda n: (n[0].repeat, n[1] or 0.0)):
        if force is None or force == 0 or row.tip is None:
            continue
        rest = next((r for r, f in numbered if f == 0 and r.repeat == row.repeat and r.tip is not None), None)
        if rest is None or rest.tip is None:
            raise ConfigError(f"stiffness: repeat {row.repeat} has no file with force: 0 N to hold deflections against")
        trial = trials.setdefault(row.repeat, len({r.trial for r in rows}) + len(trials) + 1)
        deflection = sign * (row.tip[axis] - rest.tip[axis])
        out.append(
            TrialRow(
                trial=trial, step=sum(r.trial == trial for r in out) + 1, protocol="stiffness", repeat=row.repeat, branch="load",
                t=row.t, spine_length=row.spine_length, pressures=(0.0,) * len(row.pressures), specimen=wanted.stiffness.specimen,
                force=float(force), deflection=float(deflection),
            )
        )  # fmt: skip
    return out
