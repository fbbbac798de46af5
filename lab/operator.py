"""Who prepares the rig: a person at the console, or a program that answers JSON lines at a TCP address."""

from __future__ import annotations

import json
import socket
import sys
from dataclasses import asdict
from typing import Any

from protocols.bench import Operator, Setup
from protocols.errors import ProtocolError, Stopped
from recordings.json_text import read_json

MOUNTS = {
    "robot": "hang the robot in its frame, spine inside",
    "body": "mount the robot at the stiffness stand",
    "spine": "mount the bare spine at the stiffness stand",
}

LONGEST_ANSWER = 65536
"""Characters of one line that a program may answer."""


class Console:
    """Asks the person to prepare and waits for Enter; where nobody can type, says what it takes for granted."""

    def prepare(self, setup: Setup) -> None:
        """See Operator.prepare."""
        print(
            f"Prepare: {MOUNTS[setup.mount]}; tip mass {setup.tip_mass * 1e3:g} g; "
            f"chamber pattern turned by {setup.roll_deg:g} deg; vacuum supply at {setup.vacuum / 1e3:g} kPa below ambient."
        )
        if not sys.stdin.isatty():
            print("(not a terminal: taken as prepared)")
            return
        if input("Enter when ready, q to stop: ").strip().lower() == "q":
            raise Stopped("not prepared; nothing moved")

    def confirm(self, trouble: str) -> None:
        """See Operator.confirm; where nobody can type, nobody can confirm."""
        print(f"Paused, vented and stopped: {trouble}")
        if not sys.stdin.isatty():
            raise Stopped(f"paused: {trouble}; nobody is there to put it right (not a terminal)")
        if input("Enter when it is put right and nobody is in the cell, q to stop: ").strip().lower() == "q":
            raise Stopped(f"stopped during a pause: {trouble}")


class Program:
    """Sends each set-up as one JSON line and waits for {"ok": true}."""

    def __init__(self, host: str, port: int, within: float = 60.0) -> None:
        self.address, self.within = (host, port), within

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
        return f"operator at {self.address[0]}:{self.address[1]}"

    def _ask(self, question: dict[str, Any]) -> dict[str, Any]:
        try:
            with socket.create_connection(self.address, timeout=self.within) as connection:
                connection.sendall(json.dumps(question).encode() + b"\n")
                line = connection.makefile().readline(LONGEST_ANSWER)
            answer = read_json(line)
        except (OSError, ValueError) as e:
            raise ProtocolError(
                f"{self._where}: no usable answer ({e}); start it, or set operator: console in rig.yaml"
            ) from e
        if not isinstance(answer, dict):
            raise ProtocolError(f"{self._where}: answered {answer!r}; a JSON object with ok is needed")
        return answer


def operator(spec: str) -> Operator:
    """The operator that rig.yaml names: "console" or "tcp://host:port"."""
    if spec == "console":
        return Console()
    host, port = spec.removeprefix("tcp://").rsplit(":", 1)
    return Program(host, int(port))
