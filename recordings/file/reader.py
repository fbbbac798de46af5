"""Reading a recording: streams as numpy arrays, events, attachments, metadata; and `Streams` for concluding states
again."""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray

from .. import events
from ..errors import BadMessage, Damaged, Foreign, MissingStream, NotARecording, Oversized, Truncated
from ..events import EVENTS, EventType, Mark, Request
from ..messages import SCHEMA_VERSION, STREAMS, MessageType, is_stream
from ..states.bodies import Bodies
from ..states.rules import LARGEST, State, checked
from ..states.vacuum import VacuumBand
from ..states.zeros import Drift, Zeros
from ..trials import DOUBTS, TrialRow
from . import protobuf_runtime
from .budget import Budget, Cost
from .contents import Contents, Hole
from .gather import pick
from .records import demand_mcap, index, inside, records
from .samples import Samples, check_version, message_of, ordered, ours, version_of, written_name

SAID = tuple(e.topic for e in (events.STATE, events.TRIAL, events.LOG, events.REQUEST, events.ZERO, events.MARK))
"""Topics whose messages are texts that are taken apart."""
COUNTERS = ("device_time", "frame")
"""Fields that count up at the instrument until it restarts."""
SHOWN = 12
"""Topics of a foreign file that an error lists."""
_LEVELS = {number: name.lower() for name, number in events.Log.Level.items()}


def _name(topic: str) -> str:
    return f"{topic} ({written_name(topic)}, protobuf)"


@dataclass(frozen=True)
class StateEvent:
    """What was asked for at rig time `t` (s); `number` counts the states of a recording."""

    t: float
    number: int
    state: State
    repeats: int = 0
    """Number of the state that is read again; 0: of none."""


@dataclass(frozen=True)
class TrialEvent:
    """The row that was concluded live for state `number`, recorded at rig time `t` (s)."""

    t: float
    number: int
    row: TrialRow
    repeats: int = 0
    """Number of the state that was read again; 0: of none."""


@dataclass(frozen=True)
class ZeroEvent:
    """How the force sensor's zero moved during a trial, as it was concluded live."""

    t: float
    zeros: Zeros
    drift: Drift


@dataclass(frozen=True)
class LogLine:
    """One line of /log, `log_time` ns since the epoch."""

    log_time: int
    level: str
    text: str


def mapped(path: Path) -> memoryview:
    """A file's bytes; raises `NotARecording` when it cannot be read."""
    try:
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b"")
    except OSError as error:
        raise NotARecording(f"{path} cannot be read: {error.strerror}") from error


