"""The summary at the end of a finished file, held against the records that it points to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, ChunkIndex, MetadataIndex, Schema, Statistics

from .container import ChunkPlace, Head, stream


@dataclass
class Found:
    """What a file's data section holds, and the records of its summary."""

    records: dict[int, Head] = field(default_factory=dict)
    """By the byte where they start."""
    chunks: list[ChunkPlace] = field(default_factory=list)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: dict[int, int] = field(default_factory=dict)
    """Channel -> messages in whole chunks."""
    summary: list[Head] = field(default_factory=list)


def check_summary(data: memoryview, found: Found, start: int) -> Iterator[tuple[int, str]]:
    """(byte, what is wrong) of the summary that begins at byte `start` (0: there is none)."""
    if start and (not found.summary or found.summary[0].start != start):
        yield start, "the footer points to a summary that does not begin there"
    indexed: dict[int, list[int]] = {}
    chunks = {chunk.start: chunk for chunk in found.chunks}
    for head in found.summary:
        if head.opcode == Opcode.CHUNK_INDEX:
            yield from _chunk(head, ChunkIndex.read(stream(data, head)), found, chunks)
        elif head.opcode == Opcode.STATISTICS:
            yield from _statistics(head, Statistics.read(stream(data, head)), found)
        elif head.opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
            kind: Any = AttachmentIndex if head.opcode == Opcode.ATTACHMENT_INDEX else MetadataIndex
            index = kind.read(stream(data, head))
            target = Opcode.ATTACHMENT if head.opcode == Opcode.ATTACHMENT_INDEX else Opcode.METADATA
            yield from _place(head, found, target, index.offset, index.length)
        elif head.opcode == Opcode.CHANNEL:
            channel = Channel.read(stream(data, head))
            if found.channels.get(channel.id) != channel:
                yield head.start, f"the summary describes channel {channel.topic} differently from the data section"
        elif head.opcode == Opcode.SCHEMA:
            schema = Schema.read(stream(data, head))
            if found.schemas.get(schema.id) != schema:
                yield head.start, f"the summary describes schema {schema.name} differently from the data section"
        indexed.setdefault(head.opcode, []).append(head.start)
    for opcode, there in (
        (Opcode.CHUNK_INDEX, len(found.chunks)),
        (Opcode.ATTACHMENT_INDEX, _count(found, Opcode.ATTACHMENT)),
        (Opcode.METADATA_INDEX, _count(found, Opcode.METADATA)),
    ):
        listed = len(indexed.get(opcode, []))
        if listed not in (0, there):
            yield start, f"the summary lists {listed} of {there} ({opcode.name.lower().replace('_', ' ')})"


def _count(found: Found, opcode: Opcode) -> int:
    return sum(head.opcode == opcode for head in found.records.values())


def _place(head: Head, found: Found, opcode: Opcode, offset: int, length: int) -> Iterator[tuple[int, str]]:
    target = found.records.get(offset)
    if target is None or target.opcode != opcode or target.end - target.start != length:
        yield head.start, f"the summary points to byte {offset}, where no {opcode.name.lower()} of {length} bytes is"


def _chunk(head: Head, index: ChunkIndex, found: Found, chunks: dict[int, ChunkPlace]) -> Iterator[tuple[int, str]]:
    yield from _place(head, found, Opcode.CHUNK, index.chunk_start_offset, index.chunk_length)
    chunk = chunks.get(index.chunk_start_offset)
    if chunk is None:
        return
    stated = (index.message_start_time, index.message_end_time, index.uncompressed_size, index.compressed_size)
    if stated != (chunk.first_time, chunk.last_time, chunk.size, chunk.data_end - chunk.data_start):
        yield head.start, f"the summary has other times or sizes for the chunk at byte {chunk.start}"
    # An index record begins with its head (9 bytes), the channel (2) and the length of the pairs (4).
    places = {channel: begin - 15 for channel, begin, _ in chunk.indexes}
    if chunk.indexes and index.message_index_offsets != places:
        yield head.start, f"the summary has other message indexes for the chunk at byte {chunk.start}"


def _statistics(head: Head, stated: Statistics, found: Found) -> Iterator[tuple[int, str]]:
    counts = {channel: n for channel, n in stated.channel_message_counts.items() if n}
    if counts != found.messages or stated.message_count != sum(found.messages.values()):
        yield (
            head.start,
            f"the summary counts {stated.message_count} messages, there are {sum(found.messages.values())}",
        )
    if stated.chunk_count != len(found.chunks):
        yield head.start, f"the summary counts {stated.chunk_count} chunks, there are {len(found.chunks)}"
