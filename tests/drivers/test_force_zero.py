"""The zero of the force sensor is refused while force or moment change, and never while the sensor is at rest."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

import timing
from drivers.errors import NotReady
from drivers.ft300s.driver import FT300S, Config
from drivers.ft300s.rest import unrest
from sim_fakes.ft300s import COUNTS, PERIOD, Ft300sDevice, Ft300sFake
from sim_fakes.plant import Plant
from timing import RigClock

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
def fake() -> Iterator[Ft300sFake]:
    fake = Ft300sFake(Plant(9), RigClock(1.0), seed=3)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def sensor(fake: Ft300sFake) -> Iterator[FT300S]:
    sensor = FT300S("force", Config(port=fake.port, timeout=2.0), fake.clock, lambda sample: None)
    sensor.open()
    yield sensor
    sensor.close()


@pytest.mark.parametrize(
    ("load", "named"),
    [
        (lambda t: (0.0, 0.0, 10 * t), "fz"),
        (lambda t: (0.5 * t, 0.0, 0.0), "fx"),
        (lambda t: (0.0, math.sin(4 * math.pi * t), 0.0), "fy"),
        (lambda t: (0.0, 0.0, 1.0 if t > 0.5 else 0.0), "fz"),
    ],
    ids=["lean", "slow drift", "swing", "step"],
)
def test_no_zero_is_taken_while_the_force_changes(sensor: FT300S, fake: Ft300sFake, load: Load, named: str) -> None:
    fake.device.lever = np.zeros(3)  # the moments stay
    rest = sensor.zero(100)
    with changing(fake, load), pytest.raises(NotReady, match=rf"no zero taken.*{named} .* N, limit .*hang free"):
        sensor.zero(100)
    assert sensor.latest().zero == rest


def test_no_zero_is_taken_while_a_moment_changes(sensor: FT300S, fake: Ft300sFake) -> None:
    fake.device.lever = np.array([0.0, 0.0, 2.0])  # the force itself stays within the noise
    with changing(fake, lambda t: (0.08 * t, 0.0, 0.0)), pytest.raises(NotReady, match=r"my .* N m, limit"):
        sensor.zero(100)


def test_a_sensor_at_rest_is_never_refused(fake: Ft300sFake) -> None:
    device = Ft300sDevice(Plant(9), np.random.default_rng(7), np.array([0.0, 0.0, 0.1]))
    for samples, times in ((2, 300), (5, 300), (20, 200), (100, 200)):
        for _ in range(times):
            readings = [tuple(device.counts() / COUNTS) for _ in range(samples)]
            assert not unrest(readings)


def test_a_zero_of_one_reading_is_taken_as_it_is(sensor: FT300S) -> None:
    assert sensor.zero(1) == pytest.approx((1.5, -2.25, 30.0, 0.125, -0.5, 1.0), abs=1.0)
