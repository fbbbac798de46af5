"""The samples of a run in memory: exactly the bytes that are written, so that live and replay see the same numbers."""

from __future__ import annotations

import math
import threading
from collections.abc import ItemsView
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingStream, RecordingError
from ..messages import MessageType

KEEP = 900.0
"""Seconds of rig time that stay in memory at least."""

_FIRST_CAPACITY = 256


class Streams(Protocol):
    """Where a reading takes its samples from: the run in progress or a file."""

    def newest(self, topic: str) -> float:
        """Stamp (s) of the topic's newest sample; -inf while there is none."""

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """The topic's samples with t0 <= t <= t1, oldest first, as an array of its message's `dtype`."""


class Buffer:
    """One topic's messages, end to end as bytes, with their stamps. Appending and looking are safe from any thread."""

    def __init__(self, message: MessageType, keep: float) -> None:
        self.message = message
        self.keep = keep
        self.forgotten = -math.inf
        """Stamp of the newest message that is no longer held."""
        self._lock = threading.Lock()
        self._count = 0
        self._stamps = np.empty(_FIRST_CAPACITY)
        self._bytes = np.empty((_FIRST_CAPACITY, message.size), np.uint8)
        self._raw = self._bytes.data.cast("B")

    @property
    def newest(self) -> float:
        """Stamp of the newest message, s; -inf while there is none."""
        with self._lock:
            return float(self._stamps[self._count - 1]) if self._count else -math.inf

    def append(self, t: float, payload: bytes) -> None:
        """Add one message; stamps must not go backwards."""
        size = self.message.size
        with self._lock:
            if self._count == len(self._stamps):
                self._make_room(t)
            self._stamps[self._count] = t
            self._raw[self._count * size : (self._count + 1) * size] = payload
            self._count += 1

    def _make_room(self, t: float) -> None:
        """Forget what is older than `keep`; grow when that does not free half of the room."""
        old = int(np.searchsorted(self._stamps[: self._count], t - self.keep))
        if old:
            self.forgotten = float(self._stamps[old - 1])
        left = self._count - old
        capacity = max(_FIRST_CAPACITY, 2 * left)
        stamps, rows = np.empty(capacity), np.empty((capacity, self.message.size), np.uint8)
        stamps[:left] = self._stamps[old : self._count]
        rows[:left] = self._bytes[old : self._count]
        self._stamps, self._bytes, self._count = stamps, rows, left
        self._raw = rows.data.cast("B")

    def window(self, t0: float, t1: float) -> NDArray[np.void]:
        """Messages with t0 <= t <= t1, decoded; `RecordingError` when some of them are forgotten."""
        with self._lock:
            if -math.inf < self.forgotten >= t0:
                raise RecordingError(
                    f"{self.message.topic}: samples from {t0:.3f} s are no longer in memory "
                    f"(kept: {self.keep:g} s); read the state sooner or keep more"
                )
            first, last = (
                np.searchsorted(self._stamps[: self._count], t0),
                np.searchsorted(self._stamps[: self._count], t1, side="right"),
            )
            raw = self._bytes[first:last].copy()
        return self.message.decode(raw.reshape(-1))


class Buffers:
    """The buffers of all streams: `Streams` of a run in progress."""

    def __init__(self, messages: dict[str, MessageType], keep: float = KEEP) -> None:
        self._buffers = {topic: Buffer(message, keep) for topic, message in messages.items()}

    def __getitem__(self, topic: str) -> Buffer:
        try:
            return self._buffers[topic]
        except KeyError:
            raise MissingStream(f"no stream {topic}; there are {', '.join(self._buffers)}") from None

    def items(self) -> ItemsView[str, Buffer]:
        """Every topic with its buffer."""
        return self._buffers.items()

    def newest(self, topic: str) -> float:
        """Stamp (s) of the topic's newest sample; -inf while there is none."""
        return self[topic].newest

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """The topic's samples with t0 <= t <= t1, oldest first."""
        return self[topic].window(t0, t1)

    def latest(self, topic: str) -> np.void | None:
        """The topic's newest sample, None while there is none."""
        newest = self.newest(topic)
        return None if newest == -math.inf else self.window(topic, newest, math.inf)[-1]
