"""Whether a file is what was written: every checksum, every record, every index against the records it lists.

A finished file carries a checksum over its whole data section, one over its summary, one for each chunk and one for
each attachment, so that no changed byte stays unnoticed. A file that was never finished has those of its chunks.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, DataEnd, Schema
from numpy.typing import NDArray

from ..errors import NotARecording, RecordingError
from .budget import Budget, Cost
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
from .counts import below_zero, counted
from .gather import decompress, index_of
from .reader import Recording, mapped
from .summary import Found, check_summary

_UNPARSABLE = (struct.error, McapError, UnicodeDecodeError, OverflowError)
ENOUGH = 1000
"""Problems after which a file is not looked at further."""
_KNOWN = frozenset(int(opcode) for opcode in Opcode)


@dataclass(frozen=True)
class Problem:
    """What is wrong, and at which byte of the file."""

    at: int
    text: str


@dataclass(frozen=True)
class Verification:
    """What was checked and what was found. `messages`: in chunks that are whole."""

    path: str
    size: int
    finished: bool
    chunks: int
    messages: int
    checksums: int
    """Checksums that were there and were compared."""
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        """Nothing is wrong."""
        return not self.problems

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "ok": self.ok}


@dataclass
class _Check:
    """A walk over a file, with what it has found so far."""

    name: str
    data: memoryview
    budget: Budget
    found: Found = field(default_factory=Found)
    problems: list[Problem] = field(default_factory=list)
    checksums: int = 0
    chunk: ChunkPlace | None = None
    """The chunk whose message indexes come next."""
    expected: dict[int, NDArray[np.uint64]] = field(default_factory=dict)
    """Its messages, from its records; what an index lists is taken out."""

    def problem(self, at: int, text: str) -> None:
        self.problems.append(Problem(at, text))

    # -- records
    def walk(self) -> bool:
        """Check all records; whether the file has its end."""
        at, data_section = len(MAGIC), True
        while (head := head_at(self.data, at)) is not None and len(self.problems) < ENOUGH:
            at = head.end
            if head.opcode != Opcode.MESSAGE_INDEX:
                self._close_chunk()
            try:
                if head.opcode == Opcode.FOOTER:
                    return self._footer(head)
                if data_section:
                    self._record(head)
                else:
                    self.found.summary.append(head)
            except _UNPARSABLE as error:
                self.problem(head.start, f"the record of kind {head.opcode} cannot be parsed: {error}")
            data_section = data_section and head.opcode != Opcode.DATA_END
        self._close_chunk()
        self.problem(
            at, f"no complete record follows; {len(self.data) - at} bytes are left and the file was not finished"
        )
        return False

    def _record(self, head: Head) -> None:
        self.found.records[head.start] = head
        take: dict[int, Callable[[Head], None]] = {
            Opcode.CHUNK: self._chunk,
            Opcode.MESSAGE_INDEX: self._index,
            Opcode.ATTACHMENT: self._attachment,
            Opcode.DATA_END: self._data_end,
            Opcode.SCHEMA: lambda h: self._define(h.opcode, bytes(self.data[h.body : h.end])),
            Opcode.CHANNEL: lambda h: self._define(h.opcode, bytes(self.data[h.body : h.end])),
        }
        if head.opcode in take:
            take[head.opcode](head)
        elif head.opcode not in _KNOWN:
            self.problem(head.start, f"a record of unknown kind {head.opcode}")

    def _define(self, opcode: int, body: bytes) -> None:
        self.budget.take(Cost.DEFINITIONS, len(body))
        source = stream(body, Head(opcode, 0, 0, len(body)))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(source)
            self.found.schemas[schema.id] = schema
            return
        channel = Channel.read(source)
        if channel.schema_id and channel.schema_id not in self.found.schemas:
            raise struct.error(f"channel {channel.topic} names the schema {channel.schema_id}, which is missing")
        self.found.channels[channel.id] = channel
        check_number(self.found.schemas, self.found.channels, self.name)

    def _attachment(self, head: Head) -> None:
        Attachment.read(stream(self.data, head))
        self._compare(
            head.start, zlib.crc32(self.data[head.body : head.end - 4]), self._u32(head.end - 4), "attachment"
        )

    def _data_end(self, head: Head) -> None:
        crc = DataEnd.read(stream(self.data, head)).data_section_crc
        self._compare(head.start, zlib.crc32(self.data[: head.start]), crc, "data section")

    def _footer(self, head: Head) -> bool:
        if self.data[head.end :] != MAGIC:
            self.problem(head.end, "the end mark is missing, or something follows it")
        if head.end - head.body != 20:
            raise struct.error("the footer is not 20 bytes long")
        (start, _, crc) = struct.unpack_from("<QQI", self.data, head.body)
        begin = start or head.start
        if begin > head.start:
            raise struct.error("the footer points past itself")
        self._compare(head.start, zlib.crc32(self.data[begin : head.end - 4]), crc, "summary")
        for at, text in check_summary(self.data, self.found, start):
            self.problem(at, text)
        return True

    def _u32(self, at: int) -> int:
        return int(struct.unpack_from("<I", self.data, at)[0])

    def _compare(self, at: int, computed: int, stored: int, what: str) -> None:
        if stored == 0:
            self.problem(at, f"the {what} carries no checksum")
            return
        self.checksums += 1
        if computed != stored:
            self.problem(at, f"the checksum of the {what} is {computed:08x}, it was written as {stored:08x}")

    # -- chunks
    def _chunk(self, head: Head) -> None:
        chunk = chunk_place(self.data, head)
        self.found.chunks.append(chunk)
        self.chunk, self.expected = chunk, {}
        if chunk.crc == 0:
            self.problem(head.start, "the chunk carries no checksum")
        take_chunk(chunk, self.budget)
        try:
            raw = decompress(self.data, chunk, self.name)
        except RecordingError as error:
            self.problem(head.start, str(error))
            self.chunk = None
            return
        self.checksums += chunk.crc != 0
        strange: set[int] = set()
        for record in records_in(raw, self.budget):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(record.opcode, raw[record.body : record.end])
            elif record.opcode != Opcode.MESSAGE:
                strange.add(record.opcode)
        for opcode in sorted(strange):
            self.problem(head.start, f"the chunk holds a record of kind {opcode}")
        self.expected = index_of(raw)
        for channel, pairs in self.expected.items():
            self.found.messages[channel] = self.found.messages.get(channel, 0) + len(pairs)
            if channel not in self.found.channels:
                self.problem(head.start, f"the chunk holds messages of channel {channel}, which is not described")
        times = [pairs[:, 0] for pairs in self.expected.values()]
        if times and (min(t.min() for t in times), max(t.max() for t in times)) != (chunk.first_time, chunk.last_time):
            self.problem(head.start, "the times of the chunk differ from those of its messages")

    def _index(self, head: Head) -> None:
        channel, start, end = index_place(self.data, head)
        if self.chunk is None:
            return
        self.chunk.indexes.append((channel, start, end))
        listed = np.frombuffer(self.data[start:end], "<u8").reshape(-1, 2)
        there = self.expected.pop(channel, np.zeros((0, 2), "<u8"))
        if not np.array_equal(_sorted(listed), _sorted(there)):
            self.problem(head.start, f"the index of channel {channel} lists other messages than its chunk holds")

    def _close_chunk(self) -> None:
        """The chunk's indexes are over: none may be missing, unless the file has no message indexes at all."""
        if self.chunk is not None and self.expected and self.chunk.indexes:
            missing = ", ".join(map(str, self.expected))
            self.problem(self.chunk.start, f"the chunk has no index of its messages of channel {missing}")
        self.chunk = None


