"""The arm's probe at the stiffness stand: it moves about the specimen, finds it, and feels what it pushes back with."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from pydantic import Field

from drivers.errors import DeviceFault, StaleReading
from drivers.frames import rotation_from_vector, vector_from_rotation
from recordings.states.zeros import Span, Unloaded, unloaded

from .bench import Bench, StandFrame
from .errors import NotReached, Suspended, TooMuchForce
from .parameters import Parameters

HELD_SAMPLES = 20
"""Force samples that each reading holds by which the probe feels whether the specimen pushes back: 0.02 N of a noise of 0.1 N."""
LONGEST_MOVE, LARGEST_TURN = 0.25, 0.6
"""m and rad; a longer way is made in equal parts."""


class Probing(Parameters):
    """Parameters of the probe's motions and of the force sensor."""

    max_force: float = Field(25.0, gt=0, le=100, json_schema_extra={"unit": "N"})
    """Force at which a trial ends early."""
    contact_force: float = Field(0.3, gt=0, le=10, json_schema_extra={"unit": "N"})
    """Force of contact."""
    approach_step: float = Field(1e-3, gt=0, le=5e-3, json_schema_extra={"unit": "m"})
    """Step of the approach."""
    clearance: float = Field(5e-3, gt=0, le=0.1, json_schema_extra={"unit": "m"})
    """Distance from the expected surface at which the approach in steps begins."""
    speed: float = Field(0.05, gt=0, le=0.25, json_schema_extra={"unit": "m/s"})
    """Away from the specimen."""
    push_speed: float = Field(5e-3, gt=0, le=0.05, json_schema_extra={"unit": "m/s"})
    """Near the specimen and in contact."""
    acceleration: float = Field(0.3, gt=0, le=2, json_schema_extra={"unit": "m/s^2"})
    """Of every move."""
    min_samples: int = Field(50, ge=1, le=10_000)
    """Fewest force samples in a reading."""
    zero_samples: int = Field(100, ge=1, le=10_000)
    """Force samples whose mean without load is the zero."""


@dataclass(frozen=True)
class ZeroReading:
    """The unloaded force sensor: when it was read, and what it showed along the push."""

    span: Span
    read: Unloaded


@dataclass(frozen=True)
class Contact:
    """Where the probe first touches the specimen, and how."""

    depth: float
    """m, in the stand's frame."""
    force: float
    """N with which the specimen pushes back there."""
    offset: float
    """N that the sensor shows there, from which forces count."""
    at: float
    """When that was read, rig time s."""
    zero: ZeroReading
    """Of the sensor before the approach."""


