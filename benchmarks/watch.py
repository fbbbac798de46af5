"""What looking at a run costs it, and how old what is seen is.

    python -m benchmarks.watch [--seconds S] [--json FILE]

The rig's streams are recorded at their true pace, in turn without anybody looking and with ten who look, one of whom takes
nothing of what is sent to him. Stamps are those of the host's clock, so that the age of what a viewer has is known.
"""

from __future__ import annotations

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from lab.live.beside import Page
from model.arrays import Array

from .figures import Figure, show
from .recording.speed import Paced, paced_run
from .recording.stream import TOTAL

VIEWERS = 10
TURNS = 3


@dataclass
class Viewer:
    """Somebody who looks; `ages` in s of the newest sample at each update."""

    address: str
    takes: bool = True
    ages: list[float] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    """Samples of each stream, as told last."""
    begun: threading.Event = field(default_factory=threading.Event)
    """The first line has come."""

    def look(self) -> None:
        """Until whoever serves ends."""
        where = urlsplit(self.address)
        with socket.create_connection((where.hostname, where.port), timeout=60.0) as wire:
            if not self.takes:
                wire.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            wire.sendall(f"GET {where.path}events HTTP/1.1\r\nHost: bench\r\n\r\n".encode())
            if not self.takes:
                self._done.wait()
                return
            for line in wire.makefile("rb"):
                self.begun.set()
                if line.startswith(b"data: "):
                    self._take(json.loads(line[6:]))

    def _take(self, data: dict[str, object]) -> None:
        now = time.time()
        if "points" in data:
            clock, t, sent = (float(data[key]) for key in ("clock", "t", "sent"))  # type: ignore[arg-type]
            self.ages.append(now - (sent / 1e3 - (clock - t)))
        streams = data.get("streams")
        if isinstance(streams, dict):
            self.counts |= {topic: s["count"] for topic, s in streams.items()}

    def __post_init__(self) -> None:
        self._done = threading.Event()
        self._thread = threading.Thread(target=self.look, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Wait until it has seen the end."""
        self._done.set()
        self._thread.join()


def look(address: str) -> None:
    """Ten who look, the last one stuck, in a process of their own; prints what those who take something have seen."""
    viewers = [Viewer(address, takes=k < VIEWERS - 1) for k in range(VIEWERS)]
    for viewer in viewers[:-1]:
        viewer.begun.wait()
    print("looking", flush=True)
    for viewer in viewers[:-1]:
        viewer.end()
    seen = [viewer for viewer in viewers if viewer.takes]
    print(json.dumps([{"ages": v.ages, "count": sum(v.counts.values())} for v in seen]))


@contextmanager
def page_of(file: Path) -> Iterator[str]:
    """The address of a page beside a recording that is about to be written."""
    with Page() as page:
        page.show(file, lambda kind, by, text: None)
        yield page.address


@contextmanager
def looked_at(file: Path) -> Iterator[list[dict[str, Any]]]:
    """The page beside a recording that is about to be written, and those who look; filled with what they saw at the end."""
    seen: list[dict[str, Any]] = []
    with page_of(file) as address:
        command = [sys.executable, "-m", "benchmarks.watch", "--look", address]
        eyes = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert eyes.stdout is not None
        eyes.stdout.readline()
        yield seen
    out, _ = eyes.communicate(timeout=60.0)
    seen += json.loads(out)


def cost(folder: Path, seconds: float) -> list[Figure]:
    """Samples lost, delays of the writer's producers, ages at the viewers."""
    alone: list[Paced] = []
    beside: list[Paced] = []
    ages: list[Array] = []
    whole = True
    for turn in range(TURNS):
        alone.append(paced_run(folder / f"alone-{turn}.mcap", seconds, seconds, 1.0))
        file = folder / f"seen-{turn}.mcap"
        with looked_at(file) as seen:
            beside.append(paced_run(file, seconds, seconds, 1.0))
        ages += [np.array(viewer["ages"][20:]) for viewer in seen]
        whole &= all(viewer["count"] == beside[-1].messages for viewer in seen)
    before, after = (np.quantile(np.concatenate([p.delays for p in part]), (0.5, 0.99, 0.999)) for part in (alone, beside))
    spread = [np.quantile(p.delays, 0.999) for p in alone]
    age = np.quantile(np.concatenate(ages), (0.5, 0.99))
    lost = sum(p.dropped for p in beside)
    count = sum(p.messages for p in beside)
    return [
        Figure(
            f"{VIEWERS} viewers, one of them stuck: {count} samples at {TOTAL}/s",
            "0 lost, every viewer told of all", f"{lost} lost; all told: {'yes' if whole else 'NO'}", lost == 0 and whole,
            {"lost": lost, "samples": count},
        ),
        Figure(
            "the producers' delay with and without viewers",
            "p99.9 not above the largest turn without by more than a quarter",
            f"p99.9 {after[2]:.0f} us with, {before[2]:.0f} us without (turns {min(spread):.0f} to {max(spread):.0f}); p99 "
            f"{after[1]:.0f} and {before[1]:.0f}, p50 {after[0]:.1f} and {before[0]:.1f} us",
            bool(after[2] <= 1.25 * max(spread)),
            {"with_p999_us": float(after[2]), "without_p999_us": float(before[2]), "without_most_us": float(max(spread))},
        ),
        Figure(
            "age of the newest sample when an update has arrived", "p99 <= 250 ms",
            f"p50 {age[0] * 1e3:.0f}, p99 {age[1] * 1e3:.0f} ms", bool(age[1] <= 0.25),
            {"p50_ms": float(age[0] * 1e3), "p99_ms": float(age[1] * 1e3)},
        ),
    ]  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    p = argparse.ArgumentParser(description="Measures what looking at a run costs it.")
    p.add_argument("--seconds", type=float, default=60.0, help="of each turn (default 60)")
    p.add_argument("--json", type=Path, default=Path("out/watch.json"), help="where the table is written as JSON")
    p.add_argument("--look", metavar="ADDRESS", help=argparse.SUPPRESS)
    a = p.parse_args(arguments)
    if a.look:
        look(a.look)
        return 0
    with tempfile.TemporaryDirectory(prefix="watch-", ignore_cleanup_errors=True) as name:
        figures = cost(Path(name), a.seconds)
    return show("A run that is looked at", figures, a.json)


if __name__ == "__main__":
    raise SystemExit(main())
