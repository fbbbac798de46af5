"""Reading a recording: streams as numpy arrays, events, attachments, metadata; and `Streams` for concluding states
again."""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray

from . import events, protobuf_runtime
from .container import Contents, walk
from .errors import MissingStream, NotARecording, OtherVersion, Truncated
from .gather import Picked, find_channels, pick
from .messages import SCHEMA_VERSION, STREAMS, MessageType
from .states import State
from .trials import TrialRow


@dataclass(frozen=True)
class StateEvent:
    """What was asked for at rig time `t` (s); `number` counts the states of a recording."""

    t: float
    number: int
    state: State


@dataclass(frozen=True)
class TrialEvent:
    """The row that was concluded live for state `number`, recorded at rig time `t` (s)."""

    t: float
    number: int
    row: TrialRow


@dataclass(frozen=True)
class LogLine:
    """One line of /log, `log_time` ns since the epoch."""

    log_time: int
    level: str
    text: str


@dataclass(frozen=True)
class _Messages:
    """A channel's messages in the file's order: as rows of bytes where all have one size, else one by one."""

    log_times: NDArray[np.int64]
    rows: NDArray[np.uint8] | None
    payloads: list[bytes]

    def each(self) -> list[bytes]:
        """The messages one by one."""
        return self.payloads if self.rows is None else [row.tobytes() for row in self.rows]


_NOTHING = _Messages(np.zeros(0, np.int64), None, [])


def _joined(parts: list[_Messages]) -> _Messages:
    log_times = np.concatenate([part.log_times for part in parts])
    rows = [part.rows for part in parts if part.rows is not None]
    if len(rows) == len(parts) and len({row.shape[1] for row in rows}) == 1:
        return _Messages(log_times, np.concatenate(rows), [])
    return _Messages(log_times, None, [payload for part in parts for payload in part.each()])


