"""Predictions of another simulator: read from a table or asked of the simulator, and every doubt told."""

import csv
import dataclasses
import json
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from commands import Cli, refused
from diagnosed_case import EULER, ROBOT, campaign, folder

from lab.files.baseline import from_simulator, from_table, simulator
from lab.files.config import ConfigError
from lab.files.inputs import Case, read_case
from model.condition import States, conditions
from model.effects import CATALOGUE
from model.rods import FINE, solve
from model.section import rods_of
from model.simulators import Readings
from recordings.errors import BadTable
from tests.simulated.bench import raises

LENGTHS, PRESSURES = (0.0, 0.2), (0.0, 100e3, 200e3)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    rows = campaign({"chamber_azimuth.angle": np.radians(8)}, lengths=LENGTHS, pressures=PRESSURES)
    return read_case([folder(tmp_path_factory.mktemp("case"), rows)])


def written(path: Path, rows: list[dict[str, object]]) -> Path:
    with path.open("w", newline="", encoding="utf-8") as f:
        table = csv.DictWriter(f, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    return path


def by_step(case: Case, scale: float = 1.0) -> list[dict[str, object]]:
    return [
        {"trial": r.trial, "step": r.step, **dict(zip("xyz", (scale * c for c in r.tip or ()), strict=True))} for r in case.table
    ]


def test_rows_are_matched_by_trial_and_step(case: Case, tmp_path: Path) -> None:
    made = from_table(written(tmp_path / "p.csv", by_step(case)[::-1]), case)
    assert made.predicted.tip == pytest.approx(np.array([r.tip for r in case.table]))
    assert np.isnan(made.predicted.orientation).all() and made.name == "p.csv"
    assert made.predicted.pressures == pytest.approx(np.array([r.pressures for r in case.table]))


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ([{"trial": 1, "step": 1, "x": 0.0, "y": 0.0}], "has no column z"),
        ([{"trial": 1, "step": 1, "x": 0, "y": 0, "z": 0.4}] * 2, "trial 1 step 1 is predicted twice"),
        ([{"trial": 77, "step": 1, "x": 0.0, "y": 0.0, "z": 0.4}], "predicts none of the"),
        ([{"x": 0.0, "y": 0.0, "z": 0.4}], "has no column trial; trial and step name the row of trials.csv"),
        ([{"trial": 1, "step": 1, "x": "left", "y": 0, "z": 0.4}], "p.csv line 2, x: 'left' is not a number"),
    ],
)
def test_what_cannot_be_matched_is_told(case: Case, tmp_path: Path, rows: list[dict[str, object]], told: str) -> None:
    raises((ConfigError, BadTable), told, from_table, written(tmp_path / "p.csv", rows), case)


def test_a_prediction_in_millimetres_is_refused(case: Case, tmp_path: Path) -> None:
    refused("mm", from_table, written(tmp_path / "p.csv", by_step(case, scale=1e3)), case)


class Rod:
    """The rod itself, which knows how soft it is."""

    parameters = ("youngs_modulus.excess",)

    def __init__(self) -> None:
        self.asked: list[int] = []

    def predict(self, states: States, parameters: Mapping[str, float]) -> Readings:
        self.asked.append(len(states))
        at = conditions(ROBOT, states.spine_length, states.pressure, states.tip_mass, states.roll)
        softer = 1 + parameters.get("youngs_modulus.excess", 0.0)
        robot = ROBOT.model_copy(update={"youngs_modulus": ROBOT.youngs_modulus * softer})
        return Readings(solve(rods_of(robot, at), FINE).tip)


def test_a_simulator_is_asked_once_for_each_setting_and_for_each_of_its_parameters(case: Case) -> None:
    own = Rod()
    steps: list[tuple[float, float]] = []
    made = from_simulator("rod", own, case, CATALOGUE, lambda done, total: steps.append((done, total)))
    assert sum(own.asked) == 2 * len(LENGTHS) * len(PRESSURES) and max(own.asked) <= 8
    assert steps[-1][0] == steps[-1][1] == len(own.asked)
    step, there = made.varied["youngs_modulus.excess"]
    assert step == pytest.approx(0.002) and np.abs(there.predicted.tip - made.predicted.tip).max() > 1e-5


