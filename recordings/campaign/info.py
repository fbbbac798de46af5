"""What is in a recording, at a glance: streams, counts, rates, gaps, losses, clocks, attachments, provenance, outcome."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from ..events import Request
from ..file.clocks import ClockModel, clocks
from ..file.counts import counted
from ..file.reader import Recording
from ..file.timing import Timing, timing
from ..states.concluding import of_sensor


@dataclass(frozen=True)
class StreamInfo:
    """One topic: timing of the messages in the file, and what the recorder counted (None when it never said)."""

    timing: Timing
    dropped: int | None
    lost: int | None
    restarts: int = 0
    """How often its numbers or its instrument's stamps went back: the stream began anew; what was lost then is not known."""


@dataclass(frozen=True)
class Quantity:
    """What a sensor of the lab's own measured: unit, and the range and mean of its samples."""

    unit: str
    least: float
    mean: float
    greatest: float


@dataclass(frozen=True)
class Info:
    """Summary of a file. `readable` of `size` bytes are whole records; `outcome` None: it ended abruptly."""

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

    @property
    def complete(self) -> bool:
        """Finished, and no message was dropped or lost on the way."""
        return self.finished and all(not (s.dropped or s.lost) for s in self.streams.values())

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "complete": self.complete}


def info(path: str | os.PathLike[str]) -> Info:
    """Summary of a file, truncated or not. Raises `NotARecording` or `Damaged`.

    >>> found = info("run.mcap")
    >>> found.outcome, found.complete
    ('completed', True)
    """
    recording = Recording.open(path, truncated=True)
    metadata = dict(recording.metadata)
    metadata.pop("clocks", None)
    recording.load()
    counts = counted(metadata)
    metadata.pop("counts", None)
    outcome = metadata.pop("outcome", {})
    streams: dict[str, StreamInfo] = {}
    start = recording.start_wall_ns if "recording" in metadata else 0
    first: int | None = None
    last = 0
    for topic in recording.topics:
        log_times = recording.log_times(topic)
        if len(log_times):
            first = int(log_times[0]) if first is None else min(first, int(log_times[0]))
            last = max(last, int(log_times[-1]))
        stated = counts.get(topic, {})
        restarts = recording.restarts(topic) if topic in recording.streams else 0
        since = (log_times - start) / 1e9
        streams[topic] = StreamInfo(timing(since), stated.get("dropped"), stated.get("lost"), restarts)
    return Info(
        path=str(recording.path),
        size=recording.contents.size,
        readable=recording.contents.end,
        finished=recording.contents.finished,
        outcome=outcome.get("outcome"),
        detail=outcome.get("detail", ""),
        start="" if first is None else datetime.fromtimestamp(first / 1e9, UTC).isoformat(timespec="seconds"),
        duration=0.0 if first is None else (last - first) / 1e9,
        states=streams["/state"].timing.count if "/state" in streams else 0,
        rows=streams["/trial"].timing.count if "/trial" in streams else 0,
        streams=streams,
        attachments={name: len(data) for name, data in recording.attachments.items()},
        clocks=clocks(recording),
        metadata=metadata,
        requests=recording.requests,
        sensors={topic: _quantities(recording, topic) for topic in recording.streams if of_sensor(topic)},
    )


def _quantities(recording: Recording, topic: str) -> dict[str, Quantity]:
    samples, found = recording.stream(topic), {}
    for name, unit in recording.units(topic).items():
        values = samples[name][np.isfinite(samples[name])]
        if name != "t" and len(values):
            found[name] = Quantity(unit, float(values.min()), float(values.mean()), float(values.max()))
    return found
