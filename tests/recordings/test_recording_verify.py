"""Verify: a file as it was written is right, and no changed byte stays unnoticed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from synthetic_run import Run

from recordings.errors import NotARecording, RecordingError
from recordings.file.records import index
from recordings.file.verify import Verification, verify
from recordings.file.writer import Recorder


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "run.mcap"
    with Recorder(path, start_wall_ns=10**18, attachments={"rig.yaml": b"x: 1"}, markers=2) as recorder:
        for topic, t, values in Run(duration=0.5).messages():
            recorder.push(topic, t, values)
    return path


def changed(source: Path, target: Path, places: Iterator[tuple[int, int]]) -> Iterator[tuple[int, Verification | None]]:
    """The file with one bit changed at a time (byte, bit); None where it is no recording at all any more."""
    data = bytearray(source.read_bytes())
    for at, bit in places:
        data[at] ^= 1 << bit
        target.write_bytes(data)
        data[at] ^= 1 << bit
        try:
            yield at, verify(target)
        except RecordingError:
            yield at, None


def test_a_file_as_it_was_written_is_right_and_all_its_checksums_are_compared(small: Path) -> None:
    result = verify(small)
    assert result.ok and result.finished and result.problems == ()
    assert result.checksums == result.chunks + 3  # an attachment, the data section and the summary


def test_files_of_the_kept_old_version_are_right() -> None:
    assert verify(Path(__file__).parent / "data" / "bending-schema-1.mcap").ok


@pytest.mark.parametrize("every", [89, pytest.param(17, marks=pytest.mark.long)])
def test_every_changed_byte_of_a_file_is_found(small: Path, tmp_path: Path, every: int) -> None:
    random = np.random.default_rng(5)
    size = small.stat().st_size
    places = ((int(at), int(random.integers(8))) for at in range(0, size, every))
    unnoticed = [at for at, result in changed(small, tmp_path / "a.mcap", places) if result is not None and result.ok]
    assert unnoticed == []


def test_a_changed_byte_in_a_chunk_is_found_where_it_is(small: Path, tmp_path: Path) -> None:
    random = np.random.default_rng(6)
    chunk = max(index(memoryview(small.read_bytes()), "").chunks, key=lambda c: c.size)
    places = [(int(random.integers(chunk.data_start, chunk.data_end)), int(random.integers(8))) for _ in range(150)]
    for _, result in changed(small, tmp_path / "a.mcap", iter(places)):
        assert result is not None and not result.ok
        assert all(p.at >= chunk.start for p in result.problems)
    assert any("chunk" in p.text for p in result.problems)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_file_that_was_cut_is_told_as_not_finished(small: Path, tmp_path: Path, share: float) -> None:
    data = small.read_bytes()
    (tmp_path / "a.mcap").write_bytes(data[: int(len(data) * share)])
    result = verify(tmp_path / "a.mcap")
    assert not result.ok and not result.finished and "not finished" in result.problems[-1].text


def test_a_message_that_is_missing_though_counted_is_found(small: Path, tmp_path: Path) -> None:
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file, enable_data_crcs=True)
        writer.start()
        schema = writer.register_schema("x", "protobuf", b"")
        channel = writer.register_channel("/x", "protobuf", schema)
        writer.add_message(channel, 1, b"", 1)
        writer.add_metadata("counts", {"/x": '{"written": 2}'})
        writer.finish()
    (problem,) = verify(tmp_path / "a.mcap").problems
    assert problem.text == "/x: 2 messages were written, the file holds 1"


def test_a_file_without_checksums_is_intact_as_far_as_checksums_reach_and_the_rest_is_named(tmp_path: Path) -> None:
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file, enable_crcs=False)
        writer.start()
        writer.add_message(writer.register_channel("/x", "json", 0), 1, b"{}", 1)
        writer.finish()
    found = verify(tmp_path / "a.mcap")
    assert (found.verdict, found.problems, found.checksums) == ("intact as far as checksums reach", (), 0)
    assert found.uncovered == (
        "header, definitions, metadata and indexes outside chunks",
        "1 of 1 chunks",
        "the summary",
    )


def test_what_is_no_recording_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"t,x\n")
    with pytest.raises(NotARecording):
        verify(tmp_path / "a.mcap")
