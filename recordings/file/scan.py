"""What can still be read of a damaged or torn file: every record from front to end, going on after what is broken.

A record counts when it is consistent in itself: a chunk by its checksum, an attachment by its own, anything else by its
lengths. Behind a broken record the scan goes on at the next chunk, found by how every packed chunk begins.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import lz4.frame
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from ..errors import Oversized, RecordingError
from .budget import MAX_CHUNK, Budget, Cost, largest_chunk
from .container import (
    MAGIC,
    ChunkPlace,
    Head,
    check_number,
    chunk_place,
    head_at,
    index_place,
    records_in,
    stream,
    take_chunk,
)
from .gather import MESSAGE, check_chunk, decompress

_UNPARSABLE = (struct.error, McapError, UnicodeDecodeError, OverflowError)
_PACKED = re.compile(rb"\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4", re.DOTALL)
_BEFORE_NAME = 9 + 28
"""Bytes of a chunk in front of the length of its compression's name."""
_TIMES = struct.Struct("<QQ")
_PIECE = 2**16
"""Bytes of a torn chunk that are unpacked at a time."""


@dataclass(frozen=True)
class Message:
    """One message as it stands in the file; times in ns."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass
class Chunk:
    """A chunk that can be read. `torn`: what could be unpacked of the last one, which is not whole."""

    place: ChunkPlace | None
    torn: bytes = b""


@dataclass
class Hole:
    """Bytes that make no sense. `behind`: how many readable chunks come before them; `until`: the last log time (ns)
    of the chunk that was there, where its beginning can be read."""

    start: int
    end: int
    behind: int
    until: int | None = None


@dataclass
class Scan:
    """All that a scan found, in the file's order; `budget` is what it may cost."""

    budget: Budget
    library: str = ""
    finished: bool = False
    chunks: list[Chunk] = field(default_factory=list)
    holes: list[Hole] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


def scan(data: memoryview, name: str) -> Scan:
    """Read a file as far as possible; raises nothing, whatever stands in it.

    What goes beyond the file's budget counts as what cannot be read.
    """
    out = Scan(Budget(name, len(data)))
    at = len(MAGIC)
    while at < len(data):
        head = head_at(data, at)
        try:
            if head is None:
                raise struct.error("no whole record")
            if head.opcode == Opcode.FOOTER and data[head.end : head.end + len(MAGIC)] == MAGIC:
                out.finished = True
                break
            _take(out, data, head, name)
        except (*_UNPARSABLE, RecordingError):
            if head is not None and head.opcode != Opcode.CHUNK and _follows(data, head):
                out.holes.append(Hole(at, head.end, len(out.chunks)))
                at = head.end
            else:
                at = _go_on(out, data, at, name)
        else:
            at = head.end
    return out


def _follows(data: memoryview, head: Head) -> bool:
    """Whether another record begins where this one says that it ends."""
    following = head_at(data, head.end)
    if following is None or following.opcode not in tuple(Opcode):
        return False
    try:
        if following.opcode == Opcode.CHUNK:
            chunk_place(data, following)
        elif following.opcode == Opcode.MESSAGE_INDEX:
            index_place(data, following)
    except _UNPARSABLE:
        return False
    return True


def _take(out: Scan, data: memoryview, head: Head, name: str) -> None:
    """Keep a record; raises when it is broken."""
    if head.opcode == Opcode.CHUNK:
        _keep(out, data, chunk_place(data, head), name)
    elif head.opcode == Opcode.MESSAGE_INDEX:
        index_place(data, head)
    elif head.opcode == Opcode.ATTACHMENT:
        if zlib.crc32(data[head.body : head.end - 4]) != struct.unpack_from("<I", data, head.end - 4)[0]:
            raise struct.error("attachment fails its checksum")
        attachment = Attachment.read(stream(data, head))
        out.attachments[attachment.name] = attachment
    elif head.opcode == Opcode.METADATA:
        out.budget.take(Cost.DEFINITIONS, head.end - head.body)
        metadata = Metadata.read(stream(data, head))
        out.metadata[metadata.name] = metadata.metadata
    elif head.opcode == Opcode.HEADER:
        out.library = Header.read(stream(data, head)).library
    elif head.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        _define(out, head.opcode, bytes(data[head.body : head.end]))
    elif head.opcode not in tuple(Opcode):
        raise struct.error("unknown kind")


def _keep(out: Scan, data: memoryview, place: ChunkPlace, name: str) -> None:
    check_chunk(data, place, name)
    take_chunk(place, out.budget)
    raw = decompress(data, place, name)
    for record in records_in(raw, out.budget):
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _define(out, record.opcode, raw[record.body : record.end])
    out.chunks.append(Chunk(place))


