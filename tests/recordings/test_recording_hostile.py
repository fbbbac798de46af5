"""Files made to do harm: whatever lengths they tell, memory stays bounded and the error is ours and clear."""

from __future__ import annotations

import io
import json
import struct
import subprocess
import sys
import textwrap
import zlib
from collections.abc import Callable, Iterator

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from recordings.file.budget import MAX_CHUNK
from recordings.file.records import MAGIC
from recordings.messages import PRESSURE

HUGE = 2**62


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def chunk(packed: bytes, size: int, compression: bytes = b"zstd", crc: int = 0, length: int | None = None) -> bytes:
    head = struct.pack("<QQQI", 0, 1, size, crc) + text(compression)
    return record(Opcode.CHUNK, head + struct.pack("<Q", len(packed) if length is None else length) + packed)


def whole(*records: bytes) -> bytes:
    """A file that has its end, with no summary."""
    end = record(Opcode.DATA_END, bytes(4)) + record(Opcode.FOOTER, bytes(20))
    return MAGIC + record(Opcode.HEADER, text(b"") + text(b"")) + b"".join(records) + end + MAGIC


def definitions(shape: str = "9") -> bytes:
    schema = struct.pack("<H", 1) + text(PRESSURE.full_name.encode()) + text(b"protobuf") + text(PRESSURE.schema)
    texts = b"".join(text(k) + text(v.encode()) for k, v in ((b"shape.measured", shape), (b"schema_version", "1")))
    channel = struct.pack("<HH", 1, 1) + text(b"/pressure") + text(b"protobuf") + text(texts)
    return record(Opcode.SCHEMA, schema) + record(Opcode.CHANNEL, channel)


def message(length: int | None = None) -> bytes:
    payload = PRESSURE.encode(0.5, ((0.0,) * 9, (1.0,) * 9))
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 1, 1, 1) + payload, length)


def index(offsets: list[int]) -> bytes:
    pairs = b"".join(struct.pack("<QQ", 1, offset) for offset in offsets)
    return record(Opcode.MESSAGE_INDEX, struct.pack("<H", 1) + text(pairs))


def plain(raw: bytes) -> bytes:
    return chunk(raw, len(raw), b"", zlib.crc32(raw))


