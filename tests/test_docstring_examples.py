"""The examples in docstrings run, in a folder with a robot.yaml, a recording run.mcap and a case folder campaign/."""

import doctest
import importlib
import shutil
from pathlib import Path

import numpy as np
import pytest

from model.condition import conditions
from model.robot import load_robot
from model.rods import FINE, solve
from model.section import rods_of
from recordings.table_file import write_csv
from recordings.trials import Table, TrialRow

ROOT = Path(__file__).parent.parent
MODULES = {
    "diagnosis.answer.result": 1,
    "diagnosis.data.levels": 1,
    "diagnosis.diagnose": 1,
    "lab.api": 5,
    "lab.campaign.design": 1,
    "model.calibration": 2,
    "model.condition": 1,
    "model.effects.spec": 1,
    "model.robot": 2,
    "model.rods.solver": 1,
    "recordings.campaign.export": 2,
    "recordings.campaign.info": 1,
    "recordings.campaign.replay": 2,
    "recordings.file.reader": 1,
    "recordings.file.recover": 1,
    "recordings.file.verify": 1,
    "recordings.trials": 1,
}
"""Module -> how many of its docstrings have an example, at least."""
LENGTHS, PRESSURES = (0.0, 0.15), (0.0, 60e3, 120e3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tips of the rod model with 0.2 mm of noise, three chambers inflated, every sweep three times."""
    made = tmp_path_factory.mktemp("examples")
    shutil.copy(ROOT / "lab/files/paper_robot.yaml", made / "robot.yaml")
    shutil.copy(ROOT / "tests/recordings/data/bending-schema-1.mcap", made / "run.mcap")
    (made / "campaign").mkdir()
    shutil.copy(made / "robot.yaml", made / "campaign/robot.yaml")
    robot = load_robot(made / "robot.yaml")
    rng = np.random.default_rng(1)
    rows = []
    for repeat in range(1, 4):
        for length in LENGTHS:
            trial = len({r.trial for r in rows}) + 1
            for step, p in enumerate(PRESSURES, 1):
                pressures = (p,) * 3 + (0.0,) * (len(robot.chambers.azimuths_deg) - 3)
                tip = solve(rods_of(robot, conditions(robot, length, pressures)), FINE).tip[0] + 0.2e-3 * rng.normal(size=3)
                at = 60.0 * trial + step
                rows.append(TrialRow(trial, step, "bending", repeat, "load", at, length, pressures, tip=tuple(tip.tolist())))
    write_csv(Table.of(rows), made / "campaign/trials.csv")
    return made


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_of_docstrings_run_as_they_stand(
    name: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "examples"
    shutil.copytree(folder, here)
    monkeypatch.chdir(here)
    module = importlib.import_module(name)
    examples = [t for t in doctest.DocTestFinder().find(module) if t.examples]
    assert len(examples) >= MODULES[name]
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    for example in examples:
        assert runner.run(example).failed == 0, example.name
