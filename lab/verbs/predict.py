"""`lab predict`: predict the tip with 95 % intervals, or find pressures for wanted tips."""

from __future__ import annotations

import argparse
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table as Sheet

from diagnosis.data.levels import pressure_gap, vented_at_zero
from diagnosis.data.plausible import LOWEST_USUAL
from model.actuators import Words
from model.arrays import Array
from model.effects import EffectSpec
from model.errors import ModelError
from model.prediction import NORMAL_95, Prediction, Predictor
from model.prediction.campaign import ASKED, predict_campaign
from model.prediction.inverse import REACHED, inverse, limits_of
from model.prediction.predictor import outside_known
from model.prediction.spread import states_uncertainty
from model.robot import Robot
from protocols.planned import planned_rows
from recordings.json_text import plain_numbers
from recordings.numbers import whole_number
from recordings.table_file import csv_text, read_numbers
from recordings.trials import Table

from ..console import Screen, note, out, titled
from ..files.config import ConfigError, demand_writable, load
from ..files.map_file import factor
from ..files.output_folder import fate
from ..files.own_effects import stated_by
from ..files.robot_numbers import doubtful_numbers
from ..imports.headings import UNITS, unit_named
from ..options import JSON, OWN_EFFECTS, OneOf, Result, Verb, option, path_option, repeatable
from .run import Columns, planned_columns, protocol_plan, robot_facts, source_of

AT_REST = {"spine_length", "tip_mass", "roll_deg"}
"""Columns of states that are each reached from rest by one ramp."""
AT_REST_SHARE = 0.02
"""Of the highest pressure of a table, up to which a chamber is not shown as inflated."""
MM, SHOWN = 1e3, 40
"""Rows that are printed; all are written."""
INTERVAL = (
    "95 %: parameters of robot.yaml to first order, model-form error, discrepancy, {pressure}{spine} from trial to trial; "
    "of a reading also its noise"
)
NO_INTERVAL = (
    "no interval: robot.yaml is not fitted (`uncertainty` only limits a fit); `lab fit CASE --with EFFECT --out FOLDER` fits it"
)
PICTURES = (".svg", ".png", ".pdf")


def predict(robot: Robot, states: Columns, files: tuple[Path | None, Path | None], effects: Path | None) -> Result:
    """Predict the tip of states (columns of trials.csv, SI), those of a trial in order. Raises ConfigError, ModelError."""
    catalogue = stated_by(robot, effects)
    notes = _judge(robot, states)
    with Screen("predicting"):
        prediction = _with_known_intervals(robot, _predicted(robot, states, catalogue))
    bent = states["protocol"] != "stiffness" if "protocol" in states else np.ones(len(prediction.tip), bool)
    bending = {name: column[bent] for name, column in states.items() if name != "protocol"}
    unsolved = int((~prediction.converged).sum())
    missing = f"{unsolved} of {len(prediction.tip)} states have no trusted equilibrium and therefore no tip" if unsolved else ""

    def draw(path: Path) -> None:
        from ..pages.figures import tips

        tips(pressures.max(axis=1), np.asarray(lengths, float), prediction, path, robot.actuators.words)

    named = f"{robot.name}, {' + '.join(robot.effects) or 'no effect'}"
    title = f"Expected tip (end of the rod of robot.yaml, in the base frame), p in {robot.actuators.words.unit}: {named}"
    lengths, pressures, rows = bending["spine_length"], _pressures(robot, bending), prediction_rows(bending, prediction)
    sheet = partial(_sheet, title, robot, {}, lengths, pressures, prediction)
    return _result(robot, files, "states", rows, sheet, draw, missing, notes)


