"""A protocol that goes through pressures and reads a state at each, in a few lines of one's own.

`plan_of` makes the plan, `go_through` carries it out: trials, pauses, a spine that is jammed anew, resuming. See
examples/protocol/staircase.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from recordings.states.rules import Settled, Window

from .actions import home, keep_jammed, ramp, set_spine, vent
from .bench import Bench, Setup
from .bending import TOPICS
from .experiment import Ask, Plan, Reading, Step, Trial, Trials, settled
from .parameters import Jam, Settle, SpineMotion
from .suspension import through_jams, through_pauses

TO_REST = 4.0
"""s from the ramp's end until a robot has usually settled."""
AVERAGE, LEAST_AVERAGE = 0.2, 1.0
"""Share of its hold over which a state at a fixed time is averaged, and the shortest average, s."""
LATE = 30.0
"""s after which a reading at a fixed time is given up."""


@dataclass(frozen=True)
class Visit:
    """One state: the pressure (Pa, gauge) of each inflated chamber, counted from 1, and when it is read."""

    pressures: Mapping[int, float]
    hold: float | None = None
    """s from the ramp's end to the reading; None: once the robot has settled."""

    @property
    def average(self) -> float:
        """s over which it is averaged, at least."""
        return max(LEAST_AVERAGE, AVERAGE * (self.hold or 0.0))

    @property
    def by_chamber(self) -> tuple[float, ...]:
        """Pa, up to the last chamber that is named."""
        return tuple(self.pressures.get(c, 0.0) for c in range(1, max(self.pressures, default=1) + 1))


@dataclass(frozen=True)
class Sweep:
    """What all visits of a protocol share; SI units."""

    rate: float = 25e3
    """Pa/s of the ramps."""
    repeats: int = 1
    spine_length: float = 0.0
    vacuum: float = 0.0
    """Below ambient, with which the spine is jammed; 0: it is not."""
    tip_mass: float = 0.0
    roll_deg: float = 0.0
    settle: Settle = Settle()

    @property
    def setup(self) -> Setup:
        """What a person prepares."""
        return Setup("robot", self.tip_mass, self.roll_deg, self.vacuum)


def plan_of(protocol: str, visits: Sequence[Visit], sweep: Sweep | None = None) -> Plan:
    """The plan of a protocol of this name that visits these states in each repeat."""
    s = sweep or Sweep()
    motion = SpineMotion()
    steps: list[Step] = []
    for repeat in range(1, s.repeats + 1):
        grown = Ask(
            spine_length=s.spine_length, spine_speed=motion.speed if s.spine_length else None, vacuum=s.vacuum,
            setup=s.setup if repeat == 1 else None,
        )  # fmt: skip
        steps.append(Step(f"vent and prepare, repeat {repeat}", 10.0 + s.spine_length / motion.speed, grown))
        before = 0.0
        for visit, branch in zip(visits, _branches(visits), strict=True):
            top = max(visit.by_chamber)
            hold = TO_REST if visit.hold is None else visit.hold
            change = abs(top - before)
            reads = (Reading(branch, hold, s.rate if top >= before else -s.rate, repeat),)
            label = f"{top / 1e3:g} kPa {branch}, repeat {repeat}"
            steps.append(Step(label, change / s.rate + hold + visit.average, Ask(visit.by_chamber, s.rate), reads))
            before = top
    highest = max((max(v.by_chamber) for v in visits), default=0.0)
    return Plan(protocol, steps, {"pressure_pa": highest, "spine_length_m": s.spine_length})


def go_through(bench: Bench, trials: Trials, visits: Sequence[Visit], sweep: Sweep | None = None) -> None:
    """Visit all states in each repeat. Raises ProtocolError; the caller makes the rig safe whatever happens."""
    s = sweep or Sweep()
    left = trials.remaining(range(1, s.repeats + 1), 1 + len(visits))
    if not left:
        return
    vent(bench)
    bench.operator.prepare(s.setup)
    home(bench)
    grow = partial(set_spine, bench, s.spine_length, s.vacuum, SpineMotion(), Jam())
    for repeat in left:
        bench.check_stop()
        bench.say(f"Repeat {repeat} of {s.repeats}")
        ambient = through_pauses(bench, grow)
        trials.step_done()
        trial = trials.begin(
            repeat=repeat, spine=s.spine_length, ambient=ambient, tip_mass=s.tip_mass, roll_deg=s.roll_deg
        )
        with trials.doing(trial):
            through_jams(trials, trial, partial(_visit_all, bench, trials, trial, visits, s, grow))
        vent(bench)


def _visit_all(
    bench: Bench, trials: Trials, trial: Trial, visits: Sequence[Visit], s: Sweep, grow: partial[float]
) -> None:
    branches = _branches(visits)
    for k, visit in enumerate(visits):
        bench.check_stop()
        highest = max(visits[: k + 1], key=lambda v: max(v.by_chamber))

        def back(highest: Visit = highest, branch: str = branches[k]) -> None:
            keep_jammed(bench, grow)
            if branch == "unload":  # an unloaded state is reached from the highest pressure before it
                _ramp(bench, highest, s.rate)

        through_pauses(bench, partial(_read, bench, trials, trial, visit, branches[k], s), back)
        trials.step_done()


def _read(
    bench: Bench, trials: Trials, trial: Trial, visit: Visit, branch: Literal["load", "unload"], s: Sweep
) -> None:
    before = max(bench.need(bench.pressure, "pressure").read().setpoint)
    arrived = _ramp(bench, visit, s.rate)
    rule: Settled | Window = (
        settled(s.settle) if visit.hold is None else Window(max(0.0, visit.hold - visit.average / 2), visit.average, 1)
    )
    trials.read(
        trial, rule, branch=branch, t_start=arrived, ramp_end=arrived,
        rate=s.rate if max(visit.by_chamber) >= before else -s.rate, targets=visit.by_chamber, topics=TOPICS,
        wait=(s.settle.within if visit.hold is None else visit.hold + visit.average) + LATE,
    )  # fmt: skip


def _ramp(bench: Bench, visit: Visit, rate: float) -> float:
    return ramp(bench, bench.chambers.setpoints(dict(enumerate(visit.by_chamber, 1))), rate)


def _branches(visits: Sequence[Visit]) -> list[Literal["load", "unload"]]:
    """Of each visit: unload where the pressures have fallen, and as long as they stay."""
    found: list[Literal["load", "unload"]] = []
    before = 0.0
    for visit in visits:
        total = sum(visit.by_chamber)
        same = found[-1] if found else "load"
        found.append("load" if total > before else "unload" if total < before else same)
        before = total
    return found
