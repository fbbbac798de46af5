"""Reading: the fast reader agrees with the library, also on files of other writers, and each kind of bad file is identified.
Damaged files: verify finds every cut and every changed byte, reading gives nothing wrong, and recover keeps every message that
is whole, invents none, and says what is missing. Other people's software reads the recordings: counts, order, sums, attachments,
metadata, and fields by name.

The reader in JavaScript needs node and the packages @mcap/core, @mcap/support and protobufjs; say where they are with
SOFTLAB_NODE_MODULES=<folder>/node_modules.
"""

import hashlib
import json
import os
import shutil
import subprocess
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory
from synthetic_run import OLD, Run, held, recorded, rewritten, state

from recordings.campaign.info import info
from recordings.campaign.replay import replay_states
from recordings.errors import Damaged, MissingStream, NotARecording, OtherVersion, RecordingError, Truncated, WriteFailed
from recordings.events import EVENTS
from recordings.file.chunks import Messages
from recordings.file.contents import Contents
from recordings.file.reader import Recording
from recordings.file.records import index, records
from recordings.file.recover import Recovery, recover
from recordings.file.tail import Tail
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from recordings.messages import STREAMS
from recordings.states.rules import Window
from tests.simulated.bench import raises


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished recording."""
    return recorded(tmp_path_factory.mktemp("whole") / "run.mcap", Run(duration=2.0))


def test_a_message_without_a_field_is_read_by_the_runtime(whole: Path, tmp_path: Path) -> None:
    with open(whole, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = iter([tip for *_, tip in reader.iter_decoded_messages(["/tip"])])

    def without(topic: str, number: int, message: Any) -> None:
        if topic == "/tip":
            tip = next(decoded)
            tip.ClearField("marker_error")
            message.data = tip.SerializeToString()

    a, b = Recording.open(whole), Recording.open(rewritten(whole, tmp_path / "b.mcap", without))
    assert (b.stream("/tip")["marker_error"] == 0).all()
    assert np.array_equal(a.stream("/tip")["position"], b.stream("/tip")["position"])


def test_another_schema_version_and_a_missing_stream_are_refused_by_name(whole: Path, tmp_path: Path) -> None:
    other = Recording.open(rewritten(whole, tmp_path / "b.mcap", channel={"schema_version": "7"}))
    raises(OtherVersion, "schema version 7, this software reads 1", other.stream, "/tip")
    raises(MissingStream, "/pressure", Recording.open(whole).stream, "/temperature")
    raises(MissingStream, "not a stream of numbers", Recording.open(whole).stream, "/log")


def followed(path: Path) -> None:
    with Tail(path) as tail:
        tail.read()


@pytest.mark.parametrize("content", [b"", b"t,x\n1,2\n", b"\x89MCAP1\r\n", bytes(100)])
@pytest.mark.parametrize("way", [Recording.open, verify, recover, followed])
def test_another_kind_of_file_is_told(tmp_path: Path, content: bytes, way: Callable[[Path], object]) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    if content or way is not followed:  # an empty file may still be written
        raises(NotARecording, "not an MCAP file", way, tmp_path / "a.mcap")
    raises(NotARecording, "cannot be read", way, tmp_path / "absent.mcap")


@pytest.mark.parametrize("way", [Tail, Recording.open, verify, recover])
def test_a_pipe_or_a_folder_is_no_recording_and_nobody_waits_for_one(tmp_path: Path, way: Callable[[Path], object]) -> None:
    os.mkfifo(pipe := tmp_path / "pipe.mcap")
    for other in (pipe, tmp_path):
        raises(NotARecording, None, way, other)


def test_an_index_that_lies_or_leaves_out_messages_misleads_nobody_and_is_noticed(whole: Path, tmp_path: Path) -> None:
    recording = Recording.open(whole)
    samples = recording.stream("/tip")
    channel, start, end = next(i for c in recording.contents.chunks for i in c.indexes if i[2] - i[1] >= 32)
    data = bytearray(whole.read_bytes())
    for change in (b"\x07" + bytes(7), data[start + 8 : start + 16], b"\xff" * 8):
        bad = bytearray(data)
        bad[start + 24 : start + 32] = change
        (tmp_path / "bad.mcap").write_bytes(bad)
        assert Recording.open(tmp_path / "bad.mcap").stream("/tip").tobytes() == samples.tobytes()
        assert any("index" in problem.text for problem in verify(tmp_path / "bad.mcap").problems)


def test_gaps_in_a_stream_are_counted(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=0) as recorder:
        for k in range(200):
            if k not in (50, 51, 52, 120, 121):
                recorder.push("/vacuum", k * 0.01, absolute=1.0)
    timing = info(tmp_path / "a.mcap").streams["/vacuum"].timing
    assert (timing.gaps, timing.missing) == (2, 5) and timing.longest == pytest.approx(0.04)


def test_what_info_verify_and_replay_hold_does_not_grow_with_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("file.records.BATCH", 2**16), ("campaign.replay.KEEP", 1.0), ("campaign.replay.SLOW_OLDEST", 1.0),
                        ("file.counts.Pace.DISTINCT", 2**8), ("file.clocks.ClockFit.MOST", 2**8)):  # fmt: skip
        monkeypatch.setattr(f"recordings.{name}", value)
    peaks: dict[str, list[int]] = {}
    for duration in (8.0, 32.0):
        path = tmp_path / f"{duration:g}.mcap"
        with Recorder(path, start_wall_ns=10**18, markers=2) as recorder:
            for k, (topic, t, values) in enumerate(Run(duration=duration).messages()):
                recorder.push(topic, t, values)
                if k % 1000 == 0:
                    recorder.state(t, state(rule=Window(0.1, 0.2), t_start=t, step=1 + k // 1000))
                if k % 40 == 0:
                    recorder.sync()  # a chunk each
        for name, read in (("info", info), ("verify", verify), ("replay", lambda p: replay_states(Recording.open(p)))):
            read(path)
            tracemalloc.start()
            read(path)
            peaks.setdefault(name, []).append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    assert all(long < 1.5 * short for short, long in peaks.values()), peaks


# -- damaged files
@pytest.fixture(scope="module")
def many(whole: Path) -> Path:
    """The same in many small chunks."""
    return rewritten(whole, whole.with_name("many.mcap"), chunk_size=4000, enable_data_crcs=True)


def by_chunk(data: bytes) -> list[list[bytes]]:
    """What the messages hold that can be read, chunk by chunk."""
    walk = records(memoryview(data), Contents("", len(data)), unpack=True)
    return [item.payloads() for item in walk if isinstance(item, Messages) and len(item)]


def recovered(data: bytes, folder: Path) -> tuple[Recovery, Path]:
    (folder / "bad.mcap").write_bytes(data)
    (folder / "good.mcap").unlink(missing_ok=True)
    return recover(folder / "bad.mcap", folder / "good.mcap"), folder / "good.mcap"


def test_a_file_as_it_was_written_is_right_and_recovered_message_by_message(whole: Path, many: Path, tmp_path: Path) -> None:
    result = verify(whole)
    assert result.ok and result.finished and result.problems == () and verify(OLD).ok
    assert result.checksums == result.chunks + 3  # an attachment, the data section and the summary
    kept, target = recovered(many.read_bytes(), tmp_path)
    assert kept.complete and kept.seconds_lost == 0 and kept.lost == {}
    assert held(target) == held(many) and verify(target).ok
    assert Recording.open(target).attachments == {"rig.yaml": b"x: 1"}


# ------------------------------------------------------------------ cuts
def test_a_file_cut_anywhere_is_told_as_such_and_read_as_far_as_it_goes(whole: Path, tmp_path: Path) -> None:
    data, full, path = whole.read_bytes(), Recording.open(whole), tmp_path / "cut.mcap"
    for size in (*np.random.default_rng(3).integers(8, len(data), 40).tolist(), len(data) - 300, len(data) - 8):
        path.write_bytes(data[:size])
        raises(Truncated, r"\d+ of \d+ bytes, \d+ chunks.*lab recover", Recording.open, path)
        cut, told = Recording.open(path, truncated=True), verify(path)
        for topic in {"/tip", "/pressure"} & set(cut.topics):
            samples = cut.stream(topic)
            assert samples.tobytes() == full.stream(topic)[: len(samples)].tobytes()
        assert not told.ok and not told.finished and "not finished" in told.problems[-1].text
        assert not info(path).finished and info(path).to_dict()["complete"] is False


@pytest.mark.parametrize("every", [127, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE], ids=["zstd", "not packed"])
def test_cut_at_any_byte_of_the_last_two_chunks_every_whole_message_is_kept(
    tmp_path: Path, compression: CompressionType, every: int
) -> None:
    short = recorded(tmp_path / "short.mcap", Run(duration=0.15))
    source = rewritten(short, tmp_path / "source.mcap", chunk_size=4000, compression=compression, enable_data_crcs=True)
    data = source.read_bytes()
    chunks = index(memoryview(data), "").chunks
    ends, count = [], 0  # (byte at which a message is whole, messages until then)
    for chunk, held_here in zip(chunks, by_chunk(data), strict=True):
        for message in held_here:
            count += 1
            if compression is CompressionType.NONE:
                ends.append((data.index(message, chunk.data_start) + len(message), count))
        ends.append((chunk.data_end, count))
    all_messages = held(source)
    for cut in range(chunks[-2].start, chunks[-1].data_end + 200, every):
        kept = sum(map(len, by_chunk(data[:cut])))
        assert kept >= max(n for end, n in ends if end <= cut), cut
        if cut % 61 < every:
            result, target = recovered(data[:cut], tmp_path)
            assert held(target) == all_messages[: sum(result.messages.values())] and not result.complete
            assert sum(result.messages.values()) == kept and verify(target).ok


# ------------------------------------------------------------------ changed bytes
def test_a_changed_byte_in_a_chunk_is_found_where_it_is_whatever_reads_it(whole: Path, tmp_path: Path) -> None:
    data, bad = whole.read_bytes(), tmp_path / "bad.mcap"
    chunk = max(Recording.open(whole).contents.chunks, key=lambda c: c.data_end - c.data_start)
    for at in np.linspace(chunk.data_start, chunk.data_end - 1, 50).astype(int).tolist():
        bad.write_bytes(data[:at] + bytes([data[at] ^ 1 << at % 8]) + data[at + 1 :])
        problems = verify(bad).problems
        assert problems and all(p.at >= chunk.start for p in problems) and any("chunk" in p.text for p in problems)
        raises(Damaged, "chunk at byte", Recording.open(bad).stream, "/tip")
    with Tail(bad) as tail, pytest.raises(RecordingError, match="lab verify"):
        while tail.read():
            pass


@pytest.mark.parametrize("count", [12, pytest.param(40, marks=pytest.mark.long)])
def test_any_changed_byte_costs_one_chunk_at_most(many: Path, tmp_path: Path, count: int) -> None:
    random = np.random.default_rng(8)
    data, all_messages = many.read_bytes(), set(held(many))
    chunks = index(memoryview(data), "").chunks
    largest = max(map(len, by_chunk(data)))
    for at in random.integers(chunks[1].start, len(data), count).tolist():
        bad = bytearray(data)
        bad[at] ^= 1 << int(random.integers(8))
        _, target = recovered(bytes(bad), tmp_path)
        kept = set(held(target))
        assert kept <= all_messages and len(all_messages) - len(kept) <= largest


def test_a_broken_chunk_costs_its_own_messages_and_seconds_only(many: Path, tmp_path: Path) -> None:
    data = bytearray(many.read_bytes())
    chunks = index(memoryview(bytes(data)), "").chunks
    broken = chunks[len(chunks) // 2]
    data[(broken.data_start + broken.data_end) // 2] ^= 4
    result, target = recovered(bytes(data), tmp_path)
    kept, all_messages = held(target), held(many)
    missing = [m for m in all_messages if m not in set(kept)]
    assert missing and all(broken.first_time <= time <= broken.last_time for _, time, _, _ in missing)
    assert len(kept) + len(missing) == len(all_messages) and sum(result.lost.values()) == len(missing)
    assert result.finished and not result.complete
    spanned = (broken.last_time - broken.first_time) / 1e9
    assert spanned <= result.seconds_lost <= spanned + 0.02


# ------------------------------------------------------------------ what is said of it
def test_what_is_missing_is_counted_in_the_new_file_and_shown_by_info(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=0) as recorder:
        for k in range(100):
            recorder.push("/vacuum", k * 0.01, absolute=1.0)
            if k == 50:
                recorder.push("/vacuum", 0.0, absolute=1.0)
    data = (tmp_path / "a.mcap").read_bytes()
    result, target = recovered(data[: index(memoryview(data), "").chunks[-1].data_end], tmp_path)
    assert result.lost == {"/vacuum": 1} and not result.finished
    summary = info(target)
    assert (summary.outcome, summary.streams["/vacuum"].dropped, summary.complete) == ("abrupt", 1, False)
    assert json.loads(Recording.open(target).metadata["recovery"]["finished"]) is False


def test_the_source_stays_and_nothing_is_written_over(whole: Path, tmp_path: Path) -> None:
    before = whole.read_bytes()
    (tmp_path / "there.mcap").write_text("precious")
    raises(WriteFailed, "exists", recover, whole, tmp_path / "there.mcap")
    raises(WriteFailed, "cannot be written", recover, whole, tmp_path / "no such folder" / "a.mcap")
    recover(whole, tmp_path / "new.mcap")
    assert whole.read_bytes() == before and (tmp_path / "there.mcap").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new.mcap", "there.mcap"]


def plain(path: Path, metadata: dict[str, dict[str, str]] | None = None, **how: bool) -> Path:
    """A file of one message by the library's writer."""
    with open(path, "wb") as file:
        writer = Writer(file, **how)
        writer.start()
        writer.add_message(writer.register_channel("/x", "json", 0), 1, b"{}", 1)
        for name, texts in (metadata or {}).items():
            writer.add_metadata(name, texts)
        writer.finish()
    return path


