"""Another simulator's predictions of the measured states, from a table or from the simulator itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from diagnosis.data.campaign import settings
from diagnosis.inference.on_baseline import Baseline
from model.arrays import Array, Ints
from model.condition import conditions
from model.effects.nominal import tolerances
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

TOGETHER = (2e-3, 3e3, 1e-4, 1e-3, *[1e-3] * 3, *[1e-4] * 3)
"""m of spine, Pa, kg at the tip, rad of roll, N and N m on the tip within which one setting is simulated for several readings."""
BEHIND = len(TOGETHER) - 2
"""Numbers of a setting behind its pressures."""
READ = (*TIP, *ORIENTATION)


def from_table(path: Path, case: Case) -> Baseline:
    """Predictions of a CSV file, matched by trial and step. Raises ConfigError and BadTable."""
    predicted = read_numbers(path, ("trial", "step", "spine_length", *READ), r"p[0-9]+|m[0-9]+[xyz]", "x, y, z (m)")
    missing = [name for name in ("trial", "step", *TIP) if name not in predicted]
    if missing:
        needed = "trial and step name the row of trials.csv; x, y, z are its tip in m, base frame"
        raise ConfigError(f"{path}: has no column {missing[0]}; {needed}")
    keys = list(zip(predicted["trial"].tolist(), predicted["step"].tolist(), strict=True))
    twice = next((k for k in dict.fromkeys(keys) if keys.count(k) > 1), None)
    if twice is not None:
        raise ConfigError(f"{path}: trial {twice[0]:g} step {twice[1]:g} is predicted twice; keep one")
    line, table, (setting, read) = {key: i for i, key in enumerate(keys)}, case.table, _names(case)
    place = np.array([line.get((float(t), float(s)), -1) for t, s in zip(table.trial, table["step"], strict=True)])
    if (place < 0).all():
        raise ConfigError(f"{path}: predicts none of the {len(place)} states of the table; match its columns trial and step")
    measured = dict(zip(setting, (np.clip(table.spine_length, 0.0, None), *table.pressures.T), strict=True))
    columns = measured | dict.fromkeys(read, np.full(len(table), np.nan))
    for column in columns.keys() & predicted.keys():
        columns[column] = np.where(place >= 0, np.asarray(predicted[column], float)[np.maximum(place, 0)], columns[column])
    baseline = Baseline(path.name, Table(columns))
    _demand_plausible(str(path), baseline, case)
    return baseline


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
    specs = (*catalogue.values(), *tolerances(case.robot).values(), AREA)
    scale = {f"{spec.id}.{p.name}": p.scale for spec in specs for p in spec.parameters}
    if unknown := [p for p in forward.parameters if p not in scale]:
        raise ConfigError(f"simulator {name}: parameter {unknown[0]!r} is not known; `lab effects --json` lists the names")
    s = settings(case.robot, case.table)
    distinct, place = _distinct(np.column_stack([s.spine_length, s.pressure, s.tip_mass, s.roll, s.force, s.moment]))
    states = [distinct[i : i + 8] for i in range(0, len(distinct), 8)]  # eight a call, so that progress is seen
    variants = [("", 0.0), *((p, 0.1 * scale[p]) for p in forward.parameters if varied)]  # a tenth of each plausible size
    baselines: dict[str, Baseline] = {}
    for v, (parameter, step) in enumerate(variants):
        parts: list[Array] = []
        for i, part in enumerate(states):
            try:
                mass, roll = part[:, -BEHIND], part[:, 1 - BEHIND]
                states_of_part = conditions(case.robot, part[:, 0], part[:, 1:-BEHIND], mass, roll, part[:, -6:-3], part[:, -3:])
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
