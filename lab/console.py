"""What a person sees while something runs: lines of text, and progress with time left (quiet when not a terminal)."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


def note(texts: Iterable[str]) -> None:
    """Doubts that do not stop anything, beside the result."""
    for text in texts:
        err.print(f"note: {text}", markup=False)


class Screen:
    """Narrator of protocols: says lines, shows how far they are and how long it will take at the rig's speed."""

    def __init__(self, title: str, speed: float = 1.0, quiet: bool = False) -> None:
        self._title, self._speed, self._quiet = title, speed, quiet
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(bar_width=30), TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(), TextColumn("{task.fields[left]}"), console=out, transient=True,
            disable=quiet or not sys.stdout.isatty(),
        )  # fmt: skip
        self._task: TaskID | None = None
        self._began = time.monotonic()

    def __enter__(self) -> Screen:
        self._progress.start()
        self._task = self._progress.add_task(self._title, total=1.0, left="")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def say(self, text: str) -> None:
        """One line."""
        if not self._quiet:
            self._progress.console.print(f"  {text}")

    def progress(self, done: float, total: float) -> None:
        """Seconds of rig time done, of the total planned; the time left is corrected by the pace kept so far."""
        if self._task is None or total <= 0:
            return
        elapsed = time.monotonic() - self._began
        pace = elapsed / done if done > 0.02 * total else 1 / self._speed
        self._progress.update(self._task, completed=min(1.0, done / total), left=f"{clock((total - done) * pace)} left")


def clock(seconds: float) -> str:
    """Seconds as a person reads them: 45 s, 12 min, 2 h 05 min."""
    s = max(0, round(seconds))
    if s < 90:
        return f"{s} s"
    minutes = round(s / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
