"""A noisy made-up run: a robot that is inflated, creeps to rest, and is read by streams of different rates; its recording, the
same by another writer, and states that may be asked of it."""

import math
import random as order
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.records import Message as McapMessage
from mcap.writer import Writer

from recordings.file.writer import Recorder
from recordings.states.concluding import conclude
from recordings.states.rules import Settled, State, Window

Message = tuple[str, float, tuple[object, ...]]
STREAMS = ("/pressure", "/tip", "/spine", "/vacuum", "/force", "/arm")
OLD = Path(__file__).parent / "data" / "bending-schema-1.mcap"
"""A recording of schema version 1, kept since."""
SIGNS = (-1, 1)
REST = Settled(still=0.6, still_distance=1e-3, min_samples=3, average=0.4)
TARGETS = (80e3, 80e3, 80e3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Run:
    """Pressure ramps for `ramp` s to TARGETS, the tip follows with time constant `lag` (s); noise is gaussian."""

    seed: int = 1
    duration: float = 12.0
    ramp: float = 3.0
    lag: float = 0.8
    hidden: tuple[float, float] = (0.0, 0.0)
    dropout: float = 0.0

    def messages(self) -> Iterator[Message]:
        """All messages in the order in which they arrive."""
        random = np.random.default_rng(self.seed)
        out: list[Message] = []
        rates = {"/pressure": 10, "/tip": 100, "/spine": 10, "/vacuum": 5, "/force": 100, "/arm": 125}
        for topic, rate in rates.items():
            stamps = np.arange(0.01, self.duration, 1 / rate)
            stamps += random.uniform(0, 0.3 / rate, len(stamps))
            for k, t in enumerate(stamps.tolist()):
                out.append((topic, t, self._values(topic, k, t, random)))
        return iter(sorted(out, key=lambda message: message[1]))

    def level(self, t: float) -> float:
        """Share of the target pressures."""
        return min(1.0, t / self.ramp)

    def tip(self, t: float) -> tuple[float, float, float]:
        """True tip position, m."""
        x = 0.1 * (self.level(t) if t < self.ramp else 1.0) * (1 - math.exp(-t / self.lag))
        return (x, 0.0, 0.4 - x * x)

    def _values(self, topic: str, k: int, t: float, random: np.random.Generator) -> tuple[object, ...]:
        if topic == "/pressure":
            asked = tuple(self.level(t) * p for p in TARGETS)
            return (asked, tuple(p + random.normal(0, 100) for p in asked))
        if topic == "/tip":
            seen = not (self.hidden[0] <= t <= self.hidden[1]) and random.random() >= self.dropout
            place = tuple(c + random.normal(0, 0.3e-3) for c in self.tip(t))
            turn = np.array([1.0, 0.0, 0.3 * self.level(t), 0.0]) + random.normal(0, 1e-3, 4)
            turn = tuple((turn / math.sqrt(turn @ turn) * SIGNS[random.integers(2)]).tolist())
            markers = ((0.0, 0.0, 0.1), (math.nan,) * 3 if k % 7 == 0 else (0.01, 0.0, 0.2))
            return (t, k, place, turn, 1e-4, bool(seen), markers)
        if topic == "/spine":
            return (0.2 + random.normal(0, 1e-5), 0.0, 0.2, False, True)
        if topic == "/vacuum":
            return (21e3 + random.normal(0, 50),)
        if topic == "/force":
            return (tuple(random.normal(0, 0.05, 6) + [0.0, 0.0, 2.5, 0.0, 0.0, 0.0]), (0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
        pose = (0.4, 0.1, 0.305 + random.normal(0, 1e-5), math.pi * SIGNS[random.integers(2)], 0.0, 0.0)
        return (t, (0.0,) * 6, pose, (0.0,) * 6, 1, True)


def recorded(path: Path, run: Run, **options: Any) -> Path:
    """A finished recording of a run, with a robot's two markers and an attachment."""
    kept: dict[str, Any] = {"start_wall_ns": 10**18, "attachments": {"rig.yaml": b"x: 1"}, "markers": 2}
    with Recorder(path, **kept | options) as recorder:
        for topic, t, values in run.messages():
            recorder.push(topic, t, values)
    return path


def concluded(path: Path) -> Path:
    """A finished recording of seven seconds in many chunks, in which one state was asked for at 2 s and read."""
    asked = state(rule=REST, t_start=2.0, ramp_end=2.0, rate=1.0, spine_length=0.2)
    with Recorder(path, start_wall_ns=1_700_000_000_123_456_789, markers=2) as recorder:
        recorder.progress(0.0, 0, 2, 0.0, 7.0)
        for k, (topic, t, values) in enumerate(Run(duration=7.0, ramp=2.0, lag=0.4).messages()):
            recorder.push(topic, t, values)
            if k % 200 == 0:
                recorder.sync()  # a chunk each
        recorder.state(2.0, asked)
        row = conclude(recorder.buffers, asked)
        assert row is not None
        recorder.trial(6.9, 1, row)
        recorder.progress(6.9, 1, 2, 3.5, 7.0)
    return path


def state(**changes: Any) -> State:
    """A state of the first trial, as a protocol asks for it."""
    plain: dict[str, Any] = {
        "trial": 1, "step": 1, "protocol": "bending", "repeat": 1, "branch": "load", "rule": Window(0.5), "t_start": 0.0,
        "ramp_end": 0.0, "rate": 0.0, "targets": TARGETS, "spine_length": 0.1, "tip_mass": 0.0,
    }  # fmt: skip
    return State(**plain | changes)


def rewritten(
    source: Path,
    target: Path,
    change: Callable[[str, int, McapMessage], None] = lambda topic, number, message: None,
    topics: Iterable[str] | None = None,
    seed: int | None = None,
    metadata: dict[str, dict[str, str]] | None = None,
    channel: dict[str, str] | None = None,
    more: Iterable[tuple[str, bytes, int]] = (),
    **how: Any,
) -> Path:
    """The same messages by the library's writer; with a seed in another order, so that its chunks hold others.

    Each message may be changed; `metadata` and `channel` (of every channel) replace those of the source, and `more` messages
    (topic, data, number) follow at 11 s.
    """
    with open(source, "rb") as file, open(target, "wb") as out:
        reader, writer = make_reader(file), Writer(out, **how)
        found, summary = list(reader.iter_messages(topics, log_time_order=seed is None)), reader.get_summary()
        if seed is not None:
            order.Random(seed).shuffle(found)
        writer.start()
        for attachment in reader.iter_attachments():
            writer.add_attachment(1, 1, attachment.name, "text/plain", attachment.data)
        own = {r.name: dict(r.metadata) for r in reader.iter_metadata() if r.name not in ("counts", "clocks")}
        for name, texts in (own if metadata is None else metadata).items():
            writer.add_metadata(name, texts)
        channels: dict[str, int] = {}
        for each in summary.channels.values():
            schema = summary.schemas[each.schema_id]
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[each.topic] = writer.register_channel(each.topic, "protobuf", number, each.metadata | (channel or {}))
        for k, (_, each, message) in enumerate(found):
            change(each.topic, k, message)
            writer.add_message(channels[each.topic], message.log_time, message.data, message.publish_time, message.sequence)
        for topic, data, number in more:
            writer.add_message(channels[topic], 10**18 + 11 * 10**9, data, 10**18 + 11 * 10**9, number)
        writer.finish()
    return target


def held(path: Path) -> list[tuple[str, int, int, bytes]]:
    """All messages (topic, log time, number, data), by the library's reader, in the file's order of time."""
    with open(path, "rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages()
        return [(channel.topic, m.log_time, m.sequence, m.data) for _, channel, m in found]
