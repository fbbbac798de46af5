"""Robots and conditions shared by the tests of the model."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from model.condition import States, conditions
from model.robot import Robot, load_robot, robot_from_dict

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def paper_robot() -> Robot:
    return load_robot(ROOT / "examples/paper/robot.yaml")


@pytest.fixture(scope="session")
def reference_robot(paper_robot: Robot) -> Robot:
    """The robot of the published reference values: one area factor, spine modulus on a straight line."""
    spine = {"radius": 0.029, "modulus": {0.05: 0.318e6, 0.30: 4.389e6}}
    changed = {"shear_modulus": paper_robot.youngs_modulus / 3, "area_factor": 1.5, "spine": spine}
    return robot_from_dict({**paper_robot.model_dump(), **changed})


@pytest.fixture(scope="session")
def pulled(reference_robot: Robot) -> Robot:
    """The same body without a spine, pulled by three tendons."""
    ring = {"path_radius": 0.04, "azimuths_deg": [0.0, 120.0, 240.0]}
    return reference_robot.replace(chambers=None, tendons=ring, spine=None, area_factor=1.0)


@pytest.fixture(scope="session")
def bending() -> Callable[..., States]:
    """bending(robot, spine lengths, pressures): every combination, the three chambers around azimuth 0 pressurised."""

    def make(robot: Robot, spine_lengths: list[float], pressures: list[float], **more: float) -> States:
        length, p = (a.ravel() for a in np.meshgrid(spine_lengths, pressures, indexing="ij"))
        nine = np.zeros((length.size, 9))
        nine[:, [8, 0, 1]] = p[:, None]  # the chambers at -40, 0 and 40 deg
        return conditions(robot, length, nine, **more)

    return make
