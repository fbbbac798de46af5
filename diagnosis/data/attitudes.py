"""Whether the tip's attitudes are in the frame of its places: a straight robot is not turned, and it turns about the axis of its
bending.

A body bent along an arc has its tip at an angle a from the axis, about z x p, and turned by 2 a about the same; one that sags by
1.4 a. Software that turns positions into another frame and leaves quaternions where they were shows neither.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from recordings.trials import Table

from ..arrays import Array

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

TURN_OF_CHORD = 1.7
"""Turn of the tip over the angle of the line from base to tip: between that of a body that sags and of one bent along an arc."""
TURNED_AT_REST, ANOTHER_AXIS = 45.0, 0.25
"""Degrees by which robots at rest may be turned from that, median; mean of 1 - cos between the axes of bending and turning."""
BENT, TURNED = 0.03, 8.0
"""Tip's movement across the axis, robot lengths, and its turn, degrees, from which a state shows both axes."""
FEWEST = 4
LIKELY = 25.0
"""Degrees, median, that a turn of the attitudes must leave at most to be proposed."""


def attitude_in_another_frame(length: float, states: Table, resting: Table, limp: bool = False) -> str:
    """A message where attitudes contradict places of states with both, m and unit quaternions; else empty. `resting`: those
    without pressure; `limp`: a robot that hangs down from its base, which shows nothing at rest."""
    from scipy.spatial.transform import Rotation  # only tables with attitudes wait for it

    usual_roll = float(np.median(states.get("roll_deg", 0.0)))
    states, resting = (s.take(np.abs(s.get("roll_deg", 0.0) - usual_roll) < 1.0) for s in (states, resting))
    turns, tips = Rotation.from_quat(states.orientation, scalar_first=True), states.tip
    first = f"{states.place(0)}, columns qw, qx, qy, qz" if len(states) else ""
    if len(resting) and not limp:
        still = Rotation.from_quat(resting.orientation, scalar_first=True)
        away = np.degrees((_bent(resting.tip).inv() * still).magnitude())
        if np.median(away) > TURNED_AT_REST:
            return (
                f"{first}: at rest the tip's orientation is turned by {np.median(away):.0f} deg from a straight robot, whose is "
                f"(1, 0, 0, 0): {_remedy(turns, tips)}"
            )
    lateral, turned = tips, turns
    if len(resting):
        lateral = tips - np.median(resting.tip, axis=0)
        turned = turns * Rotation.from_quat(resting.orientation, scalar_first=True).mean().inv()
    bending = np.cross([0.0, 0.0, 1.0], lateral)
    size, angle = np.linalg.norm(bending, axis=1), turned.magnitude()
    told = (size > BENT * length) & (np.degrees(angle) > TURNED)
    if told.sum() < FEWEST:
        return ""
    cosine = (bending * turned.as_rotvec()).sum(axis=1)[told] / (size * angle)[told]
    if np.mean(1 - cosine) <= ANOTHER_AXIS:
        return ""
    return (
        f"{first}: the tip's orientation turns about another axis than the tip bends about (by "
        f"{np.degrees(np.arccos(np.median(cosine))):.0f} deg in the median of {told.sum()} states): {_remedy(turns, tips)}"
    )


def _bent(tips: Array) -> Rotation:
    """Turns that places (n, 3) m show, base frame."""
    from scipy.spatial.transform import Rotation

    axis = np.cross([0.0, 0.0, 1.0], tips)
    across = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = TURN_OF_CHORD * np.arctan2(across, tips[:, 2:])
    return Rotation.from_rotvec(axis / np.maximum(across, 1e-12) * angle)


def _remedy(turns: Rotation, tips: Array) -> str:
    """What to do: the quarter turn that brings attitudes to places, if one does."""
    from scipy.spatial.transform import Rotation

    bent, ways = _bent(tips), [(turns.inv(), "change the sign of qx, qy and qz")]
    for q in Rotation.create_group("O"):
        w, x, y, z = q.as_quat(canonical=True, scalar_first=True).round(3) + 0.0
        by, back = f"({w:g}, {x:g}, {y:g}, {z:g})", f"({w:g}, {-x + 0.0:g}, {-y + 0.0:g}, {-z + 0.0:g})"
        ways += [
            (q * turns, f"multiply each quaternion from the left by {by}"),
            (q * turns * q.inv(), f"multiply each quaternion from the left by {by} and from the right by {back}"),
            (turns * q, f"multiply each quaternion from the right by {by}"),
        ]
    left = np.degrees([float(np.median((bent.inv() * turned).magnitude())) for turned, _ in ways])
    best = int(np.argmax(left < left.min() + 1.0))  # a plain one of those that do the same
    looks = "looks like the attitude in another frame than the position"
    if left[best] > LIKELY:
        return f"{looks}: write both in the base frame, or leave the quaternions out"
    return f"{looks}: {ways[best][1]} (w, x, y, z), or leave them out"
