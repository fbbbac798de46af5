"""The page next to a run: a process of its own, of lowest priority, that reads the file and nothing else.

Requests of its viewers come back through a pipe, which a thread reads no faster than people click.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

from recordings.json_text import read_json

from ..guard.child import start_child
from ..priority import BEHIND
from .show import place

BY = "page"

Ask = Callable[[str, str, str], object]
"""Receives the requests of viewers, as `Steering.ask`."""


class Page:
    """Shows a run, or runs that follow each other, one recording at a time, until it is closed.

    The socket listens at once, so that no run waits for the process that answers there. Raises OSError when it cannot.
    """

    def __init__(self, browser: bool = False) -> None:
        where = place()
        self.address = where.address
        self._part: tuple[str, bool] = ("", False)
        self._shown = 0
        self._ask: Ask = lambda kind, by, text: None
        with where.listening:
            pipe = subprocess.PIPE
            process = start_child(
                "lab.live",
                (where.listening.fileno(),),
                "open" if browser else "quiet",
                place=BEHIND,
                stdin=pipe,
                stdout=pipe,
                stderr=subprocess.DEVNULL,
            )
        assert process.stdin is not None and process.stdout is not None
        self._pipe = process.stdin
        os.set_blocking(self._pipe.fileno(), False)  # the run waits for no page
        self._write(where.token)
        threading.Thread(target=self._listen, args=(process.stdout,), name="live-requests", daemon=True).start()

    def part(self, text: str, more: bool) -> None:
        """Which part of a campaign is shown next, and whether more may follow."""
        self._part = (text, more)

    def show(self, file: Path, ask: Ask) -> None:
        """Show this recording, which is about to be written; a thread passes requests of viewers to `ask`."""
        self._shown, self._ask = self._shown + 1, ask
        text, more = self._part
        self._write(json.dumps({"file": str(file), "part": text, "more": more}))

    def _write(self, line: str) -> None:
        with contextlib.suppress(OSError):
            os.write(self._pipe.fileno(), line.encode() + b"\n")

    def _listen(self, pipe: IO[bytes]) -> None:
        """Pass on requests from the page until its process ends, except those meant for an earlier run."""
        with pipe:
            # a line of up to 4096 bytes is written to a pipe whole or not at all
            while line := pipe.readline(4096):
                with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError):
                    told = read_json(line)
                    if told["shown"] == self._shown:
                        self._ask(told["kind"], BY, told["text"])
                time.sleep(0.1)

    def close(self) -> None:
        """End the page; its viewers see that nothing follows."""
        with contextlib.suppress(OSError):
            self._pipe.close()


@contextlib.contextmanager
def page_where(wanted: bool, say: Callable[[str], None]) -> Iterator[Page | None]:
    """A page while the block runs, if wanted and possible; otherwise `say` gets the reason."""
    with contextlib.ExitStack() as beside:
        page = None
        if wanted:
            try:
                page = beside.enter_context(contextlib.closing(Page(browser=sys.stdout.isatty())))
            except OSError as e:
                say(f"no page: {e}")
        yield page


def opened_in_browser(address: str) -> None:
    """Open a page in the person's browser where there is a screen for one, without waiting for it."""
    if sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        threading.Thread(target=webbrowser.open, args=(address,), name="live-browser", daemon=True).start()
