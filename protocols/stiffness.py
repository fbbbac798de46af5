"""Stiffness trial: the arm pushes the tip of a cantilever step by step and the sensor reads the force.

For each length: un-jam, grow, jam, zero the sensor, approach until contact, step the deflection, read force, retreat.
The slope of force over deflection gives Young's modulus: eq. 9 (spine), eq. 8 (body). The spine lengths are the paper's.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal

from pydantic import Field

from recordings.states.rules import Probe, Window
from recordings.states.zeros import Zeros, drift
from recordings.trials import TrialRow

from .actions import home, keep_jammed, set_spine, vent
from .bench import Bench, Setup
from .errors import NotPushing, ProtocolError, TooMuchForce
from .experiment import Ask, Plan, Push, Reading, Step, Trial, Trials
from .parameters import PREPARING, Jam, SpineLength, SpineMotion, Vacuum
from .probe import Contact, ProbeMotion, Probing
from .suspension import through_jams, through_pauses


class Stiffness(Probing):
    """Parameters of stiffness trials."""

    specimen: Literal["spine", "body"] = "spine"
    """What is pushed: the bare spine, or the robot's body."""
    renamed: ClassVar[Mapping[str, str]] = {"lengths": "spine_lengths"}
    spine_lengths: list[SpineLength] = Field(
        [0.05, 0.10, 0.15, 0.20, 0.25, 0.30], min_length=1, max_length=200, json_schema_extra={"unit": "m"}
    )
    """Lengths of the spine that are pushed, or of the spine inside the body (0: bare body)."""
    body_length: float = Field(0.40, gt=0, le=1, json_schema_extra={"unit": "m"})
    """From the clamp to where the body is pushed."""
    repeats: int = Field(1, ge=1, le=100)
    """How often all lengths are pushed."""
    steps: int = Field(8, ge=3, le=100)
    """Number of deflections, evenly spaced."""
    deflection_ratio: float = Field(0.02, gt=0, le=0.1, json_schema_extra={"unit": ""})
    """Largest deflection as a share of the cantilever's length."""
    specimen_radius: float | None = Field(None, gt=0, le=0.2, json_schema_extra={"unit": "m"})
    """From the specimen's axis to its surface; by default 29 mm (spine), 50 mm (body)."""
    dwell: float = Field(0.5, ge=0, le=60, json_schema_extra={"unit": "s"})
    """Wait before the force is read."""
    average: float = Field(1.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Shortest time of the average."""
    vacuum: Vacuum = Field(80e3, json_schema_extra={"unit": "Pa"})
    """Vacuum that jams the spine, below ambient; 0: not jammed."""
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
APPROACHING, STEPPING = 15.0, 0.5
"""Planned s of zeroing and approaching, and of moving to the next deflection."""


def plan(p: Stiffness) -> Plan:
    """What will be done, how long it takes, and the largest values it asks for."""
    steps: list[Step] = []
    previous = 0.0
    for repeat, spine in itertools.product(range(1, p.repeats + 1), p.spine_lengths):
        label = f"{p.specimen} {spine * 100:g} cm, repeat {repeat}"
        grow, approach, deflect = _asks(p, spine)
        if not steps:
            grow = replace(grow, setup=_setup(p))
        reads = (Reading("load", p.dwell + p.average / 2, 0.0, repeat),)
        growing = abs(spine - previous) / p.spine.speed + p.spine.settle
        steps.append(Step(f"release, grow, jam: {label}", PREPARING + growing, grow))
        steps.append(Step(f"zero and approach: {label}", APPROACHING, approach))
        pushing = STEPPING + p.dwell + p.average
        steps += [Step(f"deflection {i}: {label}", pushing, deflect(i), reads) for i in range(1, p.steps + 1)]
        previous = spine
    limits = {
        "force_n": p.max_force, "arm_speed_m_s": p.speed, "spine_length_m": max(p.spine_lengths),
        "deflection_m": max(p.deflection_ratio * p.cantilever(x) for x in p.spine_lengths), "vacuum_pa": p.vacuum,
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
        deflection = p.deflection_ratio * length * i / p.steps
        push = Push(p.specimen, spine, length, deflection, p.max_force)
        return replace(free, arm_speed=p.push_speed, probe=((length, deflection - p.radius),), push=push)

    return grow, approach, deflect


def run(bench: Bench, p: Stiffness, trials: Trials) -> None:
    """Do all trials. Raises ProtocolError; the caller always lands the rig safe."""
    stand = bench.need(bench.stand, "stand")
    bench.operator.prepare(_setup(p))
    if bench.pressure is not None:
        vent(bench)
    probe = ProbeMotion(bench, p, stand, p.radius)
    home(bench)
    for repeat, spine in trials.remaining(itertools.product(range(1, p.repeats + 1), p.spine_lengths), 2 + p.steps):
        bench.check_stop()
        inside = "" if p.specimen == "spine" else "spine "
        bench.say(f"Repeat {repeat} of {p.repeats}: specimen {p.specimen}, {inside}{spine * 100:g} cm")
        grow = partial(_grow, bench, p, probe, spine)
        ambient = through_pauses(bench, grow)
        trials.step_done()
        trial = trials.begin(repeat=repeat, spine=spine, ambient=ambient, specimen=p.specimen)
        with trials.doing(trial):
            try:
                work = Pushing(probe, p.cantilever(spine), grow)
                through_jams(trials, trial, partial(_push, bench, p, trial, trials, work))
            except ProtocolError:
                with contextlib.suppress(Exception):  # report what ended the trial, not how the retreat failed
                    probe.retreat()
                raise


def _grow(bench: Bench, p: Stiffness, probe: ProbeMotion, spine: float) -> float:
    """The next specimen, with the probe out of its way; returns ambient pressure, Pa absolute."""
    probe.go(p.first_place, -probe.stand.standoff, p.speed)
    probe.before = probe.read_unloaded()
    return set_spine(bench, spine, p.vacuum, p.spine, p.jam)


TOPICS = ("/force", "/arm", "/spine", "/vacuum")
MIN_POSES = 3
"""Poses of the arm that a reading averages at least."""
SOFT_SHARE = 0.5
"""Of the expected force, below which a spine is soft: granules that yield lose a few percent a deflection, it nearly all."""


@dataclass(frozen=True)
class Pushing:
    """One trial's work: the probe, where along the specimen it pushes (m), and how the specimen is jammed anew."""

    probe: ProbeMotion
    length: float
    jam: Callable[[], object]

    def come_back(self, depth: float) -> None:
        """After a pause: away from the specimen, and to where it is nearly touched. Raises JamLost where it was soft."""
        self.probe.retreat()
        keep_jammed(self.probe.bench, self.jam)
        self.probe.go(self.length, depth, self.probe.p.speed)


def _push(bench: Bench, p: Stiffness, trial: Trial, trials: Trials, work: Pushing) -> None:
    """Approach, step the deflection and read force at each, retreat."""
    probe, length = work.probe, work.length
    contact = through_pauses(bench, partial(probe.approach, length), partial(work.come_back, probe.near))
    trials.step_done()
    x, y, z, *_ = probe.state.latest().tcp_pose
    # Deflection counts from here, so force does: how far the last step went past the first touch is in both.
    trial = replace(trial, probe=Probe(direction=probe.stand.push, origin=(x, y, z), force_offset=contact.offset))
    # s that hold enough samples of the force and poses of the arm
    average = max(p.average, p.min_samples / _sample_rate(bench), (MIN_POSES + 1) * _longest_gap(bench))
    row: TrialRow | None = None
    for i in range(1, p.steps + 1):
        deflection = p.deflection_ratio * length * i / p.steps
        expected_force = contact.force + _expected_rise(row, deflection)
        deflect = partial(_deflect, bench, p, trial, trials, work, contact, deflection, expected_force, average)
        try:
            row = through_pauses(bench, deflect, partial(work.come_back, contact.depth - p.clearance))
        except TooMuchForce as e:
            bench.say(f"{e}: no further deflection at this length")
            break
        trials.step_done()
        force = contact.offset + (row.force or 0.0)
        if force > p.max_force:
            bench.say(f"Force {force:.1f} N is above {p.max_force:g} N: no further deflection at this length")
            break
    through_pauses(bench, partial(_retreat, bench, trial, trials, work, contact), partial(work.come_back, -probe.stand.standoff))


def _deflect(
    bench: Bench, p: Stiffness, trial: Trial, trials: Trials, work: Pushing, contact: Contact, deflection: float,
    expected_force: float, average: float,
) -> TrialRow:  # fmt: skip
    """Read the state at a deflection (m from the contact), averaged over `average` s; Suspended for a soft jammed specimen."""
    depth = contact.depth + deflection

    def read(least_rise: float | None) -> TrialRow:
        work.probe.go(work.length, depth, p.push_speed)
        at_rest = bench.clock.now()
        return trials.read(
            trial, Window(p.dwell, average, MIN_POSES), branch="load", t_start=at_rest, ramp_end=at_rest, rate=0.0,
            targets=(), topics=TOPICS, wait=p.dwell + average + 20.0, repeatable=True, least_force=least_rise,
        )  # fmt: skip

    if bench.jammed is None:
        return read(None)
    least_force = SOFT_SHARE * expected_force
    try:
        return read(least_force - contact.force)  # a state's force counts from the contact
    except NotPushing as e:
        _raise_if_soft(trial, trials, work, depth, least_force, e)
        return read(None)


def _expected_rise(row: TrialRow | None, deflection: float) -> float:
    """N above the first contact at a deflection (m), in proportion to the state before, `row`; 0 where there is none."""
    if row is None or not row.deflection or not row.force:
        return 0.0
    return max(0.0, row.force * deflection / row.deflection)


def _raise_if_soft(trial: Trial, trials: Trials, work: Pushing, depth: float, least_force: float, why: NotPushing) -> None:
    """Lift the probe off and back: raises Suspended below `least_force` N; above, the sensor's drift caused `why`."""
    resistance = work.probe.resistance(work.length, depth)
    if resistance >= least_force:
        work.probe.bench.say(f"{why}; but it pushes back with {resistance:.2f} N: the sensor drifts, and the state is read again")
        return
    work.probe.retreat()  # it may become stiff while a person puts it right
    raise trials.soft(trial, f"it pushes back with {resistance:.2f} N, expected are {least_force:.2f} N or more")


def _retreat(bench: Bench, trial: Trial, trials: Trials, work: Pushing, contact: Contact) -> None:
    """Away from the specimen, where the sensor's zero is read again. Raises Suspended where the force hardly rose."""
    probe = work.probe
    probe.retreat()
    unjammed, start, end = probe.before, contact.zero, probe.read_unloaded()
    zeros = Zeros(trial.number, probe.stand.push, unjammed.span, start.span, end.span, contact.at)
    trials.zero(zeros, drift(unjammed.read, start.read, end.read))
    last = trials.rows[-1] if trials.rows else None
    if bench.jammed is None or last is None or last.trial != trial.number or last.force is None or last.doubt:
        return
    least_rise = 5.0 * math.hypot(start.read.error, end.read.error)  # five standard errors of the zero
    if last.force < least_rise:
        raise trials.soft(trial, f"the force rose by {last.force:.2f} N, expected are more than {least_rise:.2f} N")


def _longest_gap(bench: Bench) -> float:
    """s of rig time between two poses of the arm, the longest of the last five seconds; 0 where there are none yet."""
    now = bench.clock.now()
    times = [*bench.recorder.buffers.window("/arm", now - 5.0, now)["t"], now]
    return float(max((b - a for a, b in itertools.pairwise(times)), default=0.0))


def _sample_rate(bench: Bench) -> float:
    """Force samples a second of rig time, over the last two seconds."""
    now = bench.clock.now()
    return max(1.0, len(bench.recorder.buffers.window("/force", now - 2.0, now)) / 2.0)
