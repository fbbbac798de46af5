"""The records of an MCAP file, in its order: one tolerant walk, of which everything that reads files is a fold.

    contents = Contents(name, len(data))
    for item in records(data, contents): ...          Record or Hole

Layout: https://mcap.dev/spec. Nothing that a file says of lengths is believed before it is held against the bytes that
are there. A record may be longer than its fields need, and of a kind that is not known: both are legal. What makes no
sense is a `Hole`; the walk goes on behind it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator

from mcap.opcode import Opcode

from ..errors import Damaged, NotARecording, Oversized, RecordingError
from .chunks import HEAD, MESSAGE, Chunk, Record, chunk_of, decompress, records_in, torn_bytes
from .contents import UNPARSABLE, Contents, Hole

MAGIC = b"\x89MCAP0\r\n"
LAYOUT: dict[int, tuple[int, ...]] = {
    Opcode.HEADER: (-4, -4), Opcode.FOOTER: (20,), Opcode.SCHEMA: (2, -4, -4, -4), Opcode.CHANNEL: (4, -4, -4, -4),
    Opcode.MESSAGE: (22,), Opcode.CHUNK: (28, -4, -8), Opcode.MESSAGE_INDEX: (2, -4), Opcode.CHUNK_INDEX: (32, -4, 8, -4, 16),
    Opcode.ATTACHMENT: (16, -4, -4, -8, 4), Opcode.ATTACHMENT_INDEX: (40, -4, -4), Opcode.STATISTICS: (42, -4),
    Opcode.METADATA: (-4, -4), Opcode.METADATA_INDEX: (16, -4), Opcode.SUMMARY_OFFSET: (17,), Opcode.DATA_END: (4,),
}  # fmt: skip
"""Fields of each kind: bytes of fixed fields, or -4 and -8 for bytes counted by a number of so many bytes in front of them."""
CHAIN = 3
"""Records that must follow each other where the walk goes on behind a hole."""
PLAUSIBLE = 2**32
"""Bytes that a record may claim beyond the end of a file that was cut off."""
ZEROS = 4096
"""Bytes of zeros behind a record that are taken for the end of what was written."""
_BEGIN = re.compile(rb"(?=[\x01-\x0f][\x00-\xff]{4}\x00{4})")
"""Where kind and length of a record below 4 GiB may stand."""
_LENGTHS = {4: struct.Struct("<I"), 8: struct.Struct("<Q")}


def demand_mcap(data: memoryview, name: str) -> None:
    """Raises `NotARecording` when a file does not begin as an MCAP file."""
    if bytes(data[: len(MAGIC)]) != MAGIC:
        raise NotARecording(f"{name} is not an MCAP file: it begins with {bytes(data[:8])!r}")


def index(data: memoryview, name: str) -> Contents:
    """Contents of a whole file, without looking into chunks; raises `NotARecording`, `Damaged` or `Oversized`.

    The end may be missing, see `Contents.finished`.
    """
    demand_mcap(data, name)
    contents = Contents(name, len(data))
    for item in records(data, contents):
        # What is behind the last record is the end that is missing, or follows the end mark.
        if isinstance(item, Hole) and isinstance(item.error, Oversized):
            raise item.error
    for hole in contents.holes:
        if hole.start < contents.end:
            raise hole.error
    if not contents.finished and contents.chunks:
        # Some of its indexes may be cut off; without any, its records are walked over instead.
        contents.chunks[-1].indexes.clear()
    return contents


def records(
    data: memoryview, contents: Contents, *, unpack: bool = False, growing: bool = False
) -> Iterator[Record | Hole]:
    """Every record of a file in its order, with a hole for whatever is none; `contents` takes note of each.

    `unpack`: each chunk is followed by the records in it. `growing`: the last record may still be on its way.
    """
    at = 0 if contents.base else len(MAGIC)
    while at < len(data) and not contents.finished:
        try:
            record = _record_at(data, at)
            if growing and record.opcode == Opcode.FOOTER and len(data) - record.end < len(MAGIC):
                return
            contents.take(record)
        except (*UNPARSABLE, RecordingError) as error:
            if growing and _unfinished(data, at):
                return
            hole, rest = _hole(data, at, error, contents)
            contents.note(hole)
            if unpack and hole.torn is not None:
                for item in _unpacked(torn_bytes(data, hole.torn, contents.budget), hole.torn, contents):
                    if isinstance(item, Record):
                        yield item
            yield hole
            at = hole.end - contents.base
            if rest is None:
                continue
            record = rest
        at = record.end
        contents.end = contents.base + at
        if record.opcode == Opcode.FOOTER and data[at : at + len(MAGIC)] == MAGIC:
            contents.finished, contents.end = True, contents.end + len(MAGIC)
        yield record
        if unpack and record.opcode == Opcode.CHUNK:
            yield from inside(data, contents.chunks[-1], contents)
    if contents.finished and not growing and contents.end < len(data):
        behind = Damaged(f"{len(data) - contents.end} bytes follow the end mark")
        contents.note(Hole(contents.end, len(data), behind))
        yield contents.holes[-1]


def inside(data: memoryview, chunk: Chunk, contents: Contents) -> Iterator[Record | Hole]:
    """The records of a chunk, or a hole where it does not hold what was written."""
    try:
        raw = decompress(data, chunk, contents.budget)
    except RecordingError as error:
        yield Hole(chunk.start, chunk.end, error)
        return
    yield from _unpacked(raw, chunk, contents)


def _unpacked(raw: bytes, chunk: Chunk, contents: Contents) -> Iterator[Record | Hole]:
    def hole(error: Exception) -> Hole:
        if not isinstance(error, RecordingError):
            why = str(error) or "a field goes beyond the end of its record"
            text = f"{contents.name}: the chunk at byte {chunk.start} cannot be parsed ({why}); run `lab recover`"
            error = Damaged(text)
        return Hole(chunk.start, chunk.end, error)

    try:
        for record in records_in(raw, contents.budget):
            if record.opcode == Opcode.MESSAGE:
                if record.end - record.body < MESSAGE.size:
                    yield hole(struct.error("a message shorter than its head"))
                    continue
            elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                try:
                    contents.define(record)
                except (*UNPARSABLE, Damaged) as error:
                    yield hole(error)
                    continue
            elif record.opcode in LAYOUT:
                yield hole(struct.error(f"it holds a record of kind {record.opcode}, which stands outside chunks only"))
                continue
            yield record
    except (struct.error, RecordingError) as error:
        yield hole(error)


def _record_at(data: memoryview, at: int, search: bool = True) -> Record:
    """The record that begins at a byte; raises what `UNPARSABLE` lists when it does not make sense.

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
    return Record(opcode, at, body, end, data)


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
    left = len(data) - at - HEAD.size
    if left < 0:
        return True
    opcode, length = HEAD.unpack_from(data, at)
    if opcode == 0:
        return not (length or any(data[at : at + ZEROS]))
    return bool(length <= left or (opcode in LAYOUT and length < PLAUSIBLE))