class ProbeMotion:
    """Moves the probe in the stand's frame: `along` the specimen from the clamp, `depth` along the push from its axis, m."""

    def __init__(self, bench: Bench, p: Probing, stand: StandFrame, radius: float) -> None:
        """`radius`: m from the specimen's axis to its surface."""
        self.bench, self.p, self.radius = bench, p, radius
        self.arm = bench.need(bench.arm, "arm")
        self.state = bench.need(bench.arm_state, "arm")
        self.force = bench.need(bench.force, "force")
        self.stand = stand
        self.along = 0.0
        self.zero: tuple[float, ...] | None = None
        self.before: ZeroReading
        """Of the sensor before the specimen was jammed."""

    @property
    def near(self) -> float:
        """Depth at which the approach in steps begins: surely off the specimen."""
        return -self.radius - self.p.clearance

    def go(self, along: float, depth: float, speed: float) -> None:
        """Move there and wait until the arm has come to rest.

        On the way in, once the sensor has its zero, the arm stops where the force passes the limit: TooMuchForce.
        """
        inwards = self.zero is not None and depth > -self.stand.standoff
        s = self.stand
        point = [o + along * a + depth * d for o, a, d in zip(s.origin, s.axis, s.push, strict=True)]
        goal = [*point, *s.tool_rotation]
        go_to(self.bench, goal, speed, self.p.acceleration, partial(self._watch_force, inwards))
        self.along = along

    def _watch_force(self, inwards: bool) -> None:
        force = 0.0
        # without a fresh sample the arm waits by itself; when that lasts, `moving` or the watch ends the run
        with contextlib.suppress(StaleReading):
            sample = self.force.latest()
            if sample.zero == self.zero:  # else taken before the zero was set
                force = math.hypot(*sample.wrench[:3])
        if inwards and force > self.p.max_force:
            self.arm.stop()
            raise TooMuchForce(f"force: {force:.1f} N exceeded max_force {self.p.max_force:g} N; the arm was stopped")

    def retreat(self) -> None:
        """Away from the specimen, straight back."""
        self.go(self.along, -self.stand.standoff, self.p.speed)

    def pushing(self, samples: int = 5) -> float:
        """Force on the specimen along the push, N, from the sensor's zero: the mean of the next force samples."""
        return self._sensed(samples)[1]

    def _sensed(self, samples: int) -> tuple[float, float]:
        """The mean time (s) of the next force samples, and the force on the specimen along the push, N."""
        since = self.bench.clock.now()

        def mean() -> tuple[float, float] | None:
            newer = self.bench.recorder.buffers.window("/force", since, float("inf"))
            if len(newer) < samples:
                return None
            force = (newer["raw"] - newer["zero"])[:, :3].mean(axis=0)
            rotation = rotation_from_vector(self.state.latest().tcp_pose[3:])
            return float(newer["t"].mean()), -float(np.dot(rotation @ force, self.stand.push))

        return self.bench.wait(f"force: {samples} samples", mean, 30.0 + samples / 10)

    def read_unloaded(self, since: float | None = None) -> ZeroReading:
        """Read the sensor where the probe touches nothing, from now or from rig time `since` (s) on."""
        buffers, begin = self.bench.recorder.buffers, self.bench.clock.now() if since is None else since
        samples = max(self.p.zero_samples, 10)

        def complete() -> float | None:  # rig time of the last sample that is needed
            force, arm = (buffers.window(topic, begin, math.inf)["t"] for topic in ("/force", "/arm"))
            return max(float(force[samples - 1]), float(arm[0])) if len(force) >= samples and len(arm) else None

        span = begin, self.bench.wait(f"force and arm: {samples} samples", complete, 30.0 + samples / 10)
        read = self.bench.wait("force and arm: the sample after those", lambda: unloaded(buffers, self.stand.push, span), 30.0)
        return ZeroReading(span, read)

    def approach(self, along: float) -> Contact:
        """From the standoff in small steps until the specimen pushes back.

        Raises NotReached when it is not there, Suspended when it is a jammed one and does not push back.
        """
        p = self.p
        self.go(along, -self.stand.standoff, p.speed)
        since = self.bench.clock.now()
        self.zero = self.force.zero(p.zero_samples)
        zero = self.read_unloaded(since)
        depth = self.near
        self.go(along, depth, p.speed)
        free = 0.0  # N that the sensor shows in the air: it may drift
        while True:
            force = self.pushing()
            free = min(free, force)
            if force - free >= p.contact_force:
                resistance = self.resistance(along, depth)
                # half of the contact force must go away with the probe; else the sensor has drifted and nothing was touched
                if resistance >= 0.5 * p.contact_force:
                    break
                free = force
            if depth > self.radius:
                self._give_up(depth)
            depth += p.approach_step
            self.go(along, depth, p.push_speed)
        touched_at, offset = self._sensed(p.min_samples)
        return Contact(depth, resistance, offset, touched_at, zero)

    def _give_up(self, depth: float) -> None:
        """Nothing was touched up to this depth: away from what may become stiff while a person puts it right, and say so."""
        self.retreat()
        none = (
            f"no contact above {self.p.contact_force:g} N up to {depth * 1e3:.0f} mm past the specimen's axis; "
            "check the stand in rig.yaml and that the specimen is mounted"
        )
        if self.bench.jammed is None:
            raise NotReached(f"force: {none}")
        raise Suspended(DeviceFault("force", f"{none}, and that it is jammed, whatever the gauge shows"))

    def resistance(self, along: float, depth: float) -> float:
        """Force (N) with which the specimen pushes back at this depth: what goes away when the probe does.

        It is read before and after the probe was away, so a constant drift of the sensor is not in it.
        """
        touching = self.pushing(HELD_SAMPLES)
        self.go(along, self.near, self.p.push_speed)
        free = self.pushing(HELD_SAMPLES)
        self.go(along, depth, self.p.push_speed)
        return (touching + self.pushing(HELD_SAMPLES)) / 2 - free


def go_to(
    bench: Bench, goal: Sequence[float], speed: float, acceleration: float, watch: Callable[[], None] = lambda: None
) -> None:
    """Move the arm straight to a pose (m, rotation vector rad) and wait until it is at rest; `watch` is called meanwhile."""
    arm, state = bench.need(bench.arm, "arm"), bench.need(bench.arm_state, "arm")

    def arrived() -> bool | None:
        watch()
        return None if arm.moving() else True

    for pose in waypoints(state.latest().tcp_pose, goal):
        arm.move_to(pose, speed, acceleration)
        bench.wait("arm: at its target", arrived, 120.0)


def waypoints(start: Sequence[float], goal: Sequence[float]) -> list[list[float]]:
    """Poses (m, rotation vector rad) from start to goal in parts within `LONGEST_MOVE` and `LARGEST_TURN`."""
    first = rotation_from_vector(start[3:])
    turn = vector_from_rotation(rotation_from_vector(goal[3:]) @ first.T)
    way = np.subtract(goal[:3], start[:3])
    parts = max(1, math.ceil(np.linalg.norm(way) / LONGEST_MOVE), math.ceil(np.linalg.norm(turn) / LARGEST_TURN))
    shares = [i / parts for i in range(1, parts)]
    between = [[*(start[:3] + way * x), *vector_from_rotation(rotation_from_vector((turn * x).tolist()) @ first)] for x in shares]
    return [*between, list(goal)]
