"""The recorder: what goes in is in the file and at once in memory, nothing is lost unnoticed, and viewers get
published schemas."""

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from synthetic_run import Run, recorded

from recordings.campaign.info import info
from recordings.errors import BadMessage, RecordingError, WriteFailed
from recordings.file import writer
from recordings.file.mcap_file import MOST
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.writer import Recorder
from recordings.messages import streams
from recordings.states.buffer import BLOCK, Buffers
from tests.simulated.bench import raises

WALL = 1_700_000_000_000_000_123


def test_an_independent_reader_finds_every_message_with_its_values_and_log_time(tmp_path: Path) -> None:
    run = Run(duration=2.0)
    recorded(tmp_path / "a.mcap", run, start_wall_ns=WALL)
    sent = {topic: [m for m in run.messages() if m[0] == topic] for topic in ("/pressure", "/tip", "/force", "/arm")}
    with open(tmp_path / "a.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        found: dict[str, list[tuple[int, object]]] = {}
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
        assert [a.name for a in reader.iter_attachments()] == ["rig.yaml"]
    for topic, messages in sent.items():
        assert [log for log, _ in found[topic]] == [WALL + round(t * 1e9) for _, t, _ in messages]
    assert [list(d.measured) for _, d in found["/pressure"]] == [list(v[1]) for _, _, v in sent["/pressure"]]  # type: ignore[attr-defined, call-overload]
    assert [d.frame for _, d in found["/tip"]] == [v[1] for _, _, v in sent["/tip"]]  # type: ignore[attr-defined]


def test_the_buffer_and_the_file_hold_the_same_numbers_bit_by_bit(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=WALL, markers=2) as recorder:
        for topic, t, values in Run(duration=3.0).messages():
            recorder.push(topic, t, values)
    recording = Recording.open(tmp_path / "a.mcap")
    for topic in recorder.messages:
        live = recorder.buffers.window(topic, -np.inf, np.inf)
        assert live.dtype == recording.stream(topic).dtype
        assert live.tobytes() == recording.stream(topic).tobytes()
        assert len(live) or topic == "/valve"


def test_metadata_tell_outcome_and_counts(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=WALL, metadata={"versions": {"softlab": "0.1"}})
    for k in range(10):
        recorder.push("/valve", k * 0.1, on=True)
    recorder.push("/valve", 0.3, on=False)
    recorder.push("/vacuum", 0.1, absolute=1e5)
    recorder.note_lost("/valve", 4)
    counts = recorder.close("stopped", "by hand")
    assert (counts["/valve"].generated, counts["/valve"].written) == (11, 10)
    assert (counts["/valve"].dropped, counts["/valve"].lost, counts["/valve"].complete) == (1, 4, False)
    told = info(tmp_path / "a.mcap").streams
    assert [(told[t].timing.count, told[t].dropped, told[t].lost) for t in ("/valve", "/vacuum")] == [(10, 1, 4), (1, 0, 0)]
    recording = Recording.open(tmp_path / "a.mcap")
    assert recording.outcome == "stopped" and recording.metadata["outcome"]["detail"] == "by hand"
    assert recording.metadata["versions"] == {"softlab": "0.1"}
    assert json.loads(recording.metadata["counts"]["/valve"])["lost"] == 4
    assert recorder.close("completed") == counts
    assert recording.outcome == "stopped"


def test_what_is_not_a_message_is_refused_and_counted(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=WALL) as recorder:
        for t in (float("nan"), -1.0, float("inf")):
            raises(BadMessage, "rig time", recorder.push, "/vacuum", t, absolute=1.0)
        raises(BadMessage, "absolut", recorder.push, "/vacuum", 0.0, absolut=1.0)
        raises(BadMessage, "/vaccum", recorder.push, "/vaccum", 0.0, absolute=1.0)
        raises(BadMessage, "loud", recorder.log, "loud", "text")
        raises(ValueError, "/force: -3 lost samples", recorder.note_lost, "/force", -3)
    assert recorder.counts()["/vacuum"].dropped == 4 and recorder.counts()["/force"].lost == 0


def body(t: float, frame: int, *markers: tuple[float, float, float]) -> SimpleNamespace:
    turn = (1, 0, 0, 0)
    return SimpleNamespace(
        t=t, device_time=t, frame=frame, position=(1, 2, 3), orientation=turn, marker_error=0.0, valid=True, markers=markers
    )


def test_a_sink_fills_up_markers_and_never_raises(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=WALL, markers=2)
    sink = recorder.sink("/tip")
    sink(body(0.1, 1, (4, 5, 6)))
    for k in (2, 3):
        sink(body(0.1 * k, k, *[(4.0, 5.0, 6.0)] * 3))
    recorder.close("completed")
    sink(body(0.4, 4))
    recording = Recording.open(tmp_path / "a.mcap")
    (markers,) = recording.stream("/tip")["markers"]
    assert markers[0].tolist() == [4, 5, 6] and np.isnan(markers[1]).all()
    assert [line.level for line in recording.log] == ["info", "error"] and "markers" in recording.log[1].text
    assert recorder.counts()["/tip"].dropped == 3


def test_many_producers_at_once_lose_nothing_and_keep_each_stream_in_order(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=WALL)
    values = {"/vacuum": lambda k: (k,), "/valve": lambda k: (k % 2 == 0,), "/force": lambda k: ((k,) * 6, (0,) * 6)}

    def produce(topic: str) -> None:
        for k in range(3000):
            recorder.push(topic, k * 1e-3, values[topic](float(k)))

    with ThreadPoolExecutor(len(values) + 1) as pool:
        list(pool.map(produce, (*values, "/vacuum")))
    counts = recorder.close("completed")
    recording = Recording.open(tmp_path / "a.mcap")
    for topic in ("/valve", "/force"):
        assert counts[topic].written == 3000
        assert np.array_equal(recording.stream(topic)["t"], np.array([round(k * 1e-3 * 1e9) / 1e9 for k in range(3000)]))
    assert recording.stream("/force")["raw"][:, 0].tolist() == list(range(3000))
    written = recording.stream("/vacuum")
    assert counts["/vacuum"].generated == 6000 and counts["/vacuum"].written == len(written) >= 3000
    assert (np.diff(written["t"]) >= 0).all() and written["t"][-1] == 2.999
    assert recorder.buffers.window("/vacuum", 0.0, 9.0).tobytes() == written.tobytes()


@dataclass
class Held:
    """A recorder whose writer waits for the disk until it may go on."""

    recorder: Recorder
    go: threading.Event
    fault: str = ""
    """Of the disk by then."""


@pytest.fixture
def held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Held]:
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=WALL)
    busy, commit, held = threading.Event(), recorder._disk.commit, Held(recorder, threading.Event())

    def wait() -> None:
        busy.set()
        assert held.go.wait(60.0)
        if held.fault:
            raise OSError(held.fault)
        commit()

    monkeypatch.setattr(recorder._disk, "commit", wait)
    assert busy.wait(60.0)
    yield held
    held.go.set()
    with contextlib.suppress(*[WriteFailed] if held.fault else []):
        recorder.close("completed")