def _result(
    robot: Robot, files: tuple[Path | None, Path | None], kind: str, rows: list[dict[str, Any]], sheet: Callable[[], Sheet],
    draw: Callable[[Path], None], missing: str, notes: list[str],
) -> Result:  # fmt: skip
    """Write the files wanted and return the result; `kind`: name of the rows in JSON, `missing`: which have no answer.

    `notes` go with those about robot.yaml: on the screen, and in JSON."""
    csv, figure = files
    note(notes := [*(f"robot.yaml: {text}" for text in doubtful_numbers(robot)), *notes])
    written = {str(path): fate(path) for path in files if path is not None}
    if csv is not None:
        csv.write_text(csv_text([list(rows[0]), *(row.values() for row in rows)]), encoding="utf-8")
    if figure is not None:
        draw(figure.resolve())
    covered = robot.actuators.words.fill(INTERVAL, spine=" and spine" if robot.spine is not None else "")
    interval = covered if states_uncertainty(robot) else None

    def show() -> None:
        out.print(sheet())
        if len(rows) > SHOWN:
            out.print(f"{len(rows) - SHOWN} more rows; --out FILE.csv writes all")
        out.print(NO_INTERVAL if interval is None else f"± {interval}")
        for path, word in written.items():
            out.print(f"{word}: {path}")
        if missing:
            out.print(missing)

    head = {"schema": "prediction/1", "robot": robot.name, "effects": list(robot.effects), "interval": interval, "notes": notes}
    return Result({**head, "files": list(written), kind: rows}, show)


def _predicted(robot: Robot, states: Columns, catalogue: Mapping[str, EffectSpec]) -> Prediction:
    """Each state from rest if the table has no trials, whose vented chambers are taken as 0, as fits and diagnoses take them."""
    number = np.arange(len(states["spine_length"]))
    if set(states) & set(ASKED) <= AT_REST:
        roll = np.radians(np.asarray(states.get("roll_deg", 0.0 * number), float))
        mass = states.get("tip_mass")
        pressures = _pressures(robot, states)
        with warnings.catch_warnings(action="ignore"):  # `_judge` names what is outside the robot's limits
            return Predictor(robot, catalogue)(pressures, states["spine_length"], mass, roll, intervals=True)
    if "trial" in states:
        read, table = _pressures(robot, states), Table(states)
        taken = vented_at_zero(read, table.trial, pressure_gap(table))
        states = {**states, **{f"p{c}": own for c, own in enumerate(taken.T, 1)}}
    return predict_campaign(robot, {"trial": number, **states}, catalogue, intervals=True)


def invert(
    robot: Robot,
    targets_path: Path,
    files: tuple[Path | None, Path | None],
    effects: Path | None,
    spine_length: float | None,
    groups: tuple[tuple[int, ...], ...] | None,
) -> Result:
    """Pressures and spine lengths (m; None: free) for wanted tips; `groups` share a regulator. Raises ConfigError, ModelError."""
    table, _ = _columns_in_si(targets_path, "w?[xyz]", "x, y, z (m, or x [mm] ..)", robot.actuators.words)
    m = len(next(iter(table.values())))
    place = np.stack([np.asarray(table.get(k, np.full(m, np.nan)), float) for k in "xyz"], axis=1)  # NaN: free
    if (none := ~np.isfinite(place).any(axis=1)).any():
        raise ConfigError(f"{targets_path}: row {int(np.argmax(none)) + 1} has no coordinate; give x, y or z in m")
    weight = np.stack([np.asarray(table.get(f"w{k}", np.ones(m)), float) for k in "xyz"], axis=1)
    weight = np.where(np.isfinite(weight), weight, 1.0)
    try:
        limits = limits_of(robot, groups, spine=None if spine_length is None else (spine_length, spine_length))
        with Screen(f"searching {robot.actuators.words.pressures}") as screen, warnings.catch_warnings(action="ignore"):
            predictor = Predictor(robot, stated_by(robot, effects))
            reached = inverse(predictor, place, limits, weight, lambda share: screen.progress(share, 1.0))
        reached = replace(reached, prediction=_with_known_intervals(robot, reached.prediction))
    except ModelError as e:
        raise ConfigError(f"{targets_path}: {e}") from e
    missed, missing = np.flatnonzero(~reached.reached), ""
    if missed.size:
        nearest = ", ".join(f"{i + 1} ({MM * reached.miss[i]:.1f} mm)" for i in missed[:10].tolist())
        missing = (
            f"{missed.size} of {len(place)} targets are out of reach within the limits; distance of the nearest reachable point: "
            f"{nearest}{' ..' if missed.size > 10 else ''}"
        )

    def draw(path: Path) -> None:
        from ..pages.figures import targets

        targets(place, reached, path)

    def sheet() -> Sheet:
        words, there = robot.actuators.words, zip(reached.reached.tolist(), reached.miss.tolist(), strict=True)
        lead = {
            "target, mm": [" ".join("any" if np.isnan(v) else f"{MM * v:.1f}" for v in target) for target in place],
            "there": ["yes" if yes else f"{MM * miss:.1f} mm off" for yes, miss in there],
        }
        title = f"{words.pressures.capitalize()} for wanted tips, p in {words.unit} (there: within {MM * REACHED:g} mm)"
        return _sheet(title, robot, lead, reached.spine_length, reached.pressures, reached.prediction, model_only=True)

    _, notes = outside_known(robot, reached.pressures, reached.spine_length)
    columns: Columns = {f"target_{k}": place[:, i] for i, k in enumerate("xyz")}
    columns |= {"reached": reached.reached, "miss": reached.miss}
    columns |= {f"p{c}": pressure for c, pressure in enumerate(reached.pressures.T, 1)}
    columns["spine_length"] = reached.spine_length
    rows = _rows(columns | _with_ends("xyz", reached.prediction.tip, *reached.prediction.interval(model_only=True)))
    return _result(robot, files, "targets", rows, sheet, draw, missing, notes)


