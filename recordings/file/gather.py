"""From chunks to messages: decompress many chunks, then pick each channel's messages out at once with numpy.

The message indexes behind each chunk tell where messages are; every offset is checked against the record found there,
and the bytes of each chunk are accounted for, so an index that lies or leaves out messages is noticed.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from ..errors import Damaged
from .budget import Budget
from .chunks import MESSAGE, Chunk, decompress, records_in
from .records import Contents

BATCH = 4 * 2**20
"""Bytes of decompressed chunks held at a time; small enough for the allocator to use the same memory again."""

UNPACKERS = min(4, os.cpu_count() or 1)
"""Threads that unpack chunks."""

_RECORD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
HEAD = _RECORD.itemsize
"""Bytes of a message record in front of the message itself."""
HEAD_IN_LENGTH = HEAD - 9
"""Of these, so many are counted in the record's length."""
_PAIR = struct.Struct("<QQ")


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
    """All messages of a file, channel by channel, batch by batch, in the file's order.

    Chunks are unpacked by threads, one batch ahead of what is picked.
    """
    budget = Budget(contents.name, len(data))
    with ThreadPoolExecutor(UNPACKERS, "unpack") as pool:
        ahead: list[tuple[list[Chunk], list[Future[bytes]]]] = []
        for batch in _batches(contents.chunks):
            ahead.append((batch, [pool.submit(decompress, data, chunk, budget) for chunk in batch]))
            if len(ahead) > 1:
                chunks, raws = ahead.pop(0)
                yield from _pick(data, chunks, [raw.result() for raw in raws], budget)
        for chunks, raws in ahead:
            yield from _pick(data, chunks, [raw.result() for raw in raws], budget)


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


def _pick(data: memoryview, batch: list[Chunk], raws: list[bytes], budget: Budget) -> Iterator[Picked]:
    name = budget.name
    bases = np.zeros(len(batch) + 1, np.int64)
    pairs: dict[int, list[bytes | memoryview]] = {}
    places: dict[int, list[tuple[int, int]]] = {}
    for number, (chunk, raw) in enumerate(zip(batch, raws, strict=True)):
        bases[number + 1] = bases[number] + len(raw)
        indexes = [(channel, data[a:b]) for channel, a, b in chunk.indexes] or _index(raw, chunk, budget)
        for channel, entries in indexes:
            pairs.setdefault(channel, []).append(entries)
            places.setdefault(channel, []).append((number, len(entries) // 16))
    whole = b"".join(raws)
    accounted = np.zeros(len(batch), np.int64)
    for channel, parts in pairs.items():
        index = np.frombuffer(b"".join(parts), "<u8").reshape(-1, 2)
        numbers, counts = np.array(places[channel]).T
        chunk_of = np.repeat(numbers, counts)
        picked = _channel(whole, channel, index[:, 1].astype(np.int64) + bases[chunk_of], name)
        np.add.at(accounted, chunk_of, picked.ends - picked.starts + HEAD)
        if len(index):
            yield picked
    for number in np.flatnonzero(accounted != np.diff(bases)).tolist():
        raw = raws[number]
        try:
            others = sum(head.end - head.start for head in records_in(raw, budget) if head.opcode != Opcode.MESSAGE)
        except struct.error as error:
            raise _senseless(name, batch[number], error) from error
        if accounted[number] + others != len(raw):
            raise Damaged(
                f"{name}: the index of the chunk at byte {batch[number].start} does not list all its messages; "
                "run `lab recover` to rebuild it"
            )


def _channel(whole: bytes, channel: int, offsets: NDArray[np.int64], name: str) -> Picked:
    """Check that message records of this channel stand at the offsets."""
    empty = np.zeros(0, np.int64)
    if not len(offsets):
        return Picked(channel, empty, empty, empty, empty, whole)
    inside = (offsets >= 0) & (offsets <= len(whole) - HEAD)
    if not inside.all():
        raise Damaged(f"{name}: a message index points outside its chunk; run `lab recover` to rebuild it")
    windows = np.ndarray((len(whole) - HEAD + 1,), np.dtype((np.void, HEAD)), whole, strides=(1,))
    heads = windows[offsets].view(_RECORD)
    lengths = heads["length"]
    if (lengths < HEAD_IN_LENGTH).any() or (lengths > len(whole)).any():
        raise Damaged(f"{name}: a message is longer than its chunk; run `lab recover` to leave it out")
    ends = offsets + 9 + lengths.astype(np.int64)
    if (heads["opcode"] != Opcode.MESSAGE).any() or (heads["channel"] != channel).any() or (ends > len(whole)).any():
        raise Damaged(f"{name}: a message index points at no message; run `lab recover` to rebuild it")
    if (np.diff(offsets) <= 0).any() and len(np.unique(offsets)) < len(offsets):
        raise Damaged(f"{name}: a message index lists a message twice; run `lab recover` to rebuild it")
    log_times, sequences = heads["log"].astype(np.int64), heads["sequence"].astype(np.int64)
    return Picked(channel, log_times, sequences, offsets + HEAD, ends, whole)


def _index(raw: bytes, chunk: Chunk, budget: Budget) -> list[tuple[int, bytes]]:
    """(channel, pairs of log time and offset) of a chunk without an index: walk over its records."""
    out: dict[int, list[bytes]] = {}
    try:
        for record in records_in(raw, budget):
            if record.opcode == Opcode.MESSAGE:
                channel, _, log_time, _ = MESSAGE.unpack_from(raw, record.body)
                out.setdefault(channel, []).append(_PAIR.pack(log_time, record.start))
    except struct.error as error:
        raise _senseless(budget.name, chunk, error) from error
    return [(channel, b"".join(pairs)) for channel, pairs in out.items()]


def _senseless(name: str, chunk: Chunk, error: Exception) -> Damaged:
    return Damaged(f"{name}: the chunk at byte {chunk.start} cannot be parsed ({error}); run `lab recover`")
