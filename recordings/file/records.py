"""The records of an MCAP file, in its order: one tolerant walk, of which everything that reads files is a fold.

    contents = Contents(name, len(data))
    for item in records(data, contents, unpack=True): ...       Record, Messages or Hole

Layout: https://mcap.dev/spec. Nothing that a file says of lengths is believed before it is held against the bytes that
are there. A record may be longer than its fields need, and of a kind that is not known: both are legal. What makes no
sense is a `Hole`; the walk goes on behind it.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from mcap.opcode import Opcode

from ..errors import Damaged, NotARecording, Oversized, RecordingError
from .budget import ReadingBudget
from .chunks import HEAD, UNPARSABLE, Chunk, McapRecord, Messages, scan, unpacked
from .contents import PASSED, Contents, let_go

MAGIC = b"\x89MCAP0\r\n"
LAYOUT: dict[int, tuple[int, ...]] = {
    Opcode.HEADER: (-4, -4), Opcode.FOOTER: (20,), Opcode.SCHEMA: (2, -4, -4, -4), Opcode.CHANNEL: (4, -4, -4, -4),
    Opcode.MESSAGE: (22,), Opcode.CHUNK: (28, -4, -8), Opcode.MESSAGE_INDEX: (2, -4), Opcode.CHUNK_INDEX: (32, -4, 8, -4, 16),
    Opcode.ATTACHMENT: (16, -4, -4, -8, 4), Opcode.ATTACHMENT_INDEX: (40, -4, -4), Opcode.STATISTICS: (42, -4),
    Opcode.METADATA: (-4, -4), Opcode.METADATA_INDEX: (16, -4), Opcode.SUMMARY_OFFSET: (17,), Opcode.DATA_END: (4,),
}  # fmt: skip
"""Fields of each kind: bytes of fixed fields, or -4 and -8 for bytes counted by a number of this many bytes in front of them."""
PLAUSIBLE = 2**32
"""Bytes that a record may claim beyond the end of a file that was cut off."""
UNPACKERS = min(4, os.cpu_count() or 1)
"""Threads that unpack chunks."""
BATCH = 4 * 2**20
"""Bytes unpacked at a time; small enough for the allocator to use the same memory again."""
_BEGIN = re.compile(rb"(?=[\x01-\x0f][\x00-\xff]{4}\x00{4})")
"""Where kind and length of a record below 4 GiB may stand."""
_LENGTHS = {4: struct.Struct("<I"), 8: struct.Struct("<Q")}


@dataclass(frozen=True)
class Hole:
    """Bytes of the file that are no record, and why. `torn`: a chunk that goes beyond the end of the file."""

    start: int
    end: int
    error: RecordingError
    torn: Chunk | None = None


def index(data: memoryview, name: str) -> Contents:
    """Contents of a whole file, without looking into chunks; raises `NotARecording`, `Damaged` or `Oversized`.

    The end may be missing, see `Contents.finished`.
    """
    contents = Contents(name, len(data))
    for hole in holes(data, contents):
        if hole.start < contents.end:  # else it is the end that is missing, or follows the end mark
            raise hole.error
    if not contents.finished and contents.chunks:
        # Some of its indexes may be cut off; without any, its records are walked over instead.
        contents.chunks[-1].channels.clear()
    return contents


def holes(data: memoryview, contents: Contents, *, unpack: bool = False) -> list[Hole]:
    """The holes of a file, of which `contents` takes note; raises `NotARecording` or `Oversized`."""
    gaps: list[Hole] = []
    for item in records(data, contents, unpack=unpack):
        if isinstance(item, Hole):
            if isinstance(item.error, Oversized):
                raise item.error
            gaps.append(item)
    return gaps


def records(
    data: memoryview, contents: Contents, *, unpack: bool = False, growing: bool = False
) -> Iterator[McapRecord | Messages | Hole]:
    """Every record of a file in its order, starting at `contents.end`, with a hole for what is none; `contents` takes note
    of each. Raises `NotARecording` for a file that is not an MCAP file.

    `data`: the file from byte `contents.end` on. `unpack`: each chunk is followed by the messages in it, and those outside
    chunks come together; else there are none. `growing`: the last record may still be on its way.
    """
    base = contents.end
    offset = 0 if base else len(MAGIC)
    if not base and data[:offset] != MAGIC:
        if growing and len(data) < offset:
            return
        raise NotARecording(f"{contents.name} is not an MCAP file: it begins with {bytes(data[:offset])!r}")
    if growing:
        contents.end = base + offset
    run: Chunk | None = None
    """Messages outside chunks, while more may follow."""
    passed = 0
    while offset < len(data) and not contents.finished:
        if offset - passed > PASSED:
            passed = offset
            let_go(data, passed)
        record: McapRecord | None
        hole: Hole | None = None
        try:
            record = record_at(data, offset, base)
            if growing and record.opcode == Opcode.FOOTER and len(data) - record.end < len(MAGIC):
                break  # the end mark is still on its way
            contents.take(record)
        except (*UNPARSABLE, RecordingError) as error:
            if growing and _unfinished(data, offset):
                break
            hole, record = _hole(data, offset, base, error, contents)
        if run and (record is None or record.opcode != Opcode.MESSAGE or run is not contents.chunks[-1]):  # it has ended
            yield from inside(data, run, contents)
            run = None
        if hole is not None:
            contents.indexed = None
            if unpack and hole.torn is not None:  # the messages that a cut-off chunk still gives
                yield from (item for item in inside(data, hole.torn, contents) if isinstance(item, Messages))
            yield hole
            offset = hole.end - base
        if record is None:
            continue
        offset = record.end
        contents.end = base + offset
        if record.opcode == Opcode.FOOTER and data[offset : offset + len(MAGIC)] == MAGIC:
            contents.finished, contents.end = True, contents.end + len(MAGIC)
        if record.opcode == Opcode.MESSAGE:
            run = contents.chunks[-1] if unpack else None
            continue
        yield record
        if unpack and record.opcode == Opcode.CHUNK:
            yield from inside(data, contents.chunks[-1], contents)
    if run is not None:
        yield from inside(data, run, contents)
    if contents.finished and not growing and contents.end < len(data):
        yield Hole(contents.end, len(data), Damaged(f"{len(data) - contents.end} bytes follow the end mark"))


def inside(data: memoryview, chunk: Chunk, contents: Contents) -> Iterator[Messages | Hole]:
    """The messages of a chunk, with a hole where it does not hold what was written; `contents` takes note of definitions."""
    try:
        raw = unpacked(data, chunk, contents.budget)
    except RecordingError as problem:
        yield Hole(chunk.start, chunk.end, problem)
        return
    starts, other_records, error = scan(raw, contents.budget)
    faults: list[tuple[int, Exception]] = [] if error is None else [(len(raw), error)]
    messages = Messages.at(raw, np.array(starts, np.int64), chunk)
    if (short := messages.sizes < 0).any():
        faults += [(offset, struct.error("a message shorter than its head")) for offset in messages.starts[short].tolist()]
        messages = messages.which(~short)
    for offset in other_records:
        opcode, length = HEAD.unpack_from(raw, offset)
        try:
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                contents.define(McapRecord(opcode, offset, offset + HEAD.size, offset + HEAD.size + length, raw))
            elif opcode in LAYOUT:
                raise struct.error(f"it holds a record of kind {opcode}, which stands outside chunks only")
        except (*UNPARSABLE, Damaged) as problem:
            faults.append((offset, problem))
        except Oversized as problem:
            faults = [*(earlier for earlier in faults if earlier[0] < offset), (offset, problem)]
            messages = messages.which(messages.starts < offset)
            break
    begin = 0
    for offset, reason in sorted(faults, key=itemgetter(0)):  # a hole stands between the messages before and behind it
        end = int(np.searchsorted(messages.starts, offset))
        if end > begin:
            yield messages.which(slice(begin, end))
        yield Hole(chunk.start, chunk.end, _named(reason, f"{contents.name}: the chunk at byte {chunk.start}", "recover"))
        begin = end
    yield messages.which(slice(begin, None))


def _named(error: Exception, place: str, remedy: str) -> RecordingError:
    """The error of a place that makes no sense."""
    if isinstance(error, RecordingError):
        return error
    return Damaged(f"{place} cannot be parsed ({str(error) or 'a field goes beyond its end'}); run `lab {remedy}`")


def gathered(data: memoryview, contents: Contents) -> Iterator[tuple[Messages, int | None]]:
    """All messages of a file, many chunks at a time, and the log time (ns) before which chunks that follow state no message, None
    for the end; raises `Damaged`, `Oversized`.

    Chunks come in the order of their first messages. They are unpacked by threads, one batch ahead of what is handed out.
    """
    budget, chunks = ReadingBudget(contents.name, len(data)), contents.chunks
    firsts, sizes = (np.fromiter((getattr(c, name) for c in chunks), np.uint64, len(chunks)) for name in ("first_time", "size"))
    order = np.argsort(firsts, kind="stable")
    edges = np.flatnonzero(np.diff(np.cumsum(sizes[order]) // np.uint64(BATCH))) + 1
    with ThreadPoolExecutor(UNPACKERS, "unpack") as pool:
        pending: list[tuple[list[Chunk], list[Future[bytes]]]] = []
        for numbers in [*np.split(order, edges), None] if len(order) else []:
            if numbers is not None:
                batch = [chunks[number] for number in numbers.tolist()]
                pending.append((batch, [pool.submit(unpacked, data, chunk, budget) for chunk in batch]))
            if len(pending) > 1 or numbers is None:
                batch, raws = pending.pop(0)
                messages = _joined(batch, [raw.result() for raw in raws], budget)
                let_go(data, min(chunk.start for chunk in batch))
                yield messages, pending[0][0][0].first_time if pending else None


def _joined(batch: list[Chunk], raws: list[bytes], budget: ReadingBudget) -> Messages:
    """The messages of chunks, whose unpacked bytes are `raws`; raises `Damaged`."""
    starts, base = [], 0
    for chunk, raw in zip(batch, raws, strict=True):
        messages, _, error = scan(raw, budget)
        if error is not None:
            raise _named(error, f"{budget.name}: the chunk at byte {chunk.start}", "recover")
        starts.append(np.array(messages, np.int64) + base)
        base += len(raw)
    joined = Messages.at(b"".join(raws), np.concatenate(starts), batch[0])
    if (joined.sizes < 0).any():
        raise Damaged(f"{budget.name}: a message is shorter than its head; run `lab recover` to leave it out")
    return joined


def record_at(data: memoryview, at: int, base: int = 0, search: bool = True) -> McapRecord:
    """The record that begins at data[at], byte base + at of the file; raises what `UNPARSABLE` lists when it makes no sense.

    Where nothing makes sense behind it, its length is wrong if records are found in it (`search`).
    """
    opcode, length = HEAD.unpack_from(data, at)
    body = at + HEAD.size
    end = body + length
    if opcode == 0 or end > len(data):
        raise struct.error("no complete record")
    used = _used(data, opcode, body)
    if used > end:
        raise struct.error("its fields are longer than the record")
    if used < end and not _plausible(data, end) and not (search and _next(data, at + 1, end) == end):
        raise struct.error("no record follows where it ends")
    return McapRecord(opcode, base + at, body, end, data)


def _used(data: memoryview | bytes, opcode: int, body: int) -> int:
    """Where the fields of a record end."""
    at = body
    for size in LAYOUT.get(opcode, ()):
        if size < 0:
            size = -size + _LENGTHS[-size].unpack_from(data, at)[0]
        at += size
    return at


def _plausible(data: memoryview, at: int) -> bool:
    """Whether a record may begin here, or nothing comes any more, or only zeros do."""
    rest = len(data) - at - HEAD.size
    if rest < 0:
        return True
    opcode, length = HEAD.unpack_from(data, at)
    if opcode == 0:
        # this many zeros behind a record are taken for the end of what was written
        return not (length or any(data[at : at + 4096]))
    return bool(length <= rest or (opcode in LAYOUT and length < PLAUSIBLE))


def _begins(data: memoryview, at: int) -> bool:
    """Whether a chain of known records begins here, or the last ones of the file."""
    try:
        for _ in range(3):
            record = record_at(data, at, search=False)
            if record.opcode not in LAYOUT:
                return False
            at = record.end
            if record.opcode == Opcode.FOOTER or at == len(data):
                return True
    except UNPARSABLE:
        return False
    return True


def _next(data: memoryview, at: int, end: int) -> int:
    """Where a chain of records begins between two bytes; `end` where none does."""
    found = (m.start() for m in _BEGIN.finditer(data, at, min(end + HEAD.size, len(data))))
    return next((start for start in found if start < end and _begins(data, start)), end)


def _unfinished(data: memoryview, at: int) -> bool:
    """Whether the record here, or the one behind it, is not all there yet."""
    if len(data) - at < HEAD.size:
        return True
    opcode, length = HEAD.unpack_from(data, at)
    return bool(opcode == 0 or length > len(data) - at - HEAD.size)


def _hole(data: memoryview, at: int, base: int, error: Exception, contents: Contents) -> tuple[Hole, McapRecord | None]:
    """The hole that begins at data[at] (byte base + at) up to where the walk goes on, and the record there if its stated length
    alone is wrong."""
    error = _named(error, f"{contents.name}: the record at byte {base + at}", "verify")
    end, chunk, record = len(data), None, None
    try:
        opcode, length = HEAD.unpack_from(data, at)
        stated, used = at + HEAD.size + length, _used(data, opcode, at + HEAD.size)
    except UNPARSABLE:
        opcode, stated, used = 0, 0, 0
    known_kind = opcode in LAYOUT and opcode != Opcode.MESSAGE
    if known_kind and stated == used > len(data):  # the file ends within it
        if opcode == Opcode.CHUNK:
            with contextlib.suppress(*UNPARSABLE):
                chunk = Chunk.of(McapRecord(opcode, base + at, at + HEAD.size, stated, data))
    elif known_kind and stated != used and _begins(data, used):  # a record follows its fields: its length is wrong
        end = at + HEAD.size
        record = McapRecord(opcode, base + at, end, used, data)
        try:
            contents.take(record)
        except (*UNPARSABLE, RecordingError):
            end, record = used, None
    elif opcode and stated <= len(data) and (stated == len(data) or _begins(data, stated)):
        end = stated  # a record follows its stated end: its fields are wrong
    else:
        end = _next(data, at + 1, len(data))
    return Hole(base + at, base + end, error, chunk), record
