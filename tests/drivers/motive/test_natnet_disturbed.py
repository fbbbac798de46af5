"""Motion capture when datagrams are late, lost or twice there, the client is forgotten, or bodies change in Motive."""

from __future__ import annotations

import struct
from collections.abc import Callable

import pytest
from natnet_rig import Make, first, refused, wait

from drivers.errors import DeviceFault, StaleReading, WrongDevice
from drivers.interfaces import BodySample
from sim_fakes.motive import MotiveFake
from sim_fakes.plant import Plant
from timing import RigClock


def demand_each_once(found: list[BodySample]) -> None:
    numbers = [s.frame for s in found]
    assert numbers == sorted(set(numbers))
    stamps = [s.t for s in found]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize("fault", [{"jitter": 0.15}, {"jitter": 0.03, "twice": True}, {"twice": True}])
def test_frames_that_overtake_each_other_are_sorted_and_none_counts_as_lost(
    make: Make,
    fake: MotiveFake,
    samples: list[BodySample],
    fault: dict[str, object],
) -> None:
    mocap = make()
    mocap.open()
    fake.faults.extra.update(fault)
    begun = fake.frame
    wait(lambda: bool(samples) and samples[-1].frame > begun + 150)
    demand_each_once(samples)
    assert mocap.lost == 0
    assert samples[-1].frame - samples[0].frame == len(samples) - 1


def test_of_late_frames_only_those_that_never_come_count_as_lost(
    make: Make,
    fake: MotiveFake,
    samples: list[BodySample],
) -> None:
    mocap = make()
    mocap.open()
    fake.faults.extra["jitter"] = 0.1
    begun = fake.frame
    wait(lambda: fake.frame > begun + 50)
    fake.faults.extra["drop"] = 5
    wait(lambda: bool(samples) and samples[-1].frame > begun + 120)
    demand_each_once(samples)
    assert mocap.lost == 5


@pytest.mark.parametrize("lost", [1, 3])
def test_the_first_requests_may_be_lost(make: Make, fake: MotiveFake, lost: int) -> None:
    fake.faults.extra["deaf"] = lost
    make().open()


def test_a_client_that_the_server_has_forgotten_connects_again(
    make: Make,
    fake: MotiveFake,
    samples: list[BodySample],
) -> None:
    mocap = make()
    mocap.open()
    first(mocap)
    fake.faults.extra["forget"] = True
    wait(lambda: "forget" not in fake.faults.extra)
    count = len(samples)
    wait(lambda: len(samples) > count + 20 and samples[-1].valid)
    first(mocap)
    demand_each_once(samples)


@pytest.mark.parametrize("version", [(4, 1), (3, 1)])
def test_a_server_that_is_started_again_is_found_again(
    make: Make,
    fake: MotiveFake,
    samples: list[BodySample],
    plant: Plant,
    version: tuple[int, int],
) -> None:
    """With a count that begins anew, another bitstream, and other numbers of its bodies."""
    mocap = make(markers=("M1", "M2"))
    mocap.open()
    wait(lambda: len(samples) > 50)
    before, lost = samples[-1].frame, mocap.lost
    fake.stop()
    refused(mocap, StaleReading, "no frame for")
    again = MotiveFake(plant, RigClock(10.0), host=fake.host, version=version, noise=0.0, angle_noise=0.0)
    for k, body in enumerate(again.bodies):
        body.number = 40 - k
    again.start()
    try:
        wait(lambda: samples[-1].valid and samples[-1].frame < before)
        found = first(mocap)
        assert found.position == pytest.approx(plant.tip_position, abs=1e-6)
        assert found.markers[1] == pytest.approx(plant.markers[1], abs=1e-6)
        assert mocap.lost == lost
    finally:
        again.stop()


def renumber(motive: MotiveFake) -> None:
    """Tip and first marker change their numbers, and Motive says so."""
    tip, marker = (next(b for b in motive.bodies if b.name == name) for name in ("Tip", "M1"))
    tip.number, marker.number = marker.number, tip.number
    motive.faults.extra["changed"] = True


