"""A plan is judged against every limit at once, before anything is connected: one line a limit, with its worst step."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from lab.cli import main
from lab.console import clock
from lab.files.config import ConfigError, load
from lab.files.example import paper_robot
from lab.files.rig_file import load_rig
from lab.rig.limits import expected_force, within_robot
from lab.verbs.run import job
from model.robot import Robot
from protocols.experiment import Push

RIG = Path(__file__).parent.parent.parent / "examples" / "rig" / "rig.yaml"
Rig = Callable[..., Path]


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """The example's rig.yaml with tables changed, and robot.yaml beside it with values changed (None: left out)."""

    def write(robot: dict[str, Any] | None = None, **tables: dict[str, Any]) -> Path:
        data = yaml.safe_load(RIG.read_text()) | {"robot": "robot.yaml"}
        for name, values in tables.items():
            place = data["instruments"] if name in data["instruments"] else data
            place[name] = place[name] | values
        own = yaml.safe_load(paper_robot().read_text()) | (robot or {})
        (tmp_path / "robot.yaml").write_text(yaml.safe_dump({k: v for k, v in own.items() if v is not None}))
        (tmp_path / "rig.yaml").write_text(yaml.safe_dump(data))
        return tmp_path / "rig.yaml"

    return write


def refused(rig: Path, protocol: str, *settings: str) -> list[str]:
    """The lines with which a plan is refused."""
    with pytest.raises(ConfigError) as caught:
        job(protocol, rig, list(settings))
    return str(caught.value).splitlines()


def test_the_default_protocols_are_within_the_limits_of_the_example(rig: Rig) -> None:
    path = rig()
    for protocol in ("bending", "elongation", "stiffness"):
        job(protocol, path, [])
    job("stiffness", path, ["specimen=body", "spine_lengths=[0, 10 cm]"])


def test_a_robot_that_does_not_say_what_it_bears_is_planned_for_no_inflation(rig: Rig) -> None:
    path = rig({"max_pressure": None})
    for protocol in ("bending", "stiffness"):
        (line,) = refused(path, protocol)
        assert line.startswith(f"{path.parent / 'robot.yaml'}: max_pressure: is missing") and "150 kPa" in line


def test_the_robot_s_own_pressure_is_a_limit_beside_the_regulator_s(rig: Rig) -> None:
    own, regulators = refused(rig({"max_pressure": 100e3}, pressure={"max_pressure": 200e3}), "bending")
    assert "requires 250000 Pa, above max_pressure = 100000 Pa of" in own and "robot.yaml" in own
    assert own.startswith("bending, step ") and "(250 kPa load, spine 0 cm" in own
    assert "250000 Pa, above instruments.pressure.max_pressure = 200000 Pa" in regulators


def test_every_limit_that_is_not_kept_has_its_line(rig: Rig) -> None:
    path = rig(
        pressure={"max_pressure": 100e3, "max_rate": 10e3},
        spine={"max_length": 0.2, "max_speed": 0.01},
        limits={"max_total_pressure": 500e3, "max_vacuum": 60e3},
    )
    lines = refused(path, "elongation")
    asked = [
        "150000 Pa, above instruments.pressure.max_pressure = 100000 Pa",
        "a total over the chambers of 1.35e+06 Pa, above limits.max_total_pressure = 500000 Pa",
        "25000 Pa/s, above instruments.pressure.max_rate = 10000 Pa/s",
        "0.3 m, above instruments.spine.max_length = 0.2 m",
        "0.02 m/s, above instruments.spine.max_speed = 0.01 m/s",
        "a vacuum of 80000 Pa, above limits.max_vacuum = 60000 Pa",
    ]
    for words in asked:
        assert sum(f"requires {words}" in line for line in lines) == 1, (words, lines)
    assert len(lines) == len(asked) and all("elongation, step" in line and "; " in line for line in lines)


def test_a_sum_that_each_chamber_by_itself_would_keep_is_refused(rig: Rig) -> None:
    (line,) = refused(rig(), "bending", "chambers=[1,2,3,4,5,6,7,8,9]", "pressures=[100 kPa, 200 kPa]")
    assert "1.8e+06 Pa, above limits.max_total_pressure = 1.5e+06 Pa" in line