def table_states(path: Path, words: Words) -> Columns:
    """Columns (SI) of the states in a table: trials.csv, or one with p1 .. and spine_length (default 0) alone.

    Without a unit in its heading a column is in SI. Raises ConfigError, also for pressures too low for Pa."""
    needed = f"p1 .. (Pa) or p1 [{words.unit}] .., and with a spine spine_length (m)"
    columns, in_unit = _columns_in_si(path, "|".join(("p[0-9]+", *ASKED)), needed, words)
    for name, column in columns.items():
        if column.dtype == np.float64 and np.isnan(column).all():
            raise ConfigError(f"{path}: the column {name} is empty, leave it out")
    columns.setdefault("spine_length", np.zeros(len(next(iter(columns.values())))))
    bare = {name: column for name, column in columns.items() if re.fullmatch(r"p\d+", name) and name not in in_unit}
    highest, name = max(((float(np.nanmax(np.abs(column))), name) for name, column in bare.items()), default=(0.0, ""))
    if 0 < highest < LOWEST_USUAL:
        raise ConfigError(
            f"{path}: column {name}: the highest {words.pressure} is {highest:g} Pa, which looks like another unit; write Pa "
            f"({highest:g} {words.unit} is {words.pascal * highest:g}), or name the column '{name} [{words.unit}]'"
        )
    return columns


def _columns_in_si(path: Path, pattern: str, needed: str, words: Words) -> tuple[Columns, set[str]]:
    """Columns whose names match the pattern, in SI, and those of them in whose headings a unit stands. Raises ConfigError."""
    columns, in_unit = Columns(), set[str]()
    in_heading = re.compile(rf"(?i)({pattern})(?:\s*[\[(](.+)[\])]|_({'|'.join(map(re.escape, UNITS))}))?")
    for heading, column in read_numbers(path, (), in_heading.pattern, needed).items():
        found = in_heading.fullmatch(heading)
        assert found is not None  # the columns that it matches are read
        name, stated = found[1].lower(), found[2] or found[3] or ""
        if name in columns:
            raise ConfigError(f"{path}: several columns are {name}, such as {heading!r}: leave one out")
        kind, unit = unit_named(stated) or ("", stated.strip())
        if re.fullmatch(r"p\d+", name) and kind == ("Pa" if words.unit == "N" else "N"):
            raise ConfigError(
                f"{path}: column {heading!r}: a robot with {words.kind} takes {words.pressures} in {words.unit} (1 {words.unit} "
                f"is {words.pascal:g} Pa in tables): convert the column and name it '{name} [{words.unit}]'"
            )
        columns[name] = column if not unit else column * factor(unit, name, words, f"{path}: column {heading!r}: unit")
        in_unit |= {name} if unit else set()
    return columns, in_unit


