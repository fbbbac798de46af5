"""Recover: every message that is whole is kept, nothing is invented, and what is missing is told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from synthetic_run import Run

from recordings.campaign.info import info
from recordings.errors import NotARecording, WriteFailed
from recordings.file.chunks import Messages
from recordings.file.contents import Contents
from recordings.file.reader import Recording
from recordings.file.records import index, records
from recordings.file.recover import Recovery, recover
from recordings.file.verify import verify
from recordings.file.writer import Recorder

Key = tuple[str, int, int, bytes]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished file of many small chunks."""
    folder = tmp_path_factory.mktemp("whole")
    with Recorder(folder / "one.mcap", start_wall_ns=10**18, attachments={"rig.yaml": b"x: 1"}, markers=2) as recorder:
        for topic, t, values in Run(duration=2.0).messages():
            recorder.push(topic, t, values)
    return copied(folder / "one.mcap", folder / "many.mcap", CompressionType.ZSTD)


def copied(source: Path, target: Path, compression: CompressionType) -> Path:
    with open(source, "rb") as file, open(target, "wb") as out:
        reader, writer = make_reader(file), Writer(out, 4000, compression, enable_data_crcs=True)
        writer.start()
        for attachment in reader.iter_attachments():
            writer.add_attachment(1, 1, attachment.name, "text/plain", attachment.data)
        channels: dict[str, int] = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.topic not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "protobuf", number, channel.metadata)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.log_time, message.sequence)
        writer.finish()
    return target


def held(path: Path) -> list[Key]:
    """All messages, by the library's reader, in the file's order of time."""
    with open(path, "rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages()
        return [(channel.topic, message.log_time, message.sequence, message.data) for _, channel, message in found]


def by_chunk(data: bytes) -> list[list[bytes]]:
    """What the messages hold that can be read, chunk by chunk."""
    walk = records(memoryview(data), Contents("", len(data)), unpack=True)
    return [item.payloads() for item in walk if isinstance(item, Messages) and len(item)]


def recovered(data: bytes, folder: Path) -> tuple[Recovery, Path]:
    (folder / "bad.mcap").write_bytes(data)
    (folder / "good.mcap").unlink(missing_ok=True)
    return recover(folder / "bad.mcap", folder / "good.mcap"), folder / "good.mcap"


def test_a_whole_file_is_recovered_message_by_message_and_nothing_is_lost(whole: Path, tmp_path: Path) -> None:
    result, target = recovered(whole.read_bytes(), tmp_path)
    assert result.complete and result.seconds_lost == 0 and result.lost == {}
    assert held(target) == held(whole) and verify(target).ok
    assert Recording.open(target).attachments == {"rig.yaml": b"x: 1"}


@pytest.mark.parametrize("every", [19, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE], ids=["zstd", "not packed"])
def test_cut_at_any_byte_of_the_last_two_chunks_every_whole_message_is_kept(
    tmp_path: Path, compression: CompressionType, every: int
) -> None:
    with Recorder(tmp_path / "short.mcap", start_wall_ns=10**18, markers=2) as recorder:
        for topic, t, values in Run(duration=0.15).messages():
            recorder.push(topic, t, values)
    source = copied(tmp_path / "short.mcap", tmp_path / "source.mcap", compression)
    data = source.read_bytes()
    chunks = index(memoryview(data), "").chunks
    ends = []  # (byte at which a message is whole, messages until then)
    count = 0
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


def test_a_broken_chunk_costs_its_own_messages_and_seconds_only(whole: Path, tmp_path: Path) -> None:
    data = bytearray(whole.read_bytes())
    chunks = index(memoryview(bytes(data)), "").chunks
    broken = chunks[len(chunks) // 2]
    data[(broken.data_start + broken.data_end) // 2] ^= 4
    result, target = recovered(bytes(data), tmp_path)
    kept, all_messages = held(target), held(whole)
    missing = [m for m in all_messages if m not in set(kept)]
    assert missing and all(broken.first_time <= time <= broken.last_time for _, time, _, _ in missing)
    assert len(kept) + len(missing) == len(all_messages) and sum(result.lost.values()) == len(missing)
    assert result.finished and not result.complete
    spanned = (broken.last_time - broken.first_time) / 1e9
    assert spanned <= result.seconds_lost <= spanned + 0.02


def test_any_changed_byte_costs_one_chunk_at_most(whole: Path, tmp_path: Path) -> None:
    random = np.random.default_rng(8)
    data, all_messages = whole.read_bytes(), set(held(whole))
    chunks = index(memoryview(data), "").chunks
    largest = max(map(len, by_chunk(data)))
    for at in random.integers(chunks[1].start, len(data), 40).tolist():
        bad = bytearray(data)
        bad[at] ^= 1 << int(random.integers(8))
        _, target = recovered(bytes(bad), tmp_path)
        kept = set(held(target))
        assert kept <= all_messages and len(all_messages) - len(kept) <= largest


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
    with pytest.raises(WriteFailed, match="exists"):
        recover(whole, tmp_path / "there.mcap")
    with pytest.raises(WriteFailed, match="cannot be written"):
        recover(whole, tmp_path / "no such folder" / "a.mcap")
    recover(whole, tmp_path / "new.mcap")
    assert whole.read_bytes() == before and (tmp_path / "there.mcap").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new.mcap", "there.mcap"]


def test_what_is_no_recording_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(bytes(100))
    with pytest.raises(NotARecording):
        recover(tmp_path / "a.mcap")
