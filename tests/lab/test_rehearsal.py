"""`lab plan --rehearse`: a protocol's own `run` at the desk, where nothing is connected."""

import re
import socket
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import Cli
from virtual_lab import settings

ROOT = Path(__file__).parents[2]
RIG = ROOT / "examples/rig/rig.yaml"
PUFF = '''
"""A puff into one group of chambers, at its height and after it."""

from functools import partial

from protocols.actions import ramp, vent
from protocols.errors import NotReached
from protocols.experiment import Ask, Plan, Reading, Step
from protocols.parameters import Parameters
from protocols.suspension import through_pauses
from recordings.states.rules import Window

PARAMETERS = Parameters
NEEDS = ("pressure", "mocap")
WAY = [(45e3, "load"), (0.0, "unload")]


def group(pressure):
    return (0.0, 0.0, pressure, pressure, pressure)


def plan(p):
    steps = [Step(f"{x / 1e3:g} kPa", 9.0, Ask(group(x), 15e3), (Reading(b, 4.0, 15e3),)) for x, b in WAY]
    return Plan("puff", steps)


def visit(bench, trials, trial, pressure, branch):
    arrived = ramp(bench, bench.chambers.setpoints(dict(enumerate(group(pressure), 1))), 15e3)
    row = trials.read(
        trial, Window(3.0, 2.0), branch=branch, t_start=arrived, ramp_end=arrived, rate=15e3,
        targets=group(pressure), topics=("/pressure", "/tip"), wait=30.0,
    )
    bench.say(f"tip at {bench.recorder.buffers.latest('/tip')['position'][2]:.3f} m, {row.pressures[2]:.0f} Pa")
    trials.step_done()


def run(bench, p, trials):
    vent(bench)
    trial = trials.begin()
    for pressure, branch in WAY:
        through_pauses(bench, partial(visit, bench, trials, trial, pressure, branch))
    trials.end(trial)
'''


@pytest.fixture(autouse=True)
def _nothing_is_connected(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*how: object, **more: object) -> None:
        raise AssertionError("a rehearsal needs neither sockets nor processes")

    monkeypatch.setattr(socket, "socket", refused)
    monkeypatch.setattr(subprocess, "Popen", refused)


def rehearsed(cli: Cli, protocol: object, *words: str, rig: Path = RIG) -> dict[str, Any]:
    found: dict[str, Any] = cli("plan", protocol, "--rig", rig, "--rehearse", "--json", *words).json["rehearsal"]
    return found


def puff(folder: Path, old: str = "", new: str = "") -> Path:
    assert old in PUFF
    file = folder / "puff.py"
    file.write_text(PUFF.replace(old, new))
    return file


@pytest.mark.parametrize(
    ("protocol", "values", "states", "trials"),
    [
        ("bending", ["spine_lengths=[0, 12 cm]", "repeats=2"], 44, 4),
        ("bending", ["reading=sweep", "spine_lengths=[20 cm]", "vacuums=[40 kPa, 70 kPa]"], 22, 2),
        ("bending", ["reading=hold", "hold_times=[1 s, 40 s]", "spine_lengths=[5 cm]", "unload=false"], 12, 1),
        ("elongation", ["spine_lengths=[7 cm]"], 6, 1),
        ("stiffness", ["spine_lengths=[6 cm, 18 cm]", "steps=5"], 10, 2),
        ("stiffness", ["specimen=body", "spine_lengths=[0]"], 8, 1),
        ("cycles", ["cycles=2"], 0, 0),
        ("arm_accuracy", ["poses=9"], 17, 17),
        (ROOT / "examples/protocol/staircase.py", ["chambers=[6, 7, 8]", "repeats=2"], 14, 2),
        (ROOT / "examples/protocol/creep.py", ["times=[3 s, 500 s]"], 2, 1),
    ],
)
def test_each_protocol_reads_what_it_plans(protocol: object, values: list[str], states: int, trials: int, cli: Cli) -> None:
    assert rehearsed(cli, protocol, *settings(*values)) == {"states": states, "trials": trials, "differs": []}


def test_a_robot_without_a_spine_needs_no_line_about_one(tmp_path: Path, cli: Cli) -> None:
    tutorial = (ROOT / "docs/tutorials/your-rig.md").read_text()
    (code,) = re.findall(r"```python\n# compare_chambers.py\n(.*?)```", tutorial, re.DOTALL)
    own = tmp_path / "compare_chambers.py"
    own.write_text(code)
    rig = yaml.safe_load(RIG.read_text())
    rig["instruments"] = {name: rig["instruments"][name] for name in ("pressure", "mocap")}
    rig["instruments"]["pressure"] |= {"chambers": [[1], [2], [3]], "max_pressure": "80 kPa"}
    rig["robot"] = str(ROOT / "examples/three_chambers/robot.yaml")
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(rig))
    assert rehearsed(cli, own, rig=file) == {"states": 3, "trials": 1, "differs": []}
    assert rehearsed(cli, "bending", "--set", "pressures=[30 kPa]", rig=file)["differs"] == []
    assert not re.search("home|set_spine|ambient|spine=", code)
    staircase = (ROOT / "examples/protocol/staircase.py").read_text()
    own.write_text(staircase.replace('("pressure", "mocap")', '("pressure",)'))
    assert rehearsed(cli, own, rig=file)["differs"] == []  # it waits for no cameras


