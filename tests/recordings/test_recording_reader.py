"""Reading: the fast way equals the library's way, and every kind of bad file is told apart."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_protobuf.decoder import DecoderFactory
from synthetic_run import Run

from recordings.campaign.info import info
from recordings.errors import Damaged, MissingStream, NotARecording, OtherVersion, RecordingError, Truncated
from recordings.file import samples
from recordings.file.reader import Recording
from recordings.file.verify import verify
from recordings.file.writer import Recorder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    with Recorder(path, start_wall_ns=10**18, attachments={"rig.yaml": b"x: 1"}, markers=2) as recorder:
        for topic, t, values in Run(duration=2.0).messages():
            recorder.push(topic, t, values)
            if topic == "/vacuum":
                recorder.log("info", "a line")
    return path


def rewritten(source: Path, target: Path, version: str | None = None, drop: str = "", **how: object) -> Path:
    """The same messages by the library's writer: other chunks, compression or indexes, and messages re-encoded."""
    with open(source, "rb") as file, open(target, "wb") as out:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        writer = Writer(out, **how)  # type: ignore[arg-type]
        writer.start()
        channels: dict[str, int] = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            if schema is None:
                continue
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                metadata = channel.metadata | ({"schema_version": version} if version else {})
                channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", number, metadata)
            data = message.data
            if drop and channel.topic == "/tip":
                decoded.ClearField(drop)
                data = decoded.SerializeToString()
            writer.add_message(channels[channel.topic], message.log_time, data, message.publish_time, message.sequence)
        writer.finish()
    return target


def test_the_fast_way_equals_the_library_and_the_protobuf_runtime(whole: Path) -> None:
    recording = Recording.open(whole)
    for topic in ("/pressure", "/tip", "/spine", "/vacuum", "/force", "/arm"):
        fast = recording.stream(topic)
        with open(whole, "rb") as file:
            found = [(schema, message.data) for schema, _, message in make_reader(file).iter_messages([topic])]
        schema = found[0][0]
        assert schema is not None
        slow = samples.decode(recording._message(recording._channel(topic)), schema, [data for _, data in found], len(found))
        assert fast.dtype == slow.dtype and fast.tobytes() == slow.tobytes()


@pytest.mark.parametrize(
    "how",
    [
        {"compression": CompressionType.LZ4, "chunk_size": 3000},
        {"compression": CompressionType.NONE, "chunk_size": 500},
        {"index_types": IndexType.NONE, "chunk_size": 4000},
        {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "enable_crcs": False},
    ],
    ids=["lz4", "not compressed", "no index", "no summary"],
)
def test_files_of_other_writers_give_the_same_numbers(whole: Path, tmp_path: Path, how: dict[str, object]) -> None:
    a, b = Recording.open(whole), Recording.open(rewritten(whole, tmp_path / "b.mcap", **how))
    for topic in ("/pressure", "/tip", "/spine", "/vacuum", "/force", "/arm"):
        assert a.stream(topic).tobytes() == b.stream(topic).tobytes()
    assert len(a.log) == len(b.log) == 11


def test_a_message_without_a_field_is_read_by_the_runtime(whole: Path, tmp_path: Path) -> None:
    a, b = Recording.open(whole), Recording.open(rewritten(whole, tmp_path / "b.mcap", drop="marker_error"))
    assert (b.stream("/tip")["marker_error"] == 0).all()
    assert np.array_equal(a.stream("/tip")["position"], b.stream("/tip")["position"])


def test_another_schema_version_is_refused_by_name(whole: Path, tmp_path: Path) -> None:
    recording = Recording.open(rewritten(whole, tmp_path / "b.mcap", version="7"))
    with pytest.raises(OtherVersion, match="schema version 7, this software reads 1"):
        recording.stream("/tip")


def test_a_missing_stream_is_told_with_those_there_are(whole: Path) -> None:
    with pytest.raises(MissingStream, match="/pressure"):
        Recording.open(whole).stream("/temperature")
    with pytest.raises(MissingStream, match="not a stream of numbers"):
        Recording.open(whole).stream("/log")


@pytest.mark.parametrize("content", [b"", b"t,x\n1,2\n", b"\x89MCAP1\r\n"])
def test_another_kind_of_file_is_told(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(NotARecording, match="not an MCAP file"):
        Recording.open(tmp_path / "a.mcap")
    with pytest.raises(NotARecording, match="cannot be read"):
        Recording.open(tmp_path / "absent.mcap")


def test_a_truncated_file_tells_how_much_is_readable_and_gives_it(whole: Path, tmp_path: Path) -> None:
    data = whole.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(Truncated, match=r"\d+ of \d+ bytes, \d+ chunks.*lab recover"):
        Recording.open(tmp_path / "cut.mcap")
    cut, full = Recording.open(tmp_path / "cut.mcap", truncated=True), Recording.open(whole)
    tip = cut.stream("/tip")
    assert tip.tobytes() == full.stream("/tip")[: len(tip)].tobytes()


def test_a_file_cut_anywhere_is_read_as_far_as_it_goes(whole: Path, tmp_path: Path) -> None:
    data, full = whole.read_bytes(), Recording.open(whole)
    path = tmp_path / "cut.mcap"
    for size in np.random.default_rng(3).integers(8, len(data), 40).tolist():
        path.write_bytes(data[:size])
        cut = Recording.open(path, truncated=True)
        for topic in cut.topics:
            if topic in ("/tip", "/pressure"):
                samples = cut.stream(topic)
                assert samples.tobytes() == full.stream(topic)[: len(samples)].tobytes()


def test_changed_bytes_in_a_chunk_are_noticed(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    chunk = max(Recording.open(whole).contents.chunks, key=lambda c: c.data_end - c.data_start)
    for at in np.linspace(chunk.data_start, chunk.data_end - 1, 20).astype(int).tolist():
        bad = bytearray(data)
        bad[at] ^= 0x10
        (tmp_path / "bad.mcap").write_bytes(bad)
        with pytest.raises(Damaged, match="chunk at byte"):
            Recording.open(tmp_path / "bad.mcap").stream("/tip")


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


def test_info_sums_up_counts_rates_and_provenance(whole: Path, tmp_path: Path) -> None:
    summary = info(whole)
    assert summary.finished and summary.complete and summary.outcome == "completed"
    assert summary.streams["/tip"].timing.count == 199 and summary.streams["/tip"].timing.rate == pytest.approx(100, 0.01)
    assert summary.attachments == {"rig.yaml": 4} and summary.start.startswith("2001-09-09")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-300])
    assert not info(cut).finished and info(cut).to_dict()["complete"] is False


def test_gaps_in_a_stream_are_counted(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=0) as recorder:
        for k in range(200):
            if k not in (50, 51, 52, 120, 121):
                recorder.push("/vacuum", k * 0.01, absolute=1.0)
    timing = info(tmp_path / "a.mcap").streams["/vacuum"].timing
    assert (timing.gaps, timing.missing) == (2, 5) and timing.longest == pytest.approx(0.04)


def test_what_the_library_can_stream_is_chunks_of_a_fraction_of_a_second(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=0) as recorder:
        for k in range(8):
            recorder.push("/vacuum", k * 0.1, absolute=1.0)
            time.sleep(0.1)
    with open(tmp_path / "a.mcap", "rb") as file:
        chunks = [r for r in StreamReader(file, emit_chunks=True).records if isinstance(r, Chunk)]
    assert len(chunks) >= 4


def test_errors_share_one_root() -> None:
    assert all(issubclass(e, RecordingError) for e in (Damaged, MissingStream, NotARecording, OtherVersion, Truncated))
