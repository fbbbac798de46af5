"""Rows of stiffness trials: which can be used, which repeat each other, and what cannot be concluded from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from model.actuators import Words
from model.robot import Robot
from recordings.trials import Table

from ..arrays import Array, Ints, Mask
from ..errors import BadCase
from ..findings import Finding, finding
from .campaign import Campaign
from .levels import SPINE_GAP, VACUUM_GAP, by_frequency, distinct, levels, step_gap

FARTHEST = 0.3
"""Largest deflection of beam theory, as a share of the cantilever's length."""
SHORTEST = 0.01
"""m; a shorter spine offers nothing to push on."""


def complete(table: Table) -> Mask:
    """(n,) states of stiffness trials with a force and the deflection it belongs to."""
    return np.asarray(table.pushed & np.isfinite(table.get("force")) & np.isfinite(table.get("deflection")))


def _of_body(given: Table) -> Mask:
    return np.asarray(given.get("specimen") == "body")


def cantilevers(robot: Robot, given: Table) -> Array:
    """(n,) m of the cantilevers."""
    return np.where(_of_body(given), robot.length, given.spine_length)


def require_plausible(robot: Robot, pushes: Table) -> None:
    """Raises `BadCase` for states that no stiffness trial of this robot gives."""
    length, deflection = cantilevers(robot, pushes), pushes.get("deflection")
    if robot.spine is None and (of_spine := np.flatnonzero(~_of_body(pushes))).size:
        raise BadCase(
            f"{pushes.place(of_spine[0])}: a stiffness trial of a spine, but robot {robot.name!r} has none: add the spine's "
            "moduli to robot.yaml"
        )
    for i in np.flatnonzero(length < SHORTEST)[:1].tolist():
        raise BadCase(
            f"{pushes.place(i)}: a stiffness trial of a spine of {length[i]:g} m: check spine_length (m), or write specimen body"
        )
    for i in np.flatnonzero(np.abs(deflection) > FARTHEST * length)[:1].tolist():
        looks = "looks like mm; deflections are in m: divide by 1000" if abs(deflection[i]) > length[i] else "check the unit (m)"
        raise BadCase(
            f"{pushes.place(i)}: deflection {deflection[i]:g} m of a cantilever of {length[i]:g} m; beam theory holds up to "
            f"{FARTHEST:g} of its length: {looks}, or leave the row out"
        )


def kinds(given: Table) -> Ints:
    """Number of each state's kind of experiment, specimen and vacuum; 0 for most."""
    return by_frequency(_of_body(given).astype(np.int64), levels(given.get("vacuum", 0.0), VACUUM_GAP))


def conditions(given: Table) -> Ints:
    """Number of each state's condition: kind, spine length, branch and step of deflection."""
    deflection, trial, spine = given.get("deflection"), given.trial, np.clip(given.spine_length, 0.0, None)
    branch = (given.get("branch") == "unload").astype(np.int64)
    same = distinct(kinds(given), levels(spine, SPINE_GAP), branch)
    level = np.zeros(len(given), np.int64)
    for one in np.unique(same):
        own = same == one
        level[own] = levels(deflection[own], step_gap(deflection[own], trial[own]))
    return distinct(same, level)


def can_name_cause(s: Campaign) -> bool:
    """Whether pushes alone may name a cause: repeated, to two deflections, at two lengths or of two specimens."""
    if not len(s) or s.repeats < 2:
        return False
    places = len(np.unique(distinct(levels(s.spine_length, SPINE_GAP), s.kind)))
    return places > 1 and len(np.unique(s.condition)) > places


def concerns(s: Campaign, beside: bool, words: Words) -> Iterator[Finding]:
    """What cannot be concluded from the stiffness trials of a campaign; `beside` states of the robot."""
    own = s.take(s.pushed)
    if not len(own):
        return
    if not beside:
        yield finding("only_stiffness_trials", words)
        yield finding("probabilities_not_calibrated")
    if own.repeats < 3:
        yield finding("deflections_not_repeated" if own.repeats < 2 else "deflections_repeated_once")
    if len(np.unique(levels(own.spine_length, SPINE_GAP))) < 2:
        yield finding("one_stiffness_length")
