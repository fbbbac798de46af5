"""Bending sweep: grow the spine, inflate chambers step by step and let off again, and read the tip at each state.

The defaults are the paper's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from pydantic import Field, model_validator

from recordings.states.rules import Crossing, Settled, Window
from recordings.trials import TrialRow, Vector3

from .actions import home, vent
from .bench import Bench, Setup
from .experiment import Ask, Plan, Reading, Step, Trials, settled
from .parameters import PREPARING, Chamber, Jam, Parameters, Pressure, RobotFacts, Settle, SpineLength, SpineMotion, Vacuum
from .suspension import through_pauses
from .visits import Branch, Sweep, Walk, around, in_one_jamming, planned_rest, setpoints, signed

FARTHER, LEAST_FARTHER = 1.5, 0.01
"""Times, and m more than, the deflection of the load branch that a tip may have at the same pressure when unloading: hysteresis
and creep make up to a fifth more, a spine of 20 cm that goes soft nearly twice as much, a longer one more."""


@dataclass
class Shapes:
    """The tips of one sweep: where the chambers were vented, and at each pressure (Pa) of the load branch; m, base frame."""

    straight: Vector3 | None = None
    loaded: dict[float, Vector3] = field(default_factory=dict)
    seen: str = ""
    """What showed last that the spine had gone soft; empty while nothing did."""
    asked: bool = False
    """A person was asked about it in this trial: seen again with the spine jammed anew, it only marks the trial."""

    def begin(self) -> None:
        """The sweep begins, perhaps again."""
        self.straight, self.seen = None, ""
        self.loaded.clear()

    def take(self, branch: Literal["load", "unload"], pressure: float, row: TrialRow) -> bool:
        """Keep a tip of the load branch, compare one of the unload branch with it: whether the spine has gone soft between."""
        if row.tip is None:
            return False
        if branch == "load":
            if not pressure:
                self.straight = row.tip
            self.loaded[pressure] = row.tip
        if branch == "load" or not pressure or self.straight is None or pressure not in self.loaded:
            return False
        loading, unloading = math.dist(self.loaded[pressure], self.straight), math.dist(row.tip, self.straight)
        if unloading - loading < LEAST_FARTHER or unloading < FARTHER * loading:
            return False
        self.seen = (
            f"at {pressure / 1e3:g} kPa the tip is deflected by {unloading * 1e3:.0f} mm when unloading and was by "
            f"{loading * 1e3:.0f} mm when loading, limit {FARTHER:g} times as much"
        )
        return True


class Bending(Parameters):
    """Parameters of a bending sweep."""

    spine_lengths: list[SpineLength] = Field(
        [0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30], min_length=1, max_length=200, json_schema_extra={"unit": "m"}
    )
    """Spine lengths, one sweep for each."""
    pressures: list[Pressure] = Field(
        [50e3, 100e3, 150e3, 200e3, 250e3], min_length=1, max_length=200, json_schema_extra={"unit": "Pa"}
    )
    """Where the tip is read on the way up, increasing."""
    chambers: list[Chamber] = Field([9, 1, 2], min_length=1, max_length=64)
    """Chambers that are inflated together; by default the paper's group or, if that is not connected, the first channel's."""
    unload: bool = True
    """Whether the pressures are read on the way down, too."""
    zero_state: bool = True
    """Whether the vented state is read, first and, with `unload`, last."""
    repeats: int = Field(1, ge=1, le=100)
    """Repeats of all sweeps; at least 3 for a noise floor."""
    reading: Literal["settled", "sweep", "hold"] = "settled"
    """When a state is read: once settled, while ramping, or at `hold_times` (creep)."""
    rate: float = Field(25e3, gt=0, le=200e3, json_schema_extra={"unit": "Pa/s"})
    """Rate of the pressure ramps."""
    hold_times: list[float] = Field([2.0, 5.0, 10.0, 30.0], max_length=50, json_schema_extra={"unit": "s"})
    """Times after the ramp's end with `reading: hold`, increasing."""
    tip_mass: float = Field(0.053, ge=0, le=1.0, json_schema_extra={"unit": "kg"})
    """Mass at the tip; by default that of robot.yaml."""
    roll_deg: float = Field(0.0, ge=-360, le=360, json_schema_extra={"unit": "deg"})
    """Angle about its axis at which a person mounts the robot."""
    vacuums: list[Vacuum] = Field([80e3], min_length=1, max_length=20, json_schema_extra={"unit": "Pa"})
    """Vacuums that jam the spine, below ambient, one sweep for each; 0: not jammed."""
    spine: SpineMotion = SpineMotion()
    jam: Jam = Jam()
    settle: Settle = Settle()

    @classmethod
    def defaults_for(cls, robot: RobotFacts) -> dict[str, Any]:
        """Its tip mass; the first channel's chambers where the paper's group is not connected; no spine where there is none."""
        defaults: dict[str, Any] = {"tip_mass": robot.tip_mass}
        if not robot.spine:
            defaults |= {"spine_lengths": [0.0], "vacuums": [0.0]}
        connected = {c for group in robot.channels for c in group}
        if connected and not connected >= set(cls.model_fields["chambers"].default):
            defaults["chambers"] = list(robot.channels[0])
        return defaults

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
class SweepLevel:
    """One state of a sweep: pressure of the group (Pa) and how it is reached."""

    pressure: float
    branch: Branch


