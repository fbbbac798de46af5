"""The FT 300-S driver through pymodbus and pyserial, against the fake sensor: its stream, its zero, and frames made up here."""

import math
import random
import struct
from collections.abc import Callable

import numpy as np
import pytest
from pymodbus.framer import FramerRTU

import timing
from drivers.errors import DeviceFault, NotReady, StaleReading, Unreachable, WrongDevice
from drivers.ft300s.driver import FT300S, Config
from drivers.ft300s.stream import FrameParser, GapCounter, unrest
from drivers.interfaces import WrenchSample
from sim_fakes.ft300s import COUNTS, PERIOD, Ft300sDevice, Ft300sFake
from sim_fakes.plant import Plant
from tests.simulated.bench import Bench, raises, repeated, started_fake, wait_until

pytestmark = pytest.mark.speed(1.0)  # at the sensor's own speed

TOOL = (1.5, -2.25, 30.0, 0.125, -0.5, 1.0)
"""N and N m, what the fake's tool weighs, and what GOOD says."""
fake = started_fake(Ft300sFake, seed=1)


@pytest.fixture
def samples() -> list[WrenchSample]:
    return []


@pytest.fixture
def sensor(bench: Bench, fake: Ft300sFake, samples: list[WrenchSample]) -> FT300S:
    return bench.closing(FT300S("force", Config(port=fake.port, timeout=2.0), bench.clock, samples.append))


@pytest.fixture
def opened(sensor: FT300S) -> FT300S:
    sensor.open()
    return sensor


def test_every_frame_reaches_the_sink_in_order_and_none_is_lost(opened: FT300S, samples: list[WrenchSample]) -> None:
    wait_until(lambda: len(samples) >= 60)
    assert opened.lost == 0
    times = [sample.t for sample in samples]
    assert times == sorted(times)


def test_zero_takes_the_tools_weight_off_and_keeps_the_raw_reading(opened: FT300S) -> None:
    zero = opened.zero(20)
    wait_until(lambda: opened.latest().zero == zero)
    sample = opened.latest()
    assert np.allclose(sample.wrench[:3], 0.0, atol=0.5)
    assert np.allclose(sample.wrench[3:], 0.0, atol=0.025)
    assert np.allclose(sample.raw, np.add(sample.wrench, zero))


def test_force_is_turned_into_the_sensor_frame_with_its_moment(sensor: FT300S, fake: Ft300sFake, plant: Plant) -> None:
    fake.device.bias[:] = 0.0
    fake.device.lever = np.array([0.0, 0.02, 0.1])
    # the tool points along base -x, its x axis along base z
    plant.probe_rotation = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    plant.probe_force = np.array([12.0, -3.0, 5.0])
    sensor.open()
    raw = sensor.zero(30)
    assert np.allclose(raw[:3], [5.0, -3.0, -12.0], atol=0.1)
    assert np.allclose(raw[3:], np.cross([0.0, 0.02, 0.1], [5.0, -3.0, -12.0]), atol=0.005)


def test_identity_comes_from_the_registers(sensor: FT300S, fake: Ft300sFake) -> None:
    fake.device.number, fake.device.version, fake.device.year = 70_001, (3, 1, 4), 2024
    identity = sensor.open()
    assert (identity.serial, identity.firmware, identity.model) == ("FTS-70001", "FTS-3.1.4", "FT 300-S (2024)")


@pytest.mark.parametrize("echo", [False, True], ids=["", "behind an echoing adapter"])
def test_a_sensor_left_streaming_by_a_host_that_died_is_stopped_and_opened(sensor: FT300S, fake: Ft300sFake, echo: bool) -> None:
    fake.device.streaming, fake.faults.echo = True, echo
    timing.sleep(0.1)
    assert sensor.open().serial == "FTS-1234"
    assert sensor.latest().raw[2] == pytest.approx(30.0, abs=1.0)


def test_closing_ends_the_stream(opened: FT300S, fake: Ft300sFake) -> None:
    assert fake.device.streaming
    opened.close()
    assert not fake.device.streaming


