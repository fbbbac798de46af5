"""Whether the tip and the markers can be points along this body: how far each moves, and how far apart they are.

A point farther from the base moves at least as far as one nearer to it, and two points are no farther apart than the length of
the body between them, which stretches by as much as the pressures stretch it. Exchanged markers, or exchanged axes of one of
them, contradict one of both. Nothing is refused here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.data.plausible import tracked_beyond
from model.condition import conditions
from model.effects import ForwardModel
from model.errors import BadCondition
from model.robot import Robot
from recordings.trials import Table

Array = NDArray[np.float64]

LONGER, STRETCHED = 0.03, 0.1
"""Robot lengths by which two points may be too far apart, for noise and an uncertain length: of a body pulled by tendons, and of
one whose chambers may also stretch it by the thrust on their walls."""
FEWEST, MOST = 3, 60
"""States with points too far apart, and states whose stretch is computed."""
BENT, ALONG = (0.05, 0.3), 0.7
"""Displacements, per arc length, at which a point of a body that hardly stretches moves across its axis, and the share of it
along the axis that is no longer bending: an arc that turns by up to 0.6 rad has 0.2."""


def doubtful_places(robot: Robot, table: Table) -> Iterator[str]:
    """What to ask about the points of a table (m)."""
    kept = table.take(table.with_tip)
    if not len(kept):
        return
    places = np.concatenate([kept.markers, kept.tip[:, None]], axis=1)
    count = places.shape[1] - 1
    arcs = np.full(count + 1, np.nan)  # of markers that robot.yaml does not know
    arcs[: min(count, len(robot.markers))] = robot.markers[:count]
    arcs[-1] = robot.length
    names = [*(f"marker {k}" for k in range(1, count + 1)), "the tip"]
    if odd := _order(places, arcs, names):
        yield odd
        return
    yield from _too_far(robot, kept, places, arcs, names)
    if robot.tendons is not None:
        yield from _along(kept.pressures, places, arcs, names)


def _order(places: Array, arcs: Array, names: Sequence[str]) -> str:
    """About a point that moves farther than one that is farther from the base."""
    seen = places[np.isfinite(places).all(axis=(1, 2))]
    if len(seen) < FEWEST:
        return ""
    spread = np.sqrt(seen.var(axis=0).sum(axis=1))
    every = range(len(spread))
    pairs = [(i, j) for i in every for j in every if spread[j] > 0 and not arcs[i] >= arcs[j] and np.isfinite(arcs[j])]
    ratio, i, j = max(((spread[i] / spread[j], i, j) for i, j in pairs), default=(0.0, 0, 0))
    # noise and stretch make less
    if ratio < 1.2:
        return ""
    where = "it" if names[j] == "the tip" else f"it, though {names[j]} is farther from the base (robot.yaml, markers)"
    return f"{names[i]} moves {ratio:.2g} times as far as {names[j]}: was it taken for {where}?"


def _too_far(robot: Robot, states: Table, places: Array, arcs: Array, names: Sequence[str]) -> Iterator[str]:
    """About a point that is farther from the base than the body between them is long."""
    stretch = _stretch(robot, states.pressures)
    more = LONGER if robot.chambers is None else STRETCHED
    for k, name in enumerate(names):
        tip = name == "the tip"
        aside = tracked_beyond(robot) if tip else robot.outer_radius
        most = float(arcs[k] * stretch + more * robot.length + aside)
        away = np.linalg.norm(places[:, k], axis=1)
        if (far := away > most).sum() < FEWEST:
            continue
        yield (
            f"{name} is up to {1e3 * np.nanmax(away):.0f} mm from the base, in {int(far.sum())} of {len(states)} states farther "
            f"than the {1e3 * arcs[k] * stretch:.0f} mm of body between them: check its columns x, y, z (exchanged axes, unit), "
            + ("the length of the robot, and where on it the tracked point sits (marker_offset)" if tip else "and markers")
        )


def _along(tensions: Array, places: Array, arcs: Array, names: Sequence[str]) -> Iterator[str]:
    """About a point that moves along the axis of a body that tendons bend."""
    total = tensions.sum(axis=1)
    for k, name in enumerate(names):
        known = np.flatnonzero(np.isfinite(places[:, k]).all(axis=1) & np.isfinite(total))
        if not len(known) or not np.isfinite(arcs[k]):
            continue
        rest = places[known[np.argmin(total[known])], k]
        if np.hypot(*rest[:2]) > BENT[1] * arcs[k]:  # sags so far that across its axis is along z
            continue
        moved = places[known, k] - rest
        size = np.linalg.norm(moved, axis=1)
        bent = (size > BENT[0] * arcs[k]) & (size < BENT[1] * arcs[k])
        if bent.sum() < FEWEST or np.median(np.abs(moved[bent, 2]) / size[bent]) < ALONG:
            continue
        yield (
            f"{name} moves along z, the robot's axis, though tendons bend the body across it: are two of its columns x, y, z "
            "exchanged, or is the robot's axis another axis of the file (frame)?"
        )


def _stretch(robot: Robot, pressures: Array) -> float:
    """Largest ratio of the body's length under pressures (n, chambers) Pa to its length, twice the excess the model predicts."""
    if pressures.shape[1] != len(robot.bending_directions) or robot.tendons is not None:
        return 1.0
    most = np.argsort(-np.nan_to_num(pressures.sum(axis=1)), kind="stable")[:MOST]
    try:
        asked = conditions(robot, 0.0, np.nan_to_num(pressures[most]))
    except BadCondition:  # the states do not fit this robot, which is said elsewhere
        return 1.0
    model = ForwardModel.of_single_states(robot).at(asked, np.zeros(0))
    # twenty chords along the backbone, whose sum is its length
    shapes = model.shapes(np.zeros(len(model.parameters)), np.linspace(0.0, robot.length, 21))
    lengths = np.linalg.norm(np.diff(shapes, axis=1), axis=2).sum(axis=1)
    lengths = lengths[np.isfinite(lengths)]
    return 1.0 + 2.0 * max(float(lengths.max(initial=robot.length)) / robot.length - 1.0, 0.0)