class Recording:
    """One recording, read. Streams are decoded at the first use of any of them and then kept."""

    def __init__(self, path: Path, data: memoryview, contents: Contents) -> None:
        self.path = path
        self.contents = contents
        self._data = data
        self._read: dict[int, _Messages] | None = None
        self._streams: dict[str, NDArray[np.void]] = {}

    @classmethod
    def open(cls, path: str | os.PathLike[str], *, truncated: bool = False) -> Recording:
        """Open a file; `truncated=True` also takes one that was never finished, as far as it goes.

        Raises `NotARecording`, or `Truncated` telling how much is readable.
        """
        path = Path(path)
        try:
            with open(path, "rb") as file:
                size = os.fstat(file.fileno()).st_size
                data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b"")
        except OSError as error:
            raise NotARecording(f"{path} cannot be read: {error.strerror}") from error
        contents = walk(data, str(path))
        if not contents.finished and not truncated:
            raise Truncated(
                f"{path} was not finished (the recording ended abruptly or the copy is not whole): {contents.end} of "
                f"{contents.size} bytes, {len(contents.chunks)} chunks, {_seconds(contents):.1f} s are readable; "
                "run `lab recover` to get them"
            )
        find_channels(data, contents, str(path))
        return cls(path, data, contents)

    # -- what is in it
    @property
    def topics(self) -> tuple[str, ...]:
        """All topics, in the order of their channels."""
        return tuple(channel.topic for _, channel in sorted(self.contents.channels.items()))

    @property
    def attachments(self) -> Mapping[str, bytes]:
        """Name -> bytes."""
        return self.contents.attachments

    @property
    def metadata(self) -> Mapping[str, dict[str, str]]:
        """Metadata records by name."""
        return self.contents.metadata

    @property
    def outcome(self) -> str | None:
        """completed, stopped or failed; None when the recording ended abruptly."""
        return self.metadata.get("outcome", {}).get("outcome")

    @property
    def start_wall_ns(self) -> int:
        """Wall time (ns since the epoch) of rig time 0."""
        try:
            return int(self.metadata["recording"]["start_wall_ns"])
        except KeyError:
            raise NotARecording(
                f"{self.path} was not written by this software: it has no metadata 'recording'"
            ) from None

    # -- streams
    def stream(self, topic: str) -> NDArray[np.void]:
        """All samples of a stream, oldest first, as an array with the fields of its message (see `messages`).

        Raises `MissingStream`, `OtherVersion`, or `Damaged`.
        """
        if topic not in self._streams:
            self._streams[topic] = self._decode(topic)
        return self._streams[topic]

    def newest(self, topic: str) -> float:
        """Stamp (s) of the topic's newest sample; -inf when there is none."""
        stamps = self.stream(topic)["t"]
        return float(stamps[-1]) if len(stamps) else -math.inf

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """The topic's samples with t0 <= t <= t1, oldest first."""
        samples = self.stream(topic)
        first, last = np.searchsorted(samples["t"], t0), np.searchsorted(samples["t"], t1, side="right")
        return samples[first:last]

    def log_times(self, topic: str) -> NDArray[np.int64]:
        """Log times (ns since the epoch) of a topic's messages, ascending."""
        return np.sort(self._messages(self._channel(topic)).log_times)

    def _channel(self, topic: str) -> Channel:
        for channel in self.contents.channels.values():
            if channel.topic == topic:
                return channel
        raise MissingStream(f"{self.path} has no stream {topic}; it has {', '.join(self.topics) or 'none'}")

    def _messages(self, channel: Channel) -> _Messages:
        """A channel's messages; the first call reads the whole file."""
        if self._read is None:
            read: dict[int, list[_Messages]] = {}
            for picked in pick(self._data, self.contents, str(self.path)):
                read.setdefault(picked.channel, []).append(self._keep(picked))
            self._read = {channel: _joined(parts) for channel, parts in read.items()}
        return self._read.get(channel.id, _NOTHING)

    def _keep(self, picked: Picked) -> _Messages:
        """What to keep of a batch: the rows of streams, the bytes of everything else."""
        channel = self.contents.channels[picked.channel]
        rows = picked.rows() if channel.topic in STREAMS else None
        return _Messages(picked.log_times, rows, [] if rows is not None else picked.messages())

    def _decode(self, topic: str) -> NDArray[np.void]:
        channel = self._channel(topic)
        if topic not in STREAMS:
            raise MissingStream(f"{topic} is no stream of numbers; those are {', '.join(STREAMS)}")
        message = self._message(channel)
        messages = self._messages(channel)
        if not len(messages.log_times):
            return np.zeros(0, message.dtype)
        if messages.rows is not None and message.fits(messages.rows):
            samples = message.decode(messages.rows.reshape(-1))
        else:
            schema = self.contents.schemas[channel.schema_id]
            samples = protobuf_runtime.decode(message, schema, messages.each())
        if (np.diff(samples["t"]) < 0).any():
            samples = samples[np.argsort(samples["t"], kind="stable")]
        samples.setflags(write=False)
        return samples

    def _message(self, channel: Channel) -> MessageType:
        """The stream's message with the array sizes of this recording."""
        self._check_version(channel)
        shapes = {
            key.removeprefix("shape."): tuple(int(n) for n in text.split("x"))
            for key, text in channel.metadata.items()
            if key.startswith("shape.")
        }
        return STREAMS[channel.topic].sized(**shapes)

    def _check_version(self, channel: Channel) -> None:
        version = channel.metadata.get("schema_version", SCHEMA_VERSION)
        if version != SCHEMA_VERSION:
            raise OtherVersion(
                f"{self.path}: {channel.topic} has schema version {version}, this software reads {SCHEMA_VERSION}; "
                "use the version of the software named in the file's metadata"
            )

    # -- events
    def _events(self, event: events.EventType) -> list[tuple[int, Any]]:
        """(log time, message) of an event's topic in order; none when the file has no such topic."""
        if event.topic not in self.topics:
            return []
        channel = self._channel(event.topic)
        self._check_version(channel)
        messages = self._messages(channel)
        return [
            (int(log_time), protobuf_runtime.parse(event.message_class, payload, event.topic))
            for log_time, payload in zip(messages.log_times, messages.each(), strict=True)
        ]

    @property
    def states(self) -> list[StateEvent]:
        """What was asked for, in order."""
        return [StateEvent(m.t, m.number, State.from_json(m.json)) for _, m in self._events(events.STATE)]

    @property
    def trials(self) -> list[TrialEvent]:
        """What was concluded live, in order."""
        return [TrialEvent(m.t, m.number, TrialRow.from_json(m.json)) for _, m in self._events(events.TRIAL)]

    @property
    def log(self) -> list[LogLine]:
        """The lines of /log, in order."""
        return [
            LogLine(log_time, events.Log.Level.Name(m.level).lower(), m.message)
            for log_time, m in self._events(events.LOG)
        ]


def _seconds(contents: Contents) -> float:
    """Rig seconds that the chunks span."""
    if not contents.chunks:
        return 0.0
    first = min(chunk.first_time for chunk in contents.chunks)
    return (max(chunk.last_time for chunk in contents.chunks) - first) / 1e9