def bomb(size: int) -> bytes:
    """Packed zeros, a piece at a time; without the size in its head."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    return b"".join(packer.compress(bytes(2**20)) for _ in range(size // 2**20)) + packer.flush()


def repeated(count: int) -> bytes:
    """Many chunks of the largest size allowed, each packed to almost nothing."""
    one = chunk(zstandard.compress(bytes(MAX_CHUNK)), MAX_CHUNK)
    return one * count


def by_library(change: Callable[[bytes], bytes]) -> bytes:
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    schema = writer.register_schema(PRESSURE.full_name, "protobuf", PRESSURE.schema)
    channel = writer.register_channel("/pressure", "protobuf", schema, PRESSURE.metadata)
    for k in range(50):
        writer.add_message(channel, k, PRESSURE.encode(k * 1e-9, ((0.0,) * 9, (1.0,) * 9)), k)
    writer.finish()
    return change(out.getvalue())


def hostile() -> Iterator[tuple[str, bytes]]:
    odd = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 1, 1, 1) + b"x")
    yield "a record longer than all disks", MAGIC + record(Opcode.CHUNK, b"", HUGE)
    yield "a chunk whose data is longer than its record", whole(chunk(b"abc", 100, length=HUGE))
    yield "a chunk that says it holds exabytes", whole(definitions(), chunk(zstandard.compress(b"x"), HUGE))
    yield (
        "packed data that say they hold exabytes",
        whole(chunk(b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", HUGE), 100)),
    )
    yield "a bomb that says it is small", whole(definitions(), chunk(bomb(2**30), 1000))
    yield "a bomb in many chunks", whole(definitions(), repeated(100))
    yield "lz4 that goes on and on", whole(chunk(b"\x04\x22\x4d\x18\x64\x40\xa7" + b"\xff" * 1000, 10, b"lz4"))
    yield "a name of a compression as long as memory", whole(record(Opcode.CHUNK, bytes(28) + struct.pack("<I", 2**31)))
    yield "an unknown compression", whole(chunk(b"abc", 3, b"brotli"))
    yield (
        "an attachment longer than its record",
        whole(record(Opcode.ATTACHMENT, bytes(16) + struct.pack("<I", 2**32 - 1))),
    )
    yield "metadata longer than its record", whole(record(Opcode.METADATA, text(b"x") + struct.pack("<I", 2**32 - 1)))
    yield "a schema that is no schema", whole(record(Opcode.SCHEMA, b"\x01"), plain(definitions() + message()))
    yield "a message longer than its chunk", whole(plain(definitions() + message(HUGE)))
    yield "a message shorter than its head", whole(plain(definitions() + record(Opcode.MESSAGE, b"\x01\x00")))
    yield "arrays as large as memory", whole(definitions("1000000000"), plain(message()), index([0]))
    yield "a shape that is no number", whole(definitions("9xq"), plain(message()), index([0]))
    yield (
        "a schema of rubbish",
        whole(definitions().replace(PRESSURE.schema, b"\xff" * len(PRESSURE.schema)), plain(odd)),
    )
    yield "a negative shape", whole(definitions("-9"), plain(message()), index([0]))
    yield "an index that lists one message a million times", whole(definitions(), plain(message()), index([0] * 10**6))
    yield "an index that points behind the end", whole(definitions(), plain(message()), index([2**64 - 1]))
    yield "chunks in chunks in chunks", whole(definitions(), plain(plain(plain(message()))))
    yield "records of length zero without end", whole(definitions(), plain(record(Opcode.SUMMARY_OFFSET, b"") * 10**5))
    yield (
        "a footer that points behind the file",
        by_library(lambda d: d[:-28] + struct.pack("<QQI", HUGE, HUGE, 1) + MAGIC),
    )
    yield (
        "a footer that points at itself",
        by_library(lambda d: d[:-28] + struct.pack("<QQI", len(d) - 37, 0, 1) + MAGIC),
    )


CHILD = textwrap.dedent(
    """
    import json, resource, sys
    from pathlib import Path
    import recordings.campaign.export, recordings.campaign.replay, recordings.campaign.shelf
    import recordings.file.recover, recordings.file.verify
    from recordings.errors import RecordingError
    from recordings.campaign.info import info
    from recordings.file.player import play
    from recordings.file.reader import Recording
    from recordings.file.recover import recover
    from recordings.campaign.replay import replay
    from recordings.file.verify import verify

    def stream(path):
        recording = Recording.open(path, truncated=True)
        for topic in recording.topics:
            recording.stream(topic) if topic == "/pressure" else recording.log_times(topic)

    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + 700 * 2**20,) * 2)
    found = {}
    for path in map(Path, sys.argv[1:]):
        told = {}
        for name, do in (("info", info), ("stream", stream), ("replay", lambda p: replay(p, truncated=True)),
                         ("verify", lambda p: verify(p).problems), ("recover", recover)):
            try:
                answer = do(path)
                told[name] = f"ok {len(answer)}" if name == "verify" else "ok"
            except RecordingError as error:
                told[name] = f"{type(error).__name__}: {error}"
            except BaseException as error:
                told[name] = f"BAD {type(error).__name__}: {error}"
        found[path.stem] = told
    print(json.dumps(found))
    """
)


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """What every way of reading says to every file, in a process that may take 700 MB."""
    folder = tmp_path_factory.mktemp("hostile")
    names = {}
    for number, (name, data) in enumerate(hostile()):
        names[f"f{number}"] = name
        (folder / f"f{number}.mcap").write_bytes(data)
    files = [str(folder / f"{stem}.mcap") for stem in names]
    done = subprocess.run([sys.executable, "-c", CHILD, *files], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return {names[stem]: answer for stem, answer in json.loads(done.stdout).items()}


def test_every_way_of_reading_stays_within_memory_and_answers_with_our_own_errors(
    told: dict[str, dict[str, str]],
) -> None:
    assert [(name, ways) for name, ways in told.items() if any(said.startswith("BAD") for said in ways.values())] == []


def test_verify_finds_something_wrong_with_each(told: dict[str, dict[str, str]]) -> None:
    assert [name for name, ways in told.items() if ways["verify"] == "ok 0"] == []
