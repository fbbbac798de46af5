"""Errors of a measured arm by cause: `python -m benchmarks.ur5 FOLDER [--arm examples/ur5/arm.yaml] [--draws 20]`.

FOLDER holds grid.csv and random.csv of P. Jacobi's UR5 (github.com/pauljac7700/serial_robots_datasets): targets x_t, y_t, z_t
and measured errors x_dif, y_dif, z_dif in mm, joint_1 .. joint_6 in deg, in the order in which they were measured. Every fit
sees the grid alone, with the causes' plausible sizes as priors; the random poses are held out. Small campaigns go through the
door of `lab diagnose`, which proposes their poses and corrects.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from lab.verbs.diagnose_arm import diagnose_poses
from model.arm import Arm, ArmModel, load_arm
from model.robot import Array

FIRST, COUNT = 10, 30
"""Random poses with which a small campaign begins, and all of its poses."""
ROUNDS = 6
"""Of Gauss and Newton; the last changes no figure."""


def read(path: Path) -> tuple[pd.DataFrame, Array]:
    """Inputs (angles and those before them, rad) and measured positions (n, 3), m."""
    table = pd.read_csv(path)
    q = pd.DataFrame({f"q{k}": np.radians(table[f"joint_{k}"]) for k in range(1, 7)})
    at = table[["x_t", "y_t", "z_t"]].to_numpy() + table[["x_dif", "y_dif", "z_dif"]].to_numpy()
    return q.join(q.shift().add_suffix("_before")), at / 1e3


def fit(model: ArmModel, names: list[str], q: pd.DataFrame, at: Array) -> tuple[dict[str, float], float]:
    """Most probable parameters, and the noise (m, along each axis), estimated by its restricted likelihood."""
    sizes, x, sigma = np.array([model.parameters[n][1] for n in names]), np.zeros(len(names)), 1e-4
    for _ in range(ROUNDS):
        theta = dict(zip(names, x * sizes, strict=True))
        jac = np.transpose([d.ravel() for d in model.derivatives(theta, q, names).values()]) * sizes
        misfit = (at - model(theta, q)).ravel() + jac @ x
        gram = jac.T @ jac
        inverse = np.linalg.inv(gram / sigma**2 + np.eye(len(names)))
        x = inverse @ (jac.T @ misfit) / sigma**2
        free = misfit.size - float(np.sum(inverse * gram)) / sigma**2
        sigma = float(np.sqrt(np.sum((misfit - jac @ x) ** 2) / free))
    return dict(zip(names, x * sizes, strict=True)), sigma


def chosen(arm: Arm, poses: pd.DataFrame, first: int, count: int) -> list[int]:
    """The `first` poses, and those that the diagnosis proposes one round after the other, of all that could be measured."""
    picked = [*range(first)]
    while len(picked) < count:
        others = poses.drop(index=picked)
        answer, _ = diagnose_poses(arm, poses.iloc[picked], others.reset_index(drop=True))
        picked += [int(others.index[int(p.at)]) for p in answer.next_experiment][: count - len(picked)]
    return picked


def main() -> None:
    """Print mean distances (mm) on both sets by model, then from 30 poses."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--arm", type=Path, default=Path("examples/ur5/arm.yaml"))
    parser.add_argument("--draws", type=int, default=20)
    options = parser.parse_args()
    arm = load_arm(options.arm)
    model = ArmModel(arm)
    (q, at), (q_new, at_new) = read(options.folder / "grid.csv"), read(options.folder / "random.csv")

    def distance(theta: dict[str, float], q: pd.DataFrame, at: Array) -> float:
        return 1e3 * float(np.linalg.norm(at - model(theta, q), axis=1).mean())

    table, names = Table("model", "parameters", "grid, mm", "held out, mm", "noise, um"), []
    for cause in (None, *model.causes):
        names += [*cause.parameters] if cause else []
        theta, noise = fit(model, names, q, at)
        figures = (f"{distance(theta, q, at):.4f}", f"{distance(theta, q_new, at_new):.4f}", f"{1e6 * noise:.1f}")
        table.add_row(f"+ {cause.name}" if cause else "as given", str(len(names)), *figures)
    poses, rng, errors = q.iloc[:, :6].assign(**dict(zip("xyz", at.T, strict=True))), np.random.default_rng(0), []
    for _ in range(options.draws):
        pool = poses.iloc[rng.choice(len(q), len(q) // 2, replace=False)].reset_index(drop=True)
        answers = [diagnose_poses(arm, pool.iloc[own]) for own in (chosen(arm, pool, FIRST, COUNT), [*range(COUNT)])]
        corrected = [forward(answer.values, q_new) for answer, forward in answers]
        errors.append([1e3 * float(np.linalg.norm(at_new - p, axis=1).mean()) for p in corrected])
    for name, column in zip(
        (f"{COUNT} poses, {COUNT - FIRST} proposed", f"{COUNT} random poses"), np.transpose(errors), strict=True
    ):
        table.add_row(f"{name}, median", "", "", f"{np.median(column):.4f} ({min(column):.4f} to {max(column):.4f})", "")
    Console().print(table)


if __name__ == "__main__":
    main()
