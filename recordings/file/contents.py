"""What a walk over the records of a file has found: chunks, definitions, attachments, metadata, and what is no record.

A schema, a channel, an attachment or metadata never replaces another one: names that come again get a number.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from ..errors import Damaged, RecordingError
from .budget import PER_CHANNEL, PER_TEXT, Budget, Cost, largest_chunk
from .chunks import MESSAGE, SMALLEST, Chunk, Record, chunk_of

UNPARSABLE = (struct.error, McapError, UnicodeDecodeError, OverflowError)
"""What parsing of bytes raises that are not what they should be."""
RUN = 2**20
"""Bytes of messages outside chunks that are read together."""
_INDEX = struct.Struct("<HI")
_LENGTHS = (struct.Struct("<I"), struct.Struct("<I"), struct.Struct("<Q"))


def attachment_crc(record: Record) -> tuple[int, int]:
    """The checksum of an attachment, and the one that was written (0: none)."""
    at = record.body + 16
    for length in _LENGTHS:  # of name, media type and data
        at += length.size + length.unpack_from(record.source, at)[0]
    return zlib.crc32(record.source[record.body : at]), int(_LENGTHS[0].unpack_from(record.source, at)[0])


@dataclass(frozen=True)
class Hole:
    """Bytes of the file that are no record, and why. `torn`: a chunk that goes beyond the end of the file."""

    start: int
    end: int
    error: RecordingError
    torn: Chunk | None = None


class Fields(ReadDataStream):
    """A record's content, for the library to parse. Unlike the library's stream it never gives fewer bytes than asked for."""

    def __init__(self, record: Record) -> None:
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
class Contents:
    """What a walk over a file of `size` bytes has found; `name` is used in messages."""

    name: str
    size: int
    base: int = 0
    """Byte of the file at which the walked bytes begin."""
    end: int = 0
    """Where the last whole record ends; behind the end mark of a finished file."""
    finished: bool = False
    """Footer and end mark are there."""
    header: Header | None = None
    chunks: list[Chunk] = field(default_factory=list)
    """With the runs of messages outside chunks."""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    holes: list[Hole] = field(default_factory=list)
    broken: set[int] = field(default_factory=set)
    """Where chunks begin of which only the records that make sense are read; of all others everything must."""

    def __post_init__(self) -> None:
        self.budget = Budget(self.name, self.size)
        self._seen: set[int] = set()
        """Of definitions: one that is repeated costs nothing."""
        self._indexed: Chunk | None = None
        """The chunk whose message indexes come next."""

    def take(self, record: Record) -> None:
        """Take note of a record of the file; raises what `UNPARSABLE` lists, or a `RecordingError`."""
        opcode, indexed, self._indexed = record.opcode, self._indexed, None
        if opcode == Opcode.MESSAGE:
            self._message(record)
        elif opcode == Opcode.MESSAGE_INDEX:
            channel, length = _INDEX.unpack_from(record.source, record.body)
            if length % 16:
                raise struct.error("a message index whose length is wrong")
            pairs = record.body + _INDEX.size
            if indexed is not None:
                indexed.indexes.append((channel, pairs, pairs + length))
            self._indexed = indexed
        elif opcode == Opcode.CHUNK:
            chunk = chunk_of(memoryview(record.source), record.start, record.end, self.base)
            if chunk.size <= largest_chunk(self.size):  # one that nothing could hold is not unpacked
                self.budget.take(Cost.UNPACKED, max(chunk.size, SMALLEST))
            self.chunks.append(chunk)
            self._indexed = chunk
        elif opcode == Opcode.HEADER:
            self.header = self.header or Header.read(Fields(record))
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(Fields(record))
            computed, stored = attachment_crc(record)
            if stored not in (0, computed):
                raise Damaged(
                    f"{self.name}: the checksum of the attachment {attachment.name!r} at byte {self.base + record.start} is "
                    f"{computed:08x}, it was written as {stored:08x}; run `lab recover` to leave it out"
                )
            self.attachments[_unique(attachment.name, self.attachments)] = attachment.data
        elif opcode == Opcode.METADATA:
            self.budget.take(Cost.DEFINITIONS, PER_TEXT * (record.end - record.body))
            metadata = Metadata.read(Fields(record))
            self.metadata[_unique(metadata.name, self.metadata)] = metadata.metadata
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.define(record)

    def note(self, hole: Hole) -> None:
        """Take note of a hole; indexes behind it belong to no chunk."""
        self.holes.append(hole)
        self._indexed = None

    def define(self, record: Record) -> None:
        """Take note of a schema or channel, wherever in the file it stands; raises like `take`."""
        body = record.content()
        key = hash((record.opcode, body))
        if key in self._seen:
            return
        kind: type[Schema] | type[Channel] = Schema if record.opcode == Opcode.SCHEMA else Channel
        self.budget.take(Cost.DEFINITIONS, len(body) if kind is Schema else PER_CHANNEL + PER_TEXT * len(body))
        found = kind.read(Fields(record))
        known: dict[int, Schema] | dict[int, Channel] = self.schemas if kind is Schema else self.channels
        if _identity(known.setdefault(found.id, found)) != _identity(found):  # type: ignore[arg-type]
            raise Damaged(
                f"{self.name}: describes {kind.__name__.lower()} {found.id} twice, and differently; run `lab verify`"
            )
        self._seen.add(key)

    def described(self, number: int) -> bool:
        """Whether a channel and its schema have been found."""
        channel = self.channels.get(number)
        return channel is not None and (channel.schema_id == 0 or channel.schema_id in self.schemas)

    def _message(self, record: Record) -> None:
        _, _, log_time, _ = MESSAGE.unpack_from(record.source, record.body)
        last = self.chunks[-1] if self.chunks else None
        if last is None or not last.bare or last.data_end != record.start or last.size > RUN:
            start, end = self.base + record.start, self.base + record.end
            last = Chunk(start, end, log_time, log_time, 0, 0, "", record.start, record.start, bare=True)
            self.chunks.append(last)
        last.end, last.data_end = self.base + record.end, record.end
        last.size = record.end - last.data_start
        last.first_time, last.last_time = min(last.first_time, log_time), max(last.last_time, log_time)

    @property
    def span(self) -> tuple[int, int] | None:
        """First and last log time (ns) that chunks and messages outside chunks state; None where there are none."""
        held = [chunk for chunk in self.chunks if chunk.first_time or chunk.last_time]
        return (min(c.first_time for c in held), max(c.last_time for c in held)) if held else None


def _unique(name: str, taken: dict[str, bytes] | dict[str, dict[str, str]]) -> str:
    """The name, with a number behind it where it is taken."""
    number, other = len(taken), name
    while other in taken:
        number, other = number + 1, f"{name} ({number + 1})"
    return other


def _identity(known: Schema | Channel) -> object:
    """What messages depend on; a channel's metadata may be told differently."""
    return known if isinstance(known, Schema) else (known.topic, known.message_encoding, known.schema_id)
