"""A program at a real terminal: what it shows, and keys pressed."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import termios
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import timing

ACTS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
"""What moves the cursor or colours text."""
COLUMNS = 400
WITHIN = 300.0
UNASKED = "Enter when it is fixed"
"""Shown in a pause that no test asks for: the run would wait for a person for ever."""
LAB = (sys.executable, "-m", "lab.cli")


class Terminal(contextlib.AbstractContextManager["Terminal"]):
    """A program (`lab`) with these words, in a session of its own whose terminal this is. Use as a context."""

    def __init__(self, *words: object, program: Sequence[str] = LAB) -> None:
        self.master, self.slave = os.openpty()
        termios.tcsetwinsize(self.slave, (40, COLUMNS))
        self.before: list[Any] = termios.tcgetattr(self.slave)
        """Its mode when the program began."""
        number = self.slave
        self.program = subprocess.Popen(
            [*program, *map(str, words)], preexec_fn=lambda: os.login_tty(number), pass_fds=(number,),
            env={**os.environ, "TERM": "xterm", "COLUMNS": str(COLUMNS)},
        )  # fmt: skip
        self._shown = b""
        self._read = timing.Thread(target=self._listen, daemon=True)
        self._read.start()

    def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(self.master, 4096):
                self._shown += data

    @property
    def raw(self) -> str:
        """All that it has shown, with what acts on the terminal."""
        return self._shown.decode(errors="replace")

    @property
    def shown(self) -> str:
        """All that it has shown, as words between single blanks."""
        return " ".join(ACTS.sub("", self.raw).split())

    @property
    def mode(self) -> list[Any]:
        """The terminal's mode now."""
        return termios.tcgetattr(self.slave)

    def press(self, keys: str) -> None:
        """Keys, in one go."""
        os.write(self.master, keys.encode())

    def until(self, text: str, times: int = 1) -> None:
        """Wait until this was shown so often; AssertionError when the program ends before, or never shows it."""
        deadline = timing.now() + WITHIN
        while self.shown.count(text) < times:
            assert self.program.poll() is None and timing.now() < deadline, (text, self.shown[-3000:])
            assert UNASKED not in self.shown, (text, self.shown[-3000:])
            timing.sleep(0.02)

    def hang_up(self) -> None:
        """The terminal is closed, as by its window or a lost connection."""
        os.close(self.master)
        self.master = -1

    def end(self) -> int:
        """Its exit code, once it has ended; AssertionError with what it showed when it does not."""
        timing.wait(lambda: self.program.poll() is not None or UNASKED in self.shown, WITHIN)
        assert self.program.poll() is not None, self.shown[-3000:]
        return self.program.returncode

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.program.kill()
        self.program.wait()
        os.close(self.slave)
        self._read.join(10.0)
        if self.master >= 0:
            os.close(self.master)
