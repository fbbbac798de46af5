"""Small campaigns for tests of `lab diagnose`: tips and orientations of the forward model with known effects, plus noise."""

import contextlib
import io
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from lab.cli import main
from lab.files.robot_file import paper_robot
from model.effects import CATALOGUE, EffectSpec, ForwardModel, design_from_columns
from model.robot import load_robot
from model.rotation import from_vector, multiply
from recordings.table_file import write_csv
from recordings.trials import Table, TrialRow
from tests.model.effects import campaigns

ROBOT = load_robot(paper_robot())
LENGTHS = (0.0, 0.1, 0.2, 0.3)
PRESSURES = (0.0, 80e3, 160e3, 240e3)
AREA_FACTOR = 1.7
"""Of every campaign, whatever its spine lengths."""
TIP_NOISE, TURN_NOISE, AGAIN, JAM = 0.3e-3, math.radians(0.3), 1e-3, 0.02
"""m and rad of a reading; m of spine length and share of spine stiffness by which trials differ."""

EULER = """
from model.condition import conditions
from model.rods import PAPER, solve
from model.section import rods_of
from model.simulators import Readings


class Euler:
    parameters = ()

    def __init__(self, robot):
        self.robot = robot

    def predict(self, states, parameters):
        at = conditions(self.robot, states.spine_length, states.pressure, states.tip_mass, states.roll, states.force)
        return Readings(tip=solve(rods_of(self.robot, at), PAPER).tip)


SIMULATOR = Euler
"""
"""A simulator of a person's own."""


@dataclass(frozen=True)
class Answered:
    """A case that was diagnosed by the command, and what came of it."""

    case: Path
    other: Path
    """The campaign held out."""
    json: Path
    page: Path
    protocols: Path
    code: int = -1
    said: str = ""


def campaign(
    effects: Mapping[str, float],
    seed: int = 1,
    repeats: int = 3,
    lengths: Sequence[float] = LENGTHS,
    pressures: Sequence[float] = PRESSURES,
    chambers: Sequence[int] = (9, 1, 2),
    catalogue: Mapping[str, EffectSpec] = CATALOGUE,
) -> list[TrialRow]:
    """A bending campaign up and down; `effects` parameter name -> value."""
    same = {"tip_mass": ROBOT.tip_mass, "roll_deg": 0.0}
    table = campaigns.campaign(lengths, pressures, zero=False, repeats=repeats, hold=3.0, chambers=chambers, **same)
    table |= {"step": table["step"] + 1, "rate": np.where(table["branch"] == "load", 25e3, -25e3)}
    table |= {"t": 100.0 * table["trial"] + 8.0 * table["step"]}
    cells = [dict(zip(table, row, strict=True)) for row in zip(*(own.tolist() for own in table.values()), strict=True)]
    forward = ForwardModel(ROBOT, design_from_columns(ROBOT, table), catalogue=catalogue, area_factor=AREA_FACTOR)
    rng = np.random.default_rng(seed)
    spread = {"spine_length": AGAIN, "spine_stiffness": JAM}
    drawn = ((p.name, spread.get(p.source, 0.0) * p.recurs * rng.normal()) for p in forward.parameters)
    theta = np.array([effects.get(name, random) for name, random in drawn])
    if unused := set(effects) - {p.name for p in forward.parameters}:
        raise KeyError(f"no such parameters: {sorted(unused)}")
    predicted = forward.predict(theta)
    n = len(cells)
    read = {name: predicted[forward.observations.channel == name] for name in ("x", "y", "z", "rx", "ry", "rz")}
    tip = np.stack([read[k] for k in "xyz"], axis=1) + TIP_NOISE * rng.normal(size=(n, 3))
    turn = np.stack([read[k] for k in ("rx", "ry", "rz")], axis=1) + TURN_NOISE * rng.normal(size=(n, 3))
    q = multiply(from_vector(turn), forward.observations.reference[:n])
    return [
        TrialRow.from_cells({**c, **dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz"), map(float, (*p, *o)), strict=True))})
        for c, p, o in zip(cells, tip, q, strict=True)
    ]


def folder(path: Path, rows: Sequence[TrialRow], robot: Path | None = None) -> Path:
    """A case folder, of the paper's robot if no other is given."""
    path.mkdir(parents=True, exist_ok=True)
    shutil.copy(robot or paper_robot(), path / "robot.yaml")
    write_csv(Table.of(rows), path / "trials.csv")
    return path


def without(column: str, path: Path, rows: Sequence[TrialRow]) -> Path:
    """A case folder whose table lacks a column."""
    import pandas  # slow to import

    file = folder(path, rows) / "trials.csv"
    pandas.read_csv(file).drop(columns=column).to_csv(file, index=False)
    return path


@cache
def answered_once(root: Path) -> Answered:
    """One diagnosis for all tests of a process, in a new folder: a spine credited as by area moments, tried on other chambers."""
    effects = {"area_moment.blend": 0.9}
    case = folder(root / "case", campaign(effects))
    other = folder(root / "other", campaign(effects, seed=2, repeats=2, lengths=(0.0, 0.2), chambers=(3, 4, 5)))
    made = Answered(case, other, root / "diagnosis.json", root / "diagnosis.html", root / "next")
    written = ["--json", made.json, "--report", made.page, "--protocols", made.protocols]
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main([str(a) for a in ("diagnose", case, "--holdout", other, *written)])
    return replace(made, code=code, said=said.getvalue())
