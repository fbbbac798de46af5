"""What every experiment does, with real drivers on fakes; visits and the sweep are one way between states."""

from pathlib import Path
from typing import Any, cast

import pytest

from drivers.numato.driver import Config as ValveConfig
from drivers.numato.driver import NumatoValve
from drivers.pfeiffer.driver import Config as GaugeConfig
from drivers.pfeiffer.driver import PfeifferGauge
from protocols.actions import release
from protocols.bench import Bench as Tools
from protocols.bending import Bending
from protocols.bending import plan as bending_plan
from protocols.experiment import Plan, Reading
from protocols.parameters import Jam
from protocols.visits import Sweep, Visit, plan_of
from recordings.file.writer import Recorder
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import AMBIENT
from tests.simulated.bench import Bench
from tests.simulated.clock import SimulatedClock


def test_a_slow_gauge_is_judged_over_as_long_as_its_readings_take(
    simulated: SimulatedClock, bench: Bench, tmp_path: Path
) -> None:
    fake = bench.started(PfeifferFake(bench.plant, bench.clock, seed=4))
    module = bench.started(NumatoFake(bench.plant, bench.clock))
    valve = bench.closing(NumatoValve("valve", ValveConfig(port=module.port, relay=0), bench.clock))
    gauge = bench.closing(PfeifferGauge("gauge", GaugeConfig(port=fake.port, timeout=1.0), bench.clock))
    for driver in (valve, gauge):
        driver.open()
    fake.faults.delay = 0.08  # host s, 1.6 s of the rig: two readings in the rest of 2 s
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder:
        tools = Tools(bench.clock, recorder, *cast(Any, (None,) * 6), valve=valve, gauge=gauge)
        assert release(tools, Jam(rest=2.0, within=30.0)) == pytest.approx(AMBIENT, rel=0.01)


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
