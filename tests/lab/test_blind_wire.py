"""A robot with a hidden effect, recorded through every wire, reads like the same robot without wires."""

import numpy as np
import pytest

from lab.console import Screen
from lab.rig.assembly import Rig
from lab.verbs.fakes import write_rig
from lab.verbs.run import connect, execute, job
from recordings.campaign.replay import table_of
from recordings.file.reader import Recording
from recordings.trials import Table
from sim_fakes.rig import FakeRig
from sim_fakes.virtual_robot import Condition, RobotTruth, VirtualReading, VirtualRobot, walk
from tests.simulated.clock import SimulatedClock

TRUTH = RobotTruth(youngs_modulus=0.52e6, area_factor=1.55, scatter_length=1e-3, scatter_stiffness=0.02)
SEALED = {"chamber_ballooning": 0.15}
SPINE, RATE, BAND = 0.10, 5e3, 7.5e3
STATES = (  # pressure and hold of each reading; the ends of a ramp are read on the fly, just before it turns
    (0.0, 5.0), (50e3, 0.0), (100e3, 0.0), (150e3 - BAND, 0.0), (100e3, 0.0), (50e3 + BAND, 0.0), (0.0, 5.0),
)  # fmt: skip
SETTINGS = (
    f"spine_lengths=[{SPINE}]", "pressures=[50000.0, 100000.0, 150000.0]", "chambers=[9, 1, 2]", "repeats=1", "unload=true",
    "zero_state=true", "reading=sweep", f"rate={RATE}", "settle.average=3.0", f"settle.band={BAND}",
)  # fmt: skip
SPEED = 10.0
"""Rig seconds a host second."""
CAMERA = 0.3e-3
"""m, noise of a camera frame of the fakes, one sigma."""


@pytest.fixture(scope="module")
def wired(shared_clock: SimulatedClock, tmp_path_factory: pytest.TempPathFactory) -> Table:
    """The rows that a recording of the bending protocol holds."""
    folder = tmp_path_factory.mktemp("wire")
    with FakeRig(speed=SPEED, seed=21, truth=TRUTH, effects=SEALED) as fakes:
        write_rig(fakes, folder / "rig.yaml")
        asked = job("bending", folder / "rig.yaml", list(SETTINGS))
        with Rig(asked.rig) as rig:
            connect(rig, asked.experiment.needs, quiet=True)
            outcome = execute(rig, asked, folder, Screen("wire", SPEED, quiet=True))
    assert outcome.error is None
    return table_of(Recording.open(outcome.file))


def driven(effects: dict[str, float], seed: int) -> list[VirtualReading]:
    """Readings of the robot without wires; the ramp goes on to its end before it turns."""
    levels = [*STATES[:4], (150e3, None), *STATES[4:]]
    states = [
        Condition(SPINE, tuple(p if c in (9, 1, 2) else 0.0 for c in range(1, 10)), hold=hold or 0.0, rate=RATE)
        for p, hold in levels
    ]
    read = walk(VirtualRobot(TRUTH, effects, seed), states)
    return [r for r, (_, hold) in zip(read, levels, strict=True) if hold is not None]


def test_readings_scatter_as_the_cameras_do(wired: Table) -> None:
    for column in ("sd_x", "sd_y", "sd_z"):
        assert 0.7 < np.median(wired[column]) / CAMERA < 1.8


def test_the_tip_is_where_the_robot_puts_it_and_not_where_one_without_the_effect_would(wired: Table) -> None:
    asked = np.array([p for p, _ in STATES])
    # 20 ms of host time between pressure and cameras are 0.2 s of a rig ten times as fast: 1 kPa of the ramp
    late = 1e3 * np.array([hold == 0 for _, hold in STATES])

    def beyond(effects: dict[str, float]) -> np.ndarray:
        """(7, 3) distance of the tip in tolerances: the scatter of spines that are jammed anew, the ramp, the cameras."""
        many = np.array([[r.position for r in driven(effects, seed)] for seed in range(6)])
        mean, spread = many.mean(axis=0), np.maximum(many.std(axis=0, ddof=1), 0.15e-3)
        steep = np.abs(np.diff(mean, axis=0)) / np.maximum(np.abs(np.diff(asked)), 1e3)[:, None]
        found = np.stack([wired["x"], wired["y"], wired["z"]], axis=1)
        return np.asarray(np.abs(found - mean) / (6 * spread + late[:, None] * steep.max(axis=0)))

    assert beyond(SEALED).max() < 1
    assert beyond({}).max() > 1
