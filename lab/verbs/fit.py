"""`lab fit`: fit moduli to stiffness trials, the effective chamber area to bending states, or effects with their posterior, and
write them into a robot.yaml."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.table import Table as Sheet

from diagnosis.answer.headline import sized
from diagnosis.answer.result import Diagnosis, FittedRobot
from diagnosis.errors import DiagnosisError
from diagnosis.fit_effects import Fitted, fit_effects
from model.arrays import Array
from model.effects.nominal import stated_effects, tolerances
from model.effects.scales import scales
from model.effects.spec import EffectSpec
from model.estimate import Estimate
from model.robot import Robot
from recordings.own_files import folder_in, replaced
from recordings.table_file import csv_text

from ..calibration import calibrate
from ..console import Screen, note, out, titled
from ..files.config import ConfigError
from ..files.inputs import Case, read_case
from ..files.output_folder import demand_free, whole
from ..files.own_effects import catalogue
from ..files.robot_file import write_robot
from ..options import JSON, OF_CASE, OWN_EFFECTS, REPLACE, Result, Verb, option, path_option
from .compare import thrust_taken

SAME_FIT = 0.05
"""Relative difference of two residuals of one robot."""
OWN = ("robot.yaml", "samples")
"""What a fit writes, and replaces when it is repeated."""


def fit(wanted: argparse.Namespace) -> Result:
    """Calibrate the robot of a case without its effects, its set-up taken as exact; or fit effects that are named, area factor
    and tolerances of the set-up, with --set-up or --residual without any effect too. Raises ConfigError, BadEffect,
    RecordingError."""
    inputs, folder, named, samples = wanted.inputs, wanted.out, wanted.with_effects, wanted.samples
    if named is not None and not named:
        raise ConfigError("--with: names no effect; to fit area factor and tolerances alone give --set-up, else leave it out")
    calibrating = named is None and not wanted.residual and not wanted.set_up
    for name, given in (("--samples", samples), ("--effects", wanted.effects)):
        if given and calibrating:
            raise ConfigError(f"{name}: needs --with EFFECT[,EFFECT..] or --set-up")
    if samples < 0:
        raise ConfigError(f"--samples {samples}: must be at least 1")
    if samples and folder is None:
        raise ConfigError(f"--samples {samples}: needs --out FOLDER to write the robots into")
    demand_free(folder, OWN, wanted.replace, inputs)
    case = read_case(inputs, wanted.robot)
    note(case.table.warnings)
    effects: Mapping[str, EffectSpec] = {}
    if calibrating:
        if case.robot != case.robot.plain:
            note(
                ["the effects in robot.yaml are ignored: this command calibrates without effects. To keep them: "
                 f"--with {','.join(case.robot.effects)}"]
            )  # fmt: skip
        with Screen("calibrating") as screen:
            fitted = calibrate(Case(case.robot.plain, case.table), screen.step)
    else:
        effects, left_out = catalogue(case.robot, wanted.effects)
        note(left_out)
        diagnosed = _diagnosed(inputs)
        start = {} if diagnosed is None else {name: v.value for name, v in diagnosed.parameters.items()}
        with Screen("fitting") as screen:
            fitted = fit_effects(case, named or (), effects, screen.step, wanted.residual, start)
        note([] if diagnosed is None else disagreement(fitted, diagnosed))
    # the others were said before the fit, or are of a fit with effects
    note(str(f) for f in fitted.findings if f.code == "thrust_settled" or not (calibrating or f.code == "as_read"))
    written: list[Path] = []
    if folder is not None:
        with whole(folder, OWN, wanted.replace, inputs) as (place, word):
            write_robot(fitted.robot, place / "robot.yaml", case.robot_text)
            written.append(folder / "robot.yaml")
            if samples:
                names, values, robots = drawn(fitted.robot, effects, samples, wanted.seed)
                files = write_samples(names, values, robots, folder_in(place, "samples"), case.robot_text)
                with Screen("writing robots") as screen:
                    for k, _ in enumerate(files, 1):
                        screen.progress(k, len(robots))
                written.append(folder / "samples" / "samples.csv")

    def show() -> None:
        out.print(sheet(fitted) if calibrating else effects_sheet(fitted))
        lines = [baseline_line(fitted)] if calibrating else residual_lines(fitted)
        lines += [f"marker {k}, which the fit used too: {mm:.2f} mm rms (in-sample)" for k, mm in fitted.markers_mm.items()]
        for line in (*filter(None, lines), *(f"{word}: {path}" for path in written)):
            out.print(line)

    return Result({**fitted.as_dict(), "files": [str(path) for path in written]}, show)


def _diagnosed(inputs: Sequence[Path]) -> FittedRobot | None:
    """The robot of the diagnosis.json in a case folder; None where there is none, or more than one folder."""
    try:
        (folder,) = inputs
        return Diagnosis.from_json((folder / "diagnosis.json").read_text(encoding="utf-8")).fitted
    except (OSError, ValueError, DiagnosisError):
        return None


def disagreement(f: Fitted, d: FittedRobot) -> Iterator[str]:
    """How a fit disagrees with the diagnosis.json of its case."""
    if {*f.effects} != {*d.effects}:
        yield (
            f"diagnosis.json names {', '.join(d.effects)}, which leaves {d.left_mm:.2f} mm; with "
            f"{', '.join(f.effects) or 'no effect'} {f.left_mm:.2f} mm remain"
        )
    elif abs(f.left_mm - d.left_mm) > SAME_FIT * d.left_mm:
        yield (
            f"{f.left_mm:.2f} mm remain, but {d.left_mm:.2f} mm in diagnosis.json: the table or robot.yaml has changed since. "
            "Diagnose the case again"
        )


def effects_sheet(f: Fitted) -> Sheet:
    """The fitted parameters as a table, in the units in which people read them."""
    named, words = " + ".join(f.effects) or "no effect", f.robot.actuators.words
    t = titled(f"Robot with {named} (± standard deviation)", ("parameter", "value"))
    for _, group in groupby(f.parameters.items(), lambda one: (one[0].partition(".")[0] in f.effects, "." in one[0])):
        t.add_section()
        for name, p in group:
            t.add_row(name, sized(p, words))
    for each in f.by_actuator:
        t.add_section()
        for name, factor in each.by_name(words).items():
            t.add_row(name, f"{sized(factor)} times the mean")
    return t


def residual_lines(f: Fitted) -> list[str]:
    """The tip error before and after the fit, and the terms of a prediction's interval."""
    posterior = f.robot.posterior
    lines = [f"{each.says(f.robot.actuators.words)} [{each.effect}]".capitalize() for each in f.by_actuator]
    worse = f", which is larger: {' and '.join(f.effects)} does not explain these data" * (f.left_mm > f.calibrated_mm + 0.005)
    with_effects = f", {f.left_mm:.2f} mm with the effects{worse}" * bool(f.effects)
    lines.append(
        f"tip error on the {f.states} states of {f.trials} trials that were fitted (in-sample): "
        f"{f.calibrated_mm if f.effects else f.left_mm:.2f} mm rms with area factor and set-up fitted{with_effects}"
    )
    if posterior is not None:
        lines.append(
            f"noise floor {1e3 * posterior.noise.floor:.2f} mm, model-form error {100 * posterior.law_error:.1f} % of what an "
            f"effect does, unexplained {1e3 * posterior.discrepancy:.2f} mm along each axis"
        )
    if f.left_out_mm is not None:
        lines.append(
            f"{f.left_out_mm:.2f} mm with the learned residual, on settings that it did not learn from (effects and tolerances "
            "are fitted to all states); predictions use it, a diagnosis does not"
        )
    return lines