def test_the_stream_is_found_again_after_garbage(sensor: FT300S, fake: Ft300sFake, samples: list[WrenchSample]) -> None:
    fake.device.noise[:] = 0.0
    sensor.open()
    fake.faults.garbage, fake.faults.split = b"\x20\x4e\x00", True
    wait_until(lambda: len(samples) > 40)
    assert {sample.raw for sample in samples} == {TOOL}


def test_frames_that_never_come_are_counted(opened: FT300S, fake: Ft300sFake) -> None:
    fake.faults.extra["drop"] = 2
    wait_until(lambda: opened.lost >= 15)


def test_the_speed_of_the_rigs_clock_does_not_count_as_loss(bench: Bench, sensor: FT300S, samples: list[WrenchSample]) -> None:
    bench.clock.speed = 50.0
    sensor.open()
    wait_until(lambda: len(samples) >= 60)
    assert sensor.lost < 10 * len(samples)  # by the rig's clock 49 of 50 were lost; by the host's, what came late


@pytest.mark.parametrize(("axis", "named"), [(2, "fz = 327.67 N .* 300 N"), (4, "my = 32.77 N m .* 30 N m")])
def test_a_reading_beyond_the_range_is_a_fault_that_names_the_axis(
    opened: FT300S, fake: Ft300sFake, samples: list[WrenchSample], axis: int, named: str
) -> None:
    fake.faults.extra["over_range"] = axis
    wait_until(lambda: abs(samples[-1].raw[axis]) > 32)
    raises(DeviceFault, named, opened.latest)


def test_a_stream_that_stops_makes_the_reading_stale_and_zero_ends_in_time(opened: FT300S, fake: Ft300sFake) -> None:
    fake.faults.silent = True
    timing.sleep(0.2)
    raises(StaleReading, r"newest frame is 0\.\d+ s old, limit 0\.1 s", opened.latest)
    raises(StaleReading, "of 5 frames arrived", opened.zero, 5)


def test_a_cable_pulled_out_is_unreachable_and_closing_is_still_quiet(opened: FT300S, fake: Ft300sFake) -> None:
    fake.stop()
    raises(Unreachable, "lost", opened.zero, 5)
    opened.close()


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        ({"foreign": "GRP"}, WrongDevice, "'GRP'"),
        ({"exception": 2}, WrongDevice, "no registers 500 to 502"),
        ({"no_stream": True}, Unreachable, "no complete frame"),
        ({"endless": True}, WrongDevice, "cannot be stopped"),
    ],
)
def test_what_cannot_be_used_is_refused_with_a_reason(
    sensor: FT300S, fake: Ft300sFake, fault: dict[str, object], error: type[Exception], message: str
) -> None:
    fake.faults.extra.update(fault)
    fake.device.streaming = "endless" in fault
    raises(error, message, sensor.open)


def test_a_silent_sensor_is_unreachable_and_the_message_says_what_to_check(bench: Bench, fake: Ft300sFake) -> None:
    fake.device.device_id = 5
    sensor = FT300S("force", Config(port=fake.port, timeout=0.2), bench.clock, lambda sample: None)
    raises(Unreachable, "no answer from Modbus device 9.*24 V", sensor.open)


# -- its zero is refused while force or moment change, and never while it is at rest
Load = Callable[[float], tuple[float, float, float]]
"""Force on the probe's tip, N, by time in s."""


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
    opened: FT300S, fake: Ft300sFake, load: Load, lever: float, named: str
) -> None:
    fake.device.lever = np.array([0.0, 0.0, lever])
    rest, start = opened.zero(100), timing.now()

    def change() -> None:
        with fake.device.plant.lock:
            fake.device.plant.probe_force[:] = load(timing.now() - start)

    with repeated(change, PERIOD / 2), pytest.raises(NotReady, match=rf"no zero taken.*{named}, limit .*hang free"):
        opened.zero(100)
    assert opened.latest().zero == rest


def test_a_sensor_at_rest_is_never_refused() -> None:
    device = Ft300sDevice(Plant(9), np.random.default_rng(7), np.array([0.0, 0.0, 0.1]))
    for samples, times in ((2, 300), (5, 300), (20, 200), (100, 200)):
        for _ in range(times):
            assert not unrest([tuple(device.counts() / COUNTS) for _ in range(samples)])


def test_a_zero_of_one_reading_is_taken_as_it_is(opened: FT300S) -> None:
    assert opened.zero(1) == pytest.approx(TOOL, abs=1.0)


