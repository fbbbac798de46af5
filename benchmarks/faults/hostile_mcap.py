"""Recordings that are changed with care: inside the chunks, with every checksum made right again.

A flipped byte is found by its checksum; what a checksum cannot find is a file that was written wrong, or made to do harm.
"""

from __future__ import annotations

import json
import random
import struct
import zlib
from collections.abc import Callable, Iterator
from itertools import takewhile

import lz4.frame
import zstandard
from google.protobuf.message import DecodeError
from mcap.opcode import Opcode

from recordings.events import STATE, TRIAL
from recordings.file.chunks import HEAD, unpacked
from recordings.file.records import MAGIC, index

Record = tuple[int, bytes]
Edit = Callable[[list[Record], random.Random], None]
MOST_BARE = 400_000
"""Bytes of a chunk that may stand unpacked: the bounds are for files below 1 MB."""
NUMBERS = (0, 1, 2**7, 2**16 - 1, 2**31, 2**32 - 1, 2**53, 2**62, 2**63, 2**64 - 1)
TEXTS = (
    "", "\0", "1e999", "9" * 5000, "[" * 100_000, "{}", "null", "-1", "0x-1", "1x1x1x1", "1000000000", "1x" * 70 + "1", "NaN",
    '"\\ud800"', "../../x", "a" * 300, '{"written": ' + "9" * 30 + "}", "\N{PILE OF POO}", "99999999999999999999", "0",
)  # fmt: skip
WORDS = {
    b"NaN": (b"0", b"1e999"), b"null": (b"[]", b"-1"), b"settled": (b"window ", b"crossing"), b"true": (b"null",),
    b'"trial"': (b'"step"', b'"m99x"', b'"p99"'), b"0.5": (b"1e9", b"-9", b"nan", b"1e308"), b"60.0": (b"1e99", b'"60"', b"0.00"),
    b"10": (b"-1", b"99999999"), b"/tip": (b"/arm", b"/log"), b"load": (b"down",), b"[": (b"{", b"[["), b"bending": (b"unknown",),
}  # fmt: skip


def split(data: bytes) -> tuple[list[Record], dict[int, list[Record]]]:
    """The records of a sound file up to its end of data, and those inside each chunk, by the chunk's place."""
    view = memoryview(data)
    contents = index(view, "sound")
    records = list(takewhile(lambda record: record[0] != Opcode.DATA_END, _parts(data[len(MAGIC) : -len(MAGIC)])))
    places = [number for number, (opcode, _) in enumerate(records) if opcode == Opcode.CHUNK]
    chunks = [chunk for chunk in contents.chunks if not chunk.bare]
    raws = (unpacked(view, chunk, contents.budget) for chunk in chunks)
    return records, {place: list(_parts(raw)) for place, raw in zip(places, raws, strict=True)}


def _parts(data: bytes) -> Iterator[Record]:
    """The records of sound bytes."""
    at = 0
    while at < len(data):
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size + length
        yield opcode, data[at - length : at]


def written(opcode: int, body: bytes, length: int | None = None) -> bytes:
    """A record; `length`: what it says instead of its true one."""
    return struct.pack("<BQ", opcode, (len(body) if length is None else length) % 2**64) + body


def mutated(data: bytes, rng: random.Random) -> bytes:
    """One to four changes anywhere, then checksums and (mostly) indexes made right."""
    records, inside = split(data)
    records = [(op, body) for op, body in records]
    for _ in range(rng.randint(1, 4)):
        if inside and rng.random() < 0.7:
            edit = rng.choice(INSIDE)
            edit(inside[rng.choice(list(inside))], rng)
        else:
            _outside(records, rng, set(inside))
    out = [MAGIC]
    stale = rng.random() < 0.2
    for number, (opcode, body) in enumerate(records):
        if number in inside:
            out.append(_chunk(inside[number], rng, stale))
        elif opcode != Opcode.MESSAGE_INDEX or stale:
            out.append(written(opcode, body))
    section = b"".join(out)
    end = written(Opcode.DATA_END, struct.pack("<I", zlib.crc32(section)))
    foot = struct.pack("<BQQQ", Opcode.FOOTER, 20, 0, 0)
    whole = section + end + foot + struct.pack("<I", zlib.crc32(foot)) + MAGIC
    return whole[: rng.randrange(len(whole))] if rng.random() < 0.15 else whole


# ------------------------------------------------------------------ inside a chunk
def _pick(inner: list[Record], rng: random.Random, opcode: int) -> int | None:
    found = [i for i, (op, _) in enumerate(inner) if op == opcode]
    return rng.choice(found) if found else None


