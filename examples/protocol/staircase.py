"""A staircase of pressure, up and down. `lab plan examples/protocol/staircase.py --rig RIG`."""

from pydantic import Field

from protocols.parameters import Chamber, Parameters, Pressure
from protocols.visits import Sweep, Visit, go_through, plan_of


class Staircase(Parameters):
    step: Pressure = Field(20e3, json_schema_extra={"unit": "Pa"})
    steps: int = Field(3, ge=1, le=50)
    chambers: list[Chamber] = Field([1], min_length=1, max_length=64)
    hold: float = Field(20.0, gt=0, le=600, json_schema_extra={"unit": "s"})
    repeats: int = Field(3, ge=1, le=100)


PARAMETERS, NEEDS = Staircase, ("pressure", "mocap")


def visits(p):
    levels = [p.step * k for k in (*range(p.steps + 1), *range(p.steps - 1, -1, -1))]
    return [Visit(dict.fromkeys(p.chambers, pressure), p.hold) for pressure in levels]


def plan(p):
    return plan_of("staircase", visits(p), Sweep(repeats=p.repeats))


def run(bench, p, trials):
    go_through(bench, trials, visits(p), Sweep(repeats=p.repeats))
