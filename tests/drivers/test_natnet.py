"""Motion capture over NatNet against the fake Motive, also when datagrams are late or lost; and datagrams taken apart."""

import math
import random
import socket
import struct
import threading

import numpy as np
import psutil
import pytest
from natnet_rig import Motive, refused

import timing
from drivers.errors import DeviceFault, StaleReading, Unreachable, WrongDevice
from drivers.frames import matrix_from_quaternion
from drivers.interfaces import BodySample
from drivers.natnet.driver import Config, NatNetMocap
from drivers.natnet.packets import SERVERINFO, Unreadable, definitions, frame, message, server_info
from sim_fakes.motive import Mode, MotiveFake
from sim_fakes.plant import Plant
from sim_fakes.ur.process import free_host
from tests.simulated.bench import Bench, answered, raises, wait_until
from timing import RigClock


@pytest.fixture
def motive(bench: Bench, request: pytest.FixtureRequest) -> Motive:
    return Motive(bench, **getattr(request, "param", {}))


IDENTITY = {"position": (0.0, 0.0, 0.0), "quaternion": (1.0, 0.0, 0.0, 0.0)}


VERSIONS = ((2, 6), (2, 7), (2, 10), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2))


@pytest.mark.parametrize("motive", [{"version": version} for version in VERSIONS], indirect=True)
def test_the_pose_arrives_in_the_base_frame_for_any_bitstream(motive: Motive) -> None:
    sample, plant = answered(motive.opened(markers=("M1", "M3")).latest), motive.plant
    assert sample.valid
    assert sample.position == pytest.approx(plant.tip_position, abs=1e-6)
    assert matrix_from_quaternion(sample.orientation) == pytest.approx(plant.tip_rotation, abs=1e-6)
    assert sample.markers[0] == pytest.approx(plant.markers[0], abs=1e-6)
    assert sample.markers[1] == pytest.approx(plant.markers[2], abs=1e-6)


TILTED = ((0.3, -1.1, 0.7), (0.5, 0.5, -0.5, 0.5))


@pytest.mark.parametrize("motive", [{"mocap_to_base": TILTED}], indirect=True)
def test_the_frame_of_the_cameras_is_a_matter_of_calibration(motive: Motive) -> None:
    motive.plant.tip_position = np.array([0.1, 0.2, 0.3])
    assert answered(motive.opened().latest).position == pytest.approx((0.1, 0.2, 0.3), abs=1e-6)
    seen = matrix_from_quaternion(TILTED[1]).T @ (np.array([0.1, 0.2, 0.3]) - np.array(TILTED[0]))
    assert answered(motive.opened(mocap_to_base=IDENTITY).latest).position == pytest.approx(seen, abs=1e-6)


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
    assert answered(mocap.latest).position == pytest.approx(seen + 0.1, abs=1e-6)


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
    seen, hidden = answered(motive.opened(markers=("M1", "M2")).latest).markers
    assert seen == pytest.approx(motive.plant.markers[0], abs=1e-6)
    assert all(math.isnan(part) for part in hidden)


# -- frames that are lost, repeated or damaged
def test_a_replayed_frame_does_not_keep_a_reading_fresh(motive: Motive) -> None:
    mocap = motive.seen()
    motive.extra["replay"] = True
    refused(mocap, StaleReading, "no frame for")
    count = len(motive.samples)
    timing.sleep(0.1)
    raises(StaleReading, "no frame for", mocap.latest)
    assert len(motive.samples) == count and mocap.lost == 0


def test_a_damaged_frame_is_dropped_and_counted_and_the_stream_goes_on(motive: Motive) -> None:
    mocap, fake = motive.seen(), motive.fake
    fake.faults.truncate, at = True, fake.frame
    wait_until(lambda: fake.frame > at + 5)
    fake.faults.truncate, damaged = False, fake.frame - at + 1
    wait_until(lambda: mocap.lost >= 4)
    motive.frames(3)
    assert mocap.lost <= damaged + 1
    assert answered(mocap.latest).valid


# -- who answers


