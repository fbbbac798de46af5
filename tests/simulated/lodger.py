"""A child of a program as a thread of its process: children that hold instruments share the program's simulated clock."""

import importlib
import os
import subprocess
from collections.abc import Sequence
from typing import Any

import timing
from lab.guard.child import new_process
from lab.priority import Priority

HOLDERS = {"lab.guard.process", "lab.guard.hosted"}
"""Modules whose processes hold instruments."""


class Lodger:
    """Used as a `Popen`."""

    returncode = 0

    def __init__(self, module: str, given: list[int]) -> None:
        self.pid = os.getpid()
        serve = importlib.import_module(module).serve
        self._thread = timing.Thread(target=serve, args=(given,), name=module)
        self._thread.start()

    def poll(self) -> int | None:
        return None if self._thread.is_alive() else self.returncode

    def wait(self, timeout: float | None = None) -> int:
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise subprocess.TimeoutExpired(self._thread.name, timeout or 0.0)
        return self.returncode

    def kill(self) -> None:
        """Nothing: a thread ends when its pipes do."""


def started(module: str, passed: Sequence[int], more: Sequence[str], place: Priority, streams: Any) -> Any:
    """Stands in for `lab.guard.child.new_process`."""
    if module in HOLDERS:
        return Lodger(module, [os.dup(one) for one in passed])
    return new_process(module, passed, more, place, streams)
