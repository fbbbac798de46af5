"""What became of each topic's messages, counted while they are recorded."""

from __future__ import annotations

import threading
from array import array
from dataclasses import dataclass, field

import numpy as np

from .timing import timing


@dataclass(frozen=True)
class StreamCounts:
    """What became of a topic's messages.

    `generated` = `written` + `dropped`; `dropped` were refused here (malformed, out of order, queue full, disk failed);
    `lost` never arrived and were reported by the driver. Times in s, rate in Hz; see `timing`.
    """

    generated: int
    written: int
    dropped: int
    lost: int
    rate: float
    jitter: float
    gaps: int
    longest: float

    @property
    def complete(self) -> bool:
        """Nothing was lost on the way."""
        return self.dropped == 0 and self.lost == 0


@dataclass
class Tally:
    """Book-keeping of one topic; `lock` keeps its stamps, its buffer and the queue in one order."""

    channel: int = 0
    lock: threading.Lock = field(default_factory=threading.Lock)
    generated: int = 0
    pending: int = 0
    written: int = 0
    lost: int = 0
    last: int = -1
    stamps: array[int] = field(default_factory=lambda: array("q"))
    complained: bool = False

    def counts(self) -> StreamCounts:
        """The counts so far; what is still on its way to the disk counts as dropped until it is there."""
        at = timing(np.array(self.stamps[: self.written], dtype=np.int64) / 1e9)
        dropped = self.generated - self.written
        return StreamCounts(self.generated, self.written, dropped, self.lost, at.rate, at.jitter, at.gaps, at.longest)
