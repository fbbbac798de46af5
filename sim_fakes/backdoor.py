"""The door into the fakes that no real instrument has: JSON lines over a Unix socket that only its own
user can reach.

    {"prepare": {"mount": "spine", "tip_mass": 0.0, "roll_deg": 0.0, "vacuum": 80000.0}}   what the person at the rig does
    {"confirm": "what was wrong"}                     a person has put it right; sets free what was held by `person`
    {"state": true}                                                                       what the plant is doing
    {"faults": {"pressure": {"silent": true}}}                                            faults of a serial fake
    {"fault": ["spine", "half"]}, {"fault": null}                                         one of sim_fakes/faults.py; none
    {"drop_out": ["pressure", 0.5]}                                                       a cable is out for so long, host s
    {"panel": ["pressure", "A", "unit", "psi"]}, {"panel": ["pressure", "A", "unlock"]}                   a person at a panel
    {"accident": "burst"}, {"accident": null}                                             one of sim_fakes/faults.py; none
    {"tip_visible": false}                                                                hide the tip from the cameras
    {"ur": {"do": "protective_stop"}}                                                     passed on to the arm's controller

Each line is answered by {"ok": true, ...} or {"error": "..."}.
"""

from __future__ import annotations

import contextlib
import json
import socket
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import timing

LOOK = 0.05
"""Host seconds between two looks whether it has been stopped."""


class BackDoor:
    """Serves a rig of fakes at a socket in a folder of its own; `do` does one request and returns what more is answered."""

    def __init__(self, do: Callable[[str, Any], dict[str, Any]]) -> None:
        self._do = do
        self._folder = tempfile.TemporaryDirectory(prefix="softlab-")  # of mode 0700
        self.path = Path(self._folder.name) / "operator.sock"
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._listening.bind(str(self.path))
        self._listening.listen()
        self._running = True
        self._thread = timing.Thread(target=self._serve, name="fake-backdoor")

    def start(self) -> None:
        """Accept connections."""
        self._thread.start()

    def stop(self) -> None:
        """End; may be called twice and before start."""
        self._running = False
        if self._thread.is_alive():
            self._thread.join(1.0)
        self._listening.close()
        self._folder.cleanup()

    def _serve(self) -> None:
        while self._running:
            if timing.readable([self._listening], LOOK):
                caller, _ = self._listening.accept()
                timing.Thread(target=self._hear, args=(caller,), name="fake-backdoor-caller").start()

    def _hear(self, caller: socket.socket) -> None:
        heard = b""
        with caller, contextlib.suppress(OSError):
            while more := timing.recv(caller, 65536):
                *lines, heard = (heard + more).split(b"\n")
                for line in lines:
                    caller.sendall(json.dumps(self.answer(line)).encode() + b"\n")

    def answer(self, line: bytes) -> dict[str, Any]:
        """Do what one line asks."""
        try:
            request = json.loads(line)
            extra: dict[str, Any] = {}
            for what, value in request.items():
                extra |= self._do(what, value)
        except (ValueError, KeyError, TypeError, AttributeError, RuntimeError, OSError) as e:
            return {"error": f"{type(e).__name__}: {e}"}
        return {"ok": True, **extra}
