"""Numbers in texts from outside have one grammar, wherever they stand: ASCII digits, no underscores."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import pandas as pd
import pytest
from commands import Cli, refused
from pydantic import Field

from lab.files.config import ConfigError, check, parse_yaml
from lab.files.robot_file import paper_robot
from lab.files.units import UnitError, to_si
from lab.imports.columns import judge
from model.plain_yaml import FileTable
from model.robot import Robot
from recordings.errors import BadTable
from recordings.numbers import number, whole_number
from recordings.table_file import read_csv, read_numbers
from tests.simulated.bench import raises

NO_NUMBERS = [
    "0.0_5", "1_000", "0x10", "0b1", "1e1_0", "\uff11\uff12", "\u0663", "1.\uff15", "1e\uff13", "1,5", "- 1", "--1", "e5", ".",
]  # fmt: skip
"""Some of them Python's float would take: `0.0_5`, full-width and Arabic digits."""
NUMBERS = {"1": 1.0, "+1.": 1.0, "-.5": -0.5, "1e5": 1e5, "1E-3": 1e-3, " 2 ": 2.0, "007": 7.0}


class Values(FileTable):
    """A file of a person."""

    plain: float = Field(0.0)
    length: float = Field(0.0, json_schema_extra={"unit": "m"})
    lengths: tuple[float, ...] = Field((), json_schema_extra={"unit": "m"})
    count: int = Field(0)


def test_what_is_a_number() -> None:
    assert {text: number(text) for text in NUMBERS} == NUMBERS
    assert math.isnan(number("NaN")) and number("-Infinity") == -math.inf and whole_number("-12") == -12


@pytest.mark.parametrize("text", NO_NUMBERS)
def test_what_is_none_is_refused_everywhere(text: str, tmp_path: Path, cli: Cli) -> None:
    for read, said in product((number, whole_number), (text, 100_000 * "1" + "x")):  # a long one at once
        raises(ValueError, "is not a", read, said)
    for quantity in (text, f"{text} m"):
        raises(UnitError, None, to_si, quantity, "m")
    for key, value in [(key, value) for key in ("plain", "length", "count") for value in (text, f"'{text}'")]:
        with pytest.raises(ConfigError, match=rf"{key}|usable number|valid YAML"):
            check(parse_yaml(f"{key}: {value}\n", "values.yaml"), Values)
    refused("lengths", check, parse_yaml(f"lengths: [0.1, '{text}']\n", "values.yaml"), Values)
    robot = paper_robot().read_text().replace("area_factor: {0.0:", f"area_factor: {{'{text}':", 1)
    refused("area_factor", check, parse_yaml(robot, "robot.yaml"), Robot)
    table = tmp_path / "table.csv"
    table.write_text(f'p1,x\n0,"{text}"\n')
    raises(BadTable, "is not a number", read_numbers, table, ("x",), r"p[0-9]+", "x")
    trials = tmp_path / "trials.csv"
    trials.write_text(f'trial,step,protocol,repeat,branch,t,spine_length,p1,x,y,z\n1,1,bending,1,load,0,0,"{text}",0,0,0.4\n')
    raises(BadTable, "p1: .* is not a number", read_csv, trials)
    if text != "1,5":  # a decimal comma, in a table of another program
        assert math.isnan(float(judge(pd.Series(["1.5", "2.5", text], dtype=str)).values[2]))
    assert "--seed" in cli("fakes", f"--seed={text}", "--list-effects", code=2).err
    assert "--effect" in cli("fakes", "--effect", f"base_tilt={text}", code=2).err