def _payload(inner: list[Record], rng: random.Random) -> None:
    i = _pick(inner, rng, Opcode.MESSAGE)
    if i is None:
        return
    head, body = inner[i][1][:22], bytearray(inner[i][1][22:])
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(max(1, len(body)))
        match rng.randrange(4):
            case 0:
                body[at : at + 8] = struct.pack("<d", rng.choice((float("nan"), float("inf"), -1e308, 1e308, 0.0, -1.0)))
            case 1:
                body[at : at + 1] = rng.randbytes(1)
            case 2:
                del body[at : at + rng.randint(1, 40)]
            case _:
                body[at:at] = rng.randbytes(rng.randint(1, 40))
    inner[i] = (Opcode.MESSAGE, head + bytes(body))


def _said(inner: list[Record], rng: random.Random) -> None:
    """Words in the JSON of states and rows, the same in all of them; lengths of the messages kept where possible."""
    old = rng.choice(list(WORDS))
    new = rng.choice(WORDS[old])
    for i, (op, body) in enumerate(inner):
        if op == Opcode.MESSAGE and b'{"' in body:
            spaces = len(old) - len(new)
            text = new + b" " * spaces if spaces > 0 else new
            inner[i] = (op, body.replace(old, text))


def _json(inner: list[Record], rng: random.Random) -> None:
    """One state or row with a field of another kind; its length in protobuf is made right."""
    found = [i for i, (op, body) in enumerate(inner) if op == Opcode.MESSAGE and b'{"' in body]
    if not found:
        return
    i = rng.choice(found)
    head, payload = inner[i][1][:22], inner[i][1][22:]
    kind = (STATE if b'"rule"' in payload else TRIAL).message_class
    try:
        message = kind.FromString(payload)
        values = json.loads(message.json)
    except (DecodeError, ValueError):  # an earlier change has spoilt it
        return
    place = values.get("rule") if rng.random() < 0.5 else values
    if not (isinstance(place, dict) and place):
        return
    key = rng.choice(list(place))
    place[key] = rng.choice(
        (None, [], {}, "", "x", -1, 0, 1e999, 10**18, 10**400, [[[]]], [1e9] * 12, True, "\ud800", float("nan"))
    )
    if rng.random() < 0.2:
        place[rng.choice(("m99999x", "p0", "sd_sd_x", "new", "p77"))] = 1.0
    message.json = json.dumps(values)
    inner[i] = (Opcode.MESSAGE, head + message.SerializeToString())


def _head(inner: list[Record], rng: random.Random) -> None:
    i = _pick(inner, rng, Opcode.MESSAGE)
    if i is None or len(inner[i][1]) < 22:  # none, or one that an earlier change has cut off
        return
    channel, sequence, log, publish = struct.unpack("<HIQQ", inner[i][1][:22])
    match rng.randrange(3):
        case 0:
            channel = rng.choice((0, 1, 2, 3, 65535))
        case 1:
            log = rng.choice(NUMBERS)
        case _:
            sequence = rng.choice(NUMBERS) % 2**32
    inner[i] = (Opcode.MESSAGE, struct.pack("<HIQQ", channel, sequence, log, publish) + inner[i][1][22:])


def _definition(inner: list[Record], rng: random.Random) -> None:
    i = _pick(inner, rng, rng.choice((Opcode.SCHEMA, Opcode.CHANNEL)))
    if i is None:
        return
    body = bytearray(inner[i][1])
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(body))
        body[at : at + 1] = rng.choice((rng.randbytes(1), b"", b"0123456789x"[rng.randrange(11) :][:1]))
    inner[i] = (inner[i][0], bytes(body))


def _shape(inner: list[Record], rng: random.Random) -> None:
    """The shape that a channel tells, its length made right."""
    for i, (op, body) in enumerate(inner):
        at = body.find(b"shape.")
        if op != Opcode.CHANNEL or at < 0 or rng.random() < 0.5:
            continue
        key = struct.unpack_from("<I", body, at - 4)[0]
        value = at + key
        old = struct.unpack_from("<I", body, value)[0]
        text = rng.choice((*TEXTS, "0", "3", "8", "9999", "0x1000000000", "2x3", "3x3", "3x0")).encode("utf-8", "replace")
        new = body[:value] + struct.pack("<I", len(text)) + text + body[value + 4 + old :]
        topic = struct.unpack_from("<I", new, 4)[0]
        encoding = 8 + topic + 4 + struct.unpack_from("<I", new, 8 + topic)[0]
        size = struct.unpack_from("<I", new, encoding)[0] + len(text) - old
        inner[i] = (op, new[:encoding] + struct.pack("<I", size) + new[encoding + 4 :])


def _shuffle(inner: list[Record], rng: random.Random) -> None:
    a, b = rng.randrange(len(inner)), rng.randrange(len(inner))
    match rng.randrange(3):
        case 0:
            inner[a], inner[b] = inner[b], inner[a]
        case 1:
            del inner[a:b]
            if not inner:
                inner.append((Opcode.MESSAGE, bytes(22)))
        case _:
            inner[a:a] = inner[b : b + 20]


