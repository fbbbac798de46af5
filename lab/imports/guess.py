"""Propose a map for a file from its headings and numbers, each line with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from model.arrays import Array
from model.robot import Robot
from recordings.ambient import AMBIENT
from recordings.trials import unit_of

from ..files.config import ConfigError
from ..files.config import Source as Proposed
from ..files.map_file import map_of
from ..files.units import KINDS
from .clock import MANY, unit_of_steps
from .columns import is_missing
from .guess_tip import changes_throughout, guess_angles, guess_quaternion, guess_tip, proposed_pressures
from .headings import (
    ASKED_FOR,
    ELECTRIC,
    READ,
    WORDS_OF_BRANCH,
    Heading,
    chamber,
    heading,
    names_inflated,
    own_column,
    quadruples,
    quantity,
    tendon,
    triples,
    turning,
    unseen_axis,
)
from .joining import JOIN
from .proposal import Guess
from .quantities import quantities_of
from .series import Series, texts, unit_in
from .trials import Change, Stages, changes

USUAL_PRESSURES = {"Pa": (4e3, 2e6), "kPa": (4.0, 600.0), "bar": (0.02, 4.0), "mbar": (600.0, 6e3), "psi": (4.0, 90.0)}
"""Highest pressures of soft robots by unit, in the order in which they are considered."""
STEADY = 0.02
"""Band of a plateau, as a share of the highest pressure."""
MOTION_CAPTURE = ("Motive", "C3D")
FRAME_WORDS = frozenset(["frame", "frames", "sample", "samples", "index", "idx", "bild"])
"""Words of a heading for a count of rows."""


def guess_map(series: Series, robot: Robot) -> Guess:
    """Return the most plausible map of a file's columns for a robot. Raises ConfigError if no tip or pressure is found."""
    g, (series, unseen) = Guess(), _with_plane(series)
    headings = [heading(n, series.units.get(n, "")) for n in series.names if n in series.numbers or n in series.words]
    turns, angles = quadruples(headings), turning(headings)
    used = {name for four in turns for name in four} | {name for three in angles for name in three.columns}
    counting = [h for h in headings if h.name not in used and _counts(h, series)]
    remaining = [h for h in headings if h.name not in used and h not in counting]
    if not _actuators(series, remaining, robot):  # "chamber" of a robot of one
        counting, remaining = [], [*remaining, *counting]
    pressures = _pressures(g, series, remaining, robot)
    used |= {h.name for h in counting} | set(pressures)
    tip = guess_tip(g, series, [h for h in headings if h.name not in used and h.name in series.numbers], robot)
    guess_quaternion(g, series, turns, tip.columns)
    guess_angles(g, series, angles, tip)
    used |= set(tip.mentioned)
    _others(g, series, [h for h in headings if h.name not in used], robot)
    _states(g, series, pressures, robot)
    _trials(g, series, counting, pressures, robot)
    in_use = repr({k: v for k, v in g.values.items() if k != "trials"})
    if words := list(dict.fromkeys(w for name, s in series.strange.items() if repr(name) in in_use for w in s.words)):
        g.say("source.missing", words, "cells of these columns that are not numbers")
        g.doubt("source.missing", f"{', '.join(map(repr, words))} are taken as missing values")
    if unseen and g.values["columns"].pop(unseen, None) and g.reasons.pop(f"columns.{unseen}"):
        g.say(f"constants.{unseen}", "0 mm", f"one camera: no column of {unseen}")
        g.doubt(f"constants.{unseen}", f"no column of {unseen}: does the robot move in a plane, and is that at 0 mm?")
    return g


def _with_plane(series: Series) -> tuple[Series, str]:
    """The same with zeros for the coordinate that one camera does not see, and that coordinate; empty where it sees all."""
    axis, name = unseen_axis([heading(n, series.units.get(n, "")) for n in series.numbers])
    return (replace(series, columns={**series.columns, name: np.zeros(len(series))}), axis) if axis else (series, "")


def lacks(series: Series, robot: Robot) -> frozenset[str]:
    """Which of pressures and tip no heading of a file names."""
    series, _ = _with_plane(series)
    headings = [heading(n, series.units.get(n, "")) for n in series.numbers]
    turns = {name for four in quadruples(headings) for name in four}
    places = [t for t in triples([h for h in headings if h.name not in turns]) if t.unit in ("", *KINDS["m"])]
    held = {"pressures": _actuators(series, headings, robot), "tip": places}
    return frozenset(what for what, columns in held.items() if not columns)


