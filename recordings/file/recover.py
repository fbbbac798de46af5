"""A whole file out of a damaged or torn one: every message that can be read, indexed anew, and what is missing told.

The source is never touched. The new file appears under its name only when it is complete and verified.
"""

from __future__ import annotations

import json
import math
import os
from array import array
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from ..errors import NotARecording, RecordingError, WriteFailed
from ..messages import is_stream
from ..own_files import replacing
from .container import MAGIC
from .counts import StreamCounts, counted
from .reader import mapped
from .scan import Message, Scan, messages, scan
from .timing import timing
from .verify import verify


@dataclass(frozen=True)
class Recovery:
    """What was kept and what is lost."""

    source: str
    target: str
    finished: bool
    """The source had its end: nothing beyond what it holds was ever written."""
    messages: dict[str, int]
    """Kept, by topic."""
    lost: dict[str, int]
    """Known to be missing by the messages' numbers, by topic; topics that miss none are left out."""
    nameless: int
    """Messages left out because nothing in the file describes their topic any more, or their time makes no sense."""
    seconds_kept: float
    seconds_lost: float
    """Rig seconds between the messages before and behind each hole, and to the end that a torn chunk tells."""
    bytes_skipped: int
    holes: int

    @property
    def complete(self) -> bool:
        """Nothing was lost: the source was finished and every record of it could be read."""
        return self.finished and not (self.holes or self.lost or self.nameless)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "complete": self.complete}


@dataclass
class _Kept:
    """One topic's messages on their way into the new file."""

    topic: str
    channel: int
    count: int = 0
    numbers: array[int] = field(default_factory=lambda: array("q"))
    log_times: array[int] = field(default_factory=lambda: array("q"))

    def add(self, message: Message) -> None:
        self.count += 1
        self.numbers.append(message.sequence)
        self.log_times.append(message.log_time)

    @property
    def generated(self) -> int:
        """Messages there were before the last one that is kept, by their numbers.

        In the order of time: numbers that go back are a stream that began anew, and both its parts count.
        """
        if not self.numbers:
            return 0
        if not is_stream(self.topic):  # events may be told later than they happened
            return max(self.numbers)
        numbers = np.array(self.numbers)[np.lexsort((self.numbers, self.log_times))]
        ends = np.append(np.flatnonzero(np.diff(numbers) < 0), len(numbers) - 1)
        return int(numbers[ends].sum())


def recover(source: str | os.PathLike[str], target: str | os.PathLike[str] | None = None) -> Recovery:
    """Write what can be read of `source` to `target` (`<name>-recovered.mcap` beside it when None).

    Raises `NotARecording`, or `WriteFailed` when the target exists or cannot be written.

    >>> cut = Path("cut.mcap")
    >>> _ = cut.write_bytes(Path("run.mcap").read_bytes()[:-1000])
    >>> recover(cut).target
    'cut-recovered.mcap'
    """
    source = Path(source)
    target = source.with_name(f"{source.stem}-recovered.mcap") if target is None else Path(target)
    data = mapped(source)
    if bytes(data[: len(MAGIC)]) != MAGIC:
        raise NotARecording(f"{source} is not an MCAP file: it begins with {bytes(data[:8])!r}")
    if target.exists():
        raise WriteFailed(f"{target} exists; recordings are never overwritten, choose another name with --out")
    found = scan(data, str(source))
    try:
        with replacing(target) as (file, partial):
            result = _write(data, found, source, target, file)
            file.flush()
            problems = verify(partial).problems
            if problems:
                raise RecordingError(
                    f"{target}: the recovered file is wrong: {problems[0].text}; the source is untouched"
                )
    except OSError as error:
        raise WriteFailed(f"{target} cannot be written: {error.strerror}") from error
    return result


def _write(data: memoryview, found: Scan, source: Path, target: Path, file: Any) -> Recovery:
    """Everything found, in the order of the file; the record `recovery` tells what is missing."""
    writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(library=found.library)
    for name, texts in found.metadata.items():
        if name not in ("counts", "outcome"):
            writer.add_metadata(name, texts)
    for attachment in found.attachments.values():
        writer.add_attachment(
            attachment.create_time, attachment.log_time, attachment.name, attachment.media_type, attachment.data
        )
    kept = _register(writer, found)
    nameless, seconds_lost, first, newest = 0, 0.0, math.inf, -math.inf
    holes = {hole.behind: hole for hole in found.holes}
    for number, chunk in enumerate(found.chunks):
        before = newest
        earliest = math.inf
        for message in messages(data, chunk, str(source)):
            entry = kept.get(message.channel)
            if entry is None or message.log_time >= 2**63:
                nameless += 1
                continue
            entry.add(message)
            writer.add_message(entry.channel, message.log_time, message.data, message.publish_time, message.sequence)
            earliest, newest = min(earliest, message.log_time), max(newest, message.log_time)
        first = min(first, earliest)
        if number in holes and math.isfinite(before) and math.isfinite(earliest):
            seconds_lost += max(0.0, (earliest - before) / 1e9)
    last = holes.get(len(found.chunks))
    if last is not None and last.until is not None and math.isfinite(newest):
        seconds_lost += max(0.0, (last.until - newest) / 1e9)
    counts = _counts(kept, found)
    result = Recovery(
        source=str(source),
        target=str(target),
        finished=found.finished,
        messages={entry.topic: entry.count for entry in kept.values()},
        lost={topic: c.dropped + c.lost for topic, c in counts.items() if not c.complete},
        nameless=nameless,
        seconds_kept=max(0.0, (newest - first) / 1e9) if math.isfinite(newest) else 0.0,
        seconds_lost=seconds_lost,
        bytes_skipped=sum(hole.end - hole.start for hole in found.holes),
        holes=len(found.holes),
    )
    outcome = {"outcome": "abrupt", "detail": f"recovered, {seconds_lost:.3f} s lost", "closed_wall_ns": ""}
    writer.add_metadata("counts", {topic: json.dumps(asdict(c)) for topic, c in counts.items()})
    writer.add_metadata("recovery", {name: json.dumps(value) for name, value in result.to_dict().items()})
    writer.add_metadata("outcome", found.metadata.get("outcome", outcome))
    writer.finish()
    return result


def _register(writer: Writer, found: Scan) -> dict[int, _Kept]:
    """Schemas and channels of the new file, by the channel numbers of the old one."""
    schemas = {0: 0}
    for number, schema in sorted(found.schemas.items()):
        schemas[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
    return {
        number: _Kept(c.topic, writer.register_channel(c.topic, c.message_encoding, schemas[c.schema_id], c.metadata))
        for number, c in sorted(found.channels.items())
        if c.schema_id in schemas
    }


def _counts(kept: dict[int, _Kept], found: Scan) -> dict[str, StreamCounts]:
    """Counts of the new file: the messages' numbers tell how many there were before the last one that is kept."""
    start = min((entry.log_times[0] for entry in kept.values() if entry.log_times), default=0)
    out, before = {}, counted(found.metadata)
    for entry in kept.values():
        told = before.get(entry.topic, {})
        generated = max(entry.generated, entry.count, told.get("generated", 0))
        at = timing((np.sort(np.array(entry.log_times, dtype=np.int64)) - start) / 1e9)
        out[entry.topic] = StreamCounts.of(generated, entry.count, told.get("lost", 0), at)
    return out
