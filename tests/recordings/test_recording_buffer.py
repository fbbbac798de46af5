"""Samples in memory: whole across blocks, also for who looks while they come."""

import threading

import numpy as np

from recordings.messages import streams
from recordings.states.buffer import BLOCK, Buffer, Buffers

COUNT = 5 * BLOCK + 7


def valve(keep: float) -> Buffer:
    return Buffer(streams(9, 0, ())["/valve"], keep)


def append(buffer: Buffer) -> None:
    for k in range(COUNT):
        buffer.append(float(k), buffer.message.encode(float(k), (k % 2 == 0,)))


def test_windows_are_whole_across_blocks() -> None:
    buffer = valve(1e9)
    assert len(buffer.window(0.0, 1.0)) == 0 and buffer.newest == -np.inf
    append(buffer)
    assert buffer.newest == COUNT - 1
    for first, last in ((0, COUNT - 1), (BLOCK - 1, BLOCK), (BLOCK, BLOCK), (BLOCK + 3, 4 * BLOCK), (COUNT, 2 * COUNT)):
        expected = np.arange(first, min(last, COUNT - 1) + 1)
        assert buffer.window(first, last)["t"].tolist() == expected.tolist()


def test_who_looks_while_samples_come_sees_all_up_to_some_moment() -> None:
    buffers = Buffers(streams(9, 0, ()), 1e9)

    def come() -> None:
        for k in range(COUNT):
            with buffers.lock:
                buffers["/valve"].append(float(k), buffers["/valve"].message.encode(float(k), (k % 2 == 0,)))

    writer = threading.Thread(target=come)
    writer.start()
    while True:
        alive, newest = writer.is_alive(), buffers.newest("/valve")
        seen = buffers.window("/valve", 0.0, np.inf)["t"]
        assert seen.tolist() == list(range(len(seen))) and (newest == -np.inf or len(seen) > newest)
        if not alive:
            break
    writer.join()
    assert len(seen) == COUNT


def test_only_what_is_older_than_asked_for_is_forgotten() -> None:
    buffer = valve(float(BLOCK))
    append(buffer)
    held = buffer.window(float(COUNT - 1 - BLOCK), np.inf)["t"]
    assert held[0] == COUNT - 1 - BLOCK and len(held) == BLOCK + 1