# ------------------------------------------------------------------ pressures
def _actuators(series: Series, headings: Sequence[Heading], robot: Robot) -> dict[str, int]:
    """Column of numbers -> chamber or tendon that its heading names; else one for each, numbered without unit or in N."""
    number = chamber if robot.tendons is None else tendon
    named = {h.name: n for h in headings if (n := number(h)) is not None and h.name in series.numbers}
    if named:
        return named
    if robot.tendons is None:  # set1, act1 ..: what was asked for or read, and nothing says of what
        bare = {h.name: n for h in headings if h.name in series.numbers and not h.stated and h.says(ASKED_FOR | READ)
                and (n := chamber(replace(h, kind="Pa"))) is not None}  # fmt: skip
        return bare if len({*bare.values()}) == len(robot.actuators.azimuths_deg) > 1 else {}
    forces = {name for t in triples(headings) for name in t.columns}
    in_newton = [h for h in headings if h.kind == "N" and h.name in series.numbers and h.name not in forces]
    alike = ([h for h in in_newton if h.words[:1] == one.words[:1]] for one in in_newton)
    tensions = next((found for found in (in_newton, *alike) if len(found) == len(robot.tendons.azimuths_deg) > 1), [])
    silent = {h.name: n for h in headings if h.name in series.numbers and h.name not in forces
              and not h.stated and (n := tendon(replace(h, kind="N"))) is not None}  # fmt: skip
    return {h.name: k for k, h in enumerate(tensions, 1)} or (silent if len(silent) == len(robot.tendons.azimuths_deg) else {})


def _pressures(g: Guess, series: Series, headings: Sequence[Heading], robot: Robot) -> list[str]:
    """Propose column and unit of each chamber or tendon; return the columns used, in order. Raises ConfigError without any."""
    actuator_of = _actuators(series, headings, robot)
    by_name = {h.name: h for h in headings}
    measured = {name: n for name, n in actuator_of.items() if not by_name[name].says(ASKED_FOR)}
    chosen = measured or actuator_of
    wanted, words = len(robot.actuators.azimuths_deg), robot.actuators.words
    first_of = {number: name for name, number in reversed(chosen.items())}
    again = [name for name, number in chosen.items() if len(first_of) >= wanted and first_of[number] != name]
    shared = not again and len(first_of) < len(chosen)
    names = [*chosen] if shared else sorted(first_of.values(), key=chosen.__getitem__)
    if not names:
        if wanted == 1:
            g.say("constants", {"p1": 0}, "no column of pressures")
            g.doubt("constants.p1", "no pressure column found: 0 is right for a body that is never inflated")
            return []
        if series.form.startswith(MOTION_CAPTURE):
            g.say("constants", {f"p{k + 1}": "?" for k in range(wanted)}, f"{series.form} holds no pressures: fill them in")
            g.doubt(
                "constants",
                "write each chamber's pressure, such as p1: 50 kPa, or for each file under files: {PATTERN: {p1: 50 kPa, ..}}",
            )
            return []
        wants = "a pressure (p1, P2 [kPa], pressure_3 ..)" if robot.tendons is None else "a tension (tendon1 [N], Zug_2 ..)"
        raise ConfigError(
            f"{series.path}: no heading names {wants}; there are {', '.join(map(repr, series.names[:12]))}. If they are in "
            f"another file, give both, or {JOIN}; else name them so, or write map.yaml by hand, with "
            f"`p1: {{column: HEADING, unit: {words.unit}}}` .. under columns (docs: data from elsewhere)"
        )
    if robot.tendons is not None and all(tendon(by_name[n]) is None and by_name[n].stated for n in names):
        g.doubt("columns.p1", f"{', '.join(names)} are taken as tendons 1 to {wanted}, since they are in N; check the order")
    if shared:
        order = f"{', '.join(names)} share numbers: their order in the file is taken for that of robot.yaml's {words.actuators}"
        g.doubt("columns.p1", f"{order}, which is a guess; check it against azimuths_deg")
    units = _units(series, names, robot)
    if guessed := [n for n in names if units[n].guessed]:
        g.doubt("columns.p1", f"the file states no unit for {', '.join(guessed)}: {units[guessed[0]].why}")
    electric = sorted({by_name[n].stated for n in names if by_name[n].stated.casefold() in ELECTRIC})
    columns = _shared(chosen, names, robot)
    for k, name in enumerate(columns, 1):
        if name is None:
            lacking = f"no column of {words.actuator} {k}"
            g.say(f"constants.p{k}", f"0 {words.unit}", lacking)
            g.doubt(f"constants.p{k}", f"{lacking}: was its {words.pressure} 0 {words.unit} in all rows?")
            continue
        unit = units[name]
        entry: dict[str, Any] = {"column": name, "unit": unit.name}
        if unit.absolute:
            rests = (values := series.numbers[name])[values <= (1 - STEADY) * np.nanmin(values) + STEADY * np.nanmax(values)]
            entry["zero"] = float(f"{np.median(rests):.5g}")
        g.say(f"columns.p{k}", entry, f"{unit.why}{'; its lowest readings are taken as vented' if unit.absolute else ''}")
    if electric:
        g.doubts.append(
            f"columns.p1 .. are read in {electric[0]}: write the sensor's scale (kPa per {electric[0]}), columns.p1.scale"
        )
    if not measured:
        g.doubts.append(
            f"{', '.join(names)} are set-points; no measured pressures were found. Regulators lag and leak, so name measured "
            "pressures if you have them"
        )
    if again:
        g.doubts.append(f"{', '.join(again)} name chambers that other columns also name: check which are the measured pressures")
    if len(names) != wanted and None not in columns:
        counts = f"{len(names)} columns of {words.pressures} for {wanted} {words.actuators} of robot.yaml"
        g.doubts.append(f"{counts}: check which column belongs to which {words.actuator}")
    if set(actuator_of) - set(chosen):
        g.doubts.append(f"set-points are ignored: {', '.join(sorted(set(actuator_of) - set(chosen)))}")
    return names


