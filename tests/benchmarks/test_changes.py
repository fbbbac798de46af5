"""Pairs of campaigns of which one effect has changed, or none."""

import numpy as np

from benchmarks.blind.truth import Recipe, draw_robot
from benchmarks.changes import Pair, another_day, summary

STILL = Pair("w", "", 0.0, (), 0.95)
FALSE = Pair("w", "", 0.0, ("contact",), 0.6)
RIGHT = Pair("w", "contact", 5.0, ("contact",), 0.95)
SMALL = Pair("w", "self_weight", 0.5, (), 0.8)


def test_another_day_is_the_same_robot_mounted_and_seen_anew() -> None:
    robot, _ = draw_robot(Recipe("drawn:3", 1, 3, ("cluttered_none",)), 0, "cluttered_none", ())
    other = another_day(robot, np.random.default_rng(1))
    differs = {e for e in robot.sizes if robot.sizes[e] != other.sizes[e]}
    assert differs == {"base_tilt", "frame_misalignment"} and robot.offset != other.offset
    assert (robot.world, robot.places, robot.length) == (other.world, other.places, other.length)


def test_shares_count_what_they_say() -> None:
    assert list(summary([STILL, FALSE, RIGHT, SMALL]).values()) == ["1 of 2 (0.01 .. 0.99)", "1 of 1 (0.03 .. 1.00)"]
