"""The summary at the end of a finished file, compared with the records that it points to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, MetadataIndex, Statistics

from .chunks import Chunk, Record
from .contents import UNPARSABLE, Fields

INDEXES: dict[int, tuple[Any, Opcode]] = {
    Opcode.CHUNK_INDEX: (ChunkIndex, Opcode.CHUNK),
    Opcode.ATTACHMENT_INDEX: (AttachmentIndex, Opcode.ATTACHMENT),
    Opcode.METADATA_INDEX: (MetadataIndex, Opcode.METADATA),
}
"""Kind of index -> how it is read, and what it lists."""


def check_summary(
    summary: Sequence[Record],
    places: Mapping[int, tuple[int, int]],
    chunks: Mapping[int, Chunk],
    messages: Mapping[int, int],
) -> Iterator[tuple[int, str]]:
    """(byte, what is wrong) of a summary. `places`: byte -> (kind, length) of each record of the data section that an index
    may list; `chunks` by the byte where they begin; `messages`: count by channel."""
    listed: dict[int, int] = {}
    for record in summary:
        try:
            if record.opcode == Opcode.STATISTICS:
                stated = Statistics.read(Fields(record))
                counts = {channel: n for channel, n in stated.channel_message_counts.items() if n}
                total = sum(messages.values())
                if stated.message_count != total or (counts and counts != messages):
                    yield record.start, f"the summary counts {stated.message_count} messages, there are {total}"
                if stated.chunk_count != len(chunks):
                    yield record.start, f"the summary counts {stated.chunk_count} chunks, there are {len(chunks)}"
            elif record.opcode in INDEXES:
                kind, target = INDEXES[record.opcode]
                index = kind.read(Fields(record))
                chunk = isinstance(index, ChunkIndex)
                offset, length = (
                    (index.chunk_start_offset, index.chunk_length) if chunk else (index.offset, index.length)
                )
                if places.get(offset) != (target, length):
                    what = f"no {target.name.lower()} of {length} bytes is"
                    yield record.start, f"the summary points to byte {offset}, where {what}"
                elif chunk:
                    yield from _chunk(record.start, index, chunks[offset])
                listed[record.opcode] = listed.get(record.opcode, 0) + 1
        except UNPARSABLE as error:
            yield record.start, f"the record of kind {record.opcode} cannot be parsed: {error}"
    for opcode, count in listed.items():
        there = sum(kind == INDEXES[opcode][1] for kind, _ in places.values())
        if count != there:
            yield (
                summary[0].start,
                f"the summary lists {count} of {there} ({Opcode(opcode).name.lower().replace('_', ' ')})",
            )


def _chunk(at: int, index: ChunkIndex, chunk: Chunk) -> Iterator[tuple[int, str]]:
    stated = (index.message_start_time, index.message_end_time, index.uncompressed_size, index.compressed_size)
    if stated != (chunk.first_time, chunk.last_time, chunk.size, chunk.data_end - chunk.data_start):
        yield at, f"the summary has other times or sizes for the chunk at byte {chunk.start}"
    # An index record begins with its head (9 bytes), the channel (2) and the length of the pairs (4).
    places = {channel: begin - 15 for channel, begin, _ in chunk.indexes}
    if index.message_index_offsets.items() - places.items():
        yield at, f"the summary has other message indexes for the chunk at byte {chunk.start}"
