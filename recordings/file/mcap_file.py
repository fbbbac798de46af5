"""Writing an MCAP file: messages into chunks, and behind the last one the summary by which others find everything.

The library's own writer spends several microseconds on each message; here a message costs one `struct.pack`, and a chunk
with its indexes is one write. All other records are the library's.

Layout: https://mcap.dev/spec
"""

from __future__ import annotations

import contextlib
import os
import struct
import threading
import zlib
from array import array
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
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
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from ..errors import WriteFailed
from ..own_files import created, displaced
from .records import MAGIC

MOST = 2**20
"""Bytes of messages after which a chunk is full."""

_MESSAGE = struct.Struct("<BQHIQQ")
_INDEX = struct.Struct("<BQHI")
"""Head of a message index record; last the bytes of its entries, 16 each: log time and offset."""


class Disk:
    """An output for `McapFile` that survives a crash of the process and, soon after, of the machine.

    Nothing is held back in this process. `commit` marks the end of whole records and has them synced to the disk by a
    thread of its own, because a sync may take long and must not hold up writing.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._fd = created(path)
        except FileExistsError:
            raise WriteFailed(f"{path} exists; recordings are never overwritten, choose another name") from None
        except OSError as error:
            raise WriteFailed(f"{path} cannot be created: {error.strerror}") from error
        self.path = path
        self._place = os.path.abspath(path)
        self.position = self._committed = 0
        """Bytes written, and those of whole records."""
        self._failure: OSError | None = None
        self._wake = threading.Event()
        self._closing = False
        self._syncer = threading.Thread(target=self._sync, name="recording-sync", daemon=True)
        self._syncer.start()

    # -- what the MCAP writer needs
    def write(self, data: bytes) -> int:
        """All of it or OSError."""
        if self._failure is not None:
            raise self._failure
        view = memoryview(data)
        while view:
            done = os.write(self._fd, view)
            self.position += done
            view = view[done:]
        return len(data)

    # -- safety
    def commit(self) -> None:
        """Everything written so far is whole records; sync it soon."""
        if self.position > self._committed:
            self._committed = self.position
            self._wake.set()

    def displaced(self) -> str:
        """How the file is no longer what its path names; empty while it is. See the function `displaced`."""
        return displaced(self._place, self._fd, self.position)

    def read(self, start: int, size: int) -> bytes:
        """What the open file holds there, wherever its name is now; fewer bytes where it ends before, none where it fails."""
        try:
            return os.pread(self._fd, size, start)
        except OSError:
            return b""

    def sync(self) -> None:
        """Return when everything written so far is on the disk; OSError when it did not get there."""
        os.fsync(self._fd)

    def _sync(self) -> None:
        while not self._closing:
            self._wake.wait()
            self._wake.clear()
            try:
                os.fsync(self._fd)
            except OSError as error:
                self._failure = error
                return

    def _stop(self) -> None:
        self._closing = True
        self._wake.set()
        self._syncer.join()

    def close(self) -> None:
        """Sync and close; OSError when the data did not reach the disk."""
        self._stop()
        try:
            if self._failure is not None:
                raise self._failure
            os.fsync(self._fd)
        finally:
            os.close(self._fd)

    def give_up(self, cut: bool = True) -> None:
        """Close without an error. `cut`: cut off what is not committed, so that the file ends with a whole record; a file that
        is no longer what its path names is left as it is."""
        self._stop()
        with contextlib.suppress(OSError):
            if cut:
                os.ftruncate(self._fd, min(self._committed, os.fstat(self._fd).st_size))
                os.fsync(self._fd)
        with contextlib.suppress(OSError):
            os.close(self._fd)

    def sync_name(self) -> None:
        """Sync the directory, so that the file is found after a power cut."""
        directory = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


class McapFile:
    """One file being written: zstd chunks, checksums over everything, all indexes."""

    def __init__(self, output: Disk, library: str) -> None:
        self._output = output
        self._crc = 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._counts: dict[int, int] = {}
        self._times: tuple[int, int] | None = None
        self._chunk_indexes: list[ChunkIndex] = []
        self._chunk_crcs = array("L")
        """Of each chunk with its message indexes, as it was written."""
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        # twice as fast as higher levels, for two per cent of size
        self._packer = zstandard.ZstdCompressor(level=3)
        self._records: list[bytes] = []
        self._size = 0
        self._index: dict[int, array[int]] = {}
        self._write(MAGIC)
        self._write(_bytes(Header(profile="", library=library)))

    # -- definitions
    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Define a schema; its number."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._add(_bytes(schema))
        return schema.id

    def channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Define a channel (schema 0: none); its number."""
        number = len(self._channels) + 1
        channel = Channel(id=number, topic=topic, message_encoding=encoding, metadata=metadata, schema_id=schema)
        self._channels.append(channel)
        self._add(_bytes(channel))
        return channel.id

    def metadata(self, name: str, texts: dict[str, str]) -> None:
        """A metadata record."""
        offset, record = self._output.position, _bytes(Metadata(name=name, metadata=texts))
        self._metadata.append(MetadataIndex(offset=offset, length=len(record), name=name))
        self._write(record)

    def attachment(self, name: str, media_type: str, data: bytes, create_time: int, log_time: int) -> None:
        """A file to carry along; times in ns since the epoch."""
        attachment = Attachment(create_time=create_time, log_time=log_time, name=name, media_type=media_type, data=data)
        record = _bytes(attachment)
        index = AttachmentIndex(
            offset=self._output.position, length=len(record), log_time=log_time, create_time=create_time, data_size=len(data),
            name=name, media_type=media_type,
        )  # fmt: skip
        self._attachments.append(index)
        self._write(record)

    # -- messages
    def message(self, channel: int, sequence: int, log_time: int, payload: bytes) -> None:
        """Put a message into the chunk in hand; `log_time` ns since the epoch."""
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = array("Q")
        index.append(log_time)
        index.append(self._size)
        # 5: a message record (Opcode.MESSAGE, whose look-up would cost time); 9: bytes of kind and length
        self._records.append(_MESSAGE.pack(5, _MESSAGE.size - 9 + len(payload), channel, sequence, log_time, log_time))
        self._records.append(payload)
        self._size += _MESSAGE.size + len(payload)

    @property
    def full(self) -> bool:
        """Whether the chunk in hand should be finished."""
        return self._size > MOST

    def _add(self, record: bytes) -> None:
        self._records.append(record)
        self._size += len(record)

    def flush(self) -> None:
        """Finish the chunk in hand, when there is a message in it."""
        if not self._index:
            return
        raw = b"".join(self._records)
        times = [stamp for index in self._index.values() for stamp in (min(index[::2]), max(index[::2]))]
        first, last = min(times), max(times)
        packed = self._packer.compress(raw)
        record = Chunk(
            compression="zstd", data=packed, message_start_time=first, message_end_time=last, uncompressed_crc=zlib.crc32(raw),
            uncompressed_size=len(raw),
        )  # fmt: skip
        chunk = _bytes(record)
        start = self._output.position
        index_offsets, parts, offset = {}, [chunk], start + len(chunk)
        for channel, index in self._index.items():  # time, offset, time, offset ..: 8 bytes each
            parts.append(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + 8 * len(index), channel, 8 * len(index)))
            parts.append(np.array(index, "<u8").tobytes())
            index_offsets[channel] = offset
            offset += _INDEX.size + 8 * len(index)
        block = b"".join(parts)
        self._write(block)
        entry = ChunkIndex(
            chunk_start_offset=start, chunk_length=len(chunk), compression="zstd", compressed_size=len(packed),
            message_start_time=first, message_end_time=last, message_index_offsets=index_offsets,
            message_index_length=offset - start - len(chunk), uncompressed_size=len(raw),
        )  # fmt: skip
        self._enter(entry, block)
        self._records, self._size, self._index = [], 0, {}

    def _enter(self, entry: ChunkIndex, block: bytes) -> None:
        """Take note of a chunk that was written with its message indexes."""
        self._chunk_indexes.append(entry)
        self._chunk_crcs.append(zlib.crc32(block))
        for channel, number in _counts(entry, block).items():
            self._counts[channel] = self._counts.get(channel, 0) + number
        first, last = entry.message_start_time, entry.message_end_time
        self._times = (first, last) if self._times is None else (min(first, self._times[0]), max(last, self._times[1]))

    # -- elsewhere
    def carry_on(self, old: McapFile, read: Callable[[int, int], bytes]) -> dict[int, int]:
        """Go on with what another file was given: definitions, each chunk that `read(start, size)` still finds as it was
        written, and the chunk in hand. Returns the messages by channel that are lost."""
        self._schemas, self._channels = old._schemas, old._channels
        for record in (*self._schemas, *self._channels):
            self._write(_bytes(record))
        for entry, crc in zip(old._chunk_indexes, old._chunk_crcs, strict=True):
            block = read(entry.chunk_start_offset, entry.chunk_length + entry.message_index_length)
            if zlib.crc32(block) != crc:
                continue
            shift = self._output.position - entry.chunk_start_offset
            self._write(block)
            offsets = {channel: offset + shift for channel, offset in entry.message_index_offsets.items()}
            self._enter(replace(entry, chunk_start_offset=entry.chunk_start_offset + shift, message_index_offsets=offsets), block)
        self._records, self._size, self._index = old._records, old._size, old._index
        return {channel: lost for channel, n in old._counts.items() if (lost := n - self._counts.get(channel, 0))}

    # -- the end
    def finish(self) -> None:
        """Finish the chunk in hand, write summary and end mark."""
        self.flush()
        self._write(_bytes(DataEnd(self._crc)))
        start = self._output.position
        first, last = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=len(self._attachments), channel_count=len(self._channels), schema_count=len(self._schemas),
            chunk_count=len(self._chunk_indexes), metadata_count=len(self._metadata), message_count=sum(self._counts.values()),
            channel_message_counts=dict(self._counts), message_start_time=first, message_end_time=last,
        )  # fmt: skip
        summary, offsets = b"", b""
        for opcode, records in (
            (Opcode.SCHEMA, self._schemas), (Opcode.CHANNEL, self._channels), (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunk_indexes), (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ):  # fmt: skip
            if part := b"".join(map(_bytes, records)):
                offset = SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(part))
                offsets += _bytes(offset)
                summary += part
        footer = Footer(summary_start=start, summary_offset_start=start + len(summary), summary_crc=0)
        crc = zlib.crc32(summary + offsets + _bytes(footer)[:-4])
        self._output.write(summary + offsets + _bytes(replace(footer, summary_crc=crc)) + MAGIC)

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._output.write(data)


def _bytes(record: Any) -> bytes:
    """A record as the library writes it."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()
    return data


def _counts(entry: ChunkIndex, block: bytes) -> dict[int, int]:
    """Messages by channel in a chunk, by the lengths of the message indexes that follow it in `block`; 16 bytes a message."""
    places = {channel: at - entry.chunk_start_offset for channel, at in entry.message_index_offsets.items()}
    return {channel: _INDEX.unpack_from(block, at)[3] // 16 for channel, at in places.items()}
