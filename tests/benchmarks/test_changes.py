"""Pairs of campaigns of which one effect has changed, or none."""

import numpy as np
import pytest

from benchmarks.blind.truth import Recipe, draw_robot
from benchmarks.changes import Pair, another_day, summary

STILL = Pair("w", "", 0.0, {}, (), 0.95, 0.95, 1.0)
FALSE = Pair("w", "", 0.0, {"base_tilt": 3.0}, ("contact",), 0.6, 0.3, 1.0)
MOUNTED = Pair("w", "", 0.0, {"base_tilt": 3.0}, ("base_tilt",), 0.6, 0.3, 1.0)
RIGHT = Pair("w", "contact", 5.0, {}, ("contact",), 0.95, 0.01, 1.0)
SMALL = Pair("w", "self_weight", 0.5, {}, (), 0.8, 0.8, 1.0)


def test_another_day_is_the_same_robot_mounted_and_seen_anew() -> None:
    robot, _ = draw_robot(Recipe("cellar", 1, 3, ("cluttered_none",)), 0, "cluttered_none", ())
    other = another_day(robot, np.random.default_rng(1))
    differs = {e for e in robot.sizes if robot.sizes[e] != other.sizes[e]}
    assert differs == {"base_tilt", "frame_misalignment"} and robot.offset != other.offset
    assert (robot.world, robot.places, robot.length) == (other.world, other.places, other.length)


def test_shares_count_what_they_say() -> None:
    found = summary([STILL, FALSE, MOUNTED, RIGHT, SMALL])
    shares = {name: (figure["share"], figure["n"]) for name, figure in found.items()}
    assert list(shares.values()) == [(2 / 3, 3), (1 / 3, 3), (0.5, 2), (1.0, 1), (1.0, 1), (1.0, 2)]
    assert found["changed: just the effect named"]["interval"][0] == pytest.approx(0.013, abs=0.001)
