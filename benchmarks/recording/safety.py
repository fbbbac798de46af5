"""What is lost when the worst happens: kills, cuts, changed bytes, a full disk."""

from __future__ import annotations

import os
import random
import signal
import struct
import subprocess
import sys
import textwrap
import time
from pathlib import Path

from recordings.file.chunks import Messages
from recordings.file.contents import Contents
from recordings.file.reader import Recording
from recordings.file.records import index, records
from recordings.file.recover import recover
from recordings.file.verify import verify
from recordings.file.writer import Recorder

from ..figures import Figure
from .stream import TOTAL, record

LOAD = 1500.0
"""Messages a second of all streams together, while the process is killed."""

CHILD = textwrap.dedent(
    """
    import os, struct, sys, time
    from benchmarks.recording.stream import Values, schedule
    from recordings.file.writer import Recorder
    path, fd, factor = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    values, recorder = Values(), Recorder(path, start_wall_ns=time.time_ns(), keep=60.0)
    begin = time.monotonic()
    for t, topic, k in schedule(60.0, factor):
        while (wait := t - (time.monotonic() - begin)) > 0:
            time.sleep(wait)
        recorder.push(topic, t, values.of(topic, k, t))
        os.pwrite(fd, struct.pack("<d", t), 0)
    """
)


def kills(folder: Path, times: int, seed: int = 1) -> Figure:
    """Kill a recording process at random moments; what the recovered file lacks of what was pushed until then."""
    choose, losses, whole = random.Random(seed), [], 0
    for number in range(times):
        path, note = folder / f"killed-{number}.mcap", folder / "pushed"
        fd = os.open(note, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
        child = subprocess.Popen([sys.executable, "-c", CHILD, str(path), str(fd), str(LOAD / TOTAL)], pass_fds=(fd,))
        try:
            while os.fstat(fd).st_size < 8:
                time.sleep(0.005)
            time.sleep(choose.uniform(0.3, 1.5))
            child.send_signal(signal.SIGKILL)
            child.wait()
            (pushed,) = struct.unpack("<d", os.pread(fd, 8, 0))
        finally:
            child.kill()
            os.close(fd)
        result = recover(path, folder / "recovered.mcap")
        recording = Recording.open(folder / "recovered.mcap")
        newest = max(recording.newest(topic) for topic in ("/arm", "/tip", "/force"))
        losses.append(max(0.0, pushed - newest))
        whole += not result.lost and not result.nameless
        path.unlink()
        (folder / "recovered.mcap").unlink()
    worst = max(losses)
    return Figure(
        f"loss at SIGKILL, {times} random moments at {LOAD:g} messages/s",
        f"<= 0.25 s, everything earlier recovered, {times}/{times}",
        f"worst {worst:.3f} s, median {sorted(losses)[times // 2]:.3f} s; {whole}/{times} without a gap before",
        worst <= 0.25 and whole == times,
        {"worst_s": worst, "median_s": sorted(losses)[times // 2], "without_gap": whole, "kills": times},
    )


def messages(data: bytes) -> list[bytes]:
    """All messages that can be read."""
    walk = records(memoryview(data), Contents("", len(data)), unpack=True)
    return [payload for item in walk if isinstance(item, Messages) for payload in item.payloads()]


def truncation(folder: Path) -> Figure:
    """Cut a file at every byte of its last two chunks: all messages of whole chunks must come back, and no others."""
    path = folder / "cut.mcap"
    record(path, 1.0)
    data = path.read_bytes()
    chunks = index(memoryview(data), "").chunks
    everything = messages(data)
    needed = [len(messages(data[: chunk.data_end])) for chunk in chunks]
    wrong = cuts = 0
    for cut in range(chunks[-2].start if len(chunks) > 1 else chunks[-1].start, chunks[-1].data_end + 1):
        kept = messages(data[:cut])
        least = max((n for n, chunk in zip(needed, chunks, strict=True) if chunk.data_end <= cut), default=0)
        wrong += len(kept) < least or kept != everything[: len(kept)]
        cuts += 1
    return Figure(
        "truncation at every byte of the last two chunks",
        "every complete message kept",
        f"{cuts - wrong} of {cuts} cuts right",
        wrong == 0,
        {"cuts": cuts, "wrong": wrong},
    )


def flips(folder: Path, count: int, seed: int = 2) -> Figure:
    """Change one bit at a time in a chunk; verify must say so each time, for finished files."""
    path, bad = folder / "flip.mcap", folder / "flipped.mcap"
    record(path, 2.0)
    data, choose, found = bytearray(path.read_bytes()), random.Random(seed), 0
    chunks = index(memoryview(bytes(data)), "").chunks
    for _ in range(count):
        chunk = choose.choice(chunks)
        at, bit = choose.randrange(chunk.start, chunk.data_end), 1 << choose.randrange(8)
        data[at] ^= bit
        bad.write_bytes(data)
        found += not verify(bad).ok
        data[at] ^= bit
    return Figure(
        f"{count} random byte flips in chunks", "all found by verify", f"{found} of {count} found", found == count,
        {"flips": count, "found": found},
    )  # fmt: skip


FULL = textwrap.dedent(
    """
    import resource, sys, time
    from benchmarks.recording.stream import Values, schedule
    from recordings.errors import WriteFailed
    from recordings.file.writer import Recorder
    values, recorder = Values(), Recorder(sys.argv[1], start_wall_ns=time.time_ns(), keep=60.0)
    begin, full, limit = time.monotonic(), 0.0, 300_000
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    write = recorder._disk.write
    def noted(data):
        global full
        try:
            return write(data)
        except OSError:
            full = time.monotonic()
            raise
    recorder._disk.write = noted
    try:
        for t, topic, k in schedule(60.0, 2.0):
            while (wait := t - (time.monotonic() - begin)) > 0:
                time.sleep(wait)
            recorder.push(topic, t, values.of(topic, k, t))
    except WriteFailed as error:
        print(time.monotonic() - full, error)
    try:
        recorder.close("failed")
    except WriteFailed:
        pass
    """
)


def full_disk(folder: Path) -> Figure:
    """How long after the disk is full the one who records is told; what is there must be recoverable."""
    path = folder / "full.mcap"
    done = subprocess.run([sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, check=True)
    seconds, _, text = done.stdout.partition(" ")
    result = recover(path, folder / "full-recovered.mcap")
    told = "recording stopped" in text and "lab recover" in text
    return Figure(
        "disk full",
        "told within 1 s, file recoverable, error says so",
        f"told after {float(seconds) * 1e3:.1f} ms, {result.seconds_kept:.1f} s recovered, {result.holes} holes",
        float(seconds) < 1.0 and told and result.holes == 0 and result.seconds_kept > 0.5,
        {"told_after_s": float(seconds), "recovered_s": result.seconds_kept},
    )


def start_up(folder: Path) -> Figure:
    """From nothing to header, schemas and attachments on the disk."""
    worst = []
    attachments = {"rig.yaml": bytes(3000), "robot.yaml": bytes(3000), "protocol.yaml": bytes(3000)}
    for number in range(20):
        begin = time.perf_counter()
        recorder = Recorder(folder / f"start-{number}.mcap", start_wall_ns=0, attachments=attachments)
        worst.append(time.perf_counter() - begin)
        recorder.close("completed")
    middle = sorted(worst)[10]
    return Figure(
        "header, schemas, rig and protocol on disk", "<= 50 ms of start", f"{middle * 1e3:.1f} ms (median of 20)",
        middle <= 0.05, {"median_s": middle, "worst_s": max(worst)},
    )  # fmt: skip
