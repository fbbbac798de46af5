"""What a person sees while something runs: lines of text, and progress with time left (quiet when not a terminal).

All of it goes through `out` and `err`, which take text as it is: nothing in it is markup, and what would act on a
terminal is written out. Colour is given beside a text, by `style=` or `styled`.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import sys
import time
import traceback
from collections.abc import Iterable, Iterator, Sequence
from typing import IO, Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.protocol import is_renderable
from rich.table import Column, Table
from rich.text import Text

from .plain import plain


class PlainConsole(Console):
    """A console that prints text plain, in tables too."""

    def __init__(self, stderr: bool = False, file: IO[str] | None = None, width: int | None = None) -> None:
        super().__init__(stderr=stderr, file=file, width=width, markup=False, highlight=False, emoji=False)

    def render_str(self, text: str, **how: Any) -> Text:
        """Every string that is printed or stands in a table comes through here."""
        return super().render_str(plain(text), **how)

    def print(self, *objects: Any, **how: Any) -> None:
        """See Console.print; what is no text (a path, an error) is turned into it first."""
        super().print(*(o if is_renderable(o) else str(o) for o in objects), **how)

    def __exit__(self, *raised: Any) -> None:
        """See Console; all that is printed is written here."""
        try:
            super().__exit__(*raised)
        except OSError:
            self.on_broken_pipe()

    def on_broken_pipe(self) -> None:
        """Nobody reads any more (`lab run | head`, a full disk): go on in silence, because a run must come to its end."""
        self.quiet = True
        nowhere = os.open(os.devnull, os.O_WRONLY)
        with contextlib.suppress(OSError, ValueError):
            os.dup2(nowhere, self.file.fileno())
        os.close(nowhere)


out = PlainConsole()
err = PlainConsole(stderr=True)


def questions() -> PlainConsole:
    """Return where a person who must answer reads the question: not among the JSON of a program."""
    return err if out.quiet else out


def styled(text: str, style: str) -> Text:
    """Text in a style, for a table's cell or a part of a line."""
    return Text(plain(text), style)


def titled(title: str, columns: Iterable[Column | str], rows: Iterable[Sequence[str]] = (), numbers: Iterable[str] = ()) -> Table:
    """A table under its title; columns of `numbers` stand behind the others and end at the right."""
    table = Table(*columns, *(Column(name, justify="right") for name in numbers), title=title, title_justify="left")
    for row in rows:
        table.add_row(*row)
    return table


def complain(text: str) -> None:
    """One message to stderr, its lines as they are."""
    err.print(text, soft_wrap=True)


def answer(result: object, one_line: bool = False) -> None:
    """Print the result as JSON, for a program that reads it; None prints nothing."""
    try:
        if result is not None:
            print(json.dumps(result, indent=None if one_line else 1), flush=True)
    except OSError:
        out.on_broken_pipe()


