"""What to ask about a robot.yaml and a table of trials that may be right: nothing is refused here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.campaign import settings, spread_over
from diagnosis.data.case import finite
from diagnosis.data.plausible import contradicting_attitudes, weight_ratio
from diagnosis.data.plausible_pressures import Pressures
from model.condition import States
from model.effects import ForwardModel
from model.errors import BadCondition
from model.robot import Robot
from model.rods import FINE, solve
from model.section import rods_of
from recordings.trials import Table

from .directions import ASIDE, doubtful_directions
from .numbers import doubtful_numbers
from .places import doubtful_places

Array = NDArray[np.float64]

TURNS = ((-1, 1), (-1, -1), *((axis, sign) for axis in range(3) for sign in (1, -1)))
"""Directions of gravity that are tried: as it is, reversed, along each axis of the base."""
AREAS = (1.0, 0.7, 1.4, 0.5, 2.0)
"""Factors on the area factor with which each direction may fit."""
FAR = 0.25
"""Robot lengths from where the model stands at rest beyond which a tip is asked about."""
UPSIDE_DOWN_GAIN = 0.5
"""Share of what the direction stated leaves below which another one is asked about."""
ABOVE = 1.5
"""Times max_pressure beyond which a pressure is asked about; regulators overshoot by less."""
MOST = 60
"""States that are compared."""


def doubtful(robot: Robot, table: Table, robot_name: str) -> tuple[str, ...]:
    """One message for each doubt; `robot_name`: where the robot was read."""
    tips = table.take(table.with_tip & finite(table))
    fits = len(tips) > 0 and tips.pressures.shape[1] == len(robot.bending_directions)
    seen = Pressures.of(robot, tips) if fits else None
    of_robot = (*doubtful_numbers(robot), *(_gravity(robot, seen) if seen else ()))
    of_pressures = (*_gain(robot, seen), *_above(robot, seen)) if seen else ()
    of_places = (*doubtful_directions(robot, table), *doubtful_places(robot, table), *contradicting_attitudes(robot, table))
    of_table = (*of_pressures, *of_places)
    return (*(f"{robot_name}: {text}" for text in of_robot), *of_table)


def _gain(robot: Robot, seen: Pressures) -> Iterator[str]:
    """About a tip that moves many times as far as a beam of these numbers would, or as little."""
    # a lighter body's weight changes the ratio by less than a factor of two or so, and models are right within one of three
    if weight_ratio(robot) > 10.0 or seen.unit != 1.0 or 1 / 5.0 < seen.ratio < 5.0:
        return
    pressures = robot.actuators.words.pressures
    yield (
        f"the tip moves {seen.ratio:.2g} times as far as a beam with the numbers of robot.yaml under these {pressures}: check "
        f"the unit and scale of the {pressures}, the moduli, radii and path_radius"
    )


def _above(robot: Robot, seen: Pressures) -> Iterator[str]:
    """About a pressure that the robot is never given."""
    highest, most, words = float(seen.pressure.max()) * seen.unit, robot.max_pressure, robot.actuators.words
    if most is not None and highest > ABOVE * most:
        chamber = int(np.argmax(seen.pressure.max(axis=0))) + 1
        yield (
            f"column p{chamber}: {words.number(highest)} {words.unit}, {highest / most:.2g} times the max_pressure of "
            f"{words.number(most)} {words.unit} of robot.yaml: check the unit (psi and kPa differ by 6.9), or max_pressure"
        )


def _gravity(robot: Robot, seen: Pressures) -> Iterator[str]:
    """About a tip at rest that sags to where gravity in another direction would bring it.

    A wrong modulus changes how far it sags, by a factor, but not the side; along the axis nothing sags, and nothing is asked.
    """
    resting = seen.states.take(np.flatnonzero(seen.resting)[:MOST])
    if robot.effects or not len(resting):
        return
    try:
        asked = settings(robot, resting, vented=True)
    except BadCondition:  # the states do not fit this robot, which is said elsewhere
        return
    tips = resting.tip
    away: dict[tuple[int, int], Array] = {}
    for turn in TURNS:
        found = solve(rods_of(_turned(robot, turn), asked), FINE)
        away[turn] = np.where(found.converged, np.linalg.norm(found.tip - tips, axis=1), np.nan)
        if np.nanmax(away[TURNS[0]], initial=0.0) <= ASIDE * robot.length:  # the others need not be computed
            return
    stands = np.isfinite(list(away.values())).all(axis=0)
    if not stands.any():
        return
    missed = {turn: float(np.sqrt((d[stands] ** 2).mean())) for turn, d in away.items()}
    given = missed[TURNS[0]]
    if other := _other(robot, missed):
        yield (
            f"gravity {_listed(robot)} m/s^2: at rest the tip is {1e3 * given:.3g} mm from where the model has it, and {other}: "
            "does gravity point down in the base frame, and is the frame the right way round?"
        )
    elif given > FAR * robot.length:
        yield (
            f"at rest the tip is {1e3 * given:.3g} mm from where the model has it, with any gravity: check which marker is the "
            "tip, where the base is among the cameras' axes, tip_mass, moduli and density"
        )


def doubtful_gravity(robot: Robot, states: Table) -> Iterator[str]:
    """About states, with a tip, that are to be moved to where the model stands at rest, which hides a wrong direction of gravity.

    Compared is what no shift changes: how far the tip moves from rest, and where tip and markers stand to each other at rest.
    """
    seen = Pressures.of(robot, states.take(spread_over(len(states), MOST)))
    read = np.concatenate([seen.states.tip[:, None], seen.states.markers[:, : len(robot.markers)]], axis=1)
    known = np.asarray(np.isfinite(read).all(axis=(1, 2)))
    if not (known & seen.resting).any() or read.shape[1] != 1 + len(robot.markers):
        return
    try:
        asked = settings(robot, seen.states)
    except BadCondition:  # the states do not fit this robot, which is said elsewhere
        return
    area = float(np.mean(robot.area_factor_at(seen.states.spine_length)))
    missed: dict[tuple[int, int], float] = {}
    for turn in TURNS:
        there = _turned(robot, turn)
        missed[turn] = min(_missed(there.with_area_factor(area * f), asked, seen, read, known) for f in AREAS)
        if missed[TURNS[0]] <= ASIDE * robot.length:  # the others need not be computed
            return
    if other := _other(robot, missed):
        yield (
            f"gravity {_listed(robot)} m/s^2 of robot.yaml: the tip moves, and the points stand, {1e3 * missed[TURNS[0]]:.3g} mm "
            f"from where the model has them, and {other}: does gravity point down in the base frame? Correct it before "
            "`straight: at rest` moves the readings to where that model stands"
        )


def _other(robot: Robot, missed: Mapping[tuple[int, int], float]) -> str:
    """How far (m) the direction misses that does so least, where the one stated misses far more; else empty."""
    given, best = missed[TURNS[0]], min(missed, key=lambda turn: missed[turn])
    clear = given > ASIDE * robot.length and missed[best] < UPSIDE_DOWN_GAIN * given
    return f"{1e3 * missed[best]:.3g} mm with {_listed(_turned(robot, best))}" if clear else ""


def _missed(robot: Robot, asked: States, seen: Pressures, read: Array, known: NDArray[np.bool_]) -> float:
    """m (rms) between model and the points (n, 1 + k, 3) m, the tip and markers, against those at rest; infinite where it does
    not stand."""
    model = ForwardModel.of_single_states(robot).at(asked, np.array(robot.markers))
    found = model.read(np.zeros(len(model.parameters)))
    points = np.concatenate([found.tip[0][:, None], found.markers[0]], axis=1)
    stood = known & np.isfinite(points).all(axis=(1, 2))
    if not (stood & seen.resting).any():
        return np.inf
    rest, model_rest = (p[stood & seen.resting].mean(axis=0) for p in (read, points))
    moved = (read - rest)[stood, 0] - (points - model_rest)[stood, 0]
    shape = (rest - rest.mean(axis=0)) - (model_rest - model_rest.mean(axis=0))
    return float(np.sqrt((moved**2).sum(axis=1).mean() + (shape**2).sum(axis=1).mean()))


def _listed(robot: Robot) -> str:
    return f"[{', '.join(f'{g + 0.0:g}' for g in robot.gravity)}]"


def _turned(robot: Robot, turn: tuple[int, int]) -> Robot:
    """The robot with gravity (axis, sign) along another axis of the base; axis -1: as it is, or reversed."""
    axis, sign = turn
    g = sign * np.array(robot.gravity) if axis < 0 else sign * float(np.linalg.norm(robot.gravity)) * np.eye(3)[axis]
    x, y, z = g.tolist()
    return robot.model_copy(update={"gravity": (x, y, z)})