@pytest.mark.parametrize("motive", [{"version": (2, 5)}], indirect=True)
def test_a_server_too_old_is_the_wrong_device(motive: Motive) -> None:
    raises(WrongDevice, r"NatNet 2\.5", motive.made().open)


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
        raises(error, message.format(liar), NatNetMocap("mocap", config, RigClock(), lambda _: None, told.append).open)
        thread.join()
    assert len(told) == 1


def ports_of(fake: MotiveFake) -> set[tuple[str, int]]:
    """Where this process hears datagrams, the fake left out."""
    heard = {c.laddr for c in psutil.Process().net_connections("udp4")}
    return {(fake.host if a.ip == "0.0.0.0" else a.ip, a.port) for a in heard if a.ip != fake.host}


def test_frames_from_another_address_are_not_taken_and_told_once(motive: Motive) -> None:
    liar, elsewhere, before = free_host(), Plant(tip_position=np.array([1.5, 1.5, 1.5])), ports_of(motive.fake)
    mocap = motive.seen()
    (ear,) = ports_of(motive.fake) - before  # the client's socket
    with socket.socket(type=socket.SOCK_DGRAM) as other:
        other.bind((liar, 0))
        for _ in range(5):
            other.sendto(datagram(7, seed_datagrams((4, 1), elsewhere)[0]), ear)
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
def test_close_ends_the_threads(motive: Motive) -> None:
    mocap, threads = motive.made(), threading.active_count()
    mocap.open()
    answered(mocap.latest)
    mocap.close()
    assert threading.active_count() == threads


def test_keep_alive_is_sent_sparingly(motive: Motive) -> None:
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
    assert answered(mocap.latest).valid


# -- a disturbed stream
def demand_each_once(found: list[BodySample]) -> None:
    numbers = [s.frame for s in found]
    assert numbers == sorted(set(numbers))
    stamps = [s.t for s in found]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize("fault", [{"jitter": 0.15}, {"jitter": 0.03, "twice": True}, {"twice": True}])
def test_frames_that_overtake_each_other_are_sorted_and_none_counts_as_lost(motive: Motive, fault: dict[str, object]) -> None:
    mocap, samples = motive.opened(), motive.samples
    motive.extra.update(fault)
    begun = motive.fake.frame
    wait_until(lambda: bool(samples) and samples[-1].frame > begun + 150)
    demand_each_once(samples)
    assert mocap.lost == 0
    assert samples[-1].frame - samples[0].frame == len(samples) - 1


def test_of_late_frames_only_those_that_never_come_count_as_lost(motive: Motive) -> None:
    mocap, samples = motive.opened(), motive.samples
    motive.extra["jitter"] = 0.1
    begun = motive.fake.frame
    wait_until(lambda: motive.fake.frame > begun + 50)
    motive.extra["drop"] = 5
    wait_until(lambda: bool(samples) and samples[-1].frame > begun + 120)
    demand_each_once(samples)
    assert mocap.lost == 5


@pytest.mark.parametrize("lost", [1, 3])
def test_the_first_requests_may_be_lost(motive: Motive, lost: int) -> None:
    motive.extra["deaf"] = lost
    motive.opened()


def test_a_client_that_the_server_has_forgotten_connects_again(motive: Motive) -> None:
    mocap = motive.seen()
    motive.extra["forget"] = True
    wait_until(lambda: "forget" not in motive.extra)
    motive.frames(20)
    wait_until(lambda: motive.samples[-1].valid)
    answered(mocap.latest)
    demand_each_once(motive.samples)


@pytest.mark.parametrize("version", [(4, 1), (3, 1)])
def test_a_server_that_is_started_again_is_found_again(motive: Motive, version: tuple[int, int]) -> None:
    mocap, plant = motive.opened(markers=("M1", "M2")), motive.plant
    motive.frames(50)
    before, lost = motive.samples[-1].frame, mocap.lost
    motive.fake.stop()
    refused(mocap, StaleReading, "no frame for")
    again = MotiveFake(plant, motive.bench.clock, host=motive.fake.host, version=version, noise=0.0, angle_noise=0.0)
    for k, body in enumerate(again.bodies):
        body.number = 40 - k
    motive.bench.started(again)
    wait_until(lambda: motive.samples[-1].valid and motive.samples[-1].frame < before)
    found = answered(mocap.latest)
    assert found.position == pytest.approx(plant.tip_position, abs=1e-6)
    assert found.markers[1] == pytest.approx(plant.markers[1], abs=1e-6)
    assert mocap.lost == lost


