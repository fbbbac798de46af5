"""What a walk over the records of a file has found: chunks, definitions, attachments, metadata.

A schema, a channel, an attachment or metadata never replaces another one: names that come again get a number.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from ..bounded import regular
from ..errors import Damaged, NotARecording
from .budget import PER_CHANNEL, PER_TEXT, SMALLEST_CHUNK, Cost, ReadingBudget, largest_chunk
from .chunks import HEAD, Chunk, Chunks, McapRecord

RUN = 2**20
"""Bytes of messages outside chunks that are read together."""
PASSED = 8 * 2**20
"""Bytes that a walk over a file passes before it releases their memory."""
_INDEX = struct.Struct("<HI")
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")


def mapped(path: str | os.PathLike[str]) -> memoryview:
    """A regular file's bytes; raises `NotARecording` when it cannot be read."""
    with open(regular(path, NotARecording), "rb") as file:
        try:
            size = os.fstat(file.fileno()).st_size
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b"")
        except OSError as error:
            raise NotARecording(f"{path}: cannot be read ({error.strerror}); check the path") from error


def let_go(data: memoryview, end: int) -> None:
    """Have the system take back the memory of a mapped file up to byte `end`; it is read again where it is needed again."""
    if isinstance(data.obj, mmap.mmap) and (whole := end // mmap.PAGESIZE * mmap.PAGESIZE):
        data.obj.madvise(mmap.MADV_DONTNEED, 0, whole)


def checksum(data: memoryview, begin: int, end: int, crc: int = 0) -> int:
    """The checksum of bytes of a file, that of those before them being `crc`."""
    for at in range(begin, end, PASSED):
        crc = zlib.crc32(data[at : min(at + PASSED, end)], crc)
        let_go(data, at)
    return crc


def attachment_crc(record: McapRecord) -> tuple[int, int]:
    """The checksum of an attachment, and the one that was written (0: none)."""
    at = record.body + 16
    for length in (_U32, _U32, _U64):  # of name, media type and data
        at += length.size + length.unpack_from(record.source, at)[0]
    return zlib.crc32(record.source[record.body : at]), int(_U32.unpack_from(record.source, at)[0])


@dataclass
class Contents:
    """What a walk over a file of `size` bytes has found; `name` is used in messages."""

    name: str
    size: int
    end: int = 0
    """Where the last whole record ends; behind the end mark of a finished file."""
    finished: bool = False
    """Footer and end mark are there."""
    header: Header | None = None
    chunks: Chunks = field(default_factory=Chunks)
    """With the runs of messages outside chunks."""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.budget = ReadingBudget(self.name, self.size)
        self._seen: set[int] = set()
        """Of definitions: one that is repeated costs nothing."""
        self.indexed: Chunk | None = None
        """The chunk whose message indexes come next."""

    def take(self, record: McapRecord) -> None:
        """Take note of a record of the file; raises what `UNPARSABLE` lists, or a `RecordingError`."""
        opcode, indexed, self.indexed = record.opcode, self.indexed, None
        if opcode == Opcode.MESSAGE:
            self._message(record)
        elif opcode == Opcode.MESSAGE_INDEX:
            channel, length = _INDEX.unpack_from(record.source, record.body)
            if length % 16:
                raise struct.error("a message index whose length is wrong")
            pairs = record.body + _INDEX.size
            if indexed is not None:
                indexed.indexes.append((channel, pairs, pairs + length))
                indexed.channels.add(channel)
            self.indexed = indexed
        elif opcode == Opcode.CHUNK:
            chunk = Chunk.of(record)
            if chunk.size <= largest_chunk(self.size):  # one that nothing could hold is not unpacked
                self.budget.take(Cost.UNPACKED, max(chunk.size, SMALLEST_CHUNK))
            self.chunks.append(chunk)
            self.indexed = chunk
        elif opcode == Opcode.HEADER:
            self.header = self.header or record.read(Header)
        elif opcode == Opcode.ATTACHMENT:
            attachment = record.read(Attachment)
            computed, stored = attachment_crc(record)
            if stored not in (0, computed):
                raise Damaged(
                    f"{self.name}: the checksum of the attachment {attachment.name!r} at byte {record.start} is "
                    f"{computed:08x}, it was written as {stored:08x}; run `lab recover` to leave it out"
                )
            self.attachments[_unique(attachment.name, self.attachments)] = attachment.data
        elif opcode == Opcode.METADATA:
            self.budget.take(Cost.DEFINITIONS, PER_TEXT * (record.end - record.body))
            metadata = record.read(Metadata)
            self.metadata[_unique(metadata.name, self.metadata)] = metadata.metadata
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.define(record)

    def define(self, record: McapRecord) -> None:
        """Take note of a schema or channel, wherever in the file it stands; raises like `take`."""
        body = bytes(record.source[record.body : record.end])
        key = hash((record.opcode, body))
        if key in self._seen:
            return
        kind: type[Schema] | type[Channel] = Schema if record.opcode == Opcode.SCHEMA else Channel
        self.budget.take(Cost.DEFINITIONS, len(body) if kind is Schema else PER_CHANNEL + PER_TEXT * len(body))
        entry = record.read(kind)
        known: dict[int, Schema] | dict[int, Channel] = self.schemas if kind is Schema else self.channels
        if _identity(known.setdefault(entry.id, entry)) != _identity(entry):
            raise Damaged(f"{self.name}: describes {kind.__name__.lower()} {entry.id} twice, and differently; run `lab verify`")
        self._seen.add(key)

    def described(self, number: int) -> bool:
        """Whether a channel and its schema have been found."""
        channel = self.channels.get(number)
        return channel is not None and (channel.schema_id == 0 or channel.schema_id in self.schemas)

    @property
    def schemaless(self) -> list[str]:
        """What is wrong with channels whose schema the file does not hold."""
        lost = [c for c in self.channels.values() if c.schema_id and c.schema_id not in self.schemas]
        return [f"channel {c.topic} names the schema {c.schema_id}, which is missing" for c in lost]

    def _message(self, record: McapRecord) -> None:
        """Add a message outside chunks to the run of those before it, or begin one."""
        (log_time,) = _U64.unpack_from(record.source, record.body + 6)
        run, begin = self.chunks[-1] if self.chunks else None, record.body - HEAD.size
        if run is None or not run.bare or run.data_end != begin or run.size > RUN:
            run = Chunk(record.start, record.start, log_time, log_time, 0, 0, "", begin, begin, bare=True)
            self.chunks.append(run)
        run.end, run.data_end = record.start + record.size, record.end
        run.size = record.end - run.data_start
        run.first_time, run.last_time = min(run.first_time, log_time), max(run.last_time, log_time)

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time (ns) that chunks and messages outside chunks state; None where there are none."""
        timed = [chunk for chunk in self.chunks if chunk.first_time or chunk.last_time]
        return (min(c.first_time for c in timed), max(c.last_time for c in timed)) if timed else None


def _unique(name: str, taken: dict[str, bytes] | dict[str, dict[str, str]]) -> str:
    """The name, with a number behind it where it is taken."""
    number, other = len(taken), name
    while other in taken:
        number, other = number + 1, f"{name} ({number + 1})"
    return other


def _identity(known: Schema | Channel) -> object:
    """What messages depend on; a channel's metadata may differ."""
    return known if isinstance(known, Schema) else (known.topic, known.message_encoding, known.schema_id)