def test_what_is_pushed_is_seen_and_counted_at_once_while_the_writer_waits_for_the_disk(held: Held, tmp_path: Path) -> None:
    recorder = held.recorder
    for t in (1.0, 1.5, 1.2, 1.5, 2.0):
        recorder.push("/vacuum", t, absolute=t)
    recorder.push("/valve", 3.0, on=True)
    recorder.log("info", "a line")
    assert recorder.buffers.newest("/vacuum") == 2.0 and recorder.buffers.newest("/spine") == -np.inf
    assert recorder.buffers.window("/vacuum", 0.0, 1.5)["t"].tolist() == [1.0, 1.5, 1.5]
    assert recorder.buffers.latest("/vacuum")["absolute"] == 2.0  # type: ignore[index]
    assert (recorder.counts()["/vacuum"].generated, recorder.counts()["/vacuum"].written) == (5, 0)
    held.go.set()
    counts = recorder.close("completed")["/vacuum"]
    assert (counts.generated, counts.written, counts.dropped) == (5, 4, 1)
    recording = Recording.open(tmp_path / "a.mcap")
    live = recorder.buffers.window("/vacuum", 0.0, 9.0)
    assert live.tobytes() == recording.stream("/vacuum").tobytes() and live["t"].tolist() == [1.0, 1.5, 1.5, 2.0]
    assert recording.log[-1].log_time == WALL + 3 * 10**9  # the newest stamp


def test_beyond_its_limit_the_queue_takes_no_sample_and_counts_it(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "QUEUE_LIMIT", 5)
    for k in range(8):
        held.recorder.push("/valve", float(k), on=True)
    held.recorder.log("info", "events always go in")
    assert held.recorder.buffers.newest("/valve") == 4.0
    held.go.set()
    counts = held.recorder.close("completed")
    assert (counts["/valve"].generated, counts["/valve"].written, counts["/valve"].dropped) == (8, 5, 3)
    assert counts["/log"].written == 2


