"""A protocol that goes through pressures and reads a state at each, in a few lines of one's own.

`plan_of` makes the plan, `go_through` carries it out with trials, pauses and resuming. A protocol that does more in a trial
builds on `in_one_jamming` and `Walk`, as `protocols/bending.py` does.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from recordings.states.rules import Crossing, Settled, Window
from recordings.trials import TrialRow

from .actions import home, keep_jammed, ramp, set_spine, vent
from .bench import Bench, Setup
from .errors import WrongWiring
from .experiment import Ask, Plan, Reading, Step, Trial, Trials, settled
from .parameters import Jam, Settle, SpineMotion
from .suspension import through_jams, through_pauses

Branch = Literal["load", "unload"]
TOPICS = ("/pressure", "/spine", "/vacuum")
AVERAGE, LEAST_AVERAGE = 0.2, 1.0
"""Share of its hold over which a state at a fixed time is averaged, and the shortest average, s."""
PREPARING_VISITS = 10.0
"""Planned s of venting and jamming, without the spine's way."""


@dataclass(frozen=True)
class Visit:
    """One state: the pressure (Pa, gauge) of each inflated chamber, counted from 1, and when it is read."""

    pressures: Mapping[int, float]
    hold: float | None = None
    """s from the ramp's end to the reading; None: once settled."""

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
    """That jams the spine, below ambient; 0: not jammed."""
    tip_mass: float = 0.0
    roll_deg: float = 0.0
    settle: Settle = Settle()
    spine: SpineMotion = SpineMotion()
    jam: Jam = Jam()

    @property
    def setup(self) -> Setup:
        """What a person prepares."""
        return Setup("robot", self.tip_mass, self.roll_deg, self.vacuum)


def plan_of(protocol: str, visits: Sequence[Visit], sweep: Sweep | None = None) -> Plan:
    """The plan that visits these states in each repeat."""
    s = sweep or Sweep()
    steps: list[Step] = []
    for repeat in range(1, s.repeats + 1):
        prepare = Ask(
            spine_length=s.spine_length, spine_speed=s.spine.speed if s.spine_length else None, vacuum=s.vacuum,
            setup=s.setup if repeat == 1 else None,
        )  # fmt: skip
        steps.append(Step(f"vent and prepare, repeat {repeat}", PREPARING_VISITS + s.spine_length / s.spine.speed, prepare))
        previous: tuple[float, ...] = ()
        for visit, branch in zip(visits, _branches(visits), strict=True):
            pressures = visit.by_chamber
            change = change_of(previous, pressures)
            hold = planned_rest(s.settle) if visit.hold is None else visit.hold
            average = s.settle.average if visit.hold is None else _average(visit.hold)
            reads = (Reading(branch, hold, signed(s.rate, change), repeat),)
            label = f"{max(pressures) / 1e3:g} kPa {branch}, repeat {repeat}"
            steps.append(Step(label, abs(change) / s.rate + hold + average, Ask(pressures, s.rate), reads))
            previous = pressures
    highest = max((max(v.by_chamber) for v in visits), default=0.0)
    return Plan(protocol, steps, {"pressure_pa": highest, "spine_length_m": s.spine_length})


def go_through(bench: Bench, trials: Trials, visits: Sequence[Visit], sweep: Sweep | None = None) -> None:
    """Visit all states in each repeat."""
    s = sweep or Sweep()
    repeats = trials.remaining(range(1, s.repeats + 1), 1 + len(visits))
    if not repeats:
        return
    vent(bench)
    bench.operator.prepare(s.setup)
    home(bench)
    for repeat in repeats:
        bench.check_stop()
        bench.say(f"Repeat {repeat} of {s.repeats}")
        in_one_jamming(bench, trials, repeat, s, partial(_visit_all, visits))


def in_one_jamming(bench: Bench, trials: Trials, repeat: int, sweep: Sweep, work: Callable[[Walk], None]) -> None:
    """One trial: jam the spine, read the states by `work`, again after a new jamming, vent."""
    jam = partial(set_spine, bench, sweep.spine_length, sweep.vacuum, sweep.spine, sweep.jam)
    ambient = through_pauses(bench, jam)
    trials.step_done()
    trial = trials.begin(
        repeat=repeat, spine=sweep.spine_length, ambient=ambient, tip_mass=sweep.tip_mass, roll_deg=sweep.roll_deg
    )
    with trials.doing(trial):
        through_jams(trials, trial, partial(work, Walk(bench, trials, trial, sweep, jam)))
    vent(bench)