def plain_failures() -> None:
    """From now on print logs of libraries and tracebacks plain, too, and write out characters that the terminal's encoding does
    not have. A standard stream that is closed is opened on the null device: else a recording would get its descriptor."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            with contextlib.suppress(OSError):
                os.fstat(number)
                continue
            setattr(sys, name, open(os.devnull, "r+" if number else "r", encoding="utf-8"))  # noqa: SIM115 - as long as the program
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    handler = logging.StreamHandler()
    handler.setFormatter(_PlainFormatter("%(name)s: %(message)s"))
    logging.basicConfig(level=logging.ERROR, handlers=[handler])
    sys.excepthook = lambda kind, error, trace: complain("".join(traceback.format_exception(kind, error, trace)).rstrip("\n"))


class _PlainFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return plain(super().format(record))


def note(texts: Iterable[str]) -> None:
    """Doubts that do not stop anything, beside the result."""
    for text in texts:
        err.print(f"note: {text}")


def warn(texts: Iterable[str]) -> None:
    """What a person should see to, such as an instrument that is not as it should be."""
    for text in texts:
        err.print(f"warning: {text}")


class _Bar(Progress):
    """Progress, and below it where the run can be watched and a line that somebody is typing."""

    address: str | None = None
    typed: str | None = None
    prompt = "note: {}_  (Enter writes it down, Esc does not)"

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        if self.address is not None:
            yield Text(plain(f"watch it at {self.address}"), overflow="fold")
        if self.typed is not None:
            yield Text(plain(self.prompt.format(self.typed)), overflow="fold")


LONG_STEP, MOST_LONGER = 20.0, 3.0
"""s, after which a step says once how long it will take where no bar shows it; how many times longer than in proportion that may
be: a hypothesis may bring others, which take longer."""


class Screen:
    """Narrator of protocols: says lines, shows how far they are and how long it will take at the rig's speed."""

    def __init__(self, title: str, speed: float = 1.0, quiet: bool = False) -> None:
        self._title, self._speed = plain(title), speed
        self.quiet_asked = quiet
        self.quiet = quiet = quiet or out.quiet
        self._progress = _Bar(
            TextColumn("{task.description}", markup=False), BarColumn(bar_width=30),
            TextColumn("{task.percentage:3.0f} %", markup=False), TimeElapsedColumn(),
            TextColumn("{task.fields[left]}", markup=False), console=out, transient=True,
            disable=quiet or not sys.stdout.isatty(),
        )  # fmt: skip
        self._task: TaskID | None = None
        self._began = time.monotonic()
        self._first: float | None = None
        self._step, self._said = ("", self._began), False
        """The step under way and when it began (host s), and whether its time was said."""
        self._part: tuple[float, float] | None = None

    def __enter__(self) -> Screen:
        if self._part is None:
            self._progress.start()
            self._task = self._progress.add_task(self._title, total=1.0, left="")
        return self

    def __exit__(self, *_: object) -> None:
        if self._part is None:
            self.stop()

    def stop(self) -> None:
        """Take the progress off the screen, until the next step."""
        self._progress.stop()
        if self._task is not None:
            self._progress.remove_task(self._task)
            self._task = None

    @contextlib.contextmanager
    def part(self, before: float, total: float) -> Iterator[None]:
        """What enters the screen in this block is a part of what it shows: `before` s of `total` (0: none counts) are over."""
        self._part = before, total
        try:
            yield
        finally:
            self._part = None

    def say(self, text: str) -> None:
        """Something that has happened."""
        if not self.quiet:
            self._progress.console.print("  " + text.replace("\n", "\n    "))

    def watched(self, address: str) -> None:
        """Where the run can be watched: said once, and shown below the progress as long as that is."""
        if self._progress.address != address:
            self._progress.address = address
            self.say(f"watch it at {address}")

    def typed(self, text: str | None) -> None:
        """A line that the person is typing, so far; None: none any more."""
        self._progress.typed = text
        self._progress.refresh()

    def prompt(self, prompt: str) -> None:
        """How such a line is shown: a text with {} for it."""
        self._progress.prompt = prompt

    def step(self, name: str, share: float) -> None:
        """A step whose time is not known, such as "step 2 of 5: hypotheses", and the share of it that is done; shown at once."""
        if self._task is None:
            self.__enter__()
        if self._task is not None:
            self._progress.update(self._task, description=plain(f"{self._title}, {name}"), completed=share)
        if name != self._step[0]:
            self._step, self._said = (name, time.monotonic()), False
        lasted = time.monotonic() - self._step[1]
        left = lasted * (1 / share - 1) if share > 0 else 0.0
        if share > 0 and left < 1.0:
            return
        known = f"about {clock(left)} to {clock(MOST_LONGER * left)} left in this step"
        self._say_long(lasted, known if share > 0 else "how long it takes is not known yet")

    def _say_long(self, lasted: float, left: str) -> None:
        """Say once of a step that has lasted so long (s), and where no bar shows it, what it is and how long it will take."""
        if self._said or lasted < LONG_STEP or self.quiet_asked or sys.stdout.isatty():
            return
        self._said = True
        name = f", {self._step[0]}" if self._step[0] else ""
        complain(f"{self._title}{name}: {left}")

    def progress(self, done: float, total: float) -> None:
        """Seconds of rig time done, of the total planned; the time left is corrected by the pace kept so far."""
        if self._part is not None:
            done, total = self._part[0] + done, self._part[1]
        if self._task is None or total <= 0:
            return
        elapsed = time.monotonic() - self._began
        if self._first is None:
            self._first = done  # a run that is resumed begins in the middle
        left = seconds_left(done - self._first, total - self._first, elapsed, self._speed)
        self._progress.update(self._task, completed=min(1.0, done / total), left=f"{clock(left)} left")
        self._say_long(elapsed, f"about {clock(left)} left")


def seconds_left(done: float, total: float, elapsed: float, speed: float) -> float:
    """Host seconds left: of `total` planned seconds of rig time `done` are over, which took `elapsed` host seconds."""
    pace = elapsed / done if done > 0.02 * total else 1 / speed
    return max(0.0, total - done) * pace


def clock(seconds: float) -> str:
    """Seconds as a person reads them: 0.5 s, 45 s, 12 min, 2 h 05 min."""
    s = max(0, round(seconds))
    if s < 90:
        return f"{s} s" if s >= 10 else f"{max(0.0, seconds):.2g} s"
    minutes = round(s / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