def test_a_name_is_followed_to_its_new_number(
    make: Make,
    fake: MotiveFake,
    samples: list[BodySample],
    plant: Plant,
) -> None:
    fake.faults.freeze = True  # both are where they were
    mocap = make(markers=("M1",))
    mocap.open()
    first(mocap)
    renumber(fake)
    count = fake.frame
    wait(lambda: bool(samples) and samples[-1].frame > count + 20 and samples[-1].valid)
    for sample in samples:
        assert not sample.valid or sample.position == pytest.approx(plant.tip_position, abs=1e-6)


@pytest.mark.parametrize("flagged", [True, False])
def test_a_body_that_is_gone_from_motive_is_named_and_may_come_back(
    make: Make,
    fake: MotiveFake,
    samples: list[BodySample],
    flagged: bool,
) -> None:
    """Whether or not the frame that says so has arrived."""
    mocap = make()
    mocap.open()
    first(mocap)
    tip = fake.bodies[0]
    tip.name, tip.number = "Tip2", 99
    if flagged:
        fake.faults.extra["changed"] = True
    refused(mocap, DeviceFault, "no rigid body 'Tip'; the nearest name is 'Tip2'")
    tip.name = "Tip"
    assert first(mocap).valid


def same_name(motive: MotiveFake) -> None:
    next(b for b in motive.bodies if b.name == "Base").name = "Tip"


def same_number(motive: MotiveFake) -> None:
    next(b for b in motive.bodies if b.name == "M2").number = 1


@pytest.mark.parametrize(
    ("change", "says"),
    [(same_name, "several rigid bodies are named 'Tip': numbers 1 and 2"), (same_number, "'Tip' and 'M2' .* ID 1")],
)
def test_a_name_or_number_that_two_bodies_have_is_refused(
    make: Make,
    fake: MotiveFake,
    change: Callable[[MotiveFake], None],
    says: str,
) -> None:
    change(fake)
    with pytest.raises(WrongDevice, match=says):
        make().open()


PLATE = struct.pack("<i", 1) + b"FP\xe91\0" + bytes(4 * (2 + 3 + 144 + 12)) + struct.pack("<iii", 2, 0, 2) + b"Fx\0Fy\0"
DEVICE = struct.pack("<i", 2) + b"DAQ\0SN7\0" + struct.pack("<iii", 0, 0, 1) + b"A1\0"
CAMERA = b"Prime\0" + bytes(28)
SET = b"all\0" + struct.pack("<i", 2) + b"a\0b\xff\0"
SKELETON = b"Ada\0" + struct.pack("<ii", 1, 1) + b"Hip\0" + struct.pack("<ii3fi", 1, -1, 0, 0, 0, 0)


@pytest.mark.parametrize("fake", [{"version": (3, 1)}, {"version": (4, 0)}, {"version": (4, 1)}], indirect=True)
def test_other_assets_are_passed_over(make: Make, fake: MotiveFake) -> None:
    fake.other_definitions += [(0, SET), (2, SKELETON), (3, PLATE), (4, DEVICE), (5, CAMERA)]
    told: list[str] = []
    mocap = make(notice=told.append)
    mocap.open()
    assert first(mocap).valid and not told


def test_definitions_that_cannot_be_read_are_named_and_do_not_hide_the_others(
    make: Make,
    fake: MotiveFake,
) -> None:
    fake.other_definitions += [(1, b"name without an end"), (77, b"?"), (3, PLATE[:40])]
    told: list[str] = []
    mocap = make(notice=told.append)
    mocap.open()
    assert first(mocap).valid
    assert told == ["mocap: rigid body definition at byte 8 cannot be read; it is ignored"]


@pytest.mark.parametrize("fake", [{"version": (3, 1)}], indirect=True)
def test_a_definition_that_hides_the_tip_is_named_with_its_byte(make: Make, fake: MotiveFake) -> None:
    fake.other_definitions += [(0, SET), (77, b"?")]
    with pytest.raises(WrongDevice, match=r"definition of the unknown kind 77 at byte 25 cannot be read, nor what follows"):
        make().open()


@pytest.mark.parametrize("fake", [{"group": "239.255.42.99"}], indirect=True)
def test_frames_sent_to_a_multicast_group_are_heard(make: Make, fake: MotiveFake) -> None:
    mocap = make(local=fake.host)
    mocap.open()
    assert first(mocap).valid
