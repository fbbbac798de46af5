"""From chunks to messages: decompress many chunks, then pick each channel's messages out at once with numpy.

The message indexes behind each chunk tell where messages are; every offset is checked against the record found there,
and the bytes of each chunk are accounted for, so an index that lies or leaves out messages is noticed.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import lz4.frame
import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from .container import ChunkPlace, Contents, records_in
from .errors import Damaged

BATCH = 4 * 2**20
"""Bytes of decompressed chunks held at a time; small enough for the allocator to use the same memory again."""

_RECORD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
HEAD = _RECORD.itemsize
"""Bytes of a message record in front of the message itself."""
_HEAD_IN_LENGTH = HEAD - 9

_CHANNEL = struct.Struct("<H")


@dataclass(frozen=True)
class Picked:
    """Messages of one channel in one batch: log times (ns), and the bytes of message i from `starts[i]` to
    `ends[i]`."""

    channel: int
    log_times: NDArray[np.int64]
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


def decompress(data: memoryview, chunk: ChunkPlace, name: str) -> bytes:
    """The records of a chunk; raises `Damaged` when they are not what was written."""
    packed = data[chunk.data_start : chunk.data_end]
    try:
        if chunk.compression == "zstd":
            raw = _ZSTD.decompress(packed, max_output_size=chunk.size)
        elif chunk.compression == "lz4":
            raw = lz4.frame.decompress(packed)
        elif chunk.compression == "":
            raw = bytes(packed)
        else:
            raise Damaged(
                f"{name}: chunk at byte {chunk.start} is compressed by {chunk.compression!r}, not zstd or lz4"
            )
    except (zstandard.ZstdError, RuntimeError) as error:
        raise Damaged(f"{name}: chunk at byte {chunk.start} does not decompress: {error}; run `lab verify`") from error
    if len(raw) != chunk.size or (chunk.crc and zlib.crc32(raw) != chunk.crc):
        raise Damaged(f"{name}: chunk at byte {chunk.start} fails its checksum; run `lab verify`")
    return raw


_ZSTD = zstandard.ZstdDecompressor()


def find_channels(data: memoryview, contents: Contents, name: str) -> None:
    """Add to `contents` the schemas and channels that stand inside chunks (in a file without a summary)."""
    for chunk in contents.chunks:
        if not chunk.indexes or any(channel not in contents.channels for channel, _, _ in chunk.indexes):
            raw = decompress(data, chunk, name)
            for opcode, _, start, end in records_in(memoryview(raw)):
                contents.add(opcode, raw[start:end])


def pick(data: memoryview, contents: Contents, name: str) -> Iterator[Picked]:
    """All messages of a file, channel by channel, batch by batch, in the file's order."""
    batch: list[ChunkPlace] = []
    size = 0
    for chunk in contents.chunks:
        batch.append(chunk)
        size += chunk.size
        if size >= BATCH:
            yield from _pick(data, batch, name)
            batch, size = [], 0
    if batch:
        yield from _pick(data, batch, name)


def _pick(data: memoryview, batch: list[ChunkPlace], name: str) -> Iterator[Picked]:
    raws: list[bytes] = []
    bases = np.zeros(len(batch) + 1, np.int64)
    pairs: dict[int, list[bytes | memoryview]] = {}
    places: dict[int, list[tuple[int, int]]] = {}
    for number, chunk in enumerate(batch):
        raw = decompress(data, chunk, name)
        raws.append(raw)
        bases[number + 1] = bases[number] + len(raw)
        indexes = [(channel, data[a:b]) for channel, a, b in chunk.indexes] or _index(raw)
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
        others = sum(end - at for opcode, at, _, end in records_in(memoryview(raw)) if opcode != Opcode.MESSAGE)
        if accounted[number] + others != len(raw):
            raise Damaged(
                f"{name}: the index of the chunk at byte {batch[number].start} does not list all its messages; "
                "run `lab recover` to have it made anew"
            )


def _channel(whole: bytes, channel: int, offsets: NDArray[np.int64], name: str) -> Picked:
    """Check that message records of this channel stand at the offsets."""
    empty = np.zeros(0, np.int64)
    if not len(offsets):
        return Picked(channel, empty, empty, empty, whole)
    inside = (offsets >= 0) & (offsets <= len(whole) - HEAD)
    if not inside.all():
        raise Damaged(f"{name}: a message index points outside its chunk; run `lab recover` to have it made anew")
    windows = np.ndarray((len(whole) - HEAD + 1,), np.dtype((np.void, HEAD)), whole, strides=(1,))
    heads = windows[offsets].view(_RECORD)
    ends = offsets + 9 + heads["length"].astype(np.int64)
    if (heads["opcode"] != Opcode.MESSAGE).any() or (heads["channel"] != channel).any() or (ends > len(whole)).any():
        raise Damaged(f"{name}: a message index points at no message; run `lab recover` to have it made anew")
    if (np.diff(offsets) <= 0).any() and len(np.unique(offsets)) < len(offsets):
        raise Damaged(f"{name}: a message index lists a message twice; run `lab recover` to have it made anew")
    return Picked(channel, heads["log"].astype(np.int64), offsets + HEAD, ends, whole)


def _index(raw: bytes) -> list[tuple[int, bytes]]:
    """The index of a chunk that has none: walk over its records."""
    out: dict[int, list[tuple[int, int]]] = {}
    for opcode, at, start, _ in records_in(memoryview(raw)):
        if opcode == Opcode.MESSAGE:
            (channel,) = _CHANNEL.unpack_from(raw, start)
            out.setdefault(channel, []).append((0, at))
    return [(channel, np.array(pairs, "<u8").tobytes()) for channel, pairs in out.items()]
