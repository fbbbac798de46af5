"""`lab plan`, before anything is connected: what it says, numbers that are none, and every limit with its worst step."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import Cli

from lab import console
from lab.console import clock
from lab.files.all_protocols import found_protocols, protocol_keys
from lab.files.config import ConfigError, load
from lab.files.rig_file import load_rig, within_robot
from lab.files.robot_file import paper_robot
from lab.rig.limits import expected_force
from lab.verbs.run import job
from model.robot import Robot
from protocols.experiment import Push
from protocols.registry import OWN
from tests.simulated.bench import raises

RIG = Path(__file__).parents[2] / "examples" / "rig" / "rig.yaml"
LADDER = '''
"""Pressure levels, again and again."""

from pydantic import Field

from protocols.experiment import Ask, Plan, Step
from protocols.parameters import Parameters


class Ladder(Parameters):
    """Parameters."""

    levels: list[float] = Field([20e3, 40e3], json_schema_extra={"unit": "Pa"})
    """Visited in this order."""
    rounds: int = Field(2, ge=1, le=9)
    chambers: int = Field(9, ge=1)
    height: float = Field(json_schema_extra={"unit": "m"}, default=0.004)


PARAMETERS = Ladder
NEEDS = ("pressure",)


def plan(p):
    steps = [
        Step(f"{level / 1e3:g} kPa, repeat {k}", 4.0, Ask(pressures=(level,) * p.chambers))
        for k in range(1, p.rounds + 1)
        for level in p.levels
    ]
    return Plan("ladder", steps, {})


def run(bench, p, trials):
    pass
'''


@pytest.fixture
def ladder(tmp_path: Path) -> str:
    file = tmp_path / "ladder.py"
    file.write_text(LADDER)
    return str(file)


def planned(cli: Cli, *words: object) -> list[str]:
    return cli("plan", *words, "--rig", RIG).out.splitlines()


def test_the_summary_comes_first_with_the_limits_in_the_units_of_the_steps(cli: Cli) -> None:
    told = planned(cli, "bending", "--set", "pressures=[90 kPa]", "--set", "spine_lengths=[0, 20 cm]")
    assert told[0].startswith("bending: 8 steps, about ")
    assert told[1] == "  pressure 90 kPa of 250 kPa allowed: ok"
    assert "  spine length 20 cm of 35 cm allowed: ok" in told and "  tip mass 53 g" in told
    assert told[-1].endswith("0 kPa unload, spine 20 cm, vacuum 80 kPa, repeat 1")
    pushes = planned(cli, "stiffness", "--set", "spine_lengths=[20 cm]")
    assert "  deflection 4 mm" in pushes and any(line.startswith("  expected force ") for line in pushes)


def test_repeats_are_folded_unless_all_are_asked_for(ladder: str, cli: Cli) -> None:
    told = planned(cli, ladder, "--set", "rounds=5")
    assert told[1:3] == ["  pressure 40 kPa of 250 kPa allowed: ok", "  total pressure 360 kPa of 1500 kPa allowed: ok"]
    assert [line.split(maxsplit=3)[-1] for line in told[3:5]] == ["20 kPa", "40 kPa"]
    assert told[5].startswith("x 5 repeats") and len(told) == 6
    whole = planned(cli, ladder, "--set", "rounds=5", "--all")
    assert len(whole) == 3 + 10 and whole[-1].endswith("40 kPa, repeat 5")
    odd = planned(cli, ladder, "--set", "levels=[20 kPa, 40 kPa, 20 kPa]", "--set", "rounds=1")
    assert len(odd) == 3 + 3 and odd[-1].endswith("20 kPa, repeat 1")
    Path(ladder).write_text(LADDER.replace(", 4.0,", ", 0.5,").replace(", repeat {k}", ""))
    short = planned(cli, ladder, "--set", "levels=[20 kPa, 20 kPa, 40 kPa]", "--set", "rounds=1")
    assert [line.split() for line in short[3:]] == [
        ["1", "0.5", "s", "20", "kPa", "(2", "times)"],
        ["3", "0.5", "s", "40", "kPa"],
    ]


def test_a_plan_that_asks_for_nothing_warns(ladder: str, cli: Cli) -> None:
    assert "ladder: no step asks for a pressure" in cli("plan", ladder, "--rig", RIG, "--set", "levels=[0, 0]").err
    assert cli("plan", ladder, "--rig", RIG).err == cli("plan", "bending", "--rig", RIG, "--set", "repeats=2").err == ""
    assert "the noise floor) cannot be estimated; add --set repeats=3" in cli("plan", "bending", "--rig", RIG).flat_err


def test_the_keys_of_a_protocol_are_listed(ladder: str, cli: Cli) -> None:
    def keys(*words: object) -> dict[str, dict[str, str]]:
        return {key["name"]: key for key in cli("plan", *words, "--keys", "--json").json["keys"]}

    own = keys(ladder)
    assert own["levels"] == {
        "name": "levels", "unit": "kPa", "default": "[20, 40]", "limits": "", "meaning": "Visited in this order.",
    }  # fmt: skip
    assert (own["rounds"]["limits"], own["height"]["default"], own["height"]["unit"]) == ("from 1 to 9", "0.4", "cm")
    bending = keys("bending", "--rig", RIG)
    assert (bending["spine_lengths"]["limits"], bending["tip_mass"]["default"]) == ("from 0 to 35", "53")
    assert bending["reading"]["limits"] == "settled or sweep or hold"
    assert (bending["settle.band"]["unit"], bending["settle.band"]["default"]) == ("kPa", "1.5")
    assert keys("cycles")["chambers"]["limits"] == "from 1 to 64"
    told = cli("plan", "bending", "--rig", RIG, "--keys").out
    assert "This rig allows at most: pressure 250 kPa, total pressure 1500 kPa, " in told and "chambers 1 to 9\n" in told
    assert "with their unit: --set 'rate=25 kPa/s'." in told
    assert "\nlevels (kPa): default [20, 40]\n    Visited in this order.\n" in cli("plan", ladder, "--keys").out
    assert "--rig" in cli("plan", "bending", code=2).err


@pytest.mark.parametrize("name", OWN)
def test_every_key_of_the_protocols_has_a_meaning_and_fits_a_narrow_terminal(
    name: str, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = protocol_keys(found_protocols().usable[name].parameters, {})
    assert [key.name for key in found if not key.meaning] == []
    monkeypatch.setattr(console.out, "width", 80)
    told = cli("plan", name, "--keys").out.splitlines()[1:-1]
    assert [line for line in told if len(line) > 80] == []
    assert [line.split()[0].rstrip(":") for line in told if not line.startswith(" ")] == [key.name for key in found]
    said = " ".join(line.strip() for line in told)
    assert [key.name for key in found if key.meaning not in said] == []


def test_a_key_under_its_earlier_name_is_taken_with_a_note(tmp_path: Path, cli: Cli) -> None:
    file = tmp_path / "push.yaml"
    file.write_text("protocol: stiffness\nsteps: 3\nlengths: [7 cm]\n")
    assert "  spine length 7 cm of 35 cm allowed: ok" in planned(cli, file)
    assert "push.yaml:3:lengthsiscalledspine_lengthsnow" in "".join(cli("plan", file, "--rig", RIG).err.split())
    file.write_text("protocol: stiffness\nlengths: [7 cm, 7 m]\n")
    assert "push.yaml:2: spine_lengths" in cli("plan", file, "--rig", RIG, code=2).err
    file.write_text("protocol: stiffness\nlengths: [7 cm]\nspine_lengths: [7 cm]\n")
    assert "lengths: unknown key" in cli("plan", file, "--rig", RIG, code=2).err


# ------------------------------------------------------------------ numbers
@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("rate=1e-320", "rate = 9.99989e-321 Pa/s: must be 0, or at least"),
        ("rate='1e-320 kPa/s'", "must be 0, or at least"),
        ("rate=1e-300", "days of rig time, at most 30"),
        ("rate=1e-3", "days of rig time, at most 30"),
        ("rate=1e400", "must be a finite number"),
        ("rate=.nan", "must be a finite number"),
        ("rate=true", "rate = true: must be a number in Pa/s"),
        ("repeats=true", "repeats = true: must be a number"),
        ("chambers=[true]", "chambers[0] = true: must be a number"),
        ("repeats=1e300", "repeats"),
        ("repeats=three", "repeats = 'three': must be a number"),
        ("settle.band=1e-320", "settle.band = 9.99989e-321 Pa: must be 0, or at least"),
        ("spine_lengths=[1e-320]", "spine_lengths[0]"),
    ],
)
def test_a_number_that_is_none_is_named(setting: str, words: str, cli: Cli) -> None:
    assert words in cli("plan", "bending", "--rig", RIG, "--set", setting, code=2).flat_err


def test_a_number_that_yaml_takes_for_a_text_is_one(cli: Cli) -> None:
    cli("plan", "bending", "--rig", RIG, "--set", "repeats=1e0", "--set", "rate=2e4")


# ------------------------------------------------------------------ limits
Rig = Callable[..., Path]


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """The example's rig.yaml with tables changed, and robot.yaml beside it with values changed (None: left out)."""

    def write(robot: dict[str, Any] | None = None, without: str = "", **tables: dict[str, Any]) -> Path:
        data = yaml.safe_load(RIG.read_text()) | {"robot": "robot.yaml"}
        data.pop(without, None)
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
    return raises(ConfigError, None, job, protocol, rig, list(settings)).splitlines()


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