@dataclass(frozen=True)
class Walk:
    """The way of one trial from state to state. Pressures are Pa by chamber."""

    bench: Bench
    trials: Trials
    trial: Trial
    sweep: Sweep
    jam: Callable[[], object]
    """Jams the spine anew."""

    def visit(
        self,
        pressures: Sequence[float],
        branch: Branch,
        rules: Sequence[Settled | Window],
        highest: Sequence[float],
        judge: Callable[[TrialRow], None] | None = None,
    ) -> None:
        """Ramp to `pressures` and read a state by each of the rules, passing each row to `judge`. After a pause a state of the
        unload branch is reached by way of `highest`."""
        rules_left = list(rules)

        def work() -> None:
            previous = self.bench.need(self.bench.pressure, "pressure").read().setpoint
            arrived = self.ramp(pressures)
            rate = signed(self.sweep.rate, change_of(previous, setpoints(self.bench, pressures)))
            while rules_left:
                row = self.read(rules_left[0], pressures, branch, arrived, arrived, rate)
                if judge is not None:
                    judge(row)
                rules_left.pop(0)

        self.bench.check_stop()
        through_pauses(self.bench, work, partial(self.come_back, branch, highest))
        self.trials.step_done()

    def come_back(self, branch: Branch, highest: Sequence[float]) -> None:
        """After a pause: jam a spine anew that was soft, and return by way of the highest pressures. Raises JamLost."""
        keep_jammed(self.bench, self.jam)
        if branch == "unload":
            self.ramp(highest)
            self.bench.pause(self.sweep.settle.average)  # the chambers follow their set-points

    def ramp(self, pressures: Sequence[float]) -> float:
        """Ramp all chambers; returns the rig time (s) of arrival."""
        return ramp(self.bench, setpoints(self.bench, pressures), self.sweep.rate)

    def read(
        self, rule: Settled | Window | Crossing, pressures: Sequence[float], branch: Branch, start: float, arrived: float,
        rate: float,
    ) -> TrialRow:  # fmt: skip
        """Read one state; rig times (s) from which the rule looks and at which the ramp ended."""
        due = rule.delay + rule.average if isinstance(rule, Window) else rule.timeout
        return self.trials.read(
            self.trial, rule, branch=branch, t_start=start, ramp_end=arrived, rate=rate, targets=pressures,
            topics=(*TOPICS, *["/tip"] * (self.bench.mocap is not None)), wait=due + 30.0,  # s, for the end of a state
        )  # fmt: skip


def setpoints(bench: Bench, pressures: Sequence[float]) -> tuple[float, ...]:
    """Set-point of each channel (Pa) for pressures by chamber, or WrongWiring."""
    try:
        return bench.chambers.setpoints(dict(enumerate(pressures, 1)))
    except ValueError as e:
        raise WrongWiring(str(e)) from e


def change_of(before: Sequence[float], after: Sequence[float]) -> float:
    """The largest change of a pressure (Pa), with its sign."""
    return max((b - a for a, b in itertools.zip_longest(before, after, fillvalue=0.0)), key=abs, default=0.0)


def signed(rate: float, change: float) -> float:
    """Pa/s of a ramp that changes the pressure by `change` Pa; 0 where it changes nothing."""
    return 0.0 if abs(change) < 1e3 else math.copysign(rate, change)  # Pa; a smaller change of the set-points is no ramp


def planned_rest(rules: Settle) -> float:
    """s from the ramp's end in which a robot has usually settled."""
    return 2.25 + max(rules.still, rules.average) / 2  # they follow the ramp for about 2.25 s, then the window begins


def around(hold: float, average: float) -> Window:
    """The window of `average` s around `hold` s after the ramp's end."""
    return Window(max(0.0, hold - average / 2), average, 1)


def _average(hold: float) -> float:
    """s over which a state at a fixed time is averaged."""
    return max(LEAST_AVERAGE, AVERAGE * hold)


def _visit_all(visits: Sequence[Visit], walk: Walk) -> None:
    for k, (visit, branch) in enumerate(zip(visits, _branches(visits), strict=True)):
        highest = max((v.by_chamber for v in visits[: k + 1]), key=max)
        rule = settled(walk.sweep.settle) if visit.hold is None else around(visit.hold, _average(visit.hold))
        walk.visit(visit.by_chamber, branch, [rule], highest)


def _branches(visits: Sequence[Visit]) -> list[Branch]:
    """Branch of each visit: unload where the sum of the pressures has fallen, and as long as it stays."""
    branches: list[Branch] = []
    previous = 0.0
    for visit in visits:
        total = sum(visit.by_chamber)
        unchanged = branches[-1] if branches else "load"
        branches.append("load" if total > previous else "unload" if total < previous else unchanged)
        previous = total
    return branches
