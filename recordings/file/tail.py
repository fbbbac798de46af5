"""A recording while it is written: what has come since the last look, chunk by chunk, in the order of the file.

Only the file is read, so the program that writes it notices nothing. A chunk is in the file a tenth of a second after its
first message (`writer.FLUSH_PERIOD`). A file that is finished is read the same way, piece by piece.
"""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray

from .. import events
from ..bounded import regular
from ..errors import Damaged, NotARecording, Oversized
from ..messages import MessageType, is_stream
from .budget import OPTION, Cost, largest_chunk
from .chunks import HEAD, Messages
from .contents import Contents
from .records import MAGIC, Hole, records
from .samples import check_version, message_of, ours, parse, samples_of

BLOCK = 2**20
"""Bytes that are read at a time; more where one record has more."""
FOLLOWED = tuple(e.topic for e in (events.STATE, events.TRIAL, events.LOG, events.REQUEST, events.PROGRESS))
"""Events that are taken apart; those for viewers only repeat the samples."""


@dataclass
class Piece:
    """What one chunk holds, or messages outside chunks that follow each other. Log times in ns since the epoch."""

    until: int = 0
    """Log time of its last message."""
    samples: dict[str, NDArray[np.void]] = field(default_factory=dict)
    """By topic, in the order of the file."""
    numbers: dict[str, list[int]] = field(default_factory=dict)
    """The number of each of these samples: one that is missing was dropped by whoever wrote."""
    events: dict[str, list[Any]] = field(default_factory=lambda: defaultdict(list))
    """By topic: what `events.read_event` makes of messages, and those of /progress as they are."""
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)
    """All messages as they stand in the file, in its order: number of the channel, log time, bytes."""


def ended(path: str | os.PathLike[str]) -> bool:
    """Whether a file has the end mark of a finished recording."""
    with open(path, "rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - len(MAGIC)))
        return file.tell() > len(MAGIC) and file.read() == MAGIC


class Tail(AbstractContextManager["Tail"]):
    """Follows one file; `read` gives what has come. Raises `NotARecording`, and in `read` any other `RecordingError`."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._fd = regular(self.path, NotARecording)
        self.contents = Contents(str(self.path), 0)
        """Channels, schemas, attachments and metadata so far; `end`: how far it was read; `finished`: its end mark was."""
        self._more = False
        """The last reading found something, so there may be more."""
        self._layouts: dict[int, MessageType] = {}
        """Of each channel with samples."""

    def grown(self) -> bool:
        """Whether there is more in the file than was read."""
        return not self.contents.finished and (self._more or os.fstat(self._fd).st_size > self.contents.size)

    def read(self) -> list[Piece]:
        """What stands next in the file, whole chunks only; none while nothing has come."""
        pieces: list[Piece] = []
        while not pieces and not self.contents.finished:
            end_before = self.contents.end
            for item in records(self._block(), self.contents, unpack=True, growing=True):
                if isinstance(item, Hole):
                    raise item.error
                if isinstance(item, Messages):
                    pieces.append(self._piece(item))
            self.contents.chunks.clear()
            if self.contents.end == end_before:
                break
        self._more = bool(pieces)
        return pieces

    def _block(self) -> memoryview:
        """What follows what was read, at least one record where it is all there."""
        at, size = self.contents.end, os.fstat(self._fd).st_size
        self.contents.size = size
        self.contents.budget.grow(size)
        data = os.pread(self._fd, BLOCK, at)
        if at and len(data) >= HEAD.size and (need := HEAD.unpack_from(data)[1] + HEAD.size) > len(data):
            if need > (most := largest_chunk(2**62) + BLOCK):
                place = f"{self.path}: the record at byte {at}"
                raise Oversized(f"{place} claims {need} bytes, limit {most}; {OPTION} lifts the limit")
            data = os.pread(self._fd, need + len(MAGIC), at) if at + need <= size else b""
        return memoryview(data)

    def _piece(self, batch: Messages) -> Piece:
        """Decode samples and followed events of `batch`; raises `Damaged`, `OtherVersion` or `Oversized`."""
        heads, piece = batch.heads, Piece(batch.chunk.last_time)
        piece.messages = list(zip(heads["channel"].tolist(), heads["log"].tolist(), batch.payloads(), strict=True))
        for number, messages in batch.by_channel():
            channel = self.contents.channels.get(number)
            if channel is None:
                raise Damaged(f"{self.path}: a message of channel {number}, which is not described; run `lab verify`")
            topic = channel.topic
            read = topic in FOLLOWED or is_stream(topic)
            if not (read and ours(channel, self.contents.schemas.get(channel.schema_id))):
                continue
            check_version(channel, str(self.path))
            if topic in FOLLOWED:
                piece.events[topic] += self._events(topic, messages)
            elif topic in piece.samples:
                raise Damaged(f"{self.path}: several channels carry {topic}, as in files that were merged")
            else:
                piece.samples[topic] = self._samples(channel, messages)
                piece.numbers[topic] = messages.heads["sequence"].tolist()
        return piece

    def _samples(self, channel: Channel, messages: Messages) -> NDArray[np.void]:
        schema = self.contents.schemas.get(channel.schema_id)
        if channel.id not in self._layouts:
            self._layouts[channel.id] = message_of(channel, schema, str(self.path))
        return samples_of(self._layouts[channel.id], schema, messages, str(self.path))

    def _events(self, topic: str, messages: Messages) -> list[Any]:
        self.contents.budget.take(Cost.EVENTS, int(messages.sizes.sum()))
        kind, times = events.EVENTS[topic].message_class, messages.heads["log"].tolist()
        parsed = [(t, parse(kind, payload, topic)) for t, payload in zip(times, messages.payloads(), strict=True)]
        return [m if topic == events.PROGRESS.topic else events.read_event(topic, t, m) for t, m in parsed]

    def close(self) -> None:
        """No more reading; may be called twice."""
        fd, self._fd = self._fd, -1
        if fd >= 0:
            os.close(fd)

    def __exit__(self, *_: object) -> None:
        self.close()
