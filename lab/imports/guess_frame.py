"""Find which axis of a file each axis of the base is: by where the resting body lies, and by how the tip moves.

How the tip moves is held against the model of robot.yaml, whose pressures are scaled so that it moves as far. The agreement of a
frame is the cosine between both movements from rest, over all rows; it is free of where the cameras have their origin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.campaign import spread_over
from model.arrays import Array, Ints, Mask
from model.condition import HIGHEST_PRESSURE
from model.prediction import Predictor
from model.robot import Robot

from .map_file import AXES, Frame
from .proposal import Guess

AXES_OF_BASE = "axis of the robot's base (z from base to tip): axis of the file"
MOST = 60
"""Rows that are compared with the model."""
CLEAR, OF_MODEL = 2.0, 0.02
"""Times less that a clear frame lacks of full agreement than another, and what models of robots lack anyway."""
AGREES = 0.9
"""Agreement from which a frame is not doubted."""
AT_BASE, EXACT = 0.25, 0.05
"""Share of a length by which the resting body may lie elsewhere where the origin is at the base, and where it surely is."""


@dataclass(frozen=True)
class Driven:
    """What drives the robot in n rows."""

    pressures: Array
    """(n, actuators) Pa above the lowest of each; (n, 0) where they are unknown."""
    roll: Array
    """(n,) deg by which the body is turned in its mount."""
    mass: float | None
    """kg that hang there at rest, where the file says so."""

    def tips(self, robot: Robot, rows: Ints, size: float = 1.0) -> Array:
        """(m, 3) m where the model has the tip, with pressures of another size; NaN where it has no equilibrium."""
        known = self.pressures if self.pressures.shape[1] else np.zeros((len(self.pressures), len(robot.actuators.azimuths_deg)))
        pressures = np.clip(size * known[rows], 0.0, HIGHEST_PRESSURE)
        unlimited = robot.model_copy(update={"max_pressure": None})  # of which nothing is asked here
        return Predictor(unlimited)(pressures, tip_mass=self.mass, roll=np.radians(self.roll[rows])).tip


def guess_frame(g: Guess, tip: Array, rest: Mask, markers: Sequence[Array], robot: Robot, rests: bool, driven: Driven) -> None:
    """Propose the frame, right-handed, and `straight: at rest` where the tip rests elsewhere than the model; doubt what is not
    clear. z: the axis of the file that fits the movement best; that along which the body lies from the origin, unless the
    movement clearly contradicts. x, y: as the movement has them.

    `tip`: (n, 3) m; `rest`: (n,) rows with the lowest pressures, in which the robot `rests`; `markers`: (3,) m of those of
    robot.yaml in these rows."""
    at_rest = tip[rest].mean(axis=0)
    likeness = _likeness(tip, rest, robot, driven)
    turns = {z: max(_turned(z), key=lambda xy: round(_agreement(likeness, *xy, z), 3)) for z in ("z", "-z", "x", "-x", "y", "-y")}
    lack = {z: 1 - _agreement(likeness, *xy, z) for z, xy in turns.items()}
    # of frames with another hand: two columns of the tip or of the actuators are swapped
    swapped = {z: 1 - max(_agreement(likeness, y, x, z) for x, y in _turned(z)) for z in turns}
    least = {z: min(lack[z], swapped[z]) for z in turns}
    best = _least(swapped if _clear(min(swapped.values()), min(lack.values())) else lack)
    lies, stands = _lies_along(at_rest, markers, robot), driven.tips(robot, _some(rest))
    z = best if likeness.any() else _axis(at_rest)
    exact = abs(np.linalg.norm(at_rest) - np.linalg.norm(stands, axis=1).mean()) < EXACT * robot.length
    if lies is not None and not _clear(least[best], least[lies]):  # swapped columns would explain the movement, too
        z = lies if exact or not _clear(lack[best], lack[lies]) else best
    (x, y), agreement = turns[z], 1 - lack[z]
    rival = _least({other: value for other, value in lack.items() if other != z})
    compared = f"movement and model agree to {agreement:.2f} of 1, along {rival} to {1 - lack[rival]:.2f}"
    if lies not in (None, z):
        g.doubt(
            "frame.z",
            f"the resting tip lies along the file's {lies} from the origin, but the tip moves as if the base's z were its {z} "
            f"({compared}): the origin is taken to be elsewhere than the base",
        )
    elif not (lies and exact) and not _clear(lack[z], lack[rival]):
        text = "neither the resting tip nor its movement determines which axis points from base to tip"
        g.doubt("frame.z", f"{text}. The file's {z} fits best ({compared})")
    sense = "away from the chambers inflated" if robot.tendons is None else "towards the tendons pulled"
    bends = f"the tip bends {sense} (agreement with the model {agreement:.2f} of 1)"
    if agreement < AGREES and driven.pressures.shape[1]:
        columns = " Two columns of the tip or of the actuators may be swapped." if _clear(swapped[z], lack[z]) else ""
        columns += f" Or the origin is not at the base, and its z is the file's {best}." if _clear(lack[best], lack[z]) else ""
        g.doubts.append(
            f"frame.x, frame.y: with the base's x along the file's {x} and its y along the file's {y} {bends}. This is the best "
            f"turn about the base's z, but the data do not force it.{columns} If base and cameras have not moved since an "
            "earlier table, copy the frame from its map"
        )
    if (x, y, z) != ("x", "y", "z"):
        shown_by = "the resting body lies there from the origin" if lies == z else "the tip moves so"
        why = f"{AXES_OF_BASE}. Its z is the file's {z}, as {shown_by}; with these x and y {bends}"
        g.say("frame", {"x": x, "y": y, "z": z}, why)
    _straight(g, Frame(x=x, y=y, z=z).matrix @ at_rest, stands, robot, rests)


def _straight(g: Guess, at_rest: Array, stands: Array, robot: Robot, rests: bool) -> None:
    """Propose to move the resting tip, (3,) m in the base's axes, to where the model `stands`, (m, 3) m, if it is elsewhere."""
    stands = stands.mean(axis=0) if np.isfinite(stands).all() else np.array([0.0, 0.0, robot.length])
    # how far it sags or bends by robot.yaml's weight and stiffness may be half as much again
    if np.linalg.norm(at_rest - stands) <= 0.05 * robot.length + 1.5 * np.hypot(*stands[:2]):
        return
    found, expected = (", ".join(str(round(1e3 * v)) for v in place) for place in (at_rest, stands))
    which = "at rest" if rests else "the robot is at rest in no row with a tip. In those with the lowest pressures"
    text = f"{which} the recorded tip is at ({found}) mm along the base's axes; the model expects ({expected}) mm"
    g.say("straight", "at rest", f"{text}: the origin is probably not at the base")
    g.doubt(
        "straight",
        f"{text}. The origin is probably not at the base. `at rest` moves all points to the model's position in these states, "
        "which hides any error there. To see that error, measure the base position in camera coordinates and enter it as `zero` "
        "of columns x, y, z",
    )