def test_a_pattern_that_the_wiring_cannot_make_is_refused(rig: Rig) -> None:
    (line,) = refused(rig(), "bending", "chambers=[1,2,3]")
    assert "instruments.pressure.chambers" in line and "rewire" in line


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ({"workspace_min": [-0.75, -0.75, 0.45]}, ["z = 0.4 m", "0.45 to 0.9 m"]),  # the longest spine's end
        ({"workspace_min": [0.45, -0.75, 0.02]}, ["x = 0.42 m", "0.45 to 0.75 m"]),  # where it waits
        (
            {"workspace_max": [0.52, 0.75, 0.9]},
            ["x = 0.53 m", "-0.75 to 0.52 m", "approach"],
        ),  # the approach's last step
    ],
)
def test_every_place_of_the_probe_must_lie_in_the_arm_s_box(rig: Rig, box: dict[str, Any], words: list[str]) -> None:
    (line,) = refused(rig(arm=box), "stiffness")
    assert all(word in line for word in ("the probe at", *words)), line


def test_a_stiffness_trial_without_a_stand_is_refused(rig: Rig) -> None:
    path = rig()
    data = yaml.safe_load(path.read_text())
    del data["stand"]
    path.write_text(yaml.safe_dump(data))
    (line,) = refused(path, "stiffness")
    assert "stand: is missing" in line


def test_the_force_that_a_push_should_make_is_judged_beforehand(rig: Rig) -> None:
    robot = load(paper_robot(), Robot)
    push = Push("spine", 0.05, 0.05, 0.001, 25.0)
    force = expected_force(robot, push)
    assert force == pytest.approx(3 * 318e3 * 3.14159 / 4 * 0.029**4 * 0.001 / 0.05**3, rel=1e-4)
    lines = refused(rig(limits={"max_force": 4, "max_moment": 0.4}), "stiffness")
    assert any("4.40954 N, above limits.max_force = 4 N" in line and "spine 10 cm" in line for line in lines)
    assert any("N m, above limits.max_moment = 0.4 N m" in line and "spine 20 cm" in line for line in lines)
    (line,) = refused(rig(), "stiffness", "max_force=2 N", "spine_lengths=[5 cm]")
    assert "above max_force = 2 N of the protocol" in line and "deflection 8" in line


def test_a_body_is_stiffer_with_the_spine_inside_and_softer_than_if_it_reached_the_tip() -> None:
    robot = load(paper_robot(), Robot)
    bare, half, full = (expected_force(robot, Push("body", s, 0.40, 0.008, 25.0)) for s in (0.0, 0.2, 0.4))
    assert bare is not None and half is not None and full is not None
    assert bare == pytest.approx(3 * 507147 * 3.14159 / 4 * (0.05**4 - 0.029**4) * 0.008 / 0.4**3, rel=1e-4)
    assert bare < half < full


def test_a_specimen_of_no_length_gives_no_way_and_one_of_unknown_modulus_is_not_judged() -> None:
    robot = load(paper_robot(), Robot)
    assert expected_force(robot, Push("spine", 0.0, 0.0, 0.0, 25.0)) == float("inf")
    assert expected_force(robot.model_copy(update={"spine": None}), Push("spine", 0.1, 0.1, 0.002, 25.0)) is None


def test_regulators_are_told_no_more_than_the_robot_bears(rig: Rig) -> None:
    path = rig({"max_pressure": 100e3})
    read = load_rig(path)
    bounded = within_robot(read, read.body).instruments.pressure
    assert bounded is not None and bounded.max_pressure == 100e3
    read = load_rig(rig({"max_pressure": 1e6}))
    higher = within_robot(read, read.body).instruments.pressure
    assert higher is not None and higher.max_pressure == 250e3


def test_plan_says_it_with_exit_code_2(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    path = rig({"max_pressure": 200e3})
    assert main(["plan", "bending", "--rig", str(path)]) == 2
    assert "250000 Pa, above max_pressure = 200000 Pa" in capsys.readouterr().err
    assert main(["plan", "bending", "--rig", str(path), "--set", "pressures=[200 kPa]"]) == 0


def test_a_plan_tells_the_rigs_time_and_ones_own_apart(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    path = rig()
    assert main(["plan", "bending", "--rig", str(path), "--json"]) == 0
    real = json.loads(capsys.readouterr().out)
    assert real["clock_speed"] == 1 and real["host_seconds"] == real["seconds"] > 500
    path = rig(clock={"speed": 20.0})
    assert main(["plan", "bending", "--rig", str(path), "--json"]) == 0
    fast = json.loads(capsys.readouterr().out)
    assert fast["seconds"] == real["seconds"] and fast["host_seconds"] == pytest.approx(real["seconds"] / 20)
    assert main(["plan", "bending", "--rig", str(path)]) == 0
    said = capsys.readouterr().out
    assert f"about {clock(real['seconds'])} of the rig's time, {clock(fast['host_seconds'])} of yours" in said
