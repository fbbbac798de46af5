"""Backbones of the forward model, the same model on other states, and the trial of an effect of one's own."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from model.effects import EffectSpec, ForwardModel, Law, Parameter, design_from_columns
from model.effects.proof import prove
from model.effects.quantities import Quantities
from model.effects.spec import Values
from model.errors import BadEffect
from model.robot import Robot


def tips(forward: ForwardModel, theta: np.ndarray) -> np.ndarray:
    predicted = forward.predict(theta)
    return np.stack([predicted[forward.observations.channel == axis] for axis in "xyz"], axis=1)


def test_a_backbone_runs_from_the_mount_to_the_tip_that_is_read(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    forward = ForwardModel(paper_robot, design_from_columns(paper_robot, make_campaign(lengths=(0.0, 0.2))))
    theta = np.zeros(len(forward.parameters))
    theta[forward.index("frame_misalignment")] = [0.0, 0.05, 0.02]
    arcs = np.append(np.linspace(0.0, paper_robot.length, 60), 2 * paper_robot.length)
    curves = forward.shapes(theta, arcs)
    assert curves.shape == (len(forward.design), 61, 3)
    assert np.abs(curves[:, 0]).max() < 1e-6
    assert curves[:, -1] == pytest.approx(tips(forward, theta), abs=1e-6)
    long = np.linalg.norm(np.diff(curves, axis=1), axis=2).sum(axis=1)
    assert long == pytest.approx(paper_robot.length, rel=0.08)


def test_the_model_on_other_states_keeps_area_and_obstacle(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    every = ForwardModel(paper_robot, design_from_columns(paper_robot, make_campaign(lengths=(0.0, 0.1, 0.3))))
    one = design_from_columns(paper_robot, make_campaign(lengths=(0.1,)))
    other = every.on(one)
    theta = np.zeros(len(every.parameters))
    theta[every.index("contact")] = [300.0, -0.03, 0.0, 0.0]
    there = np.zeros(len(other.parameters))
    there[other.index("contact")] = [300.0, -0.03, 0.0, 0.0]
    own = np.abs(every.design.spine_length - 0.1) < 1e-9
    assert tips(other, there) == pytest.approx(tips(every, theta)[own], abs=1e-6)
    assert set(other.area_factor) == set(every.area_factor)
    alone = ForwardModel(paper_robot, one)
    assert np.abs(tips(alone, there) - tips(other, there)).max() > 1e-3


def effect(law: Callable[[Quantities, Values], None], scale: float = 5.0) -> EffectSpec:
    parameter = Parameter("kelvin", "K", scale, -30.0, 1e9)
    return EffectSpec("colder", "material", "E (1 + 0.002 d)", (parameter,), Law(before=law), "a test", "a second day")


def colder(q: Quantities, v: Values) -> None:
    q.body_modulus = q.body_modulus * (1 + 0.002 * v["kelvin"])


def misspelt(q: Quantities, v: Values) -> None:
    q.body_modulus = q.body_modulus * (1 + 0.002 * v["kelwin"])


def no_quantity(q: Quantities, v: Values) -> None:
    q.body_modulos = q.body_modulus * (1 + 0.002 * v["kelvin"])  # type: ignore[attr-defined]


def nothing(q: Quantities, v: Values) -> None:
    q.tether = q.tether + 1e-15 * v["kelvin"]


def never_off(q: Quantities, v: Values) -> None:
    q.body_modulus = q.body_modulus * (1.01 + 0.002 * v["kelvin"])


def of_one_shape(q: Quantities, v: Values) -> None:
    q.tip_force = q.tip_force + np.array([[[1.0, 2.0]]]) * v["kelvin"]


def crushing(q: Quantities, v: Values) -> None:
    q.tip_force = q.tip_force - np.array([0.0, 0.0, 1e4]) * v["kelvin"][..., None]


def test_a_sound_effect_of_one_s_own_passes(paper_robot: Robot) -> None:
    prove(paper_robot, [effect(colder)])


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (effect(misspelt), "law fails: KeyError: 'kelwin'"),
        (effect(of_one_shape), "law fails"),
        (effect(no_quantity), "no attribute 'body_modulos'; did you mean 'body_modulus'?"),
        (effect(nothing), "moves no reading of a small campaign at its plausible size"),
        (effect(never_off), "must have exactly no effect"),
        (effect(crushing), "no state of a small campaign has an equilibrium"),
    ],
    ids=["misspelt", "shape", "no quantity", "nothing", "never off", "too large"],
)
def test_an_effect_that_cannot_be_weighed_is_refused_by_name(paper_robot: Robot, spec: EffectSpec, said: str) -> None:
    with pytest.raises(BadEffect, match=f"colder: .*{re.escape(said)}"):
        prove(paper_robot, [spec])