def test_a_take_that_motive_plays_is_not_the_present(motive: Motive) -> None:
    mocap = motive.seen()
    motive.fake.mode = Mode.EDIT
    assert not motive.invalid().valid
    refused(mocap, DeviceFault, "set Motive to Live")
    motive.fake.mode = Mode.RECORDING
    assert answered(mocap.latest).valid


def test_another_bitstream_set_in_motive_is_followed(motive: Motive) -> None:
    mocap, fake, samples = motive.seen(), motive.fake, motive.samples
    for version in ((4, 2), (3, 0), (2, 9), (4, 1)):
        fake.version, begun = version, fake.frame
        wait_until(lambda begun=begun: bool(samples) and samples[-1].frame > begun + 20 and samples[-1].valid)  # type: ignore[misc]
        assert answered(mocap.latest).valid
    for sample in samples:
        assert not sample.valid or sample.position == pytest.approx(motive.plant.tip_position, abs=1e-6)


# -- bodies that change in Motive
def test_a_name_is_followed_to_its_new_number(motive: Motive) -> None:
    fake, samples = motive.fake, motive.samples
    fake.faults.freeze = True  # both are where they were
    motive.seen(markers=("M1",))
    tip, marker = (next(b for b in fake.bodies if b.name == name) for name in ("Tip", "M1"))
    tip.number, marker.number = marker.number, tip.number
    motive.extra["changed"] = True
    count = fake.frame
    wait_until(lambda: bool(samples) and samples[-1].frame > count + 20 and samples[-1].valid)
    for sample in samples:
        assert not sample.valid or sample.position == pytest.approx(motive.plant.tip_position, abs=1e-6)


@pytest.mark.parametrize("flagged", [True, False])
def test_a_body_that_is_gone_from_motive_is_named_and_may_come_back(motive: Motive, flagged: bool) -> None:
    mocap, tip = motive.seen(), motive.fake.bodies[0]
    tip.name, tip.number = "Tip2", 99
    if flagged:
        motive.extra["changed"] = True
    refused(mocap, DeviceFault, "no rigid body 'Tip'; the nearest name is 'Tip2'")
    tip.name = "Tip"
    assert answered(mocap.latest).valid


@pytest.mark.parametrize(
    ("body", "change", "says"),
    [
        ("Base", {"name": "Tip"}, "several rigid bodies are named 'Tip': numbers 1 and 2"),
        ("M2", {"number": 1}, "'Tip' and 'M2' .* ID 1"),
    ],
)
def test_a_name_or_number_that_two_bodies_have_is_refused(
    motive: Motive, body: str, change: dict[str, object], says: str
) -> None:
    for attribute, value in change.items():
        setattr(next(b for b in motive.fake.bodies if b.name == body), attribute, value)
    raises(WrongDevice, says, motive.opened)


# -- other definitions
PLATE = struct.pack("<i", 1) + b"FP\xe91\0" + bytes(4 * (2 + 3 + 144 + 12)) + struct.pack("<iii", 2, 0, 2) + b"Fx\0Fy\0"
DEVICE = struct.pack("<i", 2) + b"DAQ\0SN7\0" + struct.pack("<iii", 0, 0, 1) + b"A1\0"
CAMERA = b"Prime\0" + bytes(28)
SET = b"all\0" + struct.pack("<i", 2) + b"a\0b\xff\0"
SKELETON = b"Ada\0" + struct.pack("<ii", 1, 1) + b"Hip\0" + struct.pack("<ii3fi", 1, -1, 0, 0, 0, 0)


@pytest.mark.parametrize("motive", [{"version": (3, 1)}, {"version": (4, 0)}, {"version": (4, 1)}], indirect=True)
def test_other_assets_are_passed_over(motive: Motive) -> None:
    motive.fake.other_definitions += [(0, SET), (2, SKELETON), (3, PLATE), (4, DEVICE), (5, CAMERA)]
    assert answered(motive.opened().latest).valid and not motive.told


