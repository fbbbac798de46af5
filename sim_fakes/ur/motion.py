"""Motions of the arm: straight in joint space, straight in space, and stopping. Each is advanced by rig time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .kinematics import Array, Geometry, forward, inverse, pose_matrix, pose_vector, rotation_matrix, rotation_vector

JOINT_SPEED_LIMIT = math.pi
"""rad/s; a faster joint is stopped by the safety system."""
START_JOINTS = (0.0, -1.5708, -1.5708, -1.5708, 1.5708, 0.0)
"""rad; the tool points down about 0.49 m in front of the base and 0.43 m above it."""


class ProgramError(Exception):
    """The running program cannot go on; the message is the reason the controller logs."""


class JointOverspeed(Exception):
    """A joint would have to move faster than it may: the safety system stops the arm."""


@dataclass
class ArmMotion:
    """Joint angles (rad), joint speeds (rad/s) and the tool (TCP in the flange frame, 4x4)."""

    geometry: Geometry
    q: Array = field(default_factory=lambda: np.array(START_JOINTS))
    qd: Array = field(default_factory=lambda: np.zeros(6))
    tool: Array = field(default_factory=lambda: np.eye(4))
    _known: tuple[Array, Array, Array, Array, Array] | None = field(default=None, repr=False)
    """Joint angles and tool, and what `forward` says of them: an arm stands still most of its cycles."""

    def _solved(self) -> tuple[Array, Array, Array]:
        """TCP as 4x4 and as (x, y, z, rotation vector), and the Jacobian, where the arm is now."""
        known = self._known
        if known is None or known[0] is not self.q or known[1] is not self.tool:  # both are replaced, never changed
            pose, jacobian = forward(self.geometry, self.q, self.tool)
            known = self._known = (self.q, self.tool, pose, pose_vector(pose), jacobian)
        return known[2:]

    def pose(self) -> Array:
        """TCP, 4x4."""
        return self._solved()[0].copy()

    def pose_vector(self) -> Array:
        """TCP as (x, y, z, rotation vector)."""
        return self._solved()[1].copy()

    def tcp_speed(self) -> Array:
        """TCP speed, m/s and rad/s, shape (6,)."""
        return self._solved()[2] @ self.qd

    def solve(self, target: Array, start: Array | None = None) -> Array | None:
        """Joint angles for a TCP (4x4), from the present ones or from `start`."""
        return inverse(self.geometry, target, self.q if start is None else start, self.tool)

    def place(self, q: Array, dt: float) -> None:
        """Go to joint angles within dt (s), with the speed slider at 0 not at all; raises JointOverspeed."""
        if dt == 0:
            self.halt()
            return
        speed = (q - self.q) / dt
        if float(np.max(np.abs(speed))) > JOINT_SPEED_LIMIT:
            raise JointOverspeed(f"joint speed {np.max(np.abs(speed)):.2f} rad/s above {JOINT_SPEED_LIMIT:.2f} rad/s")
        self.q, self.qd = q, speed

    def halt(self) -> None:
        """Stand still at once."""
        self.qd = np.zeros(6)


class Profile:
    """Distance travelled over time: accelerate, cruise, decelerate (trapezoid, or triangle when short)."""

    def __init__(self, distance: float, speed: float, acceleration: float) -> None:
        self.distance, self.acceleration = distance, acceleration
        self.ramp = speed / acceleration
        self.speed = speed
        if speed * self.ramp > distance:
            self.ramp = math.sqrt(distance / acceleration)
            self.speed = acceleration * self.ramp
        self.duration = distance / self.speed + self.ramp if distance > 0 else 0.0

    def fraction(self, t: float) -> float:
        """Share of the distance done at time t (s), 0..1."""
        if t >= self.duration:
            return 1.0
        rest = self.duration - t
        if t < self.ramp:
            travelled = self.acceleration * t * t / 2
        elif rest < self.ramp:
            travelled = self.distance - self.acceleration * rest * rest / 2
        else:
            travelled = self.speed * (t - self.ramp / 2)
        return travelled / self.distance


class Motion:
    """Something the arm is busy with."""

    def step(self, dt: float) -> bool:
        """Advance by dt (s of rig time); True while there is more to do."""
        raise NotImplementedError


class JointMove(Motion):
    """movej: all joints start and end together; speed (rad/s), acceleration (rad/s^2) of the one that goes farthest."""

    def __init__(self, arm: ArmMotion, goal: Sequence[float] | Array, speed: float, acceleration: float) -> None:
        self.arm, self.start = arm, arm.q.copy()
        self.way = np.asarray(goal, float) - self.start
        self.profile = Profile(float(np.max(np.abs(self.way))), speed, acceleration)
        self.t = 0.0

    def step(self, dt: float) -> bool:
        if self.t >= self.profile.duration:
            self.arm.halt()
            return False
        self.t += dt
        self.arm.place(self.start + self.profile.fraction(self.t) * self.way, dt)
        return True


class LinearMove(Motion):
    """movel: the TCP runs straight to a pose, turning evenly; speed m/s, acceleration m/s^2."""

    def __init__(self, arm: ArmMotion, goal: Sequence[float] | Array, speed: float, acceleration: float) -> None:
        self.arm, self.start = arm, arm.pose()
        target = pose_matrix(goal)
        self.way = target[:3, 3] - self.start[:3, 3]
        self.turn = rotation_vector(self.start[:3, :3].T @ target[:3, :3])
        # m per rad: how much of the tool speed a rotation takes in a straight motion
        distance = max(float(np.linalg.norm(self.way)), 0.1 * float(np.linalg.norm(self.turn)))
        self.profile = Profile(distance, speed, acceleration)
        self.t = 0.0
        self._check_path(distance)

    def _check_path(self, distance: float) -> None:
        """Raises ProgramError when a point of the way is out of reach."""
        steps = min(40, max(4, math.ceil(distance / 0.02)))
        q: Array | None = self.arm.q
        for i in range(1, steps + 1):
            q = self.arm.solve(self._pose(i / steps), q)
            if q is None:
                goal = ", ".join(f"{x:.3f}" for x in self._pose(1.0)[:3, 3])
                raise ProgramError(f"movel: no inverse kinematics solution on the way to ({goal}) m")

    def _pose(self, fraction: float) -> Array:
        pose = np.eye(4)
        pose[:3, :3] = self.start[:3, :3] @ rotation_matrix(fraction * self.turn)
        pose[:3, 3] = self.start[:3, 3] + fraction * self.way
        return pose

    def step(self, dt: float) -> bool:
        if self.t >= self.profile.duration:
            self.arm.halt()
            return False
        self.t += dt
        q = self.arm.solve(self._pose(self.profile.fraction(self.t)))
        if q is None:
            raise ProgramError("movel: no inverse kinematics solution")
        self.arm.place(q, dt)
        return True


class Deceleration(Motion):
    """stopj and stopl: all joint speeds fall evenly to zero within `duration` (s)."""

    def __init__(self, arm: ArmMotion, duration: float) -> None:
        self.arm, self.duration, self.t = arm, duration, 0.0
        self.q, self.qd = arm.q.copy(), arm.qd.copy()

    def step(self, dt: float) -> bool:
        if self.t >= self.duration:
            self.arm.halt()
            return False
        self.t = min(self.t + dt, self.duration)
        self.arm.q = self.q + self.qd * (self.t - self.t**2 / (2 * self.duration))
        self.arm.qd = self.qd * (1 - self.t / self.duration)
        return True


def stop_joints(arm: ArmMotion, deceleration: float) -> Deceleration:
    """stopj with a deceleration in rad/s^2."""
    return Deceleration(arm, float(np.max(np.abs(arm.qd))) / deceleration)


def stop_linear(arm: ArmMotion, deceleration: float) -> Deceleration:
    """stopl with a deceleration of the TCP in m/s^2."""
    return Deceleration(arm, float(np.linalg.norm(arm.tcp_speed()[:3])) / deceleration)