def _begins(data: memoryview, at: int, chain: int = CHAIN) -> bool:
    """Whether a chain of known records begins here, or the last ones of the file."""
    try:
        for _ in range(chain):
            record = _record_at(data, at, search=False)
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


def _hole(data: memoryview, at: int, error: Exception, contents: Contents) -> tuple[Hole, Record | None]:
    """What is wrong at a byte up to where the walk goes on, and a record whose stated length alone is wrong."""
    base = contents.base
    if not isinstance(error, RecordingError):
        why = str(error) or "a field goes beyond its end"
        text = f"{contents.name}: the record at byte {base + at} cannot be parsed ({why}); run `lab verify`"
        error = Damaged(text)
    end, torn, record = len(data), None, None
    try:
        opcode, length = HEAD.unpack_from(data, at)
        stated, used = at + HEAD.size + length, _used(data, opcode, at + HEAD.size)
    except UNPARSABLE:
        opcode, stated, used = 0, 0, 0
    if opcode in LAYOUT and opcode != Opcode.MESSAGE and stated == used > len(data):
        if opcode == Opcode.CHUNK:
            torn = _chunk_or_none(data, at, stated, base)
    elif opcode in LAYOUT and opcode != Opcode.MESSAGE and stated != used and _begins(data, used):
        end = at + HEAD.size
        record = Record(opcode, at, end, used, data)
        try:
            contents.take(record)
        except (*UNPARSABLE, RecordingError):
            end, record = used, None
    elif opcode and stated <= len(data) and (stated == len(data) or _begins(data, stated)):
        end = stated
    else:
        end = _next(data, at + 1, len(data))
    return Hole(base + at, base + end, error, torn), record


def _chunk_or_none(data: memoryview, start: int, end: int, base: int) -> Chunk | None:
    try:
        return chunk_of(data, start, end, base)
    except UNPARSABLE:
        return None
