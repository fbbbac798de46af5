"""Motion capture over NatNet, against the fake Motive."""

import math
import socket
import threading
from typing import Any

import numpy as np
import psutil
import pytest
from natnet_rig import IDENTITY, Make, first, free_host, refused, wait
from pydantic import ValidationError

import timing
from drivers.errors import DeviceFault, NotReady, StaleReading, Unreachable, WrongDevice
from drivers.frames import matrix_from_quaternion
from drivers.interfaces import BodySample
from drivers.natnet.config import Pose
from drivers.natnet.driver import Config, NatNetMocap
from sim_fakes.motive import MotiveFake
from sim_fakes.plant import Plant
from timing import RigClock


def test_samples_stream_to_the_sink_one_a_frame(make: Make, samples: list[BodySample]) -> None:
    mocap = make()
    mocap.open()
    wait(lambda: len(samples) > 30)
    numbers = [s.frame for s in samples]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] - numbers[0] == len(numbers) - 1 + mocap.lost
    stamps = [s.device_time for s in samples]
    assert stamps == sorted(stamps)


VERSIONS = ((2, 6), (2, 7), (2, 10), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2))


@pytest.mark.parametrize("fake", [{"version": version} for version in VERSIONS], indirect=True)
def test_the_pose_arrives_in_the_base_frame_for_any_bitstream(make: Make, fake: MotiveFake, plant: Plant) -> None:
    mocap = make(markers=("M1", "M3"))
    mocap.open()
    sample = first(mocap)
    assert sample.valid
    assert sample.position == pytest.approx(plant.tip_position, abs=1e-6)
    assert matrix_from_quaternion(sample.orientation) == pytest.approx(plant.tip_rotation, abs=1e-6)
    assert sample.markers[0] == pytest.approx(plant.markers[0], abs=1e-6)
    assert sample.markers[1] == pytest.approx(plant.markers[2], abs=1e-6)


TILTED = ((0.3, -1.1, 0.7), (0.5, 0.5, -0.5, 0.5))


@pytest.mark.parametrize("fake", [{"mocap_to_base": TILTED}], indirect=True)
def test_the_frame_of_the_cameras_is_a_matter_of_calibration(make: Make, fake: MotiveFake, plant: Plant) -> None:
    plant.tip_position = np.array([0.1, 0.2, 0.3])
    right = make()
    right.open()
    assert first(right).position == pytest.approx((0.1, 0.2, 0.3), abs=1e-6)
    raw = make(mocap_to_base=Pose(**IDENTITY))
    raw.open()
    seen = matrix_from_quaternion(TILTED[1]).T @ (np.array([0.1, 0.2, 0.3]) - np.array(TILTED[0]))
    assert first(raw).position == pytest.approx(seen, abs=1e-6)


@pytest.mark.parametrize("fake", [{"noise": 0.3e-3, "angle_noise": math.radians(0.2), "rate": 400.0}], indirect=True)
def test_noise_has_the_size_of_the_cameras(make: Make, fake: MotiveFake, plant: Plant, samples: list[BodySample]) -> None:
    mocap = make()
    mocap.open()
    wait(lambda: len(samples) > 300)
    positions = np.array([s.position for s in samples[:300]])
    assert positions.std(axis=0) == pytest.approx(np.full(3, 0.3e-3), rel=0.25)
    assert positions.mean(axis=0) == pytest.approx(plant.tip_position, abs=1e-4)


def test_a_hidden_tip_is_delivered_as_invalid_and_latest_refuses(
    make: Make, fake: MotiveFake, plant: Plant, samples: list[BodySample]
) -> None:
    mocap = make()
    mocap.open()
    first(mocap)
    seen = plant.tip_position.copy()
    with plant.lock:
        plant.tip_visible = False
        plant.tip_position = seen + 0.1
    wait(lambda: bool(samples) and not samples[-1].valid)
    assert samples[-1].position == pytest.approx(seen, abs=1e-6)
    refused(mocap, DeviceFault, "has not been tracked for")
    plant.tip_visible = True
    wait(lambda: samples[-1].valid)
    assert first(mocap).position == pytest.approx(seen + 0.1, abs=1e-6)


def test_a_body_never_tracked_is_told_apart_from_a_silent_server(make: Make, fake: MotiveFake, plant: Plant) -> None:
    plant.tip_visible = False
    timing.sleep(0.05)
    mocap = make()
    mocap.open()
    refused(mocap, DeviceFault, "since the start")


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        ("nan", "cannot be true"),
        ("absurd", "cannot be true"),
        ("zeros", "view of it"),
        ("no_body", "stream rigid bodies"),
    ],
)
def test_values_that_cannot_be_true_are_invalid(
    make: Make, fake: MotiveFake, plant: Plant, samples: list[BodySample], fault: str, remedy: str
) -> None:
    mocap = make()
    mocap.open()
    first(mocap)
    plant.tip_visible = fault != "zeros"
    fake.faults.extra[fault] = True
    wait(lambda: bool(samples) and not samples[-1].valid)
    refused(mocap, DeviceFault, remedy)


