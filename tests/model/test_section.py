"""Cross-section, mixing by volume, actuation."""

import numpy as np
import pytest
from numpy.typing import NDArray

from model.condition import States, conditions
from model.robot import Robot, robot_from_dict
from model.section import body_area, combined_modulus, rods_of

Array = NDArray[np.float64]


def test_mixing_by_volume_weighs_annulus_and_spine(paper_robot: Robot) -> None:
    share = (0.05**2 - 0.029**2) / 0.05**2
    expected = share * 507147 + (1 - share) * 4.389e6
    assert combined_modulus(paper_robot, 0.30) == pytest.approx(expected, rel=1e-12)
    assert combined_modulus(paper_robot, 0.05) < combined_modulus(paper_robot, 0.0) == paper_robot.youngs_modulus


def test_torsion_carries_youngs_modulus_and_the_polar_moment_as_printed(paper_robot: Robot) -> None:
    batch = rods_of(paper_robot, conditions(paper_robot, 0.1, np.zeros(9)))
    stretch, bend = batch.field("stretch_stiffness")[0], batch.field("bend_stiffness")[0]
    assert bend[:, 2] == pytest.approx(bend[:, 0] + bend[:, 1])
    assert stretch[:, 0] == pytest.approx(stretch[:, 2] / 3, rel=1e-5)


def wrench(robot: Robot, states: States) -> tuple[Array, Array]:
    """Force (n, 3) N and moment (n, 3) N m of the pressurised chambers in the tip frame."""
    batch = rods_of(robot, states)
    return batch.field("tip_force"), batch.field("tip_moment")


def test_inflating_one_chamber_pushes_along_the_axis_and_bends_away_from_it(paper_robot: Robot) -> None:
    pressure = np.zeros(9)
    pressure[0] = 100e3
    force, moment = wrench(paper_robot, conditions(paper_robot, 0.0, pressure))
    push = 100e3 * 1.5 * np.pi * 0.005**2
    np.testing.assert_allclose(force[0], [0, 0, push])
    np.testing.assert_allclose(moment[0], [0, -0.04 * push, 0], atol=1e-15)


def test_equal_pressure_in_all_chambers_does_not_bend(paper_robot: Robot) -> None:
    force, moment = wrench(paper_robot, conditions(paper_robot, 0.0, np.full(9, 100e3)))
    np.testing.assert_allclose(moment, 0, atol=1e-12)
    assert force[0, 2] == pytest.approx(9 * 100e3 * 1.5 * np.pi * 0.005**2)


def test_a_roll_of_one_pitch_equals_moving_the_pattern_by_one_chamber(paper_robot: Robot) -> None:
    pressure = np.linspace(0, 80e3, 9)
    rolled = conditions(paper_robot, 0.1, pressure, roll=np.deg2rad(40))
    moved = conditions(paper_robot, 0.1, np.roll(pressure, 1))
    for a, b in zip(wrench(paper_robot, rolled), wrench(paper_robot, moved), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_weight_and_tip_load_point_along_gravity(paper_robot: Robot) -> None:
    sideways = robot_from_dict({**paper_robot.model_dump(), "gravity": [9.81, 0.0, 0.0]})
    batch = rods_of(sideways, conditions(sideways, 0.1, np.zeros(9), tip_mass=0.2))
    np.testing.assert_allclose(batch.field("dead_force")[0], [0.2 * 9.81, 0, 0])
    np.testing.assert_allclose(batch.field("load")[0, 1], [1300 * body_area(sideways) * 9.81, 0, 0])