def test_a_message_that_is_missing_though_counted_is_found(tmp_path: Path) -> None:
    (problem,) = verify(plain(tmp_path / "a.mcap", {"counts": {"/x": '{"written": 2}'}}, enable_data_crcs=True)).problems
    assert problem.text == "/x: 2 messages were written, the file holds 1"


def test_a_file_without_checksums_is_intact_as_far_as_checksums_reach_and_the_rest_is_named(tmp_path: Path) -> None:
    found = verify(plain(tmp_path / "a.mcap", enable_crcs=False))
    assert (found.verdict, found.problems, found.checksums) == ("intact as far as checksums reach", (), 0)
    assert found.uncovered == ("header, definitions, metadata and indexes outside chunks", "1 of 1 chunks", "the summary")


# ------------------------------------------------------------------ other people's software
HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def node_modules() -> Path:
    place = os.environ.get("SOFTLAB_NODE_MODULES")
    if shutil.which("node") is None or not place:
        pytest.skip("the independent reader needs node and SOFTLAB_NODE_MODULES=<folder>")
    return Path(place)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("elsewhere") / "run.mcap"
    files = {"rig.yaml": b"clock: {speed: 1}\n", "robot.yaml": b"name: r\n", "empty": b""}
    about = {"versions": {"softlab": "0.1", "text": 'with "quotes" and umlauts äöü'}}
    with Recorder(path, start_wall_ns=10**18 + 7, attachments=files, metadata=about, markers=2) as recorder:
        for k, (topic, t, values) in enumerate(Run(duration=3.0).messages()):
            recorder.push(topic, t, values)
            if k % 100 == 0:
                recorder.log("info", f"line {k}")
    return path


