"""The outside of an MCAP file: its records in order, without looking into chunks. Reads whole and truncated files
alike.

Layout: https://mcap.dev/spec. Only record heads are touched, so this costs little however large the file is. Nothing a
file says about lengths is believed before it is held against the bytes that are there.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from ..errors import Damaged, NotARecording, Oversized
from .budget import MAX_CHANNELS, Budget, Cost, largest_chunk

MAGIC = b"\x89MCAP0\r\n"
SMALLEST = 1024
"""Bytes that a chunk counts at least: what is done for each."""
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_U64 = struct.Struct("<Q")
_INDEX = struct.Struct("<HI")
_UNPARSABLE = (struct.error, McapError, UnicodeDecodeError, OverflowError)


@dataclass(frozen=True)
class Head:
    """One record: `start` of it, `body` where its content begins, `end` of it."""

    opcode: int
    start: int
    body: int
    end: int


def head_at(data: memoryview | bytes, at: int) -> Head | None:
    """The record that begins at a byte; None when none does, or it is not whole."""
    if at + _HEAD.size > len(data):
        return None
    opcode, length = _HEAD.unpack_from(data, at)
    body = at + _HEAD.size
    return None if opcode == 0 or length > len(data) - body else Head(opcode, at, body, body + length)


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

    def add(self, opcode: int, body: bytes, budget: Budget) -> None:
        """Take note of a schema or channel, wherever in the file it stands."""
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            return
        budget.take(Cost.DEFINITIONS, len(body))
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        else:
            channel = Channel.read(stream)
            self.channels[channel.id] = channel
        check_number(self.schemas, self.channels, budget.name)


def walk(data: memoryview, name: str) -> Contents:
    """Walk over the records of a file; `name` is used in messages. Raises `NotARecording` when it is no MCAP file."""
    if bytes(data[: len(MAGIC)]) != MAGIC:
        raise NotARecording(f"{name} is not an MCAP file: it begins with {bytes(data[:8])!r}")
    contents, budget = Contents(len(data), len(MAGIC)), Budget(name, len(data))
    while (head := head_at(data, contents.end)) is not None:
        try:
            _take(contents, data, head, budget)
        except _UNPARSABLE as error:
            raise Damaged(
                f"{name}: the record at byte {head.start} cannot be parsed ({error}); run `lab verify`"
            ) from error
        contents.end = head.end
        if head.opcode == Opcode.FOOTER:
            if data[head.end : head.end + len(MAGIC)] == MAGIC:
                contents.finished = True
                contents.end = head.end + len(MAGIC)
            break
    if not contents.finished and contents.chunks:
        # Some of its indexes may be cut off; without any, its records are walked over instead.
        contents.chunks[-1].indexes.clear()
    return contents


def take_chunk(chunk: ChunkPlace, budget: Budget) -> None:
    """Count what a chunk says that it holds; one that nothing could hold is not unpacked, and does not count."""
    if chunk.size <= largest_chunk(budget.size):
        budget.take(Cost.UNPACKED, max(chunk.size, SMALLEST))


def check_number(schemas: Mapping[int, Schema], channels: Mapping[int, Channel], name: str) -> None:
    """Raises `Oversized` for a file of more channels or schemas than any rig has."""
    if len(schemas) > MAX_CHANNELS or len(channels) > MAX_CHANNELS:
        raise Oversized(f"{name}: describes more than {MAX_CHANNELS} channels or schemas, no recording has so many")


def _take(contents: Contents, data: memoryview, head: Head, budget: Budget) -> None:
    if head.opcode == Opcode.CHUNK:
        chunk = chunk_place(data, head)
        take_chunk(chunk, budget)
        contents.chunks.append(chunk)
    elif head.opcode == Opcode.MESSAGE_INDEX and contents.chunks:
        contents.chunks[-1].indexes.append(index_place(data, head))
    elif head.opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream(data, head))
        contents.attachments[attachment.name] = attachment.data
    elif head.opcode == Opcode.METADATA:
        budget.take(Cost.DEFINITIONS, head.end - head.body)
        metadata = Metadata.read(stream(data, head))
        contents.metadata[metadata.name] = metadata.metadata
    elif head.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        contents.add(head.opcode, bytes(data[head.body : head.end]), budget)


def stream(data: memoryview | bytes, head: Head) -> ReadDataStream:
    """A record's content, for the library to parse."""
    return ReadDataStream(BytesIO(data[head.body : head.end]))


def index_place(data: memoryview, head: Head) -> tuple[int, int, int]:
    """Channel, start and end of the pairs of a message index; struct.error when it is none."""
    channel, length = _INDEX.unpack_from(data, head.body)
    pairs = head.body + _INDEX.size
    if pairs + length != head.end or length % 16:
        raise struct.error("a message index whose length is wrong")
    return channel, pairs, pairs + length


def chunk_place(data: memoryview, head: Head) -> ChunkPlace:
    """Where the parts of a chunk are; struct.error when it is none."""
    first, last, size, crc, name = _CHUNK.unpack_from(data, head.body)
    at = head.body + _CHUNK.size
    if name > 16:
        raise struct.error(f"a compression name of {name} letters")
    compression = bytes(data[at : at + name]).decode()
    at += name
    (length,) = _U64.unpack_from(data, at)
    at += _U64.size
    if at + length != head.end:
        raise struct.error("a chunk whose length is wrong")
    return ChunkPlace(head.start, first, last, size, crc, compression, at, at + length)


def records_in(chunk: bytes, budget: Budget | None = None) -> Iterator[Head]:
    """Every record in a decompressed chunk; the first one that is not whole raises struct.error.

    `budget`: of which they are taken; None when they were counted before.
    """
    at = 0
    while at < len(chunk):
        if budget is not None:
            budget.take(Cost.RECORDS, 1)
        head = head_at(chunk, at)
        if head is None:
            raise struct.error(f"no complete record at byte {at} of {len(chunk)} in the chunk")
        yield head
        at = head.end
