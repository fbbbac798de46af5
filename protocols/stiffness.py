"""Stiffness trial: the arm pushes the tip of a cantilever step by step and the sensor tells the force.

For each length: un-jam, grow, jam, zero the sensor, approach until contact, step the deflection, read force, retreat.
The slope of force over deflection gives Young's modulus: eq. 9 for the spine, eq. 8 with its own second moment for the body.
The defaults are the paper's spine lengths, 5..30 cm by 5 cm.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
from pydantic import Field

from drivers.errors import StaleReading
from drivers.frames import rotation_from_vector, vector_from_rotation
from recordings.states.rules import Probe, Window
from recordings.trials import TrialRow

from .actions import home, set_spine, vent
from .bench import Bench, Setup, StandFrame
from .errors import NotReached, ProtocolError, TooMuchForce
from .experiment import Ask, Plan, Push, Reading, Step, Trial, Trials, with_probe
from .parameters import Jam, Parameters, SpineLength, SpineMotion, Vacuum
from .suspension import through_pauses

TOPICS = ("/force", "/arm", "/spine", "/vacuum")


class Stiffness(Parameters):
    """Parameters of stiffness trials."""

    specimen: Literal["spine", "body"] = "spine"
    lengths: list[SpineLength] = Field(
        [0.05, 0.10, 0.15, 0.20, 0.25, 0.30], min_length=1, max_length=200, json_schema_extra={"unit": "m"}
    )
    """Spine lengths; with the body as specimen, the spine inside it (0 for the bare body)."""
    body_length: float = Field(0.40, gt=0, le=1, json_schema_extra={"unit": "m"})
    """Where the body is pushed: at its tip."""
    repeats: int = Field(1, ge=1, le=100)
    steps: int = Field(8, ge=3, le=100)
    """Deflections read, evenly spaced."""
    deflection_ratio: float = Field(0.02, gt=0, le=0.1, json_schema_extra={"unit": ""})
    """Largest deflection over the cantilever's length; eq. 8 holds for small ones."""
    max_force: float = Field(25.0, gt=0, le=100, json_schema_extra={"unit": "N"})
    """A trial ends early here."""
    contact_force: float = Field(0.3, gt=0, le=10, json_schema_extra={"unit": "N"})
    """Contact counts as made above this."""
    approach_step: float = Field(1e-3, gt=0, le=5e-3, json_schema_extra={"unit": "m"})
    clearance: float = Field(5e-3, gt=0, le=0.1, json_schema_extra={"unit": "m"})
    """The approach in steps begins so far from where the specimen is expected."""
    specimen_radius: float | None = Field(None, gt=0, le=0.2, json_schema_extra={"unit": "m"})
    """Distance from the specimen's axis to its surface; None: 29 mm for the spine, 50 mm for the body."""
    speed: float = Field(0.05, gt=0, le=0.25, json_schema_extra={"unit": "m/s"})
    """Free moves."""
    push_speed: float = Field(5e-3, gt=0, le=0.05, json_schema_extra={"unit": "m/s"})
    """Moves near and in contact."""
    acceleration: float = Field(0.3, gt=0, le=2, json_schema_extra={"unit": "m/s^2"})
    dwell: float = Field(0.5, ge=0, le=60, json_schema_extra={"unit": "s"})
    """Wait at each deflection before it is read."""
    average: float = Field(1.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    min_samples: int = Field(50, ge=1, le=10_000)
    """Force samples a reading holds at least; a sensor that sends slowly is averaged longer."""
    zero_samples: int = Field(100, ge=1, le=10_000)
    vacuum: Vacuum = Field(80e3, json_schema_extra={"unit": "Pa"})
    spine: SpineMotion = SpineMotion()
    jam: Jam = Jam()

    @property
    def radius(self) -> float:
        """Distance from the specimen's axis to its surface, m."""
        return self.specimen_radius or (0.029 if self.specimen == "spine" else 0.05)

    def cantilever(self, spine: float) -> float:
        """Length from the clamp to where it is pushed, m."""
        return spine if self.specimen == "spine" else self.body_length

    @property
    def first_place(self) -> float:
        """How far along the specimen the probe waits while it is grown, m from the clamp."""
        return 0.1 if self.specimen == "spine" else self.body_length


PARAMETERS = Stiffness


NEEDS = ("spine", "valve", "gauge", "force", "arm")


def plan(p: Stiffness) -> Plan:
    """What will be done, how long it takes, and the largest values it asks for."""
    steps: list[Step] = []
    before = 0.0
    for repeat, spine in itertools.product(range(1, p.repeats + 1), p.lengths):
        label = f"{p.specimen} {spine * 100:g} cm, repeat {repeat}"
        grow, approach, deflect = _asks(p, spine)
        if not steps:
            grow = replace(grow, setup=_setup(p))
        reads = (Reading("load", p.dwell + p.average / 2, 0.0, repeat),)
        steps.append(
            Step(f"release, grow, jam: {label}", 8.0 + abs(spine - before) / p.spine.speed + p.spine.settle, grow)
        )
        steps.append(Step(f"zero and approach: {label}", 15.0, approach))
        steps += [
            Step(f"deflection {i}: {label}", p.dwell + p.average + 0.5, deflect(i), reads)
            for i in range(1, p.steps + 1)
        ]
        before = spine
    limits = {
        "force_n": p.max_force, "arm_speed_m_s": p.speed, "spine_length_m": max(p.lengths),
        "deflection_m": max(p.deflection_ratio * p.cantilever(x) for x in p.lengths), "vacuum_pa": p.vacuum,
    }  # fmt: skip
    return Plan("stiffness", steps, limits)


def _setup(p: Stiffness) -> Setup:
    """What a person prepares."""
    return Setup(p.specimen, 0.0, 0.0, p.vacuum)


def _asks(p: Stiffness, spine: float) -> tuple[Ask, Ask, Callable[[int], Ask]]:
    """What growing, approaching and each deflection ask of the rig at one spine length, m."""
    length = p.cantilever(spine)
    free = Ask(arm_speed=p.speed, arm_acceleration=p.acceleration)
    grow = replace(free, spine_length=spine, spine_speed=p.spine.speed, vacuum=p.vacuum, probe=((p.first_place, None),))
    nearest, farthest = -p.radius - p.clearance, p.radius + p.approach_step
    approach = replace(free, probe=((length, None), (length, nearest), (length, farthest)))

    def deflect(i: int) -> Ask:
        way = p.deflection_ratio * length * i / p.steps
        push = Push(p.specimen, spine, length, way, p.max_force)
        return replace(free, arm_speed=p.push_speed, probe=((length, way - p.radius),), push=push)

    return grow, approach, deflect


def run(bench: Bench, p: Stiffness, trials: Trials) -> None:
    """Do all trials. Raises ProtocolError; the caller lands the rig safe whatever happens."""
    stand = bench.need(bench.stand, "stand")
    bench.operator.prepare(_setup(p))
    if bench.pressure is not None:
        vent(bench)
    probe = ProbeMotion(bench, p, stand)
    home(bench)
    for repeat, spine in trials.remaining(itertools.product(range(1, p.repeats + 1), p.lengths), 2 + p.steps):
        bench.check_stop()
        bench.say(f"Repeat {repeat} of {p.repeats}: {p.specimen} with the spine at {spine * 100:g} cm")
        ambient = through_pauses(bench, partial(_grow, bench, p, probe, spine))
        trials.step_done()
        trial = trials.begin(repeat=repeat, spine=spine, ambient=ambient, specimen=p.specimen)
        with trials.doing(trial):
            try:
                _push(bench, p, trial, trials, probe, p.cantilever(spine))
            except ProtocolError:
                with contextlib.suppress(Exception):  # what ended the trial is told, not what came of the retreat
                    probe.retreat()
                raise
            probe.retreat()


def _grow(bench: Bench, p: Stiffness, probe: ProbeMotion, spine: float) -> float:
    """The next specimen, with the probe out of its way; returns ambient pressure, Pa absolute."""
    probe.go(p.first_place, -probe.stand.standoff, p.speed)
    return set_spine(bench, spine, p.vacuum, p.spine, p.jam)


class ProbeMotion:
    """Moves the probe in the stand's frame: `along` the specimen from the clamp, `depth` along the push from its axis, m."""

    def __init__(self, bench: Bench, p: Stiffness, stand: StandFrame) -> None:
        self.bench, self.p = bench, p
        self.arm = bench.need(bench.arm, "arm")
        self.state = bench.need(bench.arm_state, "arm")
        self.force = bench.need(bench.force, "force")
        self.stand = stand
        self.along = 0.0
        self.zero: tuple[float, ...] | None = None

    def go(self, along: float, depth: float, speed: float) -> None:
        """Move there and wait until the arm has come to rest.

        On the way in, once the sensor has its zero, the arm stops where the force passes the limit: TooMuchForce.
        """
        inwards = self.zero is not None and depth > -self.stand.standoff
        s = self.stand
        point = [o + along * a + depth * d for o, a, d in zip(s.origin, s.axis, s.push, strict=True)]
        goal = [*point, *s.tool_rotation]
        for pose in waypoints(self.state.latest().tcp_pose, goal):
            self.arm.move_to(pose, speed, self.p.acceleration)
            self.bench.wait("arm: at its target", partial(self._arrived, inwards), 120.0)
        self.along = along

    def _arrived(self, inwards: bool) -> bool | None:
        force = 0.0
        # without a fresh sample the arm waits by itself; when that lasts, `moving` or the watch ends the run
        with contextlib.suppress(StaleReading):
            sample = self.force.latest()
            if sample.zero == self.zero:  # else taken before the zero was set
                force = math.hypot(*sample.wrench[:3])
        if inwards and force > self.p.max_force:
            self.arm.stop()
            raise TooMuchForce(f"force: {force:.1f} N exceeded max_force {self.p.max_force:g} N; the arm was stopped")
        return None if self.arm.moving() else True

    def come_back(self, along: float, depth: float) -> None:
        """After a pause: away from the specimen, then to where it is nearly touched."""
        self.retreat()
        self.go(along, depth, self.p.speed)

    def retreat(self) -> None:
        """Away from the specimen, straight back."""
        self.go(self.along, -self.stand.standoff, self.p.speed)

    def pushing(self, samples: int = 5) -> float:
        """Force on the specimen along the push, N: the mean of the next force samples, in the arm's base frame."""
        since = self.bench.clock.now()

        def mean() -> float | None:
            newer = self.bench.recorder.buffers.window("/force", since, float("inf"))
            if len(newer) < samples:
                return None
            force = (newer["raw"] - newer["zero"])[:, :3].mean(axis=0)
            rotation = rotation_from_vector(self.state.latest().tcp_pose[3:])
            return -float(np.dot(rotation @ force, self.stand.push))

        return self.bench.wait(f"force: {samples} samples", mean, 30.0 + samples / 10)

    def approach(self, along: float) -> tuple[float, float]:
        """From the standoff in small steps until contact; returns the depth (m) of first contact and the force (N) there."""
        p = self.p
        self.go(along, -self.stand.standoff, p.speed)
        self.zero = self.force.zero(p.zero_samples)
        depth = -p.radius - p.clearance
        self.go(along, depth, p.speed)
        while self.pushing() < p.contact_force:
            if depth > p.radius:
                raise NotReached(
                    f"force: no contact above {p.contact_force:g} N up to {depth * 1e3:.0f} mm past the specimen's axis; "
                    "check the stand in rig.yaml and that the specimen is mounted"
                )
            depth += p.approach_step
            self.go(along, depth, p.push_speed)
        return depth, self.pushing(p.min_samples)


MIN_POSES = 3
"""Poses of the arm that a reading averages at least."""
LONGEST_MOVE, LARGEST_TURN = 0.25, 0.6
"""m and rad; a longer way is made in equal parts."""


def waypoints(start: Sequence[float], goal: Sequence[float]) -> list[list[float]]:
    """Poses (m, rotation vector rad) from start to goal in parts short enough for the arm's limits; the last is goal."""
    first = rotation_from_vector(start[3:])
    turn = vector_from_rotation(rotation_from_vector(goal[3:]) @ first.T)
    way = np.subtract(goal[:3], start[:3])
    parts = max(1, math.ceil(np.linalg.norm(way) / LONGEST_MOVE), math.ceil(np.linalg.norm(turn) / LARGEST_TURN))
    shares = [i / parts for i in range(1, parts)]
    between = [
        [*(start[:3] + way * x), *vector_from_rotation(rotation_from_vector((turn * x).tolist()) @ first)]
        for x in shares
    ]
    return [*between, list(goal)]


def _push(bench: Bench, p: Stiffness, trial: Trial, trials: Trials, probe: ProbeMotion, length: float) -> None:
    """Approach, then step the deflection and read force at each."""
    contact, touching = through_pauses(bench, partial(probe.approach, length))
    trials.step_done()
    tcp = probe.state.latest().tcp_pose
    # Deflection counts from here, so force does: how far the last step went past the first touch is in both.
    origin = Probe(direction=probe.stand.push, origin=(tcp[0], tcp[1], tcp[2]), force_offset=touching)
    trial = with_probe(trial, origin)
    average = max(p.average, p.min_samples / _sample_rate(bench), (MIN_POSES + 1) * _longest_gap(bench))
    for i in range(1, p.steps + 1):
        depth = contact + p.deflection_ratio * length * i / p.steps

        def deflect(depth: float = depth) -> TrialRow:
            probe.go(length, depth, p.push_speed)
            at_rest = bench.clock.now()
            return trials.read(
                trial, Window(p.dwell, average, MIN_POSES), branch="load", t_start=at_rest, ramp_end=at_rest, rate=0.0,
                targets=(), topics=TOPICS, wait=p.dwell + average + 20.0, repeatable=True,
            )  # fmt: skip

        try:
            row = through_pauses(bench, deflect, partial(probe.come_back, length, contact - p.clearance))
        except TooMuchForce as e:
            bench.say(f"{e}: no further deflection at this length")
            return
        trials.step_done()
        force = touching + (row.force or 0.0)
        if force > p.max_force:
            bench.say(f"Force {force:.1f} N is above {p.max_force:g} N: no further deflection at this length")
            return


def _longest_gap(bench: Bench) -> float:
    """s of rig time between two poses of the arm, the longest of the last five seconds; 0 where there are none yet."""
    now = bench.clock.now()
    at = [*bench.recorder.buffers.window("/arm", now - 5.0, now)["t"], now]
    return float(max((b - a for a, b in itertools.pairwise(at)), default=0.0))


def _sample_rate(bench: Bench) -> float:
    """Force samples a second of rig time, over the last two seconds."""
    now = bench.clock.now()
    return max(1.0, len(bench.recorder.buffers.window("/force", now - 2.0, now)) / 2.0)
