"""Reading: the fast way equals the library's way, also for files of other writers, and every kind of bad file is told apart."""

import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from synthetic_run import Run, recorded, rewritten, state

from recordings.campaign.info import info
from recordings.campaign.replay import replay_states
from recordings.errors import MissingStream, NotARecording, OtherVersion
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.tail import Tail
from recordings.file.verify import verify
from recordings.file.writer import Recorder
from recordings.states.rules import Window
from tests.simulated.bench import raises


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