def test_visits_that_wait_for_rest_read_what_a_bending_sweep_reads(tmp_path: Path, cli: Cli) -> None:
    own = tmp_path / "own.py"
    own.write_text(
        """
from protocols.bending import NEEDS
from protocols.parameters import Parameters
from protocols.visits import Sweep, Visit, go_through, plan_of
PARAMETERS = Parameters
WAY = [Visit(dict.fromkeys((6, 7, 8), x)) for x in (0.0, 30e3, 60e3, 30e3, 0.0)]
SWEEP = Sweep(spine_length=0.08, vacuum=60e3, repeats=2)


def plan(p):
    return plan_of("own", WAY, SWEEP)


def run(bench, p, trials):
    go_through(bench, trials, WAY, SWEEP)
"""
    )
    assert rehearsed(cli, own) == {"states": 10, "trials": 2, "differs": []}


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("    bench.say(f\"tip", "    bench.say(f\"{tpi} tip", "bench.say(f", "visit: NameError: name 'tpi' is not defined"),
        ("ramp_end=", "ramp_ends=", "row = trials.read(", "unexpected keyword argument 'ramp_ends'"),
        ("['position']", "['positon']", "bench.say(f", "no field of name positon"),
        ("row.pressures", "row.pressure", "bench.say(f", "AttributeError: 'TrialRow' object has no attribute 'pressure'"),
        ('"/tip"), wait', '"/top"), wait', "row = trials.read(", "topic '/top' is unknown; one of /pressure"),
        ("    trials.step_done()", "    raise NotReachd('never')", "raise NotReachd", "NameError: name 'NotReachd'"),
        ("bench.chambers.setpoints(dict(enumerate(group(pressure), 1)))", "[pressure]", "arrived = ramp(", "ValueError"),
        ("    vent(bench)", "    bench.need(bench.gauge, 'gauge')", "bench.need(", "gauge: this protocol uses it"),
        ('("pressure", "mocap")', '("pressure",)', "row = trials.read(", "mocap: no sample yet; check"),
        ("wait=30.0", "wait=0.5", "row = trials.read(", "visit: NotReached: trial 1 state 1"),
        ("    vent(bench)", "    while True: bench.pause(2.0)", "while True", "run has not ended after 1 h of rig time"),
        ("    vent(bench)", "    bench.spine.home()", "bench.spine.home()", "run: AttributeError"),
        ("WAY:\n        through", "WAY * 2:\n        through", "row = trials.read(", "reads state 3, and plan lists 2"),
        ("    vent(bench)", "    raise SystemExit('enough')", "raise SystemExit", "run: SystemExit: enough"),
        ("WAY = [(45e3", "WAY = [(fortyfive", "WAY = [(", "cannot be run: NameError: name 'fortyfive'"),
        ("    steps = [Step", "    steps = [Stp", "steps = [Stp", "NameError: name 'Stp'"),
        ("PARAMETERS = Parameters", "class PARAMETERS(Parameters):\n    defaults_for = classmethod(lambda cls, r: r.azimuths)",
         "r.azimuths", "'RobotFacts' object has no attribute 'azimuths'"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_run_is_told_with_its_line(old: str, new: str, line: str, said: str, tmp_path: Path, cli: Cli) -> None:
    file = puff(tmp_path, old, new)
    told, text = cli("plan", file, "--rig", RIG, "--rehearse", code=2).err.splitlines()
    number = int(told.removeprefix(f"{file}:").split(":")[0])
    assert said in told and text.strip() == file.read_text().splitlines()[number - 1].strip() and line in text


@pytest.mark.parametrize(
    ("old", "new", "differs"),
    [
        ("for pressure, branch in WAY:", "for pressure, branch in WAY[:1]:", ["2 states are planned; run reads 1"]),
        ("trial, pressure, branch))", "trial, pressure, 'load'))", ["state 2 is planned as trial 1, repeat 1, unload"]),
        ("(group(pressure), 1)", "(group(pressure / 1e3), 1)", ["run reads trial 1, repeat 1, load, spine 0 cm, 0, 0, 0.045"]),
        ("(group(pressure), 1)", "(group(2 * pressure), 1)", ["state 1 is planned as", "run asks for 90 kPa, its plan"]),
        (", (Reading(b, 4.0, 15e3),)", "", ["the plan's steps do not state what they read"]),
    ],
)  # fmt: skip
def test_a_run_that_reads_unplanned_states_is_told(old: str, new: str, differs: list[str], tmp_path: Path, cli: Cli) -> None:
    file = puff(tmp_path, old, new)
    found = rehearsed(cli, file)["differs"]
    assert len(found) == len(differs)
    assert all(part in text and text.startswith("puff: ") for part, text in zip(differs, found, strict=True))
    told = cli("plan", file, "--rig", RIG, "--rehearse")
    assert told.out.splitlines()[-1].startswith("rehearsal: run ends; states read: ")
    assert "note: puff: " in told.err
