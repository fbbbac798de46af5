"""A recording while it is written: whatever whole chunks have come since the last look, in the order of the file.

Only the file is read, so the program that writes it notices nothing. A chunk is in the file a tenth of a second after its
first message (`writer.FLUSH_PERIOD`). A file that is finished is read the same way, piece by piece.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel
from numpy.typing import NDArray

from .. import events
from ..errors import Damaged, NotARecording, Oversized
from ..events import Request
from ..messages import MessageType, is_stream
from . import protobuf_runtime
from .budget import OPTION, Cost, largest_chunk
from .chunks import HEAD, MESSAGE, Record
from .contents import Contents, Hole
from .reader import SAID, LogLine, StateEvent, TrialEvent, log_line, request_event, state_event, trial_event
from .records import MAGIC, demand_mcap, inside, records
from .samples import check_version, message_of, ours

BLOCK = 2**20
"""Bytes that are read at a time; more where one record has more."""


@dataclass
class Piece:
    """What one chunk holds, or messages outside chunks that follow each other. Log times in ns since the epoch."""

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
        self.contents = Contents(str(self.path), 0)
        """Channels, schemas, attachments and metadata so far; `end`: how far it was read; `finished`: its end mark was."""
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
            if before == 0:
                if len(data) < len(MAGIC):
                    break
                demand_mcap(data, str(self.path))
                self.contents.end = len(MAGIC)
            self._take(data, pieces, most)
            if self.contents.end == before:
                break
        self._more = len(pieces) >= most
        return pieces

    def _block(self) -> memoryview:
        """What follows what was read, at least one record where it is all there."""
        size = os.fstat(self._fd).st_size
        at = self.contents.base = self.contents.end
        self.contents.size = size
        self.contents.budget.grow(size)
        data = os.pread(self._fd, BLOCK, at)
        if at and len(data) >= HEAD.size and (need := HEAD.unpack_from(data)[1] + HEAD.size) > len(data):
            if need > (most := largest_chunk(2**62) + BLOCK):
                raise Oversized(
                    f"{self.path}: the record at byte {at} claims {need} bytes, limit {most}; {OPTION} lifts the limit"
                )
            data = os.pread(self._fd, need + len(MAGIC), at) if at + need <= size else b""
        return memoryview(data)

    def _take(self, data: memoryview, pieces: list[Piece], most: int) -> None:
        """Make pieces of the whole records of a block, until there are enough."""
        bare: list[Record] = []
        for item in records(data, self.contents, growing=True):
            if isinstance(item, Hole):
                raise item.error
            if item.opcode == Opcode.MESSAGE:
                bare.append(item)
            elif item.opcode == Opcode.CHUNK:
                self._add(pieces, bare)
                bare, chunk = [], self.contents.chunks[-1]
                pieces.append(self._piece(inside(data, chunk, self.contents), chunk.last_time))
                if len(pieces) >= most:
                    break
        self._add(pieces, bare)
        self.contents.chunks.clear()

    def _add(self, pieces: list[Piece], bare: list[Record]) -> None:
        """A piece of messages outside chunks."""
        if bare:
            pieces.append(self._piece(bare, max(MESSAGE.unpack_from(r.source, r.body)[2] for r in bare)))

    def _layout(self, channel: Channel) -> MessageType | None:
        schema = self.contents.schemas.get(channel.schema_id)
        if not is_stream(channel.topic) or not ours(channel, schema):
            return None
        check_version(channel, str(self.path))
        return message_of(channel, schema, str(self.path))

    def _piece(self, found: Iterable[Record | Hole], until: int) -> Piece:
        """The messages among records."""
        payloads: dict[int, list[tuple[int, int, bytes]]] = {}
        piece = Piece(until)
        for record in found:
            if isinstance(record, Hole):
                raise record.error
            if record.opcode == Opcode.MESSAGE:
                number, sequence, log_time, _ = MESSAGE.unpack_from(record.source, record.body)
                payload = bytes(record.source[record.body + MESSAGE.size : record.end])
                payloads.setdefault(number, []).append((sequence, log_time, payload))
                piece.messages.append((number, log_time, payload))
        for number, held in payloads.items():
            channel = self.contents.channels.get(number)
            if channel is None:
                raise Damaged(f"{self.path}: a message of channel {number}, which is not described; run `lab verify`")
            if number not in self._layouts:
                self._layouts[number] = self._layout(channel)
            layout = self._layouts[number]
            if layout is not None:
                samples = self._samples(channel, layout, [payload for *_, payload in held])
                numbers = [sequence for sequence, *_ in held]
                if channel.topic in piece.samples:
                    raise Damaged(f"{self.path}: several channels carry {channel.topic}, as in files that were merged")
                piece.samples[channel.topic], piece.numbers[channel.topic] = samples, numbers
            elif ours(channel, self.contents.schemas.get(channel.schema_id)):
                self._said(piece, channel, held)
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
        self.contents.budget.take(Cost.EVENTS, sum(len(payload) for *_, payload in found))
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