def _define(out: Scan, opcode: int, body: bytes) -> None:
    out.budget.take(Cost.DEFINITIONS, len(body))
    check_number(out.schemas, out.channels, name=out.budget.name)
    source = stream(body, Head(opcode, 0, 0, len(body)))
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(source)
        out.schemas.setdefault(schema.id, schema)
    else:
        channel = Channel.read(source)
        out.channels.setdefault(channel.id, channel)


def _go_on(out: Scan, data: memoryview, at: int, name: str) -> int:
    """Behind a broken record: keep the next chunk that can be read, note what lies between; returns where to go on."""
    behind = len(out.chunks)
    search = at
    while (match := _PACKED.search(data, search)) is not None:
        start = match.start() - _BEFORE_NAME
        search = match.end()
        for end in _ends(data, start, match.end()) if start >= at else ():
            try:
                _keep(out, data, chunk_place(data, Head(Opcode.CHUNK, start, start + 9, end)), name)
            except (*_UNPARSABLE, RecordingError):
                continue
            if start > at:
                out.holes.append(Hole(at, start, behind, _until(data, at)))
            return end
    torn = _torn(data, at, out.budget)
    if torn:
        out.chunks.append(Chunk(None, torn))
    out.holes.append(Hole(at, len(data), behind + bool(torn), _until(data, at)))
    return len(data)


def _ends(data: memoryview, start: int, after_name: int) -> list[int]:
    """Where the chunk may end, by the length of its data and by that of its record."""
    if after_name + 8 > len(data) or data[start] != Opcode.CHUNK:
        return []
    (packed,) = struct.unpack_from("<Q", data, after_name)
    (whole,) = struct.unpack_from("<Q", data, start + 1)
    ends = [after_name + 8 + packed, start + 9 + whole]
    return [end for end in dict.fromkeys(ends) if end <= len(data)]


def _until(data: memoryview, at: int) -> int | None:
    """The last log time (ns) that a chunk beginning here tells."""
    if at + 9 + _TIMES.size > len(data) or data[at] != Opcode.CHUNK:
        return None
    first, last = _TIMES.unpack_from(data, at + 9)
    return int(last) if first <= last < 2**63 else None


def _torn(data: memoryview, at: int, budget: Budget) -> bytes:
    """The messages that can be unpacked of a chunk that goes beyond the file's end.

    A chunk that is all there and fails its checksum gives nothing: no number of it could be trusted.
    """
    begin = at + _BEFORE_NAME
    if begin + 4 > len(data) or data[at] != Opcode.CHUNK:
        return b""
    (letters,) = struct.unpack_from("<I", data, begin)
    place = begin + 4 + letters
    if letters > 4 or place + 8 > len(data):
        return b""
    (length,) = struct.unpack_from("<Q", data, place)
    (outer,) = struct.unpack_from("<Q", data, at + 1)
    if place + 8 + length != at + 9 + outer or place + 8 + length <= len(data):
        return b""
    (told,) = struct.unpack_from("<Q", data, at + 9 + _TIMES.size)
    most = min(told, largest_chunk(len(data)), budget.left(Cost.UNPACKED))
    try:
        raw = _first_bytes(bytes(data[begin + 4 : place]), data[place + 8 :], most)
        budget.take(Cost.UNPACKED, len(raw))
        return _whole_messages(raw, budget)
    except (zstandard.ZstdError, RuntimeError, Oversized):
        return b""


def _first_bytes(compression: bytes, packed: memoryview, most: int) -> bytes:
    """What can be unpacked, `most` bytes of it."""
    if compression == b"":
        return bytes(packed[:most])
    if compression == b"lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=most))
    if compression != b"zstd":
        return b""
    parts: list[bytes] = []
    with zstandard.ZstdDecompressor(max_window_size=MAX_CHUNK).stream_reader(packed) as unpacking:
        while most > 0 and (part := unpacking.read(min(most, _PIECE))):
            parts.append(part)
            most -= len(part)
    return b"".join(parts)


def _whole_messages(raw: bytes, budget: Budget) -> bytes:
    """The records at the beginning that are whole."""
    at = 0
    while (head := head_at(raw, at)) is not None and head.opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
        budget.take(Cost.RECORDS, 1)
        at = head.end
    return raw[:at]


def messages(data: memoryview, chunk: Chunk, name: str) -> Iterator[Message]:
    """All messages of a chunk that `scan` found, which has counted them."""
    raw = chunk.torn if chunk.place is None else decompress(data, chunk.place, name)
    for record in records_in(raw):
        if record.opcode == Opcode.MESSAGE and record.end - record.body >= 22:
            channel, sequence, log_time = MESSAGE.unpack_from(raw, record.body)
            (publish,) = struct.unpack_from("<Q", raw, record.body + MESSAGE.size)
            yield Message(channel, sequence, log_time, publish, raw[record.body + 22 : record.end])
