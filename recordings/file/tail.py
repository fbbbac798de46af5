"""A recording while it is written: whatever whole chunks have come since the last look, in the order of the file.

Only the file is read, so the program that writes it notices nothing. A chunk is in the file a tenth of a second after its
first message (`writer.FLUSH_PERIOD`). A file that is finished is read the same way, piece by piece.
"""

from __future__ import annotations

import os
import stat
import struct
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata
from numpy.typing import NDArray

from .. import events
from ..errors import Damaged, NotARecording, Oversized
from ..events import Request
from ..messages import MessageType, is_stream
from . import protobuf_runtime
from .budget import MAX_CHUNK, Budget, Cost
from .container import MAGIC, Contents, Head, chunk_place, head_at, records_in, stream, take_chunk
from .gather import MESSAGE, check_chunk, decompress
from .reader import SAID, LogLine, StateEvent, TrialEvent, log_line, request_event, state_event, trial_event
from .samples import check_version, message_of, ours

BLOCK = 2**20
"""Bytes that are read at a time; more where one record has more."""
LARGEST_RECORD = MAX_CHUNK + 2**20
_HEAD = struct.Struct("<BQ")
_UNPARSABLE = (struct.error, McapError, UnicodeDecodeError, OverflowError)
_NUMBER = MESSAGE.size + 8
"""Bytes of a message record in front of the message itself, behind its own head."""


@dataclass
class Piece:
    """What one chunk holds. Log times in ns since the epoch."""

    until: int = 0
    """Log time of its last message."""
    samples: dict[str, NDArray[np.void]] = field(default_factory=dict)
    """By topic, in the order of the file."""
    numbers: dict[str, list[int]] = field(default_factory=dict)
    """The number of each of these samples: one that is missing was dropped by whoever wrote."""
    states: list[StateEvent] = field(default_factory=list)
    trials: list[TrialEvent] = field(default_factory=list)
    log: list[LogLine] = field(default_factory=list)
    progress: list[Any] = field(default_factory=list)
    """Messages of /progress."""
    requests: list[Request] = field(default_factory=list)
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)
    """All messages as they stand in the file, in its order: number of the channel, log time, bytes."""


