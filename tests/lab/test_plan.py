"""`lab plan`: limits in the units of the steps, repeats folded, and what can be set of a protocol."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from lab import console
from lab.cli import main
from lab.files.all_protocols import found_protocols
from lab.files.example import paper_robot
from lab.files.protocol_keys import protocol_keys
from protocols.registry import OWN

RIG = Path(__file__).parents[2] / "examples" / "rig" / "rig.yaml"
LADDER = '''
"""Pressure levels, again and again."""

from pydantic import Field

from protocols.experiment import Ask, Plan, Step
from protocols.parameters import Parameters


class Ladder(Parameters):
    """Parameters."""

    levels: list[float] = Field([20e3, 40e3], json_schema_extra={"unit": "Pa"})
    """Visited in this order."""
    rounds: int = Field(2, ge=1, le=9)
    height: float = Field(json_schema_extra={"unit": "m"}, default=0.004)


PARAMETERS = Ladder
NEEDS = ("pressure",)


def plan(p):
    steps = [
        Step(f"{level / 1e3:g} kPa, repeat {k}", 4.0, Ask(pressures=(0.0, 0.0, level, level, level)))
        for k in range(1, p.rounds + 1)
        for level in p.levels
    ]
    return Plan("ladder", steps, {})


def run(bench, p, trials):
    pass
'''


@pytest.fixture
def ladder(tmp_path: Path) -> str:
    file = tmp_path / "ladder.py"
    file.write_text(LADDER)
    return str(file)


def planned(capsys: pytest.CaptureFixture[str], *words: str) -> list[str]:
    assert main(["plan", *words, "--rig", str(RIG)]) == 0
    return capsys.readouterr().out.splitlines()


def test_the_summary_comes_first_with_the_limits_in_the_units_of_the_steps(capsys: pytest.CaptureFixture[str]) -> None:
    told = planned(capsys, "bending", "--set", "pressures=[90 kPa]", "--set", "spine_lengths=[0, 20 cm]")
    assert told[0].startswith("bending: 8 steps, about ")
    assert told[1] == "  pressure 90 kPa of 250 kPa allowed: ok"
    assert "  spine length 20 cm of 35 cm allowed: ok" in told and "  tip mass 53 g" in told
    assert told[-1].endswith("0 kPa unload, spine 20 cm, vacuum 80 kPa, repeat 1")
    pushes = planned(capsys, "stiffness", "--set", "spine_lengths=[20 cm]")
    assert "  deflection 4 mm" in pushes and any(line.startswith("  expected force ") for line in pushes)


def test_repeats_are_folded_unless_all_are_asked_for(ladder: str, capsys: pytest.CaptureFixture[str]) -> None:
    told = planned(capsys, ladder, "--set", "rounds=5")
    assert told[1:3] == ["  pressure 40 kPa of 250 kPa allowed: ok", "  total pressure 120 kPa of 1500 kPa allowed: ok"]
    assert [line.split(maxsplit=3)[-1] for line in told[3:5]] == ["20 kPa", "40 kPa"]
    assert told[5].startswith("x 5 repeats") and len(told) == 6
    whole = planned(capsys, ladder, "--set", "rounds=5", "--all")
    assert len(whole) == 3 + 10 and whole[-1].endswith("40 kPa, repeat 5")
    odd = planned(capsys, ladder, "--set", "levels=[20 kPa, 40 kPa, 20 kPa]", "--set", "rounds=1")
    assert len(odd) == 3 + 3 and odd[-1].endswith("20 kPa, repeat 1")


def test_a_plan_that_asks_for_nothing_warns(ladder: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", ladder, "--rig", str(RIG), "--set", "levels=[0, 0]"]) == 0
    assert "ladder: no step asks for a pressure" in capsys.readouterr().err
    assert main(["plan", ladder, "--rig", str(RIG)]) == 0
    assert capsys.readouterr().err == ""


def test_a_plan_for_a_faster_clock_says_how_ones_own_time_is_computed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fast = tmp_path / "rig.yaml"
    fast.write_text(yaml.safe_dump(yaml.safe_load(RIG.read_text()) | {"clock": {"speed": 8.0}, "robot": "robot.yaml"}))
    (tmp_path / "robot.yaml").write_text(paper_robot().read_text())
    assert main(["plan", "bending", "--rig", str(fast)]) == 0
    assert "divided by 8, the speed of its clock" in capsys.readouterr().out
    assert not any("divided by" in line for line in planned(capsys, "bending"))


def test_the_keys_of_a_protocol_are_listed(ladder: str, capsys: pytest.CaptureFixture[str]) -> None:
    def keys(*words: str) -> dict[str, dict[str, str]]:
        assert main(["plan", *words, "--keys", "--json"]) == 0
        return {key["name"]: key for key in json.loads(capsys.readouterr().out)["keys"]}

    own = keys(ladder)
    assert own["levels"] == {
        "name": "levels", "unit": "kPa", "default": "[20, 40]", "limits": "", "meaning": "Visited in this order.",
    }  # fmt: skip
    assert (own["rounds"]["limits"], own["height"]["default"], own["height"]["unit"]) == ("from 1 to 9", "0.4", "cm")
    bending = keys("bending", "--rig", str(RIG))
    assert (bending["spine_lengths"]["limits"], bending["tip_mass"]["default"]) == ("from 0 to 35", "53")
    assert bending["reading"]["limits"] == "settled or sweep or hold"
    assert (bending["settle.band"]["unit"], bending["settle.band"]["default"]) == ("kPa", "1.5")
    assert keys("cycles")["chambers"]["limits"] == "from 1 to 64"
    assert main(["plan", ladder, "--keys"]) == 0
    assert "\nlevels (kPa): default [20, 40]\n    Visited in this order.\n" in capsys.readouterr().out
    assert main(["plan", "bending"]) == 2
    assert "--rig" in capsys.readouterr().err


@pytest.mark.parametrize("name", OWN)
def test_every_key_of_the_protocols_has_a_meaning_and_fits_a_narrow_terminal(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    found = protocol_keys(found_protocols().usable[name].parameters, {})
    assert [key.name for key in found if not key.meaning] == []
    monkeypatch.setattr(console.out, "width", 80)
    assert main(["plan", name, "--keys"]) == 0
    told = capsys.readouterr().out.splitlines()[1:-1]
    assert [line for line in told if len(line) > 80] == []
    assert [line.split()[0].rstrip(":") for line in told if not line.startswith(" ")] == [key.name for key in found]
    said = " ".join(line.strip() for line in told)
    assert [key.name for key in found if key.meaning not in said] == []


def test_a_key_under_its_earlier_name_is_taken_with_a_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "push.yaml"
    file.write_text("protocol: stiffness\nsteps: 3\nlengths: [7 cm]\n")
    told = planned(capsys, str(file))
    assert "  spine length 7 cm of 35 cm allowed: ok" in told
    assert main(["plan", str(file), "--rig", str(RIG)]) == 0
    assert "push.yaml:3:lengthsiscalledspine_lengthsnow" in "".join(capsys.readouterr().err.split())
    file.write_text("protocol: stiffness\nlengths: [7 cm, 7 m]\n")
    assert main(["plan", str(file), "--rig", str(RIG)]) == 2
    assert "push.yaml:2: spine_lengths" in capsys.readouterr().err
    file.write_text("protocol: stiffness\nlengths: [7 cm]\nspine_lengths: [7 cm]\n")
    assert main(["plan", str(file), "--rig", str(RIG)]) == 2
    assert "lengths: unknown key" in capsys.readouterr().err
