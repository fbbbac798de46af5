"""Runs the experiments of the matrix in a process that may die without taking the fakes along.

`python -m benchmarks.faults.worker FD`.
"""

from __future__ import annotations

import logging
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

from drivers.errors import InstrumentError
from lab.console import Screen, out
from lab.files.rig_file import load_rig
from lab.guard.landing import SafeReport
from lab.guard.latch import Latch, RigLocked
from lab.rig.assembly import Rig
from lab.verbs.run import execute, job
from lab.verbs.safe import safe
from protocols.errors import Suspended

from .cells import FaultJob, FaultResult


class Told(Rig):
    """A rig that says when it begins to land, and waits for a word before it does."""

    line: Connection
    ended = 0.0
    report = SafeReport()

    def make_safe(self) -> SafeReport:
        """See Rig.make_safe."""
        if not self.ended:
            self.ended = time.monotonic()
            self.line.send("landing")
            self.line.recv()
        self.report = super().make_safe()
        return self.report


def work(todo: FaultJob, line: Connection) -> FaultResult:
    """One experiment, or one unlocking."""
    path = Path(todo.rig)
    if not todo.protocol:
        code = safe(path, clear=True).code
        return FaultResult(error="" if code == 0 else "still locked", locked=Latch(path).read() is not None)
    error: Exception | None = None
    report, ended, rows = SafeReport(), 0.0, 0
    try:
        planned = job(todo.protocol, path, list(todo.settings))
        with Told(load_rig(path)) as rig:
            rig.line = line
            failures = rig.open_all(str, rig.needed(planned.experiment.needs))
            if failures:
                error, ended = next(iter(failures.values())), time.monotonic()
            else:
                outcome = execute(rig, planned, Path(todo.folder), Screen(todo.protocol, planned.rig.clock.speed, quiet=True))
                error, report, ended, rows = outcome.error, rig.report, rig.ended, len(outcome.table)
            landed = time.monotonic()
    except RigLocked as e:
        error, landed = e, time.monotonic()
    cause = error.cause if isinstance(error, Suspended) else error
    return FaultResult(
        ended=ended or landed,
        landed=landed,
        error=str(cause or ""),
        kind=type(cause).__name__ if cause is not None else "",
        names=cause.instrument if isinstance(cause, InstrumentError) else "",
        steps=tuple((s.instrument, s.confirmed, s.text) for s in report.steps),
        locked=Latch(path).read() is not None,
        rows=rows,
    )


def main(line: Connection) -> None:
    """Work until the other end closes."""
    logging.disable(logging.CRITICAL)
    out.quiet = True
    while True:
        try:
            todo = line.recv()
        except EOFError:
            return
        line.send(work(todo, line))


if __name__ == "__main__":
    sys.stdout = sys.stderr
    main(Connection(int(sys.argv[1])))
