"""Keys at the terminal of a run: one letter is a request; after `n` a line is typed, which goes on beside the run.

A thread of its own reads the terminal, which is in cbreak mode meanwhile: keys come one by one and are not echoed, Ctrl-C and
Ctrl-Z act as ever. The mode is put back whenever somebody else reads the terminal: an operator who is asked, a shell
that gets it back by Ctrl-Z, whoever comes after the run. A run in the background leaves the terminal alone.
"""

from __future__ import annotations

import codecs
import contextlib
import os
import signal
import termios
import tty
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

import timing
from protocols.errors import BadRequest
from protocols.steering import LONGEST, Steering

HELP = "keys: p pause after this state, n note, r read this state again, s skip this trial, q end after this step"
BY = "terminal"
KINDS = {"r": "repeat", "s": "skip", "q": "finish"}
LOOK = 0.2
"""Host seconds between two looks whether this run has the terminal again."""
ENTER, RUBOUT, KILL, ESCAPE = "\r\n", "\x7f\x08", "\x15", "\x1b"


class Line:
    """What was typed so far, and what it means; pure. `show(text)` shows a line that is being typed, None none."""

    def __init__(self, steering: Steering, say: Callable[[str], None], show: Callable[[str | None], None]) -> None:
        self._steering, self._say, self._show = steering, say, show
        self._typed: str | None = None
        """The note so far; None: keys are requests."""

    def take(self, text: str) -> None:
        """Take keys that came in one piece: requests, or letters of a note. What follows the end of a note was pasted."""
        for key in text:
            if key == ESCAPE:  # alone, or the begin of what an arrow key sends
                if text == ESCAPE:
                    self.end()
                return
            if self._typed is None:
                self._key(key)
            elif key in ENTER:
                typed = self._typed
                self.end()
                if typed.strip():
                    self._ask("note", typed)
                return
            else:
                self._type(key)

    def _key(self, key: str) -> None:
        steering = self._steering
        if key == "n":
            self._typed = ""
            self._show("")
        elif key in KINDS:
            self._ask(KINDS[key])
        elif key == "p" and not steering.waiting:
            self._ask("pause")
        elif key == "p" or steering.resting:
            self._ask("go on")

    def _type(self, key: str) -> None:
        assert self._typed is not None
        if key == KILL:
            self._typed = ""
        elif key in RUBOUT:
            self._typed = self._typed[:-1]
        elif key.isprintable():
            self._typed = (self._typed + key)[:LONGEST]
        self._show(self._typed)

    def end(self) -> None:
        """A note that is being typed is given up."""
        if self._typed is not None:
            self._typed = None
            self._show(None)

    def _ask(self, kind: str, text: str = "") -> None:
        try:
            self._steering.ask(kind, BY, text)
        except BadRequest as e:
            self._say(str(e))


class Keys:
    """Reads a terminal between `with` and its end. `fd`: its descriptor."""

    def __init__(self, fd: int, line: Line) -> None:
        self._fd, self._line = fd, line
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")
        self._before: list[Any] | None = None
        """The mode to put back; None while it is as it was."""
        self._lock = timing.RLock()
        """Held while the terminal is read or its mode is changed."""
        self._lent = 0
        self._wake, self._woken = -1, -1
        self._thread = timing.Thread(target=self._run, name="keys", daemon=True)
        self._stop_signal: Any = None

    def __enter__(self) -> Keys:
        self._woken, self._wake = os.pipe()
        with contextlib.suppress(ValueError):  # not the main thread, which alone receives signals
            self._stop_signal = signal.signal(signal.SIGTSTP, self._suspended)
        self._take()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._lent += 1
        os.write(self._wake, b"x")
        self._thread.join()
        self._give_back()
        if self._stop_signal is not None:
            signal.signal(signal.SIGTSTP, self._stop_signal)
        os.close(self._wake)
        os.close(self._woken)

    @contextlib.contextmanager
    def lent(self) -> Iterator[None]:
        """The terminal as it was, for somebody who asks the person a question."""
        with self._lock:
            self._lent += 1
            self._give_back()
            self._line.end()
        try:
            yield
        finally:
            with self._lock:
                self._lent -= 1
                if not self._lent:
                    self._take()

    def _suspended(self, number: int, frame: FrameType | None) -> None:
        """Ctrl-Z: the shell gets its terminal as it was; back from there it is taken again."""
        with self.lent():
            signal.signal(signal.SIGTSTP, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGTSTP)  # here the program stands until it is continued
            signal.signal(signal.SIGTSTP, self._suspended)

    @property
    def _foreground(self) -> bool:
        """Whether the terminal is this program's: to touch that of others would stop it."""
        try:
            return os.tcgetpgrp(self._fd) == os.getpgrp()
        except OSError:
            return False

    def _take(self) -> None:
        """Keys one by one from now on; what was typed before means nothing."""
        if self._before is not None or not self._foreground:
            return
        with contextlib.suppress(termios.error):
            before = termios.tcgetattr(self._fd)
            tty.setcbreak(self._fd, termios.TCSANOW)
            termios.tcflush(self._fd, termios.TCIFLUSH)
            self._before = before

    def _give_back(self) -> None:
        before, self._before = self._before, None
        if before is not None and self._foreground:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(self._fd, termios.TCSANOW, before)

    def _run(self) -> None:
        """The thread that reads: while the terminal is this run's and not lent, hand what was typed to the line."""
        while True:
            terminal = [self._fd] if self._before is not None and self._foreground else []
            try:
                ready = timing.readable([self._woken, *terminal], LOOK)
            except OSError:
                return
            if self._woken in ready:
                return
            with self._lock:
                if self._lent:
                    continue
                self._take()
                text = self._typed()
            if text is None:
                return
            self._line.take(text)

    def _typed(self) -> str | None:
        """What has come; None at the end of a terminal that is gone."""
        if self._before is None or not self._foreground or not timing.readable([self._fd], 0.0):
            return ""
        try:
            data = os.read(self._fd, 1024)
        except OSError:
            return None
        return self._decoder.decode(data) if data else None
