"""`lab effects`: every effect has a signature, a person's own effect is shown with the others."""

from pathlib import Path

import pytest
from commands import Cli

from model.effects import CATALOGUE

OWN = """
from model.effects import EffectSpec, Law, Parameter


def _colder(q, v):
    q.body_modulus = q.body_modulus * (1 + 0.002 * v["kelvin"])


EFFECTS = (
    EffectSpec("colder", "material", "E = E (1 + 0.002 d)", (Parameter("kelvin", "K", 5.0, -30.0, 30.0),),
               Law(before=_colder), "a test", "a second day"),
)
"""


@pytest.mark.usefixtures("drawn")
def test_every_effect_of_the_catalogue_and_of_ones_own_file_is_drawn_and_listed(tmp_path: Path, cli: Cli) -> None:
    own = tmp_path / "own.py"
    own.write_text(OWN)
    told = cli("effects", "--out", tmp_path / "out", "--effects", own, "--json").json
    rms = {e["id"]: e["rms"] for e in told["effects"]}
    assert set(rms) == {*CATALOGUE, "colder"}
    # The paper's robot has chambers, and no tendons.
    assert {id for id, size in rms.items() if size < 1e-4} == {"tendon_slack", "tendon_friction"}
    assert {e["id"] for e in told["effects"] if e["read"] == "none"} == {"tendon_slack", "tendon_friction"}
    assert {e["id"] for e in told["effects"] if e["read"] == "while ramping"} == {"time_offset"}
    assert Path(told["figure"]).stat().st_size > 50_000
