"""Pressure cycles without a reading: to the highest pressure and back, again and again, one group of chambers after another.

Silicone softens in its first cycles to a new strain (Mullins). The spine stays out of the body, which bends most then.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from pydantic import Field, model_validator

from .actions import home, ramp, set_spine, vent
from .bench import Bench, Setup
from .experiment import Ask, Plan, Step, Trials
from .parameters import PREPARING, Chamber, Jam, Parameters, Pressure, RobotFacts, SpineMotion
from .suspension import through_pauses


class Cycles(Parameters):
    """Parameters of pressure cycles."""

    chambers: list[list[Chamber]] = Field([[9, 1, 2]], min_length=1, max_length=64)
    """Groups of chambers, one after another; by default the chambers of each channel."""
    pressures: list[Pressure] = Field([100e3], min_length=1, max_length=64, json_schema_extra={"unit": "Pa"})
    """Highest pressure of each group, or one for all."""
    cycles: int = Field(3, ge=1, le=1000)
    """Number of cycles of each group."""
    rate: float = Field(25e3, gt=0, le=200e3, json_schema_extra={"unit": "Pa/s"})
    """Of the pressure."""
    hold: float = Field(2.0, ge=0, le=600, json_schema_extra={"unit": "s"})
    """Pause at the highest pressure and when vented."""
    tip_mass: float = Field(0.053, ge=0, le=1.0, json_schema_extra={"unit": "kg"})
    """Mass at the tip; by default that of robot.yaml."""
    roll_deg: float = Field(0.0, ge=-360, le=360, json_schema_extra={"unit": "deg"})
    """Angle about its axis at which a person mounts the robot."""
    vacuum: float = Field(80e3, ge=0, le=95e3, json_schema_extra={"unit": "Pa"})
    """Of the supply, below ambient; the spine is not jammed."""
    spine: SpineMotion = SpineMotion()
    jam: Jam = Jam()

    @classmethod
    def defaults_for(cls, robot: RobotFacts) -> dict[str, Any]:
        """Its tip mass, its channels, and no vacuum where there is no spine."""
        defaults: dict[str, Any] = {"tip_mass": robot.tip_mass} | ({} if robot.spine else {"vacuum": 0.0})
        return defaults | ({"chambers": [list(group) for group in robot.channels]} if robot.channels else {})

    @model_validator(mode="after")
    def _one_each(self) -> Cycles:
        if len(self.pressures) not in (1, len(self.chambers)):
            raise ValueError(f"pressures has {len(self.pressures)} values for {len(self.chambers)} groups of chambers")
        if not all(self.chambers):
            raise ValueError("chambers has a group without a chamber")
        return self


PARAMETERS = Cycles
NEEDS = ("pressure", "spine", "valve", "gauge")


def _ends(p: Cycles) -> list[dict[int, float]]:
    """Highest pressure (Pa) by chamber, of each group."""
    pressures = p.pressures * len(p.chambers) if len(p.pressures) == 1 else p.pressures
    return [dict.fromkeys(group, pressure) for group, pressure in zip(p.chambers, pressures, strict=True)]


def plan(p: Cycles) -> Plan:
    """What will be done, how long it takes, and the largest values it asks for."""
    first = Ask(spine_length=0.0, spine_speed=p.spine.speed, vacuum=0.0, setup=_setup(p))
    steps = [Step("vent, and draw back a spine if there is one", PREPARING + p.spine.settle, first)]
    for end in _ends(p):
        top = max(end.values())
        up = tuple(end.get(c, 0.0) for c in range(1, max(end) + 1))
        asks = (Ask(up, p.rate), Ask((0.0,) * len(up), p.rate))
        for k in range(1, p.cycles + 1):
            label = f"chambers {', '.join(map(str, end))}, cycle {k} of {p.cycles}: {top / 1e3:g} kPa"
            steps += [Step(f"{label} {way}", top / p.rate + p.hold, ask) for way, ask in zip(("up", "down"), asks, strict=True)]
    limits = {
        "pressure_pa": max(p.pressures), "pressure_rate_pa_s": p.rate, "spine_speed_m_s": p.spine.speed,
        "tip_mass_kg": p.tip_mass,
    }  # fmt: skip
    return Plan("cycles", steps, limits)


def _setup(p: Cycles) -> Setup:
    """What a person prepares."""
    return Setup("robot", p.tip_mass, p.roll_deg, p.vacuum)


def run(bench: Bench, p: Cycles, trials: Trials) -> None:
    """Do the cycles. Raises ProtocolError; the caller always lands the rig safe."""
    if not trials.remaining([1], len(plan(p).steps)):
        return
    vent(bench)
    bench.operator.prepare(_setup(p))
    home(bench)
    ambient = through_pauses(bench, partial(set_spine, bench, 0.0, 0.0, p.spine, p.jam))
    trials.step_done()
    trial = trials.begin(repeat=1, spine=0.0, ambient=ambient, tip_mass=p.tip_mass, roll_deg=p.roll_deg)
    for end in _ends(p):
        bench.say(f"{p.cycles} cycles of chambers {', '.join(map(str, end))} to {max(end.values()) / 1e3:g} kPa")
        for pressures in (end, {}) * p.cycles:
            bench.check_stop()
            through_pauses(bench, partial(_go, bench, p, pressures))
            trials.step_done()
    vent(bench)
    trials.end(trial)


def _go(bench: Bench, p: Cycles, pressures: dict[int, float]) -> None:
    """Ramp to these pressures (Pa by chamber, 0 where none is named) and hold them."""
    ramp(bench, bench.chambers.setpoints(pressures), p.rate)
    bench.pause(p.hold)
