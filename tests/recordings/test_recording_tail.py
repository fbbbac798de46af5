"""A recording followed while it is written: everything that is in the file, once, in order, however it comes."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from numpy.typing import NDArray
from synthetic_run import concluded

from recordings.errors import Damaged, Oversized
from recordings.file.reader import Recording
from recordings.file.tail import Piece, Tail
from recordings.file.writer import Recorder


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return concluded(tmp_path_factory.mktemp("tail") / "run.mcap")


def followed(tail: Tail) -> list[Piece]:
    """All pieces that are there."""
    found: list[Piece] = []
    while pieces := tail.read():
        found += pieces
    return found


def samples(pieces: list[Piece], topic: str) -> NDArray[np.void]:
    return np.concatenate([piece.samples[topic] for piece in pieces if topic in piece.samples])


def same(a: NDArray[np.void], b: NDArray[np.void]) -> bool:
    """To the last bit; what lies between the fields does not count."""
    return a.dtype == b.dtype and all(a[name].tobytes() == b[name].tobytes() for name in a.dtype.names or ())


def test_a_finished_file_is_read_whole(path: Path) -> None:
    recording = Recording.open(path)
    with Tail(path) as tail:
        pieces = followed(tail)
        assert tail.contents.finished and tail.contents.metadata == dict(recording.metadata) and not tail.grown()
    assert len(pieces) > 5
    for topic in recording.streams:
        expected = recording.stream(topic)
        if len(expected):
            assert same(samples(pieces, topic), expected)
    assert [s for piece in pieces for s in piece.events["/state"]] == recording.states
    assert [t.row.to_json() for piece in pieces for t in piece.events["/trial"]] == [t.row.to_json() for t in recording.trials]
    assert [line for piece in pieces for line in piece.events["/log"]] == recording.log
    assert [(m.steps, m.steps_planned, m.seconds) for p in pieces for m in p.events["/progress"]] == [(0, 2, 0.0), (1, 2, 3.5)]


def test_what_was_pushed_is_there_after_the_next_sync_and_its_numbers_have_no_gap(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", start_wall_ns=10**18)
    with Tail(recorder.path) as tail:
        count = 0
        for k in range(50):
            for _ in range(7):
                count += 1
                recorder.push("/vacuum", count * 0.01, (20e3 + count,))
            recorder.sync()
            pieces = followed(tail)
            assert samples(pieces, "/vacuum")["absolute"].tolist() == [20e3 + count - 6 + i for i in range(7)]
            assert [n for p in pieces for n in p.numbers.get("/vacuum", [])] == list(range(count - 6, count + 1))
            assert not tail.contents.finished and k < 50
        recorder.close("completed")
        followed(tail)
        assert tail.contents.finished and tail.contents.metadata["outcome"]["outcome"] == "completed"


@settings(max_examples=25)
@example(cuts=list(range(1, 120)))
@given(cuts=st.lists(st.integers(1, 60_000), max_size=12))
def test_however_the_bytes_come_the_pieces_are_the_same(path: Path, cuts: list[int]) -> None:
    data = path.read_bytes()
    growing = path.with_suffix(".growing")
    growing.write_bytes(b"")
    with Tail(growing) as tail, open(growing, "ab", buffering=0) as file:
        pieces: list[Piece] = []
        for begin, end in zip([0, *sorted(cuts)], [*sorted(cuts), len(data)], strict=True):
            file.write(data[begin:end])
            pieces += followed(tail)
        assert tail.contents.finished
    recording = Recording.open(path)
    assert all(same(samples(pieces, topic), recording.stream(topic)) for topic in ("/tip", "/force"))


def test_lengths_that_a_file_claims_are_not_believed(path: Path, tmp_path: Path) -> None:
    begin = path.read_bytes()[:8]
    (claims := tmp_path / "claims.mcap").write_bytes(begin + struct.pack("<BQ", Opcode.CHUNK, 2**60) + bytes(5000))
    with Tail(claims) as tail, pytest.raises(Oversized, match="limit"):
        followed(tail)
    (senseless := tmp_path / "senseless.mcap").write_bytes(begin + struct.pack("<BQ", Opcode.CHUNK, 40) + b"\xff" * 40)
    with Tail(senseless) as tail, pytest.raises(Damaged, match="byte 8"):
        followed(tail)