def test_the_robot_s_own_pressure_is_a_limit_beside_the_regulator_s(rig: Rig, cli: Cli) -> None:
    path = rig({"max_pressure": 100e3}, pressure={"max_pressure": 200e3})
    own, regulators = cli("plan", "bending", "--rig", path, code=2).err.splitlines()
    cli("plan", "bending", "--rig", path, "--set", "pressures=[100 kPa]")
    assert "requires 250 kPa, above max_pressure = 100 kPa of" in own and "robot.yaml" in own
    assert own.startswith("bending, step ") and "(250 kPa load, spine 0 cm" in own
    assert "250 kPa, above instruments.pressure.max_pressure = 200 kPa" in regulators


def test_chambers_that_bear_less_are_named(rig: Rig) -> None:
    path = rig({"max_pressure": [100e3, 300e3, 300e3] * 3})
    line, *_ = refused(path, "bending")
    assert "requires a pressure of chambers 1, 4, 7 of 250 kPa, above max_pressure = 100 kPa of" in line
    job("bending", path, ["chambers=[1, 2, 9]", "pressures=[100 kPa]"])


def test_every_limit_that_is_not_kept_has_its_line(rig: Rig) -> None:
    path = rig(
        pressure={"max_pressure": 100e3, "max_rate": 10e3},
        spine={"max_length": 0.2, "max_speed": 0.01},
        limits={"max_total_pressure": 500e3, "max_vacuum": 60e3},
    )
    lines = refused(path, "elongation")
    asked = [
        "150 kPa, above instruments.pressure.max_pressure = 100 kPa",
        "a total over the chambers of 1350 kPa, above limits.max_total_pressure = 500 kPa",
        "25 kPa/s, above instruments.pressure.max_rate = 10 kPa/s",
        "30 cm, above instruments.spine.max_length = 20 cm",
        "2 cm/s, above instruments.spine.max_speed = 1 cm/s",
        "a vacuum of 80 kPa, above limits.max_vacuum = 60 kPa",
    ]
    for words in asked:
        assert sum(f"requires {words}" in line for line in lines) == 1, (words, lines)
    assert len(lines) == len(asked) and all("elongation, step" in line and "; " in line for line in lines)


