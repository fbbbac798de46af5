"""Bending sweep: grow the spine, inflate a group of chambers step by step and let off again, and read the tip at each state.

The defaults are the paper's: spine 0..30 cm by 5 cm, three adjacent chambers at 50..250 kPa by 50 kPa. States are read
when settled, or without stopping while ramping (`reading: sweep`), or after given hold times at each pressure (`reading:
hold`, creep).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from pydantic import Field, model_validator

from recordings.states.rules import Crossing, Settled, Window

from .actions import home, keep_jammed, ramp, set_spine, vent
from .bench import Bench, Setup
from .errors import WrongWiring
from .experiment import Ask, Plan, Reading, Step, Trial, Trials, settled
from .parameters import Chamber, Jam, Parameters, Pressure, RobotFacts, Settle, SpineLength, SpineMotion, Vacuum
from .shapes import Shapes
from .suspension import through_jams, through_pauses


class Bending(Parameters):
    """Parameters of a bending sweep."""

    spine_lengths: list[SpineLength] = Field(
        [0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30], min_length=1, max_length=200, json_schema_extra={"unit": "m"}
    )
    pressures: list[Pressure] = Field(
        [50e3, 100e3, 150e3, 200e3, 250e3], min_length=1, max_length=200, json_schema_extra={"unit": "Pa"}
    )
    """Levels of the load branch, rising."""
    chambers: list[Chamber] = Field([9, 1, 2], min_length=1, max_length=64)
    """The group that is inflated: the paper's or, where that is not connected, the first channel's; all chambers together
    make the robot longer."""
    unload: bool = True
    """Read the same levels on the way down too."""
    zero_state: bool = True
    """Read the state at zero pressure, first (and last, with the unload branch)."""
    repeats: int = Field(1, ge=1, le=100)
    """How often the whole sweep is done; at least 3 for a noise floor."""
    reading: Literal["settled", "sweep", "hold"] = "settled"
    rate: float = Field(25e3, gt=0, le=200e3, json_schema_extra={"unit": "Pa/s"})
    """Ramp between levels."""
    hold_times: list[float] = Field([2.0, 5.0, 10.0, 30.0], max_length=50, json_schema_extra={"unit": "s"})
    """Readings after the ramp's end, for `reading: hold`."""
    tip_mass: float = Field(0.053, ge=0, le=1.0, json_schema_extra={"unit": "kg"})
    roll_deg: float = Field(0.0, ge=-360, le=360, json_schema_extra={"unit": "deg"})
    """The chamber pattern turned about the robot's axis by the person who mounts it."""
    vacuums: list[Vacuum] = Field([80e3], min_length=1, max_length=20, json_schema_extra={"unit": "Pa"})
    """Levels of the vacuum supply, below ambient; more than one is a vacuum sweep."""
    spine: SpineMotion = SpineMotion()
    jam: Jam = Jam()
    settle: Settle = Settle()

    @classmethod
    def defaults_for(cls, robot: RobotFacts) -> dict[str, Any]:
        """Its tip mass; the first channel's chambers where the paper's group is not connected; no spine where there is none."""
        found: dict[str, Any] = {"tip_mass": robot.tip_mass}
        if not robot.spine:
            found |= {"spine_lengths": [0.0], "vacuums": [0.0]}
        connected = {c for group in robot.channels for c in group}
        if connected and not connected >= set(cls.model_fields["chambers"].default):
            found["chambers"] = list(robot.channels[0])
        return found

    @model_validator(mode="after")
    def _orders(self) -> Bending:
        if sorted(set(self.pressures)) != self.pressures:
            raise ValueError(f"pressures must increase without repeats, got {[p / 1e3 for p in self.pressures]} kPa")
        if len(set(self.chambers)) != len(self.chambers):
            raise ValueError(f"chambers {self.chambers} lists a chamber twice")
        if sorted(set(self.hold_times)) != self.hold_times or any(h <= 0 for h in self.hold_times):
            raise ValueError(f"hold_times must be above 0 and increase, got {self.hold_times} s")
        return self


PARAMETERS = Bending


@dataclass(frozen=True)
class Level:
    """One state of a sweep: pressure of the group (Pa) and how it is reached."""

    pressure: float
    branch: Literal["load", "unload"]


def levels(p: Bending) -> list[Level]:
    """The states of one sweep in the order they are visited."""
    up = [Level(x, "load") for x in ([0.0] if p.zero_state else []) + p.pressures]
    down = [Level(x, "unload") for x in p.pressures[-2::-1] + ([0.0] if p.zero_state else [])]
    return up + (down if p.unload else [])


def _sweeps(p: Bending) -> Iterator[tuple[int, float, float]]:
    """(repeat, vacuum Pa, spine length m) of each sweep."""
    return itertools.product(range(1, p.repeats + 1), p.vacuums, p.spine_lengths)


