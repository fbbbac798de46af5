"""Protocols come in by registration: from a file, from an installed package; what is wrong with one is told at once."""

from pathlib import Path

import pytest

from lab.cli import main
from lab.files.all_protocols import protocol_from_file
from lab.files.config import ConfigError

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