def _sorted(pairs: NDArray[np.uint64]) -> NDArray[np.uint64]:
    return pairs[np.argsort(pairs[:, 1], kind="stable")]


def verify(path: str | os.PathLike[str]) -> Verification:
    """Check a file in full; raises `NotARecording` when it is not a recording or cannot be read, or `Oversized`.

    >>> verify("run.mcap").ok
    True
    """
    path = Path(path)
    data = mapped(path)
    if bytes(data[: len(MAGIC)]) != MAGIC:
        raise NotARecording(f"{path} is not an MCAP file: it begins with {bytes(data[:8])!r}")
    check = _Check(str(path), data, Budget(str(path), len(data)))
    finished = check.walk()
    if not check.problems:
        for text in _contents(path):
            check.problem(0, text)
    return Verification(
        str(path), len(data), finished, len(check.found.chunks), sum(check.found.messages.values()),
        check.checksums, tuple(check.problems),
    )  # fmt: skip


def _contents(path: Path) -> list[str]:
    """What is wrong with the messages and counts of a file whose records are all right."""
    recording = Recording.open(path)
    problems = below_zero(recording.metadata)
    counts = counted(recording.metadata)
    try:
        recording.load()
    except RecordingError as error:
        return [str(error)]
    streams = set(recording.streams)
    for topic in recording.topics:
        try:
            if topic in streams:
                recording.stream(topic)
            written = counts.get(topic, {}).get("written")
            held = len(recording.log_times(topic))
            if written is not None and written != held:
                problems.append(f"{topic}: {written} messages were written, the file holds {held}")
        except RecordingError as error:
            problems.append(f"{topic}: {error}")
    try:
        _ = recording.states, recording.trials, recording.log, recording.zeros, recording.marks
    except RecordingError as error:
        problems.append(str(error))
    return problems
