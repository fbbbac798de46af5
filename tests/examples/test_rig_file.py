"""The rig.yaml for hardware that people copy: it loads, and it explains every key that there is."""

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

PATH = Path(__file__).parent.parent.parent / "examples" / "rig" / "rig.yaml"


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
