"""Files made to do harm: whatever lengths they tell and whatever they unpack to, memory stays bounded by the file's size, and the
error is ours and clear."""

import io
import json
import struct
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, MessageIndex, Schema
from mcap.writer import CompressionType, Writer
from mcap_files import MAGIC, chunk, whole, written

from recordings.errors import Damaged, OtherVersion, Oversized
from recordings.file.budget import MAX_CHUNK, SMALL_CHUNK, Cost, ReadingBudget, largest_chunk
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.verify import verify
from recordings.messages import PRESSURE
from tests.simulated.bench import raises

HUGE, MB = 2**62, 2**20
REST = ((0.0,) * 9, (1.0,) * 9)


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def text(value: bytes) -> bytes:
    return struct.pack("<I", len(value)) + value


def packed(raw: bytes) -> bytes:
    return chunk(raw, "zstd")


def as_if(data: bytes, size: int, compression: str = "zstd") -> bytes:
    """A chunk of these bytes, which are said to unpack to a size."""
    return written(Chunk(compression, data, 1, 0, 0, size))


SCHEMA = written(Schema(1, PRESSURE.schema, "protobuf", PRESSURE.full_name))


def channel(shape: str = "9") -> bytes:
    return written(Channel(1, "/pressure", "protobuf", {"shape.measured": shape, "schema_version": "1"}, 1))


DEFINED = SCHEMA + channel()


def message(payload: bytes = PRESSURE.encode(0.5, REST)) -> bytes:
    return written(Message(1, 1, payload, 1, 1))


def index(offsets: list[int]) -> bytes:
    return written(MessageIndex(1, [(1, offset) for offset in offsets]))


def bomb(size: int) -> bytes:
    """Packed zeros, a piece at a time; without the size in its head."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    return b"".join(packer.compress(bytes(MB)) for _ in range(size // MB)) + packer.flush()


def torn_bomb() -> bytes:
    """The last chunk of a recording that ended abruptly: 15 kB that unpack to half a gigabyte."""
    torn = as_if(zstandard.ZstdCompressor(level=1).compress(bytes(500 * MB)), 500 * MB)
    return MAGIC + record(Opcode.HEADER, bytes(8)) + torn[:-5]


def entries(count: int) -> bytes:
    """A channel with metadata of this many entries."""
    pairs = b"".join(struct.pack("<III", 4, k, 0) for k in range(count))
    return record(Opcode.CHANNEL, struct.pack("<HHI", 9, 0, 1) + b"/" + bytes(4) + text(pairs))


def by_library() -> bytes:
    """A sound file of the library's writer."""
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    schema = writer.register_schema(PRESSURE.full_name, "protobuf", PRESSURE.schema)
    channel = writer.register_channel("/pressure", "protobuf", schema, PRESSURE.metadata)
    for k in range(50):
        writer.add_message(channel, k, PRESSURE.encode(k * 1e-9, REST), k)
    writer.finish()
    return out.getvalue()


def hostile() -> dict[str, bytes]:
    endless_lz4 = b"\x04\x22\x4d\x18\x64\x40\xa7" + b"\xff" * 1000
    sound = by_library()
    says_exabytes = b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", HUGE)
    channels = b"".join(record(Opcode.CHANNEL, struct.pack("<HHI", k, 0, 4) + b"/tip" + bytes(8)) for k in range(60_000))
    return {
        "a record longer than all disks": MAGIC + record(Opcode.CHUNK, b"", HUGE),
        "a chunk whose data is longer than its record": whole(as_if(b"abc", 100)[:-11] + struct.pack("<Q", HUGE) + b"abc"),
        "a chunk that says it holds exabytes": whole(DEFINED, as_if(zstandard.compress(b"x"), HUGE)),
        "packed data that say they hold exabytes": whole(as_if(says_exabytes, 100)),
        "a bomb that says it is small": whole(DEFINED, as_if(bomb(2**30), 1000)),
        "a bomb in many chunks": whole(DEFINED, as_if(zstandard.compress(bytes(MAX_CHUNK)), MAX_CHUNK) * 100),
        "lz4 that goes on and on": whole(as_if(endless_lz4, 10, "lz4")),
        "a name of a compression as long as memory": whole(record(Opcode.CHUNK, bytes(28) + struct.pack("<I", 2**31))),
        "an unknown compression": whole(as_if(b"abc", 3, "brotli")),
        "an attachment longer than its record": whole(record(Opcode.ATTACHMENT, bytes(16) + b"\xff" * 4)),
        "metadata longer than its record": whole(record(Opcode.METADATA, text(b"x") + b"\xff" * 4)),
        "a schema that is no schema": whole(record(Opcode.SCHEMA, b"\x01"), chunk(DEFINED + message())),
        "a message longer than its chunk": whole(chunk(DEFINED + record(Opcode.MESSAGE, message()[9:], HUGE))),
        "a message shorter than its head": whole(chunk(DEFINED + record(Opcode.MESSAGE, b"\x01\x00"))),
        "arrays as large as memory": whole(SCHEMA, channel("1000000000"), chunk(message()), index([0])),
        "a shape that is no number": whole(SCHEMA, channel("9xq"), chunk(message()), index([0])),
        "a negative shape": whole(SCHEMA, channel("-9"), chunk(message()), index([0])),
        "a schema of rubbish": whole(DEFINED.replace(PRESSURE.schema, b"\xff" * len(PRESSURE.schema)), chunk(message(b"x"))),
        "an index that lists one message a million times": whole(DEFINED, chunk(message()), index([0] * 10**6)),
        "an index that points behind the end": whole(DEFINED, chunk(message()), index([2**64 - 1])),
        "chunks in chunks in chunks": whole(DEFINED, chunk(chunk(chunk(message())))),
        "records of length zero without end": whole(DEFINED, chunk(record(Opcode.SUMMARY_OFFSET, b"") * 10**4)),
        "a footer that points behind the file": sound[:-28] + struct.pack("<QQI", HUGE, HUGE, 1) + MAGIC,
        "a footer that points at itself": sound[:-28] + struct.pack("<QQI", len(sound) - 37, 0, 1) + MAGIC,
        "a torn chunk that goes on and on": torn_bomb(),
        "many chunks of the largest size": whole(DEFINED, packed(bytes(SMALL_CHUNK)) * 40),
        "messages without content": whole(DEFINED, packed(message(b"") * 250_000) * 3),
        "channels by the ten thousand": whole(packed(channels)),
        "a channel of half a million texts": whole(packed(entries(500_000))),
        "records of an unknown kind": whole(DEFINED, packed(record(0x80, b"") * 900_000)),
    }