def sheet(c: Fitted) -> Sheet:
    """The calibration as a table; without the column of spine lengths for a robot that has no spine."""
    rows = [
        ("E of the spine", f"{length * 100:.1f} cm", _mpa(e), str(e.n), f"{e.rms_residual:.3f} N")
        for length, e in c.spine_modulus.items()
    ]
    if e := c.body_modulus:
        rows.append(("E of the body (eq. 8)", "0 cm", _mpa(e), str(e.n), f"{e.rms_residual:.3f} N"))
    areas = [("set-up exact", f"{length * 100:.1f} cm", a) for length, a in c.area_factor_by_length.items()]
    areas += [("tolerances", "all", c.area_factor)] if c.area_factor else []
    factor = c.robot.actuators.words.area_factor
    for kind, where, a in areas:
        value = f"{a.value:.3f} ± {a.standard_error:.3f}"
        rows.append((f"{factor}, {kind}", where, value, str(a.n), f"{a.rms_residual * 1e3:.2f} mm rms"))
    spine = c.robot.spine is not None
    columns = ("parameter", *(("spine",) if spine else ()), "value", "states", "residual")
    shown = ((name, *((where,) if spine else ()), *rest) for name, where, *rest in rows)
    return titled(f"Calibration (± standard error){thrust_taken(c.robot)}", columns, shown)


