"""A whole file out of a damaged or torn one: every message that can be read, indexed anew, and a report of what is missing.

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
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer

from ..errors import Oversized, RecordingError, WriteFailed
from ..json_text import Plain
from ..messages import is_stream
from ..own_files import replacing
from .chunks import McapRecord
from .contents import Contents, mapped
from .counts import Pace, StreamCounts, counted
from .records import Hole, records
from .samples import ours
from .verify import check

OWN = ("counts", "outcome", "recovery")
"""Metadata that are written anew."""
RECOVERED = "-recovered.mcap"
"""End of the name of a recovered file, in place of the source's suffix."""


@dataclass(frozen=True)
class Recovery(Plain):
    """What was kept and what is lost."""

    source: str
    target: str
    finished: bool
    """The source had its end: nothing beyond what it holds was ever written."""
    library: str
    """What wrote the source."""
    messages: dict[str, int]
    """Kept, by topic."""
    lost: dict[str, int]
    """Known to be missing by the messages' numbers, by topic; topics that miss none are left out."""
    nameless: int
    """Messages left out because nothing in the file describes their topic any more."""
    schemaless: tuple[str, ...]
    """Topics whose schema is missing in the file; their messages are kept without one."""
    seconds_kept: float
    seconds_lost: float
    """Rig seconds between the messages before and behind each hole, and to the end that a torn chunk states."""
    bytes_skipped: int
    holes: int
    oversized: str
    """Why parts were left out that claim more than the limits allow; empty: none were."""

    @property
    def complete(self) -> bool:
        """Nothing was lost: the source was finished and every record of it could be read."""
        return self.finished and not (self.holes or self.lost or self.nameless or self.schemaless)


@dataclass
class _KeptChannel:
    """One channel's messages on their way into the new file. `numbered`: their numbers count what there was; `schemaless`:
    the schema that the channel names is missing."""

    topic: str
    channel: int
    numbered: bool
    schemaless: bool
    numbers: array[int] = field(default_factory=lambda: array("q"))
    log_times: array[int] = field(default_factory=lambda: array("Q"))

    @property
    def generated(self) -> int:
        """Messages there were before the last one that is kept, by their numbers.

        In the order of time: numbers that go back are a stream that began anew, and both its parts count.
        """
        if not self.numbers or not self.numbered:
            return len(self.numbers)
        if not is_stream(self.topic):  # events may be recorded later than they happened
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
    target = source.with_name(source.stem + RECOVERED) if target is None else Path(target)
    data = mapped(source)
    contents = Contents(str(source), len(data))
    for _ in records(data, contents, unpack=True):
        pass  # what describes the messages may stand behind them
    if target.exists():
        raise WriteFailed(f"{target} exists; recordings are never overwritten, choose another name with --out")
    try:
        with replacing(target) as (file, partial):
            result = _write(data, contents, target, file)
            file.flush()
            if problems := check(partial).problems:
                raise RecordingError(f"{target}: the recovered file is wrong: {problems[0].text}; the source is untouched")
    except OSError as error:
        raise WriteFailed(f"{target} cannot be written: {error.strerror}") from error
    return result


