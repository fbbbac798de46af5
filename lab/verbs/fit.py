"""`lab fit`: moduli from stiffness trials, the effective chamber area from bending states, or effects with their posterior, and
a robot.yaml that holds them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table as Sheet

from diagnosis.answer.headline import sized
from diagnosis.answer.result import Value
from diagnosis.errors import DiagnosisError
from diagnosis.fit_effects import Fitted, fit_effects
from model.calibration import AreaFit
from model.errors import BadEffect, ModelError
from model.estimate import Estimate
from recordings.own_files import folder_in

from ..calibration import Calibration, calibrate
from ..console import Screen, note, out
from ..files.config import ConfigError
from ..files.inputs import Case, read_case
from ..files.output_folder import demand_free, whole
from ..files.own_effects import catalogue
from ..files.robot_file import write_robot
from ..options import ANY_SIZE, INPUTS, JSON, OWN_EFFECTS, REPLACE, ROBOT, Verb, option
from ..samples import drawn, write_samples

OWN = ("robot.yaml", "samples")
"""What a fit writes, and replaces when it is repeated."""


@dataclass(frozen=True)
class WithEffects:
    """What `lab fit --with` is asked for."""

    effects: tuple[str, ...]
    file: Path | None = None
    """Python file with effects of one's own."""
    samples: int = 0
    """Robots to draw from the posterior."""
    seed: int = 0
    residual: bool = False
    """Learn what the model still misses."""


def fit(inputs: Sequence[Path], robot: Path | None, folder: Path | None, as_json: bool, replace: bool = False) -> int:
    """Print the calibration; with a folder also write the calibrated robot.yaml."""
    if folder is not None:
        demand_free(folder, OWN, replace, inputs)
    case = read_case(inputs, robot)
    note(case.table.warnings)
    if case.robot != case.robot.plain:
        note(
            ["the effects in robot.yaml are left out, as this calibrates the model without any; to keep them: "
             f"--with {','.join(case.robot.effects)}"]
        )  # fmt: skip
    try:
        with Screen("calibrating", quiet=as_json) as screen:
            result = calibrate(Case(case.robot.plain, case.table), screen.step)
    except (DiagnosisError, ModelError) as e:
        raise ConfigError(str(e)) from e
    if folder is not None:
        with whole(folder, OWN, replace, inputs) as place:
            write_robot(result.robot, place / "robot.yaml", case.robot_text)
    if as_json:
        print(json.dumps(result.as_dict(), indent=1))
    else:
        out.print(sheet(result))
        if result.area_factor is not None:
            out.print(baseline_line(result, result.area_factor))
    return 0


def fit_with(
    inputs: Sequence[Path], robot: Path | None, asked: WithEffects, folder: Path | None, as_json: bool, replace: bool = False
) -> int:
    """Print area factor, effects and tolerances; with a folder also write robot.yaml and robots drawn from the posterior.

    Raises ConfigError, BadEffect, RecordingError.
    """
    if asked.samples < 0:
        raise ConfigError(f"--samples {asked.samples}: must be at least 1")
    if asked.samples and folder is None:
        raise ConfigError(f"--samples {asked.samples}: needs --out FOLDER to write the robots into")
    if folder is not None:
        demand_free(folder, OWN, replace, inputs)
    case = read_case(inputs, robot)
    note(case.table.warnings)
    known, left_out = catalogue(case.robot, asked.file)
    note(left_out)
    try:
        with Screen("fitting", quiet=as_json) as screen:
            found = fit_effects(case, asked.effects, known, screen.step, asked.residual)
    except BadEffect:
        raise
    except (DiagnosisError, ModelError) as e:
        raise ConfigError(str(e)) from e
    note(map(str, found.findings))
    written: list[Path] = []
    if folder is not None:
        with whole(folder, OWN, replace, inputs) as place:
            write_robot(found.robot, place / "robot.yaml", case.robot_text)
            written.append(folder / "robot.yaml")
            if asked.samples:
                names, values, robots = drawn(found.robot, known, asked.samples, asked.seed)
                samples = write_samples(names, values, robots, folder_in(place, "samples"), case.robot_text)
                with Screen("writing robots", quiet=as_json) as screen:
                    for k, _ in enumerate(samples, 1):
                        screen.progress(k, len(robots))
                written.append(folder / "samples" / "samples.csv")
    if as_json:
        print(json.dumps({**found.as_dict(), "files": [str(path) for path in written]}, indent=1))
        return 0
    out.print(effects_sheet(found))
    for line in residual_lines(found):
        out.print(line)
    for path in written:
        out.print(f"written: {path}")
    return 0


