"""Whether forces and deflections of stiffness rows are N and m: held against the cantilever that robot.yaml describes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from model.robot import Robot
from model.section import annulus_second_moment, body_second_moment
from recordings.trials import TrialRow

from .plausible_units import FORCE_UNITS, Unit, nearest
from .pushes import SHORTEST

IMPLAUSIBLE_FORCE_RATIO = {"body": 30.0, "spine": 300.0}
"""Ratios of force measured to force expected: a body's modulus is known within a few, a jammed spine's may be a guess."""


def implausible_pushes(robot: Robot, rows: Iterable[TrialRow]) -> Iterator[str]:
    """Deflections longer than the cantilever, and forces of another unit."""
    for specimen in ("body", "spine"):
        own = [r for r in rows_of(rows, specimen) if _long(robot, r) >= SHORTEST]
        if not own or (specimen == "spine" and robot.spine is None):
            continue
        deflection = np.array([abs(r.deflection or 0.0) for r in own])
        long = np.array([_long(robot, r) for r in own])
        worst = int(np.argmax(deflection / long))
        place = f"trial {own[worst].trial} step {own[worst].step}"
        if deflection[worst] > long[worst]:
            yield (
                f"{place}, column deflection: {deflection[worst]:g} m of a cantilever of {long[worst]:g} m: looks like mm; "
                "deflections are in m: divide by 1000"
            )
            continue
        yield from _forces(robot, specimen, own, deflection, long)


def rows_of(rows: Iterable[TrialRow], specimen: str) -> list[TrialRow]:
    """Stiffness rows of a specimen with finite numbers."""
    own = [r for r in rows if r.protocol == "stiffness" and r.specimen == specimen]
    return [r for r in own if r.force is not None and r.deflection is not None and np.isfinite((r.force, r.deflection)).all()]


def _long(robot: Robot, row: TrialRow) -> float:
    return robot.length if row.specimen == "body" else row.spine_length


def _forces(robot: Robot, specimen: str, own: list[TrialRow], deflection: np.ndarray, long: np.ndarray) -> Iterator[str]:
    """The slope of force over deflection against 3 E I / L^3."""
    if robot.spine is not None and specimen == "spine":
        bending = robot.spine.modulus_at(long) * annulus_second_moment(robot.spine.radius)
    else:
        bending = np.full(len(own), robot.youngs_modulus * body_second_moment(robot))
    expected = 3 * bending / long**3 * deflection
    force = np.array([r.force for r in own], float)
    if len(own) < 3 or np.ptp(expected) == 0 or np.ptp(force) == 0:
        return
    if abs(np.corrcoef(force, expected)[0, 1]) < 0.9:
        return
    ratio = abs(float(np.polyfit(expected, force, 1)[0]))
    limit = IMPLAUSIBLE_FORCE_RATIO[specimen]
    worst = int(np.argmax(np.abs(force)))
    place = f"trial {own[worst].trial} step {own[worst].step}"
    needed = f"{expected[worst]:.3g} N expected from robot.yaml's modulus"
    if ratio > limit and (unit := nearest(ratio, FORCE_UNITS, within=10.0)) is not None:
        yield (
            f"{place}, column force: {force[worst]:g} N for {deflection[worst] * 1e3:.3g} mm, {needed}: looks like "
            f"{unit.name}; forces are in N: {unit.remedy}"
        )
    elif ratio < 1 / limit and nearest(1 / ratio, (Unit("mm", 1000.0),), within=10.0) is not None:
        yield (
            f"{place}, column deflection: {deflection[worst]:g} m under {abs(force[worst]):g} N, {needed}: looks like mm; "
            "deflections are in m: divide by 1000"
        )
