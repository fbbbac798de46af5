"""MCAP files of any writer: every combination of what the format leaves open, by the library's writer."""

import contextlib
import functools
import io
import itertools
import operator
import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Any
from unittest import mock

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Message, Metadata, Schema
from mcap.writer import CompressionType, IndexType, Writer

MAGIC = b"\x89MCAP0\r\n"
INDEXES = {
    "message index": IndexType.MESSAGE, "attachment index": IndexType.ATTACHMENT, "metadata index": IndexType.METADATA,
    "chunk index": IndexType.CHUNK,
}  # fmt: skip
FEATURES = (*INDEXES, "chunks", "statistics", "repeated schemas", "repeated channels", "summary offsets", "extra bytes")
EXTRA = b"\x01\xff\xff"
FIXED = (Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END, Opcode.FOOTER, Opcode.ATTACHMENT)
"""Records that cannot be longer than their fields, and one that has its extra bytes behind its checksum."""
PACKERS: dict[str, Callable[[bytes], bytes]] = {"": bytes, "lz4": lz4.frame.compress, "zstd": zstandard.compress}
COMPRESSIONS = {"": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}
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


def build(
    inputs: list[Any], features: frozenset[str], compression: str = "", checksums: bool = False, chunk_size: int = 10**9
) -> bytes:
    """The records of `inputs` in one file; a chunk is closed when it holds more than `chunk_size` bytes."""
    out, none = io.BytesIO(), IndexType.NONE
    indexes = [kind if name in features else none for name, kind in INDEXES.items()]
    on = [name in features for name in ("repeated channels", "repeated schemas", "chunks", "statistics", "summary offsets")]
    made = Writer(out, chunk_size, COMPRESSIONS[compression], functools.reduce(operator.or_, indexes), *on, checksums, checksums)
    with padded() if "extra bytes" in features else contextlib.nullcontext():
        made.start("", "conformance")
        for r in inputs:
            if isinstance(r, Schema):
                made.register_schema(r.name, r.encoding, r.data)
            elif isinstance(r, Channel):
                made.register_channel(r.topic, r.message_encoding, r.schema_id, r.metadata)
            elif isinstance(r, Message):
                made.add_message(r.channel_id, r.log_time, r.data, r.publish_time, r.sequence)
            elif isinstance(r, Attachment):
                made.add_attachment(r.create_time, r.log_time, r.name, r.media_type, r.data)
            else:
                made.add_metadata(r.name, r.metadata)
        made.finish()
    data = out.getvalue()
    sealed = written(ATTACHED)  # without checksums that of an attachment is left out too
    return data if checksums else data.replace(sealed[9:], sealed[9:-4] + bytes(4))


@contextlib.contextmanager
def padded() -> Iterator[None]:
    """Records get extra bytes behind their fields where their kind may have them."""
    finish, write = RecordBuilder.finish_record, Attachment.write

    def finish_padded(self: Any) -> None:
        if self._buffer.getbuffer()[self._record_start_offset] not in FIXED:
            self.write(EXTRA)
        finish(self)

    def write_padded(self: Attachment, stream: RecordBuilder) -> None:
        write(self, own := RecordBuilder())
        data = own.end()
        stream.write(data[:1] + struct.pack("<Q", len(data) - 9 + len(EXTRA)) + data[9:] + EXTRA)

    with mock.patch.object(RecordBuilder, "finish_record", finish_padded), mock.patch.object(Attachment, "write", write_padded):
        yield


def written(record: Any) -> bytes:
    """A record."""
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def chunk(raw: bytes, compression: str = "", crc: int | None = None, size: int | None = None) -> bytes:
    """A chunk of records, which may state another checksum, size or compression than it has."""
    packed = PACKERS.get(compression, bytes)(raw)
    return written(Chunk(compression, packed, 19, 10, zlib.crc32(raw) if crc is None else crc, size or len(raw)))


def whole(*parts: bytes) -> bytes:
    """A file that has its end, with no summary."""
    end = written(DataEnd(0)) + struct.pack("<BQQQI", Opcode.FOOTER, 20, 0, 0, 0) + MAGIC
    return b"".join([MAGIC, written(Header("", "another")), *parts, end])