def _with_known_intervals(robot: Robot, prediction: Prediction) -> Prediction:
    """The same without an interval where robot.yaml is not fitted."""
    if states_uncertainty(robot):
        return prediction
    sd: dict[str, Any] = {n: getattr(prediction, n) for n in ("model_sd", "sd", "orientation_sd", "shape_sd")}
    unknown: dict[str, Any] = {n: None if own is None else np.full(own.shape, np.nan) for n, own in sd.items()}
    return replace(prediction, **unknown)


def protocol_states(protocol: str, settings: list[str], robot: Robot) -> Columns:
    """The states that a protocol will read, as its plan has them; raises ConfigError for one that inflates nothing."""
    known = robot_facts(robot)
    _, parameters, plan = protocol_plan(source_of(protocol, settings), known)
    rows = planned_rows(plan, parameters, known.chambers)
    if not any(row[name] for row in rows for name in row if re.fullmatch(r"p\d+", name)):
        raise ConfigError(f"protocol {plan.protocol}: inflates no chamber, so there is no tip to predict")
    return {name: column for name, column in planned_columns(rows, robot).items() if name not in ("step", "repeat", "protocol")}


def prediction_rows(states: Columns, prediction: Prediction) -> list[dict[str, Any]]:
    """One flat row per state: set-points, then the reading and the ends of its interval, SI."""
    assert prediction.orientation_sd is not None and prediction.shape_sd is not None
    columns = {**states, **_with_ends("xyz", prediction.tip, *prediction.interval())}
    columns |= dict(zip(("qw", "qx", "qy", "qz"), prediction.orientation.T, strict=True))
    columns |= dict(zip(("sd_rx", "sd_ry", "sd_rz"), prediction.orientation_sd.T, strict=True))
    for m in range(prediction.shape.shape[1]):
        place, half = prediction.shape[:, m], NORMAL_95 * prediction.shape_sd[:, m]
        columns |= _with_ends([f"m{m + 1}{k}" for k in "xyz"], place, place - half, place + half)
    return _rows(columns)


def _with_ends(names: Sequence[str], value: Array, low: Array, high: Array) -> Columns:
    """Columns of (n, 3) values, then of the ends of their intervals."""
    ends = {f"{name}_{end}": of[:, k] for k, name in enumerate(names) for end, of in (("low", low), ("high", high))}
    return {**dict(zip(names, value.T, strict=True)), **ends}


def _rows(columns: Columns) -> list[dict[str, Any]]:
    """Values for JSON; None for a missing number."""
    cells = zip(*(column.tolist() for column in columns.values()), strict=True)
    return plain_numbers([dict(zip(columns, row, strict=True)) for row in cells])  # type: ignore[no-any-return]


def _pressures(robot: Robot, states: Columns) -> Array:
    none, count = np.zeros(len(states["spine_length"])), len(robot.actuators.azimuths_deg)
    return np.stack([np.asarray(states.get(f"p{c}", none), float) for c in range(1, count + 1)], axis=1)


def _judge(robot: Robot, states: Columns) -> list[str]:
    """Notes about actuators without a column and states where the model was never compared with the robot (`outside_known`).

    Raises ConfigError for columns of actuators that it lacks or of none, BadCondition for a tendon that pushes."""
    own, words = range(1, len(robot.actuators.azimuths_deg) + 1), robot.actuators.words
    given = {int(name[1:]) for name in states if re.fullmatch(r"p\d+", name)}
    if not given:
        raise ConfigError(f"the table has no {words.pressures}: give columns p1 .. p{own[-1]}, in Pa, or p1 [{words.unit}] ..")
    if unknown := sorted(given - {*own}):
        raise ConfigError(f"column p{unknown[0]}: {robot.name} has {words.group(own)}; leave the column out")
    lacking, lengths = sorted({*own} - given), np.asarray(states["spine_length"], float)
    _, outside = outside_known(robot, np.nan_to_num(_pressures(robot, states)), lengths, states.get("tip_mass"))
    return [f"no column of {words.group(lacking)}: taken as 0 {words.unit}"] * bool(lacking) + outside