def baseline_line(c: Fitted) -> str:
    """State the baseline of a diagnosis; "" where no area was fitted."""
    if (area := c.area_factor) is None:
        return ""
    each, exact = " for all lengths" if c.robot.spine else "", max(a.rms_residual for a in c.area_factor_by_length.values())
    return (
        f"calibrated with one {c.robot.actuators.words.area_factor}{each} and the tolerances of the set-up, the model misses the "
        f"tip by {area.rms_residual * 1e3:.2f} mm rms on the {area.n} states (in-sample): the calibrated model of lab diagnose, "
        f"which --set-up --out FOLDER writes. Without it, robot.yaml takes the set-up as exact and misses the tip by "
        f"{'up to ' * (len(c.area_factor_by_length) > 1)}{exact * 1e3:.2f} mm"
    )


def _mpa(e: Estimate) -> str:
    return f"{e.value / 1e6:.3f} ± {e.standard_error / 1e6:.3f} MPa"


VERBS = (
    Verb(
        "fit",
        fit,
        options=(
            JSON,
            *OF_CASE,
            path_option("--out", "FOLDER", "folder for robot.yaml as fitted, and --samples"),
            REPLACE,
            option(
                "--with",
                "EFFECT[,EFFECT..]",
                "fit these effects and the set-up too, and write them into robot.yaml",
                dest="with_effects",
                action="extend",
                type=lambda text: [name.strip() for name in text.split(",") if name.strip()],
            ),
            option(
                "--set-up",
                action="store_true",
                help="fit the set-up within its tolerances, as lab diagnose does; else it is exact",
            ),
            option("--residual", action="store_true", help="learn what the model still misses, for predictions"),
            option("--samples", "N", "with --with or --set-up: write N robots drawn from the posterior", type=int, default=0),
            option("--seed", type=int, default=0, help="seed of --samples (default 0)"),
            OWN_EFFECTS,
        ),
        examples=("lab fit runs/*.mcap --out fitted", "lab fit case --with spine_slip --out fitted"),
        page="docs/howto/use-the-answer.md",
    ),
)

LEAST_AREA, MOST_AREA = 1e-6, 20.0


def drawn(robot: Robot, catalogue: Mapping[str, EffectSpec], n: int, seed: int) -> tuple[tuple[str, ...], Array, list[Robot]]:
    """Names (k), values (n, k) and robots (n) of the posterior, cut at bounds. Raises ConfigError where nothing is uncertain."""
    names, covariance = robot.joint_uncertainty()
    if not names:
        raise ConfigError(f"robot {robot.name!r} is not fitted, so no robots can be drawn; see `lab fit --with`")
    stated, own = robot.stated, scales(robot)
    effects = tolerances(robot) | {id: spec.of(own) for id, spec in stated_effects(robot, catalogue).items()}
    bounds = {f"{id}.{p.name}": (p.low, p.high) for id, spec in effects.items() for p in spec.parameters}
    limits = np.array([bounds.get(name, (LEAST_AREA, MOST_AREA)) for name in names], float)
    factor = robot.area_factor
    area = factor if isinstance(factor, float) else 0.0
    mean = np.array([stated[n].value if n in stated else area for n in names], np.float64)
    root = np.asarray(np.linalg.cholesky(covariance), np.float64)
    rng = np.random.default_rng(seed)
    values = np.array([_within(mean, root, limits, rng) for _ in range(n)])
    return names, values, [robot.with_values(dict(zip(names, row, strict=True))) for row in values.tolist()]


def _within(mean: Array, root: Array, limits: Array, rng: np.random.Generator) -> Array:
    """(k,) of a normal with covariance `root` `root`^T, drawn until within `limits` (k, 2); else the mean, cut there."""
    draws = (mean + root @ rng.normal(size=len(mean)) for _ in range(1000))
    return next((value for value in draws if (value == np.clip(value, *limits.T)).all()), np.clip(mean, *limits.T))


def write_samples(names: tuple[str, ...], values: Array, robots: list[Robot], folder: Path, given: str = "") -> Iterator[Path]:
    """One robot.yaml each, derived from `given`, and samples.csv: a line for each, a column for each parameter in its unit."""
    rows: list[list[object]] = [["file", *names]]
    width = max(4, len(str(len(robots))))
    for k, (row, robot) in enumerate(zip(values.tolist(), robots, strict=True), 1):
        file = f"robot-{k:0{width}d}.yaml"
        rows.append([file, *row])
        yield write_robot(robot, folder / file, given)
    replaced(folder / "samples.csv", csv_text(rows))
