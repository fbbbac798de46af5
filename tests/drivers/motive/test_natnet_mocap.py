"""Motion capture over NatNet, against the fake Motive."""

import math
import socket
import threading

import numpy as np
import psutil
import pytest
from natnet_rig import Motive, first, refused

import timing
from drivers.errors import DeviceFault, NotReady, StaleReading, Unreachable, WrongDevice
from drivers.frames import matrix_from_quaternion
from drivers.natnet.driver import Config, NatNetMocap
from sim_fakes.motive import MotiveFake
from sim_fakes.plant import Plant
from sim_fakes.ur.process import free_host
from tests.simulated.bench import wait_until
from timing import RigClock

IDENTITY = {"position": (0.0, 0.0, 0.0), "quaternion": (1.0, 0.0, 0.0, 0.0)}


def test_samples_stream_to_the_sink_one_a_frame(motive: Motive) -> None:
    mocap = motive.opened()
    motive.frames(30)
    numbers = [s.frame for s in motive.samples]
    assert numbers == sorted(set(numbers))
    assert numbers[-1] - numbers[0] == len(numbers) - 1 + mocap.lost
    stamps = [s.device_time for s in motive.samples]
    assert stamps == sorted(stamps)


VERSIONS = ((2, 6), (2, 7), (2, 10), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2))


@pytest.mark.parametrize("motive", [{"version": version} for version in VERSIONS], indirect=True)
def test_the_pose_arrives_in_the_base_frame_for_any_bitstream(motive: Motive) -> None:
    sample, plant = first(motive.opened(markers=("M1", "M3"))), motive.plant
    assert sample.valid
    assert sample.position == pytest.approx(plant.tip_position, abs=1e-6)
    assert matrix_from_quaternion(sample.orientation) == pytest.approx(plant.tip_rotation, abs=1e-6)
    assert sample.markers[0] == pytest.approx(plant.markers[0], abs=1e-6)
    assert sample.markers[1] == pytest.approx(plant.markers[2], abs=1e-6)


TILTED = ((0.3, -1.1, 0.7), (0.5, 0.5, -0.5, 0.5))


@pytest.mark.parametrize("motive", [{"mocap_to_base": TILTED}], indirect=True)
def test_the_frame_of_the_cameras_is_a_matter_of_calibration(motive: Motive) -> None:
    motive.plant.tip_position = np.array([0.1, 0.2, 0.3])
    assert first(motive.opened()).position == pytest.approx((0.1, 0.2, 0.3), abs=1e-6)
    seen = matrix_from_quaternion(TILTED[1]).T @ (np.array([0.1, 0.2, 0.3]) - np.array(TILTED[0]))
    assert first(motive.opened(mocap_to_base=IDENTITY)).position == pytest.approx(seen, abs=1e-6)


# -- what cannot be used
def test_a_hidden_tip_is_delivered_as_invalid_and_latest_refuses(motive: Motive) -> None:
    mocap, plant = motive.seen(), motive.plant
    seen = plant.tip_position.copy()
    with plant.lock:
        plant.tip_visible = False
        plant.tip_position = seen + 0.1
    assert motive.invalid().position == pytest.approx(seen, abs=1e-6)
    refused(mocap, DeviceFault, "has not been tracked for")
    plant.tip_visible = True
    wait_until(lambda: motive.samples[-1].valid)
    assert first(mocap).position == pytest.approx(seen + 0.1, abs=1e-6)


def test_a_body_never_tracked_is_told_apart_from_a_silent_server(motive: Motive) -> None:
    motive.plant.tip_visible = False
    timing.sleep(0.05)
    refused(motive.opened(), DeviceFault, "since the start")


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [("nan", "cannot be true"), ("absurd", "cannot be true"), ("zeros", "view of it"), ("no_body", "stream rigid bodies")],
)
def test_values_that_cannot_be_true_are_invalid(motive: Motive, fault: str, remedy: str) -> None:
    mocap = motive.seen()
    motive.plant.tip_visible = fault != "zeros"
    motive.extra[fault] = True
    motive.invalid()
    refused(mocap, DeviceFault, remedy)


def test_bodies_at_one_place_are_none_of_them(motive: Motive) -> None:
    mocap = motive.seen(markers=("M1", "M2"))
    motive.plant.tip_position = motive.plant.markers[0].copy()
    same, other = motive.invalid().markers
    assert all(math.isnan(part) for part in same) and math.isfinite(other[0])
    refused(mocap, DeviceFault, "'Tip' and 'M1' at the same place")


def test_a_marker_that_is_not_tracked_has_no_place(motive: Motive) -> None:
    motive.plant.markers = motive.plant.markers[:1]
    timing.sleep(0.05)
    seen, hidden = first(motive.opened(markers=("M1", "M2"))).markers
    assert seen == pytest.approx(motive.plant.markers[0], abs=1e-6)
    assert all(math.isnan(part) for part in hidden)


# -- frames that are lost, repeated or damaged
def test_missing_frames_are_counted(motive: Motive) -> None:
    mocap = motive.seen()
    before = mocap.lost
    motive.extra["drop"] = 7
    wait_until(lambda: motive.extra["drop"] == 0)
    motive.frames(3)
    wait_until(lambda: mocap.lost > before)
    assert mocap.lost - before == 7


def test_a_replayed_frame_does_not_keep_a_reading_fresh(motive: Motive) -> None:
    mocap = motive.seen()
    motive.extra["replay"] = True
    refused(mocap, StaleReading, "no frame for")
    count = len(motive.samples)
    timing.sleep(0.1)
    with pytest.raises(StaleReading, match="no frame for"):
        mocap.latest()
    assert len(motive.samples) == count and mocap.lost == 0