class Recording:
    """One recording, read. Streams are decoded when they are used and then kept: the first one alone, all the others at
    the use of the second; `load` takes them in one go."""

    def __init__(self, path: Path, data: memoryview, contents: Contents) -> None:
        self.path = path
        self.contents = contents
        self._data = data
        self._loaded: set[int] = set()
        """Channels whose messages were read."""
        self._budget = Budget(str(path), len(data))
        self._samples: dict[int, Samples] = {}
        self._payloads: dict[int, list[bytes]] = {}
        self._log_times: dict[int, list[NDArray[np.int64]]] = {}
        self._sequences: dict[int, list[NDArray[np.int64]]] = {}
        self._streams: dict[str, NDArray[np.void]] = {}
        self.damage: tuple[str, ...] = ()
        """What `salvaged` left out, and why."""

    @classmethod
    def salvaged(cls, path: str | os.PathLike[str]) -> Recording:
        """What makes sense of a damaged file; raises `NotARecording` or `Oversized`."""
        data, name = mapped(Path(path)), str(path)
        demand_mcap(data, name)
        contents = Contents(name, len(data))
        holes = [item for item in records(data, contents, unpack=True) if isinstance(item, Hole)]
        for hole in holes:
            if isinstance(hole.error, Oversized):
                raise hole.error
        contents.broken = {hole.start for hole in holes}
        recording = cls(Path(path), data, contents)
        recording.damage = tuple(str(hole.error) for hole in holes if hole.start < contents.end)
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
            if not chunk.bare and not (chunk.indexes and all(contents.described(n) for n, _, _ in chunk.indexes)):
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
        found: dict[str, list[Channel]] = {}
        for _, channel in sorted(self.contents.channels.items()):
            found.setdefault(channel.topic, []).append(channel)
        return found

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
            raise Foreign(
                f"{self.path} was not recorded by this software: it needs {', '.join(map(_name, topics))}, but has "
                f"{self._described()}; write its states into a case folder (robot.yaml and trials.csv) instead"
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
        told = []
        for _, channel in sorted(self.contents.channels.items())[:SHOWN]:
            schema = self.contents.schemas.get(channel.schema_id)
            kind = channel.message_encoding if schema is None else f"{schema.name}, {channel.message_encoding}"
            told.append(f"{channel.topic} ({kind})")
        more = len(self.contents.channels) - len(told)
        return (", ".join(told) or "no topics") + (f" and {more} more" if more > 0 else "")

    # -- streams
    def stream(self, topic: str) -> NDArray[np.void]:
        """All samples of a stream, oldest first, as an array with the fields of its message (see `messages`).

        Raises `MissingStream`, `OtherVersion`, or `Damaged`.
        """
        if topic not in self._streams:
            self._streams[topic] = self._decode(topic)
        return self._streams[topic]

    def units(self, topic: str) -> dict[str, str]:
        """Unit of each field of a stream, as the file's schema tells. Raises `Damaged`."""
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

    def log_times(self, topic: str, samples: bool = False) -> NDArray[np.int64]:
        """Log times (ns since the epoch) of a topic's messages on all its channels, ascending; `samples`: of those that
        `stream` gives."""
        numbers = {self._channel(topic).id} if samples else {channel.id for channel in self._carriers.get(topic, [])}
        if not self._loaded and numbers:
            self._load(numbers)
        found = (part for number in numbers for part in self._log_times.get(number, []))
        return np.sort(np.concatenate([np.zeros(0, np.int64), *found]))

    def restarts(self, topic: str) -> int:
        """How often a stream began anew: its messages' numbers, or the instrument's own stamps or frame numbers, went back."""
        samples, channel = self.stream(topic), self._channel(topic)
        numbers = np.concatenate([np.zeros(0, np.int64), *self._sequences.get(channel.id, [])])
        in_time = numbers[self._order(channel, [], lambda i: b"")]
        counters = [in_time, *(samples[name] for name in COUNTERS if name in (samples.dtype.names or ()))]
        return max(int((np.diff(counter.astype(np.float64)) < 0).sum()) for counter in counters)

    def messages(self, topics: Container[str]) -> Iterator[tuple[Channel, NDArray[np.int64], list[bytes]]]:
        """Messages of topics as they stand in the file, batch by batch: their channel, log times (ns), and bytes."""
        for picked in pick(self._data, self.contents):
            channel = self.contents.channels.get(picked.channel)
            if channel is not None and channel.topic in topics:
                yield channel, picked.log_times, picked.messages()

    def load(self) -> None:
        """Read everything at once, for a use that needs most of it."""
        self._load(set(self.contents.channels) - self._loaded)

    def undescribed(self) -> list[str]:
        """What the loaded messages and the channels refer to and the file does not describe."""
        channels, schemas = self.contents.channels, self.contents.schemas
        found = [
            f"{sum(map(len, parts))} messages are of channel {number}, which is not described"
            for number, parts in sorted(self._log_times.items())
            if number not in channels
        ]
        return found + [
            f"channel {c.topic} names the schema {c.schema_id}, which is missing"
            for c in channels.values()
            if c.schema_id and c.schema_id not in schemas
        ]

    def _need(self, channel: Channel) -> None:
        """Have the messages of a channel read: of it alone when it is the first."""
        if channel.id not in self._loaded:
            self._load({channel.id} if not self._loaded else set(self.contents.channels) - self._loaded)

    def _channel(self, topic: str) -> Channel:
        found = self._carriers.get(topic, [])
        ours = [channel for channel in found if self._ours(channel)]
        if len(ours) > 1:
            raise NotARecording(
                f"{self.path}: {len(ours)} channels carry {topic}, as in files that were merged; split them"
            )
        if found:
            return (ours or found)[0]
        raise MissingStream(f"{self.path} has no stream {topic}; it has {', '.join(self.topics) or 'none'}")

    def _load(self, wanted: set[int]) -> None:
        """Read the file once: wanted streams to arrays, the messages of other wanted channels as bytes."""
        if not wanted:
            return
        for number in wanted:
            channel = self.contents.channels[number]
            if is_stream(channel.topic) and self._ours(channel) and version_of(channel) == SCHEMA_VERSION:
                self._samples[number] = Samples(self._message(channel))
        channels = self.contents.channels
        kept = {n for n in wanted if channels[n].topic in EVENTS and self._ours(channels[n])}
        first = not self._loaded
        for picked in pick(self._data, self.contents):
            if first:
                self._log_times.setdefault(picked.channel, []).append(picked.log_times)
                self._sequences.setdefault(picked.channel, []).append(picked.sequences)
            if picked.channel not in wanted:
                continue
            if picked.channel in self._samples:
                self._samples[picked.channel].add(picked.rows())
            elif picked.channel in kept:
                if self.contents.channels[picked.channel].topic in SAID:
                    self._budget.take(Cost.EVENTS, int((picked.ends - picked.starts).sum()))
                self._payloads.setdefault(picked.channel, []).extend(picked.messages())
        self._loaded |= wanted

    def _decode(self, topic: str) -> NDArray[np.void]:
        channel = self._channel(topic)
        if not is_stream(topic):
            raise MissingStream(f"{topic} is not a stream of numbers; these are {', '.join(STREAMS)}")
        self.need(topic)
        self._check_version(channel)
        self._need(channel)
        samples = self._samples[channel.id].array
        if samples is None:
            schema = self.contents.schemas.get(channel.schema_id)
            if schema is None:
                raise Damaged(f"{self.path}: {channel.topic} names the schema {channel.schema_id}, which is missing")
            batches = pick(self._data, self.contents)
            payloads = (payload for p in batches if p.channel == channel.id for payload in p.messages())
            count = sum(len(part) for part in self._log_times.get(channel.id, []))
            samples = protobuf_runtime.decode(self._message(channel), schema, payloads, count)
        return self._in_order(channel, samples)

    def _in_order(self, channel: Channel, samples: NDArray[np.void]) -> NDArray[np.void]:
        if not (np.diff(samples["t"]) > 0).all():
            samples = samples[self._order(channel, [samples["t"]], lambda i: bytes(samples[i].tobytes()))]
        samples.setflags(write=False)
        return samples

    def _order(self, channel: Channel, t: Sequence[NDArray[np.float64]], content: Callable[[int], bytes]) -> list[int]:
        """The order of a channel's messages: by stamp (when given), log time, number, and what they hold."""
        parts = (self._sequences.get(channel.id, []), self._log_times.get(channel.id, []))
        return ordered([*(np.concatenate([np.zeros(0, np.int64), *part]) for part in parts), *t], content).tolist()

    def _message(self, channel: Channel) -> MessageType:
        """The stream's message with the array sizes of this recording."""
        return message_of(channel, self.contents.schemas.get(channel.schema_id), str(self.path))

    def _check_version(self, channel: Channel) -> None:
        check_version(channel, str(self.path))

    # -- events
    def events(self, event: EventType) -> list[tuple[int, Any]]:
        """(log time ns, protobuf message) of an event's topic by log time; none when the file has no such topic."""
        return [
            (log_time, protobuf_runtime.parse(event.message_class, payload, event.topic))
            for log_time, payload in self.payloads(event)
        ]

    def payloads(self, event: EventType) -> list[tuple[int, bytes]]:
        """(log time ns, bytes of the message) of an event's topic by log time; none when the file has no such topic."""
        if not self.knows(event.topic):
            return []
        channel = self._channel(event.topic)
        self._check_version(channel)
        self._need(channel)
        log_times = [t for part in self._log_times.get(channel.id, []) for t in part.tolist()]
        payloads = self._payloads.get(channel.id, [])
        return [(log_times[i], payloads[i]) for i in self._order(channel, [], payloads.__getitem__)]

    @property
    def states(self) -> list[StateEvent]:
        """What was asked for, in order."""
        return [state_event(m) for _, m in self.events(events.STATE)]

    @property
    def trials(self) -> list[TrialEvent]:
        """What was concluded live, in order."""
        return [trial_event(m) for _, m in self.events(events.TRIAL)]

    @property
    def requests(self) -> list[Request]:
        """What people asked of the run, and what of it was carried out, in order."""
        return [request_event(m) for _, m in self.events(events.REQUEST)]

    @property
    def zeros(self) -> list[ZeroEvent]:
        """How the force sensor's zero moved during trials, in order."""
        return [zero_event(m) for _, m in self.events(events.ZERO)]

    @property
    def marks(self) -> list[Mark]:
        """Which states are in doubt, in order."""
        return [mark_event(m) for _, m in self.events(events.MARK)]

    @property
    def log(self) -> list[LogLine]:
        """The lines of /log, in order."""
        return [log_line(log_time, m) for log_time, m in self.events(events.LOG)]


def state_event(m: Any) -> StateEvent:
    """What a message of /state says; raises `BadMessage`, `Damaged`."""
    vacuum = None
    if m.HasField("vacuum_since"):
        vacuum = checked(VacuumBand(m.vacuum_since, m.vacuum_lowest, m.vacuum_highest))
    bodies = None
    if m.HasField("bodies_since"):
        bodies = checked(Bodies(m.bodies_since, tuple(m.bodies_arcs), m.bodies_stretch))
    least_force = m.least_force if m.HasField("least_force") else None
    state = replace(State.from_json(_text(m)), clipped=m.clipped, vacuum=vacuum, least_force=least_force, bodies=bodies)
    return StateEvent(m.t, m.number, checked(state), m.repeats)


def trial_event(m: Any) -> TrialEvent:
    """What a message of /trial says; raises `BadTable`, `Damaged`."""
    return TrialEvent(m.t, m.number, replace(TrialRow.from_json(_text(m)), clipped=m.clipped), m.repeats)


def request_event(m: Any) -> Request:
    """What a message of /request says; raises `Damaged`."""
    try:
        return Request(m.t, m.kind, m.by, m.text, m.done, m.trial, m.step)
    except UnicodeDecodeError as error:
        raise Damaged(f"a message of /request is not text ({error}); run `lab verify`") from error


def zero_event(m: Any) -> ZeroEvent:
    """What a message of /zero says; raises `BadMessage`."""
    numbers = (*m.direction, *m.before, *m.start, *m.end, m.offset_at, m.drift, m.rate)
    if tuple(map(len, (m.direction, m.before, m.start, m.end))) != (3, 2, 2, 2) or not all(
        abs(x) <= LARGEST for x in numbers
    ):
        raise BadMessage(f"/zero at {m.t:g} s: is not three spans of time, a direction and a drift")
    x, y, z = m.direction
    before, start, end = ((float(a), float(b)) for a, b in (m.before, m.start, m.end))
    return ZeroEvent(m.t, Zeros(m.trial, (x, y, z), before, start, end, m.offset_at), Drift(m.drift, m.rate, m.linear))


def mark_event(m: Any) -> Mark:
    """What a message of /mark says; raises `BadMessage`, `Damaged`."""
    try:
        mark = Mark(m.t, m.trial, m.doubt, m.text)
    except UnicodeDecodeError as error:
        raise Damaged(f"a message of /mark is not text ({error}); run `lab verify`") from error
    if mark.doubt not in DOUBTS:
        raise BadMessage(f"/mark at {mark.t:g} s: doubt {mark.doubt[:40]!r} is unknown; one of {', '.join(DOUBTS)}")
    return mark


def log_line(log_time: int, m: Any) -> LogLine:
    """What a message of /log says."""
    return LogLine(log_time, _LEVELS.get(m.level, f"level {m.level}"), m.message)


def _text(message: Any) -> str:
    """The field `json` of a message; `Damaged` when it is no text."""
    try:
        return str(message.json)
    except UnicodeDecodeError as error:
        raise Damaged(f"a state or row is not text ({error}); run `lab verify`") from error
