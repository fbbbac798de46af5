"""A run that was killed or stopped goes on from its first unfinished trial."""

from __future__ import annotations

import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from virtual_lab import VirtualLab, journal_says, lab, meanwhile, press_ctrl_c

import timing
from lab.files.inputs import read_case
from lab.verbs.fakes import PATIENT_SETTLE
from recordings.campaign.journal import read
from recordings.campaign.labels import labels_of
from recordings.campaign.shelf import runs
from recordings.file.reader import Recording

LATE = [word for setting in PATIENT_SETTLE[1:] for word in ("--set", setting)]
SHORT = ("--set", "spine_lengths=[0.0, 3 cm, 6 cm]", "--set", "pressures=[80 kPa]", "--set", "unload=false", *LATE)


def started(rig: Path, folder: Path) -> subprocess.Popen[str]:
    """A run in a process of its own."""
    command = [sys.executable, "-m", "lab.cli", "run", "bending", "--rig", str(rig), *SHORT, "--out", str(folder)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def wait_for(text: str, folder: Path, process: subprocess.Popen[str]) -> None:
    """Until the journal says so."""
    assert timing.wait(lambda: journal_says(text, folder) or process.poll() is not None, 120)
    assert process.poll() is None, process.communicate()[0]


def freed(virtual_lab: VirtualLab) -> None:
    """What a person does after a crash: look at the rig, bring it into the safe state, say that it is."""
    deadline = timing.now() + 120
    while lab("safe", "--clear", "--rig", virtual_lab.rig) != 0:
        assert timing.now() < deadline
        timing.sleep(0.5)


def test_a_killed_run_is_resumed_from_its_first_unfinished_trial(real_lab: VirtualLab, tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    process = started(real_lab.rig, broken)
    wait_for('{"trial": 2, "step": 1}', broken, process)
    process.send_signal(signal.SIGKILL)
    process.wait()
    (first,) = broken.glob("*.mcap")
    freed(real_lab)
    assert lab("run", "--resume", first, "--rig", real_lab.rig) in (0, 3)

    (journal,) = broken.glob("*.journal")
    progress = read(journal)
    assert progress.done == {1: 2, 2: 2, 3: 2} and [n for _, n in progress.recordings] == [1, 2]
    second = broken / progress.recordings[1][0]
    assert {row.row.trial for row in Recording.open(second).trials} == {2, 3}
    # The unfinished sweep was begun again: its first state is there twice, in two files, and once in the table.
    assert 2 in {event.row.trial for event in Recording.open(first, truncated=True).trials}
    assert lab("recover", first, "--out", broken / "first.mcap") == 3
    assert lab("recover", first) == 3  # as the how-to has it: the torn file, its recovered one and the resumed run together
    together = [first, broken / f"{first.stem}-recovered.mcap", second]
    assert read_case(together).table.rows == read_case([second, broken / "first.mcap"]).table.rows
    assert [(run.planned, run.rows) for run in runs(broken) if run.path == second.name] == [(6, 4)]
    resumed = read_case([second, broken / "first.mcap"]).table
    assert [(r.trial, r.step, r.repeat, r.branch) for r in resumed] == [(t, s, 1, "load") for t in (1, 2, 3) for s in (1, 2)]
    assert resumed["spine_length"] == pytest.approx([0.0, 0.0, 0.03, 0.03, 0.06, 0.06], abs=1e-3)
    assert [round(r.pressures[8], -4) for r in resumed] == [0.0, 80e3] * 3
    assert (resumed["t"][1:] > resumed["t"][:-1]).all() and set(read_case([second]).table.columns) <= set(resumed.columns)

    assert lab("run", "--resume", journal, "--rig", real_lab.rig) in (0, 3)
    assert read_case([second, broken / "first.mcap"]).table.rows == resumed.rows


def test_a_run_that_was_stopped_says_how_to_go_on_and_that_does(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "with blank"
    meanwhile(lambda: journal_says('{"trial": 2, "step": 1}', folder), press_ctrl_c)
    said = ("--operator", "Ada", "--tag", "batch=3")
    code = lab("run", "bending", "--rig", virtual_lab.rig, *SHORT, "--out", folder, *said)
    output = "".join(capsys.readouterr())
    assert code == 1, output
    (told,) = [line for line in output.splitlines() if line.startswith("go on with: ")]
    words = shlex.split(told.removeprefix("go on with: "))
    (first,) = folder.glob("*.mcap")
    assert words == ["lab", "run", "--resume", str(first), "--rig", str(virtual_lab.rig)]
    assert lab(*words[1:], "--tag", "batch=4") in (0, 3)
    (second,) = set(folder.glob("*.mcap")) - {first}
    assert labels_of(Recording.open(first)) == {"operator": "Ada", "batch": "3"}
    assert labels_of(Recording.open(second)) == {"operator": "Ada", "batch": "4"}
    assert {row.trial for row in read_case([first, second]).table} == {1, 2, 3}


def test_what_cannot_be_resumed_is_told(virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.journal").write_text(
        '{"journal": 1, "campaign": "c", "protocol": "bending"}\n{"recording": "gone.mcap", "first_trial": 1}\n'
    )
    assert lab("run", "--resume", tmp_path / "a.journal", "--rig", virtual_lab.rig) == 2
    assert "gone.mcap" in capsys.readouterr().err
    assert lab("run", "--resume", tmp_path / "a.journal", "--rig", virtual_lab.rig, "--set", "repeats=2") == 2
    assert lab("run", "--rig", virtual_lab.rig) == 2
