"""rig.yaml as `lab fakes` writes it: numbers with units, and the same rig when it is read."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml

from lab.files.config import check, parse_yaml
from lab.files.rig_file import RigFile
from lab.files.units import KINDS, to_si, written
from lab.rig.checked import digest
from lab.verbs.fakes import PATIENT, rig_yaml
from sim_fakes.instrument import Regulators
from sim_fakes.rig import FakeRig

AWKWARD = {
    "limits": {"max_total_pressure": 1e6 / 3, "max_age_in_motion": 0.03, "max_force": 59.999, "max_vacuum": 94_999.999},
    "stand": {"standoff": 0.0073, "tool_rotation": [0.1, 1.5707963267948966, 1 / 3]},
}


def merged(table: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    both = {k: merged(table[k], v) for k, v in changes.items() if isinstance(v, dict) and k in table}
    return {**table, **changes, **both}


@pytest.mark.parametrize("changes", [{}, PATIENT, AWKWARD])
@pytest.mark.parametrize(
    "how",
    [
        {"regulators": Regulators("alicat", 206.8e3, unit="psi"), "speed": 20.0},
        {"regulators": "smc_itv", "spine": "tmcl", "channels": 9},
        {"spine": ""},
    ],
)
def test_the_rig_that_is_read_is_the_one_that_was_written(how: dict[str, Any], changes: dict[str, Any]) -> None:
    fakes = FakeRig(**how)
    if not fakes.rig_file()["instruments"].get("spine"):
        changes = {key: values for key, values in changes.items() if key != "instruments"}
    read = check(parse_yaml(rig_yaml(fakes, "robot.yaml", changes), "rig.yaml"), RigFile)
    asked = RigFile.model_validate(merged(fakes.rig_file(), changes))
    assert read == asked and digest(read) == digest(asked)


def test_every_number_whose_unit_is_known_has_it() -> None:
    text = rig_yaml(FakeRig(), "robot.yaml", AWKWARD)
    told = yaml.safe_load(text)
    assert told["instruments"]["pressure"]["full_scale"] == "400 kPa"
    assert told["stand"]["origin"] == ["0.5 m", "0 m", "0.7 m"] and told["stand"]["standoff"] == "7.3 mm"
    assert told["stand"]["tool_rotation"] == ["0.1 rad", "1.5707963267948966 rad", "0.3333333333333333 rad"]
    assert told["limits"]["max_age_in_motion"] == "0.03 s" and told["limits"]["max_force"] == "59.999 N"
    bare = [line for line in text.splitlines() if re.search(r": -?[\d.]+$", line) and line.count(".") < 2]
    assert [line.split(":")[0].strip() for line in bare] == ["speed"]


@pytest.mark.parametrize("unit", KINDS)
def test_what_is_written_reads_back_to_the_last_bit(unit: str) -> None:
    values = [0.0, 1 / 3, 0.07, 0.29, 1e-3 / 7, 123456.789, 2.5e5, 1e-12, -0.35, 6.02e23]
    for value in values:
        assert [to_si(text, unit) for text in written([value], unit)] == [value]
    assert [to_si(text, unit) for text in written(values, unit)] == values
    assert len({text.partition(" ")[2] for text in written(values, unit)}) == 1