def _shared(number_of: Mapping[str, int], names: Sequence[str], robot: Robot) -> list[str | None]:
    """The column of each chamber or tendon, None where there is none, by the numbers in the headings.

    Fewer regulators than chambers that are numbered without a gap may each serve a group of neighbours."""
    wanted, numbers = len(robot.actuators.azimuths_deg), [number_of[name] for name in names]
    first = min(1, *numbers) if len(numbers) > 1 else 1
    placed = {number - first: name for number, name in zip(numbers, names, strict=True)}
    groups = robot.tendons is None and wanted % len(names) == 0 and max(placed) < len(names)
    if len(names) >= wanted or len(placed) < len(names) or groups or max(placed) >= wanted:
        return [names[k * len(names) // wanted] if len(names) <= wanted else names[k] for k in range(wanted)]
    return [placed.get(k) for k in range(wanted)]


@dataclass(frozen=True)
class _Unit:
    """Unit of a column's numbers."""

    name: str
    why: str
    absolute: bool = False
    guessed: bool = False


def _units(series: Series, names: Sequence[str], robot: Robot) -> dict[str, _Unit]:
    """By column the unit of a pressure or tension; those of which the file says none are judged together."""
    stated = {name: unit_in(series, name, KINDS["Pa" if robot.tendons is None else "N"]) for name in names}
    units: dict[str, _Unit] = {}
    for name in [name for name in names if stated[name]]:
        absolute = robot.tendons is None and _is_absolute(float(np.nanmin(series.numbers[name])), stated[name])
        units[name] = _Unit(stated[name], f"the file says {stated[name]} of {name!r}", absolute)
    if silent := [name for name in names if not stated[name]]:
        values = np.column_stack([series.numbers[name] for name in silent])
        guess = _usual(values) if robot.tendons is None else _Unit("N", "usual for tensions", guessed=True)
        units |= dict.fromkeys(silent, guess)
    return units


def _is_absolute(low: float, unit: str) -> bool:
    """Whether the lowest of pressures is the atmosphere."""
    return abs(low * KINDS["Pa"][unit] - AMBIENT) < 0.05 * AMBIENT


def _usual(pressures: Array) -> _Unit:
    """The unit in which the lowest of pressures is the atmosphere, or the highest is usual."""
    low, high = float(np.nanmin(pressures)), float(np.nanmax(pressures))
    for unit in ("kPa", "bar", "mbar", "psi", "Pa"):
        if _is_absolute(low, unit) and high > 1.02 * low:
            return _Unit(unit, f"the lowest reading, {low:.4g}, is the atmosphere in {unit}", absolute=True)
    for unit, (least, most) in USUAL_PRESSURES.items():
        if least <= high <= most:
            return _Unit(unit, f"up to {high:.4g}: usual for soft robots in {unit}", guessed=True)
    return _Unit("Pa", f"up to {high:.4g}: no usual unit", guessed=True)


# ------------------------------------------------------------------ the rest
def _others(g: Guess, series: Series, headings: Sequence[Heading], robot: Robot) -> None:
    """Propose the other columns (time, mass, spine, branch ..), with unit and doubts, and list unused ones."""
    ignored = []
    frames = _frames(series, headings)
    for h in headings:
        column = own_column(h) or quantity(h) or ("t" if h.kind == "s" and _rises(series, h.name) else None)
        if h.name == frames:
            g.say("columns.t", {"column": h.name, "scale": 0.01}, "GUESSED: no time column, and some frames are missing")
            g.doubt("columns.t.scale", "0.01 s per frame is a guess; state the true frame time")
            continue
        is_text = h.name in series.words and column not in ("branch", "protocol", "specimen")
        values = _branches(series, h.name) if column == "branch" else {}
        if column in (None, "trial", "repeat") or f"columns.{column}" in g.reasons or is_text or values is None:
            ignored.append(h.name)
            continue
        if column == "roll_deg" and changes_throughout(series.numbers[h.name]):
            g.doubts.append(f"{h.name!r} changes from row to row, so it is not the mounting angle (roll_deg); it is not used")
            continue
        entry: dict[str, Any] = {"column": h.name}
        why = f"the heading {h.name!r}"
        if stated := unit_in(series, h.name, KINDS.get(unit_of(column), ())):
            entry["unit"], why = stated, f"the file says {stated} of {h.name!r}"
        elif column == "t" and h.name in series.numbers:
            if unit := unit_of_steps(series.numbers[h.name]):
                entry["unit"], step = unit, float(np.nanmedian(np.diff(series.numbers[h.name])))
                why = f"{why}, and steps of {step:g}"
                g.doubt("columns.t", f"the file states no unit; steps of {step:g} are taken as {unit}")
        elif column in ("tip_mass", "spine_length") and float(np.nanmax(series.numbers[h.name])) > 3:
            entry["unit"] = {"tip_mass": "g", "spine_length": "mm"}[column]
            highest = f"values up to {float(np.nanmax(series.numbers[h.name])):g}"
            why = f"{why}, and {highest}"
            g.doubt(f"columns.{column}", f"the file states no unit; {highest} are taken as {entry['unit']}")
        if column == "tip_mass":
            unit, least = entry.get("unit", "kg"), float(np.nanmin(series.numbers[h.name]))
            if least < (own := robot.tip_mass / KINDS["kg"][unit]):
                replaces = f"its {least:g} {unit} and more replace robot.yaml's tip_mass of {own:g} {unit}"
                g.doubt("columns.tip_mass", f"{replaces}: if they count only what was added, write `zero: {-own:g}`")
        if column == "branch":
            entry["values"] = values
        g.say(f"columns.{column}", entry, why)
    if "columns.spine_length" not in g.reasons and robot.spine is not None:
        g.say("constants.spine_length", "0 mm", "no column names the spine")
        g.doubt("constants.spine_length", "no column names the spine of robot.yaml: was it 0 mm in all rows?")
    if ignored:
        force = any(heading(name).kind == "N" for name in ignored)
        hint = "; name a force under force_x, force_y, force_z, or as a sensor of your own (sensor_NAME)" if force else ""
        g.doubts.append(f"not used: {', '.join(ignored[:20])}{hint}")


def _frames(series: Series, headings: Sequence[Heading]) -> str | None:
    """The column that counts the rows of a long file without times, where it leaves numbers out."""
    if "time" in series.numbers or len(series) <= MANY or any(quantity(h) == "t" or h.kind == "s" for h in headings):
        return None
    counting = [h.name for h in headings if FRAME_WORDS & set(h.words) and _rises(series, h.name)]
    return next((name for name in counting if np.ptp(np.diff(series.numbers[name])) > 0), None)


def _rises(series: Series, name: str) -> bool:
    """Whether a column of numbers rises from row to row."""
    values = series.numbers.get(name, np.zeros(0))
    values = values[np.isfinite(values)]
    return len(values) > 1 and bool((np.diff(values) > 0).all())


def _branches(series: Series, name: str) -> dict[str, str] | None:
    """Word of a column -> load or unload; None where the column holds no words, or one that means neither."""
    if name not in series.words:
        return None
    known = {w: branch for branch, words in WORDS_OF_BRANCH.items() for w in words.split()}
    meanings = {
        str(w): known.get(str(w).strip().casefold()) for w in dict.fromkeys(series.words[name].tolist()) if not is_missing(str(w))
    }
    return {w: b for w, b in meanings.items() if b} if all(meanings.values()) else None


def _states(g: Guess, series: Series, pressures: Sequence[str], robot: Robot) -> None:
    """Propose plateaus as states if the pressures (columns) are mostly constant from row to row; else each row is a state."""
    if not pressures:
        return
    values = proposed_pressures(g, series, robot)
    values = values[np.isfinite(values).all(axis=1)]
    span = float(np.ptp(values)) if len(values) else 0.0
    stays = np.abs(np.diff(values, axis=0)).max(axis=1) < STEADY * span if len(values) > 1 else np.zeros(0, bool)
    stretches = 1 + int((~stays).sum())
    # with five rows of the same pressure on average, a file is a time series
    if len(values) >= 5 * stretches or (len(series) > 500 and stays.mean() > 0.5):
        words = robot.actuators.words
        steady = float(f"{STEADY * span / words.pascal:.2g}")
        why = f"{len(series)} rows with mostly constant pressures: treated as a time series"
        g.say("states.plateaus", {"steady": f"{steady:g} {words.unit}"}, why)
        if "columns.t" not in g.reasons and "time" not in series.numbers:
            g.say("source.rate", "100 Hz", "GUESSED: no column of time")
            g.doubt("source.rate", "100 rows per second is a guess; state the true rate")


# ------------------------------------------------------------------ trials
def _counts(h: Heading, series: Series) -> bool:
    """Whether a column counts trials, or counts repeats or names what is inflated and stays so for some rows."""
    names = names_inflated(h) and _branches(series, h.name) is None
    if h.stated or not (names or quantity(h) in ("trial", "repeat")):
        return False
    numbers = series.numbers.get(h.name, np.zeros(0))
    if not names and (numbers[np.isfinite(numbers)] % 1 != 0).any():
        return False
    cells = texts(series, h.name, "").tolist()
    known = [w for w in cells if w]
    return bool(known) and (quantity(h) == "trial" or sum(a != b for a, b in pairwise(known)) < len(cells) / 2)


def _trials(g: Guess, series: Series, counting: Sequence[Heading], pressures: Sequence[str], robot: Robot) -> None:
    """Propose where trials begin: where a column counts them, or at each return to rest and change of those `counting`."""
    stages: Stages | None = None
    all_changes, begin_trials = [], []
    with suppress(ConfigError):  # the import will say what is wrong
        values = g.values | {"trials": {"change": [h.name for h in counting]}}
        proposed = map_of(Proposed(series.path.name, values, {}), robot.actuators.words)
        strange = {n: s for n, s in series.strange.items() if n in proposed.trials.change}
        q = quantities_of(replace(series, strange=strange), proposed, robot.actuators.words)
        stages = Stages.of(q, proposed.states, proposed.trials.below)
        all_changes = changes(q, stages)
    for h in counting:
        changes_here = [c for c in all_changes if c.column == h.name]
        if stages is not None and not _useful(g, series, h, changes_here, stages, robot):
            continue
        # a count of trials changes in every rest and nowhere else
        counts_trials = stages is None or all([
            *stages.within(changes_here, stages.returns()), *stages.at_rest(changes_here)
        ])  # fmt: skip
        column = quantity(h)
        numbered = h.name in series.numbers and f"columns.{column}" not in g.reasons
        if numbered and (column == "repeat" or (column == "trial" and counts_trials)):
            g.say(f"columns.{column}", {"column": h.name}, f"the heading {h.name!r}")
        else:
            begin_trials.append(h.name)
    if "columns.trial" in g.reasons or not pressures:
        g.doubts += [f"not used: {', '.join(begin_trials)}"] if begin_trials else []
    elif begin_trials:
        why = f"each return to rest and each change of {' or '.join(begin_trials)} begins a trial"
        g.say("trials", {"begin": "rest", "change": begin_trials}, why)
    else:
        g.say("trials", {"begin": "rest"}, "each return to rest begins a trial")


def _useful(g: Guess, series: Series, h: Heading, changes_here: Sequence[Change], stages: Stages, robot: Robot) -> bool:
    """Whether trials may begin at these changes of a column; adds a doubt where rests of the robot contradict them."""
    away = [c for c, rests in zip(changes_here, stages.at_rest(changes_here), strict=True) if not rests]
    returns = len(stages.returns())
    if not changes_here:
        g.doubts.append(f"not used: {h.name}, which is the same in all rows")
        return False
    if not returns and not stages.resting.all():
        g.doubts.append(f"each change of {h.name!r} begins a trial, although the robot does not come to rest in between")
    elif away and returns:
        ignorable = len(away) <= len(changes_here) / 2 and len(changes_here) < len(stages.start) / 2
        driven = robot.actuators.words.fill("{actuators} are {inflated}")
        g.doubts.append(
            f"{h.name!r} changes while {driven} (first from {away[0].before!r} to {away[0].after!r} in "
            f"{series.place(away[0].row)}): {'no trial begins there; correct the cells' if ignorable else 'it is not used'}"
        )
        return ignorable
    return True
