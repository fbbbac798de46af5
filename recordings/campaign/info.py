"""What is in a recording, at a glance: streams, counts, rates, gaps, losses, clocks, attachments, provenance, outcome."""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import BadMessage, BadTable, Damaged, Foreign, NotARecording, OtherVersion, RecordingError
from ..events import Request
from ..file.clocks import STAMP, ClockFit, ClockModel, has_stamp
from ..file.counts import Pace, Timing, counted
from ..file.reader import COUNTERS, Recording
from ..json_text import Plain, read_json
from ..states.concluding import of_sensor

T = TypeVar("T")


@dataclass(frozen=True)
class StreamInfo:
    """One topic: timing of the messages in the file, and what the recorder counted (None when it never said)."""

    timing: Timing
    dropped: int | None
    lost: int | None
    restarts: int = 0
    """How often its numbers or its instrument's stamps went back: the stream began anew; what was lost then is not known."""
    channels: int = 1
    """Channels that carry the topic."""


@dataclass(frozen=True)
class Quantity:
    """What a sensor of the lab's own measured: unit, and the range and mean of its samples."""

    unit: str
    least: float
    mean: float
    greatest: float


@dataclass(frozen=True)
class Info(Plain):
    """Summary of a file. `readable` of `size` bytes are whole records; `finished`: its end is there; `outcome` None: it
    does not state how it ended."""

    path: str
    size: int
    readable: int
    finished: bool
    outcome: str | None
    detail: str
    start: str
    """Wall time of the first message, ISO 8601 UTC."""
    duration: float
    """Rig seconds from first to last message."""
    states: int
    rows: int
    planned: int
    """States of the whole plan, of which a run that resumes another one reads the rest; 0 where the plan does not say."""
    streams: dict[str, StreamInfo]
    attachments: dict[str, int]
    """Name -> bytes."""
    clocks: dict[str, ClockModel]
    """Of the instruments that stamp their samples, by topic."""
    metadata: dict[str, dict[str, str]]
    """Records given by whoever recorded: versions, git state, and so on."""
    requests: list[Request]
    """What people asked of the run while it went on, and what of it was carried out; notes among them."""
    sensors: dict[str, dict[str, Quantity]]
    """Of sensors of the lab's own: topic -> name -> what was measured."""
    notes: tuple[str, ...] = ()
    """What could not be worked out, and why."""
    damage: tuple[str, ...] = ()
    """What makes no sense and is not counted, and where."""

    @property
    def complete(self) -> bool:
        """Finished and not damaged, and as far as the file states no message was dropped or lost on the way."""
        return self.finished and not self.damage and all(not (s.dropped or s.lost) for s in self.streams.values())


def info(path: str | os.PathLike[str]) -> Info:
    """Summary of a file, truncated or damaged or not. Raises `NotARecording` or `Oversized`.

    >>> found = info("run.mcap")
    >>> found.outcome, found.complete
    ('completed', True)
    """
    try:
        fold = _Fold(Recording.open(path, truncated=True))
    except Damaged:
        fold = _Fold(Recording.salvaged(path))
    recording, paces = fold.recording, fold.paces
    counts, outcome = counted(recording.metadata), recording.metadata.get("outcome", {})
    metadata = {name: texts for name, texts in recording.metadata.items() if name not in ("clocks", "counts", "outcome")}
    notes: list[str] = []
    damage = [*(recording.damage or ()), *fold.undescribed, *recording.contents.schemaless]
    first = min((pace.first for pace in paces.values() if pace.count), default=None)
    last = max((pace.last for pace in paces.values() if pace.count), default=0)
    try:
        start = recording.start_wall_ns
    except Foreign:
        start = first or 0
    channel_counts = Counter(channel.topic for channel in recording.contents.channels.values())
    streams = {
        topic: StreamInfo(
            pace.timing(start), counts.get(topic, {}).get("dropped"), counts.get(topic, {}).get("lost"),
            _or(0, notes, damage, partial(fold.restarts, topic)) if topic in recording.streams else 0, channel_counts[topic],
        )
        for topic, pace in paces.items()
    }  # fmt: skip
    sensors = [topic for topic in recording.streams if of_sensor(topic)]
    planned = planned_of(recording)[1]
    states_read: set[tuple[int, int]] = _or(set(), notes, damage, lambda: {(e.row.trial, e.row.step) for e in recording.trials})
    notes += beyond_plan(len(states_read), planned)
    return Info(
        path=str(recording.path), size=recording.contents.size, readable=recording.contents.end,
        finished=recording.contents.finished, outcome=outcome.get("outcome"), detail=outcome.get("detail", ""),
        start="" if first is None else datetime.fromtimestamp(first / 1e9, UTC).isoformat(timespec="seconds"),
        duration=0.0 if first is None else (last - first) / 1e9,
        states=paces["/state"].count if recording.knows("/state") else 0,
        rows=len(states_read) or (paces["/trial"].count if recording.knows("/trial") else 0),
        planned=planned, streams=streams, attachments={name: len(data) for name, data in recording.attachments.items()},
        clocks=fold.clocks, metadata=metadata,
        requests=_or([], notes, damage, lambda: recording.requests),
        sensors={topic: _or({}, notes, damage, partial(fold.quantities, topic)) for topic in sensors},
        notes=tuple(dict.fromkeys(notes)), damage=tuple(dict.fromkeys(damage)),
    )  # fmt: skip


