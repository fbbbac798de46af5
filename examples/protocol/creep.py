"""Creep: one pressure at one spine length, read again and again. `lab plan examples/protocol/creep.py --rig RIG`."""

from __future__ import annotations

from pydantic import Field

from protocols.actions import home, ramp, set_spine, vent
from protocols.bench import Bench, Setup
from protocols.experiment import Ask, Plan, Reading, Step, Trials
from protocols.parameters import Chamber, Jam, Parameters, Pressure, SpineLength, SpineMotion, Vacuum
from recordings.states.rules import Window


class Creep(Parameters):
    """What a person may change; SI units."""

    pressure: Pressure = Field(100e3, json_schema_extra={"unit": "Pa"})
    spine_length: SpineLength = Field(0.1, json_schema_extra={"unit": "m"})
    vacuum: Vacuum = Field(80e3, json_schema_extra={"unit": "Pa"})
    chambers: list[Chamber] = Field([9, 1, 2], min_length=1, max_length=64)
    rate: float = Field(25e3, gt=0, le=200e3, json_schema_extra={"unit": "Pa/s"})
    times: list[float] = Field([2.0, 10.0, 30.0], min_length=1, json_schema_extra={"unit": "s"})
    average: float = Field(1.0, gt=0, le=60, json_schema_extra={"unit": "s"})
    """Each reading is averaged over so long, around its time."""
    spine: SpineMotion = SpineMotion()
    jam: Jam = Jam()


PARAMETERS = Creep
NEEDS = ("pressure", "spine", "valve", "gauge", "mocap")


def chambers(p: Creep) -> tuple[float, ...]:
    """Pressure of each chamber up to the last one, Pa."""
    return tuple(p.pressure if i in p.chambers else 0.0 for i in range(1, max(p.chambers) + 1))


def plan(p: Creep) -> Plan:
    """One jamming, one ramp, and the readings."""
    asks = Ask(chambers(p), p.rate, p.spine_length, p.spine.speed, p.vacuum, setup=setup(p))
    first = Step("vent, grow, jam and ramp", 10.0 + p.spine_length / p.spine.speed + p.pressure / p.rate, asks)
    waits = [later - earlier for earlier, later in zip([0.0, *p.times], p.times, strict=False)]
    reads = [
        Step(f"read after {t:g} s", wait, reads=(Reading("load", t, p.rate),)) for t, wait in zip(p.times, waits, strict=True)
    ]
    return Plan("creep", [first, *reads])


def setup(p: Creep) -> Setup:
    """What a person prepares."""
    return Setup("robot", 0.0, 0.0, p.vacuum)


def run(bench: Bench, p: Creep, trials: Trials) -> None:
    """Do it; whatever happens, the caller makes the rig safe."""
    if not trials.remaining([1], 1 + len(p.times)):
        return
    vent(bench)
    bench.operator.prepare(setup(p))
    home(bench)
    ambient = set_spine(bench, p.spine_length, p.vacuum, p.spine, p.jam)
    trial = trials.begin(repeat=1, spine=p.spine_length, ambient=ambient)
    arrived = ramp(bench, bench.chambers.setpoints(dict(enumerate(chambers(p), 1))), p.rate)
    trials.step_done()
    for t in p.times:
        trials.read(
            trial, Window(max(0.0, t - p.average / 2), p.average, 1), branch="load", t_start=arrived, ramp_end=arrived,
            rate=p.rate, targets=chambers(p), topics=("/pressure", "/tip", "/spine", "/vacuum"), wait=t + 30.0,
        )  # fmt: skip
        trials.step_done()
    trials.end(trial)
