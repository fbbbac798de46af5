"""The arm's accuracy: it visits poses with a rigid body on its flange, which the cameras see, and stands still at each.

`mocap.body` names that body; the stand is empty.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from drivers.errors import WrongDevice
from drivers.frames import alignment, rotation_from_vector, vector_from_rotation
from drivers.interfaces import Vector3, Vector6
from recordings.states.rules import Window
from recordings.states.settling import tracked
from recordings.trials import TrialRow

from .actions import vent
from .bench import Bench, Setup
from .errors import NotReached
from .experiment import Ask, Plan, Reading, Step, Trial, Trials
from .parameters import Parameters, RobotFacts
from .probe import go_to
from .suspension import through_pauses
from .visits import Branch

FEWEST = 8
"""Poses from which it shows whether a body moves with the flange: ten numbers are fitted to three of each."""
MOST_DRAWS = 20_000
LEAST_SEEN = 5
"""Samples from which a body is judged to stand still."""
STILL, WITHIN = 0.5e-3, 20.0
"""m, largest standard deviation of a body that stands still: several times the cameras' noise; s for coming to rest."""
FARTHEST = 0.01
"""m; an arm whose flange is farther from where its controller says than this is no arm to work with."""
MOST_SPIN = 1.2
"""rad about the tool's axis from the middle orientation: cables follow."""


