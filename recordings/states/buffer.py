"""The samples of a run in memory: exactly the bytes that are written, so that live and replay see the same numbers."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingStream, RecordingError
from ..messages import MessageType

KEEP = 900.0
"""Seconds of rig time that stay in memory at least."""

BLOCK = 1024
"""Messages that lie end to end. What is full stays where it is: nobody waits while it is moved."""


class Streams(Protocol):
    """Where a reading takes its samples from: the run in progress or a file."""

    def newest(self, topic: str) -> float:
        """Stamp (s) of the topic's newest sample; -inf while there is none."""

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """The topic's samples with t0 <= t <= t1, oldest first, as an array of its message's `dtype`."""


class _Block:
    """So many messages of one size, with their stamps."""

    def __init__(self, size: int) -> None:
        self.count = 0
        self.stamps = np.empty(BLOCK)
        self.bytes = np.empty((BLOCK, size), np.uint8)
        self.raw = self.bytes.data.cast("B")

    @property
    def newest(self) -> float:
        return float(self.stamps[self.count - 1]) if self.count else -math.inf


class Buffer:
    """One topic's messages, as bytes, with their stamps. Where several threads use it, each holds the lock of `Buffers`."""

    def __init__(self, message: MessageType, keep: float) -> None:
        self.message = message
        self.keep = keep
        self._blocks = [_Block(message.size)]
        """Oldest first."""
        self._forgotten = -math.inf
        """Stamp of the newest message that is no longer held."""

    @property
    def newest(self) -> float:
        """Stamp of the newest message, s; -inf while there is none."""
        return max(block.newest for block in self._blocks[-2:])

    def append(self, t: float, payload: bytes) -> None:
        """Add one message; stamps must not go backwards. Blocks of which all is older than `keep` are forgotten."""
        size, block = self.message.size, self._blocks[-1]
        if block.count == BLOCK:
            while len(self._blocks) > 1 and self._blocks[0].newest < t - self.keep:
                self._forgotten = self._blocks.pop(0).newest
            block = _Block(size)
            self._blocks.append(block)
        place = block.count
        block.stamps[place] = t
        block.raw[place * size : (place + 1) * size] = payload
        block.count = place + 1

    def window(self, t0: float, t1: float, newer: Sequence[tuple[float, bytes]] = ()) -> NDArray[np.void]:
        """Messages with t0 <= t <= t1, decoded, followed by those of `newer` (stamp, payload) in that time; `RecordingError` when
        some of them are forgotten."""
        if -math.inf < self._forgotten >= t0:
            raise RecordingError(
                f"{self.message.topic}: samples from {t0:.3f} s are no longer in memory "
                f"(kept: {self.keep:g} s); read the state sooner or keep more"
            )
        parts: list[NDArray[np.uint8]] = []
        for block in reversed(self._blocks):
            stamps = block.stamps[: block.count]
            parts.append(block.bytes[np.searchsorted(stamps, t0) : np.searchsorted(stamps, t1, side="right")])
            if block.count and stamps[0] < t0:
                break
        waiting_bytes = b"".join(payload for t, payload in newer if t0 <= t <= t1)
        blocks = [part.reshape(-1) for part in parts[::-1]]
        return self.message.decode(np.concatenate([*blocks, np.frombuffer(waiting_bytes, np.uint8)]))


class Buffers:
    """The buffers of all streams: `Streams` of a run in progress.

    `waiting`: topic -> samples (stamp s, payload) on their way into its buffer, oldest first; who looks sees them too.
    `lock` is held by readers, and while a sample goes from there into its buffer. Producers never take it.
    """

    def __init__(
        self,
        messages: dict[str, MessageType],
        keep: float = KEEP,
        waiting: Callable[[str], Sequence[tuple[float, bytes]]] = lambda topic: (),
    ) -> None:
        self.lock = threading.Lock()
        self._buffers = {topic: Buffer(message, keep) for topic, message in messages.items()}
        self._waiting = waiting

    def __getitem__(self, topic: str) -> Buffer:
        try:
            return self._buffers[topic]
        except KeyError:
            raise MissingStream(f"no stream {topic}; there are {', '.join(self._buffers)}") from None

    def newest(self, topic: str) -> float:
        """Stamp (s) of the topic's newest sample; -inf while there is none."""
        buffer = self[topic]
        with self.lock:
            waiting = self._waiting(topic)
            return waiting[-1][0] if waiting else buffer.newest

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """The topic's samples with t0 <= t <= t1, oldest first."""
        buffer = self[topic]
        with self.lock:
            return buffer.window(t0, t1, self._waiting(topic))

    def latest(self, topic: str) -> np.void | None:
        """The topic's newest sample, None while there is none."""
        newest = self.newest(topic)
        return None if newest == -math.inf else self.window(topic, newest, math.inf)[-1]