def test_definitions_that_cannot_be_read_are_named_and_do_not_hide_the_others(motive: Motive) -> None:
    motive.fake.other_definitions += [(1, b"name without an end"), (77, b"?"), (3, PLATE[:40])]
    assert answered(motive.opened().latest).valid
    assert motive.told == ["mocap: rigid body definition at byte 8 cannot be read; it is ignored"]


@pytest.mark.parametrize("motive", [{"version": (3, 1)}], indirect=True)
def test_a_definition_that_hides_the_tip_is_named_with_its_byte(motive: Motive) -> None:
    motive.fake.other_definitions += [(0, SET), (77, b"?")]
    raises(WrongDevice, r"definition of the unknown kind 77 at byte 25 cannot be read, nor what follows", motive.opened)


@pytest.mark.parametrize("motive", [{"group": "239.255.42.99"}], indirect=True)
def test_frames_sent_to_a_multicast_group_are_heard(motive: Motive) -> None:
    assert answered(motive.opened(local=motive.fake.host).latest).valid


# -- datagrams: what they hold, and that none costs more than its size
FUZZED = ((2, 6), (2, 11), (3, 1), (4, 0), (4, 1), (4, 2))


def seed_datagrams(version: tuple[int, int], plant: Plant) -> tuple[bytes, bytes]:
    """A frame, far ahead, and the definitions of a server of this version."""
    fake = MotiveFake(plant, RigClock(), free_host(), version=version)
    fake.frame = 100_000
    fake.other_definitions.append((3, PLATE))
    found = fake._frame_payload(fake.version), fake._definitions(fake.version)
    fake.stop()
    return found


def datagram(kind: int, content: bytes) -> bytes:
    return struct.pack("<HH", kind, len(content)) + content


@pytest.mark.parametrize("version", FUZZED)
def test_whatever_is_in_a_datagram_yields_no_more_than_its_size(version: tuple[int, int]) -> None:
    dice = random.Random(7)
    seeds = seed_datagrams(version, Plant())
    for k in range(4000):
        content = bytearray(seeds[k % 2])
        for _ in range(dice.randint(1, 4)):
            at = dice.randrange(len(content))
            how = dice.randrange(4)
            if how == 0:
                content[at] = dice.randrange(256)
            elif how == 1:
                content[at : at + 4] = dice.choice((b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\x80", bytes(4)))
            elif how == 2:
                del content[at:]
                content += b"\0"
            else:
                content[at:at] = dice.randbytes(dice.randint(1, 40))
        _, cursor = message(datagram(7, bytes(content)))
        try:
            if k % 2:
                told = definitions(cursor, version)
                assert len(told.bodies) + len(told.unread) <= len(content)
            else:
                assert len(frame(cursor, version).bodies) <= len(content) / 38
        except Unreadable as e:
            assert "at byte" in str(e)


def test_the_largest_datagram_of_small_things_is_read_as_it_is() -> None:
    content = struct.pack("<i", 5000) + struct.pack("<ii5sii", 1, 13, b"Tip1\0", 3, 0)[:21] * 2500
    told = definitions(message(datagram(5, content))[1], (4, 1))
    assert len(told.bodies) == 2500 and len(told.unread) == 1


def test_two_bodies_of_one_number_in_a_frame_stand_for_none() -> None:
    body = struct.pack("<i7ffh", 4, 0, 0, 0, 0, 0, 0, 1, 0, 1)
    sections = struct.pack("<ii", 0, 0) * 2 + struct.pack("<ii", 2, 76) + body * 2 + struct.pack("<ii", 0, 0) * 5
    content = struct.pack("<i", 9) + sections + struct.pack("<IIdQQQIIhI", 0, 0, 1.5, 0, 0, 0, 0, 0, 2, 0)
    found = frame(message(datagram(7, content))[1], (4, 1))
    assert found.bodies == {4: None} and found.models_changed and found.stamp == 1.5 and found.number == 9


@pytest.mark.parametrize(
    ("data", "says"),
    [(b"", "no NatNet header"), (b"\7\0\5\0abc", "states 5 bytes at byte 2 and has 3"), (b"\1\0\2\0no", "ends at byte 6")],
)
def test_what_is_no_natnet_datagram_is_named(data: bytes, says: str) -> None:
    with pytest.raises(Unreadable, match=says):
        kind, cursor = message(data)
        assert kind == SERVERINFO
        server_info(cursor)