@pytest.mark.parametrize(
    ("protocol", "settings", "tables", "kept"),
    [
        ("bending", ["pressures=[200e3, 280e3]", "spine.speed=80 mm/s", "spine_lengths=[0, 35 cm]"],
         {"spine": {"max_length": 0.3}}, ["pressures=[200 kPa, 250 kPa]", "spine.speed=50 mm/s", "spine_lengths=[0 cm, 30 cm]"]),
        ("bending", ["pressures=[1 bar, 2.3 bar, 255 kPa, 260 kPa]"], {}, ["pressures=[1 bar, 2.3 bar, 2.5 bar]"]),
        ("bending", ["pressures=[1.01 kPa, 32.3 kPa, 64.6 kPa]"], {"pressure": {"max_pressure": 48.7e3}},
         ["pressures=[1.01 kPa, 32.3 kPa, 48.7 kPa]"]),
        ("bending", ["chambers=[1, 2, 3]"], {"limits": {"max_vacuum": 60e3}}, ["chambers=[9, 1, 2]", "vacuums=[60 kPa]"]),
        ("bending", ["chambers=[1,2,3,4,5,6,7,8,9]", "pressures=[100 kPa, 200 kPa]"], {}, ["pressures=[100 kPa, 166.6 kPa]"]),
        ("elongation", [], {"pressure": {"max_pressure": 20e3, "max_rate": 10e3}},
         ["pressures=[4 kPa, 8 kPa, 12 kPa, 16 kPa, 20 kPa]", "rate=10 kPa/s"]),
        ("cycles", ["chambers=[[1, 2]]", "pressures=[280 kPa]"], {}, ["pressures=[250 kPa]", "chambers=[[9, 1, 2]]"]),
        ("stiffness", [], {"limits": {"max_force": 4, "max_moment": 0.4}}, ["deflection_ratio=0.01564"]),
        ("stiffness", [], {"arm": {"workspace_min": [-0.75, -0.75, 0.45]}}, ["spine_lengths=[5 cm, 10 cm, 15 cm, 20 cm, 25 cm]"]),
        ("arm_accuracy", ["speed=40 cm/s", "acceleration=1"], {}, ["speed=10 cm/s", "acceleration=0.5 m/s^2"]),
        ("STAIRCASE", [], {"pressure": {"max_pressure": 40e3}}, ["step=13.33 kPa", "chambers=[9, 1, 2]"]),
        ("LADDER", ["chambers=11"], {}, ["chambers=9"]),
    ],
)  # fmt: skip
def test_a_plan_beyond_a_limit_names_a_setting_that_keeps_it(
    protocol: str, settings: list[str], tables: dict[str, Any], kept: list[str], rig: Rig, ladder: str
) -> None:
    path, own = rig(**tables), {"STAIRCASE": str(RIG.parents[1] / "protocol/staircase.py"), "LADDER": ladder}
    name = own.get(protocol, protocol)
    lines = refused(path, name, *settings)
    assert all(line.count(" add --set ") == 1 for line in lines), lines
    added = {shlex.split(line.partition(" add --set ")[2])[0].rstrip(",;") for line in lines}
    assert added == set(kept)
    job(name, path, [*settings, *added])