@pytest.mark.parametrize(("fault", "says"), [("stuck", "20 readings are the same"), ("over_range", "fz .* beyond the range")])
def test_no_zero_is_taken_of_a_sensor_that_shows_no_force(opened: FT300S, fake: Ft300sFake, fault: str, says: str) -> None:
    rest = opened.zero(20)
    fake.faults.extra[fault] = {"stuck": True, "over_range": 2}[fault]
    timing.sleep(0.1)
    raises(DeviceFault, says, opened.zero, 20)
    fake.faults.extra.clear()
    timing.sleep(0.1)
    assert opened.latest().zero == rest


def test_a_zero_ends_with_the_connection(opened: FT300S) -> None:
    opened.zero(20)
    opened.open()
    assert opened.latest().zero == (0.0,) * 6


# -- frames and losses
STEP = 0.01


def frame(*counts: int) -> bytes:
    body = b"\x20\x4e" + struct.pack("<6h", *counts)
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


GOOD = frame(150, -225, 3000, 125, -500, 1000)


def test_a_known_frame_gives_its_wrench_in_newton_and_newton_metre() -> None:
    # counts and CRC worked out by hand from the definition of the frame
    assert FrameParser().feed(bytes.fromhex("204e96001fffb80b7d000cfee803") + GOOD[14:]) == [TOOL]


@pytest.mark.parametrize("cut", range(1, 16))
def test_a_frame_may_arrive_in_pieces(cut: int) -> None:
    parser = FrameParser()
    assert parser.feed(GOOD[:cut]) + parser.feed(GOOD[cut:] + GOOD[:3]) == [TOOL]


def test_the_head_inside_the_data_does_not_mislead() -> None:
    inner = frame(0x4E20, 0x4E20, 0x4E20, 0x4E20, 0x4E20, 0x4E20)
    parser = FrameParser()
    assert len(parser.feed(inner[5:] + inner * 20)) == 20
    assert parser.damaged == 0


@pytest.mark.parametrize(
    ("between", "damaged"),
    [(b"", 0), (b"\x00\xff\x20", 0), (GOOD[:9] + b"\x99" + GOOD[10:], 1), (GOOD[:15], 1), ((GOOD[:-1] + b"\x00") * 5, 5)],
)
def test_damaged_frames_are_counted_stray_bytes_are_not(between: bytes, damaged: int) -> None:
    parser = FrameParser()
    assert len(parser.feed(GOOD + between + GOOD)) == 2
    assert parser.damaged == damaged


RNG = random.Random(4)
GONE = set(RNG.sample(range(200, 2800), 60))
STEADY = [i * STEP for i in range(3000)]


@pytest.mark.parametrize(
    ("times", "missing"),
    [
        pytest.param([t * 0.99 for t in STEADY], 0, id="steady, of a clock that is fast"),
        pytest.param(STEADY, 0, id="steady"),
        pytest.param([t * 1.01 for t in STEADY], 0, id="steady, of a clock that is slow"),
        pytest.param([(i // 4 * 4 + 4) * STEP + i % 4 * 1e-3 for i in range(2000)], 0, id="in bursts"),
        pytest.param(sorted(t + RNG.uniform(0, 0.02) for t in STEADY), 0, id="jitter"),
        pytest.param([max(t, 11.0) if t > 10.0 else t for t in STEADY], 0, id="the host stood still for a second"),
        pytest.param([i * STEP + RNG.uniform(0, 0.003) for i in range(3000) if i not in GONE], 60, id="single ones are missing"),
        pytest.param([t for i, t in enumerate(STEADY[:1000]) if not 300 <= i < 650], 350, id="a long gap"),
    ],
)
def test_frames_that_are_missing_are_counted_and_what_comes_late_is_not(times: list[float], missing: int) -> None:
    counter = GapCounter()
    for t in times:
        counter.arrived(t, 0)
    assert counter.missing == missing


def test_frames_known_as_damaged_are_not_counted_as_missing_too() -> None:
    counter = GapCounter()
    for i in range(1000):
        if i % 10 != 9:
            counter.arrived(i * STEP, damaged=1 if i % 10 == 0 and i else 0)
    assert counter.missing == 0