def test_a_restarted_count_is_no_loss(motive: Motive) -> None:
    mocap = motive.opened()
    motive.frames(30)
    before = mocap.lost
    motive.extra["restart"] = True
    wait_until(lambda: motive.samples[-1].frame < 20)
    wait_until(lambda: motive.samples[-1].frame > 5)
    assert mocap.lost == before
    assert first(mocap).valid


def test_a_damaged_frame_is_dropped_and_counted_and_the_stream_goes_on(motive: Motive) -> None:
    mocap, fake = motive.seen(), motive.fake
    fake.faults.truncate, at = True, fake.frame
    wait_until(lambda: fake.frame > at + 5)
    fake.faults.truncate, damaged = False, fake.frame - at + 1
    wait_until(lambda: mocap.lost >= 4)
    motive.frames(3)
    assert mocap.lost <= damaged + 1
    assert first(mocap).valid


# -- who answers


@pytest.mark.parametrize("motive", [{"version": (2, 5)}], indirect=True)
def test_a_server_too_old_is_the_wrong_device(motive: Motive) -> None:
    with pytest.raises(WrongDevice, match=r"NatNet 2\.5"):
        motive.made().open()


GREETING = b"\x01\x00\x17\x01" + b"Motive".ljust(256, b"\0") + bytes((3, 1, 0, 0, 4, 1, 0, 0)) + bytes(15)


@pytest.mark.parametrize(
    ("said", "elsewhere", "error", "message"),
    [(b"\x01\x00\x02\x00no", False, WrongDevice, "not a NatNet server"), (GREETING, True, Unreachable, "no NatNet server.*{}")],
    ids=["not NatNet", "from another address"],
)
def test_an_answer_that_is_no_server_s_is_not_taken(said: bytes, elsewhere: bool, error: type[Exception], message: str) -> None:
    host, liar, told = free_host(), free_host(), list[str]()
    with socket.socket(type=socket.SOCK_DGRAM) as server, socket.socket(type=socket.SOCK_DGRAM) as other:
        server.bind((host, 1510))
        other.bind((liar, 0))

        def answer() -> None:
            timing.readable([server], 10.0)
            _, client = server.recvfrom(100)
            (other if elsewhere else server).sendto(said, client)

        thread = timing.Thread(target=answer)
        thread.start()
        config = Config.model_validate({"server": host, "body": "Tip", "mocap_to_base": IDENTITY, "timeout": 0.5})
        with pytest.raises(error, match=message.format(liar)):
            NatNetMocap("mocap", config, RigClock(), lambda _: None, told.append).open()
        thread.join()
    assert len(told) == 1


def forged(host: str) -> bytes:
    """A frame as a server would send it, with a tip that is somewhere else."""
    elsewhere = Plant()
    elsewhere.tip_position = np.array([1.5, 1.5, 1.5])
    server = MotiveFake(elsewhere, RigClock(10.0), host=host, noise=0.0, angle_noise=0.0)
    server.frame = 100_000
    server.start()
    with socket.socket(type=socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.1", 0))
        client.sendto(b"\x00\x00\x05\x00Ping\x00", (host, 1510))
        while (datagram := timing.recv(client, 65536))[:2] != b"\x07\x00":
            pass
    server.stop()
    return datagram


def ports_of(fake: MotiveFake) -> set[tuple[str, int]]:
    """Where this process hears datagrams, the fake left out."""
    heard = {c.laddr for c in psutil.Process().net_connections("udp4")}
    return {(fake.host if a.ip == "0.0.0.0" else a.ip, a.port) for a in heard if a.ip != fake.host}


def test_frames_from_another_address_are_not_taken_and_told_once(motive: Motive) -> None:
    liar = free_host()
    datagram, before = forged(liar), ports_of(motive.fake)
    mocap = motive.seen()
    (ear,) = ports_of(motive.fake) - before  # the client's socket
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind((liar, 0))
        for _ in range(5):
            other.sendto(datagram, ear)
        motive.frames(20)  # datagrams come in their order
        wait_until(lambda: bool(motive.told))
    assert all(s.position == pytest.approx(motive.plant.tip_position, abs=1e-6) for s in motive.samples)
    assert len(motive.told) == 1 and liar in motive.told[0] and motive.fake.host in motive.told[0]
    assert mocap.lost < 1000


def test_the_sockets_are_bound_to_the_given_interface_alone(motive: Motive) -> None:
    before, own = ports_of(motive.fake), free_host()
    motive.opened(local=own)
    assert {host for host, _ in ports_of(motive.fake) - before} == {own}


# -- the connection
def test_close_ends_the_threads_and_may_be_called_twice(motive: Motive) -> None:
    mocap = motive.made()
    mocap.close()
    threads = threading.active_count()
    mocap.open()
    first(mocap)
    mocap.close()
    mocap.close()
    assert threading.active_count() == threads
    with pytest.raises(NotReady):
        mocap.latest()


def test_keep_alive_is_sent_sparingly(motive: Motive) -> None:
    """The client alone would send one with every look at its socket."""
    motive.opened()
    timing.sleep(0.7)
    wait_until(lambda: motive.fake.keep_alives >= 1)
    assert motive.fake.keep_alives < 10


@pytest.mark.parametrize("motive", [{"version": (3, 1)}, {"version": (4, 1)}], indirect=True)
def test_a_pose_that_was_old_when_it_was_sent_is_stale(motive: Motive) -> None:
    """Motive that does not keep up with its cameras sends its frames as regularly as ever."""
    mocap = motive.seen()
    motive.extra["behind"] = 3.0
    refused(mocap, DeviceFault, r"3.00 s old when Motive sent it")
    del motive.extra["behind"]
    assert first(mocap).valid