@pytest.mark.parametrize(
    ("box", "words"),
    [
        ({"workspace_min": [-0.75, -0.75, 0.45]}, ["z = 40 cm", "45 cm to 90 cm"]),  # the longest spine's end
        ({"workspace_min": [0.45, -0.75, 0.02]}, ["x = 42 cm", "45 cm to 75 cm"]),  # where it waits
        ({"workspace_max": [0.52, 0.75, 0.9]}, ["x = 53 cm", "-75 cm to 52 cm", "approach"]),  # the approach's last step
    ],
)
def test_every_place_of_the_probe_must_lie_in_the_arm_s_box(rig: Rig, box: dict[str, Any], words: list[str]) -> None:
    (line,) = refused(rig(arm=box), "stiffness")
    assert all(word in line for word in ("the probe at", *words)), line


def test_a_stiffness_trial_without_a_stand_is_refused(rig: Rig) -> None:
    (line,) = refused(rig(without="stand"), "stiffness")
    assert "stand: is missing" in line


def test_the_force_that_a_push_should_make_is_judged_beforehand(rig: Rig) -> None:
    robot = load(paper_robot(), Robot)
    force = expected_force(robot, Push("spine", 0.05, 0.05, 0.001, 25.0))
    assert force == pytest.approx(3 * 318e3 * 3.14159 / 4 * 0.029**4 * 0.001 / 0.05**3, rel=1e-4)
    lines = refused(rig(limits={"max_force": 4, "max_moment": 0.4}), "stiffness")
    assert any("4.41 N, above limits.max_force = 4 N" in line and "spine 10 cm" in line for line in lines)
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
    of_each = [200e3] * 8 + [100e3]
    for borne, told in ((100e3, 100e3), (1e6, 250e3), (of_each, (100e3, 200e3, 200e3))):
        read = load_rig(rig({"max_pressure": borne}))
        regulators = within_robot(read, read.body.max_pressure).instruments.pressure
        assert regulators is not None and regulators.max_pressure == told


def test_a_plan_tells_the_rigs_time_and_ones_own_apart(rig: Rig, cli: Cli) -> None:
    path = rig()
    real = cli("plan", "bending", "--rig", path, "--json").json
    assert real["clock_speed"] == 1 and real["host_seconds"] == real["seconds"] > 500
    path = rig(clock={"speed": 20.0})
    fast = cli("plan", "bending", "--rig", path, "--json").json
    assert fast["seconds"] == real["seconds"] and fast["host_seconds"] == pytest.approx(real["seconds"] / 20)
    said = cli("plan", "bending", "--rig", path).out
    assert f"about {clock(real['seconds'])} of rig time" in said
    assert f"At clock speed 20 this takes {clock(fast['host_seconds'])} of real time" in said
    assert not any("clock speed" in line for line in planned(cli, "bending"))
