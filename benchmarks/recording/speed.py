"""How fast recordings begin, are written and read."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from numpy.typing import NDArray

from recordings.campaign.replay import replay
from recordings.file.reader import Recording
from recordings.file.writer import Recorder

from ..figures import Figure
from .stream import TOTAL, Values, schedule

DENSE = 10.0
"""Seconds of the rig in one host second where only drops are counted: the writer then needs about a quarter of a processor."""
LEAD_NS = 500_000_000
"""Of host time in which the threads get ready."""
PRODUCERS = (("/force",), ("/arm",), ("/tip",), ("/pressure", "/spine", "/valve", "/vacuum"))
"""Streams by the thread that brings them, as in a run."""


def paced(folder: Path, wall: float) -> Figure:
    """Twice the rig's rates: `wall` host seconds at their true pace for the delays, and DENSE times as many messages within the
    same time again for the drops (a harder task)."""
    true = paced_run(folder / "true.mcap", wall, wall)
    dense = paced_run(folder / "dense.mcap", wall, DENSE * wall)
    p50, p99, p999 = np.quantile(true.delays, (0.5, 0.99, 0.999)).tolist()
    crowded = float(np.quantile(dense.delays, 0.999))
    dropped = true.dropped + dense.dropped
    return Figure(
        f"{dense.messages / TOTAL / 2:.0f} s at twice the rig's rates "
        f"({true.messages} messages at {true.messages / wall:.0f}/s, then "
        f"{dense.messages} in {wall:g} s)",
        "0 dropped, enqueue p99.9 <= 50 us",
        f"{dropped} dropped; p50 {p50:.1f}, p99 {p99:.1f}, p99.9 {p999:.1f} us ({DENSE:g} times as dense: {crowded:.0f} us); "
        f"{dense.size / 1e6:.1f} MB",
        dropped == 0 and p999 <= 50.0,
        {"dropped": dropped, "p50_us": p50, "p99_us": p99, "p999_us": p999, "crowded_p999_us": crowded, "bytes": dense.size},
    )  # fmt: skip


@dataclass(frozen=True)
class Paced:
    """How long each push took (us), messages pushed and dropped, the file's size (bytes)."""

    delays: NDArray[np.float64]
    messages: int
    dropped: int
    size: int


def paced_run(path: Path, wall: float, seconds: float, factor: float = 2.0) -> Paced:
    """`seconds` of the rig at `factor` times its rates within `wall` host seconds, by one thread a source. Stamps of messages at
    their true pace are those of the host's clock."""
    recorder = Recorder(path, start_wall_ns=time.time_ns() + LEAD_NS, keep=60.0)
    took: list[int] = []
    begin = time.monotonic() + LEAD_NS / 1e9

    def produce(topics: tuple[str, ...]) -> None:
        values, out = Values(), []
        for t, topic, k in schedule(seconds, factor):
            if topic not in topics:
                continue
            ready = values.of(topic, k, t)
            while (wait := begin + t * wall / seconds - time.monotonic()) > 0:
                time.sleep(wait)
            before = time.perf_counter_ns()
            recorder.push(topic, t, ready)
            out.append(time.perf_counter_ns() - before)
        took.extend(out)

    threads = [threading.Thread(target=produce, args=(topics,)) for topics in PRODUCERS]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    dropped = sum(count.dropped for count in recorder.close("completed").values())
    return Paced(np.array(took) / 1e3, len(took), dropped, path.stat().st_size)


def best(times: int, do: Callable[[], object]) -> float:
    """Seconds of the fastest of several goes."""
    out = []
    for _ in range(times):
        begin = time.perf_counter()
        do()
        out.append(time.perf_counter() - begin)
    return min(out)


def reading(hour: Path, short: Path, topic: str = "/arm") -> Figure:
    """One stream of seven, into an array; the library's decoder reads the same stream of a shorter file in this run."""
    counts: list[int] = []
    ours = best(5, lambda: counts.append(len(Recording.open(hour).stream(topic))))
    theirs_count = 0

    def by_library() -> None:
        nonlocal theirs_count
        with open(short, "rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            theirs_count = sum(1 for _ in reader.iter_decoded_messages(topics=[topic]))

    theirs = best(2, by_library)
    rate, slow = counts[-1] / ours, theirs_count / theirs
    return Figure(
        f"reading one stream of seven ({topic}, {counts[-1]} of {TOTAL * 3600} messages)",
        ">= 1 M messages/s, >= 10x the mcap-protobuf decoder in the same run",
        f"{rate / 1e6:.2f} M/s, {rate / slow:.0f}x ({slow / 1e3:.0f} k/s)",
        rate >= 1e6 and rate >= 10 * slow,
        {"per_s": rate, "library_per_s": slow, "times": rate / slow},
    )


def table(hour: Path) -> Figure:
    """One hour of the rig: every state read again from the samples."""
    rows: list[int] = []
    took = best(2, lambda: rows.append(len(replay(hour))))
    return Figure(
        f"one hour of the rig ({TOTAL * 3600 / 1e6:.2f} M messages) to a trials table",
        "<= 10 s", f"{took:.2f} s, {rows[-1]} rows", took <= 10 and rows[-1] == 180, {"s": took, "rows": rows[-1]},
    )  # fmt: skip


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
