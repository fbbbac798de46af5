"""One chunk of an MCAP file: where it stands, its records unpacked, and what can be had of one that is cut off.

What a chunk says of its size is checked before anything is unpacked.
"""

from __future__ import annotations

import struct
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import lz4.frame
import zstandard

from ..errors import Damaged, Oversized
from .budget import OPTION, Budget, Cost, largest_chunk

HEAD = struct.Struct("<BQ")
"""Kind and length of a record."""
MESSAGE = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time (ns) of a message record."""
SMALLEST = 1024
"""Bytes that a chunk counts at least: what is done for each."""
_FIRST = struct.Struct("<QQQII")
"""First and last log time, size, checksum, and the length of the compression's name."""
_U64 = struct.Struct("<Q")
_PIECE = 2**16
"""Bytes of a chunk that are unpacked at a time when it is cut off."""


class Record(NamedTuple):
    """A record in `source`: the file, or the bytes of an unpacked chunk. `body`: where its content begins."""

    opcode: int
    start: int
    body: int
    end: int
    source: memoryview | bytes

    def content(self) -> bytes:
        """Its bytes behind kind and length."""
        return bytes(self.source[self.body : self.end])


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
    indexes: list[tuple[int, int, int]] = field(default_factory=list)
    """(channel id, start and end of its (time, offset) pairs in the file)"""


def chunk_of(data: memoryview, start: int, end: int, base: int = 0) -> Chunk:
    """The chunk whose record spans these bytes of `data`, which begins at byte `base` of the file; struct.error or
    UnicodeDecodeError where there is none."""
    first, last, size, crc, letters = _FIRST.unpack_from(data, start + HEAD.size)
    at = start + HEAD.size + _FIRST.size
    compression = bytes(data[at : at + min(letters, 16)]).decode()
    (packed,) = _U64.unpack_from(data, at + letters)
    begin = at + letters + _U64.size
    return Chunk(base + start, base + end, first, last, size, crc, compression, begin, begin + packed)


def decompress(data: memoryview, chunk: Chunk, budget: Budget) -> bytes:
    """The records of a chunk; raises `Damaged` when they are not what was written, `Oversized` when too many.

    The caller has counted `chunk.size` against the file's budget.
    """
    where = f"{budget.name}: chunk at byte {chunk.start}"
    packed = data[chunk.data_start : chunk.data_end]
    _check_size(packed, chunk, budget, where)
    try:
        raw = _unpacked(packed, chunk)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise Damaged(f"{where} does not decompress: {error}; run `lab verify`") from error
    if len(raw) != chunk.size or (chunk.crc and zlib.crc32(raw) != chunk.crc):
        raise Damaged(f"{where} fails its checksum; run `lab verify`")
    return raw


def _check_size(packed: memoryview, chunk: Chunk, budget: Budget, where: str) -> None:
    """Raises `Oversized` or `Damaged` when what a chunk says of its size cannot be true; unpacks nothing."""
    if chunk.compression not in ("", "lz4", "zstd"):
        raise Damaged(f"{where} is compressed by {chunk.compression!r}, not zstd or lz4")
    try:
        size = _packed_size(packed, chunk.compression)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise Damaged(f"{where} does not decompress: {error}; run `lab verify`") from error
    if size not in (chunk.size, None):
        raise Damaged(f"{where} claims to hold {chunk.size} bytes, its compressed data state {size}; run `lab verify`")
    most = largest_chunk(budget.size)
    if chunk.size > most:
        raise Oversized(f"{where} claims to hold {chunk.size} bytes, limit {most}; {OPTION} lifts the limit")


def _packed_size(packed: memoryview, compression: str) -> int | None:
    """Bytes that packed data state they hold, for which the library would reserve memory; None where they state nothing."""
    if compression == "":
        return len(packed)
    if compression == "lz4":
        return int(lz4.frame.get_frame_info(packed)["content_size"]) or None
    size = zstandard.frame_content_size(packed)
    return None if size < 0 else size


def _unpacked(packed: memoryview, chunk: Chunk) -> bytes:
    """Never more than one byte beyond the size that the chunk states."""
    if chunk.compression == "":
        return bytes(packed)
    if chunk.compression == "lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=chunk.size + 1))
    if not chunk.size:
        return b""
    return _unpacker().decompress(packed, max_output_size=chunk.size + 1)


def _unpacker() -> zstandard.ZstdDecompressor:
    """One for each thread: they cannot be shared."""
    if not hasattr(_LOCAL, "zstd"):
        _LOCAL.zstd = zstandard.ZstdDecompressor(max_window_size=_window())
    unpacker: zstandard.ZstdDecompressor = _LOCAL.zstd
    return unpacker


def _window() -> int:
    """Bytes that unpacking may look back; a power of two, at most 2 GiB."""
    return min(1 << (largest_chunk(2**31).bit_length() - 1), 2**31)


_LOCAL = threading.local()


def records_in(raw: bytes, budget: Budget) -> Iterator[Record]:
    """Every record of an unpacked chunk, counted against the budget; the first that is not whole raises struct.error."""
    at = 0
    while at < len(raw):
        budget.take(Cost.RECORDS, 1)
        body = at + HEAD.size
        if body > len(raw):
            raise struct.error(f"no complete record at byte {at} of {len(raw)} in the chunk")
        opcode, length = HEAD.unpack_from(raw, at)
        if opcode == 0 or length > len(raw) - body:
            raise struct.error(f"no complete record at byte {at} of {len(raw)} in the chunk")
        yield Record(opcode, at, body, body + length, raw)
        at = body + length


def torn_bytes(data: memoryview, chunk: Chunk, budget: Budget) -> bytes:
    """The bytes that can be unpacked of a chunk that is cut off by the end of the file."""
    most = min(chunk.size, largest_chunk(budget.size), budget.left(Cost.UNPACKED))
    packed = data[chunk.data_start :]
    raw = b""
    try:
        if chunk.compression == "":
            raw = bytes(packed[:most])
        elif chunk.compression == "lz4":
            raw = bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most))
        elif chunk.compression == "zstd":
            parts: list[bytes] = []
            with zstandard.ZstdDecompressor(max_window_size=_window()).stream_reader(packed) as unpacking:
                while most > 0 and (part := unpacking.read(min(most, _PIECE))):
                    parts.append(part)
                    most -= len(part)
            raw = b"".join(parts)
        budget.take(Cost.UNPACKED, len(raw))
    except (zstandard.ZstdError, RuntimeError, Oversized):
        return b""
    return raw
