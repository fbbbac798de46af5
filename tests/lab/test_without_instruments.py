"""Where the instruments' libraries are not installed: replay, model and diagnosis work, and a rig says what to install."""

from __future__ import annotations

import shutil
from pathlib import Path

from drivers.alicat.wire import UNITS as WIRE
from lab.files.example import paper_robot
from sim_fakes.alicat import UNITS
from tests.lab.commands import run_there

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


def test_all_but_the_rig_works_and_a_rig_says_what_to_install(tmp_path: Path) -> None:
    case, rig, landed = tmp_path / "case", ("--rig", ROOT / "examples/rig/rig.yaml"), tmp_path / "rig.yaml"
    shutil.copy(ROOT / "examples/rig/rig.yaml", landed)  # beside no robot.yaml: a landing needs none
    robot = ("--robot", paper_robot())  # the recording's own is one of a test
    works = (
        ("info", RECORDING), ("replay", RECORDING), ("verify", RECORDING), ("export", RECORDING, "--case", "--out", case),
        ("schema", "robot"), ("compare", case, *robot),
    )  # fmt: skip
    refused = (("plan", "bending", *rig), ("check", *rig), ("demo", "--out", tmp_path / "demo"))
    others = (("safe", "--rig", landed), ("fakes", "--unit", "torr"))
    done = run_there((*works, *refused, *others), lacking=LIBRARIES)  # a computer without these libraries
    assert not [each for each in done if "Traceback" in each.stderr]
    for each in done[: len(works)]:
        assert each.returncode in (0, 3), each.stdout + each.stderr
    assert "Measured against model" in done[len(works) - 1].stdout
    for each in done[len(works) : -2]:
        assert each.returncode == 2 and "the instruments' libraries are not installed" in each.stderr
        assert "pip install 'softlab[rig]'" in each.stderr
    safe, fakes = done[-2:]
    assert safe.returncode == 1 and "make it safe by hand" in " ".join(safe.stdout.split())
    assert all(f"{name}: NOT CONFIRMED" in safe.stdout for name in ("arm", "pressure", "spine", "valve"))
    assert landed.with_suffix(".latch").exists()
    assert fakes.returncode == 2 and "must be one of Pa, hPa, kPa, MPa, mbar, bar, psi" in fakes.stderr
    assert tuple(WIRE) == UNITS
