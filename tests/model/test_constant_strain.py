"""The example of a simulator of one's own agrees with the rod as far as it says, and stands still where it should."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from model.condition import States, conditions
from model.robot import Robot, robot_from_dict
from model.rods import solve
from model.section import rods_of
from model.simulators import Forward, Readings

EXAMPLE = Path(__file__).parents[2] / "examples/simulator/constant_strain.py"


@pytest.fixture(scope="module")
def states(paper_robot: Robot) -> States:
    """Eight settings from rest to the strongest bend, with and without a known force."""
    spine = np.array([0.0, 0.0, 0.1, 0.3, 0.0, 0.2, 0.0, 0.1])
    pressure = np.zeros((8, 9))
    pressure[:, [8, 0, 1]] = np.array([0.0, 250e3, 250e3, 250e3, 120e3, 60e3, 250e3, 0.0])[:, None]
    force = np.zeros((8, 3))
    force[4] = (0.0, 0.3, 0.0)
    return conditions(paper_robot, spine, pressure, 0.053, np.radians([0, 0, 0, 0, 0, 0, 30, 0]), force)


def tips(robot: Robot, states: States) -> tuple[np.ndarray, np.ndarray]:
    """Of the example and of the rod, m."""
    simulator: Forward = runpy.run_path(str(EXAMPLE))["SIMULATOR"](robot)
    readings: Readings = simulator.predict(states, {})
    return readings.tip, solve(rods_of(robot, states)).tip


def test_it_is_up_to_three_millimetres_from_the_rod(paper_robot: Robot, states: States) -> None:
    own, rod = tips(paper_robot, states)
    apart = np.linalg.norm(own - rod, axis=1)
    assert 0.2e-3 < apart.max() < 3e-3
    assert np.linalg.norm(rod - [0.0, 0.0, 0.4], axis=1).max() > 0.2


def test_it_knows_tendons_and_tapers(reference_robot: Robot) -> None:
    ring = {"path_radius": 0.04, "azimuths_deg": [0.0, 120.0, 240.0]}
    radii = {"outer_radius": (0.05, 0.045), "inner_radius": (0.029, 0.029), "path_radius": (0.04, 0.036)}
    taper = [{"length": 0.2, "youngs_modulus": 7e5}, {"length": 0.2, **radii}]
    other = {"chambers": None, "tendons": ring, "area_factor": 2.0, "sections": taper}
    robot = robot_from_dict({**reference_robot.model_dump(), **other})
    own, rod = tips(robot, conditions(robot, 0.0, np.outer([0.0, 60e3, 120e3], [1.0, 0.0, 0.0]), 0.0))
    assert np.linalg.norm(own - rod, axis=1).max() < 2e-3
    assert np.linalg.norm(rod[2] - rod[0]) > 0.02