def _bomb(inner: list[Record], rng: random.Random) -> None:
    """Much that packs to nothing: the same message, empty ones, zeros, definitions of many entries."""
    i = _pick(inner, rng, Opcode.MESSAGE)
    times = rng.choice((1000, 5000, 20_000, 100_000, 200_000))
    match rng.randrange(5):
        case 0 if i is not None:
            inner += [inner[i]] * min(times, rng.choice((7, 40)) * 10**6 // (len(inner[i][1]) + 9))
        case 1:
            inner += [(Opcode.MESSAGE, struct.pack("<HIQQ", rng.randint(1, 8), 1, 1, 1))] * times
        case 2:
            inner.append((rng.choice((Opcode.MESSAGE, Opcode.SCHEMA, 0x80)), bytes(times * rng.choice((30, 200)))))
        case 3:
            entries = b"".join(struct.pack("<I", 4) + struct.pack("<I", k) + bytes(4) for k in range(times))
            topic = struct.pack("<HH", 900, 0) + struct.pack("<I", 1) + b"/" + bytes(4)
            inner.append((Opcode.CHANNEL, topic + struct.pack("<I", len(entries)) + entries))
        case _:
            inner += [
                (Opcode.CHANNEL, struct.pack("<HH", k % 65536, 0) + struct.pack("<I", 4) + b"/tip" + bytes(8))
                for k in range(times)
            ]


def _nested(inner: list[Record], rng: random.Random) -> None:
    opcode = rng.choice((*(int(op) for op in Opcode), 0, 0x80, 0xFF))
    inner.insert(rng.randrange(len(inner) + 1), (opcode, rng.choice((b"", bytes(40), rng.randbytes(60)))))


INSIDE: tuple[Edit, ...] = (
    _payload, _payload, _said, _said, _json, _json, _json, _head, _definition, _shape, _shape, _shuffle, _bomb, _nested,
)  # fmt: skip


def _chunk(inner: list[Record], rng: random.Random, stale: bool) -> bytes:
    """The chunk with its indexes, sizes and checksum right; now and then one of its numbers is wrong."""
    parts, pairs, at = [], dict[int, list[bytes]](), 0
    for opcode, body in inner:
        wrong = rng.choice(NUMBERS) if rng.random() < 0.0005 else None
        parts.append(written(opcode, body, wrong))
        if opcode == Opcode.MESSAGE and len(body) >= 22:
            channel, _, log = struct.unpack("<HIQ", body[:14])
            pairs.setdefault(channel, []).append(struct.pack("<QQ", log, at))
        at += len(parts[-1])
    raw = b"".join(parts)
    name, packed = rng.choice(
        ((b"zstd", zstandard.compress), (b"zstd", zstandard.compress), (b"lz4", lz4.frame.compress), (b"", bytes))
    )
    if len(raw) > MOST_BARE:
        name, packed = b"zstd", zstandard.compress
    size = rng.choice(NUMBERS) if rng.random() < 0.03 else len(raw)
    data = packed(raw)
    if rng.random() < 0.02:
        name = rng.choice((b"", b"lz4", b"zstd", b"bz2"))
    head = struct.pack("<QQQII", 0, 2**63, size, zlib.crc32(raw), len(name)) + name + struct.pack("<Q", len(data))
    out = [written(Opcode.CHUNK, head + data)]
    if not stale and rng.random() < 0.9:
        for channel, each in pairs.items():
            if rng.random() < 0.02:
                each.append(struct.pack("<QQ", 1, rng.choice(NUMBERS)))
            index = b"".join(each)
            out.append(written(Opcode.MESSAGE_INDEX, struct.pack("<HI", channel, len(index)) + index))
    return b"".join(out)


# ------------------------------------------------------------------ outside the chunks
def _outside(records: list[Record], rng: random.Random, chunks: set[int]) -> None:
    """An attachment, a metadata record, or something that does not belong here."""
    kinds = [i for i, (op, _) in enumerate(records) if op in (Opcode.ATTACHMENT, Opcode.METADATA)]
    i = rng.choice(kinds)
    opcode, body = records[i]
    if opcode == Opcode.METADATA:
        records[i] = (opcode, _metadata(body, rng))
        return
    changed = bytearray(body[:-4])
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(len(changed))
        changed[at : at + 1] = rng.choice((rng.randbytes(1), b"", b"9", b"*", b"!", b"\xff"))
    records[i] = (opcode, bytes(changed) + struct.pack("<I", zlib.crc32(changed)))


def _metadata(body: bytes, rng: random.Random) -> bytes:
    """The record with one of its texts replaced."""
    (n,) = struct.unpack_from("<I", body, 0)
    name, at, end = body[4 : 4 + n], 8 + n, len(body)
    texts = []
    while at < end:
        (size,) = struct.unpack_from("<I", body, at)
        texts.append(body[at + 4 : at + 4 + size])
        at += 4 + size
    if texts:
        texts[2 * rng.randrange(len(texts) // 2) + 1] = rng.choice(TEXTS).encode("utf-8", "replace")
    entries = b"".join(struct.pack("<I", len(t)) + t for t in texts)
    return struct.pack("<I", len(name)) + name + struct.pack("<I", len(entries)) + entries
