"""Whether a file is what was written: every checksum, every record, every index compared with the records that it lists.

A checksum of 0 means that none was computed, which is no damage: the answer then names the parts that no checksum covers.
"""

from __future__ import annotations

import os
import struct
from array import array
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, MetadataIndex, Statistics

from ..errors import NotARecording, OtherVersion, Oversized, RecordingError
from ..json_text import Plain
from .chunks import UNPARSABLE, Chunk, McapRecord, Messages
from .contents import Contents, attachment_crc, checksum, let_go, mapped
from .counts import below_zero, counted
from .reader import Recording
from .records import MAGIC, Hole, record_at, records

INTACT, UNCOVERED, DAMAGED = "intact", "intact as far as checksums reach", "damaged"
INDEXES: dict[int, tuple[Any, Opcode]] = {
    Opcode.CHUNK_INDEX: (ChunkIndex, Opcode.CHUNK),
    Opcode.ATTACHMENT_INDEX: (AttachmentIndex, Opcode.ATTACHMENT),
    Opcode.METADATA_INDEX: (MetadataIndex, Opcode.METADATA),
}
"""Kind of index of the summary -> how it is read, and what it lists."""
LISTED = [kind for _, kind in INDEXES.values()]
_INDEX_HEAD = 15
"""Bytes of a message index before its pairs: kind and length (9), channel (2), length of the pairs (4)."""
_FOOTER = struct.Struct("<QQI")


@dataclass(frozen=True)
class FileProblem:
    """What is wrong, and at which byte of the file."""

    at: int
    text: str


@dataclass(frozen=True)
class Verification(Plain):
    """What was checked and what was found. `messages`: in chunks that are whole, and outside chunks."""

    path: str
    size: int
    finished: bool
    chunks: int
    messages: int
    checksums: int
    """Checksums that were there and were compared."""
    uncovered: tuple[str, ...]
    """Parts that no checksum covers."""
    problems: tuple[FileProblem, ...]

    @property
    def ok(self) -> bool:
        """Nothing is wrong."""
        return not self.problems

    @property
    def verdict(self) -> str:
        """`INTACT`, `UNCOVERED` or `DAMAGED`."""
        return DAMAGED if self.problems else UNCOVERED if self.uncovered else INTACT


