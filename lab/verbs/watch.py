"""`lab watch`: show a run live in the browser, or play a recording; on request in Foxglove too."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import signal
import sys
import threading
import time
from pathlib import Path

from recordings.file.tail import Tail, ended

from ..console import out
from ..files.checked import recording_of
from ..files.config import ConfigError
from ..live.beside import opened_in_browser
from ..live.foxglove_server import LAYOUT, Foxglove
from ..live.show import LOOPBACK, PageAddress, Show, ShownRecording, place
from ..options import READS, Result, Verb, option, path_option
from ..plain import typed

LOOK = 0.2
"""Host seconds between two checks for a new run of the rig."""
GOING_ON = 3.0
"""A run counts as active for this many host seconds after its recording last grew; it grows ten times a second."""


def watch(what: Path, speed: float | None, bind: str, port: int, browser: bool, foxglove: int | None = None) -> Result:
    """Serve the page of a recording, or of a rig.yaml's runs, until Ctrl-C; `foxglove`: the port at which Foxglove finds it."""
    if speed is not None and not speed > 0:
        raise ConfigError(f"--speed {speed:g}: must be above 0, as a multiple of rig time")
    file = recording_of(what) if what.suffix in (".yaml", ".yml") else what
    if file is what:
        with Tail(what):  # refuses what is no recording
            pass
    going_on = not ended(file) and time.time() - file.stat().st_mtime < GOING_ON
    if going_on and speed is not None:
        raise ConfigError(f"--speed: {file} is being written; an active run is shown live")
    if what != file and not going_on:
        raise ConfigError(f"{what}: no run is active; to play its last recording: {typed('lab', 'watch', file)}")
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell starts background jobs with SIGINT ignored
    page = listening(bind, port)
    with contextlib.ExitStack() as until_known:
        until_known.enter_context(page.listening)
        other = None if foxglove is None else until_known.enter_context(_foxglove(bind, foxglove))
        servers = until_known.pop_all()

    def serve() -> None:
        with servers:
            if browser and sys.stdout.isatty():
                opened_in_browser(page.address)
            show = Show(page, ShownRecording(file, more=what != file), None if going_on else speed or 1.0, foxglove=other)
            if what != file:
                threading.Thread(target=_follow, args=(show, what, file), name="watch-rig", daemon=True).start()
            with contextlib.suppress(KeyboardInterrupt):
                show.run(stay=True)

    data = {"address": page.address, "file": str(file), "live": going_on}
    data |= {} if other is None else {"foxglove": other.address, "layout": str(LAYOUT)}
    return Result(data, lambda: _tell(file, going_on, page, other), then=serve)


def _follow(show: Show, rig: Path, file: Path) -> None:
    """Go on with each further run of a rig."""
    while True:
        time.sleep(LOOK)
        with contextlib.suppress(ConfigError):
            if (newest := recording_of(rig).resolve()) != file.resolve():
                show.follow(ShownRecording(newest, more=True))
                file = newest


def _tell(file: Path, going_on: bool, page: PageAddress, other: Foxglove | None) -> None:
    """Where to look."""
    shows = "shows the run that goes on" if going_on else f"plays {file}"
    if other is not None:
        when = "" if going_on else "; the recording is played from the first subscription on"
        out.print(f"{other.address} is for Foxglove and Lichtblick (Foxglove WebSocket){when}", soft_wrap=True)
        out.print(f"{LAYOUT} is a layout for both", soft_wrap=True)
    out.print(f"{page.address} {shows}; Ctrl-C ends it", soft_wrap=True)


def _foxglove(bind: str, port: int) -> Foxglove:
    """Return the server for Foxglove, which has no secret and serves this computer only. Raises ConfigError."""
    if not ipaddress.ip_address(bind).is_loopback:
        raise ConfigError(
            f"--foxglove --bind {bind}: Foxglove has no secret, so anybody on the network could watch. Leave out --bind; from "
            f"another computer use a tunnel: ssh -L 8765:{LOOPBACK}:{port or 8765} THIS-COMPUTER"
        )
    return Foxglove(bind, port)


def listening(bind: str, port: int) -> PageAddress:
    """Return the address of the page. Raises ConfigError if it cannot be used."""
    try:
        ipaddress.ip_address(bind)
    except ValueError:
        raise ConfigError(f"--bind {bind}: must be an address of this computer, such as {LOOPBACK}") from None
    if not 0 <= port < 2**16:
        raise ConfigError(f"--port {port}: must be 0 (any that is free) to 65535")
    try:
        return place(bind, port)
    except OSError as e:
        raise ConfigError(f"--bind {bind} --port {port}: cannot listen there: {os.strerror(e.errno or 0)}") from e


VERBS = (
    Verb(
        "watch",
        lambda a: watch(a.what, a.speed, a.bind, a.port, not a.no_browser, a.foxglove),
        options=(
            *READS,
            path_option("what", "FILE|RIG", "a recording (.mcap), or the rig.yaml of the run"),
            option("--speed", type=float, help="play a recording this many times faster than rig time (default 1)"),
            option("--bind", "ADDRESS", "listen there, for other computers (default: this one only)", default="127.0.0.1"),
            option("--port", type=int, default=0, help="listen at this port (default: any that is free)"),
            option("--no-browser", action="store_true", help="print the address only"),
            option(
                "--foxglove",
                "PORT",
                "the same streams to Foxglove and Lichtblick, on this computer (default port 8765)",
                nargs="?",
                type=int,
                const=8765,
            ),
        ),
        examples=("lab watch rig/rig.yaml", "lab watch runs/sweep.mcap --speed 10"),
        page="docs/howto/watch.md",
    ),
)
