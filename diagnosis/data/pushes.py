"""Rows of stiffness trials: which can be used, which repeat each other, and what cannot be concluded from them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from model.robot import Robot
from recordings.trials import TrialRow

from ..errors import BadCase
from .campaign import Campaign
from .levels import SPINE_GAP, VACUUM_GAP, by_frequency, levels, step_gap

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

FARTHEST = 0.3
"""Largest deflection of beam theory, as a share of the cantilever's length."""
SHORTEST = 0.01
"""m; a shorter spine offers nothing to push on."""


def rows(table: Iterable[TrialRow]) -> list[TrialRow]:
    """Rows with a force and the deflection it belongs to."""
    return [r for r in table if r.protocol == "stiffness" and r.force is not None and r.deflection is not None]


def require_plausible(robot: Robot, given: list[TrialRow]) -> None:
    """Raises `BadCase` for rows that no stiffness trial of this robot gives."""
    for r in given:
        where = f"trial {r.trial} step {r.step}"
        body = r.specimen == "body"
        if not body and robot.spine is None:
            raise BadCase(
                f"{where}: a stiffness trial of a spine, but robot {robot.name!r} has none: add the spine's moduli to robot.yaml"
            )
        if r.spine_length > robot.length * 1.001:
            raise BadCase(
                f"{where}: spine length {r.spine_length:g} m, longer than the robot ({robot.length:g} m): check the unit (m)"
            )
        if not body and r.spine_length < SHORTEST:
            raise BadCase(
                f"{where}: a stiffness trial of a spine of {r.spine_length:g} m: check spine_length (m), or write specimen body"
            )
        long = robot.length if body else r.spine_length
        if abs(r.deflection or 0.0) > FARTHEST * long:
            raise BadCase(
                f"{where}: deflection {r.deflection:g} m of a cantilever of {long:g} m; beam theory holds up to "
                f"{FARTHEST:g} of its length: check the unit (m), or leave the row out"
            )


def kinds(given: list[TrialRow]) -> Ints:
    """Number of each row's kind of experiment, specimen and vacuum; 0 for most."""
    if not given:
        return np.zeros(0, np.int64)
    body = np.array([r.specimen == "body" for r in given], np.int64)
    return by_frequency(body, levels(np.array([r.vacuum or 0.0 for r in given]), VACUUM_GAP))


def conditions(given: list[TrialRow], spine: Array) -> Ints:
    """Number of each row's condition: kind, spine length, branch and step of deflection."""
    if not given:
        return np.zeros(0, np.int64)
    deflection, trial = np.array([r.deflection for r in given], float), np.array([r.trial for r in given])
    branch = np.array([r.branch == "unload" for r in given], np.int64)
    keys = np.column_stack([kinds(given), levels(spine, SPINE_GAP), branch])
    same = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    level = np.zeros(len(given), np.int64)
    for one in np.unique(same):
        own = same == one
        level[own] = levels(deflection[own], step_gap(deflection[own], trial[own]))
    return np.unique(np.column_stack([same, level]), axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)


def can_name_cause(s: Campaign) -> bool:
    """Whether pushes alone may name a cause: repeated, to two deflections, at two lengths or of two specimens."""
    if not len(s) or s.repeats < 2:
        return False
    places = np.unique(np.column_stack([levels(s.spine_length, SPINE_GAP), s.kind]), axis=0)
    return len(places) > 1 and len(np.unique(s.condition)) > len(places)


def concerns(given: list[TrialRow], s: Campaign, beside: bool) -> list[str]:
    """What cannot be concluded from stiffness trials; `beside` states of the robot."""
    if not given:
        return []
    own = s.take(s.pushed)
    notes = []
    if not beside:
        notes.append(
            "only stiffness trials: nothing can be said about chambers, pressures, loads on the robot, base or "
            "cameras, and only effects that change these readings are considered; record a bending sweep"
        )
        notes.append("only stiffness trials: probabilities were calibrated on bending campaigns, not on such data")
    if own.repeats < 3:
        word = "no deflection was repeated" if own.repeats < 2 else "deflections were repeated only once"
        notes.append(
            f"stiffness trials: {word}: default scatter of touch point, zero and jamming is assumed; repeat them three times"
        )
    if len(np.unique(levels(own.spine_length, SPINE_GAP))) < 2:
        notes.append(
            "stiffness trials at only one spine length: modulus, sensor zero and touch point cannot be "
            "distinguished; measure at two or more"
        )
    return notes
