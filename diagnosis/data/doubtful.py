"""What to ask about a robot.yaml and a table of trials that may be right: nothing is refused here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from model.condition import conditions
from model.errors import ModelError
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from recordings.trials import TrialRow

from ..judgement import UPSIDE_DOWN_GAIN
from .plausible import weight_ratio
from .plausible_directions import ASIDE, doubtful_directions
from .plausible_places import doubtful_places
from .plausible_pressures import Pressures
from .plausible_robot import doubtful_numbers


def doubtful(robot: Robot, rows: Sequence[TrialRow], robot_name: str) -> tuple[str, ...]:
    """One message for each doubt; `robot_name`: where the robot was read."""
    of_robot = (*doubtful_numbers(robot), *_gravity(robot, rows))
    directions = (*_gain(robot, rows), *doubtful_directions(robot, rows))
    return (*(f"{robot_name}: {text}" for text in of_robot), *directions, *doubtful_places(robot, rows))


def _gain(robot: Robot, rows: Sequence[TrialRow]) -> Iterator[str]:
    """About a tip that moves many times as far as a beam of these numbers would, or as little."""
    tips = [r for r in rows if r.protocol != "stiffness" and r.tip is not None]
    tips = [r for r in tips if np.isfinite((*r.tip, r.spine_length, *r.pressures)).all()]  # type: ignore[misc]
    # a lighter body's weight changes the ratio below by less than a factor of two or so
    if not tips or {len(r.pressures) for r in tips} != {len(robot.bending_directions)} or weight_ratio(robot) > 10.0:
        return
    found = Pressures.of(robot, tips)
    # models are right within a factor of three
    if found.unit != 1.0 or 1 / 5.0 < found.ratio < 5.0:
        return
    yield robot.actuators.words.say(
        f"the tip moves {found.ratio:.2g} times as far as a beam with the numbers of robot.yaml under these pressures: check the "
        "unit and scale of the pressures, the moduli, radii and path_radius"
    )


def _gravity(robot: Robot, rows: Sequence[TrialRow]) -> Iterator[str]:
    """About a tip at rest that sags to where reversed gravity would bring it.

    A wrong modulus changes how far it sags, by a factor, but not the side; along the axis nothing sags, and nothing is asked.
    """
    tips = [
        r
        for r in rows
        if r.protocol != "stiffness" and r.tip is not None and np.isfinite((*r.tip, r.spine_length, *r.pressures)).all()
    ]
    if robot.effects or not tips or {len(r.pressures) for r in tips} != {len(robot.bending_directions)}:
        return
    resting = [r for r, rests in zip(tips, Pressures.of(robot, tips).resting, strict=True) if rests][:60]
    if not resting:
        return
    try:
        asked = conditions(
            robot,
            np.clip([r.spine_length for r in resting], 0.0, None),
            np.zeros((len(resting), len(robot.bending_directions))),
            [robot.tip_mass if r.tip_mass is None else r.tip_mass for r in resting],
            np.radians([r.roll_deg or 0.0 for r in resting]),
            [r.tip_force for r in resting],
        )
        found = [solve(rods_of(_with_gravity(robot, sign), asked), FINE) for sign in (1.0, -1.0)]
    except ModelError:  # the states do not fit this robot, which is said elsewhere
        return
    stands = found[0].converged & found[1].converged
    if not stands.any():
        return
    seen = np.array([r.tip for r in resting])[stands]
    given, reversed_ = (float(np.sqrt(((f.tip[stands] - seen) ** 2).sum(axis=1).mean())) for f in found)
    if given > ASIDE * robot.length and reversed_ < UPSIDE_DOWN_GAIN * given:
        yield (
            f"gravity [{', '.join(f'{g:g}' for g in robot.gravity)}] m/s^2: at rest the tip is {1e3 * given:.3g} mm from where "
            f"the model has it, and {1e3 * reversed_:.3g} mm with gravity reversed: does gravity point down in the base frame, "
            "and is the frame the right way round?"
        )


def _with_gravity(robot: Robot, factor: float) -> Robot:
    x, y, z = (factor * g for g in robot.gravity)
    return robot.model_copy(update={"gravity": (x, y, z)})
