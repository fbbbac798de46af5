"""Asking the process beside that knows the model (`expected`), one question at a time."""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
from typing import Any

from ..priority import BEHIND, put_in_place


class NoModel(RuntimeError):
    """There is no model of this robot, or it has ended; the text says why."""


class Model:
    """Asks the process beside."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> bool:
        """Start it; returns whether it gives intervals once its kernels are there. Raises `NoModel`."""
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-P", "-m", "lab.live.expected", stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL, limit=64 * 2**20, start_new_session=True,
        )  # fmt: skip
        put_in_place(self._process.pid, BEHIND)
        answer = await self.ask({"robot": self._robot})
        if "error" in answer:
            raise NoModel(str(answer["error"]))
        return bool(answer["intervals"])

    async def ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """One answer; raises `NoModel` when the process has ended."""
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(question).encode() + b"\n")
            await process.stdin.drain()
            line = await process.stdout.readline()
            answer: dict[str, Any] = json.loads(line)
        except (OSError, ValueError) as e:
            raise NoModel(f"the model's process has ended ({e})") from e
        return answer

    async def stop(self) -> None:
        """End it; may be called twice and before start."""
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
