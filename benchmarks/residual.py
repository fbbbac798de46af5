"""Naming a cause or learning the rest: `python -m benchmarks.residual [--robots N] [--states M] [--clutter C] [--json FILE]`.

What others do instead of naming a cause is to learn what the calibrated model misses. Virtual robots with one withheld effect
(those of `lab blind`, another physics than the model's) are measured in 10, 30, 100 and 300 states with the spine up to 20 cm
and up to 200 kPa, twice each. Four models then predict tips that no fit saw, inside that range and beyond it (spines up to
30 cm, or up to 250 kPa):

    calibrated         one area factor and the tolerances of the set-up, no effect
    residual           that, and a Gaussian process over spine length and pressure for what it misses
    cause              one area factor, tolerances and the withheld effect, which is given: no diagnosis is asked
    cause + residual   that, and what `lab fit --with CAUSE --residual` learns of what it misses

Reported: rms distance from the tip in mm, median over robots; in how many robots the cause predicts better than the residual
(Clopper-Pearson 95 %); and the share of coordinates within the 95 % intervals of the last model. The Gaussian process of the
second is scikit-learn's (extra `check`).
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Sheet

from benchmarks.use import HOLD, NOISE, RATE, campaign, covered, driven
from diagnosis.fit_effects import fit_effects
from lab.blind.bench_robot import BenchRobot
from lab.blind.intervals import clopper_pearson
from lab.blind.sweeps import BEND, Sweep
from lab.blind.truth import Recipe, Truth, draw
from lab.files.inputs import Case
from model.prediction import Predictor
from model.robot import Robot
from sim_fakes.virtual_robot import NoEquilibrium

Array = NDArray[np.float64]
Predict = Callable[[Array, Array], Array]
"""Pressures (n, 9) Pa and spine lengths (n,) m in, tips (n, 3) m out."""

INSIDE, BEYOND = "inside", "beyond"
LONGEST, HIGHEST = 0.20, 200e3
"""m and Pa of the states that are fitted."""
FARTHEST, MOST = 0.30, 250e3
LENGTHS_BY_PRESSURES = {10: (2, 2), 30: (3, 4), 100: (5, 9), 300: (9, 16)}
"""States about -> spine lengths and pressures above zero."""
REPEATS = 2
MODELS = ("calibrated", "residual", "cause", "cause + residual")


@dataclass(frozen=True)
class Outcome:
    """One robot."""

    withheld: tuple[str, ...]
    rms: Mapping[int, Mapping[str, Mapping[str, float]]]
    """States about -> where -> model -> m."""
    covered: Mapping[int, Mapping[str, float]]
    """States about -> where -> share of readings within the 95 % interval of the last model."""


def sweep(states: int) -> Sweep:
    """A campaign of about so many states, spread evenly over what is fitted."""
    lengths, pressures = LENGTHS_BY_PRESSURES[states]
    return Sweep(
        f"fitted {states}",
        "inflate and read",
        tuple(np.linspace(0.0, LONGEST, lengths).tolist()),
        tuple((HIGHEST * np.arange(1, pressures + 1) / pressures).tolist()),
        repeats=REPEATS,
    )


def asked(rng: np.random.Generator, states: int) -> dict[str, tuple[Array, Array]]:
    """Where -> pressures (n, 9) Pa and spine lengths (n,) m that no fit saw."""
    length, high = rng.uniform(0.0, LONGEST, states), rng.uniform(0.1 * HIGHEST, HIGHEST, states)
    longer = rng.random(states) < 0.5
    far_length = np.where(longer, rng.uniform(LONGEST, FARTHEST, states), rng.uniform(0.0, LONGEST, states))
    far_high = np.where(longer, rng.uniform(0.1 * HIGHEST, MOST, states), rng.uniform(HIGHEST, MOST, states))
    return {INSIDE: (_inflated(high), length), BEYOND: (_inflated(far_high), far_length)}


def _inflated(pressure: Array) -> Array:
    out = np.zeros((len(pressure), 9))
    out[:, [c - 1 for c in BEND]] = pressure[:, None]
    return out


def modelled(robot: Robot) -> Predict:
    """Tips by the rod, and by what robot.yaml has learnt beyond it."""
    at = Predictor(robot)
    return lambda pressures, lengths: at(pressures, lengths, rate=RATE, hold=HOLD).tip


def with_residual(base: Predict, case: Case) -> Predict:
    """The same and, for each axis, a Gaussian process for what it misses on the states of a case."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    rows = [r for r in case.table if r.tip is not None]
    pressures, lengths = np.array([r.pressures for r in rows]), np.array([r.spine_length for r in rows])
    missed = np.array([r.tip for r in rows]) - base(pressures, lengths)
    learned = []
    for axis in range(3):
        kernel = ConstantKernel(1.0, (1e-4, 1e4)) * RBF([0.5, 0.5], (0.05, 20.0)) + WhiteKernel(0.1, (1e-4, 1e1))
        process = GaussianProcessRegressor(kernel, normalize_y=True, n_restarts_optimizer=2, random_state=0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a length scale at its bound is an answer too
            learned.append(process.fit(_inputs(pressures, lengths), missed[:, axis]))

    def predict(pressures: Array, lengths: Array) -> Array:
        x = _inputs(pressures, lengths)
        return base(pressures, lengths) + np.column_stack([process.predict(x) for process in learned])

    return predict


def _inputs(pressures: Array, lengths: Array) -> Array:
    return np.column_stack([pressures.max(axis=1) / HIGHEST, lengths / LONGEST])


def learn(truth: Truth, states: int) -> Outcome:
    """Measure, fit and judge one robot; raises `NoEquilibrium` when it loses its own."""
    robot, rng = BenchRobot(truth), np.random.default_rng([truth.seed, 6])
    judged = {}
    for where, (pressures, lengths) in asked(rng, states).items():
        reached, read, grown = driven(robot, pressures, lengths)
        kept = np.isfinite(reached).all(axis=1)
        judged[where] = read[kept], grown[kept], reached[kept] + NOISE * rng.normal(size=(int(kept.sum()), 3))
    found: dict[int, dict[str, dict[str, float]]] = {}
    within: dict[int, dict[str, float]] = {}
    for count in LENGTHS_BY_PRESSURES:
        case = campaign(truth, (sweep(count),))
        plain = modelled(fit_effects(case, ()).robot)
        last = fit_effects(case, truth.effects, residual=True).robot
        named = last.without_residual
        models = (plain, with_residual(plain, case), modelled(named), modelled(last))
        within[count] = {where: float(np.mean(covered(last, *seen))) for where, seen in judged.items()}
        found[count] = {
            where: {
                name: float(np.sqrt(np.nanmean(np.sum((predict(p, length) - tip) ** 2, axis=1))))
                for name, predict in zip(MODELS, models, strict=True)
            }
            for where, (p, length, tip) in judged.items()
        }
    return Outcome(tuple(truth.effects), found, within)


def summary(outcomes: list[Outcome]) -> dict[str, object]:
    """Medians over robots, and how often the cause is better than the residual."""
    out: dict[str, object] = {"robots": len(outcomes)}
    for count in LENGTHS_BY_PRESSURES:
        for where in (INSIDE, BEYOND):
            rms = {name: np.array([o.rms[count][where][name] for o in outcomes]) for name in MODELS}
            better = int((rms["cause"] < rms["residual"]).sum())
            out[f"{count} {where}"] = {
                "median_mm": {name: 1e3 * float(np.median(v)) for name, v in rms.items()},
                "cause_better": better / len(outcomes),
                "interval": clopper_pearson(better, len(outcomes)),
                "covered": float(np.mean([o.covered[count][where] for o in outcomes])),
            }
    return out


def main() -> int:
    """Print a line a robot, the table, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--states", type=int, default=40, help="that judge, inside and beyond each")
    parser.add_argument("--seed", type=int, default=2027)
    parser.add_argument("--clutter", type=float, default=0.0, help="size of all other effects, share of their scale")
    parser.add_argument("--json", type=Path, default=Path("out/residual.json"))
    a = parser.parse_args()
    console = Console(width=150)
    outcomes = []
    for truth in draw(Recipe(a.robots, a.seed, a.clutter, settled=True, only=("single",))):
        begun = time.monotonic()
        try:
            outcomes.append(learn(truth, a.states))
        except NoEquilibrium:
            console.print(f"{', '.join(truth.effects)}: the robot loses its equilibrium in its own campaign, left out")
            continue
        far = ", ".join(f"{name} {1e3 * m:.2f}" for name, m in outcomes[-1].rms[100][BEYOND].items())
        console.print(f"{', '.join(truth.effects)}: 100 states, beyond: {far} mm, {time.monotonic() - begun:.0f} s")
    figures = summary(outcomes)
    table = Sheet(title=f"{len(outcomes)} robots, rms of unseen tips in mm, medians", title_justify="left")
    for column in ("states", "where", *MODELS, "cause better than residual", "95 %", "covered"):
        table.add_column(column)
    for count in LENGTHS_BY_PRESSURES:
        for where in (INSIDE, BEYOND):
            own = figures[f"{count} {where}"]
            assert isinstance(own, dict)
            low, high = own["interval"]
            cells = [f"{own['median_mm'][name]:.2f}" for name in MODELS]
            table.add_row(
                str(count),
                where,
                *cells,
                f"{own['cause_better']:.2f}",
                f"{low:.2f} .. {high:.2f}",
                f"{own['covered']:.2f}",
            )
    console.print(table)
    a.json.parent.mkdir(parents=True, exist_ok=True)
    robots = [{"withheld": list(o.withheld), "rms": o.rms, "covered": o.covered} for o in outcomes]
    a.json.write_text(json.dumps({"figures": figures, "robots": robots}, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
