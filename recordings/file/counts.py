"""Fate of each topic's messages, counted while they are recorded, and how evenly they came."""

from __future__ import annotations

import contextlib
import struct
import threading
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..json_text import read_json

LARGEST = 2**53
"""No recorder counts further."""
GAP = 2.5
"""Median intervals, above which an interval is a gap."""


@dataclass(frozen=True)
class Timing:
    """`rate` Hz over the whole time; `interval` s, median; `jitter_p50`, `_p99`, `_max` s: quantiles of how far the
    intervals that are no gaps lie from the median; `gaps` the number of those that are; `longest` s, the longest
    interval; `missing` messages that would have filled the gaps."""

    count: int
    start: float
    end: float
    rate: float
    interval: float
    jitter_p50: float
    jitter_p99: float
    jitter_max: float
    gaps: int
    longest: float
    missing: int


class Pace:
    """The timing of a topic whose stamps (ns) come piece by piece, each later than those before it.

    What is kept is how many intervals there are of each length. Beyond `DISTINCT` lengths neighbours are taken together.
    """

    DISTINCT = 2**17

    def __init__(self) -> None:
        self.count = 0
        self.first = self.last = 0
        self._longest = 0
        self._grain = 1
        """ns: lengths are known to half of it."""
        self._lengths = self._numbers = np.zeros(0, np.int64)
        self._pending: list[NDArray[np.int64]] = []

    @classmethod
    def of(cls, stamps: NDArray[np.integer[Any]]) -> Pace:
        """Of all stamps."""
        pace = cls()
        pace.add(stamps)
        return pace

    def add(self, stamps: NDArray[np.integer[Any]]) -> None:
        """Take the next stamps, ascending."""
        if not len(stamps):
            return
        if not self.count:
            self.first = self.last = int(stamps[0])
        intervals = np.diff(stamps, prepend=stamps.dtype.type(self.last)).astype(np.int64)[0 if self.count else 1 :]
        self.count, self.last = self.count + len(stamps), int(stamps[-1])
        self._longest = max(self._longest, int(intervals.max(initial=0)))
        self._pending.append(np.maximum(intervals, 0))
        if sum(map(len, self._pending)) > 2 * self.DISTINCT:
            self._merge()

    def _merge(self) -> None:
        lengths = np.concatenate([self._lengths, *self._pending])
        numbers = np.concatenate([self._numbers, np.ones(len(lengths) - len(self._lengths), np.int64)])
        self._pending = []
        while True:
            self._lengths, place = np.unique(lengths // self._grain * self._grain, return_inverse=True)
            self._numbers = np.bincount(place, numbers, len(self._lengths)).astype(np.int64)
            if len(self._lengths) <= self.DISTINCT:
                return
            self._grain *= 2

    def timing(self, start: int = 0) -> Timing:
        """Summary, times counted from `start` (ns); zeros where there are too few stamps to tell."""
        begin, end = ((self.first - start) / 1e9, (self.last - start) / 1e9) if self.count else (0.0, 0.0)
        if self.count < 2:
            return Timing(self.count, begin, begin, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0)
        self._merge()
        lengths = np.asarray((self._lengths + (self._grain - 1) / 2) / 1e9, np.float64)
        numbers = self._numbers
        (median,) = _quantiles(lengths, numbers, 0.5)
        gap = lengths > GAP * median if median > 0 else np.zeros(len(lengths), dtype=bool)
        missing = int((np.round(lengths[gap] / median) - 1) @ numbers[gap]) if gap.any() else 0
        p50, p99, largest = _quantiles(np.abs(lengths[~gap] - median), numbers[~gap], 0.5, 0.99, 1.0)
        rate = (self.count - 1) / (end - begin) if end > begin else 0.0
        gaps, longest = int(numbers[gap].sum()), self._longest / 1e9
        return Timing(self.count, begin, end, rate, median, p50, p99, largest, gaps, longest, missing)


def _quantiles(values: NDArray[np.float64], numbers: NDArray[np.int64], *shares: float) -> list[float]:
    """Quantiles of values that occur so often, interpolated as numpy does."""
    order = np.argsort(values)
    values, ends = values[order], np.cumsum(numbers[order])
    at = np.array(shares) * (ends[-1] - 1)
    low, high = (values[np.searchsorted(ends, k, side="right")] for k in (np.floor(at), np.ceil(at)))
    return np.asarray(low + (at - np.floor(at)) * (high - low)).tolist()


@dataclass(frozen=True)
class StreamCounts:
    """Fate of a topic's messages.

    `generated` = `written` + `dropped`; `dropped` were refused here (malformed, out of order, queue full, disk failed);
    `lost` never arrived and were reported by the driver. Times in s, rate in Hz; see `Timing`.
    """

    generated: int
    written: int
    dropped: int
    lost: int
    rate: float
    jitter_p50: float
    jitter_p99: float
    jitter_max: float
    gaps: int
    longest: float

    @classmethod
    def of(cls, generated: int, written: int, lost: int, at: Timing) -> StreamCounts:
        """Counts with the timing of what was written."""
        return cls(
            generated, written, generated - written, lost,
            at.rate, at.jitter_p50, at.jitter_p99, at.jitter_max, at.gaps, at.longest,
        )  # fmt: skip

    @property
    def complete(self) -> bool:
        """Nothing was lost on the way."""
        return self.dropped == 0 and self.lost == 0


def _stated(metadata: Mapping[str, Mapping[str, str]]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The counts that a file states, by topic, where they can be read."""
    for topic, text in metadata.get("counts", {}).items():
        with contextlib.suppress(ValueError):
            if isinstance(stated := read_json(text), dict):
                yield topic, stated


def counted(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, dict[str, int]]:
    """The counts that a file states, by topic; what is no count (text, below zero) is left out."""
    return {
        topic: {name: n for name, n in stated.items() if type(n) is int and 0 <= n <= LARGEST}
        for topic, stated in _stated(metadata)
    }


def below_zero(metadata: Mapping[str, Mapping[str, str]]) -> list[str]:
    """What is wrong with the counts that a file states: none can be below zero."""
    return [
        f"{topic}: {name} is given as {stated[name]}, which is not a count"
        for topic, stated in _stated(metadata)
        for name in ("generated", "written", "dropped", "lost")
        if type(stated.get(name)) is int and stated[name] < 0
    ]


@dataclass
class Tally:
    """Book-keeping of one topic, by the writer's thread; `lock` is for what other threads count."""

    channel: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)
    refused: int = 0
    """Never came into the queue: malformed, queue full, file closed or failed."""
    lost: int = 0
    taken: int = 0
    """Came out of the queue, or is a view made there."""
    pending: int = 0
    written: int = 0
    last: int = -1
    """Newest rig time of those taken, ns."""
    stamps: array[int] = field(default_factory=lambda: array("q"))
    """Rig time of each message in the file or on its way there, ns."""
    stamp_at: int | None = None
    """Where in the message the instrument's own stamp is; None: it has none."""
    device_stamps: array[float] = field(default_factory=lambda: array("d"))
    complained: bool = False

    @property
    def generated(self) -> int:
        """All but those that still wait in the queue."""
        return self.taken + self.refused

    def refuse(self) -> None:
        """Count a message that does not come into the queue; from any thread."""
        with self.lock:
            self.refused += 1

    def note(self, ns: int, payload: bytes) -> None:
        """A message goes into the file."""
        self.pending += 1
        self.stamps.append(ns)
        if self.stamp_at is not None:
            self.device_stamps.append(struct.unpack_from("<d", payload, self.stamp_at)[0])

    def counts(self, generated: int) -> StreamCounts:
        """The counts so far, of this many generated with those that wait in the queue; what is still on its way to the disk
        counts as dropped until it is there."""
        pace = Pace.of(np.sort(np.array(self.stamps[: self.written], dtype=np.int64)))
        return StreamCounts.of(generated, self.written, self.lost, pace.timing())
