"""Who prepares the rig: a person at the console, or a program that answers JSON lines at a Unix socket.

Whoever answers sets a paused rig going again, so the program must be of the same user: its socket lies in a folder that nobody
else may enter, and the kernel says who is at the other end.
"""

from __future__ import annotations

import json
import os
import socket
import stat
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import timing
from protocols.bench import Operator, Setup
from protocols.errors import ProtocolError, Stopped
from recordings.json_text import read_json

from ..console import questions
from ..files.rig_file import UNIX
from ..guard.door import peer

MOUNTS = {
    "robot": "mount the robot in its frame, as robot.yaml's gravity has it",
    "body": "mount the robot at the stiffness stand",
    "spine": "mount the bare spine at the stiffness stand",
}


def preparations(setup: Setup, before: Setup | None = None) -> str:
    """What a person does for a set-up, where `before` stands; None: it is not known what stands."""
    done = {
        "mount": MOUNTS[setup.mount] + ", spine inside" * (setup.mount == "robot" and setup.vacuum > 0),
        "tip_mass": f"hang {setup.tip_mass * 1e3:g} g at the tip" if setup.tip_mass else "no mass at the tip",
        "roll_deg": f"turn the mount to {setup.roll_deg:g} deg",
        "vacuum": f"set the vacuum supply to {setup.vacuum / 1e3:g} kPa below ambient",
    }
    if before is None and not setup.vacuum:  # perhaps there is none
        del done["vacuum"]
    return "; ".join(text for name, text in done.items() if before is None or getattr(setup, name) != getattr(before, name))


class NotPrepared(ProtocolError):
    """Nobody can say that the rig is prepared, so nothing moved."""


class Console:
    """Asks the person to prepare and waits for Enter; without a terminal it stops, unless all was said to be `prepared`."""

    def __init__(self, prepared: bool) -> None:
        self._prepared = prepared

    def prepare(self, setup: Setup) -> None:
        """See Operator.prepare."""
        questions().print(f"Prepare: {preparations(setup)}.")
        if self._prepared:
            return
        if not sys.stdin.isatty():
            raise NotPrepared(
                "nothing moved: nobody can confirm that all is prepared (not a terminal); have a program answer (operator: "
                "unix:/PATH in rig.yaml), or add --yes, only if nobody is within reach of the robot"
            )
        if _typed("Enter when ready, q to stop: ") == "q":
            raise Stopped("not prepared; nothing moved")

    def confirm(self, trouble: str) -> None:
        """See Operator.confirm; where nobody can type, nobody can confirm."""
        questions().print(f"Paused, vented and stopped: {trouble}")
        if not sys.stdin.isatty():
            raise Stopped(f"paused: {trouble}; nobody can confirm the repair (not a terminal)")
        if _typed("Press Enter when it is fixed and nobody is in the cell, q to stop: ") == "q":
            raise Stopped(f"stopped during a pause: {trouble}")


def _typed(question: str) -> str:
    """What the person answers, in lower case; raises Stopped at the end of a terminal (Ctrl-D, closed)."""
    try:
        return input(question).strip().lower()
    except (EOFError, OSError) as e:
        raise Stopped("stopped: the terminal was closed before an answer") from e


class Program:
    """Sends each set-up as one JSON line and waits for {"ok": true}."""

    def __init__(self, path: Path, within: float = 60.0) -> None:
        self.path, self.within = path, within

    def prepare(self, setup: Setup) -> None:
        """See Operator.prepare; ProtocolError when the program refuses or does not answer."""
        answer = self._ask({"prepare": asdict(setup)})
        if answer.get("ok") is not True:
            raise ProtocolError(f"{self._where}: refused to prepare {setup}: {answer}")

    def confirm(self, trouble: str) -> None:
        """See Operator.confirm; Stopped when the program refuses."""
        answer = self._ask({"confirm": trouble})
        if answer.get("ok") is not True:
            raise Stopped(f"paused: {trouble}; {self._where} does not confirm: {answer}")

    @property
    def _where(self) -> str:
        return f"operator at {self.path}"

    def _ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """Send a question and return the answer, a line of JSON each; raises ProtocolError where none comes or is believed."""
        try:
            self._check_folder()
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
                connection.settimeout(self.within)
                connection.connect(str(self.path))
                if (user := peer(connection)[1]) != os.getuid():
                    where = f"{self._where}: user {user} listens there, not you ({os.getuid()})"
                    raise ProtocolError(f"{where}; start the program as yourself")
                connection.sendall(json.dumps(question).encode() + b"\n")
                line = b""
                while b"\n" not in line and len(line) < 65536 and (more := timing.recv(connection, 4096)):
                    line += more
            answer = read_json(line.partition(b"\n")[0])
        except (OSError, ValueError) as e:
            raise ProtocolError(f"{self._where}: no usable answer ({e}); start it, or set operator: console in rig.yaml") from e
        if not isinstance(answer, dict):
            raise ProtocolError(f"{self._where}: answered {answer!r}; a JSON object with ok is needed")
        return answer

    def _check_folder(self) -> None:
        """Raises ProtocolError for a folder in which somebody else could put a socket, OSError without one."""
        folder = self.path.parent
        found = folder.stat()
        mode = stat.S_IMODE(found.st_mode)
        if found.st_uid != os.getuid():
            raise ProtocolError(
                f"{self._where}: its folder belongs to user {found.st_uid}, not to you ({os.getuid()}); put the socket in "
                "a folder of your own with mode 0700"
            )
        if mode & 0o077:
            raise ProtocolError(f"{self._where}: its folder has mode {mode:04o}, so other users could answer; chmod 700 {folder}")


def operator(spec: str, prepared: bool = False) -> Operator:
    """The operator that rig.yaml names: "console", who is not asked if all is `prepared`, or "unix:/path/of/its.sock"."""
    return Console(prepared) if spec == "console" else Program(Path(spec.removeprefix(UNIX)))


class RememberingOperator:
    """An operator who is not asked again for what stands already. What stands when the program starts is not known."""

    def __init__(self) -> None:
        self._operator: Operator | None = None
        self._stands: Setup | None = None
        self.asked = 0
        """How often somebody was asked to prepare."""

    def over(self, operator: Operator) -> RememberingOperator:
        """From now on this operator is asked."""
        self._operator = operator
        return self

    def prepare(self, setup: Setup) -> None:
        """See Operator.prepare."""
        if setup == self._stands:
            return
        assert self._operator is not None
        self._stands = None  # where it is refused half-way, nobody knows
        self._operator.prepare(setup)
        self._stands = setup
        self.asked += 1

    def confirm(self, trouble: str) -> None:
        """See Operator.confirm."""
        assert self._operator is not None
        self._operator.confirm(trouble)
