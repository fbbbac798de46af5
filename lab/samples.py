"""Robots drawn from the posterior that a robot.yaml states: for domain randomisation in whatever simulator trains on them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from model.effects.nominal import TOLERANCES, stated_effects
from model.effects.spec import EffectSpec
from model.robot import Robot
from recordings.own_files import replaced

from .files.config import ConfigError
from .files.robot_file import write_robot

Array = NDArray[np.float64]

LEAST_AREA, MOST_AREA = 1e-6, 20.0


def drawn(robot: Robot, catalogue: Mapping[str, EffectSpec], n: int, seed: int) -> tuple[tuple[str, ...], Array, list[Robot]]:
    """Names (k), values (n, k) and robots (n) of the normal posterior cut at the parameters' bounds.

    Raises ConfigError for a robot of which nothing is uncertain.
    """
    names, covariance = robot.joint_uncertainty()
    if not names:
        raise ConfigError(f"robot {robot.name!r}: nothing of it is uncertain, so there is nothing to draw; see `lab fit --with`")
    stated, known = robot.stated, {**TOLERANCES, **stated_effects(robot, catalogue)}
    bounds = {f"{id}.{p.name}": (p.low, p.high) for id, spec in known.items() for p in spec.parameters}
    limits = np.array([bounds.get(name, (LEAST_AREA, MOST_AREA)) for name in names], float)
    factor = robot.area_factor
    area = factor if isinstance(factor, float) else 0.0
    mean = np.array([stated[n].value if n in stated else area for n in names], np.float64)
    half = np.asarray(np.linalg.cholesky(covariance), np.float64)
    rng = np.random.default_rng(seed)
    values = np.array([_within(mean, half, limits, rng) for _ in range(n)])
    return names, values, [robot.with_values(dict(zip(names, row, strict=True))) for row in values.tolist()]


def _within(mean: Array, half: Array, limits: Array, rng: np.random.Generator) -> Array:
    low, high = limits[:, 0], limits[:, 1]
    value = mean
    # then those that do not lie within their bounds are put on them
    for _ in range(1000):
        value = mean + half @ rng.normal(size=len(mean))
        if ((value >= low) & (value <= high)).all():
            break
    return np.clip(value, low, high)


def write_samples(names: tuple[str, ...], values: Array, robots: list[Robot], folder: Path, given: str = "") -> Iterator[Path]:
    """One robot.yaml each, and samples.csv with a line for each and a column for each parameter, in its unit.

    `given`: the robot.yaml that they were derived from, see `lab.files.robot_file`.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["file", *names])
    width = max(4, len(str(len(robots))))
    for k, (row, robot) in enumerate(zip(values.tolist(), robots, strict=True), 1):
        file = f"robot-{k:0{width}d}.yaml"
        writer.writerow([file, *map(repr, row)])
        yield write_robot(robot, folder / file, given)
    replaced(folder / "samples.csv", text.getvalue())
