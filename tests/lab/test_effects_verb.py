"""`lab effects`: every effect has a signature, a person's own effect is shown with the others."""

from pathlib import Path

import pytest
from commands import Cli

from lab.files.robot_file import paper_robot
from lab.verbs.effects import signatures
from model.effects import CATALOGUE
from model.robot import THRUST, load_robot
from tests.model.effects.test_shapes_and_proof import of_two

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


def test_an_effect_that_robot_yaml_states_in_full_is_shown_by_what_less_of_it_does() -> None:
    (shown,) = signatures(load_robot(paper_robot()).replace(thrust="walls"), {THRUST: CATALOGUE[THRUST]})
    assert shown.rms > 1e-3


def test_an_effect_on_two_chambers_is_shown_with_one_of_them_alone() -> None:
    (shown,) = signatures(load_robot(paper_robot()), {"colder": of_two(4, 5, joint=False)})
    assert shown.how == "chamber 5 alone" and shown.rms > 1e-3 and shown.x.max() == 250e3
