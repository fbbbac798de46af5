"""The few things every experiment does, with real drivers on fake instruments."""

from pathlib import Path
from typing import Any, cast

import pytest

from drivers.numato.driver import Config as ValveConfig
from drivers.numato.driver import NumatoValve
from drivers.pfeiffer.driver import Config as GaugeConfig
from drivers.pfeiffer.driver import PfeifferGauge
from protocols.actions import release
from protocols.bench import Bench as Tools
from protocols.parameters import Jam
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
