"""Where the instruments' libraries are not installed: replay, model and diagnosis work, and a rig says what to install."""

from __future__ import annotations

import shutil
from pathlib import Path

from drivers.alicat.wire import UNITS as WIRE
from lab.files.example import paper_robot
from sim_fakes.alicat import UNITS
from tests.lab.commands import Done, run_there

ROOT = Path(__file__).parents[2]
LIBRARIES = (
    "rtde_control",
    "rtde_receive",
    "serial",
    "pymodbus",
    "dynamixel_sdk",
    "pytrinamic",
    "pfeiffer_vacuum_protocol",
)
RECORDING = ROOT / "tests/recordings/data/bending-schema-1.mcap"


def lab(*commands: tuple[str | Path, ...]) -> list[Done]:
    """The command on a computer without these libraries: once for each, in one process."""
    return run_there(commands, lacking=LIBRARIES)


def test_recordings_are_read() -> None:
    for done in lab(("info", RECORDING), ("replay", RECORDING), ("verify", RECORDING)):
        assert done.returncode in (0, 3), done.stdout + done.stderr


def test_the_model_and_the_front_door_work(tmp_path: Path) -> None:
    (done,) = lab(("export", RECORDING, "--case", "--out", tmp_path / "case"))
    assert done.returncode == 0, done.stderr
    shutil.copy(paper_robot(), tmp_path / "case" / "robot.yaml")  # the recording's own is one of a test
    done, schema = lab(("compare", tmp_path / "case"), ("schema", "robot"))
    assert done.returncode == 0 and "Measured against model" in done.stdout, done.stdout + done.stderr
    assert schema.returncode == 0, schema.stderr


def test_a_landing_tells_each_actuator_that_it_cannot_reach(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"  # beside no robot.yaml: a landing needs none
    shutil.copy(ROOT / "examples/rig/rig.yaml", path)
    (done,) = lab(("safe", "--rig", path))
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stdout + done.stderr
    for name in ("arm", "pressure", "spine", "valve"):
        assert f"{name}: NOT CONFIRMED" in done.stdout
    assert "make it safe by hand" in " ".join(done.stdout.split()) and path.with_suffix(".latch").exists()


def test_a_rig_says_what_to_install(tmp_path: Path) -> None:
    place = ("--rig", ROOT / "examples/rig/rig.yaml")
    for done in lab(("plan", "bending", *place), ("check", *place), ("demo", "--out", tmp_path / "demo")):
        assert done.returncode == 2 and "Traceback" not in done.stderr, done.stdout + done.stderr
        assert "the instruments' libraries are not installed" in done.stderr
        assert "pip install 'softlab[rig]'" in done.stderr


def test_the_fakes_need_none_of_them() -> None:
    (done,) = lab(("fakes", "--unit", "torr"))
    assert done.returncode == 2 and "must be one of Pa, hPa, kPa, MPa, mbar, bar, psi" in done.stderr, done.stderr
    assert tuple(WIRE) == UNITS
