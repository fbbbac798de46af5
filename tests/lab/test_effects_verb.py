"""`lab effects`: every effect has a signature, a person's own effect is shown with the others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lab.cli import main
from model.effects import CATALOGUE

pytestmark = pytest.mark.usefixtures("drawn")

OWN = """
from model.effects import EffectSpec, Law, Parameter


def _colder(q, v):
    q.body_modulus = q.body_modulus * (1 + 0.002 * v["kelvin"])


EFFECTS = (
    EffectSpec("colder", "material", "E = E (1 + 0.002 d)", (Parameter("kelvin", "K", 5.0, -30.0, 30.0),),
               Law(before=_colder), "a test", "a second day"),
)
"""


def test_every_effect_of_the_catalogue_and_of_ones_own_file_is_drawn_and_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN)
    assert main(["effects", "--out", str(tmp_path), "--effects", str(own), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    rms = {e["id"]: e["rms"] for e in told["effects"]}
    assert set(rms) == {*CATALOGUE, "colder"}
    # The paper's robot has chambers, and no tendons.
    assert {id for id, size in rms.items() if size < 1e-4} == {"tendon_slack", "tendon_friction"}
    assert {e["id"] for e in told["effects"] if e["read"] == "none"} == {"tendon_slack", "tendon_friction"}
    assert {e["id"] for e in told["effects"] if e["read"] == "while ramping"} == {"time_offset"}
    assert Path(told["figure"]).stat().st_size > 50_000


def test_a_file_without_effects_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = tmp_path / "own.py"
    own.write_text("EFFECTS = 3\n")
    assert main(["effects", "--out", str(tmp_path), "--effects", str(own)]) != 0
    assert "EFFECTS must be a tuple of EffectSpec" in capsys.readouterr().err
