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
    [
        (b"", 0),
        (b"\x00\xff\x20", 0),
        (GOOD[:9] + b"\x99" + GOOD[10:], 1),
        (GOOD[:15], 1),
        ((GOOD[:-1] + b"\x00") * 5, 5),
    ],
)
def test_damaged_frames_are_counted_stray_bytes_are_not(between: bytes, damaged: int) -> None:
    parser = FrameParser()
    assert len(parser.feed(GOOD + between + GOOD)) == 2
    assert parser.damaged == damaged


def test_joining_in_the_middle_of_a_frame_is_no_damage() -> None:
    parser = FrameParser()
    assert parser.feed(GOOD[3:] + GOOD) == [WRENCH]
    assert parser.damaged == 0


def missing_after(times: list[float]) -> int:
    counter = GapCounter()
    for t in times:
        counter.arrived(t, 0)
    return counter.missing


def test_a_steady_stream_misses_nothing_even_when_its_clock_is_one_percent_off() -> None:
    for rate in (0.99, 1.0, 1.01):
        assert missing_after([i * PERIOD * rate for i in range(5000)]) == 0


def test_bursts_and_jitter_are_not_gaps() -> None:
    rng = random.Random(3)
    held_back = [(i // 4 * 4 + 4) * PERIOD + rng.uniform(0, 0.004) for i in range(2000)]
    assert missing_after(sorted(held_back)) == 0


def test_a_host_that_stood_still_for_a_second_finds_all_frames_in_the_end() -> None:
    times = [i * PERIOD for i in range(3000)]
    assert missing_after([max(t, 11.0) if t > 10.0 else t for t in times]) == 0


def test_single_frames_missing_here_and_there_are_counted() -> None:
    rng = random.Random(4)
    gone = set(rng.sample(range(200, 2800), 60))
    times = [i * PERIOD + rng.uniform(0, 0.003) for i in range(3000) if i not in gone]
    assert missing_after(times) == 60


def test_a_long_gap_is_counted_whole() -> None:
    assert missing_after([i * PERIOD for i in range(1000) if not 300 <= i < 650]) == 350


def test_frames_known_as_damaged_are_not_counted_as_missing_too() -> None:
    counter = GapCounter()
    for i in range(1000):
        if i % 10 != 9:
            counter.arrived(i * PERIOD, damaged=1 if i % 10 == 0 and i else 0)
    assert counter.missing == 0
