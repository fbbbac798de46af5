"""The few things every experiment does, with real drivers on fake instruments."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from drivers.numato.driver import Config as ValveConfig
from drivers.numato.driver import NumatoValve
from drivers.pfeiffer.driver import Config as GaugeConfig
from drivers.pfeiffer.driver import PfeifferGauge
from protocols.actions import release
from protocols.bench import Bench
from protocols.parameters import Jam
from recordings.file.writer import Recorder
from sim_fakes.numato import NumatoFake
from sim_fakes.pfeiffer import PfeifferFake
from sim_fakes.plant import AMBIENT, Plant
from tests.simulated.clock import SimulatedClock
from timing import RigClock

SPEED = 20.0


@pytest.fixture
def gauge(simulated: SimulatedClock) -> Iterator[PfeifferFake]:
    fake = PfeifferFake(Plant(), RigClock(SPEED), seed=4)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def bench(gauge: PfeifferFake, tmp_path: Path) -> Iterator[Bench]:
    """Valve and gauge of a rig; nobody at it."""
    module = NumatoFake(gauge.plant, RigClock(SPEED), relays=16, valve=0)
    module.start()
    clock = RigClock(SPEED)
    with Recorder(tmp_path / "run.mcap", start_wall_ns=10**18) as recorder:
        bench = Bench(
            clock, recorder, *cast(Any, (None,) * 6),
            valve=NumatoValve("valve", ValveConfig(port=module.port, relay=0), clock),
            gauge=PfeifferGauge("gauge", GaugeConfig(port=gauge.port, timeout=1.0), clock),
        )  # fmt: skip
        drivers = cast(Any, (bench.valve, bench.gauge))
        for driver in drivers:
            driver.open()
        yield bench
        for driver in drivers:
            driver.close()
    module.stop()


def test_a_slow_gauge_is_judged_over_as_long_as_its_readings_take(bench: Bench, gauge: PfeifferFake) -> None:
    gauge.faults.delay = 0.08  # host s, 1.6 s of the rig: two readings in the rest of 2 s
    assert release(bench, Jam(rest=2.0, within=30.0)) == pytest.approx(AMBIENT, rel=0.01)