def levels(p: Bending) -> list[SweepLevel]:
    """The states of one sweep in the order they are visited."""
    up = [SweepLevel(x, "load") for x in ([0.0] if p.zero_state else []) + p.pressures]
    down = [SweepLevel(x, "unload") for x in p.pressures[-2::-1] + ([0.0] if p.zero_state else [])]
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
    stay = {
        "settled": planned_rest(p.settle) + p.settle.average, "sweep": 0.0, "hold": p.hold_times[-1] if p.hold_times else 0.0,
    }[p.reading]  # fmt: skip
    length, prepared = 0.0, None
    for repeat, vacuum, spine in _sweeps(p):
        reach, setup = f"{_reach(spine, vacuum)}, repeat {repeat}", _setup(p, vacuum)
        steps.append(
            Step(
                f"{'vent, release, grow and jam: ' if spine or vacuum else 'vent, '}{reach}",
                PREPARING + abs(spine - length) / p.spine.speed + p.spine.settle,
                Ask(spine_length=spine, spine_speed=p.spine.speed, vacuum=vacuum, setup=setup if setup != prepared else None),
            )
        )
        length, previous, prepared = spine, 0.0, setup
        for level in levels(p):
            ramping = abs(level.pressure - previous) / p.rate
            ask = Ask(pressures=tuple(_chambers(p, level.pressure)), pressure_rate=p.rate)
            rate = signed(p.rate, level.pressure - previous)
            reads = tuple(Reading(level.branch, hold, rate, repeat) for hold in _holds(p, level))
            previous = level.pressure
            label = f"{level.pressure / 1e3:g} kPa {level.branch}, {reach}"
            steps.append(Step(label, ramping + stay, ask, reads))
    limits = {
        "pressure_pa": max(p.pressures), "pressure_rate_pa_s": p.rate, "spine_length_m": max(p.spine_lengths),
        "spine_speed_m_s": p.spine.speed, "vacuum_pa": max(p.vacuums), "tip_mass_kg": p.tip_mass,
    }  # fmt: skip
    return Plan(name, steps, limits)


NEEDS = ("pressure", "spine", "valve", "gauge", "mocap")


def _holds(p: Bending, level: SweepLevel) -> list[float]:
    """Planned s from the ramp's end to each reading of a level."""
    if p.reading == "hold":
        return p.hold_times
    return [0.0] if p.reading == "sweep" and level.pressure > 0 else [planned_rest(p.settle)]


def _setup(p: Bending, vacuum: float) -> Setup:
    """What a person prepares."""
    return Setup("robot", p.tip_mass, p.roll_deg, vacuum)


