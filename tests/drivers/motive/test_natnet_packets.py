"""NatNet datagrams taken apart: what they hold, and that no datagram costs more than its size."""

import random
import struct

import pytest

from drivers.natnet.packets import SERVERINFO, Unreadable, definitions, frame, message, server_info
from sim_fakes.motive import MotiveFake
from sim_fakes.plant import Plant
from timing import RigClock

VERSIONS = ((2, 6), (2, 11), (3, 1), (4, 0), (4, 1), (4, 2))


def seed_datagrams(version: tuple[int, int]) -> tuple[bytes, bytes]:
    """A frame and the definitions of a server of this version."""
    host = f"127.7.{random.randint(1, 254)}.{random.randint(2, 254)}"
    fake = MotiveFake(Plant(), RigClock(), host, version=version)
    plate = struct.pack("<i", 1) + b"FP1\0" + bytes(4 * (2 + 3 + 144 + 12)) + struct.pack("<iii", 2, 0, 1) + b"Fx\0"
    fake.other_definitions.append((3, plate))
    found = fake._frame_payload(fake.version), fake._definitions(fake.version)
    fake.stop()
    return found


def datagram(kind: int, content: bytes) -> bytes:
    return struct.pack("<HH", kind, len(content)) + content


@pytest.mark.parametrize("version", VERSIONS)
def test_whatever_is_in_a_datagram_yields_no_more_than_its_size(version: tuple[int, int]) -> None:
    dice = random.Random(7)
    seeds = seed_datagrams(version)
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
