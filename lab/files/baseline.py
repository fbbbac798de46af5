"""Another simulator's predictions of the measured states, from a table or from the simulator itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.on_baseline import Baseline
from model.arrays import Array, Ints
from model.condition import conditions
from model.effects.nominal import TOLERANCES
from model.effects.spec import EffectSpec
from model.effects.tolerance import AREA
from model.errors import ModelError, nearest
from model.robot import Robot
from model.simulators import GROUP, OWN, Forward, Readings
from recordings.table_file import read_numbers
from recordings.trials import ORIENTATION, TIP, Table, marker_columns, pressure_columns

from .config import ConfigError
from .inputs import Case
from .packages import installed, python_file, without

Columns = dict[str, NDArray[np.generic]]

PRESSURE_WITHIN, SPINE_WITHIN = 5e3, 5e-3
"""Pa and m within which a predicted state stands for a measured one; the rod bridges the rest."""
TOGETHER = (2e-3, 3e3, 1e-4, 1e-3, 1e-3, 1e-3, 1e-3)
"""m of spine, Pa, kg at the tip, rad of roll and N on the tip within which one setting is simulated for several readings."""
BEHIND = len(TOGETHER) - 2
"""Numbers of a setting behind its pressures."""
SETTING = ("spine_length", "tip_mass", "roll_deg")
READ = (*TIP, *ORIENTATION)


def from_table(path: Path, case: Case) -> Baseline:
    """Predictions of a CSV file, matched by trial and step, or by state. Raises ConfigError and BadTable."""
    predicted = read_numbers(path, ("trial", "step", *SETTING, *READ), r"p[0-9]+|m[0-9]+[xyz]", "x, y, z (m)")
    missing = [name for name in "xyz" if name not in predicted]
    if missing:
        raise ConfigError(f"{path}: has no column {missing[0]}; a baseline must predict the tip: x, y, z in m, base frame")
    place = _by_step(path, predicted, case) if {"trial", "step"} <= predicted.keys() else _by_state(path, predicted, case)
    baseline = _baseline(path.name, predicted, place, case)
    _demand_plausible(str(path), baseline, case)
    return baseline


def _by_step(path: Path, predicted: Columns, case: Case) -> Ints:
    """(rows,) line of the file for each row of the table, -1 where it has none."""
    keys = list(zip(predicted["trial"].tolist(), predicted["step"].tolist(), strict=True))
    twice = next((k for k in dict.fromkeys(keys) if keys.count(k) > 1), None)
    if twice is not None:
        raise ConfigError(f"{path}: trial {twice[0]:g} step {twice[1]:g} is predicted twice; keep one")
    line, table = {key: i for i, key in enumerate(keys)}, case.table
    place = np.array([line.get((float(t), float(s)), -1) for t, s in zip(table.trial, table["step"], strict=True)])
    if (place < 0).all():
        raise ConfigError(f"{path}: predicts none of the {len(place)} states of the table; match its columns trial and step")
    return place


def _by_state(path: Path, predicted: Columns, case: Case) -> Ints:
    """(rows,) line of the file's nearest state, within `SPINE_WITHIN` and `PRESSURE_WITHIN`; -1: none. Raises ConfigError."""
    pressures = [f"p{i}" for i in range(1, len(case.robot.actuators.azimuths_deg) + 1)]
    missing = [name for name in pressures if name not in predicted]
    if missing:
        raise ConfigError(
            f"{path}: has neither trial and step nor {missing[0]}; give the columns trial and step, or the state: "
            f"spine_length (m) and p1..p{len(pressures)} (Pa)"
        )
    predicted_pressures = np.column_stack([np.asarray(predicted[name], float) for name in pressures])
    highest, measured = float(np.nanmax(predicted_pressures)), float(np.nanmax(case.table.pressures, initial=0.0))
    if measured > PRESSURE_WITHIN and highest < 0.01 * measured:  # in another unit
        text = f"its highest pressure is {highest:g} Pa, that of the table {measured:g} Pa; pressures are in Pa"
        raise ConfigError(f"{path}: {text}")
    spine = np.asarray(predicted.get("spine_length", np.zeros(len(predicted_pressures))), float)
    settings = [name for name in ("tip_mass", "roll_deg") if name in predicted]
    line_of_row, table = np.full(len(case.table), -1), case.table
    lengths, measured_settings = np.clip(table.spine_length, 0.0, None), {n: table.get(n, 0.0) for n in settings}
    for i, pressures_read in enumerate(table.pressures):
        by_pressure = np.abs(predicted_pressures - pressures_read).max(axis=1) / PRESSURE_WITHIN
        distance = np.maximum(by_pressure, np.abs(spine - lengths[i]) / SPINE_WITHIN)
        for name in settings:
            distance[np.asarray(predicted[name], float) != measured_settings[name][i]] = np.inf
        nearest = int(np.nanargmin(distance)) if np.isfinite(distance).any() else 0
        line_of_row[i] = nearest if distance[nearest] <= 1.0 else -1
    if (line_of_row < 0).all():
        raise ConfigError(
            f"{path}: predicts none of the {len(line_of_row)} states of the table to {PRESSURE_WITHIN / 1e3:g} kPa and "
            f"{SPINE_WITHIN * 1e3:g} mm of spine; pressures are in Pa, lengths in m"
        )
    return line_of_row


