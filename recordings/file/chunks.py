"""What stands in an MCAP file: records, chunks, and the messages in a chunk as one table.

What a chunk says of its size is checked before anything is unpacked. Message indexes are not used to find messages: an index
that is wrong misleads nobody.
"""

from __future__ import annotations

import contextlib
import struct
import threading
import zlib
from array import array
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import repeat
from operator import itemgetter
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from numpy.typing import NDArray

from ..errors import Damaged, Oversized
from .budget import OPTION, Cost, ReadingBudget, largest_chunk

HEAD = struct.Struct("<BQ")
"""Kind and length of a record."""
UNPARSABLE = (struct.error, McapError, UnicodeDecodeError, OverflowError)
"""What parsing of bytes raises that are not what they should be."""
_MESSAGE = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
"""How a message record begins; times in ns. Its payload follows."""
_CHUNK = struct.Struct("<QQQII")
"""First and last log time, size, checksum, and the length of the compression's name."""
_U64 = struct.Struct("<Q")
_PIECE = 2**16
"""Bytes of a chunk that are unpacked at a time when it is cut off."""


class McapRecord(NamedTuple):
    """A record of kind `opcode` at byte `start` of the file, or of its chunk. Its content is source[body:end]."""

    opcode: int
    start: int
    body: int
    end: int
    source: memoryview | bytes

    @property
    def size(self) -> int:
        """Bytes with kind and length."""
        return self.end - self.body + HEAD.size

    def read(self, kind: type[Any]) -> Any:
        """Its fields, as the library's record of this kind; raises what `UNPARSABLE` lists."""
        return kind.read(_Fields(self))  # type: ignore[attr-defined]


class _Fields(ReadDataStream):
    """A record's content, for the library to parse. Unlike the library's stream it never gives fewer bytes than asked for."""

    def __init__(self, record: McapRecord) -> None:
        super().__init__(None)  # type: ignore[arg-type]
        self._record = record

    def read(self, length: int) -> bytes:
        """The next bytes; raises EndOfFile where the record has fewer."""
        at = self._record.body + self._count
        if length > self._record.end - at:
            raise EndOfFile()
        self._count += length
        return bytes(self._record.source[at : at + length])


@dataclass
class Chunk:
    """Where a chunk is in the file: its record from `start` to `end`, its (compressed) data, the message indexes behind it.

    `bare`: messages that follow each other outside any chunk; they are read like a chunk that is not compressed.
    """

    start: int
    end: int
    first_time: int
    last_time: int
    size: int
    """Bytes when decompressed."""
    crc: int
    """0: none."""
    compression: str
    data_start: int
    data_end: int
    bare: bool = False
    channels: set[int] = field(default_factory=set)
    """Those that its message indexes list."""
    indexes: list[tuple[int, int, int]] = field(default_factory=list)
    """(channel id, start and end of its (time, offset) pairs in the file); kept of the newest chunk alone."""

    @classmethod
    def of(cls, record: McapRecord) -> Chunk:
        """The chunk of a record; raises what `UNPARSABLE` lists where there is none."""
        first, last, size, crc, letters = _CHUNK.unpack_from(record.source, record.body)
        at = record.body + _CHUNK.size
        compression = bytes(record.source[at : at + min(letters, 16)]).decode()
        (packed,) = _U64.unpack_from(record.source, at + letters)
        begin, end = at + letters + _U64.size, record.start + record.size
        return cls(record.start, end, first, last, size, crc, compression, begin, begin + packed)


