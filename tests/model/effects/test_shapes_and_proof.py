"""Declarations of effects and what is refused, the trial of an effect of one's own, backbones, the same model on other states."""

import re
from collections.abc import Callable
from copy import copy
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from model.arrays import Array
from model.effects import CATALOGUE, EffectSpec, Law, Parameter
from model.effects.proof import prove
from model.effects.quantities import Quantities
from model.effects.spec import Values
from model.effects.spine import shear_spine
from model.errors import BadEffect
from model.robot import Robot
from tests.model.effects.campaigns import Moved, campaign
from tests.simulated.bench import raises


def test_every_effect_says_what_it_is_and_where_it_is_seen() -> None:
    for spec in CATALOGUE.values():
        assert spec.equation and spec.citation and spec.seen_best_in
        assert all(p.low <= s <= p.high for p in spec.parameters for s in p.starts)
        positive = [p for p in spec.parameters if p.sign in ("positive", "blend")]
        assert all(p.low == 0 for p in positive)
        assert all(p.high == 1 for p in positive if p.sign == "blend")
    assert CATALOGUE["pressure_offset"].family_id == CATALOGUE["pressure_deadband"].family_id


def test_declarations_that_could_never_be_absent_are_refused() -> None:
    raises(BadEffect, "must include zero", Parameter, "size", "1", 0.1, 0.5, 1.0)
    with pytest.raises(BadEffect, match="no parameter is a size"):
        EffectSpec("own", "load", "", (Parameter("form", "1", 0.1, -1.0, 1.0, role="shape"),), Law(), "", "")
    with pytest.raises(BadEffect, match="stage"):
        EffectSpec("own", "weather", "", (Parameter("size", "1", 0.1, -1.0, 1.0),), Law(), "", "")  # type: ignore[arg-type]


def test_the_papers_table_asks_for_six_and_a_half_megapascal_and_a_soft_core(paper_robot: Robot) -> None:
    found = shear_spine(paper_robot.spine)
    assert found.modulus == pytest.approx(6.6e6, rel=0.02)
    assert 3 * paper_robot.spine.radius**2 / (4 * found.shear) == pytest.approx(0.0070e-6, rel=0.02)
    engaged = found.engaged(np.array([0.05, 0.3]))
    assert 0.02 < engaged[0] < 0.06 and 0.5 < engaged[1] < 0.6


def test_a_backbone_runs_from_the_mount_to_the_tip_that_is_read(paper_robot: Robot) -> None:
    made = Moved(paper_robot, campaign(lengths=(0.0, 0.2)))
    turned = {"frame_misalignment.y": 0.05, "frame_misalignment.z": 0.02}
    arcs = np.append(np.linspace(0.0, paper_robot.length, 60), 2 * paper_robot.length)
    curves = made.forward.shapes(made.vector(turned), arcs)
    assert curves.shape == (len(made.still), 61, 3)
    assert np.abs(curves[:, 0]).max() < 1e-6
    assert curves[:, -1] == pytest.approx(made.tips(turned), abs=1e-6)
    assert np.linalg.norm(np.diff(curves, axis=1), axis=2).sum(axis=1) == pytest.approx(paper_robot.length, rel=0.08)


def test_the_model_on_other_states_keeps_area_and_obstacle(paper_robot: Robot) -> None:
    every, alone = (Moved(paper_robot, campaign(lengths)) for lengths in ((0.0, 0.1, 0.3), (0.1,)))
    other = copy(alone)
    other.forward = every.forward.on(alone.forward.design)
    contact = {"contact.stiffness": 300.0, "contact.distance": -0.03}
    own = np.abs(every.forward.design.spine_length - 0.1) < 1e-9
    assert other.tips(contact) == pytest.approx(every.tips(contact)[own], abs=1e-6)
    assert set(other.forward.area_factor) == set(every.forward.area_factor)
    assert np.abs(alone.tips(contact) - other.tips(contact)).max() > 1e-3


def effect(law: Callable[[Quantities, Values], None]) -> EffectSpec:
    parameter = Parameter("kelvin", "K", 5.0, -30.0, 1e9)
    return EffectSpec("colder", "material", "E (1 + 0.002 d)", (parameter,), Law(before=law), "a test", "a second day")


def setting(name: str, made: Callable[[Any, Array], Any], parameter: str = "kelvin") -> EffectSpec:
    """An effect that sets one quantity."""
    return effect(lambda q, v: setattr(q, name, made(q, v[parameter])))


def of_two(i: int, j: int, joint: bool) -> EffectSpec:
    """Two chambers exchange pressures in part, or where both are inflated both push more."""

    def mixed(q: Quantities, d: Array) -> Array:
        one, other, unit = q.pressure[..., [i]], q.pressure[..., [j]], np.eye(q.pressure.shape[-1])
        change = 1e-6 * one * other * (unit[i] + unit[j]) if joint else (other - one) * (unit[i] - unit[j])
        return np.asarray(q.pressure + 0.1 * d[..., None] * change)

    return setting("pressure", mixed)


def test_a_sound_effect_of_one_s_own_passes_whichever_chambers_it_acts_on(paper_robot: Robot, pulled: Robot) -> None:
    sound = [setting("body_modulus", lambda q, d: q.body_modulus * (1 + 0.002 * d)),
             setting("tip_force", lambda q, d: q.tip_force + 0.01 * d[..., None] * q.design.force)]  # fmt: skip
    for robot in (paper_robot, pulled):
        pairs = combinations(range(len(robot.actuators.azimuths_deg)), 2)
        prove(robot, [*sound, *(of_two(*pair, joint) for pair in pairs for joint in (False, True))])


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (setting("body_modulus", lambda q, d: q.body_modulus * (1 + 0.002 * d), "kelwin"), "law fails: KeyError: 'kelwin'"),
        (setting("tip_force", lambda q, d: q.tip_force + np.array([[[1.0, 2.0]]]) * d), "law fails"),
        (setting("body_modulos", lambda q, d: q.body_modulus), "no attribute 'body_modulos'; did you mean body_modulus?"),
        (
            setting("tether", lambda q, d: q.tether + 1e-15 * d),
            "moves no reading of a small campaign at its plausible size by more than 1e-09 (m, rad or N), with each chamber",
        ),
        (setting("body_modulus", lambda q, d: q.body_modulus * (1.01 + 0.002 * d)), "must have exactly no effect"),
        (
            setting("tip_force", lambda q, d: q.tip_force - np.array([0.0, 0.0, 1e4]) * d[..., None]),
            "no state of a small campaign has an equilibrium",
        ),
    ],
    ids=["misspelt", "shape", "no quantity", "nothing", "never off", "too large"],
)
def test_an_effect_that_cannot_be_weighed_is_refused_by_name(paper_robot: Robot, spec: EffectSpec, said: str) -> None:
    raises(BadEffect, f"colder: .*{re.escape(said)}", prove, paper_robot, [spec])
