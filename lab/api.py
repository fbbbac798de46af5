"""The names behind `import lab`: what a person uses from Python, in a notebook or a script of their own.

The package `lab` says how to begin. Everything is in SI units. Errors are those of the command: `ConfigError`,
`RecordingError`, `InstrumentError` and so on, each with what to do.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from model.robot import Robot

from .files.config import ConfigError, check, load, read_yaml

if TYPE_CHECKING:  # what solves, diagnoses, records and draws is loaded by what uses it
    from numpy.typing import ArrayLike

    from diagnosis.answer.result import Diagnosis
    from diagnosis.diagnose import Options
    from diagnosis.fit_effects import Fitted
    from model.prediction import Prediction
    from model.prediction.inverse import Reached
    from recordings.file.reader import Recording

    from .comparison import Comparison
    from .files.inputs import Case
    from .rig.assembly import Rig

Place = str | Path


def load_robot(path: Place) -> Robot:
    """The robot of a robot.yaml; numbers in it may carry units. Raises ConfigError.

    >>> robot = load_robot("robot.yaml")
    >>> robot.length, len(robot.actuators.azimuths_deg)
    (0.4, 9)
    """
    return load(Path(path), Robot)


def case(*inputs: Any, robot: Place | Robot | None = None, columns: Mapping[str, Any] | None = None, **keys: Any) -> Case:
    """Recordings (.mcap) and case folders as one: `case.robot`, and `case.table` with a row a state.

    `robot`: a robot.yaml or Robot in place of the input's. Raises ConfigError, RecordingError.

    >>> measured = case("campaign")
    >>> len(measured.table), measured.table["x"].shape
    (18, (18,))

    Or a pandas DataFrame and its robot: `case(frame, robot)`. `columns`: column of trials.csv -> heading, `"P_left [bar]"` for a
    column `P_left`, or entry of map.yaml; others go by their names, in SI. `keys`: further keys of map.yaml.
    Warns of doubts, kept in `case.table.warnings`.
    """
    from .files.inputs import read_case

    if inputs and not isinstance(inputs[0], str | Path):
        return _warned(_case_of_frame(*inputs, robot=robot, columns=columns, keys=keys))
    if not inputs:
        raise ConfigError("case: nothing is given; give recordings, a case folder, or a DataFrame and its robot")
    if columns or keys:
        given = ", ".join([*(["columns"] if columns else []), *keys])
        raise ConfigError(f"case: {given}: only with a DataFrame; of a file, lab import writes a case folder by a map")
    return _warned(read_case([Path(place) for place in inputs], Path(robot) if isinstance(robot, str) else robot))


def _warned(made: Case) -> Case:
    """The case, after a warning for each doubt about its table, at the line that asked for it."""
    for text in made.table.warnings:
        warnings.warn(text, stacklevel=3)
    return made


def _case_of_frame(
    frame: Any, *others: Any, robot: Place | Robot | None, columns: Mapping[str, Any] | None, keys: Mapping[str, Any]
) -> Case:
    """The case of a DataFrame and its robot (the second argument, or `robot`); raises ConfigError."""
    from .files.inputs import case_of
    from .imports.frame import trials_of  # with pandas

    if not hasattr(frame, "iloc") or not hasattr(frame, "columns"):
        raise ConfigError(f"case: {type(frame).__name__} is neither the path of a recording or a case folder nor a DataFrame")
    robots = [*others, *([] if robot is None else [robot])]
    if len(robots) != 1:
        raise ConfigError(f"case: a DataFrame needs one robot, {len(robots)} are given; write lab.case(frame, 'robot.yaml')")
    name, text = "robot", ""
    if not isinstance(robots[0], Robot):
        source = read_yaml(Path(robots[0]))
        robots, name, text = [check(source, Robot)], source.name, source.text.decode()
    return case_of(robots[0], [("DataFrame", trials_of(frame, robots[0], columns, **keys))], name, text)


def read(path: Place, truncated: bool = False) -> Recording:
    """A recording: `stream("/tip")` as a structured array, `trials`, `metadata`. Raises RecordingError.

    >>> recording = read("run.mcap")
    >>> recording.outcome, recording.stream("/tip")["position"].shape
    ('completed', (112, 3))
    """
    from recordings.file.reader import Recording

    return Recording.open(Path(path), truncated=truncated)


def predict(robot: Robot, pressures: ArrayLike, spine_length: ArrayLike = 0.0, **options: Any) -> Prediction:
    """Tip, orientation and `shape`, the places of the markers, by the Cosserat rod model; NaN where there is no equilibrium.

    `pressures` (n, chambers) or (chambers,) Pa gauge; `spine_length` m, one or (n,). `options`: `tip_mass` kg, `roll` rad of the
    body in its mount; `intervals=True`: with 95 % intervals; `gradient=True`: with the slopes by pressure and spine length; and
    the others of `model.prediction.Predictor`. Raises BadRobot, BadCondition.

    >>> robot = load_robot("robot.yaml")
    >>> found = predict(robot, [[60e3] * 3 + [0] * 6, [80e3] * 3 + [0] * 6], spine_length=[0.0, 0.1], gradient=True)
    >>> found.tip.shape, found.orientation.shape, found.shape.shape, found.tip_by_pressure.shape
    ((2, 3), (2, 4), (2, 0, 3), (2, 3, 9))
    >>> found.to_frame().round(0)["tip x [mm]"].tolist()
    [-23.0, -34.0]
    """
    from model.prediction import Predictor

    from .files.own_effects import stated_by

    return Predictor(robot, stated_by(robot))(pressures, spine_length, **options)


def inverse(
    robot: Robot, targets: ArrayLike, spine_length: float | None = None, groups: Sequence[Sequence[int]] | None = None
) -> Reached:
    """Pressures (and spine lengths, unless one is given in m) of least total pressure that bring the tip to `targets` (m, 3)
    m, NaN where a coordinate is free; and where the tip will be. Raises BadCondition.

    `groups`: chambers, counted from 1, that share a regulator; each has its own unless given.

    >>> found = inverse(load_robot("robot.yaml"), [[-0.05, float("nan"), float("nan")]], spine_length=0.1)
    >>> found.reached, found.prediction.tip.round(3)[0, 0]
    (array([ True]), np.float64(-0.05))
    """
    from model.prediction import Predictor
    from model.prediction.inverse import inverse as _inverse
    from model.prediction.inverse import limits_of

    from .files.own_effects import stated_by

    fixed = None if spine_length is None else (spine_length, spine_length)
    return _inverse(Predictor(robot, stated_by(robot)), targets, limits_of(robot, groups, spine=fixed))


Robot.predict, Robot.inverse = predict, inverse


def fit(measured: Case, effects: str | Sequence[str] = (), residual: bool = False, set_up: bool = False) -> Fitted:
    """The calibrated robot, `.robot`, and what was fitted, with its uncertainty. Raises ConfigError, DiagnosisError, BadEffect.

    Without effects: moduli from stiffness trials and area factors from tips. `effects`: these, area factor and tolerances, which
    `set_up` fits also without any.
    `residual`: what the model still misses is learnt on top, for predictions.

    >>> fitted = fit(case("campaign"))
    >>> round(float(fitted.robot.area_factor_at(0.0)), 1)
    1.5
    >>> fitted = fit(case("campaign"), "chamber_azimuth")
    >>> fitted.parameters["chamber_azimuth.angle"].unit, list(fitted.robot.effects)
    ('rad', ['chamber_azimuth'])
    """
    from diagnosis.fit_effects import fit_effects

    from .calibration import calibrate
    from .files.inputs import Case
    from .files.own_effects import catalogue

    _demand_case("fit", measured)
    if not (effects or residual or set_up):
        return calibrate(Case(measured.robot.plain, measured.table))
    named = [effects] if isinstance(effects, str) else effects
    return fit_effects(measured, named, catalogue(measured.robot)[0], residual=residual)


def compare(measured: Case) -> Comparison:
    """Every measured tip with the one that the case's robot predicts. Raises ConfigError.

    >>> found = compare(case("campaign"))
    >>> found.unsolved, found.table.rmse < 1e-3
    (0, True)
    """
    from .comparison import comparison

    _demand_case("compare", measured)
    return comparison(measured)


def diagnose(measured: Case, options: Options | None = None) -> Diagnosis:
    """Where the gap lies, which effect may cause it, how far it shrinks, what to do next. Raises DiagnosisError.

    `options` (`from diagnosis.diagnose import Options`): `Options(quantify=False)` leaves out errors on unseen states,
    `experiments=False` what to do next; `holdout=lab.case(..)` is a campaign on which the answer is tested; `catalogue` are the
    effects that are weighed."""
    from diagnosis.diagnose import diagnose as _diagnose

    _demand_case("diagnose", measured)
    return _diagnose(measured, options)


def _demand_case(verb: str, measured: object) -> None:
    """Raise TypeError for a path or DataFrame of which no case has been made."""
    if not (hasattr(measured, "robot") and hasattr(measured, "table")):
        call = f"lab.case({str(measured)!r})" if isinstance(measured, str | Path) else "lab.case(frame, 'robot.yaml')"
        raise TypeError(f"lab.{verb}: takes a case, not a {type(measured).__name__}; write lab.{verb}({call})")


def open_rig(path: Place, needs: Sequence[str] | None = None) -> Rig:
    """The instruments of a rig.yaml, connected: a context that leaves the rig vented, stopped and released, confirmed by
    reading back.

    `needs`: those that an experiment needs; all unless given. Raises ConfigError, RigLocked, InstrumentError."""
    from .files.rig_file import load_rig
    from .rig.assembly import Rig
    from .verbs.run import connect

    rig = Rig(load_rig(Path(path)))
    try:
        connect(rig, needs, quiet=True)
    except BaseException:
        rig.close()
        raise
    return rig


def run(rig: Rig, protocol: str, out: Place = ".", **parameters: Any) -> Path:
    """Run a protocol (its name, or a .yaml or .py file) on an opened rig; returns the recording.

    `parameters` in SI units. The rig is vented and at rest afterwards, whatever happens. Raises what ended the run."""
    from .console import Screen
    from .verbs.run import execute, job, source_of

    where = rig.file.path
    if where is None:
        raise ConfigError("the rig was not read from a file; open it with lab.open_rig")
    source = source_of(protocol)
    run_job = job(replace(source, data={**source.table, **parameters}), where, rig=rig.read)
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    outcome = execute(rig, run_job, folder, Screen(run_job.experiment.name, rig.clock.speed, quiet=True))
    if outcome.error is not None:
        raise outcome.error
    return outcome.file