def test_a_moment_on_the_tip_reaches_a_simulator(case: Case) -> None:
    moment = np.where(case.table["step"] == 2, 0.2, np.nan)
    robot = case.robot.replace(tip_moment=(0.1, 0.0, 0.05))
    bent = Case(robot, dataclasses.replace(case.table, values=case.table.values | {"tip_moment_y": moment}))

    class Watched(Rod):
        moments: list[np.ndarray] = []

        def predict(self, states: States, parameters: Mapping[str, float]) -> Readings:
            self.moments.append(states.moment)
            return super().predict(states, parameters)

    from_simulator("rod", Watched(), bent, CATALOGUE, lambda done, total: None, varied=False)
    assert {*map(tuple, np.vstack(Watched.moments).tolist())} == {(0.1, 0.0, 0.05), (0.1, 0.2, 0.05)}


def test_a_simulator_that_is_none_is_refused(case: Case, tmp_path: Path) -> None:
    refused("--simulator pielastica: is unknown, .*pyelastica", simulator, "pielastica", ROBOT)
    for text, told in (
        ("x = 1", "has no SIMULATOR"),
        ("SIMULATOR = lambda robot: 3", "must give `parameters` and `predict"),
        ("SIMULATOR = lambda: 3", "fails for this robot: TypeError"),
        ("def SIMULATOR(robot):\n    raise ImportError('no such library')", "no such library"),
    ):
        (tmp_path / "own.py").write_text(text)
        refused(told, simulator, str(tmp_path / "own.py"), ROBOT)

    class Wrong(Rod):
        parameters = ("softness",)  # type: ignore[assignment]

    class Flat(Rod):
        parameters = ()  # type: ignore[assignment]

        def predict(self, states: States, parameters: Mapping[str, float]) -> Readings:
            return Readings(np.zeros((len(states), 2)))

    for own, told in ((Wrong(), "parameter 'softness' is not known"), (Flat(), r"tip has the shape \(\d, 2\), must be")):
        refused(told, from_simulator, "own", own, case, CATALOGUE, lambda done, total: None)


def test_one_that_comes_with_the_software_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    assert simulator("pyelastica", ROBOT)[1].parameters == ("area.excess",)
    monkeypatch.setitem(sys.modules, "model.simulators.pyelastica", None)
    refused(r"is not installed .* pip install 'softlab\[pyelastica\]'", simulator, "pyelastica", ROBOT)


def test_the_command_diagnoses_the_gap_of_a_simulator(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    few = {effect: CATALOGUE[effect] for effect in ("chamber_azimuth", "pressure_offset")}
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", few)
    place = folder(tmp_path / "case", campaign({"chamber_azimuth.angle": np.radians(8)}, lengths=LENGTHS, pressures=PRESSURES))
    (tmp_path / "euler.py").write_text(EULER)
    out = tmp_path / "out.json"
    asked = ["diagnose", place, "--simulator", tmp_path / "euler.py", "--json", out]
    cli(*asked, "--report", tmp_path / "out.html")
    found = json.loads(out.read_text())
    assert found["attribute"]["effects"] == ["chamber_azimuth"]
    assert found["simulator"]["name"] == "euler"
    assert [s["step"] for s in found["waterfall"]["steps"]][:2] == ["calibration", "simulator"]
    page = (tmp_path / "out.html").read_text()
    assert "euler, <a" in page and "the simulator replaced by the rod" in page
    assert "no equilibrium in the measured states" not in page
    for more in (["--baseline", "p.csv"], ["--reference", place], ["--holdout", place]):
        cli(*asked, *more, code=2)