BOMBS = 6
"""The last ones, small files that unpack to much; only the first of them is wrong."""

CHILD = textwrap.dedent(
    """
    import json, resource, sys
    from pathlib import Path

    import recordings.campaign.export, recordings.campaign.shelf
    from benchmarks.faults.fuzz import forget_peak, memory_of
    from recordings.campaign.info import info
    from recordings.campaign.replay import replay
    from recordings.errors import RecordingError
    from recordings.file.reader import Recording
    from recordings.file.recover import recover
    from recordings.file.verify import verify

    def stream(path):
        recording = Recording.open(path, truncated=True)
        for topic in recording.topics:
            recording.stream(topic) if topic == "/pressure" else recording.log_times(topic)

    ways = {"info": info, "stream": stream, "replay": lambda p: replay(p, truncated=True),
            "verify": lambda p: verify(p).problems, "recover": recover}
    now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + 700 * 2**20,) * 2)
    found = []
    for path in map(Path, sys.argv[1:]):
        told, most = {}, 0.0
        for name, way in ways.items():
            forget_peak()
            before = memory_of("VmRSS")
            try:
                answer = way(path)
                told[name] = f"ok {len(answer)}" if name == "verify" else "ok"
            except RecordingError as error:
                told[name] = f"{type(error).__name__}: {error}"
            except BaseException as error:
                told[name] = f"BAD {type(error).__name__}: {error}"
            most = max(most, memory_of("VmHWM") - before)
        found.append((told, most))
    print(json.dumps(found))
    """
)


def test_every_way_of_reading_stays_within_memory_and_answers_with_our_own_errors(tmp_path: Path) -> None:
    """In a process that may take 700 MB; of that, 64 for a bomb of less than 1 MB."""
    made = hostile()
    bombs = list(made)[-BOMBS:]
    assert all(len(made[name]) < MB for name in bombs)
    for number, data in enumerate(made.values()):
        (tmp_path / f"f{number}.mcap").write_bytes(data)
    files = [str(tmp_path / f"f{number}.mcap") for number in range(len(made))]
    done = subprocess.run([sys.executable, "-c", CHILD, *files], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = dict(zip(made, json.loads(done.stdout), strict=True))
    assert {name: ways for name, (ways, _) in found.items() if any(said.startswith("BAD") for said in ways.values())} == {}
    assert {name: found[name][1] for name in bombs if found[name][1] > 64} == {}
    assert {name for name, (ways, _) in found.items() if ways["verify"] == "ok 0"} <= set(bombs[1:])


def test_a_budget_refuses_what_goes_beyond_the_share_of_the_files_size() -> None:
    budget = ReadingBudget("a.mcap", 1000)
    budget.take(Cost.UNPACKED, budget.left(Cost.UNPACKED))
    raises(Oversized, r"a\.mcap.*file of 1000 bytes", budget.take, Cost.UNPACKED, 1)
    assert largest_chunk(1000) == SMALL_CHUNK < largest_chunk(100 * MB)


def test_a_recording_of_constant_values_which_packs_best_still_opens(tmp_path: Path) -> None:
    parts = [packed(message() * 4000) + index([len(message()) * k for k in range(4000)])] * 30
    (tmp_path / "rest.mcap").write_bytes(whole(DEFINED, *parts))
    assert len(Recording.open(tmp_path / "rest.mcap").stream("/pressure")) == 120_000


@pytest.mark.parametrize("shape", ["1x1x1x1", "0x1000000000000", "9x1", "2x2"])
def test_a_shape_that_no_robot_has_is_another_version(tmp_path: Path, shape: str) -> None:
    (tmp_path / "a.mcap").write_bytes(whole(SCHEMA, channel(shape), packed(message())))
    raises(OtherVersion, "shape", Recording.open(tmp_path / "a.mcap").stream, "/pressure")


def test_a_stream_without_its_schema_is_damage(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(whole(channel(), packed(message(b"x"))))
    raises(Damaged, "schema 1, which is missing", Recording.open(tmp_path / "a.mcap").stream, "/pressure")


def test_recovering_a_torn_bomb_says_that_nothing_could_be_kept(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(torn_bomb())
    done = recover(tmp_path / "a.mcap")
    assert not done.messages and done.holes == 1 and verify(done.target).ok