def ended(path: str | os.PathLike[str]) -> bool:
    """Whether a file has the end mark of a finished recording."""
    with open(path, "rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - len(MAGIC)))
        return file.tell() > len(MAGIC) and file.read() == MAGIC


class Tail:
    """Follows one file; `read` gives what has come. Raises `NotARecording`, and in `read` any other `RecordingError`."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        try:
            self._fd = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise NotARecording(f"{self.path} cannot be read: {error.strerror}") from error
        if not stat.S_ISREG(os.fstat(self._fd).st_mode):
            self.close()
            raise NotARecording(f"{self.path} is not a file")
        self.contents = Contents(0)
        """Channels, schemas, attachments and metadata so far; `end`: how far it was read; `finished`: its end mark was."""
        self._budget = Budget(str(self.path), 0)
        self._more = False
        """The last reading ended because it had enough."""
        self._layouts: dict[int, MessageType | None] = {}
        """Of each channel; None for one whose messages are not looked at."""

    def grown(self) -> bool:
        """Whether there is more in the file than was read."""
        return not self.contents.finished and (self._more or os.fstat(self._fd).st_size > self.contents.size)

    def read(self, most: int = 64) -> list[Piece]:
        """The next whole chunks, `most` at a time; none while nothing has come."""
        pieces: list[Piece] = []
        while len(pieces) < most and not self.contents.finished:
            data = self._block()
            before = self.contents.end
            if not self._records(data, pieces, most) or self.contents.end == before:
                break
        self._more = len(pieces) >= most
        return pieces

    def _block(self) -> memoryview:
        """What follows what was read, at least one record where it is all there."""
        size = os.fstat(self._fd).st_size
        self.contents.size = size
        self._budget.grow(size)
        at = self.contents.end
        data = os.pread(self._fd, BLOCK, at)
        if at and len(data) >= _HEAD.size and (need := _HEAD.unpack_from(data)[1] + _HEAD.size) > len(data):
            if need > LARGEST_RECORD:
                raise Oversized(f"{self.path}: the record at byte {at} claims {need} bytes, limit {LARGEST_RECORD}")
            data = os.pread(self._fd, need + len(MAGIC), at) if at + need <= size else b""
        return memoryview(data)

    def _records(self, data: memoryview, pieces: list[Piece], most: int) -> bool:
        """Take the whole records of a block; False where nothing more can be done with it."""
        at = 0
        if self.contents.end == 0:
            if len(data) < len(MAGIC):
                return False
            if bytes(data[: len(MAGIC)]) != MAGIC:
                raise NotARecording(f"{self.path} is not an MCAP file: it begins with {bytes(data[:8])!r}")
            at = self.contents.end = len(MAGIC)
        while len(pieces) < most and (head := head_at(data, at)) is not None:
            if head.opcode == Opcode.FOOTER:
                self.contents.finished = bytes(data[head.end : head.end + len(MAGIC)]) == MAGIC
                return False
            try:
                self._take(data, head, pieces)
            except _UNPARSABLE as error:
                raise Damaged(
                    f"{self.path}: the record at byte {self.contents.end} cannot be parsed ({error}); run `lab verify`"
                ) from error
            self.contents.end += head.end - at
            at = head.end
        return True

    def _take(self, data: memoryview, head: Head, pieces: list[Piece]) -> None:
        if head.opcode == Opcode.CHUNK:
            place = chunk_place(data, head)
            check_chunk(data, place, str(self.path))
            take_chunk(place, self._budget)
            raw = decompress(data, replace(place, start=self.contents.end), str(self.path))
            pieces.append(self._piece(raw, place.last_time))
        elif head.opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(stream(data, head))
            self.contents.attachments[attachment.name] = attachment.data
        elif head.opcode == Opcode.METADATA:
            self._budget.take(Cost.DEFINITIONS, head.end - head.body)
            metadata = Metadata.read(stream(data, head))
            self.contents.metadata[metadata.name] = metadata.metadata
        elif head.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._define(head.opcode, bytes(data[head.body : head.end]))

    def _define(self, opcode: int, body: bytes) -> None:
        """A schema or channel; in the summary of a finished file they stand once more."""
        if opcode == Opcode.CHANNEL and struct.unpack_from("<H", body)[0] in self._layouts:
            return
        self.contents.add(opcode, body, self._budget)
        if opcode == Opcode.CHANNEL:
            channel = self.contents.channels[struct.unpack_from("<H", body)[0]]
            self._layouts[channel.id] = self._layout(channel)

    def _layout(self, channel: Channel) -> MessageType | None:
        schema = self.contents.schemas.get(channel.schema_id)
        if not is_stream(channel.topic) or not ours(channel, schema):
            return None
        check_version(channel, str(self.path))
        return message_of(channel, schema, str(self.path))

    def _piece(self, raw: bytes, until: int) -> Piece:
        """The messages of an unpacked chunk."""
        payloads: dict[int, list[tuple[int, int, bytes]]] = {}
        piece = Piece(until)
        for record in records_in(raw, self._budget):
            if record.opcode == Opcode.MESSAGE and record.end - record.body >= _NUMBER:
                number, sequence, log_time = MESSAGE.unpack_from(raw, record.body)
                payload = raw[record.body + _NUMBER : record.end]
                payloads.setdefault(number, []).append((sequence, log_time, payload))
                piece.messages.append((number, log_time, payload))
            elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(record.opcode, raw[record.body : record.end])
        for number, found in payloads.items():
            channel = self.contents.channels.get(number)
            if channel is None:
                raise Damaged(f"{self.path}: a message of channel {number}, which is not described; run `lab verify`")
            layout = self._layouts.get(number)
            if layout is not None:
                piece.samples[channel.topic] = self._samples(channel, layout, [payload for *_, payload in found])
                piece.numbers[channel.topic] = [sequence for sequence, *_ in found]
            elif ours(channel, self.contents.schemas.get(channel.schema_id)):
                self._said(piece, channel, found)
        return piece

    def _samples(self, channel: Channel, layout: MessageType, payloads: list[bytes]) -> NDArray[np.void]:
        if {len(payload) for payload in payloads} == {layout.size}:
            rows = np.frombuffer(b"".join(payloads), np.uint8).reshape(len(payloads), -1)
            if layout.fits(rows):
                return layout.decode(rows.reshape(-1))
        schema = self.contents.schemas.get(channel.schema_id)
        if schema is None:
            raise Damaged(f"{self.path}: {channel.topic} names the schema {channel.schema_id}, which is missing")
        return protobuf_runtime.decode(layout, schema, payloads, len(payloads))

    def _said(self, piece: Piece, channel: Channel, found: list[tuple[int, int, bytes]]) -> None:
        """Messages that are texts, or say how far the run is; those for viewers only repeat the samples."""
        topic = channel.topic
        if topic not in (*SAID, events.PROGRESS.topic):
            return
        check_version(channel, str(self.path))
        self._budget.take(Cost.EVENTS, sum(len(payload) for *_, payload in found))
        for _, log_time, payload in found:
            message = protobuf_runtime.parse(events.EVENTS[topic].message_class, payload, topic)
            if topic == events.STATE.topic:
                piece.states.append(state_event(message))
            elif topic == events.TRIAL.topic:
                piece.trials.append(trial_event(message))
            elif topic == events.LOG.topic:
                piece.log.append(log_line(log_time, message))
            elif topic == events.REQUEST.topic:
                piece.requests.append(request_event(message))
            elif topic == events.PROGRESS.topic:
                piece.progress.append(message)

    def close(self) -> None:
        """No more reading; may be called twice."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def __enter__(self) -> Tail:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
