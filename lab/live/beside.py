"""The page beside a run: a process of its own, behind all others in line, that reads the file and nothing else.

What its viewers ask of the run comes back through a pipe, which a thread reads no faster than people ask.
"""

from __future__ import annotations

import contextlib
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

from .show import LOOPBACK, place

BY = "page"
LONGEST_LINE = 4096
"""Bytes of a request: such a line is written to a pipe whole or not at all."""
PACE = 0.1
"""Host seconds between two requests that are taken."""


@contextlib.contextmanager
def shown_beside(
    file: Path,
    bind: str = LOOPBACK,
    port: int = 0,
    browser: bool = False,
    ask: Callable[[str, str, str], object] = lambda kind, by, text: None,
) -> Iterator[str]:
    """Have a recording that is about to be written shown while the block runs; yields the address. Raises OSError.

    `ask` is told what viewers ask, as `Steering.ask`, from a thread of its own.
    The socket listens at once, so that the run does not wait for the process that answers there.
    """
    at = place(bind, port)
    address = at.address
    with at.listening:
        number = at.listening.fileno()
        process = subprocess.Popen(
            [sys.executable, "-m", "lab.live", str(file), str(number), "open" if browser else "quiet"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            pass_fds=(number,),
            start_new_session=True,
        )
    assert process.stdin is not None and process.stdout is not None
    threading.Thread(target=_listen, args=(process.stdout, ask), name="live-requests", daemon=True).start()
    try:
        with contextlib.suppress(OSError):
            process.stdin.write(at.token.encode() + b"\n")
            process.stdin.flush()
        yield address
    finally:
        with contextlib.suppress(OSError):
            process.stdin.close()


def _listen(pipe: IO[bytes], ask: Callable[[str, str, str], object]) -> None:
    """Pass on what is asked at the page until its process ends; what is no request is passed over."""
    with pipe:
        while line := pipe.readline(LONGEST_LINE):
            with contextlib.suppress(ValueError, KeyError, TypeError, AttributeError):
                told = read_json(line)
                ask(told["kind"], BY, told["text"])
            time.sleep(PACE)


def opened_in_browser(address: str) -> None:
    """Open a page in the person's browser where there is a screen for one, without waiting for it."""
    if sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        threading.Thread(target=webbrowser.open, args=(address,), name="live-browser", daemon=True).start()
