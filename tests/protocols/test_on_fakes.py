"""Every protocol on a whole rig of fakes, in simulated time: it ends by itself, and reads what it planned."""

from pathlib import Path

import pytest

from lab.cli import main
from lab.files.all_protocols import protocol_from_file
from lab.files.config import ConfigError
from lab.verbs.fakes import write_rig
from protocols.registry import OWN
from recordings.file.reader import Recording
from sim_fakes.rig import FakeRig

SMALL = {
    "arm_accuracy": ("poses=8", "passes=1"),
    "bending": ("spine_lengths=[0.05]", "pressures=[60 kPa, 90 kPa]"),
    "cycles": ("cycles=2",),
    "elongation": ("spine_lengths=[0.05]", "pressures=[60 kPa]"),
    "stiffness": ("spine_lengths=[0.1]", "steps=3", "min_samples=20", "zero_samples=20"),
}
"""Settings with which each takes seconds."""


@pytest.fixture(scope="module")
def rig(whole_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    write_rig(whole_rig, path)
    write_rig(whole_rig, path.with_name("arm_accuracy.yaml"), {"instruments": {"mocap": {"body": "Flange", "markers": []}}})
    return path


def test_none_is_left_out() -> None:
    assert set(SMALL) == set(OWN)


@pytest.mark.parametrize(
    "protocol", [pytest.param(p, marks=[pytest.mark.long] if p in ("bending", "stiffness") else []) for p in SMALL]
)
def test_it_runs_to_its_end(protocol: str, rig: Path, tmp_path: Path) -> None:
    settings = [word for setting in SMALL[protocol] for word in ("--set", setting)]
    own = rig.with_name(f"{protocol}.yaml")
    assert main(["run", protocol, "--rig", str(own if own.exists() else rig), *settings, "--out", str(tmp_path)]) in (0, 3)
    (file,) = tmp_path.glob("*.mcap")
    recording = Recording.open(file)
    assert recording.outcome == "completed" and recording.metadata["outcome"]["safe_state"] == "confirmed"
    if protocol != "cycles":  # which reads nothing
        assert len(recording.trials) >= 2


WAVE = '''
"""A sine on the first channel."""

import math

from pydantic import Field

from protocols.actions import play
from protocols.experiment import Ask, Plan, Step
from protocols.parameters import Parameters


class Wave(Parameters):
    """SI units."""

    seconds: float = Field(8.0, gt=0, le=60, json_schema_extra={"unit": "s"})


PARAMETERS = Wave
NEEDS = ("pressure", "mocap")
PEAK = (40e3, 40e3, *[0.0] * 6, 40e3)


def plan(p):
    return Plan("wave", [Step("start", 1.0), *[Step("wave", 0.5, Ask(PEAK))] * round(2 * p.seconds)])


def run(bench, p, trials):
    wave = lambda t: bench.chambers.setpoints(dict.fromkeys((9, 1, 2), 20e3 * (1 - math.cos(t))))
    play(bench, wave, p.seconds)
'''


def test_a_waveform_is_sent_and_recorded_and_its_plan_is_short(
    rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = tmp_path / "wave.py"
    own.write_text(WAVE)
    assert main(["plan", str(own), "--rig", str(rig), "--rehearse"]) == 0
    told = capsys.readouterr().out
    assert "   2     0.5 s  wave (16 times)" in told and told.count("wave (") == 1
    assert main(["run", str(own), "--rig", str(rig), "--out", str(tmp_path)]) in (0, 3)
    (file,) = tmp_path.glob("*.mcap")
    assert f"completed: streams in {file}" in capsys.readouterr().out.replace("\n", "") and main(["info", str(file)]) == 0
    assert "no states read" in capsys.readouterr().out.replace("\n", " ")
    setpoints = Recording.open(file).stream("/pressure")["setpoint"]
    assert 25e3 < setpoints[:, 0].max() < 41e3 and (setpoints[:, 2] < 1e3).all()
    assert len(set(setpoints[:, 0].tolist())) > 3


# -- user protocols from a file: errors are reported at once
ROOT = Path(__file__).parents[2]
CREEP = ROOT / "examples/protocol/creep.py"
RIG = str(ROOT / "examples/rig/rig.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 / 0", "cannot be run: ZeroDivisionError"),
        ("", "PARAMETERS must be a subclass"),
        ("NEEDS = ('presure',)", r"NEEDS = \('presure',\) must be a tuple of pressure, spine"),
    ],
)
def test_a_file_that_holds_none_is_told(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        protocol_from_file(path)


def test_a_wrong_one_fails_before_anything_is_connected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.py"
    path.write_text(CREEP.read_text().replace("    asks = ", "    asks = nothing + "))
    assert main(["run", str(path), "--rig", RIG, "--out", str(tmp_path)]) == 2
    line = 1 + path.read_text().splitlines().index(next(x for x in path.read_text().splitlines() if "nothing +" in x))
    assert f"{path}:{line}: plan: NameError" in capsys.readouterr().err
    assert main(["plan", str(tmp_path / "zzz.py"), "--rig", RIG]) == 2
    assert capsys.readouterr().err == f"{tmp_path / 'zzz.py'}: no such file\n"
    assert main(["plan", str(tmp_path / "mine_.py"), "--rig", RIG]) == 2
    assert capsys.readouterr().err == f"{tmp_path / 'mine_.py'}: no such file; did you mean {path}?\n"
    assert main(["plan", "bendin", "--rig", RIG]) == 2
    assert "must be one of stiffness, bending, elongation, cycles, arm_accuracy, or a protocol file" in capsys.readouterr().err


def test_a_copied_file_is_a_protocol_of_its_own_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "slow_creep.py"
    path.write_text(CREEP.read_text())
    assert main(["plan", str(path), "--rig", RIG, "--rehearse"]) == 0
    told = capsys.readouterr()
    assert told.out.startswith("slow_creep: ") and told.err.startswith("note: slow_creep: each state is read once")


def test_a_plan_of_one_s_own_is_held_against_the_limits(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(CREEP), "--rig", RIG]) == 0
    assert "read after 30 s" in capsys.readouterr().out
    assert main(["plan", str(CREEP), "--rig", RIG, "--set", "pressure=290 kPa"]) == 2
    assert "creep, step 1" in capsys.readouterr().err