def run(bench: Bench, p: Bending, trials: Trials) -> None:
    """Do the sweep. Raises ProtocolError; the caller always lands the rig safe."""
    setpoints(bench, _chambers(p, max(p.pressures)))  # a pattern that the wiring cannot make fails before anything moves
    vent(bench)
    for vacuum, sweeps in itertools.groupby(trials.remaining(_sweeps(p), 1 + len(levels(p))), lambda s: s[1]):
        bench.operator.prepare(_setup(p, vacuum))
        home(bench)
        for repeat, _, spine in sweeps:
            bench.check_stop()
            bench.say(f"Repeat {repeat} of {p.repeats}: {_reach(spine, vacuum)}")
            sweep = Sweep(p.rate, p.repeats, spine, vacuum, p.tip_mass, p.roll_deg, p.settle, p.spine, p.jam)
            in_one_jamming(bench, trials, repeat, sweep, partial(_visit_all, p, Shapes()))


def _visit_all(p: Bending, shapes: Shapes, walk: Walk) -> None:
    """Visit all levels once: stop and read at each, or read without stopping between the turning points."""
    shapes.begin()
    holds: list[Settled | Window] = [around(h, p.settle.average) for h in p.hold_times]
    rules = holds if p.reading == "hold" else [settled(p.settle)]
    for (branch, ramped), group in itertools.groupby(levels(p), key=lambda level: (level.branch, level.pressure > 0)):
        if ramped and p.reading == "sweep":
            _read_on_the_fly(p, shapes, walk, list(group), branch)
            continue
        for level in group:
            walk.visit(
                _chambers(p, level.pressure), branch, rules, _chambers(p, max(p.pressures)),
                partial(_judge, shapes, walk, level),
            )  # fmt: skip
    if shapes.seen:
        walk.trials.mark(walk.trial.number, "soft", shapes.seen)
        walk.bench.say(f'Trial {walk.trial.number} is marked (doubt "soft"): {shapes.seen}')


def _read_on_the_fly(p: Bending, shapes: Shapes, walk: Walk, levels_left: list[SweepLevel], branch: Branch) -> None:
    """One ramp past all levels of a branch; each is read where the measured pressure crosses it."""
    walk.bench.check_stop()
    back = partial(walk.come_back, branch, _chambers(p, max(p.pressures)))
    through_pauses(walk.bench, partial(_pass, p, shapes, walk, levels_left), back)


def _pass(p: Bending, shapes: Shapes, walk: Walk, levels_left: list[SweepLevel]) -> None:
    """One ramp past `levels_left` to the last of them; each is removed once it is read."""
    rising = levels_left[0].branch == "load"
    end = levels_left[-1].pressure
    begin = walk.bench.clock.now()
    arrived = walk.ramp(_chambers(p, end))
    while levels_left:
        level = levels_left[0]
        # The pressure approaches the ramp's end without crossing it: the last level is read just before.
        short = p.settle.band if level.pressure == end else 0.0
        pressure = level.pressure - short if rising else level.pressure + short
        within = arrived - begin + p.settle.within
        rule = Crossing(pressure, tuple(c - 1 for c in p.chambers), rising, p.settle.average, 2, within)
        rate = p.rate if rising else -p.rate
        _judge(shapes, walk, level, walk.read(rule, _chambers(p, level.pressure), level.branch, begin, arrived, rate))
        levels_left.pop(0)
        walk.trials.step_done()


def _judge(shapes: Shapes, walk: Walk, level: SweepLevel, row: TrialRow) -> None:
    """Raises Suspended where a state's shape shows that the jammed spine has gone soft, once a trial."""
    if walk.bench.jammed is not None and shapes.take(level.branch, level.pressure, row) and not shapes.asked:
        shapes.asked = True
        raise walk.trials.soft(walk.trial, shapes.seen)


def _chambers(p: Bending, pressure: float) -> list[float]:
    """Target of each chamber up to the last of the group, Pa, with the group at one pressure."""
    return [pressure if c in p.chambers else 0.0 for c in range(1, max(p.chambers) + 1)]
