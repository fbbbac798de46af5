"""A small file cannot make a large thing: what reading may cost follows from the file's size, before anything is unpacked."""

from __future__ import annotations

import functools
import json
import struct
import subprocess
import sys
import textwrap
import zlib
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode
from test_recording_hostile import chunk, definitions, index, record, whole

from recordings.errors import Damaged, OtherVersion, Oversized
from recordings.file.budget import SMALL_CHUNK, Budget, Cost, largest_chunk
from recordings.file.reader import Recording
from recordings.file.records import MAGIC
from recordings.file.recover import recover
from recordings.file.verify import verify
from recordings.messages import PRESSURE

MB = 2**20


def test_a_budget_refuses_what_goes_beyond_the_share_of_the_files_size() -> None:
    budget = Budget("a.mcap", 1000)
    budget.take(Cost.UNPACKED, budget.left(Cost.UNPACKED))
    with pytest.raises(Oversized, match=r"a\.mcap.*file of 1000 bytes"):
        budget.take(Cost.UNPACKED, 1)
    assert largest_chunk(1000) == SMALL_CHUNK < largest_chunk(100 * MB)


def packed(raw: bytes) -> bytes:
    return chunk(zstandard.compress(raw), len(raw), b"zstd", zlib.crc32(raw))


def empty_messages(count: int) -> bytes:
    return record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 1, 1, 1)) * count


def entries(count: int) -> bytes:
    """A channel with metadata of so many entries."""
    pairs = b"".join(struct.pack("<III", 4, k, 0) for k in range(count))
    return record(Opcode.CHANNEL, struct.pack("<HHI", 9, 0, 1) + b"/" + bytes(4) + struct.pack("<I", len(pairs)) + pairs)


def torn_bomb() -> bytes:
    """The last chunk of a recording that ended abruptly: 15 kB that unpack to half a gigabyte."""
    data = zstandard.ZstdCompressor(level=1).compress(bytes(500 * MB))
    head = struct.pack("<QQQII", 0, 1, 500 * MB, 1, 4) + b"zstd" + struct.pack("<Q", len(data))
    torn = struct.pack("<BQ", Opcode.CHUNK, len(head) + len(data)) + head + data[:-5]
    return MAGIC + record(Opcode.HEADER, bytes(8)) + torn


@functools.cache
def bombs() -> dict[str, bytes]:
    """Small files that unpack to much, by name."""
    return {
        "a torn chunk that goes on and on": torn_bomb(),
        "many chunks of the largest size": whole(definitions(), packed(bytes(SMALL_CHUNK)) * 40),
        "messages without content": whole(definitions(), packed(empty_messages(250_000)) * 3),
        "channels by the ten thousand": whole(
            packed(b"".join(record(Opcode.CHANNEL, struct.pack("<HHI", k, 0, 4) + b"/tip" + bytes(8)) for k in range(60_000)))
        ),
        "a channel of half a million texts": whole(packed(entries(500_000))),
        "records of an unknown kind": whole(definitions(), packed(record(0x80, b"") * 900_000)),
    }


CHILD = textwrap.dedent(
    """
    import json, sys, time
    from pathlib import Path
    from benchmarks.faults.fuzz import forget_peak, memory_of
    from recordings.errors import RecordingError
    from recordings.campaign.info import info
    from recordings.file.recover import recover
    from recordings.campaign.replay import replay
    from recordings.file.verify import verify
    found = {}
    for path in map(Path, sys.argv[1:]):
        most, slowest = 0.0, 0.0
        for way in (info, verify, recover, lambda p: replay(p, truncated=True)):
            forget_peak()
            before, began = memory_of("VmRSS"), time.process_time()
            try:
                way(path)
            except RecordingError:
                pass
            most, slowest = max(most, memory_of("VmHWM") - before), max(slowest, time.process_time() - began)
        found[path.stem] = (most, slowest)
    print(json.dumps(found))
    """
)


def test_bombs_take_no_more_memory_than_a_small_file_may(tmp_path: Path) -> None:
    for number, data in enumerate(bombs().values()):
        assert len(data) < MB
        (tmp_path / f"{number}.mcap").write_bytes(data)
    files = [str(tmp_path / f"{number}.mcap") for number in range(len(bombs()))]
    done = subprocess.run([sys.executable, "-c", CHILD, *files], capture_output=True, text=True, timeout=250, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found = {name: json.loads(done.stdout)[str(number)][0] for number, name in enumerate(bombs())}
    assert {name: memory for name, memory in found.items() if memory > 64} == {}


def test_a_recording_of_constant_values_which_packs_best_still_opens(tmp_path: Path) -> None:
    payload = PRESSURE.encode(0.0, ((0.0,) * 9, (0.0,) * 9))
    one = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 1, 1, 1) + payload)
    parts = [packed(one * 4000) + index([len(one) * k for k in range(4000)])] * 30
    (tmp_path / "rest.mcap").write_bytes(whole(definitions(), *parts))
    assert len(Recording.open(tmp_path / "rest.mcap").stream("/pressure")) == 120_000


@pytest.mark.parametrize("shape", ["1x1x1x1", "0x1000000000000", "9x1", "2x2"])
def test_a_shape_that_no_robot_has_is_another_version(tmp_path: Path, shape: str) -> None:
    message = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 1, 1, 1) + PRESSURE.encode(0.0, ((0.0,) * 9, (0.0,) * 9)))
    (tmp_path / "a.mcap").write_bytes(whole(definitions(shape), packed(message)))
    with pytest.raises(OtherVersion, match="shape"):
        Recording.open(tmp_path / "a.mcap").stream("/pressure")


def test_a_stream_without_its_schema_is_damage(tmp_path: Path) -> None:
    both = definitions()
    channel = both[9 + struct.unpack_from("<Q", both, 1)[0] :]
    message = record(Opcode.MESSAGE, struct.pack("<HIQQ", 1, 1, 1, 1) + b"x")
    (tmp_path / "a.mcap").write_bytes(whole(channel, packed(message)))
    with pytest.raises(Damaged, match="schema 1, which is missing"):
        Recording.open(tmp_path / "a.mcap").stream("/pressure")


def test_recovering_a_torn_bomb_says_that_nothing_could_be_kept(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(bombs()["a torn chunk that goes on and on"])
    done = recover(tmp_path / "a.mcap")
    assert not done.messages and done.holes == 1 and verify(done.target).ok
