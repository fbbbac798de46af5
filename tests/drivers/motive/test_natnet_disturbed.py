"""Motion capture when datagrams are late, lost or twice there, the client is forgotten, or bodies change in Motive."""

import struct

import pytest
from natnet_rig import Motive, first, refused

from drivers.errors import DeviceFault, StaleReading, WrongDevice
from drivers.interfaces import BodySample
from sim_fakes.motive import Mode, MotiveFake
from tests.simulated.bench import wait_until


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
    first(mocap)
    demand_each_once(motive.samples)


@pytest.mark.parametrize("version", [(4, 1), (3, 1)])
def test_a_server_that_is_started_again_is_found_again(motive: Motive, version: tuple[int, int]) -> None:
    """With a count that begins anew, another bitstream, and other numbers of its bodies."""
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
    found = first(mocap)
    assert found.position == pytest.approx(plant.tip_position, abs=1e-6)
    assert found.markers[1] == pytest.approx(plant.markers[1], abs=1e-6)
    assert mocap.lost == lost


def test_a_take_that_motive_plays_is_not_the_present(motive: Motive) -> None:
    mocap = motive.seen()
    motive.fake.mode = Mode.EDIT
    assert not motive.invalid().valid
    refused(mocap, DeviceFault, "set Motive to Live")
    motive.fake.mode = Mode.RECORDING
    assert first(mocap).valid


def test_another_bitstream_set_in_motive_is_followed(motive: Motive) -> None:
    """By another client of a multicast group, for instance: nothing falls silent meanwhile."""
    mocap, fake, samples = motive.seen(), motive.fake, motive.samples
    for version in ((4, 2), (3, 0), (2, 9), (4, 1)):
        fake.version, begun = version, fake.frame
        wait_until(lambda begun=begun: bool(samples) and samples[-1].frame > begun + 20 and samples[-1].valid)  # type: ignore[misc]
        assert first(mocap).valid
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
    """Whether or not the frame that says so has arrived."""
    mocap, tip = motive.seen(), motive.fake.bodies[0]
    tip.name, tip.number = "Tip2", 99
    if flagged:
        motive.extra["changed"] = True
    refused(mocap, DeviceFault, "no rigid body 'Tip'; the nearest name is 'Tip2'")
    tip.name = "Tip"
    assert first(mocap).valid


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
    with pytest.raises(WrongDevice, match=says):
        motive.opened()


# -- other definitions
PLATE = struct.pack("<i", 1) + b"FP\xe91\0" + bytes(4 * (2 + 3 + 144 + 12)) + struct.pack("<iii", 2, 0, 2) + b"Fx\0Fy\0"
DEVICE = struct.pack("<i", 2) + b"DAQ\0SN7\0" + struct.pack("<iii", 0, 0, 1) + b"A1\0"
CAMERA = b"Prime\0" + bytes(28)
SET = b"all\0" + struct.pack("<i", 2) + b"a\0b\xff\0"
SKELETON = b"Ada\0" + struct.pack("<ii", 1, 1) + b"Hip\0" + struct.pack("<ii3fi", 1, -1, 0, 0, 0, 0)


@pytest.mark.parametrize("motive", [{"version": (3, 1)}, {"version": (4, 0)}, {"version": (4, 1)}], indirect=True)
def test_other_assets_are_passed_over(motive: Motive) -> None:
    motive.fake.other_definitions += [(0, SET), (2, SKELETON), (3, PLATE), (4, DEVICE), (5, CAMERA)]
    assert first(motive.opened()).valid and not motive.told


def test_definitions_that_cannot_be_read_are_named_and_do_not_hide_the_others(motive: Motive) -> None:
    motive.fake.other_definitions += [(1, b"name without an end"), (77, b"?"), (3, PLATE[:40])]
    assert first(motive.opened()).valid
    assert motive.told == ["mocap: rigid body definition at byte 8 cannot be read; it is ignored"]


@pytest.mark.parametrize("motive", [{"version": (3, 1)}], indirect=True)
def test_a_definition_that_hides_the_tip_is_named_with_its_byte(motive: Motive) -> None:
    motive.fake.other_definitions += [(0, SET), (77, b"?")]
    with pytest.raises(WrongDevice, match=r"definition of the unknown kind 77 at byte 25 cannot be read, nor what follows"):
        motive.opened()


@pytest.mark.parametrize("motive", [{"group": "239.255.42.99"}], indirect=True)
def test_frames_sent_to_a_multicast_group_are_heard(motive: Motive) -> None:
    assert first(motive.opened(local=motive.fake.host)).valid
