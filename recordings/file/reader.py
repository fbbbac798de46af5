"""Reading a recording: streams as numpy arrays, events, attachments, metadata; and `Streams` for concluding states
again."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray

from .. import events
from ..errors import Damaged, Foreign, MissingStream, NotARecording, OtherVersion, RecordingError, Truncated
from ..events import EVENTS, EventType
from ..messages import SCHEMA_VERSION, STREAMS, MessageType, is_stream
from .budget import Cost, ReadingBudget
from .chunks import Messages
from .contents import Contents, mapped
from .records import Hole, gathered, holes, index, inside, records
from .samples import check_version, decode, message_of, ours, parse, samples_of, version_of, written_name

T = TypeVar("T")
COUNTERS = ("device_time", "frame")
"""Fields that count up at the instrument until it restarts."""
_TIMES = np.dtype([("sequence", "<i8"), ("log", "<u8")])
"""Number and log time (ns) of a message."""


@dataclass
class Stretch:
    """What stands next in a recording, by log time."""

    times: dict[int, NDArray[np.void]] = field(default_factory=dict)
    """By channel, number and log time (ns) of each message, in the order of both."""
    samples: dict[str, NDArray[np.void]] = field(default_factory=dict)
    """By topic, of the streams that this software writes, in the same order."""
    events: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    """By topic, log time (ns) and bytes."""


class _EventList(Generic[T]):
    """What the messages of an event's topic say; none when the file has no such topic."""

    def __init__(self, event: EventType) -> None:
        self._event = event

    def __get__(self, recording: Recording | None, owner: type) -> list[T]:
        return recording.read_events(self._event, recording.payloads(self._event)) if recording else []  # of the class: none


