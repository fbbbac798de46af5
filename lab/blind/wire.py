"""A blind case measured as in the lab: fake instruments on every wire, the protocol, a recording, and its table."""

from __future__ import annotations

import itertools
import time
from pathlib import Path

from recordings.campaign.replay import table_of
from recordings.errors import RecordingError
from recordings.file.reader import Recording
from recordings.trials import Table
from sim_fakes.rig import FakeRig

from ..console import Screen
from ..rig.assembly import Rig
from ..verbs.fakes import PATIENT, write_rig
from ..verbs.run import connect, execute, job
from .bench_robot import BenchRobot
from .sweeps import Sweep
from .truth import Truth

SPEED = 20.0
"""Rig seconds a host second."""
ATTEMPTS = 4
"""A busy machine stalls a fast rig; then it is run again at half the speed."""
STALLED = 0.8e-3
"""m that the tip scatters within a reading when camera and regulators have lost each other, beyond noise and ramp."""
LATE = 3.0
"""s by which readings on the fly may be apart from what the ramp says."""


class TooSlow(RuntimeError):
    """The machine could not keep the rig's pace: what was read says nothing of the robot."""


def measure_by_wire(truth: Truth, sweep: Sweep, robot_yaml: str, folder: Path, speed: float = SPEED) -> Table:
    """Record the sweep into `folder` and return the rows that the recording holds.

    Raises what the last attempt raised: `TooSlow`, RuntimeError for a run that failed, `drivers.errors.InstrumentError`.
    """
    for attempt in range(1, ATTEMPTS + 1):
        try:
            table = _record(truth, sweep, robot_yaml, folder, speed / 2 ** (attempt - 1))
            _check_pace(table)
            return table
        except (RecordingError, OSError, RuntimeError) as e:
            if attempt == ATTEMPTS:
                raise
            (folder / f"failed-{attempt}.txt").write_text(f"{time.strftime('%H:%M:%S')} {e}\n")
    raise RuntimeError("unreachable: every attempt returns or raises")


def _check_pace(table: Table) -> None:
    """Raises `TooSlow` when the machine was too slow for the rig's speed, so that a reading says nothing of the robot."""
    scatter = max(row.sd.get(axis, 0.0) for row in table for axis in "xyz")
    if scatter > STALLED:
        raise TooSlow(
            f"the tip scattered {scatter * 1e3:.1f} mm within a reading: this machine is too slow for the speed"
        )
    for before, row in itertools.pairwise(table):
        if before.trial == row.trial and before.hold == row.hold == 0 and before.branch == row.branch and row.rate:
            ramp = abs(max(row.pressures) - max(before.pressures)) / abs(row.rate)
            if abs(row.t - before.t - ramp) > LATE:
                raise TooSlow(
                    f"trial {row.trial} step {row.step}: {row.t - before.t:.1f} s after the last reading, not {ramp:.1f} s"
                )


def _record(truth: Truth, sweep: Sweep, robot_yaml: str, folder: Path, speed: float) -> Table:
    robot = BenchRobot(truth)
    fakes = FakeRig(speed=speed, seed=truth.seed % 10**6, truth=robot.truth)
    fakes.robot = robot
    with fakes:
        write_rig(fakes, folder / "rig.yaml", PATIENT)
        (folder / "robot.yaml").write_text(robot_yaml)
        asked = job(sweep.protocol, folder / "rig.yaml", sweep.settings())
        with Rig(asked.rig) as rig:
            connect(rig, asked.experiment.needs, quiet=True)
            outcome = execute(rig, asked, folder, Screen(sweep.name, speed, quiet=True))
    if outcome.error is not None:
        raise RuntimeError(f"{sweep.name}: {outcome.error}") from outcome.error
    return table_of(Recording.open(outcome.file))
