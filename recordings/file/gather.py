"""From chunks to messages: unpack many chunks, find where their messages are, then take each channel's at once with numpy.

Message indexes are not used: what a chunk holds is read from its records, so an index that is wrong misleads nobody.
"""

from __future__ import annotations

import os
import struct
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from ..errors import Damaged
from .budget import Budget, Cost
from .chunks import HEAD, MESSAGE, Chunk, Record, decompress
from .contents import Contents
from .records import inside

BATCH = 4 * 2**20
"""Bytes of decompressed chunks held at a time; small enough for the allocator to use the same memory again."""
UNPACKERS = min(4, os.cpu_count() or 1)
"""Threads that unpack chunks."""
_BEGIN = struct.Struct("<BQH")
"""Kind and length of a record, and the channel of a message."""
_RECORD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)


@dataclass(frozen=True)
class Picked:
    """Messages of one channel in one batch: log times (ns) and numbers, and the bytes of message i from `starts[i]`
    to `ends[i]`."""

    channel: int
    log_times: NDArray[np.int64]
    sequences: NDArray[np.int64]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    data: bytes

    def rows(self) -> NDArray[np.uint8] | None:
        """Shape (n, size) when all messages have the same size, else None."""
        sizes = self.ends - self.starts
        size = int(sizes[0])
        if not size or (sizes != size).any():
            return None
        # One overlapping window at each byte of the data; taking some of them copies each as a block.
        windows = np.ndarray((len(self.data) - size + 1,), np.dtype((np.void, size)), self.data, strides=(1,))
        return windows[self.starts].view(np.uint8).reshape(-1, size)

    def messages(self) -> list[bytes]:
        """The messages one by one."""
        return [self.data[a:b] for a, b in zip(self.starts.tolist(), self.ends.tolist(), strict=True)]


def pick(data: memoryview, contents: Contents) -> Iterator[Picked]:
    """All messages of a file, channel by channel, batch by batch, in the file's order; raises `Damaged`, `Oversized`.

    Chunks are unpacked by threads, one batch ahead of what is picked.
    """
    budget = Budget(contents.name, len(data))
    with ThreadPoolExecutor(UNPACKERS, "unpack") as pool:
        ahead: list[tuple[list[Chunk], list[Future[bytes]]]] = []
        for batch in [*_batches(contents.chunks), []]:
            ahead.append((batch, [pool.submit(_raw, data, chunk, contents, budget) for chunk in batch]))
            if len(ahead) > 1:
                chunks, raws = ahead.pop(0)
                yield from _pick(chunks, [raw.result() for raw in raws], budget)


def _raw(data: memoryview, chunk: Chunk, contents: Contents, budget: Budget) -> bytes:
    """The records of a chunk; raises like `decompress`, unless the chunk is known to be broken."""
    if chunk.start not in contents.broken:
        return decompress(data, chunk, budget)
    found = (item for item in inside(data, chunk, contents) if isinstance(item, Record))
    return b"".join(record.source[record.start : record.end] for record in found)


def _batches(chunks: Sequence[Chunk]) -> Iterator[list[Chunk]]:
    batch: list[Chunk] = []
    size = 0
    for chunk in chunks:
        if batch and size + chunk.size > BATCH:
            yield batch
            batch, size = [], 0
        batch.append(chunk)
        size += chunk.size
    if batch:
        yield batch


def _pick(batch: list[Chunk], raws: list[bytes], budget: Budget) -> Iterator[Picked]:
    whole = b"".join(raws)
    places: dict[int, list[int]] = defaultdict(list)
    base = 0
    for chunk, raw in zip(batch, raws, strict=True):
        end = base + len(raw)
        if _walk(whole, base, end, places, budget) != end:
            raise Damaged(f"{budget.name}: the chunk at byte {chunk.start} holds no whole records; run `lab recover`")
        base = end
    size = _RECORD.itemsize
    for channel, found in places.items():
        starts = np.array(found, np.int64)
        windows = np.ndarray((max(len(whole) - size + 1, 0),), np.dtype((np.void, size)), whole, strides=(1,))
        heads = windows[starts[starts < len(windows)]].view(_RECORD)
        if len(heads) < len(starts) or (heads["length"] < MESSAGE.size).any():
            raise Damaged(f"{budget.name}: a message is shorter than its head; run `lab recover` to leave it out")
        ends = starts + HEAD.size + heads["length"].astype(np.int64)
        log_times, sequences = heads["log"].astype(np.int64), heads["sequence"].astype(np.int64)
        yield Picked(channel, log_times, sequences, starts + size, ends, whole)


def _walk(whole: bytes, at: int, end: int, places: dict[int, list[int]], budget: Budget) -> int:
    """Add where the messages of each channel are in a chunk from `at` to `end`; returns where its records end.

    Each message passes through here: the loop does nothing that it need not do.
    """
    unpack, message, others, last = _BEGIN.unpack_from, int(Opcode.MESSAGE), 0, end - _BEGIN.size
    before = sum(map(len, places.values()))
    while at <= last:
        opcode, length, channel = unpack(whole, at)
        if opcode == message:
            places[channel].append(at)
        else:
            others += 1
        at += 9 + length
    if last < at < end - HEAD.size + 1:
        at += HEAD.size + HEAD.unpack_from(whole, at)[1]
    budget.take(Cost.RECORDS, sum(map(len, places.values())) - before + others)
    return at
