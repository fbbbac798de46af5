"""A computer that stood still (SIGSTOP of all its processes, a paused virtual machine) goes on where it was.

The robot has no spine: a length unit's own watchdog would have stopped it, and that ends a run.
"""

import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from house import House, until

import timing
from lab.files.config import load
from lab.files.inputs import read_case
from lab.verbs.fakes import PATIENT, PATIENT_SETTLE, played, write_rig
from model.robot import Robot
from sim_fakes.rig import FakeRig
from tests.lab.commands import command
from tests.lab.virtual_lab import settings

ROBOT = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"
LONG = 12.0
"""Host seconds; Motive forgets a client after 10."""
SHORT = settings("pressures=[30 kPa]", "chambers=[1]", "rate=10 kPa/s", *PATIENT_SETTLE)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    path = tmp_path_factory.mktemp("three") / "rig.yaml"
    with FakeRig(speed=5.0, seed=7, truth=played(load(ROBOT, Robot)), without=("spine",)) as fakes:
        present = fakes.rig_file()["instruments"]
        changes = {"instruments": {k: v for k, v in PATIENT["instruments"].items() if k in present}}
        write_rig(fakes, path, {**PATIENT, **changes}, ROBOT)
        yield House(fakes, path)


def mocap(house: House) -> set[tuple[str, int]]:
    assert house.fakes.mocap is not None
    return set(house.fakes.mocap.clients)


def ramping(house: House) -> bool:
    return 5e3 < float(house.fakes.plant.regulator.max()) < 25e3


def reading(house: House) -> bool:
    return house.highest() > 28e3


@pytest.mark.real
@pytest.mark.parametrize(
    ("phase", "seconds"),
    [
        (reading, LONG),
        pytest.param(ramping, LONG, marks=pytest.mark.long),
        pytest.param(lambda house: bool(mocap(house)), LONG, marks=pytest.mark.long, id="at zero"),  # before any pressure
        pytest.param(ramping, 3.0, marks=pytest.mark.long),
        pytest.param(reading, 40.0, marks=pytest.mark.long),
    ],
)
def test_a_run_goes_on_after_a_standstill_without_a_person(
    three: House, tmp_path: Path, phase: Callable[[House], bool], seconds: float
) -> None:
    three.fakes.troubles.clear()
    assert until(lambda: not mocap(three))
    with command("run", "bending", "--rig", three.rig, "--out", tmp_path, *SHORT) as process:
        assert until(lambda: phase(three) or process.poll() is not None, 120)
        root = psutil.Process(process.pid)
        stopped = [root, *root.children(recursive=True)]  # as a suspended computer does; the instruments go on
        for one in stopped:
            one.send_signal(signal.SIGSTOP)
        timing.sleep(seconds)
        for one in stopped:
            one.send_signal(signal.SIGCONT)
        said, _ = process.communicate(timeout=300)
    assert process.returncode in (0, 3), said
    assert three.fakes.troubles == []
    (file,) = tmp_path.glob("*.mcap")
    rows = read_case([file]).table
    assert [(r.step, r.branch, round(max(r.pressures) / 30e3)) for r in rows] == [
        (1, "load", 0), (2, "load", 1), (3, "unload", 0),
    ], said  # fmt: skip
    assert (seconds > LONG / 2) == ("stood still" in said)
    assert until(lambda: three.highest() < 5e3)