# ------------------------------------------------------------------ movement
def _likeness(tip: Array, rest: Mask, robot: Robot, driven: Driven) -> Array:
    """(3, 3) sum over rows of the model's movement from rest by the tip's, (n, 3) m, over the sizes of both: the cosine between
    them where both are along the same axes. 0 where nothing moves, or the pressures are unknown."""
    known = np.isfinite(np.column_stack([tip, driven.pressures])).all(axis=1)
    rows, still, size = _some(known & ~rest), _some(known & rest), 1.0
    if not (driven.pressures.shape[1] and rows.size and still.size):
        return np.zeros((3, 3))
    moved = tip[rows] - tip[still].mean(axis=0)
    for _ in range(3):
        predicted = np.nan_to_num(driven.tips(robot, rows, size) - driven.tips(robot, still).mean(axis=0))
        solved = predicted.any(axis=1)
        far, predicted_far = (float(np.linalg.norm(movement[solved])) for movement in (moved, predicted))
        if not far * predicted_far > 0:
            return np.zeros((3, 3))
        size *= float(np.clip(far / predicted_far, 1 / 8, 8))
    return np.asarray(predicted[solved].T @ moved[solved] / (far * predicted_far))


def _agreement(likeness: Array, *axes: str) -> float:
    """Cosine between movements where the base's x, y, z are these axes of the file."""
    return float(sum(AXES[name][1] * likeness[k, AXES[name][0]] for k, name in enumerate(axes)))


def _some(rows: Mask) -> Ints:
    """Numbers of some rows of a mask, evenly spread."""
    found = np.flatnonzero(rows)
    return found[spread_over(len(found), MOST)] if len(found) else found


def _clear(lack: float, other: float) -> bool:
    """Whether a frame agrees clearly better than another."""
    return CLEAR * (lack + OF_MODEL) < other + OF_MODEL


def _least(values: Mapping[str, float]) -> str:
    return min(values, key=lambda name: values[name])


def _turned(z: str) -> list[tuple[str, str]]:
    """x and y of the four right-handed frames with this z."""
    along = "xyz".index(z[-1])
    first, second = "xyz"[(along + 1) % 3], "xyz"[(along + 2) % 3]
    one, two = (second, first) if z.startswith("-") else (first, second)
    return [(one, two), (two, f"-{one}"), (f"-{one}", f"-{two}"), (f"-{two}", one)]


# ------------------------------------------------------------------ place
def _lies_along(at_rest: Array, markers: Sequence[Array], robot: Robot) -> str | None:
    """The axis of the file along which the body rests from the origin; None where this is not at the base.

    The body sags least at its base, so the first marker shows it best."""
    places = [(markers[0], robot.markers[0])] if markers else []
    for place, arc in (*places, (at_rest, robot.length)):
        axis = _axis(place)
        along = float(AXES[axis][1] * place[AXES[axis][0]])
        if abs(np.linalg.norm(place) / arc - 1) < AT_BASE and np.linalg.norm(place) ** 2 - along**2 <= (0.5 * arc) ** 2:
            return axis
    return None


def _axis(place: Array) -> str:
    """The axis of the file on which a place is farthest from the origin, with its sign."""
    along = int(np.argmax(np.abs(place)))
    return "-" * bool(place[along] < 0) + "xyz"[along]
