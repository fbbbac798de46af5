"""Visits and the bending sweep are one way from state to state."""

from protocols.bending import Bending
from protocols.bending import plan as bending_plan
from protocols.experiment import Plan, Reading
from protocols.visits import Sweep, Visit, plan_of

GROUP = [3, 4, 5]
LEVELS = [0.0, 40e3, 70e3, 40e3, 0.0]


def reads(plan: Plan) -> list[tuple[float, tuple[Reading, ...]]]:
    """Of each step that reads: its duration (s), and what it reads."""
    return [(step.seconds, step.reads) for step in plan.steps if step.reads]


def test_settled_states_are_planned_as_those_of_a_bending_sweep() -> None:
    sweep = Bending(pressures=[40e3, 70e3], chambers=GROUP, spine_lengths=[0.0], repeats=2)
    own = plan_of("own", [Visit(dict.fromkeys(GROUP, level)) for level in LEVELS], Sweep(repeats=2))
    assert reads(own) == reads(bending_plan(sweep)) and len(reads(own)) == 2 * len(LEVELS)


def test_a_step_from_chamber_to_chamber_takes_its_ramp() -> None:
    own = plan_of("own", [Visit({1: 50e3}, 10.0), Visit({2: 50e3}, 10.0)], Sweep(rate=10e3))
    (_, first), (second_s, second) = reads(own)
    assert second_s == 5.0 + 10.0 + 2.0  # ramp, hold, average
    assert (first[0].rate, abs(second[0].rate)) == (10e3, 10e3)