def read_by_node(file: Path, modules: Path) -> Any:
    command = ["node", str(HERE / "independent" / "read.cjs"), str(file)]
    environment = os.environ | {"NODE_PATH": str(modules)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def sums(recording: Recording) -> dict[str, dict[str, float]]:
    """Of every number of every stream, added in the order of the file; NaN does not count."""
    out: dict[str, dict[str, float]] = {}
    for topic in STREAMS.keys() & recording.streams:
        samples = recording.stream(topic)
        of = {name: [v for v in samples[name].ravel().astype(float).tolist() if v == v] for name in samples.dtype.names or ()}
        out[topic] = {name: sum(numbers) for name, numbers in of.items() if numbers}
    return out


def check_by_node(file: Path, modules: Path) -> None:
    recording, found = Recording.open(file), read_by_node(file, modules)
    assert found["inOrder"] and int(found["messages"]) == sum(topic["count"] for topic in found["topics"].values())
    counts = {topic: len(recording.log_times(topic)) for topic in recording.topics}
    assert {name: topic["count"] for name, topic in found["topics"].items()} == {t: n for t, n in counts.items() if n}
    for name, topic in found["topics"].items():
        log_times = recording.log_times(name)
        assert (int(topic["first"]), int(topic["last"])) == (log_times[0], log_times[-1])
        assert topic["encoding"] == "protobuf"
    for name, expected in sums(recording).items():
        assert found["topics"][name]["sums"] == expected, name
    assert found["attachments"] == {n: hashlib.sha256(d).hexdigest() for n, d in recording.attachments.items()}
    assert found["metadata"] == recording.metadata


def test_an_independent_reader_finds_equal_counts_order_sums_attachments_and_metadata(path: Path, node_modules: Path) -> None:
    check_by_node(path, node_modules)
    topics = read_by_node(path, node_modules)["topics"]
    assert topics["/force"]["metadata"]["unit.raw"] == "N, N m" and topics["/arm"]["schema"] == "lab.Arm"
    assert topics["/arm/joints"]["schema"] == "foxglove.JointStates"


def test_the_independent_reader_reads_the_old_version(node_modules: Path) -> None:
    check_by_node(OLD, node_modules)


def test_every_channel_is_described_as_viewers_need_it(path: Path) -> None:
    """What Foxglove and Lichtblick demand: protobuf in protobuf, a schema of that full name with all files that it depends on."""
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.chunk_indexes and summary.statistics is not None
    assert {channel.topic for channel in summary.channels.values()} >= {*STREAMS, *EVENTS}
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert (channel.message_encoding, schema.encoding) == ("protobuf", "protobuf"), channel.topic
        pool = DescriptorPool()
        for part in FileDescriptorSet.FromString(schema.data).file:
            pool.Add(part)  # type: ignore[no-untyped-call]  # raises for a file whose imports are not there before it
        assert pool.FindMessageTypeByName(schema.name).fields_by_name, channel.topic  # type: ignore[no-untyped-call]