def test_chunks_stay_small_however_much_has_waited(held: Held, tmp_path: Path) -> None:
    for k in range(500):
        held.recorder.log("info", str(k % 10) * 10_000)
    held.go.set()
    held.recorder.close("completed")
    with open(tmp_path / "a.mcap", "rb") as file:
        summary = make_reader(file).get_summary()
    sizes = [chunk.uncompressed_size for chunk in summary.chunk_indexes]
    assert sum(sizes) > 4 * MOST and max(sizes) < 1.1 * MOST


def test_what_waits_when_the_disk_fails_is_counted_as_dropped(held: Held) -> None:
    recorder, held.fault = held.recorder, "no space left"
    for k in range(10):
        recorder.push("/valve", float(k), on=True)
    held.go.set()
    raises(WriteFailed, "no space left", recorder.close, "completed")
    raises(WriteFailed, "no space left", recorder.push, "/valve", 10.0, on=True)
    counts = recorder.counts()["/valve"]
    assert (counts.generated, counts.written, counts.dropped) == (11, 0, 11)


def test_leaving_a_with_block_by_an_error_is_recorded_as_failed(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), Recorder(tmp_path / "a.mcap", start_wall_ns=WALL):
        raise ZeroDivisionError("oh")
    recording = Recording.open(tmp_path / "a.mcap")
    assert recording.outcome == "failed" and "oh" in recording.metadata["outcome"]["detail"]


def test_header_schemas_and_attachments_are_in_the_file_before_the_first_sample(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=WALL, attachments={"rig.yaml": b"x"})
    recording = Recording.open(tmp_path / "a.mcap", truncated=True)
    recorder.close("completed")
    assert set(recorder.messages) < set(recording.topics) and recording.attachments == {"rig.yaml": b"x"}
    assert recording.outcome is None


CHILD = textwrap.dedent(
    """
    import itertools, os, sys, time
    from recordings.file.writer import Recorder
    recorder = Recorder(sys.argv[1], start_wall_ns=time.time_ns())
    begin = time.monotonic()
    for k in itertools.count():
        t = time.monotonic() - begin
        recorder.push("/vacuum", t, absolute=float(k))
        os.pwrite(int(sys.argv[2]), b"%20d" % k, 0)
        time.sleep(0.001)
    """
)


def test_a_killed_process_loses_a_quarter_of_a_second_at_most(tmp_path: Path) -> None:
    sent = tmp_path / "sent"
    fd = os.open(sent, os.O_RDWR | os.O_CREAT)
    child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path / "a.mcap"), str(fd)], pass_fds=(fd,))
    try:
        deadline = time.monotonic() + 60
        while int(os.pread(fd, 20, 0) or 0) < 600 and time.monotonic() < deadline:
            time.sleep(0.02)
        child.send_signal(signal.SIGKILL)
        child.wait()
        generated = int(os.pread(fd, 20, 0))
    finally:
        child.kill()
        os.close(fd)
    recording = Recording.open(tmp_path / "a.mcap", truncated=True)
    vacuum = recording.stream("/vacuum")
    assert vacuum["absolute"].tolist() == list(range(len(vacuum)))
    # The loop makes a message each millisecond or slower, so 250 messages are a quarter of a second or more.
    assert len(vacuum) > 100 and generated + 1 - len(vacuum) <= 250
    assert recording.outcome is None


FULL = textwrap.dedent(
    """
    import resource, sys
    from recordings.errors import WriteFailed
    from recordings.file.writer import Recorder
    recorder = Recorder(sys.argv[1], start_wall_ns=0)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, resource.RLIM_INFINITY))
    import random, time
    try:
        for k in range(100_000):
            recorder.push("/force", k * 1e-3, (tuple(random.random() for _ in range(6)), (0.0,) * 6))
            time.sleep(1e-4)
    except WriteFailed as error:
        print("push:", error)
    try:
        recorder.close("completed")
    except WriteFailed as error:
        print("close:", error)
    print(recorder.counts()["/force"].written)
    """
)


def test_a_disk_that_fills_up_is_told_at_the_next_push_and_at_close_and_leaves_whole_records(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "a.mcap")], capture_output=True, text=True, timeout=600, check=True
    )
    push, close, written = done.stdout.splitlines()
    assert push.startswith("push:") and "recording stopped" in push and "recover" in push
    assert close.startswith("close:")
    recording = Recording.open(tmp_path / "a.mcap", truncated=True)
    assert recording.contents.end == recording.contents.size
    assert len(recording.stream("/force")) == int(written) > 0


def test_samples_older_than_what_is_kept_are_refused_rather_than_missing(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=WALL, keep=1.0) as recorder:
        for k in range(3 * BLOCK + 1):
            recorder.push("/valve", k * 0.01, on=True)
        recorder.sync()
        newest = 0.01 * 3 * BLOCK
        assert len(recorder.buffers.window("/valve", newest - 0.995, newest)) == 100
        assert len(recorder.buffers.window("/valve", newest - 5.995, newest - 5.0)) == 100
        raises(RecordingError, "no longer in memory", recorder.buffers.window, "/valve", 0.0, 10.0)
        assert recorder.buffers["/valve"].newest == newest