def _baseline(name: str, predicted: Columns, place: Ints, case: Case) -> Baseline:
    """The columns of a file as a baseline: `place` (rows,) names its line for each row of the case's table, -1 for none (NaN)."""
    table, (setting, read) = case.table, _names(case)
    measured = dict(zip(setting, (np.clip(table.spine_length, 0.0, None), *table.pressures.T), strict=True))
    columns = measured | dict.fromkeys(read, np.full(len(table), np.nan))
    for column in columns.keys() & predicted.keys():
        columns[column] = np.where(place >= 0, np.asarray(predicted[column], float)[np.maximum(place, 0)], columns[column])
    return Baseline(name, Table(columns))


def _names(case: Case) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The columns of a case by which its states are known to a simulator, and those that it may predict."""
    chambers, markers = len(case.robot.actuators.azimuths_deg), len(case.robot.markers)
    return ("spine_length", *pressure_columns(chambers)), (*READ, *sum(marker_columns(markers), ()))


def _demand_plausible(name: str, made: Baseline, case: Case) -> None:
    """Refuse predictions in mm or with z upside down, as for measurements. Raises ConfigError."""
    from diagnosis.edits.reading import read  # with the rod, which no recording alone needs

    measured = {n: c for n, c in case.table.values.items() if n[0] not in "mq"}
    predicted = {n: c for n, c in made.predicted.values.items() if n[0] in "xyzp"}
    states = replace(case.table, values=measured | predicted, mapped=None).take(made.predicted.with_tip)
    if refused := read(case.robot, states).refused:
        raise ConfigError("\n".join(f"{name}: {text}" for text in refused))


def simulator(name: str, robot: Robot) -> tuple[str, Forward]:
    """A simulator of the robot, by the name under which a package announces it or by the Python file with its SIMULATOR."""
    if name.endswith(".py"):
        return Path(name).stem, _made(name, getattr(python_file(Path(name))[0], "SIMULATOR", None), robot)
    if name in OWN:
        module, thing = OWN[name]
        try:
            return name, _made(name, getattr(import_module(module), thing), robot)
        except ImportError as e:
            raise ConfigError(f"--simulator {name}: is not installed ({e}); pip install 'softlab[{name}]'") from e

    faults = without(lambda thing: "" if callable(thing) else "must be a class or function that takes the robot")
    listed = installed(GROUP, dict.fromkeys(OWN, object()), faults)
    if name in listed.broken:
        raise ConfigError(listed.broken[name])
    if name not in listed.usable:
        raise ConfigError(
            f"--simulator {name}: is unknown, {nearest(name, listed.usable)}; give its name, or a Python file with a SIMULATOR"
        )
    return name, _made(name, listed.usable[name], robot)


def _made(place: str, thing: object, robot: Robot) -> Forward:
    if not callable(thing):
        raise ConfigError(
            f"{place}: has no SIMULATOR, a class or function that takes the robot; see model/simulators/__init__.py"
        )
    try:
        made = thing(robot)
    except (ImportError, ModelError, TypeError, ValueError) as e:
        raise ConfigError(f"{place}: SIMULATOR fails for this robot: {type(e).__name__}: {e}") from e
    if not isinstance(made, Forward):
        raise ConfigError(
            f"{place}: SIMULATOR must give `parameters` and `predict(states, parameters)`; see model/simulators/__init__.py"
        )
    return made


def from_simulator(
    name: str,
    forward: Forward,
    case: Case,
    catalogue: Mapping[str, EffectSpec],
    progress: Callable[[float, float], None],
    varied: bool = True,
) -> Baseline:
    """Return a simulator's predictions of a case, nominal and, if wanted, with each of its own parameters varied.

    Each setting is simulated once. Raises ConfigError for results that violate `Forward`."""
    specs = (*catalogue.values(), *TOLERANCES.values(), AREA)
    scale = {f"{spec.id}.{p.name}": p.scale for spec in specs for p in spec.parameters}
    unknown = [p for p in forward.parameters if p not in scale]
    if unknown:
        raise ConfigError(f"simulator {name}: parameter {unknown[0]!r} is not known; `lab effects --json` lists the names")
    settings = _settings(case)
    distinct, place = _distinct(settings)
    states = [distinct[i : i + 8] for i in range(0, len(distinct), 8)]  # eight a call, so that progress is seen
    steps = [(p, 0.1 * scale[p]) for p in forward.parameters] if varied else []  # a tenth of each plausible size
    variants: list[tuple[str, float]] = [("", 0.0), *steps]
    baselines: dict[str, Baseline] = {}
    for v, (parameter, step) in enumerate(variants):
        parts: list[Array] = []
        for i, part in enumerate(states):
            try:
                mass, roll, force = part[:, -BEHIND], part[:, 1 - BEHIND], part[:, 2 - BEHIND :]
                states_of_part = conditions(case.robot, part[:, 0], part[:, 1:-BEHIND], mass, roll, force)
                read = forward.predict(states_of_part, {parameter: step} if parameter else {})
            except Exception as e:
                raise ConfigError(f"simulator {name}: predict failed: {type(e).__name__}: {e}") from e
            parts.append(_arrays(name, read, len(part), len(case.robot.markers)))
            progress(v * len(states) + i + 1, len(variants) * len(states))
        columns = np.hstack([distinct[:, :-BEHIND], np.concatenate(parts)])[place].T
        baselines[parameter] = Baseline(name, Table(dict(zip(sum(_names(case), ()), columns, strict=True))))
    _demand_plausible(f"simulator {name}", baselines[""], case)
    return replace(baselines[""], varied={p: (step, baselines[p]) for p, step in variants if p})


def _distinct(settings: Array) -> tuple[Array, Ints]:
    """Some of settings (n, ..), (m, ..), and which of them stands for each (n,): the first that is near enough."""
    within = np.array([TOGETHER[0], *[TOGETHER[1]] * (settings.shape[1] - BEHIND - 1), *TOGETHER[2:]])
    kept: list[int] = []
    place = np.empty(len(settings), np.int64)
    for i, own in enumerate(settings):
        near = np.flatnonzero((np.abs(settings[kept] - own) <= within).all(axis=1)) if kept else np.zeros(0, np.int64)
        if not near.size:
            kept.append(i)
        place[i] = near[0] if near.size else len(kept) - 1
    return settings[kept], place


def _settings(case: Case) -> Array:
    """(n, 1 + chambers + 5): spine length, pressures, mass, roll (rad) and force at the tip of each state."""
    table = case.table
    mass, roll = table.get("tip_mass", case.robot.tip_mass), np.radians(table.get("roll_deg", 0.0))
    return np.column_stack([np.clip(table.spine_length, 0.0, None), table.pressures, mass, roll, table.tip_force])


def _arrays(name: str, read: Readings, n: int, markers: int) -> Array:
    """(n, ..) tip, orientation and markers of n states that a simulator read, NaN what it did not; raises ConfigError."""
    if not isinstance(read, Readings):
        raise ConfigError(f"simulator {name}: predict gave {type(read).__name__}, must give model.simulators.Readings")
    arrays: list[Array] = []
    for what, shape in (("tip", (n, 3)), ("orientation", (n, 4)), ("markers", (n, markers, 3))):
        given = getattr(read, what)
        values = np.full(shape, np.nan) if given is None else np.asarray(given, float)
        if values.shape != shape:
            raise ConfigError(f"simulator {name}: {what} has the shape {values.shape}, must be {shape}")
        arrays.append(values.reshape(n, -1))
    return np.hstack(arrays)