class Chunks(Sequence[Chunk]):
    """The chunks of a file in its order: the newest as it is, of all others 84 bytes each, whatever they hold."""

    _NUMBERS = struct.Struct("<8QI")

    def __init__(self) -> None:
        self._starts, self._packed = array("Q"), bytearray()
        self._kinds: dict[tuple[str, bool, frozenset[int]], int] = {}
        """What many chunks have in common, in the order of its number."""
        self._newest: Chunk | None = None

    def append(self, chunk: Chunk) -> None:
        """Add the next one; the one before is complete."""
        if (c := self._newest) is not None:
            kind = self._kinds.setdefault((c.compression, c.bare, frozenset(c.channels)), len(self._kinds))
            numbers = (c.start, c.end, c.first_time, c.last_time, c.size, c.crc, c.data_start, c.data_end, kind)
            self._packed += self._NUMBERS.pack(*numbers)
        self._newest = chunk
        self._starts.append(chunk.start)

    def __len__(self) -> int:
        return len(self._starts)

    def __getitem__(self, number: Any) -> Any:
        at = range(len(self))[number]
        if isinstance(at, range):
            return [self[k] for k in at]
        if self._newest is not None and at == len(self) - 1:
            return self._newest
        return self._unpacked(list(self._kinds), at)

    def __iter__(self) -> Iterator[Chunk]:
        kinds = list(self._kinds)
        yield from (self._unpacked(kinds, number) for number in range(len(self) - 1))
        yield from [] if self._newest is None else [self._newest]

    def _unpacked(self, kinds: Sequence[tuple[str, bool, frozenset[int]]], number: int) -> Chunk:
        start, end, first, last, size, crc, data_start, data_end, kind = self._NUMBERS.unpack_from(
            self._packed, number * self._NUMBERS.size
        )
        compression, bare, channels = kinds[kind]
        return Chunk(start, end, first, last, size, crc, compression, data_start, data_end, bare, set(channels))

    def at(self, start: int) -> Chunk | None:
        """The chunk that begins at this byte of the file."""
        number = bisect_left(self._starts, start)
        return self[number] if number < len(self) and self._starts[number] == start else None

    def clear(self) -> None:
        """Forget all."""
        self.__init__()  # type: ignore[misc]


@dataclass(frozen=True)
class Messages:
    """Messages in the order of the file, of `chunk` or of several chunks from it on. `starts`: where the record of each begins
    in `data`; `begins`: its first bytes."""

    data: bytes
    starts: NDArray[np.int64]
    begins: NDArray[np.void]
    chunk: Chunk

    @classmethod
    def at(cls, data: bytes, starts: NDArray[np.int64], chunk: Chunk) -> Messages:
        """Those that begin at these bytes."""
        if len(starts) and starts[-1] > len(data) - _MESSAGE.itemsize:  # the last one is too short for its head
            data += bytes(_MESSAGE.itemsize)
        return cls(data, starts, _windows(data, _MESSAGE.itemsize)[starts], chunk)

    def __len__(self) -> int:
        return len(self.starts)

    def which(self, chosen: Any) -> Messages:
        """Those that an index or mask of numpy picks."""
        return Messages(self.data, self.starts[chosen], self.begins[chosen], self.chunk)

    @property
    def heads(self) -> NDArray[np.void]:
        """A line a message, with its `channel`, `sequence`, and times `log` and `publish` in ns."""
        return self.begins.view(_MESSAGE)  # numpy picks lines of plain bytes much faster than lines of fields

    def by_channel(self) -> list[tuple[int, Messages]]:
        """The number of each channel and its messages, in the order of their first."""
        channels = self.heads["channel"].copy()
        order = np.argsort(channels, kind="stable")
        parts = [part for part in np.split(order, np.flatnonzero(np.diff(channels[order])) + 1) if len(part)]
        return [(int(channels[part[0]]), self.which(part)) for part in sorted(parts, key=itemgetter(0))]

    @property
    def sizes(self) -> NDArray[np.int64]:
        """Bytes of each payload; below 0 where a record is shorter than the head of a message."""
        return self.heads["length"].astype(np.int64) + HEAD.size - _MESSAGE.itemsize

    def rows(self) -> NDArray[np.uint8] | None:
        """The payloads, shape (n, size), when all have the same size, else None."""
        sizes = self.sizes
        size = int(sizes[0])
        if not size or (sizes != size).any():
            return None
        return _windows(self.data, size)[self.starts + _MESSAGE.itemsize].view(np.uint8).reshape(-1, size)

    def payloads(self) -> list[bytes]:
        """The payloads one by one."""
        begins = self.starts + _MESSAGE.itemsize
        return [self.data[a:b] for a, b in zip(begins.tolist(), (begins + self.sizes).tolist(), strict=True)]


def _windows(data: bytes, size: int) -> NDArray[np.void]:
    """A window of `size` bytes at each byte of the data; taking some of them copies each as a block."""
    return np.ndarray((max(len(data) - size + 1, 0),), np.dtype((np.void, size)), data, strides=(1,))