def _sheet(
    title: str, robot: Robot, lead: Mapping[str, Sequence[str]], lengths: Array, pressures: Array, prediction: Prediction,
    model_only: bool = False,
) -> Sheet:  # fmt: skip
    """The first states and predicted tips (± half of the interval, mm) as a table, behind the columns `lead`."""
    low, high = prediction.interval(model_only)
    words, spine, count = robot.actuators.words, robot.spine is not None, pressures.shape[1]
    # chambers of a robot with more are listed in one column
    one_by_one, idle = count <= 4, AT_REST_SHARE * float(np.nan_to_num(pressures).max(initial=0.0))
    columns = [f"p{c}" for c in range(1, count + 1)] if one_by_one else [f"p ({words.actuators})"]
    t = titled(title, (), (), (*lead, *(("spine",) if spine else ()), *columns, "x, mm", "y, mm", "z, mm"))
    for i in range(min(len(pressures), SHOWN)):
        t.add_row(
            *(cells[i] for cells in lead.values()),
            *([f"{100 * float(lengths[i]):.1f} cm"] if spine else []),
            *([words.number(p, 1) for p in pressures[i]] if one_by_one else [_inflated(pressures[i], words, idle)]),
            *(
                "none" if not np.isfinite(v) else f"{MM * v:.2f}" + (f" ± {MM * (h - l) / 2:.2f}" if h >= l else "")
                for v, l, h in zip(prediction.tip[i], low[i], high[i], strict=True)
            ),
        )
    return t


def _inflated(pressures: Array, words: Words, idle: float) -> str:
    """Pressure or tension and, in brackets, the actuators that have it, without those up to `idle` Pa: noise of a gauge."""
    by: dict[str, list[str]] = {}
    for c, p in enumerate(pressures.tolist(), 1):
        if p > idle:
            by.setdefault(words.number(p, 1), []).append(str(c))
    return "; ".join(f"{number} ({', '.join(own)})" for number, own in by.items()) or "none"


def _groups(text: str) -> tuple[tuple[int, ...], ...]:
    """Chambers between commas, groups between blanks."""
    try:
        return tuple(tuple(whole_number(c) for c in group.split(",")) for group in text.split())
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: separate chambers by commas and groups by spaces") from None


def _predict_verb(a: argparse.Namespace) -> Result:
    robot, files = load(a.robot, Robot), (a.out, a.figure)
    demand_writable(*files)  # before minutes are spent
    if a.figure is not None and a.figure.suffix not in PICTURES:
        raise ConfigError(f"--figure {a.figure}: must end in {', '.join(PICTURES)}")
    if a.inverse is not None:
        return invert(robot, a.inverse, files, a.effects, a.spine_length, a.groups)
    states = table_states(a.table, robot.actuators.words) if a.table else protocol_states(a.protocol, a.set, robot)
    return predict(robot, states, files, a.effects)


GIVEN = OneOf(
    option("--protocol", help="predict the states of a protocol: its name or its file (.yaml, .py)"),
    path_option(
        "--table",
        "STATES.csv",
        "predict the states of a table: p1 .. in Pa ('p1 [kPa]', tendons 'p1 [N]'), spine_length in m; or a trials.csv",
    ),
    path_option("--inverse", "TARGETS.csv", "find pressures for these tips: x, y, z in m; an empty cell is free"),
    required=True,
)

VERBS = (
    Verb(
        "predict",
        _predict_verb,
        options=(
            JSON,
            path_option("--robot", "ROBOT.yaml", "robot.yaml, with its effects (lab fit --with)", required=True),
            GIVEN,
            repeatable("--set", "KEY=VALUE", "with --protocol: change one parameter"),
            option("--spine-length", type=float, metavar="M", help="with --inverse: keep the spine at this length, m"),
            option(
                "--groups", "'9,1,2 3,4,5'", "with --inverse: chambers that share a regulator (others stay vented)", type=_groups
            ),
            path_option("--out", "FILE.csv", "write all rows to this file"),
            path_option("--figure", "FILE.svg", "draw them in this file (.svg, .png or .pdf)"),
            OWN_EFFECTS,
        ),
        examples=(
            "lab predict --robot fitted/robot.yaml --protocol bending",
            "lab predict --robot fitted/robot.yaml --inverse targets.csv",
        ),
        page="docs/howto/use-the-answer.md",
    ),
)
