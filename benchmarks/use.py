"""What a diagnosis is worth when it is put to use: `python -m benchmarks.use [--robots N] [--targets M] [--given] [--json FILE]`.

Virtual robots with a withheld effect (those of `lab blind`, another physics than the model's) are measured, diagnosed, and fitted
with what the diagnosis names. Each is then asked for tips that it can reach, by `lab predict --inverse`, with three models:

    by length    lab fit: an area factor for each spine length
    calibrated   one area factor and the tolerances of the set-up, no effect
    diagnosed    the same with the named effects

and driven to what each model says. Reported: distance of the tip from its target, share within two noise floors (Clopper-Pearson
95 %), ratio of the median distances; and the share of readings in states that no fit saw that lie within their 95 % interval.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Sheet

from diagnosis.diagnose import Options, diagnose
from diagnosis.fit_effects import fit_effects
from diagnosis.inference.executor import Executor
from lab.blind.bench_robot import BenchRobot
from lab.blind.designs import joined
from lab.blind.drive import measure
from lab.blind.intervals import clopper_pearson
from lab.blind.make import described
from lab.blind.sweeps import BASE_SETTLED, MENU, Sweep
from lab.blind.truth import Recipe, Truth, draw
from lab.calibration import calibrate
from lab.files.inputs import Case
from model.prediction import NORMAL_95, Predictor
from model.prediction.inverse import inverse, limits_of
from model.robot import Robot
from sim_fakes.virtual_robot import Condition, NoEquilibrium, walk

Array = NDArray[np.float64]

GROUPS = ((9, 1, 2), (3, 4, 5), (6, 7, 8))
HIGHEST, LONGEST = 220e3, 0.30
"""Pa and m of the states whose tips are asked for."""
LANDINGS = 3
"""Times that the diagnosed robot's command is given: a spine that is grown and jammed anew does not come to the same place."""
SYSTEMATIC = "diagnosed, mean of three"
MODELS = ("by length", "calibrated", "diagnosed")
NOISE = 0.3e-3 / np.sqrt(50)
"""m of a settled reading along each axis."""
HOLD, RATE = 5.0, 25e3


@dataclass(frozen=True)
class Outcome:
    """One robot."""

    withheld: tuple[str, ...]
    named: tuple[str, ...]
    floor: float
    """m."""
    miss: dict[str, list[float]]
    """Model -> m from each target to the tip."""
    inside: list[bool]
    """For each coordinate of unseen states, whether the reading lies within the diagnosed robot's interval."""


def campaign(truth: Truth, sweeps: Sequence[Sweep]) -> Case:
    """The robot as a diagnosis is given it, and what was measured on it."""
    robot, rng = BenchRobot(truth), np.random.default_rng([truth.seed, 4])
    tables = [measure(robot, s, rng) for s in sweeps]
    return Case(described(), joined(tables))