def test_bodies_at_one_place_are_none_of_them(make: Make, fake: MotiveFake, plant: Plant, samples: list[BodySample]) -> None:
    mocap = make(markers=("M1", "M2"))
    mocap.open()
    first(mocap)
    plant.tip_position = plant.markers[0].copy()
    wait(lambda: bool(samples) and not samples[-1].valid)
    assert all(math.isnan(part) for part in samples[-1].markers[0]) and math.isfinite(samples[-1].markers[1][0])
    refused(mocap, DeviceFault, "'Tip' and 'M1' at the same place")


def test_a_marker_that_is_not_tracked_has_no_place(make: Make, fake: MotiveFake, plant: Plant) -> None:
    plant.markers = plant.markers[:1]
    timing.sleep(0.05)
    mocap = make(markers=("M1", "M2"))
    mocap.open()
    seen, hidden = first(mocap).markers
    assert seen == pytest.approx(plant.markers[0], abs=1e-6)
    assert all(math.isnan(part) for part in hidden)


def test_missing_frames_are_counted(make: Make, fake: MotiveFake, samples: list[BodySample]) -> None:
    mocap = make()
    mocap.open()
    first(mocap)
    before = mocap.lost
    fake.faults.extra["drop"] = 7
    wait(lambda: fake.faults.extra["drop"] == 0)
    count = len(samples)
    wait(lambda: len(samples) > count + 2)
    wait(lambda: mocap.lost > before)
    assert mocap.lost - before == 7


def test_a_replayed_frame_does_not_keep_a_reading_fresh(make: Make, fake: MotiveFake, samples: list[BodySample]) -> None:
    mocap = make()
    mocap.open()
    first(mocap)
    fake.faults.extra["replay"] = True
    refused(mocap, StaleReading, "no frame for")
    count = len(samples)
    timing.sleep(0.1)
    with pytest.raises(StaleReading, match="no frame for"):
        mocap.latest()
    assert len(samples) == count
    assert mocap.lost == 0


def test_a_restarted_count_is_no_loss(make: Make, fake: MotiveFake, samples: list[BodySample]) -> None:
    mocap = make()
    mocap.open()
    wait(lambda: len(samples) > 30)
    before = mocap.lost
    fake.faults.extra["restart"] = True
    wait(lambda: bool(samples) and samples[-1].frame < 20)
    wait(lambda: bool(samples) and samples[-1].frame > 5)
    assert mocap.lost == before
    assert first(mocap).valid


def test_a_damaged_frame_is_dropped_and_counted_and_the_stream_goes_on(
    make: Make, fake: MotiveFake, samples: list[BodySample], capsys: pytest.CaptureFixture[str]
) -> None:
    mocap = make()
    mocap.open()
    first(mocap)
    fake.faults.truncate = True
    at = fake.frame
    wait(lambda: fake.frame > at + 5)
    fake.faults.truncate = False
    damaged = fake.frame - at + 1
    wait(lambda: mocap.lost >= 4)
    count = len(samples)
    wait(lambda: len(samples) > count + 3)
    assert mocap.lost <= damaged + 1
    assert first(mocap).valid


def test_a_server_gone_silent_makes_readings_stale(make: Make, fake: MotiveFake) -> None:
    mocap = make()
    mocap.open()
    first(mocap)
    fake.faults.silent = True
    refused(mocap, StaleReading, "Motive")
    fake.faults.silent = False
    first(mocap)


@pytest.mark.parametrize("server", ["a" * 200, "255.255.255.255"])
def test_a_server_that_cannot_be_reached_is_told_with_its_name(server: str) -> None:
    config = Config(server=server, body="Tip", mocap_to_base=Pose(**IDENTITY), timeout=0.3)
    with pytest.raises(Unreachable, match=server):
        NatNetMocap("mocap", config, RigClock(), lambda _: None).open()


def test_a_local_address_that_is_not_ours_is_unreachable(make: Make, fake: MotiveFake) -> None:
    with pytest.raises(Unreachable, match="192.0.2.1"):
        make(local="192.0.2.1").open()


def test_an_unknown_body_is_reported_with_the_nearest_name(make: Make, fake: MotiveFake) -> None:
    with pytest.raises(WrongDevice, match="'Tipp'.*nearest name is 'Tip'"):
        make(body="Tipp").open()
    with pytest.raises(WrongDevice, match="'M9'"):
        make(markers=("M9",)).open()


@pytest.mark.parametrize("fake", [{"version": (2, 5)}], indirect=True)
def test_a_server_too_old_is_the_wrong_device(make: Make, fake: MotiveFake) -> None:
    with pytest.raises(WrongDevice, match=r"NatNet 2\.5"):
        make().open()


