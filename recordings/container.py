"""The outside of an MCAP file: its records in order, without looking into chunks. Reads whole and truncated files
alike.

Layout: https://mcap.dev/spec. Only record heads are touched, so this costs little however large the file is.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from .errors import NotARecording

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_U64 = struct.Struct("<Q")
_INDEX = struct.Struct("<HI")


@dataclass(frozen=True)
class ChunkPlace:
    """Where a chunk is: `start` of its record, its (compressed) data, and the message indexes that follow it."""

    start: int
    first_time: int
    last_time: int
    size: int
    """Bytes when decompressed."""
    crc: int
    compression: str
    data_start: int
    data_end: int
    indexes: list[tuple[int, int, int]] = field(default_factory=list)
    """(channel id, start and end of its (time, offset) pairs in the file)"""


@dataclass
class Contents:
    """What a walk over the records found."""

    size: int
    end: int = 0
    """Where the last whole record ends; the same as `size` in a file that was finished."""
    finished: bool = False
    """Footer and end mark are there."""
    chunks: list[ChunkPlace] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def add(self, opcode: int, body: bytes) -> None:
        """Take note of a schema or channel, wherever in the file it stands."""
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            self.channels[channel.id] = channel


def walk(data: memoryview, name: str) -> Contents:
    """Walk over the records of a file; `name` is used in messages. Raises `NotARecording` when it is no MCAP file."""
    if bytes(data[: len(MAGIC)]) != MAGIC:
        raise NotARecording(f"{name} is not an MCAP file: it begins with {bytes(data[:8])!r}")
    contents = Contents(len(data), len(MAGIC))
    at, size = len(MAGIC), len(data)
    while at + _HEAD.size <= size:
        opcode, length = _HEAD.unpack_from(data, at)
        body = at + _HEAD.size
        if opcode == 0 or length > size - body:
            break
        _take(contents, opcode, data, body, body + length)
        at = contents.end = body + length
        if opcode == Opcode.FOOTER:
            if data[at : at + len(MAGIC)] == MAGIC:
                contents.finished = True
                contents.end = at + len(MAGIC)
            break
    if not contents.finished and contents.chunks:
        # Some of its indexes may be cut off; without any, its records are walked over instead.
        contents.chunks[-1].indexes.clear()
    return contents


def _take(contents: Contents, opcode: int, data: memoryview, start: int, end: int) -> None:
    if opcode == Opcode.CHUNK:
        contents.chunks.append(_chunk(data, start))
    elif opcode == Opcode.MESSAGE_INDEX and contents.chunks:
        channel, length = _INDEX.unpack_from(data, start)
        pairs = start + _INDEX.size
        contents.chunks[-1].indexes.append((channel, pairs, pairs + length))
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(ReadDataStream(BytesIO(data[start:end])))
        contents.attachments[attachment.name] = attachment.data
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(ReadDataStream(BytesIO(data[start:end])))
        contents.metadata[metadata.name] = metadata.metadata
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        contents.add(opcode, bytes(data[start:end]))


def _chunk(data: memoryview, start: int) -> ChunkPlace:
    first, last, size, crc, name = _CHUNK.unpack_from(data, start)
    at = start + _CHUNK.size
    compression = bytes(data[at : at + name]).decode()
    at += name
    (length,) = _U64.unpack_from(data, at)
    at += _U64.size
    return ChunkPlace(start - _HEAD.size, first, last, size, crc, compression, at, at + length)


def records_in(chunk: memoryview) -> list[tuple[int, int, int, int]]:
    """(opcode, start of the record, start and end of its body) of every record in a decompressed chunk."""
    out, at = [], 0
    while at + _HEAD.size <= len(chunk):
        opcode, length = _HEAD.unpack_from(chunk, at)
        body = at + _HEAD.size
        out.append((opcode, at, body, body + length))
        at = body + length
    return out
