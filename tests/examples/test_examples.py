"""The rig.yaml for hardware that people copy loads and explains every key that there is; the notebooks run to their last cell and
end in what they promise."""

import importlib.util
import json
import re
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml
from pydantic import BaseModel

from lab.files.config import Source, check, load
from lab.files.rig_file import Instruments, RigFile, load_rig
from lab.rig.real_time import clock_of
from model.robot import Robot
from tests.diagnosis.small_campaigns import SOME
from tests.simulated.clock import SimulatedClock

ROOT = Path(__file__).parents[2]
PATH = ROOT / "examples/rig/rig.yaml"


def models(annotation: Any) -> list[type[BaseModel]]:
    """Every table that a rig.yaml may hold."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation, *(m for f in annotation.model_fields.values() for m in models(f.annotation))]
    return [m for a in get_args(annotation) for m in models(a)]


def alternatives() -> list[dict[str, Any]]:
    """The instruments that stand in comments, one table each."""
    blocks = re.findall(r"(?:^  #\| ?.*\n)+", PATH.read_text(), re.MULTILINE)
    return [yaml.safe_load(re.sub(r"^  #\| ?", "", block, flags=re.MULTILINE)) for block in blocks]


def test_it_loads_with_its_robot_and_runs_at_real_speed() -> None:
    rig = load_rig(PATH)
    assert clock_of(rig).speed == 1
    robot = load(rig.robot, Robot)
    assert robot.max_pressure is not None and rig.instruments.pressure is not None
    assert rig.instruments.pressure.max_pressure <= robot.max_pressure


@pytest.mark.parametrize("table", alternatives(), ids=lambda t: next(iter(t)))
def test_the_instruments_in_comments_load_too(table: dict[str, Any]) -> None:
    assert check(Source("alternative", table, {}), Instruments)


def test_no_key_is_missing_and_each_line_that_is_not_plain_says_what_it_is() -> None:
    text = PATH.read_text()
    for model in models(RigFile):
        for key in model.model_fields:
            assert re.search(rf"^[ #|]*{key}:", text, re.MULTILINE), f"{model.__name__}.{key} is not explained"
    assert len(alternatives()) == 2


def executed(name: str) -> tuple[str, dict[str, Any]]:
    spec = importlib.util.spec_from_file_location("notebook", ROOT / "docs/notebook.py")
    assert spec is not None and spec.loader is not None
    spec.loader.exec_module(module := importlib.util.module_from_spec(spec))
    path = ROOT / "examples/notebooks" / name
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in cells), "notebooks are kept without outputs"
    page, names = module.executed(path)
    assert page.count("```python") == sum(cell["cell_type"] == "code" for cell in cells)
    return page, names


def test_a_table_is_analysed_to_its_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lab.files.own_effects.CATALOGUE", SOME)
    page, names = executed("analysis.ipynb")
    assert "turned by 7.9" in repr(names["answer"]) and list(names["known"].effects) == ["chamber_azimuth"]
    assert names["reached"].reached.all() and names["longer"].length == 0.13
    assert "4 of 126 rows have no tip" in page and "<th>tip x [mm]</th>" in page


def test_a_protocol_runs_on_fakes(shared_clock: SimulatedClock) -> None:
    _, names = executed("protocol.ipynb")
    assert names["recording"].outcome == "completed" and len(names["case"].table) == 7
    assert float(max(names["fakes"].plant.chamber_pressure)) < 5e3
