"""What to ask about a robot.yaml and a table of trials that may be right: nothing is refused here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from model.errors import ModelError
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from recordings.trials import TrialRow

from ..judgement import UPSIDE_DOWN_GAIN
from .campaign import settings
from .plausible import weight_ratio
from .plausible_directions import ASIDE, doubtful_directions
from .plausible_places import doubtful_places
from .plausible_pressures import Pressures
from .plausible_robot import doubtful_numbers

TURNS = ((-1, 1), (-1, -1), *((axis, sign) for axis in range(3) for sign in (1, -1)))
"""Directions of gravity that are tried: as it is, reversed, along each axis of the base."""


def doubtful(robot: Robot, rows: Sequence[TrialRow], robot_name: str) -> tuple[str, ...]:
    """One message for each doubt; `robot_name`: where the robot was read."""
    tips = [r for r in rows if r.protocol != "stiffness" and r.tip is not None]
    tips = [r for r in tips if np.isfinite((*r.tip, r.spine_length, *r.pressures)).all()]  # type: ignore[misc]
    fits = bool(tips) and {len(r.pressures) for r in tips} == {len(robot.bending_directions)}
    seen = Pressures.of(robot, tips) if fits else None
    of_robot = (*doubtful_numbers(robot), *(_gravity(robot, seen) if seen else ()))
    of_table = (*(_gain(robot, seen) if seen else ()), *doubtful_directions(robot, rows), *doubtful_places(robot, rows))
    return (*(f"{robot_name}: {text}" for text in of_robot), *of_table)


def _gain(robot: Robot, seen: Pressures) -> Iterator[str]:
    """About a tip that moves many times as far as a beam of these numbers would, or as little."""
    # a lighter body's weight changes the ratio by less than a factor of two or so, and models are right within one of three
    if weight_ratio(robot) > 10.0 or seen.unit != 1.0 or 1 / 5.0 < seen.ratio < 5.0:
        return
    yield robot.actuators.words.say(
        f"the tip moves {seen.ratio:.2g} times as far as a beam with the numbers of robot.yaml under these pressures: check the "
        "unit and scale of the pressures, the moduli, radii and path_radius"
    )


def _gravity(robot: Robot, seen: Pressures) -> Iterator[str]:
    """About a tip at rest that sags to where gravity in another direction would bring it.

    A wrong modulus changes how far it sags, by a factor, but not the side; along the axis nothing sags, and nothing is asked.
    """
    resting = [r for r, rests in zip(seen.rows, seen.resting, strict=True) if rests][:60]
    if robot.effects or not resting:
        return
    try:
        asked = settings(robot, resting, vented=True)
        found = {turn: solve(rods_of(_turned(robot, turn), asked), FINE) for turn in TURNS}
    except ModelError:  # the states do not fit this robot, which is said elsewhere
        return
    stands = np.all([f.converged for f in found.values()], axis=0)
    if not stands.any():
        return
    tips = np.array([r.tip for r in resting])[stands]
    missed = {turn: float(np.sqrt(((f.tip[stands] - tips) ** 2).sum(axis=1).mean())) for turn, f in found.items()}
    given, best = missed[TURNS[0]], min(missed, key=lambda turn: missed[turn])
    if given > ASIDE * robot.length and missed[best] < UPSIDE_DOWN_GAIN * given:
        other = ", ".join(f"{g + 0.0:g}" for g in _turned(robot, best).gravity)
        yield (
            f"gravity [{', '.join(f'{g:g}' for g in robot.gravity)}] m/s^2: at rest the tip is {1e3 * given:.3g} mm from where "
            f"the model has it, and {1e3 * missed[best]:.3g} mm with [{other}]: does gravity point down in the base frame, and "
            "is the frame the right way round?"
        )


def _turned(robot: Robot, turn: tuple[int, int]) -> Robot:
    """The robot with gravity (axis, sign) along another axis of the base; axis -1: as it is, or reversed."""
    axis, sign = turn
    g = sign * np.array(robot.gravity) if axis < 0 else sign * float(np.linalg.norm(robot.gravity)) * np.eye(3)[axis]
    x, y, z = g.tolist()
    return robot.model_copy(update={"gravity": (x, y, z)})
