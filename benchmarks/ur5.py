"""Errors of a measured arm by cause: `python -m benchmarks.ur5 FOLDER [--arm examples/ur5/arm.yaml] [--draws 20]`.

FOLDER holds grid.csv and random.csv of P. Jacobi's UR5 (github.com/pauljac7700/serial_robots_datasets): targets x_t, y_t, z_t
and measured errors x_dif, y_dif, z_dif in mm, joint_1 .. joint_6 in deg, in the order in which they were measured. Every fit
sees the grid alone, with the causes' plausible sizes as priors; the random poses are held out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from model.arm import ArmModel, load_arm
from model.robot import Array

NOISE = 3e-5
"""m, along each axis: what is taken of a campaign too small to estimate it, a third of the maker's repeatability of 0.1 mm."""
ROUNDS = 6
"""Of Gauss and Newton; the last changes no figure."""


def read(path: Path) -> tuple[pd.DataFrame, Array]:
    """Inputs (angles and those before them, rad) and measured positions (n, 3), m."""
    table = pd.read_csv(path)
    q = pd.DataFrame({f"q{k}": np.radians(table[f"joint_{k}"]) for k in range(1, 7)})
    at = table[["x_t", "y_t", "z_t"]].to_numpy() + table[["x_dif", "y_dif", "z_dif"]].to_numpy()
    return q.join(q.shift().add_suffix("_before")), at / 1e3


def fit(
    model: ArmModel, names: list[str], q: pd.DataFrame, at: Array, noise: float | None = None
) -> tuple[dict[str, float], float]:
    """Most probable parameters, and the noise (m, along each axis): estimated by its restricted likelihood if not given."""
    sizes, x, sigma = np.array([model.parameters[n][1] for n in names]), np.zeros(len(names)), noise or 1e-4
    for _ in range(ROUNDS):
        theta = dict(zip(names, x * sizes, strict=True))
        jac = model.derivatives(theta, q, names).reshape(at.size, -1) * sizes
        misfit = (at - model.predict(theta, q)).ravel() + jac @ x
        gram = jac.T @ jac
        inverse = np.linalg.inv(gram / sigma**2 + np.eye(len(names)))
        x = inverse @ (jac.T @ misfit) / sigma**2
        free = misfit.size - float(np.sum(inverse * gram)) / sigma**2
        sigma = noise or float(np.sqrt(np.sum((misfit - jac @ x) ** 2) / free))
    return dict(zip(names, x * sizes, strict=True)), sigma


def choose(jac: Array, start: int, count: int, noise: float) -> list[int]:
    """Poses that one after the other most reduce the mean predicted variance over all of jac (poses, 3, parameters)."""
    flat, cov, picked = jac.reshape(-1, jac.shape[-1]), np.eye(jac.shape[-1]), [start]
    while True:
        own = jac[picked[-1]] @ cov
        cov = cov - own.T @ np.linalg.solve(own @ jac[picked[-1]].T + noise**2 * np.eye(3), own)
        if len(picked) == count:
            return picked
        joint = (flat @ cov @ flat.T).reshape(-1, len(jac), 3)
        variance = np.array([joint[3 * i : 3 * i + 3, i] for i in range(len(jac))]) + noise**2 * np.eye(3)
        gain = np.einsum("nij,nji->n", np.linalg.inv(variance), np.einsum("mni,mnj->nij", joint, joint))
        gain[picked] = -np.inf
        picked.append(int(np.argmax(gain)))


def main() -> None:
    """Print mean distances (mm) on both sets by model, then from 30 poses."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--arm", type=Path, default=Path("examples/ur5/arm.yaml"))
    parser.add_argument("--draws", type=int, default=20)
    options = parser.parse_args()
    model = ArmModel(load_arm(options.arm))
    (q, at), (q_new, at_new) = read(options.folder / "grid.csv"), read(options.folder / "random.csv")

    def distance(theta: dict[str, float], q: pd.DataFrame, at: Array) -> float:
        return 1e3 * float(np.linalg.norm(at - model.predict(theta, q), axis=1).mean())

    table, names = Table("model", "parameters", "grid, mm", "held out, mm", "noise, um"), []
    for cause in (None, *model.causes):
        names += [*cause.parameters] if cause else []
        theta, noise = fit(model, names, q, at)
        figures = (f"{distance(theta, q, at):.4f}", f"{distance(theta, q_new, at_new):.4f}", f"{1e6 * noise:.1f}")
        table.add_row(f"+ {cause.id}" if cause else "as given", str(len(names)), *figures)
    sizes, rng, errors = np.array([model.parameters[n][1] for n in names]), np.random.default_rng(0), []
    for _ in range(options.draws):
        pool = rng.choice(len(q), len(q) // 2, replace=False)
        chosen = pool[choose(model.derivatives({}, q.iloc[pool], names) * sizes, 0, 30, NOISE)]
        errors.append([distance(fit(model, names, q.iloc[p], at[p], NOISE)[0], q_new, at_new) for p in (chosen, pool[:30])])
    for name, column in zip(("30 chosen poses", "30 random poses"), np.transpose(errors), strict=True):
        table.add_row(
            f"{name}, median", str(len(names)), "", f"{np.median(column):.4f} ({min(column):.4f} to {max(column):.4f})", ""
        )
    Console().print(table)


if __name__ == "__main__":
    main()
