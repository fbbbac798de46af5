"""Check whether the tip turns as it moves, whether files have their markers in one order, and rows another marker."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import scipy

from diagnosis.data.campaign import settings
from diagnosis.data.levels import REST
from model.arrays import Array, Mask
from model.effects import ForwardModel
from model.errors import ModelError
from model.robot import Robot
from recordings.trials import Table

from ..files.config import ConfigError
from ..files.jumps import BODIES, STILL, at_rest

LEAST_TURN = np.radians(10.0)
FEWEST = 6
"""States that turn by as much."""
FITS, SIZES = 0.9, (0.15, 5.0)
"""Agreement of place and turn (1 is the most) of bodies, and sizes of their displacements, of an arc's."""


def turn_off(states: Table, length: float) -> tuple[float, float] | None:
    """The agreement (1 is the most) between the axis about which the tip turns and the one across its displacement, and the
    displacement in units of that of an arc that turns as far; None where they fit those of a body of this length (m)."""
    oriented = states.take(np.asarray(np.isfinite(np.column_stack([states.tip, states.orientation])).all(axis=1)))
    resting = at_rest(oriented.pressures)
    if not resting.any():
        return None
    turn = scipy.spatial.transform.Rotation.from_quat(oriented.orientation.reshape(-1, 4), scalar_first=True)
    bent, across = _from_rest(oriented.tip, turn, resting)
    if len(bent) < FEWEST or not across.any():
        return None
    moved, turned = (np.linalg.norm(v, axis=1) for v in (across, bent))
    agreement = float((across * bent).sum() / (moved * turned).sum())
    size = float(moved.sum() / (length / 2 * turned.sum()))  # an arc's end moves length / 2 per rad
    return None if agreement > FITS and SIZES[0] < size < SIZES[1] else (agreement, size)


def turn_misfit(tip: Array, turn: scipy.spatial.transform.Rotation, resting: Mask) -> float | None:
    """rad (rms) by which the tip, (n, 3) m, turns about another axis than the one across its displacement; None: hardly turns."""
    bent, axis = _from_rest(tip, turn, resting)
    if len(bent) < FEWEST:
        return None
    axis /= np.maximum(np.linalg.norm(axis, axis=1), 1e-12)[:, None]
    about = np.maximum((bent * axis).sum(axis=1), 0.0)
    return float(np.sqrt(((bent - about[:, None] * axis) ** 2).sum(axis=1).mean()))


def _from_rest(tip: Array, turn: scipy.spatial.transform.Rotation, resting: Mask) -> tuple[Array, Array]:
    """Of the rows that turn by `LEAST_TURN` from the mean of the states at rest: rotation vectors from it (m, 3) rad, and the
    displacement across z, turned by a quarter about z (m, 3) m: the axis about which a body bends there."""
    bent, moved = (turn * turn[resting].mean().inv()).as_rotvec(), tip - tip[resting].mean(axis=0)
    clear = np.linalg.norm(bent, axis=1) > LEAST_TURN
    return bent[clear], np.column_stack([-moved[:, 1], moved[:, 0], np.zeros(len(tip))])[clear]


# ------------------------------------------------------------------ from file to file
EXCHANGED, ELSEWHERE = 3.0, 0.5
"""Times farther from the same points of another file than from others of them, and robot lengths that a tip at rest is away from
where it rests there, from which the order of columns is asked about."""


def other_order(files: Sequence[tuple[str, Array]], length: float, moved: bool) -> Iterator[str]:
    """Ask about files, (name, points at rest: (1 + k, 3) m of the tip and k markers), in which points stand where other points
    do in the usual file, the one that is nearest to all, or in which the tip is far from where it is there.

    `length`: the robot's, m; `moved`: cameras may have been moved from file to file."""
    usable = [(name, rest) for name, rest in files if np.isfinite(rest).all()]
    if len(usable) < 2 or len({rest.shape for _, rest in usable}) > 1:
        return
    names, places = [name for name, _ in usable], np.array([rest for _, rest in usable])
    if moved and places.shape[1] > 1:
        places = places - places.mean(axis=1, keepdims=True)
    apart = np.linalg.norm(places[:, None] - places[None], axis=3).sum(axis=(1, 2))
    usual = int(np.argmin(np.round(apart, 9)))
    for name, place in zip(names, places, strict=True):
        off = np.linalg.norm(place[:, None] - places[usual][None], axis=2)
        rows, columns = scipy.optimize.linear_sum_assignment(off)  # which point of the usual file each is nearest to
        exchanged = [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if i != j]
        if exchanged and float(np.trace(off)) > max(EXCHANGED * float(off[rows, columns].sum()), STILL * length):
            text = ", ".join(f"{BODIES[i]} stands where {BODIES[j]} does" for i, j in exchanged)
        elif (place.shape[0] > 1 or not moved) and off[0, 0] > ELSEWHERE * length:
            behind = " behind the base," if place[0, 2] < 0 < places[usual][0, 2] else ""
            text = f"the tip is{behind} {1e3 * off[0, 0]:.0f} mm from where it is"
        else:
            continue
        yield (
            f"{name}: at rest {text} in {names[usual]}: are its marker columns in another order? If so, name its columns or "
            f"points under files: {{{name!r}: {{points: ..}}, '*': {{}}}}"
        )


# ------------------------------------------------------------------ at rest
def at_rest_by_model(robot: Robot, states: Table) -> tuple[Array, scipy.spatial.transform.Rotation, Array]:
    """Tip (n, 3) m, its turn and markers (n, k, 3) m of states in the base frame, as the model of robot.yaml has them: with their
    spine, mass, roll and force, without pressures up to `REST`. Raises ConfigError where it finds no equilibrium."""
    vented = bool(np.nan_to_num(np.abs(states.pressures)).max(initial=0.0) < REST)
    try:
        model = ForwardModel.of_single_states(robot).at(settings(robot, states, vented))
        read = model.read(np.zeros(len(model.parameters)))
    except ModelError as e:
        raise ConfigError(f"straight: at rest: {e}") from e
    if not np.isfinite(read.tip).all():
        raise ConfigError(
            "straight: at rest: robot.yaml's model has no equilibrium in the states at rest; correct modulus and weight, or "
            "write `straight: first state` for a robot that is straight at rest"
        )
    return read.tip[0], scipy.spatial.transform.Rotation.from_quat(read.orientation[0], scalar_first=True), read.markers[0]


def strays(tip: Array, markers: Array, length: float) -> Mask:
    """(n,) rows of a state, in which a place, of the tip (n, 3) or a marker (n, k, 3) m, jumps, that hold it far from where most
    rows do."""
    out = np.zeros(len(tip), bool)
    for place in (tip, *np.swapaxes(markers, 0, 1)):
        seen = place[np.isfinite(place).all(axis=1)]
        if np.linalg.norm(np.diff(seen, axis=0), axis=1).max(initial=0.0) > STILL * length:
            out |= np.linalg.norm(place - np.median(seen, axis=0), axis=1) > STILL * length / 2
    return out
