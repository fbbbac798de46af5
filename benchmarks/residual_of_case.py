"""Naming a cause or learning the rest, on measurements: `python -m benchmarks.residual_of_case CASE [--json FILE]`.

The four models of `benchmarks.residual`, for a robot whose cause nobody knows: the cause is the leading hypothesis of a diagnosis
of the trials that are fitted, whatever its verdict. Trials are left out of everything in turn, one pressure after the other
(inside: between or below those fitted; beyond: the quarter of the trials with the highest pressures). Reported: rms distance from
the tip of states that no fit saw, mm.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Sheet

from benchmarks.residual import BEYOND, INSIDE, MODELS, Predict, with_residual
from diagnosis.diagnose import Options, diagnose
from diagnosis.fit_effects import fit_effects
from diagnosis.inference.posterior import UNKNOWN
from lab.files.inputs import Case, read_case
from model.prediction import Predictor
from model.robot import Robot
from recordings.trials import Table, TrialRow

Array = NDArray[np.float64]

FOLDS = 5
"""Into which the trials with lower pressures are dealt in turn."""
HIGH = 0.25


def splits(table: Table) -> Iterator[tuple[str, Table, Table]]:
    """Where, what is fitted, what is judged."""
    rows = [r for r in table if r.tip is not None and r.protocol != "stiffness"]
    highest: dict[int, float] = {}
    for r in rows:
        highest[r.trial] = max(highest.get(r.trial, 0.0), max(r.pressures))
    order = sorted(highest, key=lambda trial: highest[trial])
    few = int(np.ceil((1 - HIGH) * len(order)))
    low, high = order[:few], order[few:]
    for k in range(FOLDS):
        yield INSIDE, _of(rows, set(low) - set(low[k::FOLDS])), _of(rows, set(low[k::FOLDS]))
    yield BEYOND, _of(rows, set(low)), _of(rows, set(high))


def _of(rows: list[TrialRow], trials: set[int]) -> Table:
    return Table(tuple(r for r in rows if r.trial in trials))


def missed(robot: Robot, fitted: Case, judged: Table, cause: tuple[str, ...]) -> dict[str, Array]:
    """Model -> distances (n,) m of the judged tips."""
    inflated = [r for r in judged if max(r.pressures) > 0]
    pressures, lengths = np.array([r.pressures for r in inflated]), np.array([r.spine_length for r in inflated])
    tip = np.array([r.tip for r in inflated])
    plain = fit_effects(fitted, ()).robot
    last = fit_effects(fitted, cause, residual=True).robot

    calibrated = _modelled(plain)
    models = (calibrated, with_residual(calibrated, fitted), _modelled(last.without_residual), _modelled(last))
    return {
        name: np.linalg.norm(predict(pressures, lengths) - tip, axis=1)
        for name, predict in zip(MODELS, models, strict=True)
    }


def _modelled(robot: Robot) -> Predict:
    at = Predictor(robot)
    return lambda pressures, lengths: at(pressures, lengths).tip


def main() -> int:
    """Print the table, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", type=Path)
    parser.add_argument("--json", type=Path, default=Path("out/residual_of_case.json"))
    a = parser.parse_args()
    case, console = read_case([a.case], None), Console(width=120)
    found: dict[str, dict[str, list[float]]] = {where: {name: [] for name in MODELS} for where in (INSIDE, BEYOND)}
    causes: dict[str, list[str]] = {INSIDE: [], BEYOND: []}
    for where, fitted, judged in splits(case.table):
        of = Case(case.robot, fitted)
        answer = diagnose(of, Options(quantify=False, experiments=False))
        cause = next(h.effects for h in answer.attribute.ranking if h.effects != UNKNOWN)
        causes[where].append(" + ".join(cause) or "none")
        console.print(f"{where}: {len(fitted)} states fitted, {answer.attribute.verdict}, leading: {causes[where][-1]}")
        for name, distances in missed(case.robot, of, judged, cause).items():
            found[where][name] += distances.tolist()
    table = Sheet(title=f"{a.case.name}: rms of unseen tips, mm", title_justify="left")
    for column in ("where", "states", *MODELS):
        table.add_column(column)
    figures = {}
    for where, own in found.items():
        figures[where] = {name: 1e3 * float(np.sqrt(np.nanmean(np.square(d)))) for name, d in own.items()}
        table.add_row(where, str(len(own[MODELS[0]])), *(f"{v:.2f}" for v in figures[where].values()))
    console.print(table)
    a.json.parent.mkdir(parents=True, exist_ok=True)
    a.json.write_text(json.dumps({"rms_mm": figures, "causes": causes}, indent=1), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
