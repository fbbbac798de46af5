"""Conditions: shapes, broadcasting, limits."""

from typing import Any

import numpy as np
import pytest

from model.condition import conditions
from model.errors import BadCondition
from model.robot import Robot, robot_from_dict

NINE = np.zeros(9)


def test_single_values_hold_for_all_states_and_the_tip_mass_comes_from_the_robot(paper_robot: Robot) -> None:
    made = conditions(paper_robot, [0.0, 0.1, 0.2], NINE, roll=0.5)
    assert len(made) == 3
    assert made.pressure.shape == (3, 9)
    np.testing.assert_array_equal(made.tip_mass, [0.053] * 3)
    np.testing.assert_array_equal(made.roll, [0.5] * 3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"spine_length": 0.41, "pressure": NINE}, ["spine_length", "0.41 m", "0.4 m"]),
        ({"spine_length": -0.01, "pressure": NINE}, ["spine_length", "-0.01 m", "negative"]),
        ({"spine_length": [0.0, np.nan], "pressure": NINE}, ["spine_length", "state 1", "finite"]),
        ({"spine_length": 0.0, "pressure": np.full(9, np.nan)}, ["pressure", "finite"]),
        ({"spine_length": 0.0, "pressure": np.full(9, 3e6)}, ["pressure", "3e+06 Pa", "unit"]),
        ({"spine_length": 0.0, "pressure": np.zeros(3)}, ["pressure", "3 columns", "9 chambers"]),
        ({"spine_length": [0.0, 0.1], "pressure": np.zeros((3, 9))}, ["spine_length", "(2,)", "(3,)"]),
        ({"spine_length": 0.0, "pressure": NINE, "tip_mass": -0.1}, ["tip_mass", "-0.1 kg"]),
        ({"spine_length": 0.1, "pressure": NINE, "force": [0.0, 1.0]}, ["force: shape (1, 2), must be (3,) or (1, 3)"]),
        ({"spine_length": "long", "pressure": NINE}, ["spine_length", "'long'", "numbers"]),
    ],
)
def test_a_bad_state_is_refused_with_field_and_value(paper_robot: Robot, arguments: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(BadCondition) as caught:
        conditions(paper_robot, **arguments)
    for word in words:
        assert word in str(caught.value)


def test_a_robot_without_spine_takes_no_spine_length(paper_robot: Robot) -> None:
    bare = robot_from_dict({**paper_robot.model_dump(), "spine": None})
    with pytest.raises(BadCondition, match="no spine"):
        conditions(bare, 0.1, NINE)


def test_states_group_by_spine_length_within_a_tenth_of_a_millimetre(paper_robot: Robot) -> None:
    made = conditions(paper_robot, [0.1, 0.05, 0.10002], NINE)
    groups = {length: own.tolist() for length, own in made.by_spine_length()}
    assert groups == {0.05: [False, True, False], 0.1: [True, False, True]}


def test_rows_are_picked_together(paper_robot: Robot) -> None:
    made = conditions(paper_robot, [0.0, 0.1], np.arange(18.0).reshape(2, 9), [0.1, 0.2])
    picked = made[np.array([False, True])]
    assert len(picked) == 1
    assert picked.spine_length[0] == 0.1 and picked.pressure[0, 0] == 9.0 and picked.tip_mass[0] == 0.2
