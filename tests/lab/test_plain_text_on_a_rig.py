"""Markup and terminal codes in what instruments, files and people say: the run ends as it should, and all of it is plain."""

from __future__ import annotations

import contextlib
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from virtual_lab import VirtualLab

import timing
from lab.cli import main
from lab.verbs.fakes import PATIENT_SETTLE
from recordings.file.reader import Recording

HOSTILE = "[/red] [bold]x[/] \x1b[2J <script>alert(1)</script>"
SHOWN = "[/red] [bold]x[/]"
SERIAL = "\x1b[2J[/b]"
"""Eight characters that are no blanks, as the module's identity is."""
SHORT = [word for setting in ("spine_lengths=[0.05, 0.08]", "pressures=[60 kPa]", *PATIENT_SETTLE) for word in ("--set", setting)]
"""Noise looks like motion when the processors are busy."""


@contextlib.contextmanager
def hostile(lab: VirtualLab, folder: Path) -> Iterator[Path]:
    """A rig file and a robot with such names, and a valve with such an identity."""
    name = HOSTILE.replace("\x1b", "")  # a file that holds a control character is refused
    rig = yaml.safe_load(lab.rig.read_text()) | {"name": name}
    robot = yaml.safe_load(lab.rig.with_name("robot.yaml").read_text()) | {"name": name}
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot))
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(rig))
    valve = lab.fakes.lines["valve"]
    valve.identity = SERIAL  # type: ignore[attr-defined]
    try:
        yield path
    finally:
        valve.identity = "SOFTLAB1"  # type: ignore[attr-defined]
        valve.faults.extra.clear()


def on_a_terminal(*arguments: str) -> tuple[int, str]:
    """Exit code of the command, and everything that reached the terminal it ran at."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "lab.cli", *arguments]
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "400"}
    process = subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    seen = b""
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:
            break
        if not piece:
            break
        seen += piece
    os.close(ours)
    return process.wait(60), seen.decode()


def test_check_shows_names_identities_and_foreign_answers_plain(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with hostile(virtual_lab, tmp_path) as rig:
        assert main(["check", "--rig", str(rig), "--seconds", "0.3"]) in (0, 3)
        said = capsys.readouterr()
        assert "\x1b" not in said.out + said.err and SHOWN in said.out and "\\x1b[2J[/b]" in said.out
        virtual_lab.fakes.lines["valve"].faults.extra["foreign"] = HOSTILE
        assert main(["check", "--rig", str(rig), "--seconds", "0.3"]) == 1
        said = capsys.readouterr()
        assert "\x1b" not in said.out + said.err
        assert "missing: valve" in said.err and "[/red]" in said.err and "[/red]" in said.out


def test_a_fault_in_mid_run_ends_it_with_its_error_and_a_whole_recording(real_lab: VirtualLab, tmp_path: Path) -> None:
    plant, valve = real_lab.fakes.plant, real_lab.fakes.lines["valve"]
    over = timing.Event()

    def spoil() -> None:
        while not over.wait(0.005):
            if plant.valve_on:
                valve.faults.extra["garbled"] = HOSTILE
                return

    thread = timing.Thread(target=spoil, daemon=True)
    thread.start()
    with hostile(real_lab, tmp_path) as rig:
        code, seen = on_a_terminal("run", "bending", "--rig", str(rig), *SHORT, "--out", str(tmp_path))
    over.set()
    thread.join()
    assert code == 1, seen
    assert "\x1b[2J" not in seen, "the terminal was repainted"
    assert SHOWN in seen and "Traceback" not in seen
    (file,) = tmp_path.glob("*.mcap")
    recording = Recording.open(file)
    assert recording.outcome == "failed"
    assert "valve" in recording.metadata["outcome"]["detail"]