class ArmAccuracy(Parameters):
    """Parameters of poses of the arm. Lengths in its base frame; places are those of the TCP."""

    poses: int = Field(40, ge=FEWEST, le=1000)
    """Different poses."""
    passes: int = Field(2, ge=1, le=20)
    """Times that they are visited, forwards and backwards by turns."""
    seed: int = Field(0, ge=0)
    """Of the poses."""
    box: list[Vector3] = Field(
        [(-0.75, -0.75, 0.02), (0.75, 0.75, 0.90)], min_length=2, max_length=2, json_schema_extra={"unit": "m"}
    )
    """Corners of the box that contains all poses; by default the arm's workspace."""
    margin: float = Field(0.1, ge=0, le=0.5, json_schema_extra={"unit": "m"})
    """Distance from its faces, for flange, tool and body."""
    nearest: float = Field(0.3, gt=0.1, le=1, json_schema_extra={"unit": "m"})
    """Smallest distance from the axis of the base, also on the way."""
    reach: float = Field(0.7, gt=0.2, le=2, json_schema_extra={"unit": "m"})
    """Largest distance from the centre of its base."""
    azimuth_deg: float = Field(0.0, ge=-360, le=360, json_schema_extra={"unit": "deg"})
    """Middle of the sector of all poses; by default the stand's azimuth."""
    sector_deg: float = Field(120.0, gt=0, le=300, json_schema_extra={"unit": "deg"})
    """Width of the sector."""
    tool_rotation: Vector3 = Field((2.22144, -2.22144, 0.0), json_schema_extra={"unit": "rad"})
    """Rotation vector of the TCP in the middle of the sector; by default it points down."""
    max_tilt: float = Field(0.4, ge=0, le=1.5, json_schema_extra={"unit": "rad"})
    """Largest tilt from there."""
    keep_out: list[Vector3] = Field([], max_length=2, json_schema_extra={"unit": "m"})
    """Ends of a line to be avoided; by default the axis of the stand's specimen."""
    keep_out_radius: float = Field(0.08, ge=0, le=1, json_schema_extra={"unit": "m"})
    """Smallest distance from it; by default `stand.standoff`."""
    speed: float = Field(0.1, gt=0, le=0.5, json_schema_extra={"unit": "m/s"})
    """Of every move."""
    acceleration: float = Field(0.3, gt=0, le=2, json_schema_extra={"unit": "m/s^2"})
    """Of every move."""
    average: float = Field(1.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Rest before a reading, and its average."""

    @classmethod
    def defaults_for(cls, robot: RobotFacts) -> dict[str, Any]:
        """Workspace of the arm and place of the stand."""
        return dict(robot.arm)

    @model_validator(mode="after")
    def _has_room(self) -> ArmAccuracy:
        if len(self.drawn) < self.poses:
            raise ValueError(
                f"poses: only {len(self.drawn)} of {self.poses} poses have a free way in {MOST_DRAWS} draws; widen box, "
                "reach or sector_deg, or reduce margin, nearest or keep_out_radius"
            )
        return self

    @cached_property
    def drawn(self) -> list[Vector6]:
        """Poses of the TCP, each with a free straight way from the one before it; fewer than `poses` where there is no room."""
        rng, poses, tool = np.random.default_rng(self.seed), list[Vector6](), rotation_from_vector(self.tool_rotation)
        low, high = np.add(self.box[0], self.margin), np.subtract(self.box[1], self.margin)
        for _ in range(MOST_DRAWS if (low < high).all() else 0):
            place = rng.uniform(low, high)
            azimuth = math.remainder(math.atan2(place[1], place[0]) - math.radians(self.azimuth_deg), math.tau)
            tilt, direction, spin = rng.uniform([0.0, -math.pi, -MOST_SPIN], [self.max_tilt, math.pi, MOST_SPIN])
            if abs(azimuth) > math.radians(self.sector_deg) / 2 or self.room(poses[-1][:3] if poses else place, place).min() < 0:
                continue
            tilted = rotation_from_vector([tilt * math.cos(direction), tilt * math.sin(direction), 0.0])
            turn = rotation_from_vector([0.0, 0.0, azimuth]) @ tool @ tilted @ rotation_from_vector([0.0, 0.0, spin])
            poses.append((*place.tolist(), *vector_from_rotation(turn).tolist()))
            if len(poses) == self.poses:
                break
        return poses

    def room(self, a: Any, b: ArrayLike) -> NDArray[np.float64]:
        """Room (100,) m that base, `reach` and `keep_out` leave along the straight way between two places; below 0: none."""
        way = np.linspace(np.asarray(a, float), np.asarray(b, float), 100)
        room = np.minimum(np.hypot(way[:, 0], way[:, 1]) - self.nearest, self.reach - np.linalg.norm(way, axis=1))
        return np.minimum(room, distance(way, self.keep_out) - self.keep_out_radius) if self.keep_out else room

    def way(self, here: ArrayLike, index: int) -> list[Vector6]:
        """Poses on a free way from a place (m) to a pose: straight, or by the nearest in their order; none where there is no way.
        One that begins without room must not get less."""
        for first in sorted(range(self.poses), key=lambda k: abs(k - index)):
            room = self.room(here, self.drawn[first][:3])
            if (room >= min(0.0, room[0])).all():
                return self.drawn[first : index + 1] if first <= index else self.drawn[index : first + 1][::-1]
        return []


def distance(places: NDArray[np.float64], line: Sequence[Vector3]) -> NDArray[np.float64]:
    """Distance (n,) of places (n, 3) from the line between two points, m."""
    start, along = np.array(line[0]), np.subtract(line[-1], line[0])
    share = np.clip((places - start) @ along / max(along @ along, 1e-12), 0.0, 1.0)
    return np.asarray(np.linalg.norm(places - start - share[:, None] * along, axis=1))


PARAMETERS = ArmAccuracy
NEEDS = ("arm", "force", "mocap")
SETUP = Setup("robot", 0.0, 0.0, 0.0)


def _visits(p: ArmAccuracy) -> list[tuple[int, int]]:
    """Pass, and index of the pose, of each visit; a pass begins where the one before has ended."""
    orders = [range(p.poses)[:: 1 if k % 2 else -1][k > 1 :] for k in range(1, p.passes + 1)]
    return [(k, index) for k, order in enumerate(orders, 1) for index in order]


def plan(p: ArmAccuracy) -> Plan:
    """What will be done, how long it takes, and the largest values it asks for."""
    steps, previous = list[Step](), p.drawn[0]
    for k, (number, index) in enumerate(_visits(p), 1):
        pose = p.drawn[index]
        ask = Ask(spine_length=0.0, poses=(previous, pose), arm_speed=p.speed, arm_acceleration=p.acceleration)
        seconds = math.dist(previous[:3], pose[:3]) / p.speed + p.speed / p.acceleration + 2.5 * p.average
        reads = (Reading(_branch(number), 1.5 * p.average, 0.0, number),)
        steps.append(Step(f"pose {k}, repeat {number}", seconds, ask, reads))
        previous = pose
    return Plan("arm_accuracy", steps, {"arm_speed_m_s": p.speed})


def _branch(number: int) -> Branch:
    """Forwards or backwards, so that each pose is approached from two sides."""
    return "load" if number % 2 else "unload"


def run(bench: Bench, p: ArmAccuracy, trials: Trials) -> None:
    """Visit all poses. Raises ProtocolError, and WrongDevice for a body that does not move with the flange."""
    bench.operator.prepare(SETUP)
    bench.bodies = None  # the body of the tip is on the arm
    if bench.pressure is not None:
        vent(bench)
    flange, seen = list[Vector6](), list[Vector3]()
    for number, index in trials.remaining(_visits(p), 1):
        bench.check_stop()
        trial = trials.begin(repeat=number)
        with trials.doing(trial):
            row = through_pauses(bench, partial(_visit, bench, p, trials, trial, index))
            if row.tip is not None:
                flange.append(bench.need(bench.arm_state, "arm").latest().tcp_pose)
                seen.append(row.tip)
                _demand_flange(np.array(flange), np.array(seen))
        trials.step_done()


def _visit(bench: Bench, p: ArmAccuracy, trials: Trials, trial: Trial, index: int) -> TrialRow:
    """Go to a pose on a free way, wait until arm and body stand still, and read the state."""
    here = bench.need(bench.arm_state, "arm").latest().tcp_pose[:3]
    if not (way := p.way(here, index)):
        raise NotReached(
            f"arm: no straight way from ({', '.join(f'{x * 1e3:.0f}' for x in here)}) mm to a pose is free (nearest, reach, "
            "keep_out); move the arm at the pendant, to the middle of the sector"
        )
    for pose in way:
        go_to(bench, pose, p.speed, p.acceleration)
    arrived = bench.clock.now()

    def rest() -> tuple[float, float]:
        """Time (s) of the last samples, at least `LEAST_SEEN`, and largest standard deviation (m) of the body's place in it."""
        seen = tracked(bench.recorder.buffers.window("/tip", arrived, math.inf))
        recent = seen[min(seen["t"].searchsorted(seen["t"][-1:].sum() - p.average), max(0, len(seen) - LEAST_SEEN)) :]
        if len(recent) in (len(seen), 0):
            return 0.0, math.inf
        return float(np.ptp(recent["t"])), float(recent["position"].std(axis=0).max())

    bench.wait(
        "mocap: the body on the flange stands still",
        lambda: True if rest()[1] <= STILL else None,
        WITHIN + p.average,
        lambda: f"its place has a standard deviation of {rest()[1] * 1e3:.2f} mm, limit {STILL * 1e3:g} mm; fasten it",
    )
    at_rest, average = bench.clock.now(), 1.5 * max(p.average, rest()[0])
    return trials.read(
        trial, Window(0.0, average, LEAST_SEEN), branch=_branch(trial.repeat), t_start=at_rest, ramp_end=at_rest, rate=0.0,
        targets=(), topics=("/arm", "/tip"), wait=average + 20.0, repeatable=True,
    )  # fmt: skip


def _demand_flange(flange: NDArray[np.float64], seen: NDArray[np.float64]) -> None:
    """Raise WrongDevice where the places seen (n, 3), m, are not those of a point fixed on the flange, of poses (n, 6)."""
    if len(flange) < FEWEST:
        return
    worst = float(np.linalg.norm(alignment(flange, seen).residuals, axis=1).max())
    if worst > FARTHEST:
        raise WrongDevice(
            "mocap",
            f"its body is {worst * 1e3:.1f} mm from where the flange has brought it, limit {FARTHEST * 1e3:g} mm; "
            "name the body on the flange in mocap.body, and fasten it",
        )