class Recording:
    """One recording, read. Streams are decoded when they are used and then kept: the first one alone, all the others at
    the use of the second; `load` takes them in one go."""

    def __init__(self, path: Path, data: memoryview, contents: Contents) -> None:
        self.path, self.contents, self._data = path, contents, data
        self.attachments: Mapping[str, bytes] = contents.attachments
        self.metadata: Mapping[str, dict[str, str]] = contents.metadata
        self.damage: tuple[str, ...] | None = None
        """What `salvaged` left out, and why; None of a recording of which everything is read."""
        self._loaded: set[int] = set()
        """Channels whose messages were read."""
        self._budget = ReadingBudget(str(path), len(data))
        self._samples: dict[int, list[NDArray[np.void]] | None] = {}
        """Of channels of ours, batch by batch; None where some message has another layout."""
        self._payloads: dict[int, list[bytes]] = {}
        self._times: dict[int, list[NDArray[np.void]]] = {}
        self._streams: dict[str, NDArray[np.void]] = {}

    @classmethod
    def salvaged(cls, path: str | os.PathLike[str]) -> Recording:
        """What makes sense of a damaged file; raises `NotARecording` or `Oversized`."""
        data = mapped(path)
        contents = Contents(str(path), len(data))
        gaps = holes(data, contents, unpack=True)
        recording = cls(Path(path), data, contents)
        recording.damage = tuple(str(hole.error) for hole in gaps if hole.start < contents.end)
        return recording

    def __repr__(self) -> str:
        first, last = self.contents.span or (0, 0)
        topics = ", ".join(sorted({c.topic for c in self.contents.channels.values()}))
        return f"<Recording: {self.path.name}, {(last - first) / 1e9:.1f} s, {topics}>"

    @classmethod
    def open(cls, path: str | os.PathLike[str], *, truncated: bool = False) -> Recording:
        """Open a file; `truncated=True` also takes one that was never finished, as far as it goes.

        Raises `NotARecording`, or `Truncated` telling how much is readable.

        >>> recording = Recording.open("run.mcap")
        >>> recording.stream("/tip")["position"].shape
        (112, 3)
        """
        path = Path(path)
        data = mapped(path)
        contents = index(data, str(path))
        if not contents.finished and not truncated:
            first, last = contents.span or (0, 0)
            raise Truncated(
                f"{path} was not finished (the recording ended abruptly or the copy is incomplete): {contents.end} of "
                f"{contents.size} bytes, {len(contents.chunks)} chunks, {(last - first) / 1e9:.1f} s are readable; "
                "run `lab recover` to get them"
            )
        for chunk in contents.chunks:  # schemas and channels that the summary does not repeat stand in chunks alone
            if not chunk.bare and not (chunk.channels and all(map(contents.described, chunk.channels))):
                for item in inside(data, chunk, contents):
                    if isinstance(item, Hole):
                        raise item.error
        return cls(path, data, contents)

    # -- what is in it
    @property
    def topics(self) -> tuple[str, ...]:
        """All topics, in the order of their channels; one that several channels carry is named once."""
        return tuple(self._carriers)

    @cached_property
    def _carriers(self) -> dict[str, list[Channel]]:
        """The channels of each topic, in the order of their numbers."""
        carriers: dict[str, list[Channel]] = {}
        for _, channel in sorted(self.contents.channels.items()):
            carriers.setdefault(channel.topic, []).append(channel)
        return carriers

    @property
    def outcome(self) -> str | None:
        """completed, stopped or failed; None when the recording ended abruptly."""
        return self.metadata.get("outcome", {}).get("outcome")

    @cached_property
    def skipped(self) -> frozenset[int]:
        """Trials that a person skipped."""
        return frozenset(request.trial for request in self.requests if request.kind == "skip" and request.done)

    @property
    def start_wall_ns(self) -> int:
        """Wall time (ns since the epoch) of rig time 0."""
        text = self.metadata.get("recording", {}).get("start_wall_ns", "")
        if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) < 2**63):
            raise Foreign(
                f"{self.path} was not written by this software: its metadata 'recording' has no start_wall_ns; it has "
                f"{self._described()}"
            )
        return int(text)

    def need(self, *topics: str) -> None:
        """Raises `Foreign` when the file does not have these topics as this software writes them."""
        if not all(map(self.knows, topics)):
            needed = ", ".join(f"{topic} ({written_name(topic)}, protobuf)" for topic in topics)
            raise Foreign(
                f"{self.path} was not recorded by this software: it needs {needed}, but has {self._described()}; "
                "write its states into a case folder (robot.yaml and trials.csv) instead"
            )

    def knows(self, topic: str) -> bool:
        """Whether the topic is there with the message that this software writes on it."""
        return any(map(self._ours, self._carriers.get(topic, [])))

    @cached_property
    def streams(self) -> tuple[str, ...]:
        """The topics with samples as this software writes them, in the order of their channels."""
        return tuple(topic for topic in self.topics if is_stream(topic) and self.knows(topic))

    def _ours(self, channel: Channel) -> bool:
        return ours(channel, self.contents.schemas.get(channel.schema_id))

    def _described(self) -> str:
        """The topics with their messages, for people."""
        names = []
        for _, channel in sorted(self.contents.channels.items())[:12]:
            schema = self.contents.schemas.get(channel.schema_id)
            kind = channel.message_encoding if schema is None else f"{schema.name}, {channel.message_encoding}"
            names.append(f"{channel.topic} ({kind})")
        more = len(self.contents.channels) - len(names)
        return (", ".join(names) or "no topics") + (f" and {more} more" if more > 0 else "")

    # -- streams
    def stream(self, topic: str) -> NDArray[np.void]:
        """All samples of a stream, oldest first, as an array with the fields of its message (see `messages`).

        Raises `MissingStream`, `OtherVersion`, or `Damaged`.
        """
        if topic not in self._streams:
            self._streams[topic] = self._decode(topic)
        return self._streams[topic]

    def units(self, topic: str) -> dict[str, str]:
        """Unit of each field of a stream, as the file's schema states. Raises `Damaged`."""
        return {field.name: field.unit for field in self._message(self._channel(topic)).fields}

    def newest(self, topic: str) -> float:
        """Stamp (s) of the topic's newest sample; -inf when there is none."""
        stamps = self.stream(topic)["t"]
        return float(stamps[-1]) if len(stamps) else -math.inf

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """The topic's samples with t0 <= t <= t1, oldest first."""
        samples = self.stream(topic)
        first, last = np.searchsorted(samples["t"], t0), np.searchsorted(samples["t"], t1, side="right")
        return samples[first:last]

    def log_times(self, topic: str) -> NDArray[np.uint64]:
        """Log times (ns since the epoch) of a topic's messages on all its channels, ascending."""
        for channel in self._carriers.get(topic, []):
            self._need(channel)
        return np.sort(self._times_of(*(channel.id for channel in self._carriers.get(topic, [])))["log"])

    def _times_of(self, *numbers: int) -> NDArray[np.void]:
        """Number and log time of each message of channels, in the order of the file."""
        return np.concatenate([np.zeros(0, _TIMES), *(part for n in numbers for part in self._times.get(n, []))])

    def messages(self, topics: Container[str]) -> Iterator[tuple[Channel, NDArray[np.uint64], list[bytes]]]:
        """Messages of topics as they stand in the file, batch by batch: their channel, log times (ns), and bytes."""
        for batch, _ in self._batches():
            for number, messages in batch.by_channel():
                channel = self.contents.channels.get(number)
                if channel is not None and channel.topic in topics:
                    yield channel, messages.heads["log"].astype(np.uint64), messages.payloads()

    def _batches(self) -> Iterator[tuple[Messages, int | None]]:
        """All messages, and the log time (ns) before which none of any later batch is, as far as chunks state theirs, None for
        the end; not those of a chunk that is cut off."""
        if self.damage is None:
            return gathered(self._data, self.contents)
        size = len(self._data)
        walk = records(self._data, Contents(str(self.path), size), unpack=True)
        return ((item, None) for item in walk if isinstance(item, Messages) and item.chunk.end <= size)

    def load(self) -> None:
        """Read everything at once, for a use that needs most of it."""
        self._load(set(self.contents.channels) - self._loaded)

    def sweep(self, faults: dict[str, RecordingError]) -> Iterator[Stretch]:
        """The recording from begin to end, of which one stretch is held at a time. Events are kept.

        `faults`: why a stream has no more samples, by topic; they are added to it. Raises `Damaged`, `Oversized`.
        """
        layouts, kinds, held = dict[int, MessageType](), dict[str, np.dtype[np.void]](), dict[int, tuple[Any, ...]]()
        times, payloads = dict[int, list[NDArray[np.void]]](), dict[int, list[bytes]]()
        for topic in self.streams:
            try:
                channel = self.demand_version(topic)
                layouts[channel.id] = self._message(channel)
            except RecordingError as error:
                faults[topic] = error
        event_channels = {n for n, c in self.contents.channels.items() if c.topic in events.READ and self._ours(c)}

        def content(number: int, messages: Messages) -> NDArray[Any]:
            """Samples of a stream, bytes of an event, of all else nothing."""
            nothing = np.zeros(len(messages), "V0")
            if number in event_channels:
                texts = np.empty(len(messages), object)
                texts[:] = messages.payloads()
                return texts
            if number not in layouts or (topic := self.contents.channels[number].topic) in faults:
                return nothing
            try:
                schema = self.contents.schemas.get(self.contents.channels[number].schema_id)
                samples = samples_of(layouts[number], schema, messages, str(self.path))
                if kinds.setdefault(topic, samples.dtype) != samples.dtype:
                    raise OtherVersion(f"{topic}: an array changes its size within the file")
                return samples
            except RecordingError as error:
                faults[topic] = error
                return nothing

        for batch, horizon in self._batches():
            stretch, parts = Stretch(), dict(batch.by_channel())
            for number in sorted(parts.keys() | held.keys()):
                pieces = [held.pop(number)] if number in held else []
                if number in parts:
                    pieces.append((parts[number].heads[["sequence", "log"]].astype(_TIMES), content(number, parts[number])))
                topic = self.contents.channels[number].topic if number in self.contents.channels else ""
                at, what = (pieces[0] if len(pieces) == 1 else (
                    np.concatenate([a for a, _ in pieces]),
                    np.zeros(0, "V0") if topic in faults else np.concatenate([w for _, w in pieces]),
                ))  # fmt: skip
                order = np.lexsort((at["sequence"], at["log"]))
                ready = len(at) if horizon is None else int(np.searchsorted(at["log"][order], np.uint64(horizon)))
                order, later = order[:ready], order[ready:]
                faulty = len(what) < len(at)
                if len(later):
                    held[number] = (at[later], what[:0] if faulty else what[later])
                stretch.times[number] = at[order]
                if number in event_channels:
                    self._budget.take(Cost.EVENTS, sum(map(len, what[order])))
                    times.setdefault(number, []).append(at[order])
                    payloads.setdefault(number, []).extend(what[order])
                    stretch.events[topic] = list(zip(at["log"][order].tolist(), what[order], strict=True))
                elif number in layouts and topic not in faults and not faulty:
                    stretch.samples[topic] = what[order]
            yield stretch
        self._loaded, self._times, self._payloads = event_channels, times, payloads

    def _need(self, channel: Channel) -> None:
        """Have the messages of a channel read: of it alone when it is the first."""
        if channel.id not in self._loaded:
            self._load({channel.id} if not self._loaded else set(self.contents.channels) - self._loaded)

    def _channel(self, topic: str) -> Channel:
        carriers = self._carriers.get(topic, [])
        ours = [channel for channel in carriers if self._ours(channel)]
        if len(ours) > 1:
            raise NotARecording(f"{self.path}: {len(ours)} channels carry {topic}, as in files that were merged; split them")
        if carriers:
            return (ours or carriers)[0]
        raise MissingStream(f"{self.path} has no stream {topic}; it has {', '.join(self.topics) or 'none'}")

    def _load(self, wanted: set[int]) -> None:
        """Read the file once: wanted streams to arrays, the messages of other wanted channels as bytes."""
        if not wanted:
            return
        channels, layouts = self.contents.channels, dict[int, MessageType]()
        for number in wanted:
            channel = channels[number]
            if is_stream(channel.topic) and self._ours(channel) and version_of(channel) == SCHEMA_VERSION:
                layouts[number], self._samples[number] = self._message(channel), []
        event_channels = {n for n in wanted if channels[n].topic in EVENTS and self._ours(channels[n])}
        for batch, _ in self._batches():
            for number, messages in batch.by_channel():
                if number in wanted:
                    self._times.setdefault(number, []).append(messages.heads[["sequence", "log"]].astype(_TIMES))
                if number in layouts:
                    parts, rows = self._samples[number], messages.rows()
                    if parts is None or rows is None or not layouts[number].fits(rows):
                        self._samples[number] = None
                    else:
                        parts.append(layouts[number].decode(rows.reshape(-1)))
                elif number in event_channels:
                    if channels[number].topic in events.READ:
                        self._budget.take(Cost.EVENTS, int(messages.sizes.sum()))
                    self._payloads.setdefault(number, []).extend(messages.payloads())
        self._loaded |= wanted

    def _decode(self, topic: str) -> NDArray[np.void]:
        """All samples of a stream, ascending in time; raises as `stream` does."""
        channel = self._channel(topic)
        if not is_stream(topic):
            raise MissingStream(f"{topic} is not a stream of numbers; these are {', '.join(STREAMS)}")
        self.need(topic)
        check_version(channel, str(self.path))
        self._need(channel)
        message, parts = self._message(channel), self._samples.pop(channel.id, None)
        if parts is not None:
            samples = np.zeros(sum(map(len, parts)), message.dtype)  # no stray bytes between the fields
            if parts:
                np.concatenate(parts, out=samples)
        else:
            schema = self.contents.schemas.get(channel.schema_id)
            if schema is None:
                raise Damaged(f"{self.path}: {channel.topic} names the schema {channel.schema_id}, which is missing")
            payloads = (held for carrier, _, held in self.messages({topic}) if carrier.id == channel.id)
            count = sum(map(len, self._times.get(channel.id, [])))
            samples = decode(message, schema, chain.from_iterable(payloads), count)
        if not (np.diff(samples["t"]) > 0).all():
            samples = samples[self._order(channel, [samples["t"]], lambda i: bytes(samples[i].tobytes()))]
        samples.setflags(write=False)
        return samples

    def _order(self, channel: Channel, t: Sequence[NDArray[np.float64]], content: Callable[[int], bytes]) -> list[int]:
        """The order of a channel's messages: by stamp (when given), log time, number, and at last by what they hold."""
        times = self._times_of(channel.id)
        keys = [times["sequence"], times["log"], *t]
        order = np.lexsort(keys)
        same = np.all([np.diff(key[order]) == 0 for key in keys], axis=0)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], same, [False])).astype(np.int8)))
        for first, last in edges.reshape(-1, 2).tolist():  # of each run of equal neighbours
            order[first : last + 1] = sorted(order[first : last + 1].tolist(), key=content)
        return list(map(int, order.tolist()))

    def _message(self, channel: Channel) -> MessageType:
        """The stream's message with the array sizes of this recording."""
        return message_of(channel, self.contents.schemas.get(channel.schema_id), str(self.path))

    # -- events
    def demand_version(self, topic: str) -> Channel:
        """The channel of a topic; raises `OtherVersion`, or `NotARecording` where several carry it."""
        channel = self._channel(topic)
        check_version(channel, str(self.path))
        return channel

    def read_events(self, event: EventType, payloads: Iterable[tuple[int, bytes]]) -> list[Any]:
        """What messages of an event's topic say. Raises `Damaged`, `BadMessage`, `Oversized`."""
        kind, topic = event.message_class, event.topic
        return [events.read_event(topic, log_time, parse(kind, message, topic)) for log_time, message in payloads]

    def payloads(self, event: EventType) -> list[tuple[int, bytes]]:
        """(log time ns, bytes of the message) of an event's topic by log time; none when the file has no such topic."""
        if not self.knows(event.topic):
            return []
        channel = self.demand_version(event.topic)
        self._need(channel)
        log_times, payloads = self._times_of(channel.id)["log"].tolist(), self._payloads.get(channel.id, [])
        return [(log_times[i], payloads[i]) for i in self._order(channel, [], payloads.__getitem__)]

    states = _EventList[events.StateEvent](events.STATE)
    """What was asked for, in order."""
    trials = _EventList[events.TrialEvent](events.TRIAL)
    """What was concluded live, in order."""
    requests = _EventList[events.Request](events.REQUEST)
    """What people asked of the run, and what of it was carried out, in order."""
    zeros = _EventList[events.ZeroEvent](events.ZERO)
    """How the force sensor's zero moved during trials, in order."""
    marks = _EventList[events.Mark](events.MARK)
    """Which states are in doubt, in order."""
    log = _EventList[events.LogLine](events.LOG)
    """The lines of /log, in order."""