def _write(data: memoryview, contents: Contents, target: Path, file: Any) -> Recovery:
    """Write all that `contents` describes, in the order of the file; the record `recovery` states what is missing."""
    writer = Writer(file, compression=CompressionType.ZSTD, enable_data_crcs=True)
    header = contents.header
    writer.start("" if header is None else header.profile, "" if header is None else header.library)
    kept = _register(writer, contents)
    holes: list[Hole] = []
    nameless, seconds_lost, first, newest = 0, 0.0, math.inf, -math.inf
    gap_start: float | None = None
    """Newest log time when a hole began, while no message has come behind it."""
    for item in records(data, Contents(contents.name, contents.size), unpack=True):
        if isinstance(item, McapRecord):
            if item.opcode == Opcode.ATTACHMENT:
                a = item.read(Attachment)
                writer.add_attachment(a.create_time, a.log_time, a.name, a.media_type, a.data)
            elif item.opcode == Opcode.METADATA and (texts := item.read(Metadata)).name not in OWN:
                writer.add_metadata(texts.name, texts.metadata)
        elif isinstance(item, Hole):
            holes.append(item)
            gap_start = newest if gap_start is None else gap_start
            if item.torn is not None and math.isfinite(newest):
                seconds_lost += max(0.0, (item.torn.last_time - newest) / 1e9)
        else:
            for head, payload in zip(item.heads.tolist(), item.payloads(), strict=True):
                _, _, number, sequence, log_time, publish_time = head
                entry = kept.get(number)
                if entry is None:
                    nameless += 1
                    continue
                entry.numbers.append(sequence)
                entry.log_times.append(log_time)
                writer.add_message(entry.channel, log_time, payload, publish_time, sequence)
                if gap_start is not None and math.isfinite(gap_start):
                    seconds_lost += max(0.0, (log_time - gap_start) / 1e9)
                gap_start, first, newest = None, min(first, log_time), max(newest, log_time)
    topics: dict[str, list[_KeptChannel]] = {}
    for entry in kept.values():
        topics.setdefault(entry.topic, []).append(entry)
    counts = _counts(topics, contents)
    result = Recovery(
        source=contents.name, target=str(target), finished=contents.finished, library="" if header is None else header.library,
        messages={topic: sum(len(entry.numbers) for entry in entries) for topic, entries in topics.items()},
        lost={topic: c.dropped + c.lost for topic, c in counts.items() if not c.complete}, nameless=nameless,
        schemaless=tuple(sorted({entry.topic for entry in kept.values() if entry.schemaless})),
        seconds_kept=max(0.0, (newest - first) / 1e9) if math.isfinite(newest) else 0.0, seconds_lost=seconds_lost,
        bytes_skipped=sum(hole.end - hole.start for hole in holes), holes=len(holes),
        oversized=next((str(hole.error) for hole in holes if isinstance(hole.error, Oversized)), ""),
    )  # fmt: skip
    if counts:
        writer.add_metadata("counts", {topic: json.dumps(asdict(c)) for topic, c in counts.items()})
    writer.add_metadata("recovery", {name: json.dumps(value) for name, value in result.to_dict().items()})
    if "outcome" in contents.metadata:
        writer.add_metadata("outcome", contents.metadata["outcome"])
    elif not contents.finished:
        detail = f"recovered, {seconds_lost:.3f} s lost"
        writer.add_metadata("outcome", {"outcome": "abrupt", "detail": detail, "closed_wall_ns": ""})
    writer.finish()
    return result


def _register(writer: Writer, contents: Contents) -> dict[int, _KeptChannel]:
    """Schemas and channels of the new file, by the channel numbers of the old one."""
    registered = ((number, writer.register_schema(s.name, s.encoding, s.data)) for number, s in sorted(contents.schemas.items()))
    schemas = {0: 0, **dict(registered)}
    kept = {}
    for number, c in sorted(contents.channels.items()):
        new_number = writer.register_channel(c.topic, c.message_encoding, schemas.get(c.schema_id, 0), c.metadata)
        numbered = ours(c, contents.schemas.get(c.schema_id))
        kept[number] = _KeptChannel(c.topic, new_number, numbered, c.schema_id not in schemas)
    return kept


def _counts(topics: dict[str, list[_KeptChannel]], contents: Contents) -> dict[str, StreamCounts]:
    """Counts of the new file by the messages' numbers; topics without numbers have none unless the source states them."""
    first = min((min(entry.log_times) for entries in topics.values() for entry in entries if entry.log_times), default=0)
    out, stated_counts = {}, counted(contents.metadata)
    for topic, entries in topics.items():
        stated, count = stated_counts.get(topic, {}), sum(len(entry.numbers) for entry in entries)
        if not (stated or any(entry.numbered for entry in entries)):
            continue
        generated = max(sum(max(entry.generated, len(entry.numbers)) for entry in entries), stated.get("generated", 0))
        times = np.sort(np.concatenate([np.array(entry.log_times, dtype=np.uint64) for entry in entries]))
        out[topic] = StreamCounts.of(generated, count, stated.get("lost", 0), Pace.of(times).timing(first))
    return out
