"""Other robots of the bench: what is measured on them is what the model says of their robot.yaml."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lab.blind.geometry import GEOMETRIES

from lab.blind.make import robot_yaml
from lab.files.config import check, parse_yaml
from model.condition import conditions
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from sim_fakes.virtual_robot import Condition, RobotTruth, VirtualRobot, walk

SWEEP = [(length, (p, 0.4 * p, 0.0)) for length in (0.0, 0.2) for p in (0.0, 80e3, 160e3)]


@pytest.mark.parametrize("name", ["three_chambers", "tapered", "tendons"])
def test_the_virtual_robot_and_the_rod_agree(name: str, tmp_path: Path) -> None:
    robot = check(parse_yaml(robot_yaml(GEOMETRIES[name], markers=False, per_length=False), "robot.yaml"), Robot)
    truth = RobotTruth(
        youngs_modulus=robot.youngs_modulus, shear_ratio=robot.shear_modulus / robot.youngs_modulus, area_factor=1.6,
        segments=80, **GEOMETRIES[name].truth,
    )  # fmt: skip
    lengths, pressures = np.array([s for s, _ in SWEEP]), np.array([p for _, p in SWEEP])
    expected = solve(rods_of(robot, conditions(robot, lengths, pressures, tip_mass=0.053)), FINE).trusted().tip
    read = walk(VirtualRobot(truth), [Condition(s, p, hold=60.0) for s, p in SWEEP])
    measured = np.array([r.position for r in read])
    # Pieces of a taper, and segments of the virtual robot.
    assert np.linalg.norm(measured - expected, axis=1).max() < (1.5e-3 if name == "tapered" else 0.15e-3)
    assert np.linalg.norm(measured[-1] - measured[0]) > 0.02


def test_friction_of_tendons_leaves_a_loop_that_time_does_not_close() -> None:
    levels = (0.0, 125e3, 250e3, 125e3, 0.0)
    truth = RobotTruth(area_factor=1.6, **GEOMETRIES["tendons"].truth)
    states = [Condition(0.0, (p, 0.0, 0.0), hold=30.0) for p in levels]
    free, held = (
        np.array([r.position[0] for r in walk(VirtualRobot(truth, effects), states)])
        for effects in ({}, {"tendon_friction": 0.5})
    )
    assert abs(free[3] - free[1]) < 1e-5
    assert abs(held[2]) < abs(free[2]) - 1e-3
    assert abs(held[3]) > abs(held[1]) + 1e-3
