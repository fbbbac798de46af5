"""Frames and losses of the FT 300-S stream, on bytes and times made up here."""

import random
import struct

import pytest
from pymodbus.framer import FramerRTU

from drivers.ft300s.stream import FrameParser, GapCounter

PERIOD = 0.01


def frame(*counts: int) -> bytes:
    body = b"\x20\x4e" + struct.pack("<6h", *counts)
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


GOOD = frame(150, -225, 3000, 125, -500, 1000)
WRENCH = (1.5, -2.25, 30.0, 0.125, -0.5, 1.0)


def test_a_known_frame_gives_its_wrench_in_newton_and_newton_metre() -> None:
    # counts and CRC worked out by hand from the definition of the frame
    assert FrameParser().feed(bytes.fromhex("204e96001fffb80b7d000cfee803") + GOOD[14:]) == [WRENCH]


@pytest.mark.parametrize("cut", range(1, 16))
def test_a_frame_may_arrive_in_pieces(cut: int) -> None:
    parser = FrameParser()
    assert parser.feed(GOOD[:cut]) + parser.feed(GOOD[cut:] + GOOD[:3]) == [WRENCH]


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


def test_joining_in_the_middle_of_a_frame_is_no_damage() -> None:
    parser = FrameParser()
    assert parser.feed(GOOD[3:] + GOOD) == [WRENCH]
    assert parser.damaged == 0


RNG = random.Random(4)
GONE = set(RNG.sample(range(200, 2800), 60))
STEADY = [i * PERIOD for i in range(3000)]


@pytest.mark.parametrize(
    ("times", "missing"),
    [
        pytest.param([t * 0.99 for t in STEADY], 0, id="steady, of a clock that is fast"),
        pytest.param(STEADY, 0, id="steady"),
        pytest.param([t * 1.01 for t in STEADY], 0, id="steady, of a clock that is slow"),
        pytest.param([(i // 4 * 4 + 4) * PERIOD + i % 4 * 1e-3 for i in range(2000)], 0, id="in bursts"),
        pytest.param(sorted(t + RNG.uniform(0, 0.02) for t in STEADY), 0, id="jitter"),
        pytest.param([max(t, 11.0) if t > 10.0 else t for t in STEADY], 0, id="the host stood still for a second"),
        pytest.param(
            [i * PERIOD + RNG.uniform(0, 0.003) for i in range(3000) if i not in GONE], 60, id="single ones are missing"
        ),
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
            counter.arrived(i * PERIOD, damaged=1 if i % 10 == 0 and i else 0)
    assert counter.missing == 0
