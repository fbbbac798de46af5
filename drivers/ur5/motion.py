"""What a straight motion of the arm may ask for, how long it may take, and whether two poses are the same.

Poses are (x, y, z [m], rotation vector [rad]) in the arm's base frame. Rotation vectors are never subtracted: near a
half turn the same orientation has two of them with opposite signs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import timing
from timing import Clock

from ..errors import LimitExceeded, WrongDevice
from ..interfaces import Vector6
from .config import Config

TURN_WAY = 0.2
"""m for which a turn by 1 rad counts: more than the controller takes."""


def distance_between(a: Sequence[float], b: Sequence[float]) -> float:
    """Distance of the positions of two poses, m."""
    return math.dist(a[:3], b[:3])


def turn_between(a: Sequence[float], b: Sequence[float]) -> float:
    """Angle of the rotation that leads from one pose's orientation to the other's, 0..pi rad."""
    p, q = _quaternion(a[3:6]), _quaternion(b[3:6])
    # By the chord between the unit quaternions: acos of their product has no digits left at small angles.
    chord = min(math.dist(p, q), math.dist(p, [-x for x in q]))
    return 4.0 * math.asin(min(1.0, chord / 2.0))


def _quaternion(vector: Sequence[float]) -> list[float]:
    angle = math.hypot(*vector)
    factor = math.sin(angle / 2.0) / angle if angle > 1e-12 else 0.5
    return [math.cos(angle / 2.0), *(factor * x for x in vector)]


def check_request(name: str, limits: Config, pose: Sequence[float], speed: float, acceleration: float) -> Vector6:
    """The pose as six floats. Raises LimitExceeded when pose, speed (m/s) or acceleration (m/s^2) is not allowed."""
    goal = [float(x) for x in pose]
    if len(goal) != 6 or not all(math.isfinite(x) for x in (*goal, speed, acceleration)):
        raise LimitExceeded(
            name, f"pose {goal}, speed {speed}, acceleration {acceleration}: the pose needs six numbers, and all must be finite"
        )
    if not 0 < speed <= limits.max_speed:
        raise LimitExceeded(name, f"speed {speed:g} m/s outside 0..{limits.max_speed:g} m/s; reduce it or raise max_speed")
    if not 0 < acceleration <= limits.max_acceleration:
        raise LimitExceeded(
            name,
            f"acceleration {acceleration:g} m/s^2 outside 0..{limits.max_acceleration:g} m/s^2; reduce it or raise "
            "max_acceleration",
        )
    for axis, value, low, high in zip("xyz", goal, limits.workspace_min, limits.workspace_max, strict=False):
        if not low <= value <= high:
            raise LimitExceeded(name, f"{axis} = {value:.4f} m outside the workspace {low:g}..{high:g} m; change one of them")
    return (goal[0], goal[1], goal[2], goal[3], goal[4], goal[5])


def check_step(name: str, limits: Config, here: Sequence[float], goal: Sequence[float]) -> None:
    """Raises LimitExceeded when the goal is farther from the present pose than one motion may go."""
    distance, turn = distance_between(here, goal), turn_between(here, goal)
    if distance > limits.max_step:
        raise LimitExceeded(
            name, f"target is {distance:.4f} m away, limit {limits.max_step:g} m; move in steps or raise max_step"
        )
    if turn > limits.max_turn:
        raise LimitExceeded(
            name, f"target is turned by {turn:.3f} rad, limit {limits.max_turn:g} rad; turn in steps or raise max_turn"
        )


def duration(here: Sequence[float], goal: Sequence[float], speed: float, acceleration: float) -> float:
    """Time of a straight motion, s: accelerate, cruise, decelerate (an upper bound: v/a + d/v)."""
    way = max(distance_between(here, goal), TURN_WAY * turn_between(here, goal))
    return way / speed + speed / acceleration


def top_speed(here: Sequence[float], goal: Sequence[float], speed: float, acceleration: float) -> float:
    """Highest speed of the TCP on a straight motion, m/s: a short one ends before it reaches `speed`; 0 where it mostly turns."""
    way = distance_between(here, goal)
    return 0.0 if way < TURN_WAY * turn_between(here, goal) else min(speed, math.sqrt(acceleration * way))


@dataclass(frozen=True)
class Deadline:
    """A time that is part rig time (what the arm needs) and part host time (what the wire needs)."""

    clock: Clock
    rig_start: float
    host_start: float
    rig_allowed: float
    host_margin: float

    @classmethod
    def after(cls, clock: Clock, rig_allowed: float, host_margin: float) -> Deadline:
        """Starts now; both in s."""
        return cls(clock, clock.now(), timing.now(), rig_allowed, host_margin)

    @property
    def expired(self) -> bool:
        """True when the rig's part is over and the overdue, converted to host time, exceeds the margin."""
        rig, host = self.clock.now() - self.rig_start, timing.now() - self.host_start
        if rig <= self.rig_allowed:
            return False
        return host * (1.0 - self.rig_allowed / rig) > self.host_margin


PAYLOAD_TOLERANCE, CENTRE_TOLERANCE = 0.01, 1e-3
"""kg and m: the pendant shows no finer."""
TCP_TOLERANCE = 1e-6
"""m and rad: what the controller's own arithmetic changes."""


@dataclass(frozen=True)
class Tool:
    """Payload (kg), its centre of gravity (m), TCP (m, rotation vector rad), in the flange frame; None: not reported."""

    payload: float | None
    centre: Sequence[float] | None
    tcp: Sequence[float]

    def check(self, name: str, at_open: Tool, wanted: float | None) -> None:
        """Raise WrongDevice when the payload is not the one wanted (kg), or anything not as it was at `open`."""
        if wanted is not None and self.payload is not None and abs(self.payload - wanted) > PAYLOAD_TOLERANCE:
            raise WrongDevice(
                name,
                f"the payload is set to {self.payload:.3f} kg, needed {wanted:.3f} kg; set it in the installation at the "
                "pendant, or correct payload in rig.yaml",
            )
        if self.payload is not None and at_open.payload is not None:
            same = abs(self.payload - at_open.payload) <= PAYLOAD_TOLERANCE
            self._demand(same, name, "payload", f"{self.payload:.3f} kg", f"{at_open.payload:.3f} kg")
        if self.centre is not None and at_open.centre is not None:
            same = distance_between(self.centre, at_open.centre) <= CENTRE_TOLERANCE
            now, then = millimetres(self.centre), millimetres(at_open.centre)
            self._demand(same, name, "payload's centre of gravity", now, then)
        self._demand(same_pose(self.tcp, at_open.tcp), name, "TCP", _words(self.tcp), _words(at_open.tcp))

    @staticmethod
    def _demand(same: bool, name: str, what: str, now: str, then: str) -> None:
        if not same:
            raise WrongDevice(
                name, f"the {what} is now {now}, needed as at open {then}; set it back at the pendant, or close and open the arm"
            )


def same_pose(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two poses agree within the controller's arithmetic."""
    return distance_between(a, b) <= TCP_TOLERANCE and turn_between(a, b) <= TCP_TOLERANCE


def millimetres(pose: Sequence[float]) -> str:
    """The position of a pose (m) in words."""
    return "(" + ", ".join(f"{x * 1e3:.1f}" for x in pose[:3]) + ") mm"


def _words(pose: Sequence[float]) -> str:
    return f"{millimetres(pose)} turned by ({', '.join(f'{x:.4f}' for x in pose[3:])}) rad"