def effects_sheet(f: Fitted) -> Sheet:
    """The fitted parameters as a table, in the units in which people read them."""
    named = " + ".join(f.effects) or "no effect"
    t = Sheet(title=f"Robot with {named} (± standard deviation)", title_justify="left")
    for column in ("parameter", "value"):
        t.add_column(column)
    before = ""
    for name, p in f.parameters.items():
        kind = name.partition(".")[0]
        group = "effect" if kind in f.effects else "tolerance" if "." in name else "area"
        if before and group != before:
            t.add_section()
        before = group
        value = Value(p.value, p.sd, p.unit, name not in f.undetermined)
        t.add_row(name, sized(value, f.robot.actuators.words))
    return t


def residual_lines(f: Fitted) -> list[str]:
    """How far the tip is off before and after, and what a prediction takes its interval from."""
    posterior = f.robot.posterior
    lines = [
        f"tip error on the {f.states} states of {f.trials} trials that were fitted (in-sample): "
        f"{f.calibrated_mm:.2f} mm rms with one area factor and no effect, {f.fitted_mm:.2f} mm with the effects"
    ]
    if posterior is not None:
        lines.append(
            f"noise floor {1e3 * posterior.noise.floor:.2f} mm, model-form error {100 * posterior.law_error:.1f} % of what an "
            f"effect does, unexplained {1e3 * posterior.discrepancy:.2f} mm along each axis"
        )
    if f.left_out_mm is not None:
        lines.append(
            f"{f.left_out_mm:.2f} mm with the learnt residual on each trial that it did not learn from (effects and tolerances "
            "are those of all trials); predictions have it, a diagnosis does not"
        )
    return lines


def sheet(c: Calibration) -> Sheet:
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
        rows.append((f"{factor}, {kind}", where, _plain(a.factor), str(a.states), f"{a.rmse * 1e3:.2f} mm rms"))
    t = Sheet(title="Calibration (± standard error)", title_justify="left")
    spine = c.robot.spine is not None
    for column in ("parameter", *(("spine",) if spine else ()), "value", "states", "residual"):
        t.add_column(column)
    for name, where, *rest in rows:
        t.add_row(name, *((where,) if spine else ()), *rest)
    return t


def baseline_line(c: Calibration, area: AreaFit) -> str:
    """The baseline of a diagnosis, in its words."""
    spine = c.robot.spine is not None
    return (
        f"calibrated with one {c.robot.actuators.words.area_factor}{' for all lengths' if spine else ''} and the tolerances of "
        f"the set-up, the model misses the tip by {area.rmse * 1e3:.2f} mm rms on the {area.states} states (in-sample): the "
        "calibrated model of lab diagnose"
        + (". Factors per length take the set-up as exact, so they need not agree with that one" if spine else "")
    )


def _mpa(e: Estimate) -> str:
    return f"{e.value / 1e6:.3f} ± {e.standard_error / 1e6:.3f} MPa"


def _plain(e: Estimate) -> str:
    return f"{e.value:.3f} ± {e.standard_error:.3f}"


def _names(text: str) -> tuple[str, ...]:
    """Names between commas."""
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _fit_verb(a: argparse.Namespace) -> int:
    if a.with_effects is None and not a.residual:
        for name, given in (("--samples", a.samples), ("--effects", a.effects)):
            if given:
                raise ConfigError(f"{name}: needs --with EFFECT[,EFFECT..]")
        return fit(a.inputs, a.robot, a.out, a.json, a.replace)
    asked = WithEffects(a.with_effects or (), a.effects, a.samples, a.seed, a.residual)
    return fit_with(a.inputs, a.robot, asked, a.out, a.json, a.replace)


VERBS = (
    Verb(
        "fit",
        _fit_verb,
        options=(
            JSON,
            ANY_SIZE,
            INPUTS,
            ROBOT,
            option("--out", type=Path, metavar="FOLDER", help="folder for robot.yaml as fitted, and --samples"),
            REPLACE,
            option(
                "--with",
                dest="with_effects",
                type=_names,
                metavar="EFFECT[,EFFECT..]",
                help="fit these effects too, and write them into robot.yaml",
            ),
            option("--residual", action="store_true", help="learn what the model still misses, for predictions"),
            option(
                "--samples",
                type=int,
                default=0,
                metavar="N",
                help="with --with: write N robots drawn from the posterior",
            ),
            option("--seed", type=int, default=0, help="seed of --samples (default 0)"),
            OWN_EFFECTS,
        ),
        examples=("lab fit runs/*.mcap --out fitted", "lab fit case --with spine_slip --out fitted"),
        page="docs/howto/use-the-answer.md",
    ),
)