@dataclass
class _Check:
    """A walk over a file, with its findings up to here."""

    data: memoryview
    contents: Contents
    problems: list[FileProblem] = field(default_factory=list)
    checksums: int = 0
    bare: Counter[str] = field(default_factory=lambda: Counter(outside=1))
    """Parts that no checksum covers."""
    oversized: Oversized | None = None
    """Why a part was not read."""
    messages: Counter[int] = field(default_factory=Counter)
    """Count by channel."""
    kinds: Counter[int] = field(default_factory=Counter)
    """Count of the records that the summary may list, by kind."""
    places: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Byte -> kind and length of those of them that are no chunks."""
    summary: array[int] = field(default_factory=lambda: array("Q"))
    """Where its records begin."""
    data_end: int | None = None
    """Where the data section ends."""
    chunk: Chunk | None = None
    """The chunk whose messages or message indexes come next, and the messages."""
    held: Messages | None = None

    def problem(self, at: int, text: str) -> None:
        self.problems.append(FileProblem(at, text))

    def walk(self) -> None:
        """Go through the file once and note each problem, up to a thousand."""
        for item in records(self.data, self.contents, unpack=True):
            if len(self.problems) >= 1000:
                return
            if isinstance(item, Hole):
                self._close_chunk(whole=False)
                if isinstance(item.error, Oversized):
                    self.oversized = self.oversized or item.error
                elif item.end < len(self.data) or self.contents.finished:
                    self.problem(item.start, str(item.error))
            elif isinstance(item, Messages):
                self.messages.update(item.heads["channel"].tolist())
                self.bare["messages"] += len(item) * item.chunk.bare
                if item.chunk is self.chunk:
                    self.held = item
            else:
                try:
                    self._record(item)
                except UNPARSABLE as error:
                    self.problem(item.start, f"the record of kind {item.opcode} cannot be parsed: {error}")
        self._close_chunk()
        if self.oversized is not None:
            self.problem(0, str(self.oversized))
        for number in self.messages.keys() - self.contents.channels.keys():
            self.problem(0, f"messages of channel {number}, which is not described")
        self.problems += [FileProblem(0, text) for text in self.contents.schemaless]
        if not self.contents.finished:
            end = self.contents.end
            self.problem(end, f"no complete record follows; {len(self.data) - end} bytes are left and the file was not finished")

    # -- records
    def _record(self, record: McapRecord) -> None:
        """Check one record's checksum, and note where it stands; records of the summary wait for the footer."""
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._close_chunk()
        if record.opcode == Opcode.FOOTER:
            self._footer(record)
        elif self.data_end is not None:
            self.summary.append(record.start)
        elif record.opcode == Opcode.CHUNK:
            self.chunk = self.contents.chunks[-1]
            self.checksums += self.chunk.crc != 0
            self.bare["chunks"] += not self.chunk.crc
        elif record.opcode == Opcode.ATTACHMENT:
            self.bare["attachments"] += not self._compare(record.start, *attachment_crc(record), "attachment")
        elif record.opcode == Opcode.DATA_END:
            self.data_end = record.start
            (crc,) = struct.unpack_from("<I", self.data, record.body)
            computed = checksum(self.data, 0, record.start)
            if crc and crc == computed:
                self.bare.clear()  # it covers all parts up to here
            elif crc and crc == self._without_chunks(record.start):
                self.bare, computed = Counter(chunks=self.bare["chunks"]), crc
            self._compare(record.start, computed, crc, "data section")
            if self.oversized is not None and crc in (0, computed):
                raise self.oversized  # the size is what was written, and no damage
        if record.opcode in LISTED:
            self.kinds[record.opcode] += 1
            if record.opcode != Opcode.CHUNK:
                self.places[record.start] = (record.opcode, record.size)

    def _without_chunks(self, end: int) -> int:
        """The checksum of the data section as some writers compute it: without what stands in chunks that have none."""
        crc, at = 0, 0
        for chunk in self.contents.chunks:
            if not (chunk.crc or chunk.bare):
                crc, at = checksum(self.data, at, chunk.data_start, crc), chunk.data_end
        return checksum(self.data, at, end, crc)

    def _compare(self, at: int, computed: int, stored: int, what: str) -> bool:
        """Whether a checksum is `stored`; notes a problem where it differs from the one `computed`."""
        self.checksums += stored != 0
        if stored not in (0, computed):
            self.problem(at, f"the checksum of the {what} is {computed:08x}, it was written as {stored:08x}")
        return stored != 0

    def _close_chunk(self, whole: bool = True) -> None:
        """Check the chunk's indexes: each lists what the chunk holds, and none is missing unless the file has none at all."""
        chunk, messages = self.chunk, self.held
        self.chunk = self.held = None
        if chunk is None or messages is None:
            return
        by_channel = dict(messages.by_channel())
        for channel, start, end in chunk.indexes:
            of_channel = by_channel.pop(channel, messages.which(slice(0)))
            pairs = np.frombuffer(self.data[start:end], "<u8").reshape(-1, 2)
            pairs = pairs[np.argsort(pairs[:, 1], kind="stable")]
            if not np.array_equal(pairs, np.column_stack([of_channel.heads["log"], of_channel.starts.astype(np.uint64)])):
                self.problem(start - _INDEX_HEAD, f"the index of channel {channel} lists other messages than its chunk holds")
        times = messages.heads["log"]
        if not whole:
            return
        if len(times) and (times.min(), times.max()) != (chunk.first_time, chunk.last_time):
            self.problem(chunk.start, "the times of the chunk differ from those of its messages")
        if by_channel and chunk.indexes:
            self.problem(chunk.start, f"the chunk has no index of its messages of channel {', '.join(map(str, by_channel))}")

    # -- the end
    def _footer(self, record: McapRecord) -> None:
        """Check the end of the file, and the summary in front of it against what the walk has met."""
        end, size = record.end, record.end - record.body
        if self.data[end : end + len(MAGIC)] != MAGIC:
            self.problem(end, "the end mark is missing")
        if size != _FOOTER.size:
            self.problem(record.start, f"the footer is {size} bytes long, not {_FOOTER.size}")
        if self.data_end is None:
            self.problem(record.start, "no record marks the end of the data")
        start, offsets, crc = _FOOTER.unpack_from(self.data, record.body)
        first = self.summary[0] if self.summary else record.start
        # 0: the part is left out
        if start not in (0, first) or (offsets not in (0, record.start) and offsets not in self.summary):
            self.problem(record.start, "the footer points to a summary that does not begin there")
            return
        begin = start or offsets or record.start
        summary = checksum(self.data, begin, record.body + 16)
        self.bare["summary"] += not self._compare(record.start, summary, crc, "summary") and bool(self.summary)
        listed: Counter[int] = Counter()
        for number, place in enumerate(self.summary):
            if number % 1000 == 0:
                let_go(self.data, place)  # the records that it points to were read
            try:
                item = record_at(self.data, place)
                self._listed(item)
                if item.opcode in INDEXES:
                    listed[item.opcode] += 1
            except UNPARSABLE as error:
                self.problem(place, f"the record of kind {self.data[place]} cannot be parsed: {error}")
        for opcode, count in listed.items():
            counted = self.kinds[INDEXES[opcode][1]]
            if count != counted:
                kind = Opcode(opcode).name.lower().replace("_", " ")
                self.problem(self.summary[0], f"the summary lists {count} of {counted} ({kind})")

    def _listed(self, record: McapRecord) -> None:
        """Compare a record of the summary with what it counts or points to."""
        if record.opcode == Opcode.STATISTICS:
            stated, total = record.read(Statistics), self.messages.total()
            counts = {channel: n for channel, n in stated.channel_message_counts.items() if n}
            if stated.message_count != total or (counts and counts != self.messages):
                self.problem(record.start, f"the summary counts {stated.message_count} messages, there are {total}")
            if stated.chunk_count != (chunks := self.kinds[Opcode.CHUNK]):
                self.problem(record.start, f"the summary counts {stated.chunk_count} chunks, there are {chunks}")
        elif record.opcode in INDEXES:
            kind, target = INDEXES[record.opcode]
            index = record.read(kind)
            of_chunk = target == Opcode.CHUNK
            place, length = (index.chunk_start_offset, index.chunk_length) if of_chunk else (index.offset, index.length)
            chunk = self.contents.chunks.at(place) if of_chunk else None
            known = (target, length) == (self.places.get(place) if chunk is None else (Opcode.CHUNK, chunk.end - chunk.start))
            if not known or (of_chunk and (chunk is None or chunk.bare)):
                what = f"no {target.name.lower()} of {length} bytes is"
                self.problem(record.start, f"the summary points to byte {place}, where {what}")
            elif chunk is not None:
                what = f"for the chunk at byte {place}"
                times = (index.message_start_time, index.message_end_time)
                sizes = (index.uncompressed_size, index.compressed_size)
                of_file = (chunk.first_time, chunk.last_time, chunk.size, chunk.data_end - chunk.data_start)
                if (*times, *sizes) != of_file:
                    self.problem(record.start, f"the summary has other times or sizes {what}")
                if index.message_index_offsets.items() - self._indexes_behind(chunk).items():
                    self.problem(record.start, f"the summary has other message indexes {what}")

    def _indexes_behind(self, chunk: Chunk) -> dict[int, int]:
        """Where the message indexes of a chunk begin, by channel."""
        places, item = {}, record_at(self.data, chunk.end)
        while item.opcode == Opcode.MESSAGE_INDEX:
            places[int.from_bytes(self.data[item.body : item.body + 2], "little")] = item.start
            item = record_at(self.data, item.end)
        return places

    def uncovered(self) -> tuple[str, ...]:
        """Parts that no checksum covers."""
        kinds, bare = self.kinds, self.bare
        texts = {
            "outside": "header, definitions, metadata and indexes outside chunks",
            "chunks": f"{bare['chunks']} of {kinds[Opcode.CHUNK]} chunks",
            "attachments": f"{bare['attachments']} of {kinds[Opcode.ATTACHMENT]} attachments",
            "messages": f"{bare['messages']} messages outside chunks",
            "summary": "the summary",
        }
        return tuple(text for part, text in texts.items() if bare[part])