def scan(data: bytes, budget: ReadingBudget) -> tuple[list[int], list[int], Exception | None]:
    """Where the messages and the other records of an unpacked chunk begin, counted against the budget; and what is wrong where
    they do not reach its end.

    Each message passes through here: the loop does nothing that it need not do.
    """
    messages, others, at = list[int](), list[int](), 0
    unpack, message, head = HEAD.unpack_from, int(Opcode.MESSAGE), HEAD.size
    with contextlib.suppress(struct.error, OverflowError):  # the end
        for _ in repeat(None, max(budget.left(Cost.RECORDS), 0)):
            opcode, length = unpack(data, at)
            if opcode == message:
                messages.append(at)
            else:
                others.append(at)
                if not opcode:
                    length = len(data)  # no record: the walk ends
            at += head + length
    if at > len(data):  # the last record goes beyond the end
        at = (messages if messages[-1:] > others[-1:] else others).pop()
    error: Exception | None = None
    if at < len(data):
        error = struct.error(f"no complete record at byte {at} of {len(data)} in the chunk")
    try:
        budget.take(Cost.RECORDS, len(messages) + len(others) + (error is not None))
    except Oversized as problem:
        error = problem
    return messages, others, error


def unpacked(data: memoryview, chunk: Chunk, budget: ReadingBudget) -> bytes:
    """The records of a chunk, or what can be had of them where the file ends before the chunk does. Raises `Damaged` when they
    are not what was written, `Oversized` when too many.

    The caller has counted `chunk.size` of a whole chunk against the file's budget.
    """
    place, packed = f"{budget.name}: chunk at byte {chunk.start}", data[chunk.data_start : chunk.data_end]
    if chunk.bare:
        return bytes(packed)
    if chunk.data_end > len(data):
        return _torn(packed, chunk, budget)
    if chunk.compression not in ("", "lz4", "zstd"):
        raise Damaged(f"{place} is compressed by {chunk.compression!r}, not zstd or lz4")
    try:
        stated = _stated_size(packed, chunk.compression)
        if stated not in (chunk.size, None):
            raise Damaged(f"{place} claims to hold {chunk.size} bytes, its compressed data state {stated}; run `lab verify`")
        if chunk.size > (most := largest_chunk(budget.size)):
            raise Oversized(f"{place} claims to hold {chunk.size} bytes, limit {most}; {OPTION} lifts the limit")
        raw = _unpacked(packed, chunk, chunk.size + 1)  # a byte more shows that there is more
    except (zstandard.ZstdError, RuntimeError) as error:
        raise Damaged(f"{place} does not decompress: {error}; run `lab verify`") from error
    if len(raw) != chunk.size or (chunk.crc and zlib.crc32(raw) != chunk.crc):
        raise Damaged(f"{place} fails its checksum; run `lab verify`")
    return raw


def _stated_size(packed: memoryview, compression: str) -> int | None:
    """Bytes that packed data state they hold, for which the library would reserve memory; None where they state nothing."""
    if compression == "":
        return len(packed)
    if compression == "lz4":
        return int(lz4.frame.get_frame_info(packed)["content_size"]) or None
    size = zstandard.frame_content_size(packed)
    return None if size < 0 else size


def _unpacked(packed: memoryview, chunk: Chunk, most: int) -> bytes:
    if chunk.compression == "":
        return bytes(packed[:most])
    if chunk.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most))
    if not hasattr(_LOCAL, "zstd"):
        _LOCAL.zstd = _zstd()
    return bytes(_LOCAL.zstd.decompress(packed, max_output_size=most)) if chunk.size else b""


_LOCAL = threading.local()
"""Holds one decompressor for each thread: they cannot be shared."""


def _zstd() -> zstandard.ZstdDecompressor:
    """One that looks back over a bounded number of bytes: a power of two, at most 2 GiB."""
    return zstandard.ZstdDecompressor(max_window_size=min(1 << (largest_chunk(2**31).bit_length() - 1), 2**31))


def _torn(packed: memoryview, chunk: Chunk, budget: ReadingBudget) -> bytes:
    """What can be unpacked of a chunk that the file's end cuts off; empty where nothing can."""
    most, parts = min(chunk.size, largest_chunk(budget.size), budget.left(Cost.UNPACKED)), list[bytes]()
    try:
        if chunk.compression == "zstd":
            with _zstd().stream_reader(packed) as unpacking:
                while most > 0 and (part := unpacking.read(min(most, _PIECE))):
                    parts.append(part)
                    most -= len(part)
        elif chunk.compression in ("", "lz4"):
            parts.append(_unpacked(packed, chunk, most))
        raw = b"".join(parts)
        budget.take(Cost.UNPACKED, len(raw))
    except (zstandard.ZstdError, RuntimeError, Oversized):
        return b""
    return raw
