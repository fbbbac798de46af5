"""MCAP files of any writer: every combination of what the format leaves open, built byte by byte."""

import itertools
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
FEATURES = (
    "chunks", "message index", "statistics", "repeated schemas", "repeated channels", "attachment index", "metadata index",
    "chunk index", "summary offsets", "extra bytes",
)  # fmt: skip
FIXED = (Message, Chunk, DataEnd, Footer)
"""Records that cannot be longer than their fields."""
EXTRA = b"\x01\xff\xff"
PACKERS: dict[str, Callable[[bytes], bytes]] = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}
ONE = Schema(1, b"\xf4\x05\x06", "json", "Example")
CHANNEL = Channel(1, "example", "json", {"foo": "bar"}, 1)
BARE = Channel(1, "example", "json", {}, 0)
ATTACHED = Attachment(create_time=2, log_time=1, name="my file", media_type="text/plain", data=bytes(range(256)) * 4)
NOTED = Metadata("my notes", {"foo": "bar"})


def message(number: int, channel: int = 1) -> Message:
    return Message(channel, 10 + number, b'{"x": %d}' % number, 10 + number, number)


INPUTS: dict[str, list[Any]] = {
    "nothing": [],
    "a message": [ONE, CHANNEL, message(0)],
    "a message without schema": [BARE, message(0)],
    "an attachment": [ATTACHED],
    "metadata": [NOTED],
    "ten messages": [ONE, CHANNEL, *map(message, range(10))],
    "everything": [NOTED, ONE, CHANNEL, *map(message, range(3)), ATTACHED, *map(message, range(3, 7)), NOTED],
}


def combinations() -> Iterator[frozenset[str]]:
    for flags in itertools.product((False, True), repeat=len(FEATURES)):
        yield frozenset(name for name, on in zip(FEATURES, flags, strict=True) if on)


@dataclass
class Built:
    """A file, and what a reader must find in it."""

    data: bytes
    counts: dict[int, int] = field(default_factory=dict)
    chunks: int = 0


def build(
    inputs: list[Any], features: frozenset[str], compression: str = "", checksums: bool = False, per_chunk: int = 10**9
) -> Built:
    """The records of `inputs` in one file; a chunk is closed after `per_chunk` messages."""
    pad = EXTRA if "extra bytes" in features else b""
    out, summary = bytearray(MAGIC), list[tuple[int, Any]]()
    built, chunk, indexes = Built(b""), bytearray(), dict[int, list[tuple[int, int]]]()
    out += written(Header("", "conformance"), pad)

    def close() -> None:
        if not chunk:
            return
        packed, raw = PACKERS[compression](bytes(chunk)), bytes(chunk)
        times = [time for index in indexes.values() for time, _ in index] or [0]
        record = Chunk(compression, packed, max(times), min(times), zlib.crc32(raw) if checksums else 0, len(raw))
        start, body = len(out), written(record)
        out.extend(body)
        places = {}
        after = len(out)
        for number, index in indexes.items() if "message index" in features else ():
            places[number] = len(out)
            out.extend(written(MessageIndex(number, index), pad))
        listed = ChunkIndex(
            len(body), start, compression, len(packed), max(times), len(out) - after, places, min(times), len(raw)
        )
        summary.append((Opcode.CHUNK_INDEX, listed))
        built.chunks += 1
        chunk.clear()
        indexes.clear()

    for record in inputs:
        inner = isinstance(record, Schema | Channel | Message)
        if isinstance(record, Message):
            built.counts[record.channel_id] = built.counts.get(record.channel_id, 0) + 1
        if inner and "chunks" in features:
            if isinstance(record, Message):
                indexes.setdefault(record.channel_id, []).append((record.log_time, len(chunk)))
            chunk += written(record, pad)
            if sum(map(len, indexes.values())) >= per_chunk:
                close()
            continue
        start, body = len(out), written(record, pad, checksums)
        out += body
        if isinstance(record, Attachment):
            about = AttachmentIndex(start, len(body), 1, 2, len(record.data), record.name, record.media_type)
            summary.append((Opcode.ATTACHMENT_INDEX, about))
        elif isinstance(record, Metadata):
            summary.append((Opcode.METADATA_INDEX, MetadataIndex(start, len(body), record.name)))
    close()
    out += written(DataEnd(zlib.crc32(out) if checksums else 0))
    out += _summary(inputs, features, summary, built, len(out), pad, checksums)
    built.data = bytes(out + MAGIC)
    return built


def _summary(
    inputs: list[Any],
    features: frozenset[str],
    listed: list[tuple[int, Any]],
    built: Built,
    start: int,
    pad: bytes,
    checksums: bool,
) -> bytes:
    def kinds(kind: Any) -> list[Any]:
        return [record for record in inputs if isinstance(record, kind)]

    counts = built.counts
    statistics = Statistics(
        len(kinds(Attachment)), len(kinds(Channel)), counts, built.chunks, sum(counts.values()), 0, 0, len(kinds(Metadata)),
        len(kinds(Schema)),
    )  # fmt: skip
    groups = {
        Opcode.SCHEMA: kinds(Schema) if "repeated schemas" in features else [],
        Opcode.CHANNEL: kinds(Channel) if "repeated channels" in features else [],
        Opcode.STATISTICS: [statistics] if "statistics" in features else [],
    }
    for name, opcode in (
        ("metadata index", Opcode.METADATA_INDEX),
        ("attachment index", Opcode.ATTACHMENT_INDEX),
        ("chunk index", Opcode.CHUNK_INDEX),
    ):
        groups[opcode] = [record for kind, record in listed if kind == opcode and name in features]
    out, offsets = b"", b""
    for opcode, records in groups.items():
        part = b"".join(written(record, pad) for record in records)
        if "summary offsets" in features and (part or opcode in (Opcode.METADATA_INDEX, Opcode.CHUNK_INDEX)):
            offsets += written(SummaryOffset(opcode, start + len(out), len(part)), pad)
        out += part
    at = start + len(out) if offsets else 0
    foot = struct.pack("<BQQQ", Opcode.FOOTER, 20, start if out else 0, at)
    crc = zlib.crc32(out + offsets + foot) if checksums else 0
    return out + offsets + foot + struct.pack("<I", crc)


def written(record: Any, pad: bytes = b"", checksums: bool = True) -> bytes:
    """A record, with extra bytes behind its fields where its kind may have them."""
    builder = RecordBuilder()
    record.write(builder)
    data = bytes(builder.end())
    if isinstance(record, Attachment) and not checksums:
        data = data[:-4] + bytes(4)
    if pad and not isinstance(record, FIXED):
        data = struct.pack("<BQ", data[0], len(data) - 9 + len(pad)) + data[9:] + pad
    return data
