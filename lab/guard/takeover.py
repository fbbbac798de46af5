"""`lab safe` while a run is going: the guard that owns the rig is asked to land it, at once and for good, and answers with what
it read back.

Question and answer are files beside rig.yaml, so that who may write there may ask, and nobody else. The guard looks for a
question with each look at its program (50 ms). One that does not take the question up is dead or stands still.
"""

from __future__ import annotations

import contextlib
import getpass
import json
import os
import time
import uuid
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from recordings.json_text import read_json
from recordings.own_files import opened, replaced

from .landing import SafeReport, SafeStep

TAKEN_WITHIN = 1.5
"""Host seconds in which a guard that lives takes a question up."""
LOOK = 0.02
LONGEST = 100_000
"""Bytes of a question or an answer that are read."""


@dataclass(frozen=True)
class Request:
    """Somebody wants the rig safe."""

    number: str
    by: str
    """Who asks, for the screen and the journal of the run."""


class Requests:
    """Questions and answers of one rig.yaml."""

    def __init__(self, rig: Path) -> None:
        self._question, self._answer = rig.with_suffix(".landing"), rig.with_suffix(".landed")

    # -- who asks
    def ask(self, within: float) -> SafeReport | None:
        """What the rig's present owner read back after landing; None when there is nobody who takes the question up."""
        request = Request(uuid.uuid4().hex, f"lab safe, by {_user()}, process {os.getpid()}")
        self._answer.unlink(missing_ok=True)
        replaced(self._question, json.dumps(asdict(request)), 0o600)
        began = time.monotonic()
        try:
            while time.monotonic() - began < within:
                if self._question.exists() and time.monotonic() - began > TAKEN_WITHIN:
                    return None
                if (report := self._report(request)) is not None:
                    return report
                time.sleep(LOOK)
            return None
        finally:
            self._question.unlink(missing_ok=True)
            self._answer.unlink(missing_ok=True)

    def _report(self, request: Request) -> SafeReport | None:
        data = _read(self._answer)
        if data is None or data.get("number") != request.number:
            return None
        try:
            return SafeReport(tuple(SafeStep(**step) for step in data["steps"]))
        except (KeyError, TypeError):
            return None

    # -- who owns the rig
    def take(self) -> Request | None:
        """A question that has come, once."""
        data = _read(self._question)
        if data is None:
            return None
        self._question.unlink(missing_ok=True)
        return Request(str(data.get("number", "")), str(data.get("by", "somebody"))[:200])

    def answer(self, request: Request, report: SafeReport) -> None:
        """What was reached; a disk that is full must not keep the guard from anything."""
        with contextlib.suppress(OSError):
            steps = [asdict(step) for step in report.steps]
            replaced(self._answer, json.dumps({"number": request.number, "steps": steps}), 0o600)


def _read(path: Path) -> dict[str, Any] | None:
    """The table that a file holds; None when there is none."""
    try:
        with open(opened(path, os.O_RDONLY), "rb") as file:
            data = read_json(file.read(LONGEST))
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) else None


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return f"user {os.getuid()}"
