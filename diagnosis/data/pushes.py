"""Rows of stiffness trials: which can be used, which repeat each other, and what cannot be concluded from them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from model.robot import Robot
from model.section import annulus_second_moment, body_second_moment
from recordings.trials import TrialRow

from ..arrays import Array, Ints
from ..errors import BadCase
from .campaign import Campaign
from .levels import SPINE_GAP, VACUUM_GAP, by_frequency, distinct, levels, step_gap
from .units import FORCE_UNITS, LENGTH_UNITS, nearest

FARTHEST = 0.3
"""Largest deflection of beam theory, as a share of the cantilever's length."""
SHORTEST = 0.01
"""m; a shorter spine offers nothing to push on."""
IMPLAUSIBLE_FORCE_RATIO = {"body": 30.0, "spine": 300.0}
"""Ratios of force measured to force expected: a body's modulus is known within a few, a jammed spine's may be a guess."""


def rows(table: Iterable[TrialRow]) -> list[TrialRow]:
    """Rows with a force and the deflection it belongs to."""
    return [r for r in table if r.protocol == "stiffness" and r.force is not None and r.deflection is not None]


def _length(robot: Robot, row: TrialRow) -> float:
    """m of the cantilever."""
    return robot.length if row.specimen == "body" else row.spine_length


def require_plausible(robot: Robot, given: list[TrialRow]) -> None:
    """Raises `BadCase` for rows that no stiffness trial of this robot gives."""
    for r in given:
        where, long = f"trial {r.trial} step {r.step}", _length(robot, r)
        if r.specimen != "body" and robot.spine is None:
            raise BadCase(
                f"{where}: a stiffness trial of a spine, but robot {robot.name!r} has none: add the spine's moduli to robot.yaml"
            )
        if long < SHORTEST:
            raise BadCase(f"{where}: a stiffness trial of a spine of {long:g} m: check spine_length (m), or write specimen body")
        if abs(r.deflection or 0.0) > FARTHEST * long:
            raise BadCase(
                f"{where}: deflection {r.deflection:g} m of a cantilever of {long:g} m; beam theory holds up to "
                f"{FARTHEST:g} of its length: check the unit (m), or leave the row out"
            )


def implausible_pushes(robot: Robot, table: Iterable[TrialRow]) -> Iterator[str]:
    """Messages about deflections longer than the cantilever, and about forces of another unit."""
    finite = [r for r in rows(table) if np.isfinite((r.force, r.deflection)).all()]  # type: ignore[arg-type]
    for specimen in ("body", "spine"):
        own = [r for r in finite if r.specimen == specimen and _length(robot, r) >= SHORTEST]
        if not own or (specimen == "spine" and robot.spine is None):
            continue
        deflection, long = np.array([(abs(r.deflection or 0.0), _length(robot, r)) for r in own]).T
        worst = int(np.argmax(deflection / long))
        if deflection[worst] > long[worst]:
            yield (
                f"trial {own[worst].trial} step {own[worst].step}, column deflection: {deflection[worst]:g} m of a cantilever of "
                f"{long[worst]:g} m: looks like mm; deflections are in m: divide by 1000"
            )
        else:
            yield from _forces(robot, specimen, own, deflection, long)


def _forces(robot: Robot, specimen: str, own: list[TrialRow], deflection: Array, long: Array) -> Iterator[str]:
    """The slope of force over deflection against 3 E I / L^3."""
    if robot.spine is not None and specimen == "spine":
        bending = robot.spine.modulus_at(long) * annulus_second_moment(robot.spine.radius)
    else:
        bending = np.full(len(own), robot.youngs_modulus * body_second_moment(robot))
    expected, force = 3 * bending / long**3 * deflection, np.array([r.force for r in own], float)
    if len(own) < 3 or np.ptp(expected) == 0 or np.ptp(force) == 0 or abs(np.corrcoef(force, expected)[0, 1]) < 0.9:
        return
    ratio, limit = abs(float(np.polyfit(expected, force, 1)[0])), IMPLAUSIBLE_FORCE_RATIO[specimen]
    worst = int(np.argmax(np.abs(force)))
    place, needed = (
        f"trial {own[worst].trial} step {own[worst].step}",
        f"{expected[worst]:.3g} N expected from robot.yaml's modulus",
    )
    if ratio > limit and (unit := nearest(ratio, FORCE_UNITS, within=10.0)) is not None:
        yield (
            f"{place}, column force: {force[worst]:g} N for {deflection[worst] * 1e3:.3g} mm, {needed}: looks like "
            f"{unit.name}; forces are in N: {unit.remedy}"
        )
    elif ratio < 1 / limit and nearest(1 / ratio, LENGTH_UNITS[:1], within=10.0) is not None:
        yield (
            f"{place}, column deflection: {deflection[worst]:g} m under {abs(force[worst]):g} N, {needed}: looks like mm; "
            "deflections are in m: divide by 1000"
        )


def kinds(given: list[TrialRow]) -> Ints:
    """Number of each row's kind of experiment, specimen and vacuum; 0 for most."""
    body = np.array([r.specimen == "body" for r in given], np.int64)
    return by_frequency(body, levels(np.array([r.vacuum or 0.0 for r in given]), VACUUM_GAP))


def conditions(given: list[TrialRow], spine: Array) -> Ints:
    """Number of each row's condition: kind, spine length, branch and step of deflection."""
    deflection, trial = np.array([r.deflection for r in given], float), np.array([r.trial for r in given])
    branch = np.array([r.branch == "unload" for r in given], np.int64)
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


def concerns(s: Campaign, beside: bool) -> Iterator[str]:
    """What cannot be concluded from the stiffness trials of a campaign; `beside` states of the robot."""
    own = s.take(s.pushed)
    if not len(own):
        return
    if not beside:
        yield (
            "only stiffness trials: nothing can be said about chambers, pressures, loads on the robot, base or "
            "cameras, and only effects that change these readings are considered; record a bending sweep"
        )
        yield "only stiffness trials: probabilities were calibrated on bending campaigns, not on such data"
    if own.repeats < 3:
        word = "no deflection was repeated" if own.repeats < 2 else "deflections were repeated only once"
        yield f"stiffness trials: {word}: default scatter of touch point, zero and jamming is assumed; repeat them three times"
    if len(np.unique(levels(own.spine_length, SPINE_GAP))) < 2:
        yield (
            "stiffness trials at only one spine length: modulus, sensor zero and touch point cannot be "
            "distinguished; measure at two or more"
        )
