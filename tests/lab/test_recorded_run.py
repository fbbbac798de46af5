"""What is recorded is what happened: files that people delete or edit meanwhile, and a terminal that is closed."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from terminal import Terminal
from test_resume import SHORT, freed
from virtual_lab import VirtualLab, journal_says, lab, meanwhile

import timing
from lab.files.inputs import read_case
from lab.rig.current import recording_of
from lab.verbs import run as run_verb
from recordings.file.reader import Recording
from recordings.file.verify import verify

READ = '{"trial": 1, "step": 1}'
BENDING = "PARAMETERS, NEEDS, plan, run = bending.PARAMETERS, bending.NEEDS, bending.plan, bending.run\n"


def delete_file(folder: Path) -> None:
    next(folder.glob("*.mcap")).unlink()


def rename_folder(folder: Path) -> None:
    folder.rename(folder.with_name("moved"))


def truncate(folder: Path) -> None:
    os.truncate(next(folder.glob("*.mcap")), 30_000)


@pytest.mark.parametrize("harm", [delete_file, truncate, pytest.param(rename_folder, marks=pytest.mark.long)])
def test_a_run_whose_recording_is_lost_lands_after_the_state_and_goes_on_from_the_rescue_file(
    harm: Callable[[Path], None], virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig" / "rig.yaml"
    shutil.copytree(virtual_lab.rig.parent, rig.parent)
    folder = tmp_path / "out"
    files: list[Path] = []
    meanwhile(lambda: journal_says(READ, folder), lambda: files.extend(folder.glob("*.mcap")), lambda: harm(folder))
    code = lab("run", "bending", "--rig", rig, *SHORT, "--out", folder)
    output = "".join(capsys.readouterr())
    (file,) = files
    (rescue,) = rig.parent.glob("*-rescue.mcap")
    assert code == 3, output
    told = "".join(output.split())
    assert str(file) in told and f"statesin{rescue}" in told and "Traceback" not in output
    assert verify(rescue).ok and lab("info", rescue) == (3 if harm is truncate else 0)
    found = Recording.open(rescue)
    assert found.outcome == "stopped" and any(str(file) in line.text for line in found.log if line.level == "error")
    assert found.metadata["outcome"]["safe_state"] == "confirmed" and len(found.trials) < 6
    assert lab("replay", rescue) == 0 or harm is truncate
    line = output.split("go on with: ")[1].splitlines()[0]
    assert lab(*shlex.split(line)[1:]) in (0, 3)
    second = max((p for p in rig.parent.glob("*.mcap") if p != rescue), key=lambda p: p.stat().st_mtime)
    assert {row.trial for row in read_case([rescue, second]).table} == {1, 2, 3}


def test_what_was_read_is_attached_whatever_the_files_hold_by_then(
    virtual_lab: VirtualLab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(virtual_lab.rig.parent, tmp_path / "rig")
    rig, robot, own = tmp_path / "rig" / "rig.yaml", tmp_path / "rig" / "robot.yaml", tmp_path / "bending.py"
    own.write_text("from protocols import bending\n" + BENDING)
    before = {"rig.yaml": rig.read_bytes(), "robot.yaml": robot.read_bytes(), "protocol.py": own.read_bytes()}
    connect = run_verb.connect

    def edited(*how: object, **more: object) -> None:
        connect(*how, **more)  # type: ignore[arg-type]
        for path in (rig, robot, own):
            path.write_text("edited: yes\n")

    monkeypatch.setattr(run_verb, "connect", edited)
    out = tmp_path / os.fsdecode(b"M\xfcller")  # which is no UTF-8
    assert lab("run", own, "--rig", rig, *SHORT, "--set", "spine_lengths=[0.0]", "--out", out) in (0, 3)
    (file,) = out.glob("*.mcap")
    assert recording_of(rig) == file
    found = Recording.open(file)
    assert {name: found.attachments[name] for name in before} == before
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in found.attachments.items()}
    assert found.metadata["sha256"] == sums and "protocol.yaml" in sums


@pytest.mark.parametrize("asked", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_closed_terminal_ends_a_run_as_a_signal_to_end_does(asked: bool, real_lab: VirtualLab, tmp_path: Path) -> None:
    """While a state is read, and while the person is asked to prepare the rig."""
    freed(real_lab)
    rig = real_lab.rig.with_name("at_terminal.yaml")
    rig.write_text(yaml.safe_dump({**yaml.safe_load(real_lab.rig.read_text()), "operator": "console"}))
    holding = (
        "--set",
        "reading=hold",
        "--set",
        "hold_times=[1, 400]",
    )  # the terminal is closed before the second state
    with Terminal("run", "bending", "--rig", rig, *SHORT, *holding, "--out", tmp_path) as terminal:
        terminal.until("Enter when ready")
        if not asked:
            terminal.press("\n")
            assert timing.wait(lambda: journal_says(READ, tmp_path), 120), terminal.shown
        terminal.hang_up()
        assert terminal.end() == 1
    (file,) = tmp_path.glob("*.mcap")
    found = Recording.open(file)
    assert found.outcome == "stopped" and found.metadata["outcome"]["safe_state"] == "confirmed"
    assert verify(file).ok
    assert not rig.with_suffix(".latch").exists()
