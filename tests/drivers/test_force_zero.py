"""The zero of the force sensor is refused while force or moment change, and never while the sensor is at rest."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

import timing
from drivers.errors import DeviceFault, NotReady
from drivers.ft300s.driver import FT300S, Config
from drivers.ft300s.stream import unrest
from sim_fakes.ft300s import COUNTS, PERIOD, Ft300sDevice, Ft300sFake
from sim_fakes.plant import Plant
from tests.simulated.bench import Bench, of_speed

pytestmark = of_speed(1.0)  # at the sensor's own speed

Load = Callable[[float], tuple[float, float, float]]
"""Force on the probe's tip, N, by time in s."""


@contextmanager
def changing(fake: Ft300sFake, load: Load) -> Iterator[None]:
    """The load on the tip changes until the block ends; it has begun when the block is entered."""
    began, end, start = timing.Event(), timing.Event(), timing.now()

    def change() -> None:
        while not end.is_set():
            with fake.device.plant.lock:
                fake.device.plant.probe_force[:] = load(timing.now() - start)
            began.set()
            timing.sleep(PERIOD / 2)

    thread = timing.Thread(target=change)
    thread.start()
    began.wait()
    try:
        yield
    finally:
        end.set()
        thread.join()


@pytest.fixture
def fake(bench: Bench) -> Ft300sFake:
    return bench.started(Ft300sFake(bench.plant, bench.clock, seed=3))


@pytest.fixture
def sensor(bench: Bench, fake: Ft300sFake) -> FT300S:
    sensor = bench.closing(FT300S("force", Config(port=fake.port, timeout=2.0), bench.clock, lambda sample: None))
    sensor.open()
    return sensor


@pytest.mark.parametrize(
    ("load", "lever", "named"),
    [
        (lambda t: (0.0, 0.0, 10 * t), 0.0, "fz .* N"),
        (lambda t: (0.5 * t, 0.0, 0.0), 0.0, "fx .* N"),
        (lambda t: (0.0, math.sin(4 * math.pi * t), 0.0), 0.0, "fy .* N"),
        (lambda t: (0.0, 0.0, 1.0 if t > 0.5 else 0.0), 0.0, "fz .* N"),
        (lambda t: (0.08 * t, 0.0, 0.0), 2.0, "my .* N m"),  # the force itself stays within the noise
    ],
    ids=["lean", "slow drift", "swing", "step", "moment"],
)
def test_no_zero_is_taken_while_force_or_moment_change(
    sensor: FT300S, fake: Ft300sFake, load: Load, lever: float, named: str
) -> None:
    fake.device.lever = np.array([0.0, 0.0, lever])
    rest = sensor.zero(100)
    with changing(fake, load), pytest.raises(NotReady, match=rf"no zero taken.*{named}, limit .*hang free"):
        sensor.zero(100)
    assert sensor.latest().zero == rest


def test_a_sensor_at_rest_is_never_refused(bench: Bench) -> None:
    device = Ft300sDevice(Plant(9), np.random.default_rng(7), np.array([0.0, 0.0, 0.1]))
    for samples, times in ((2, 300), (5, 300), (20, 200), (100, 200)):
        for _ in range(times):
            readings = [tuple(device.counts() / COUNTS) for _ in range(samples)]
            assert not unrest(readings)


def test_a_zero_of_one_reading_is_taken_as_it_is(sensor: FT300S) -> None:
    assert sensor.zero(1) == pytest.approx((1.5, -2.25, 30.0, 0.125, -0.5, 1.0), abs=1.0)


@pytest.mark.parametrize(("fault", "says"), [("stuck", "20 readings are the same"), ("over_range", "fz .* beyond the range")])
def test_no_zero_is_taken_of_a_sensor_that_shows_no_force(sensor: FT300S, fake: Ft300sFake, fault: str, says: str) -> None:
    rest = sensor.zero(20)
    fake.faults.extra[fault] = {"stuck": True, "over_range": 2}[fault]
    timing.sleep(0.1)
    with pytest.raises(DeviceFault, match=says):
        sensor.zero(20)
    fake.faults.extra.clear()
    timing.sleep(0.1)
    assert sensor.latest().zero == rest


def test_a_zero_ends_with_the_connection(sensor: FT300S) -> None:
    """The sensor may have been without power since, or be another one."""
    sensor.zero(20)
    sensor.open()
    assert sensor.latest().zero == (0.0,) * 6
