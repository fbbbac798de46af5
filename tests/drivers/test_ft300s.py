"""The FT 300-S driver through pymodbus and pyserial, against the fake sensor."""

import numpy as np
import pytest

import timing
from drivers.errors import DeviceFault, StaleReading, Unreachable, WrongDevice
from drivers.ft300s.driver import FT300S, Config
from drivers.interfaces import WrenchSample
from sim_fakes.ft300s import Ft300sFake
from sim_fakes.plant import Plant
from tests.simulated.bench import Bench, of_speed, wait_until

pytestmark = of_speed(1.0)  # at the sensor's own speed

TOOL = (1.5, -2.25, 30.0, 0.125, -0.5, 1.0)
"""N and N m, what the fake's tool weighs."""


@pytest.fixture
def fake(bench: Bench) -> Ft300sFake:
    return bench.started(Ft300sFake(bench.plant, bench.clock, seed=1))


@pytest.fixture
def samples() -> list[WrenchSample]:
    return []


@pytest.fixture
def sensor(bench: Bench, fake: Ft300sFake, samples: list[WrenchSample]) -> FT300S:
    return bench.closing(FT300S("force", Config(port=fake.port, timeout=2.0), bench.clock, samples.append))


def test_every_frame_reaches_the_sink_in_order_and_none_is_lost(sensor: FT300S, samples: list[WrenchSample]) -> None:
    sensor.open()
    wait_until(lambda: len(samples) >= 60)
    assert sensor.lost == 0
    times = [sample.t for sample in samples]
    assert times == sorted(times)


def test_zero_takes_the_tools_weight_off_and_keeps_the_raw_reading(sensor: FT300S) -> None:
    sensor.open()
    zero = sensor.zero(20)
    wait_until(lambda: sensor.latest().zero == zero)
    sample = sensor.latest()
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


def test_a_stream_left_running_behind_an_echoing_adapter_is_stopped(sensor: FT300S, fake: Ft300sFake) -> None:
    fake.device.streaming, fake.faults.echo = True, True
    sensor.open()
    sensor.latest()


def test_identity_comes_from_the_registers(sensor: FT300S, fake: Ft300sFake) -> None:
    fake.device.number, fake.device.version, fake.device.year = 70_001, (3, 1, 4), 2024
    identity = sensor.open()
    assert (identity.serial, identity.firmware, identity.model) == ("FTS-70001", "FTS-3.1.4", "FT 300-S (2024)")


def test_a_sensor_left_streaming_by_a_host_that_died_is_stopped_and_opened(sensor: FT300S, fake: Ft300sFake) -> None:
    fake.device.streaming = True
    timing.sleep(0.1)
    assert sensor.open().serial == "FTS-1234"
    assert sensor.latest().raw[2] == pytest.approx(30.0, abs=1.0)


def test_closing_ends_the_stream(sensor: FT300S, fake: Ft300sFake) -> None:
    sensor.open()
    assert fake.device.streaming
    sensor.close()
    assert not fake.device.streaming


def test_the_stream_is_found_again_after_garbage(sensor: FT300S, fake: Ft300sFake, samples: list[WrenchSample]) -> None:
    fake.device.noise[:] = 0.0
    sensor.open()
    fake.faults.garbage, fake.faults.split = b"\x20\x4e\x00", True
    wait_until(lambda: len(samples) > 40)
    assert {sample.raw for sample in samples} == {TOOL}


def test_frames_that_never_come_are_counted(sensor: FT300S, fake: Ft300sFake) -> None:
    sensor.open()
    fake.faults.extra["drop"] = 2
    wait_until(lambda: sensor.lost >= 15)


def test_the_speed_of_the_rigs_clock_does_not_count_as_loss(bench: Bench, sensor: FT300S, samples: list[WrenchSample]) -> None:
    bench.clock.speed = 50.0
    sensor.open()
    wait_until(lambda: len(samples) >= 60)
    assert sensor.lost < 10 * len(samples)  # by the rig's clock 49 of 50 were lost; by the host's, what came late


@pytest.mark.parametrize(("axis", "named"), [(2, "fz = 327.67 N .* 300 N"), (4, "my = 32.77 N m .* 30 N m")])
def test_a_reading_beyond_the_range_is_a_fault_that_names_the_axis(
    sensor: FT300S, fake: Ft300sFake, samples: list[WrenchSample], axis: int, named: str
) -> None:
    sensor.open()
    fake.faults.extra["over_range"] = axis
    wait_until(lambda: abs(samples[-1].raw[axis]) > 32)
    with pytest.raises(DeviceFault, match=named):
        sensor.latest()


def test_a_stream_that_stops_makes_the_reading_stale_and_zero_ends_in_time(sensor: FT300S, fake: Ft300sFake) -> None:
    sensor.open()
    fake.faults.silent = True
    timing.sleep(0.2)
    with pytest.raises(StaleReading, match=r"newest frame is 0\.\d+ s old, limit 0\.1 s"):
        sensor.latest()
    with pytest.raises(StaleReading, match="of 5 frames arrived"):
        sensor.zero(5)


def test_a_cable_pulled_out_is_unreachable_and_closing_is_still_quiet(sensor: FT300S, fake: Ft300sFake) -> None:
    sensor.open()
    fake.stop()
    with pytest.raises(Unreachable, match="lost"):
        sensor.zero(5)
    sensor.close()


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
    with pytest.raises(error, match=message):
        sensor.open()


def test_a_silent_sensor_is_unreachable_and_the_message_says_what_to_check(bench: Bench, fake: Ft300sFake) -> None:
    fake.device.device_id = 5
    sensor = FT300S("force", Config(port=fake.port, timeout=0.2), bench.clock, lambda sample: None)
    with pytest.raises(Unreachable, match="no answer from Modbus device 9.*24 V"):
        sensor.open()
