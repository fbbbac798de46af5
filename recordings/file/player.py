"""A recording as a player: its messages in the order of time, at the pace they came, faster, or at once.

    play(Recording.open(path), sink, speed=4)           sink(Played) for every message

What is played depends on the file alone: order and content are the same at any speed.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.json_format import MessageToDict, SerializeToJsonError
from numpy.typing import NDArray

from ..errors import Damaged
from ..events import EVENTS
from ..messages import is_stream
from .reader import Recording
from .samples import parse

Fields = dict[str, Any]


@dataclass(frozen=True)
class Played:
    """One message: topic, rig time (s), log time (ns since the epoch), and its fields as plain numbers and lists."""

    topic: str
    t: float
    log_time: int
    fields: Fields

    def to_json(self) -> str:
        """One line; numbers that are none (NaN) are null."""
        return json.dumps({"topic": self.topic, "t": self.t, "log_time": self.log_time, "fields": plain_numbers(self.fields)})


def messages(recording: Recording) -> Iterator[Played]:
    """All messages in the order of their log time; at equal times in the order of the channels."""
    start = recording.start_wall_ns
    recording.load()
    topics = [topic for topic in recording.topics if recording.knows(topic)]
    times, makers = zip(*(_played(recording, topic) for topic in topics), strict=True) if topics else ((), ())
    of = np.repeat(np.arange(len(topics)), [len(t) for t in times])
    rows = np.concatenate([np.zeros(0, np.int64), *(np.arange(len(t)) for t in times)])
    log_times = np.concatenate([np.zeros(0, np.int64), *times])
    for i in np.lexsort((rows, of, log_times)).tolist():
        log_time = int(log_times[i])
        yield Played(topics[of[i]], (log_time - start) / 1e9, log_time, makers[of[i]](int(rows[i])))


def play(recording: Recording, sink: Callable[[Played], None], speed: float = math.inf, pace: Any = time) -> int:
    """Send every message to `sink`; `speed` 1 is rig time, inf is at once. Returns how many were sent. `pace`: has `monotonic`
    and `sleep` like the module time.

    A sink that is slower than the recording delays what follows; nothing is left out.
    """
    if not speed > 0:
        raise ValueError(f"speed = {speed}: must be above 0, as a multiple of rig time")
    count = 0
    begin, first = pace.monotonic(), None
    for message in messages(recording):
        first = message.t if first is None else first
        wait = begin + (message.t - first) / speed - pace.monotonic()
        if wait > 0:
            pace.sleep(wait)
        sink(message)
        count += 1
    return count


def _played(recording: Recording, topic: str) -> tuple[NDArray[np.int64], Callable[[int], Fields]]:
    """Log times (ns) of a topic's messages, and what makes the fields of each."""
    if is_stream(topic):  # in the order of the stream's own stamps, from which the log times are made
        samples = recording.stream(topic)
        names = samples.dtype.names or ()
        times = recording.log_times(topic, samples=True).astype(np.int64)
        return times, lambda row: {name: samples[row][name].tolist() for name in names}
    event = EVENTS[topic]
    payloads = recording.payloads(event)

    def fields(row: int) -> Fields:
        # One at a time: as dictionaries all of them would be many times as large.
        message = parse(event.message_class, payloads[row][1], topic)
        try:
            return MessageToDict(message, preserving_proto_field_name=True)
        except (ValueError, SerializeToJsonError) as error:
            raise Damaged(f"{topic}: a message cannot be written as JSON ({error}); run `lab verify`") from error

    return np.array([log_time for log_time, _ in payloads], dtype=np.int64), fields


def plain_numbers(value: Any) -> Any:
    """The value with None for every number that is none (NaN, infinite): JSON knows none such."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple):
        return [plain_numbers(item) for item in value]
    if isinstance(value, dict):
        return {key: plain_numbers(item) for key, item in value.items()}
    return value
