"""Shells complete verbs, options, choices, files and protocols."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from lab.cli import main

ASK = """
source {script}
words=({line}); [ -n "{word}" ] || words+=("")
COMP_WORDS=("${{words[@]}}"); COMP_CWORD=$(( ${{#words[@]}} - 1 )); COMPREPLY=()
_shtab_lab lab "{word}"
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture
def script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert main(["completion", "bash"]) == 0
    path = tmp_path / "lab.bash"
    path.write_text(capsys.readouterr().out)
    (tmp_path / "beam.yaml").touch()
    (tmp_path / "beside.txt").touch()
    return path


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("lab diag", {"diagnose"}),
        ("lab run be", {"bending", "beam.yaml"}),
        ("lab run --res", {"--resume"}),
        ("lab run bending --set settle.max_", {"settle.max_gap=", "settle.max_hidden="}),
        ("lab predict --protocol elo", {"elongation"}),
        ("lab fit --with spine_sl", {"spine_slip"}),
        ("lab fakes --effect vacuum_l", {"vacuum_leak"}),
        ("lab check --rig bea", {"beam.yaml"}),
        ("lab blind ma", {"make"}),
        ("lab fakes --channels ", {"3", "9"}),
    ],
)
def test_bash_completes(script: Path, line: str, offered: set[str]) -> None:
    word = "" if line.endswith(" ") else line.rpartition(" ")[2]
    ask = ASK.format(script=script, line=line, word=word)
    done = subprocess.run(["bash", "-c", ask], cwd=script.parent, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == offered, done.stderr


def test_zsh_gets_a_completion_that_it_can_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "zsh"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("#compdef lab") and "_lab_protocols" in said and "_files" in said
    if zsh := shutil.which("zsh"):
        (tmp_path / "_lab").write_text(said)
        subprocess.run([zsh, "-n", tmp_path / "_lab"], check=True)