def test_what_people_and_instruments_say_is_kept_as_it_is_but_not_without_end(tmp_path: Path) -> None:
    hostile = "[/red] \x1b[2J <script>"
    recorder = Recorder(tmp_path / "a.mcap", start_wall_ns=WALL, metadata={"labels": {"operator": "M\udcfcller"}})
    recorder.log("warning", hostile)
    recorder.log("warning", "x" * 1_000_000)
    recorder.log("warning", "half \ud800")
    recorder.close("failed", "half \ud800" + "y" * 1_000_000)
    recording = Recording.open(tmp_path / "a.mcap")
    first, long, half = (line.text for line in recording.log if line.level == "warning")
    assert first == hostile and half == "half \\ud800"
    assert len(long) < 11_000 and long.endswith("x ... (990000 more characters)")
    assert recording.metadata["outcome"]["detail"].startswith("half \\ud800yyy")
    assert len(recording.metadata["outcome"]["detail"]) < 11_000
    assert recording.metadata["labels"] == {"operator": "M\\udcfcller"}


COUNT = 5 * BLOCK + 7


def test_who_looks_while_samples_come_sees_all_up_to_some_moment() -> None:
    buffers = Buffers(streams(9, 0, ()), 1e9)

    def come() -> None:
        for k in range(COUNT):
            with buffers.lock:
                buffers["/valve"].append(float(k), buffers["/valve"].message.encode(float(k), (k % 2 == 0,)))

    writer = threading.Thread(target=come)
    writer.start()
    while True:
        alive, newest = writer.is_alive(), buffers.newest("/valve")
        seen = buffers.window("/valve", 0.0, np.inf)["t"]
        assert seen.tolist() == list(range(len(seen))) and (newest == -np.inf or len(seen) > newest)
        if not alive:
            break
    writer.join()
    assert len(seen) == COUNT


def test_pose_markers_and_joints_come_at_thirty_a_second_of_rig_time(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with Recorder(path, start_wall_ns=10**18, markers=3) as recorder:
        for k in range(500):
            t = k * 0.004
            markers = ((0.1, 0.2, 0.3), (math.nan,) * 3, (0.4, 0.5, 0.6))
            recorder.push("/tip", t, (t, k, (1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5), 0.0, k < 400, markers))
            recorder.push("/arm", t, (t, tuple(range(6)), (0.0,) * 6, (0.0,) * 6, 1, True))
    counts = recorder.counts()
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found: dict[str, list[tuple[int, object]]] = {}
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            if schema is not None and schema.name.startswith("foxglove.") and channel.topic != "/log":
                found.setdefault(f"{channel.topic} {schema.name}", []).append((message.log_time, decoded))
    assert {name.split(".")[-1] for name in found} == {"PoseInFrame", "PosesInFrame", "JointStates"}
    for messages in found.values():
        assert np.diff([time for time, _ in messages]).min() >= 1e9 / 30 - 1
    assert len(found["/arm/joints foxglove.JointStates"]) == len(found["/tip/markers foxglove.PosesInFrame"]) == 56
    poses = found["/tip/markers foxglove.PosesInFrame"][0][1].poses  # type: ignore[attr-defined]
    assert [(p.position.x, p.position.y, p.position.z) for p in poses] == [(0.1, 0.2, 0.3), (0.4, 0.5, 0.6)]
    joints = found["/arm/joints foxglove.JointStates"][0][1].joints  # type: ignore[attr-defined]
    assert [(j.name, j.position) for j in joints][:2] == [("shoulder_pan", 0.0), ("shoulder_lift", 1.0)]
    # Where the tip was not tracked there is no pose; that is no loss.
    assert len(found["/tip/pose foxglove.PoseInFrame"]) == 45
    assert counts["/tip/pose"].complete and counts["/tip/pose"].written == 45


def test_a_recording_with_views_that_saw_nothing_is_recovered_as_complete(tmp_path: Path) -> None:
    with Recorder(tmp_path / "a.mcap", start_wall_ns=10**18) as recorder:
        for k in range(20):
            recorder.push("/tip", k * 0.1, (0.0, k, (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), 0.0, k % 2 == 0, ()))
    assert recover(tmp_path / "a.mcap", tmp_path / "b.mcap").complete
    assert len(Recording.open(tmp_path / "b.mcap").log_times("/tip/pose")) == 10