def planned_of(recording: Recording) -> tuple[str, int]:
    """Return protocol and number of states of the attached plan; "" and 0 where it does not say."""
    try:
        plan = read_json(recording.attachments["plan.json"])
        states = plan.get("states", 0)
        return str(plan["protocol"]), states if isinstance(states, int) and 0 < states < 10**9 else 0
    except (KeyError, TypeError, ValueError, AttributeError):
        return "", 0


def beyond_plan(states: int, planned: int) -> list[str]:
    """Return the note that more states were read than the plan lists, if so; `planned` is 0 where it does not say."""
    if not 0 < planned < states:
        return []
    return [
        f"{states} states were read, and the plan lists {planned}: duration and limits were checked for those alone; list each "
        "state in `reads` of a Step of the protocol's plan (`lab plan PROTOCOL --rehearse` names the first that is missing)"
    ]


def _or(otherwise: T, notes: list[str], damage: list[str], compute: Callable[[], T]) -> T:
    """What `compute` gives; else `otherwise`, with a note (other versions, merged files) or damage (senseless messages)."""
    try:
        return compute()
    except (NotARecording, OtherVersion) as error:
        notes.append(str(error))
    except (Damaged, BadMessage, BadTable) as error:
        damage.append(str(error))
    return otherwise


class _Fold:
    """One pass over a recording: what its summary takes of the messages. Raises `Damaged`, `Oversized`."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self._faults = recording, dict[str, RecordingError]()
        self.paces = {topic: Pace() for topic in recording.topics}
        self._clocks = {topic: ClockFit() for topic in recording.streams if has_stamp(topic)}
        self._back: dict[str, dict[str, tuple[float, int]]] = defaultdict(dict)
        """Of the counters of each stream the last value, and how often it went back."""
        self._sums: dict[str, dict[str, tuple[float, float, float, int]]] = defaultdict(dict)
        """Of each quantity of a sensor least, sum, greatest and number."""
        channels, undescribed = recording.contents.channels, Counter[int]()
        for stretch in recording.sweep(self._faults):
            logs = defaultdict[str, list[NDArray[np.uint64]]](list)
            for number, times in stretch.times.items():
                if number not in channels:
                    undescribed[number] += len(times)
                    continue
                topic = channels[number].topic
                logs[topic].append(times["log"])
                if topic in stretch.samples:
                    self._stream(topic, times["sequence"], stretch.samples[topic])
            for topic, parts in logs.items():
                self.paces[topic].add(np.sort(np.concatenate(parts)))
        self.undescribed = [
            f"{count} messages are of channel {number}, which is not described" for number, count in sorted(undescribed.items())
        ]
        self.clocks = {topic: fit.model for topic, fit in self._clocks.items() if topic not in self._faults and fit.model}

    def _stream(self, topic: str, numbers: NDArray[np.int64], samples: NDArray[np.void]) -> None:
        """Take the next samples of a stream."""
        names = samples.dtype.names or ()
        for name, values in {"": numbers, **{name: samples[name] for name in COUNTERS if name in names}}.items():
            last, restarts = self._back[topic].get(name, (-np.inf, 0))
            restarts += int((np.diff(values.astype(np.float64), prepend=last) < 0).sum())
            self._back[topic][name] = (float(values[-1]) if len(values) else last, restarts)
        if topic in self._clocks:
            self._clocks[topic].add(samples[STAMP], samples["t"])
        for name in names[1:] if of_sensor(topic) else ():
            values = samples[name][np.isfinite(samples[name])]
            if len(values):
                least, total, greatest, number = self._sums[topic].get(name, (np.inf, 0.0, -np.inf, 0))
                extremes = min(least, float(values.min())), max(greatest, float(values.max()))
                self._sums[topic][name] = (extremes[0], total + float(values.sum()), extremes[1], number + len(values))

    def restarts(self, topic: str) -> int:
        """How often a stream began anew: its messages' numbers, or the instrument's own stamps or frame numbers, went back."""
        self._demand_whole(topic)
        return max((restarts for _, restarts in self._back[topic].values()), default=0)

    def quantities(self, topic: str) -> dict[str, Quantity]:
        """What a sensor of the lab's own measured."""
        self._demand_whole(topic)
        units, sums = self.recording.units(topic), self._sums[topic]
        return {n: Quantity(units[n], least, total / number, most) for n, (least, total, most, number) in sums.items()}

    def _demand_whole(self, topic: str) -> None:
        """Raise why a stream could not be read to its end, if so."""
        if topic in self._faults:
            raise self._faults[topic]
