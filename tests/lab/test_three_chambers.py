"""A robot with three chambers and no spine: the robot decides, from the plan to the diagnosis."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import SOUND, Cli, refused
from virtual_lab import lab, settings

from lab.files.config import load
from lab.verbs.fakes import played, write_rig
from model.effects import ForwardModel, design_from_columns
from model.robot import Robot
from recordings.campaign.replay import table_of
from recordings.file.reader import Recording
from sim_fakes.instrument import FakeRegulators
from sim_fakes.rig import FakeRig
from sim_fakes.virtual_robot import Condition, VirtualRobot, walk
from tests.simulated.clock import SimulatedClock

ROBOT = Path(__file__).parents[2] / "examples/three_chambers/robot.yaml"
SWEEP = ("pressures=[30 kPa, 60 kPa]", "repeats=2", "settle.min_samples=3")


@pytest.fixture(scope="module")
def rig(shared_clock: SimulatedClock, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("three") / "rig.yaml"
    with FakeRig(speed=20.0, seed=7, truth=played(load(ROBOT, Robot)), without=("spine",)) as fakes:
        write_rig(fakes, path, {}, ROBOT)
        yield path


@pytest.mark.parametrize(("range_of_units", "allowed"), [(400e3, [350e3, 250e3, 250e3]), (200e3, 200e3)])
def test_a_rig_of_fakes_allows_what_both_robot_and_regulators_bear(range_of_units: float, allowed: Any) -> None:
    robot = load(ROBOT, Robot).replace(max_pressure=[350e3, 250e3, 250e3])
    fakes = FakeRig(truth=played(robot), regulators=FakeRegulators("alicat", range_of_units), without=("spine",))
    assert fakes.rig_file()["instruments"]["pressure"]["max_pressure"] == allowed


@pytest.fixture(scope="module")
def files(rig: Path) -> list[Path]:
    for chamber in (1, 2):
        assert lab("run", "bending", "--rig", rig, *settings(*SWEEP, f"chambers=[{chamber}]"), "--out", rig.parent) in SOUND
    return sorted(rig.parent.glob("*.mcap"))


GIVEN = {"bending_stiffness": 0.04, "axial_stiffness": 700.0, "torsional_stiffness": 0.02, "mass_per_length": 0.9}


UNEVEN = {
    "chambers": {"radius": (4e-3, 3.5e-3, 3e-3), "path_radius": (0.0105, 0.0125, 0.0145), "azimuths_deg": (0.0, 120.0, 240.0)}
}


@pytest.mark.parametrize("stated", [{}, UNEVEN, {"thrust": "walls"}, {**GIVEN, "thrust": "walls", "gravity": (0.0, -9.81, 0.0)}])
def test_the_virtual_robot_puts_its_tip_where_the_model_does(stated: dict[str, Any]) -> None:
    robot = load(ROBOT, Robot).replace(**stated)
    pressures = np.array([(p, 0.4 * p, 0.0) for p in (0.0, 40e3, 80e3)])
    table = {"trial": np.arange(3), "spine_length": np.zeros(3), "tip_mass": np.full(3, 0.053)}
    table |= {f"p{k}": values for k, values in enumerate(pressures.T, 1)} | dict.fromkeys("xyz", np.zeros(3))
    forward = ForwardModel(robot, design_from_columns(robot, table))
    assert not [p.name for p in forward.parameters if p.name.endswith(".spine")]
    expected = forward.predict(np.zeros(len(forward.parameters))).reshape(3, 3)
    finer = played(robot).model_copy(update={"segments": 80})
    read = walk(VirtualRobot(finer), [Condition(0.0, tuple(p), hold=60.0) for p in pressures.tolist()])
    assert np.array([r.position for r in read]) == pytest.approx(expected, abs=0.15e-3)
    assert np.linalg.norm(expected[-1] - expected[0]) > (0.015 if stated else 0.02)


def test_a_body_without_a_hole_is_simulated() -> None:
    full = load(ROBOT, Robot).model_copy(update={"inner_radius": 0.0})
    (reading,) = walk(VirtualRobot(played(full), {}, seed=1), [Condition(0.0, (20e3, 0.0, 0.0))])
    assert np.isfinite(reading.position).all()
    unlike = full.model_copy(update={"chambers": full.actuators.model_copy(update={"ends": (0.1,)}), "sections": ("one",)})
    refused("the fakes do not support sections, chambers.ends", played, unlike)
    beside = full.replace(markers=[{"arc_length": 0.1, "offset": [0.02, 0.0]}])
    refused("the fakes do not support markers beside the axis", played, beside)
    refused("density: cannot be simulated", played, full.model_copy(update={"density": -1.0}))
    refused("shear_modulus over youngs_modulus: cannot", played, full.model_copy(update={"shear_modulus": 1e8}))


def test_the_fakes_have_no_length_unit_and_the_plan_asks_for_none(rig: Path, cli: Cli) -> None:
    assert not {"spine", "valve", "gauge"} & set(yaml.safe_load(rig.read_text())["instruments"])
    assert "quaternion: [" in rig.read_text() and "\n- " not in rig.read_text()
    assert "above max_pressure = 80 kPa" in cli("plan", "bending", "--rig", rig, "--json", code=2).err
    for protocol in ("bending", "elongation"):
        plan = cli("plan", protocol, "--rig", rig, "--set", "pressures=[30 kPa]", "--json").json
        assert plan["limits"]["spine_length_m"] == 0 and plan["steps"][0]["label"] == "vent, no spine, repeat 1"


@pytest.mark.parametrize(
    ("protocol", "setting", "words"),
    [
        ("bending", "spine_lengths=[0.1]", "it has no spine"),
        ("bending", "chambers=[4]", "4 is not a chamber; chambers are numbered 1 to 3"),
        ("stiffness", "spine_lengths=[0.1]", "it has no spine"),
    ],
)
def test_what_it_has_not_is_told_before_anything_moves(rig: Path, cli: Cli, protocol: str, setting: str, words: str) -> None:
    low = () if protocol == "stiffness" else ("--set", "pressures=[30 kPa]")
    assert words in cli("plan", protocol, "--rig", rig, *low, "--set", setting, code=2).err


def test_wiring_beyond_its_chambers_is_told(rig: Path, tmp_path: Path, cli: Cli) -> None:
    data = yaml.safe_load(rig.read_text()) | {"robot": str(ROBOT)}
    data["instruments"]["pressure"]["chambers"] = [[1], [2], [4]]
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(data))
    assert "instruments.pressure.chambers: 4 is not a chamber" in cli("plan", "bending", "--rig", path, code=2).err


def test_rows_have_three_pressures_and_replay_is_equal(files: list[Path], cli: Cli) -> None:
    for file, chamber in zip(files, (1, 2), strict=True):
        assert "bit-identical to the live run's" in cli("replay", file).out
        rows = table_of(Recording.open(file)).rows
        assert all(len(row.pressures) == 3 and row.spine_length == 0.0 and row.vacuum is None for row in rows)
        highest = max(rows, key=lambda row: row.pressures[chamber - 1])
        assert highest.pressures[chamber - 1] == pytest.approx(60e3, rel=0.03)
        assert max(p for i, p in enumerate(highest.pressures) if i != chamber - 1) < 2e3


def test_it_is_compared_and_fitted(files: list[Path], cli: Cli) -> None:
    assert {*cli("compare", *files, "--json").json["markers"]} == {"m1", "m2"}
    assert "rms of markers: m1 " in cli("compare", *files).out
    factor = cli("fit", *files, "--json").json["area_factor"]
    (found,) = factor.values() if "value" not in factor else (factor,)
    assert found["value"] == pytest.approx(1.5, rel=0.05)
