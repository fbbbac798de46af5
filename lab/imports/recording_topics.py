"""Topics of a recording of another robot as columns `/topic.field`, at the times of one of them.

Only the topics that a map names are decoded. A topic, message or field that cannot be decoded is left out, and a note says
which and why. The files into which a recorder split one recording are read as one.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import zstandard
from mcap.records import Channel, Schema

from model.arrays import Array
from recordings.errors import Damaged, RecordingError, Truncated
from recordings.file.reader import Recording
from recordings.file.samples import message_class
from recordings.numbers import number

from ..files.config import ConfigError
from ..files.map_file import Map, Source
from .clock import EPOCH
from .joining import at_times
from .series import MOST_COLUMNS, Series, Texts, leaves, name_in

if TYPE_CHECKING:
    import pandas as pd

Decoder = Callable[[bytes], Any]

MOST_REASONS, MOST_SAID = 3, 160
"""Reasons that a note gives, and letters of each."""
SHOWN = 12
"""Topics that a note lists."""
PARTS_APART = 2.0 * 1e9
"""ns within which files that follow each other are parts of one recording."""
OLDEST = 0.5
"""s that the nearest message of a topic may be old."""
FEWEST_OF_A_THING = 4
"""Messages about each thing, on average; a word that changes more often is no name."""
ZSTD = b"\x28\xb5\x2f\xfd"
MOST_UNPACKED = 64 << 20
"""Bytes of one message that is unpacked."""
PLAIN_CDR = (b"\0\0", b"\0\1")
"""How a message in CDR begins, by the order of its bytes; XCDR2 places its fields otherwise."""
DECODERS = {"cdr": "mcap_ros2.decoder", "ros1": "mcap_ros1.decoder"}
"""Package by encoding; JSON and protobuf need none."""


@dataclass
class Topic:
    """Messages of one topic: times (s since the epoch), and numbers by column."""

    name: str
    times: list[float] = field(default_factory=list)
    rows: list[dict[str, float]] = field(default_factory=list)
    about: list[str] = field(default_factory=list)
    """Which thing each message names; empty where it names none."""
    left_out: int = 0
    """Messages that could not be decoded."""
    why: dict[str, None] = field(default_factory=dict)
    """Why messages or fields were left out."""

    @property
    def things(self) -> list[str]:
        """What the messages name, where they name several things."""
        named = [thing for thing in dict.fromkeys(self.about) if thing]
        return named if 1 < len(named) <= len(self.rows) / FEWEST_OF_A_THING else []

    def frame(self) -> pd.DataFrame:
        """Numbers by column and time, NaN where a message has none; each of several things has columns of its own."""
        import pandas as pd

        cut, things = len(self.name), self.things
        rows = [
            {f"{name[:cut]}{thing}{name[cut:]}": value for name, value in row.items()}
            for thing, row in zip([f".{thing}" * bool(thing and things) for thing in self.about], self.rows, strict=True)
        ]
        return pd.DataFrame(rows, index=self.times, dtype=np.float64).sort_index(kind="stable")

    @property
    def reason(self) -> str:
        """Why messages or fields were left out."""
        count = f"{self.left_out} of {self.left_out + len(self.rows)} messages are skipped: " if self.left_out else ""
        more = f"; and {len(self.why) - MOST_REASONS} other reasons" if len(self.why) > MOST_REASONS else ""
        return count + "; ".join(islice(self.why, MOST_REASONS)) + more


def together(files: Sequence[tuple[Path, Map]]) -> list[tuple[tuple[Path, ...], Map]]:
    """Recordings in the order of time, each with the files into which its recorder split it, and its map; raises ConfigError.

    Parts of one recording follow each other within `PARTS_APART`, have topics in common and the same map."""
    opened = [(r.contents.span or (0, 0), set(r.topics), path, wanted) for path, wanted in files for r in [_open(path)]]
    recordings: list[tuple[tuple[Path, ...], Map]] = []
    end, topics = -np.inf, set[str]()
    for (first, last), own_topics, path, wanted in sorted(opened, key=lambda o: o[0]):
        if recordings and topics & own_topics and first > 0 and abs(first - end) <= PARTS_APART and recordings[-1][1] == wanted:
            recordings[-1] = ((*recordings[-1][0], path), wanted)
        else:
            recordings.append(((path,), wanted))
        end, topics = last, own_topics
    return recordings


def read_topics(paths: Sequence[Path], source: Source, named: Collection[str] | None) -> Series:
    """Columns /topic.field of all topics at the log times of one: `source.topic`, or that with positions and most messages.

    `paths`: the parts of one recording. `named`: columns that are wanted; None: all. Raises ConfigError."""
    path, recordings = paths[0], [_open(p) for p in paths]
    all_topics = list(dict.fromkeys(topic for recording in recordings for topic in recording.topics))
    wanted = all_topics
    if named is not None:  # a column is a topic, or a field of it
        wanted = [t for t in all_topics if t == source.topic or any(n == t or n.startswith(f"{t}.") for n in named)]
    notes = [f"read as one recording, by its times: {', '.join(p.name for p in paths)}"] if len(paths) > 1 else []
    if unwanted := [t for t in all_topics if t not in wanted]:
        more = f" and {len(unwanted) - SHOWN} more" if len(unwanted) > SHOWN else ""
        notes.append(f"topics that are not in the map are not read: {', '.join(unwanted[:SHOWN])}{more}")
    topic_of = {name: Topic(name) for name in wanted}
    for p, recording in zip(paths, recordings, strict=True):
        channels = Counter(c.topic for c in recording.contents.channels.values() if c.topic in topic_of)
        notes += [f"{n} channels carry {topic}; read as one, in order of time" for topic, n in channels.items() if n > 1]
        try:
            _decode(recording, topic_of)
        except RecordingError as e:
            raise _unreadable(p, e) from e
    for topic in topic_of.values():
        if things := ", ".join(topic.things[:SHOWN]):
            notes.append(f"the messages of {topic.name} are about {things}: read as columns {topic.name}.NAME")
        if topic.why:
            notes.append(f"{topic.name}: {topic.reason}")
    topics = {name: topic for name, topic in topic_of.items() if any(topic.rows)}
    if not topics:
        why = "; ".join(f"{topic.name}: {topic.reason}" for topic in topic_of.values() if topic.why)
        raise ConfigError(f"{path}: no topic holds numbers that can be read{f' ({why})' if why else ''}")
    if source.topic is not None and source.topic not in topics:
        why = f" ({topic_of[source.topic].reason})" if source.topic in topic_of and topic_of[source.topic].why else ""
        raise ConfigError(f"{path}: has no topic {source.topic!r} with numbers (source.topic){why}; it has {', '.join(topics)}")
    placed = {name for name, topic in topics.items() if any(n.endswith(("tip_1", ".x")) for n in topic.rows[0])}
    leading = topics[source.topic or max(topics, key=lambda t: (t in placed, len(topics[t].rows)))]
    frames = {name: topic.frame() for name, topic in topics.items()}
    start, times = min(frame.index[0] for frame in frames.values()), frames[leading.name].index.to_numpy()
    # s since the epoch where log times are, so that recordings keep their distance in time
    columns: dict[str, Array | Texts] = {"time": times if start >= EPOCH[0] else times - start}
    if len(times) > 1 and not np.ptp(times):
        raise ConfigError(
            f"{path}: all {len(times)} messages of {leading.name} have the log time {times[0]:g} s, so they cannot be matched; "
            "record again with times, or write them with the stamps in their messages"
        )
    for name, frame in frames.items():
        for label, values in _continuous({label: frame[label].to_numpy() for label in frame}).items():
            columns[label] = values if name == leading.name else at_times(times, frame.index.to_numpy(), values, OLDEST)
    return Series(path, columns, "MCAP", notes=tuple(dict.fromkeys(notes)))


def _open(path: Path) -> Recording:
    try:
        return Recording.open(path)
    except RecordingError as e:
        raise _unreadable(path, e) from e


def _unreadable(path: Path, error: RecordingError) -> ConfigError:
    """What is wrong with a file, and what to do."""
    text = str(error) if str(path) in str(error) else f"{path}: {error}"
    damaged = isinstance(error, Damaged | Truncated) and "lab recover" not in text
    return ConfigError(f"{text}, then `lab recover`, and import what it writes" if damaged else text)


def _continuous(columns: dict[str, Array]) -> dict[str, Array]:
    """Give each quaternion (columns STEM.w .x .y .z) the sign that is nearer to the one before: q and -q are one turn."""
    for stem in [name[:-1] for name in columns if name.endswith(".w")]:
        names = [f"{stem}{part}" for part in "wxyz"]
        if not all(name in columns for name in names):
            continue
        parts = np.array([columns[name] for name in names])
        seen = np.flatnonzero(np.isfinite(parts).all(axis=0))
        if np.abs(np.linalg.norm(parts[:, seen], axis=0) - 1).max(initial=0.0) > 0.05:
            continue
        flips = (parts[:, seen[1:]] * parts[:, seen[:-1]]).sum(axis=0) < 0
        parts[:, seen[1:]] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)
        columns |= dict(zip(names, parts, strict=True))
    return columns


# ------------------------------------------------------------------ messages
def _decode(recording: Recording, topics: Mapping[str, Topic]) -> None:
    """Append the messages of one file to the topics they belong to; those that cannot be decoded are counted there."""
    decoders: dict[int, Decoder | None] = {}
    for channel, log_times, payloads in recording.messages(topics):
        topic = topics[channel.topic]
        if channel.id not in decoders:
            schema = recording.contents.schemas.get(channel.schema_id)
            decoders[channel.id] = _decoder(channel, schema, payloads[:20], topic)
        decode = decoders[channel.id]
        if decode is None:
            topic.left_out += len(payloads)
            continue
        for log_time, payload in zip(log_times.tolist(), payloads, strict=True):
            try:
                message = decode(payload)
                row = dict(islice(_numbers(channel.topic, message), MOST_COLUMNS))
            except Exception as e:  # whatever a decoder raises, this is no message
                topic.left_out += 1
                topic.why.setdefault(_short(e))
            else:
                topic.times.append(log_time / 1e9)
                topic.rows.append(row)
                topic.about.append(name_in(message))


def _decoder(channel: Channel, schema: Schema | None, tried: Sequence[bytes], topic: Topic) -> Decoder | None:
    """The first decoder that decodes a message tried; None, with the reason in `topic`, where there is none."""
    why: str | None = None
    for left_out, make in _ways(channel, schema):
        for payload in tried:
            try:
                decode = make()
                decode(payload)
            except Exception as e:  # whatever a decoder raises
                why = why or _short(e)
            else:
                if left_out:
                    topic.why.setdefault(f"the fields starting at `{left_out}` cannot be decoded ({why})")
                return decode
    topic.why.setdefault(why or "it holds no message")
    return None


def _ways(channel: Channel, schema: Schema | None) -> Iterator[tuple[str, Callable[[], Decoder]]]:
    """Decoders, as (first field left out, function that makes it): for whole messages (""), then (ROS 2) without last fields."""
    encoding = channel.message_encoding
    if encoding == "json":
        yield "", lambda: json.loads
    elif encoding == "protobuf" and schema is not None:
        yield "", lambda: message_class(schema).FromString
    else:
        yield "", lambda: _by_package(encoding, schema)
        if encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
            own_lines, *other_parts = re.split(r"(?m)^(?==+\s*$)", schema.data.decode(errors="replace"), maxsplit=1)
            lines = [line.strip() for line in own_lines.splitlines()]
            fields = [i for i, line in enumerate(lines) if line and not line.startswith("#")]
            for i in reversed(fields[1:]):
                shorter = "\n".join([*lines[:i], *other_parts])
                shortened = Schema(id=1, name=schema.name, encoding=schema.encoding, data=shorter.encode())
                yield lines[i], partial(_by_package, encoding, shortened)


def _by_package(encoding: str, schema: Schema | None) -> Decoder:
    """The decoder of a package; raises ValueError where there is none."""
    if (package := DECODERS.get(encoding)) is None:
        raise ValueError(f"messages of encoding {encoding!r} are not read")
    try:
        factory = import_module(package).DecoderFactory()
    except ImportError as e:
        raise ValueError(f"needs the package of {package.partition('.')[0]}; pip install 'softlab[import]'") from e
    decode: Decoder | None = factory.decoder_for(encoding, schema)
    if decode is None:
        raise ValueError(f"definitions of kind {schema.encoding if schema else 'none'!r} are not read")
    return (lambda data: decode(_plain_cdr(data))) if encoding == "cdr" else decode


def _plain_cdr(data: bytes) -> bytes:
    """A message in CDR, unpacked where its recorder packed each message; raises ValueError for any other."""
    if data.startswith(ZSTD):
        data = zstandard.ZstdDecompressor().stream_reader(data).read(MOST_UNPACKED + 1)
        if len(data) > MOST_UNPACKED:
            raise ValueError(f"a packed message is larger than {MOST_UNPACKED >> 20} MiB")
    if data[:2] not in PLAIN_CDR:
        raise ValueError(f"a message begins with {data[:2].hex()}, which is not plain CDR")
    return data


def _short(error: Exception) -> str:
    """One line of an error."""
    words = " ".join(str(error).split()) or type(error).__name__
    return words[:MOST_SAID] + (" .." if len(words) > MOST_SAID else "")


def _numbers(name: str, message: Any) -> Iterator[tuple[str, float]]:
    """Numbers of a message by the path of their fields; what is no number is left out."""
    for path, value in leaves(name, message):
        with suppress(OverflowError, ValueError, TypeError):
            yield path, number(value) if isinstance(value, str) else float(value)
