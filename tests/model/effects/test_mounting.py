"""What turns with a robot that is mounted anew, what stays, and where an obstacle touches."""

import numpy as np
import pytest

from model.effects import layout as at
from model.effects.solver import solve as solve_rows
from model.robot import Robot
from model.rods import columns as col
from model.rotation import to_base
from model.sections import Section
from tests.model.effects.campaigns import Moved, campaign, joined

LEVELS = (100e3, 200e3)


def test_each_further_mounting_has_tolerances_that_act_on_it_alone(paper_robot: Robot) -> None:
    rolls = ((0.0, (0.0, 0.1)), (90.0, (0.0,)))
    made = Moved(paper_robot, joined(*(campaign(lengths, levels=LEVELS, roll_deg=roll) for roll, lengths in rolls)))
    own = [p.name for p in made.forward.parameters if p.name.startswith("mount_")]
    assert len(own) == 6 and all(name.endswith("[roll=90 deg]") for name in own)
    moved = np.abs(made.by({"mount_turn.x[roll=90 deg]": 0.01})).max(axis=1)
    rolled = made.forward.design.roll > 1
    assert (moved[rolled] > 1e-3).all() and (moved[~rolled] < 1e-12).all()


def test_what_is_done_on_another_day_may_be_mounted_anew(paper_robot: Robot) -> None:
    def again(later: float, restart: bool = False) -> Moved:
        """The same twice, the second time begun `later` s after the first; with times of each trial's own."""
        columns = joined(*2 * [campaign((0.0, 0.1), LEVELS)])
        first, second = (columns["trial"] == k for k in (1, 3))
        columns["t"] = columns["t"] + (columns["trial"] > 2) * (later + columns["t"][first][0] - columns["t"][second][0])
        if restart:
            for trial in np.unique(columns["trial"]):
                columns["t"][columns["trial"] == trial] -= columns["t"][columns["trial"] == trial][0]
        return Moved(paper_robot, columns)

    def mountings(made: Moved) -> list[str]:
        return [p.name for p in made.forward.parameters if p.name.startswith("mount_turn")]

    other, long = again(1e5), float(campaign((0.0, 0.1), LEVELS)["t"].max())
    assert mountings(other) == mountings(again(0.0)) == [f"mount_turn.{a}[roll=0 deg, sitting 2]" for a in "xyz"]
    assert mountings(again(long + 60.0)) == mountings(again(1e5, restart=True)) == []
    moved = np.abs(other.by({"mount_turn.x[roll=0 deg, sitting 2]": 0.01})).max(axis=1)
    sitting = other.forward.design.sitting
    assert ((moved > 1e-3) == (sitting == 1)).all() and set(sitting) == {0, 1}


def test_each_repeat_of_the_sweep_may_be_mounted_anew(paper_robot: Robot) -> None:
    made, alone = (Moved(paper_robot, campaign((0.1,), LEVELS, repeats=n)) for n in (2, 1))
    own = [p for p in made.forward.parameters if p.name.startswith("repeat_")]
    assert len(own) == 12 and all(p.recurs for p in own)
    moved, again = np.abs(made.by({"repeat_shift.y[repeat=2]": 1e-3})), made.forward.design.repeat == 2
    assert moved[again, 1] == pytest.approx(1e-3) and (moved[~again] < 1e-12).all()
    assert not [p.name for p in alone.forward.parameters if p.name.startswith("repeat_")]


@pytest.mark.parametrize("timed", [True, False])
def test_the_modulus_drifts_from_the_first_state_to_the_last(paper_robot: Robot, timed: bool) -> None:
    columns = campaign(lengths=(0.0,), levels=LEVELS, repeats=3)
    if not timed:
        del columns["t"]
    made = Moved(paper_robot, columns)
    at_top = (made.forward.design.pressure.max(axis=1) == LEVELS[-1]) & ~made.forward.design.unload
    first, middle, last = made.by(drift__slope=-0.1)[at_top]
    assert abs(middle[0]) < 0.2 * abs(last[0]) and np.sign(first[0]) == -np.sign(last[0])
    stiff = made.still[at_top][-1]
    assert np.linalg.norm((stiff + last)[:2]) > np.linalg.norm(stiff[:2]) and np.linalg.norm(last) > 1e-3


def test_pressures_that_change_move_the_baseline_as_the_model_says(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.0,), levels=LEVELS, unload=False)
    made = Moved(paper_robot, columns)
    change = np.where(made.forward.design.pressure > 0, 1e3, 0.0)
    more = Moved(paper_robot, columns | {f"p{i + 1}": columns[f"p{i + 1}"] + change[:, i] for i in range(9)})
    assert made.forward.respond(change).reshape(-1, 3) == pytest.approx(more.still - made.still, abs=1e-7)


@pytest.mark.parametrize("stiff_end", [1e-6, 0.03])
def test_an_obstacle_touches_the_body_where_its_lever_says(paper_robot: Robot, stiff_end: float) -> None:
    lever, soft_end = 0.06, Section(length=paper_robot.length - stiff_end)
    robot = paper_robot.model_copy(update={"sections": (soft_end, Section(length=stiff_end, bending_stiffness=50.0))})
    made = Moved(robot, campaign(lengths=(0.0,), levels=(100e3, 150e3), unload=False))
    here = made.forward._solved(made.vector(contact__stiffness=1e-3, contact__lever=lever)).final
    point = np.full((len(here.rows), 1, 3), [0.0, 0.0, paper_robot.length - lever])
    there = solve_rows(here.layout, here.rows, point, here.steps).result
    wall = at.SPRINGS + 2 * at.SPRING_WIDTH
    arm = to_base(there[:, at.ORIENTATION : at.ORIENTATION + 4], here.rows[:, wall + col.SPRING_ARM : wall + col.SPRING_ARM + 3])
    touched = there[:, :3] - arm
    assert np.abs(touched - there[:, at.MARKERS : at.MARKERS + 3]).max() < 2e-4


def test_an_obstacle_that_faces_away_pushes_sideways(paper_robot: Robot) -> None:
    made = Moved(paper_robot, campaign(lengths=(0.0,), levels=(150e3,), unload=False))
    straight, turned = (made.tips(contact__stiffness=200.0, contact__turn=turn)[-1] for turn in (0.0, 0.3))
    assert abs(turned[1] - straight[1]) > 2e-3