def unseen(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Pressures (n, 9) Pa and spine lengths (n,) m of one or two inflated groups."""
    pressures = np.zeros((count, 9))
    for row in pressures:
        for g in rng.choice(3, rng.integers(1, 3), replace=False):
            row[[c - 1 for c in GROUPS[g]]] = rng.uniform(30e3, HIGHEST)
    return pressures, rng.uniform(0.0, LONGEST, count)


def driven(robot: BenchRobot, pressures: Array, lengths: Array) -> tuple[Array, Array, Array]:
    """Where the robot's tip comes to (n, 3) m, each state in a trial of its own, and what regulators and length unit read
    there; NaN where it has no equilibrium."""
    out = np.full((len(lengths), 3), np.nan)
    read, grown = pressures.copy(), lengths.copy()
    for i, (p, length) in enumerate(zip(pressures.tolist(), lengths.tolist(), strict=True)):
        # The spine is grown and jammed anew for each.
        asked = Condition(length, tuple(p), hold=HOLD, rate=RATE, rejam=True)
        try:
            found = walk(robot, [asked])[0]
            out[i], read[i], grown[i] = found.position, found.pressures, found.spine_length
        except NoEquilibrium:
            robot.reset()
    # A vented chamber is at zero gauge, whatever its sensor reads.
    return out, np.where(pressures > 0, read, 0.0), grown


def covered(robot: Robot, pressures: Array, lengths: Array, read: Array) -> NDArray[np.bool_]:
    """(n, 3) whether the coordinates of read tips (m, 3) m lie within their 95 % interval, where there is an equilibrium."""
    predicted = Predictor(robot)(pressures, lengths, rate=RATE, hold=HOLD, intervals=True)
    low, high = predicted.interval()
    return np.asarray(((read >= low) & (read <= high))[predicted.converged])


def use(truth: Truth, targets: int, given: bool, cores: int, sweeps: Sequence[Sweep]) -> Outcome:
    """Measure, diagnose (`given`: the withheld effects are taken as named), fit, and use one robot."""
    case = campaign(truth, sweeps)
    named = tuple(truth.effects)
    if not given:
        options = Options(quantify=False, experiments=False, executor=Executor(cores))
        named = diagnose(case, options).attribute.effects
    fitted = fit_effects(case, named)
    posterior = fitted.robot.posterior
    assert posterior is not None
    calibration = calibrate(case)
    assert calibration.calibrated is not None
    robots = dict(zip(MODELS, (calibration.robot, calibration.calibrated.robot, fitted.robot), strict=True))
    rng = np.random.default_rng([truth.seed, 5])
    pressures, lengths = unseen(rng, targets)
    robot = BenchRobot(truth)
    reached, read_pressures, read_lengths = driven(robot, pressures, lengths)
    kept = np.isfinite(reached).all(axis=1)
    reached = reached[kept]
    read = reached + NOISE * rng.normal(size=reached.shape)
    inside = covered(fitted.robot, read_pressures[kept], read_lengths[kept], read)
    miss: dict[str, list[float]] = {}
    for name, model in robots.items():
        found = inverse(Predictor(model), reached, limits_of(model, GROUPS, spine=(0.0, LONGEST)))
        landings = LANDINGS if model is fitted.robot else 1
        there = np.array([driven(robot, found.pressures, found.spine_length)[0] for _ in range(landings)])
        miss[name] = np.linalg.norm(there[0] - reached, axis=1).tolist()
        if landings > 1:
            miss[SYSTEMATIC] = np.linalg.norm(there.mean(axis=0) - reached, axis=1).tolist()
    return Outcome(tuple(truth.effects), tuple(named), posterior.noise.floor, miss, inside.ravel().tolist())


def summary(outcomes: Sequence[Outcome]) -> dict[str, object]:
    """All figures, over all robots."""
    out: dict[str, object] = {"robots": len(outcomes), "targets": sum(len(o.miss["diagnosed"]) for o in outcomes)}
    for name in (*MODELS, SYSTEMATIC):
        mm = np.array([1e3 * m for o in outcomes for m in o.miss[name]])
        within = np.array([m <= 2 * o.floor for o in outcomes for m in o.miss[name]])
        out[name] = {
            "median_mm": float(np.nanmedian(mm)),
            "within_two_floors": float(within.mean()),
            "interval": clopper_pearson(int(within.sum()), len(within)),
        }
    for name in MODELS[:2]:
        ratio = [float(np.nanmedian(o.miss[name]) / np.nanmedian(o.miss["diagnosed"])) for o in outcomes]
        whole = [np.nanmedian([m for o in outcomes for m in o.miss[k]]) for k in (name, "diagnosed")]
        out[f"{name} over diagnosed"] = {"all": float(whole[0] / whole[1]), "median_of_robots": float(np.median(ratio))}
    inside = np.array([x for o in outcomes for x in o.inside])
    # Coordinates of one robot share its parameters: the interval is over robots.
    each = np.array([np.mean(o.inside) for o in outcomes])
    spread = float(NORMAL_95 * each.std(ddof=1) / np.sqrt(len(each))) if len(each) > 1 else float("nan")
    out["coverage"] = {"share": float(inside.mean()), "n": len(inside), "half_width_over_robots": spread}
    return out


def main() -> int:
    """Print a line a robot, the table, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--targets", type=int, default=10, help="of each robot")
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--clutter", type=float, default=0.0, help="size of all other effects, share of their scale")
    parser.add_argument("--given", action="store_true", help="fit the withheld effect without diagnosing it")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--json", type=Path, default=Path("out/use.json"))
    a = parser.parse_args()
    console = Console(width=150)
    recipe = Recipe(a.robots, a.seed, a.clutter, settled=True, only=("single",))
    sweeps = (BASE_SETTLED, *(s for s in MENU if s.name == "other_group"))
    outcomes = []
    for truth in draw(recipe):
        begun = time.monotonic()
        try:
            o = use(truth, a.targets, a.given, a.cores, sweeps)
        except NoEquilibrium:
            console.print(f"{', '.join(truth.effects)}: the robot loses its equilibrium in its own campaign, left out")
            continue
        outcomes.append(o)
        medians = ", ".join(f"{name} {1e3 * np.nanmedian(o.miss[name]):.2f}" for name in (*MODELS, SYSTEMATIC))
        console.print(
            f"{', '.join(o.withheld)} (named: {', '.join(o.named) or 'none'}): floor {1e3 * o.floor:.2f} mm, median miss "
            f"{medians} mm, inside {np.mean(o.inside):.2f}, {time.monotonic() - begun:.0f} s"
        )
    figures = summary(outcomes)
    table = Sheet(title=f"{figures['robots']} robots, {figures['targets']} targets", title_justify="left")
    for column in ("model", "median miss, mm", "within two floors", "95 %"):
        table.add_column(column)
    for name in (*MODELS, SYSTEMATIC):
        own = figures[name]
        assert isinstance(own, dict)
        low, high = own["interval"]
        table.add_row(name, f"{own['median_mm']:.2f}", f"{own['within_two_floors']:.2f}", f"{low:.2f} .. {high:.2f}")
    console.print(table)
    for name in (*(f"{n} over diagnosed" for n in MODELS[:2]), "coverage"):
        console.print(f"{name}: {figures[name]}")
    a.json.parent.mkdir(parents=True, exist_ok=True)
    robots = [{**vars(o), "withheld": list(o.withheld), "named": list(o.named)} for o in outcomes]
    a.json.write_text(json.dumps({"figures": figures, "robots": robots}, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