def check(path: Path) -> Verification:
    """Check the records of a file, but not what its messages say; raises `NotARecording` or `Oversized`."""
    data = mapped(path)
    walk = _Check(data, Contents(str(path), len(data)))
    walk.walk()
    return Verification(
        str(path), len(data), walk.contents.finished, walk.kinds[Opcode.CHUNK], walk.messages.total(),
        walk.checksums, walk.uncovered(), tuple(walk.problems),
    )  # fmt: skip


def verify(path: str | os.PathLike[str]) -> Verification:
    """Check a file in full; raises `NotARecording` when it is not a recording or cannot be read, or `Oversized`.

    >>> verify("run.mcap").verdict
    'intact'
    """
    verification = check(Path(path))
    if verification.problems:
        return verification
    return replace(verification, problems=tuple(FileProblem(0, text) for text in _content_problems(Path(path))))


def _content_problems(path: Path) -> list[str]:
    """What is wrong with the messages and counts of a file whose records are all right."""
    counts, faults = Counter[str](), dict[str, RecordingError]()
    try:
        recording = Recording.open(path)
        for stretch in recording.sweep(faults):
            for number, times in stretch.times.items():
                if number in recording.contents.channels:
                    counts[recording.contents.channels[number].topic] += len(times)
    except RecordingError as error:
        return [str(error)]
    problems, stated = below_zero(recording.metadata), counted(recording.metadata)
    for topic in recording.topics:
        written = stated.get(topic, {}).get("written")
        if written is not None and written != counts[topic]:
            problems.append(f"{topic}: {written} messages were written, the file holds {counts[topic]}")
    for name in ("states", "trials", "log", "zeros", "marks"):
        try:
            getattr(recording, name)
        except RecordingError as error:
            faults[name] = error
    # of another version, or merged: sound, but nothing that this software computes with
    return problems + [str(error) for error in faults.values() if not isinstance(error, (NotARecording, OtherVersion))]
