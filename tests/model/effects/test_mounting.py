"""What turns with a robot that is mounted anew, what stays, and where an obstacle touches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from model.effects import layout as at
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.solver import solve as solve_rows
from model.robot import Robot
from model.rods import columns as col
from model.rotation import to_base

LEVELS = (100e3, 200e3)


def made(robot: Robot, columns: Any) -> ForwardModel:
    return ForwardModel(robot, design_from_columns(robot, columns))


def tips(forward: ForwardModel, **values: float) -> np.ndarray:
    theta = np.zeros(len(forward.parameters))
    names = [p.name for p in forward.parameters]
    for name, value in values.items():
        theta[names.index(name.replace("__", "."))] = value
    channel = forward.observations.channel
    predicted = forward.predict(theta)
    return np.column_stack([predicted[channel == axis] for axis in "xyz"])


def test_a_marker_rolls_with_the_robot_it_sits_on(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    shift = []
    for roll in (0.0, 90.0):
        forward = made(paper_robot, make_campaign(lengths=(0.0,), levels=LEVELS, roll_deg=roll))
        shift.append((tips(forward, marker_offset__x=5e-3) - tips(forward))[0])
    assert shift[0] == pytest.approx([5e-3, 0.0, 0.0], abs=1e-4)
    assert shift[1] == pytest.approx([0.0, 5e-3, 0.0], abs=1e-4)


def test_each_further_mounting_has_tolerances_that_act_on_it_alone(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    first, second = make_campaign(lengths=(0.0, 0.1), levels=LEVELS), make_campaign(lengths=(0.0,), levels=LEVELS)
    second["roll_deg"] = np.full(len(second["trial"]), 90.0)
    first["roll_deg"] = np.zeros(len(first["trial"]))
    second["trial"] = second["trial"] + 2
    forward = made(paper_robot, {k: np.concatenate([first[k], second[k]]) for k in first})
    own = [p.name for p in forward.parameters if p.name.startswith("mount_")]
    assert len(own) == 6 and all(name.endswith("[roll=90 deg]") for name in own)
    moved = np.abs(tips(forward, **{"mount_turn__x[roll=90 deg]": 0.01}) - tips(forward)).max(axis=1)
    rolled = forward.design.roll > 1
    assert (moved[rolled] > 1e-3).all() and (moved[~rolled] < 1e-12).all()


def test_what_is_done_on_another_day_may_be_mounted_anew(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    def joined(later: float, restart: bool = False) -> ForwardModel:
        parts = [make_campaign(lengths=(0.0, 0.1), levels=LEVELS) for _ in range(2)]
        parts[1]["trial"] = parts[1]["trial"] + 2
        parts[1]["t"] = parts[1]["t"] + later
        columns = {k: np.concatenate([p[k] for p in parts]) for k in parts[0]}
        if restart:
            for trial in np.unique(columns["trial"]):
                own = columns["trial"] == trial
                columns["t"][own] -= columns["t"][own][0]
        return made(paper_robot, columns)

    def mountings(forward: ForwardModel) -> list[str]:
        return [p.name for p in forward.parameters if p.name.startswith("mount_turn")]

    long = float(joined(0.0).design.t.max())
    assert mountings(joined(1e5)) == mountings(joined(0.0)) == [f"mount_turn.{a}[roll=0 deg, sitting 2]" for a in "xyz"]
    assert mountings(joined(long + 60.0)) == mountings(joined(1e5, restart=True)) == []
    other = joined(1e5)
    moved = np.abs(tips(other, **{"mount_turn__x[roll=0 deg, sitting 2]": 0.01}) - tips(other)).max(axis=1)
    assert ((moved > 1e-3) == (other.design.sitting == 1)).all() and set(other.design.sitting) == {0, 1}


def test_each_repeat_of_the_sweep_may_be_mounted_anew(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    forward = made(paper_robot, make_campaign(lengths=(0.1,), levels=LEVELS, repeats=2))
    own = [p for p in forward.parameters if p.name.startswith("repeat_")]
    assert len(own) == 12 and all(p.recurs for p in own)
    moved = np.abs(tips(forward, **{"repeat_shift__y[repeat=2]": 1e-3}) - tips(forward))
    again = forward.design.repeat == 2
    assert moved[again, 1] == pytest.approx(1e-3) and (moved[~again] < 1e-12).all()
    alone = made(paper_robot, make_campaign(lengths=(0.1,), levels=LEVELS))
    assert not [p.name for p in alone.parameters if p.name.startswith("repeat_")]


@pytest.mark.parametrize("timed", [True, False])
def test_the_modulus_drifts_from_the_first_state_to_the_last(
    paper_robot: Robot, make_campaign: Callable[..., Any], timed: bool
) -> None:
    columns = make_campaign(lengths=(0.0,), levels=LEVELS, repeats=3)
    if not timed:
        del columns["t"]
    forward = made(paper_robot, columns)
    at_top = (forward.design.pressure.max(axis=1) == LEVELS[-1]) & ~forward.design.unload
    first, middle, last = (tips(forward, drift__slope=-0.1) - tips(forward))[at_top]
    assert abs(middle[0]) < 0.2 * abs(last[0]) and np.sign(first[0]) == -np.sign(last[0])
    softer = (tips(forward, drift__slope=-0.1) - tips(forward))[at_top][-1]
    assert np.linalg.norm(tips(forward, drift__slope=-0.1)[at_top][-1, :2]) > np.linalg.norm(tips(forward)[at_top][-1, :2])
    assert np.linalg.norm(softer) > 1e-3


def test_pressures_that_change_move_the_baseline_as_the_model_says(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    columns = make_campaign(lengths=(0.0,), levels=LEVELS, unload=False)
    forward = made(paper_robot, columns)
    change = np.where(forward.design.pressure > 0, 1e3, 0.0)
    more = dict(columns)
    for i in range(9):
        more[f"p{i + 1}"] = columns[f"p{i + 1}"] + change[:, i]
    channel = forward.observations.channel
    moved = np.column_stack([forward.respond(change)[channel == axis] for axis in "xyz"])
    assert moved == pytest.approx(tips(made(paper_robot, more)) - tips(forward), abs=1e-7)


def test_an_obstacle_touches_the_body_where_its_lever_says(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    lever = 0.06
    columns = make_campaign(lengths=(0.0,), levels=(100e3, 150e3), unload=False)
    forward = made(paper_robot, columns)
    names = [p.name for p in forward.parameters]
    theta = np.zeros(len(names))
    theta[names.index("contact.stiffness")], theta[names.index("contact.lever")] = 1e-3, lever
    here = forward._solved(theta).final
    long = paper_robot.length
    there = solve_rows(here.layout, here.rows, np.array([long - lever]), here.steps).result
    wall = at.SPRINGS + 2 * at.SPRING_WIDTH
    arm = to_base(there[:, at.ORIENTATION : at.ORIENTATION + 4], here.rows[:, wall + col.SPRING_ARM : wall + col.SPRING_ARM + 3])
    touched = there[:, :3] - arm
    assert np.abs(touched - there[:, at.MARKERS : at.MARKERS + 3]).max() < 1.5e-3


def test_an_obstacle_that_faces_away_pushes_sideways(paper_robot: Robot, make_campaign: Callable[..., Any]) -> None:
    forward = made(paper_robot, make_campaign(lengths=(0.0,), levels=(150e3,), unload=False))
    straight = tips(forward, contact__stiffness=200.0)[-1]
    turned = tips(forward, contact__stiffness=200.0, contact__turn=0.3)[-1]
    assert abs(turned[1] - straight[1]) > 2e-3