def test_what_does_not_speak_natnet_is_the_wrong_device() -> None:
    host = free_host()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((host, 1510))
        other.settimeout(3)

        def answer() -> None:
            timing.readable([other], 3.0)
            _, client = other.recvfrom(100)
            other.sendto(b"\x01\x00\x02\x00no", client)

        thread = timing.Thread(target=answer)
        thread.start()
        config = Config(server=host, body="Tip", mocap_to_base=Pose(**IDENTITY), timeout=0.5)
        with pytest.raises(WrongDevice, match="not a NatNet server"):
            NatNetMocap("mocap", config, RigClock(), lambda _: None).open()
        thread.join()


def test_close_ends_the_threads_and_the_stream_and_may_be_called_twice(
    make: Make, fake: MotiveFake, samples: list[BodySample]
) -> None:
    mocap = make()
    mocap.close()
    threads = threading.active_count()
    mocap.open()
    first(mocap)
    mocap.close()
    mocap.close()
    assert threading.active_count() == threads
    count = len(samples)
    timing.sleep(0.05)
    assert len(samples) == count
    with pytest.raises(NotReady):
        mocap.latest()


def forged(host: str) -> bytes:
    """A frame as a server would send it, with a tip that is somewhere else."""
    elsewhere = Plant()
    elsewhere.tip_position = np.array([1.5, 1.5, 1.5])
    server = MotiveFake(elsewhere, RigClock(10.0), host=host, noise=0.0, angle_noise=0.0)
    server.frame = 100_000
    server.start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.1", 0))
        client.settimeout(10)
        client.sendto(b"\x00\x00\x05\x00Ping\x00", (host, 1510))
        while (datagram := timing.recv(client, 65536))[:2] != b"\x07\x00":
            pass
    server.stop()
    return datagram


def ports_of(fake: MotiveFake) -> set[tuple[str, int]]:
    """Where this process hears datagrams, the fake left out."""
    heard = {c.laddr for c in psutil.Process().net_connections("udp4")}
    return {(fake.host if a.ip == "0.0.0.0" else a.ip, a.port) for a in heard if a.ip != fake.host}


def test_frames_from_another_address_are_not_taken_and_told_once(
    make: Make, fake: MotiveFake, plant: Plant, samples: list[BodySample]
) -> None:
    told: list[str] = []
    liar = free_host()
    datagram = forged(liar)
    before = ports_of(fake)
    mocap = make(notice=told.append)
    mocap.open()
    first(mocap)
    ears = ports_of(fake) - before
    assert len(ears) == 1, "the client's socket"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((liar, 0))
        for _ in range(5):
            for ear in ears:
                other.sendto(datagram, ear)
        count = len(samples)
        wait(lambda: bool(told) and len(samples) > count + 20)  # datagrams come in their order
    assert all(s.position == pytest.approx(plant.tip_position, abs=1e-6) for s in samples)
    assert len(told) == 1 and liar in told[0] and fake.host in told[0]
    assert mocap.lost < 1000


def test_the_sockets_are_bound_to_the_given_interface_alone(make: Make, fake: MotiveFake) -> None:
    before = ports_of(fake)
    own = free_host()
    make(local=own).open()
    assert {host for host, _ in ports_of(fake) - before} == {own}


def test_an_answer_from_another_address_is_no_server() -> None:
    host, liar = free_host(), free_host()
    told: list[str] = []
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        server.bind((host, 1510))
        server.settimeout(10)
        other.bind((liar, 0))

        def answer() -> None:
            timing.readable([server], 10.0)
            _, client = server.recvfrom(100)
            other.sendto(b"\x01\x00\x17\x01" + b"Motive".ljust(256, b"\0") + bytes((3, 1, 0, 0, 4, 1, 0, 0)) + bytes(15), client)

        thread = timing.Thread(target=answer)
        thread.start()
        config = Config(server=host, body="Tip", mocap_to_base=Pose(**IDENTITY), timeout=0.5)
        with pytest.raises(Unreachable, match=f"no NatNet server.*{liar}"):
            NatNetMocap("mocap", config, RigClock(), lambda _: None, told.append).open()
        thread.join()
    assert len(told) == 1


def test_keep_alive_is_sent_sparingly(make: Make, fake: MotiveFake) -> None:
    """The client alone would send one with every look at its socket."""
    mocap = make()
    mocap.open()
    timing.sleep(0.7)
    wait(lambda: fake.keep_alives >= 1)
    assert fake.keep_alives < 10


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"mocap_to_base": {"position": (0, 0, 0), "quaternion": (1, 1, 0, 0)}}, "length 1"),
        ({"max_age": 0.01}, "two frames"),
        ({"mocap_to_base": None}, "mocap_to_base"),
    ],
)
def test_configurations_that_cannot_work_are_refused(changes: dict[str, Any], complaint: str) -> None:
    values: dict[str, Any] = {"server": "127.0.0.1", "body": "Tip", "mocap_to_base": IDENTITY} | changes
    with pytest.raises(ValidationError, match=complaint):
        Config(**values)