def _reach(spine: float, vacuum: float) -> str:
    """How far the spine is grown and how it is jammed, for people."""
    return f"spine {spine * 100:g} cm, vacuum {vacuum / 1e3:g} kPa" if spine or vacuum else "no spine"


def plan(p: Bending, name: str = "bending") -> Plan:
    """What will be done, how long it takes, and the largest values it asks for."""
    steps: list[Step] = []
    length, prepared = 0.0, None
    for repeat, vacuum, spine in _sweeps(p):
        reach, setup = f"{_reach(spine, vacuum)}, repeat {repeat}", _setup(p, vacuum)
        steps.append(
            Step(
                f"vent, release, grow and jam: {reach}",
                8.0 + abs(spine - length) / p.spine.speed + p.spine.settle,
                Ask(
                    spine_length=spine,
                    spine_speed=p.spine.speed,
                    vacuum=vacuum,
                    setup=setup if setup != prepared else None,
                ),
            )
        )
        length, before, prepared = spine, 0.0, setup
        for level in levels(p):
            climb = abs(level.pressure - before) / p.rate
            stay = {
                "settled": p.settle.still + p.settle.average + 1.5,
                "sweep": 0.0,
                "hold": p.hold_times[-1] if p.hold_times else 0,
            }
            ask = Ask(pressures=tuple(_chambers(p, level.pressure)), pressure_rate=p.rate)
            rate = _signed(p.rate, level.pressure - before)
            reads = tuple(Reading(level.branch, hold, rate, repeat) for hold in _holds(p, level))
            before = level.pressure
            label = f"{level.pressure / 1e3:g} kPa {level.branch}, {reach}"
            steps.append(Step(label, climb + stay[p.reading], ask, reads))
    limits = {
        "pressure_pa": max(p.pressures), "pressure_rate_pa_s": p.rate, "spine_length_m": max(p.spine_lengths),
        "spine_speed_m_s": p.spine.speed, "vacuum_pa": max(p.vacuums), "tip_mass_kg": p.tip_mass,
    }  # fmt: skip
    return Plan(name, steps, limits)


NEEDS = ("pressure", "spine", "valve", "gauge", "mocap")
TOPICS = ("/pressure", "/tip", "/spine", "/vacuum")


TO_REST = 2.25
"""s from the ramp's end until the window of a settled state begins, about: regulators and silicone follow the ramp."""


def _holds(p: Bending, level: Level) -> list[float]:
    """Planned s from the ramp's end to each reading of a level."""
    if p.reading == "hold":
        return p.hold_times
    if p.reading == "sweep" and level.pressure > 0:
        return [0.0]
    return [TO_REST + max(p.settle.still, p.settle.average) / 2]


def _signed(rate: float, way: float) -> float:
    """Pa/s of a ramp that changes the pressure by `way` Pa; 0 where it changes nothing."""
    return 0.0 if abs(way) < 1e3 else math.copysign(rate, way)


def _setup(p: Bending, vacuum: float) -> Setup:
    """What a person prepares."""
    return Setup("robot", p.tip_mass, p.roll_deg, vacuum)


def run(bench: Bench, p: Bending, trials: Trials) -> None:
    """Do the sweep. Raises ProtocolError; the caller lands the rig safe whatever happens."""
    _channels(bench, p, max(p.pressures))  # a pattern that the wiring cannot make fails before anything moves
    vent(bench)
    for vacuum, sweeps in itertools.groupby(trials.remaining(_sweeps(p), 1 + len(levels(p))), lambda s: s[1]):
        bench.operator.prepare(_setup(p, vacuum))
        home(bench)
        for repeat, _, spine in sweeps:
            bench.check_stop()
            bench.say(f"Repeat {repeat} of {p.repeats}: {_reach(spine, vacuum)}")
            ambient = through_pauses(bench, partial(set_spine, bench, spine, vacuum, p.spine, p.jam))
            trials.step_done()
            trial = trials.begin(repeat=repeat, spine=spine, ambient=ambient, tip_mass=p.tip_mass, roll_deg=p.roll_deg)
            sweep = Sweep(bench, p, trial, trials, partial(set_spine, bench, spine, vacuum, p.spine, p.jam))
            with trials.doing(trial):
                through_jams(trials, trial, partial(_visit_all, sweep))
            vent(bench)


@dataclass(frozen=True)
class Sweep:
    """One trial: what works for it, and what is known of its spine."""

    bench: Bench
    p: Bending
    trial: Trial
    trials: Trials
    jam: Callable[[], object]
    """Jams the spine anew."""
    shapes: Shapes = field(default_factory=Shapes)


def _visit_all(s: Sweep) -> None:
    """Visit all levels once: stop and read at each, or read without stopping between the turning points."""
    s.shapes.begin()
    if s.p.reading != "sweep":
        for level in levels(s.p):
            _stop_and_read(s, [level])
    else:
        for branch, some in itertools.groupby(levels(s.p), key=lambda level: (level.branch, level.pressure > 0)):
            (_read_on_the_fly if branch[1] else _stop_and_read)(s, list(some))
    if s.shapes.seen:
        s.trials.mark(s.trial.number, "soft", s.shapes.seen)
        s.bench.say(f'Trial {s.trial.number} is marked (doubt "soft"): {s.shapes.seen}')


def _stop_and_read(s: Sweep, at: list[Level]) -> None:
    """Ramp to each level and read it when settled, or after the hold times."""
    for level in at:
        s.bench.check_stop()
        rules = _rules(s.p)

        def visit(level: Level = level, rules: list[Settled | Window] = rules) -> None:
            before = max(s.bench.need(s.bench.pressure, "pressure").read().setpoint)
            arrived = ramp(s.bench, _channels(s.bench, s.p, level.pressure), s.p.rate)
            rate = _signed(s.p.rate, level.pressure - before)
            while rules:
                _read(s, level, rules[0], arrived, arrived, rate)
                rules.pop(0)

        through_pauses(s.bench, visit, partial(_climb_back, s, level.branch))
        s.trials.step_done()


def _climb_back(s: Sweep, branch: str) -> None:
    """After a pause the chambers are empty: a spine that was soft is jammed anew, and a state of the unload branch is reached by
    way of the highest again. Raises JamLost."""
    keep_jammed(s.bench, s.jam)
    if branch == "unload":
        ramp(s.bench, _channels(s.bench, s.p, max(s.p.pressures)), s.p.rate)
        s.bench.pause(s.p.settle.average)  # the chambers follow their set-points


def _rules(p: Bending) -> list[Settled | Window]:
    if p.reading == "hold":
        return [Window(max(0.0, h - p.settle.average / 2), p.settle.average, 1) for h in p.hold_times]
    return [settled(p.settle)]


def _read_on_the_fly(s: Sweep, passed: list[Level]) -> None:
    """One ramp past all levels of a branch; each is read where the measured pressure crosses it."""
    s.bench.check_stop()
    branch, left = passed[0].branch, list(passed)
    through_pauses(s.bench, lambda: _pass(s, left), lambda: _climb_back(s, branch))


def _pass(s: Sweep, left: list[Level]) -> None:
    """One ramp to the last level; takes those that were read off the list."""
    p = s.p
    rising = left[0].branch == "load"
    end = left[-1].pressure
    begin = s.bench.clock.now()
    arrived = ramp(s.bench, _channels(s.bench, p, end), p.rate)
    while left:
        level = left[0]
        # The pressure approaches the ramp's end without crossing it: the last level is read just before.
        short = p.settle.band if level.pressure == end else 0.0
        at = level.pressure - short if rising else level.pressure + short
        rule = Crossing(
            at, tuple(c - 1 for c in p.chambers), rising, p.settle.average, 2, arrived - begin + p.settle.within
        )
        _read(s, level, rule, begin, arrived, p.rate if rising else -p.rate)
        left.pop(0)
        s.trials.step_done()


def _read(
    s: Sweep, level: Level, rule: Settled | Window | Crossing, start: float, ramp_end: float, rate: float
) -> None:
    """Read one state. Raises Suspended where its shape shows that the jammed spine has gone soft, once a trial."""
    p, shapes = s.p, s.shapes
    last = p.hold_times[-1] if p.reading == "hold" else 0.0
    row = s.trials.read(
        s.trial, rule, branch=level.branch, t_start=start, ramp_end=ramp_end, rate=rate, targets=_chambers(p, level.pressure),
        topics=TOPICS, wait=last + p.settle.average + p.settle.within + 10.0,
    )  # fmt: skip
    if s.bench.jammed is not None and shapes.take(level.branch, level.pressure, row) and not shapes.asked:
        shapes.asked = True
        raise s.trials.soft(s.trial, shapes.seen)


def _chambers(p: Bending, pressure: float) -> list[float]:
    """Target of each chamber up to the last of the group, Pa, with the group at one pressure."""
    return [pressure if c in p.chambers else 0.0 for c in range(1, max(p.chambers) + 1)]


def _channels(bench: Bench, p: Bending, pressure: float) -> tuple[float, ...]:
    """Channel set-points, Pa; ProtocolError when the wiring cannot make the group."""
    try:
        return bench.chambers.setpoints(dict(enumerate(_chambers(p, pressure), 1)))
    except ValueError as e:
        raise WrongWiring(f"chambers {p.chambers}: {e}") from e
