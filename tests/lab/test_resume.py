"""A run that was killed goes on from its first unfinished trial; a disk that fills up ends a run safely and at once."""

from __future__ import annotations

import json
import os
import resource
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from virtual_lab import VirtualLab, journal_says, meanwhile, press_ctrl_c

import timing
from lab.cli import main
from lab.files.inputs import read_case
from lab.verbs.fakes import PATIENT_SETTLE
from recordings.campaign.journal import read
from recordings.campaign.labels import labels_of
from recordings.campaign.shelf import runs
from recordings.file.reader import Recording
from recordings.trials import Table

LATE = [word for setting in PATIENT_SETTLE[1:] for word in ("--set", setting)]
SHORT = ("--set", "spine_lengths=[0.0, 3 cm, 6 cm]", "--set", "pressures=[80 kPa]", "--set", "unload=false", *LATE)


def lab(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def started(rig: Path, folder: Path, limit: int | None = None, said: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """A run in a process of its own; `limit` (bytes) is where its disk is full."""
    command = [
        sys.executable,
        "-m",
        "lab.cli",
        "run",
        "bending",
        "--rig",
        str(rig),
        *SHORT,
        "--out",
        str(folder),
        *said,
    ]

    def fill() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))

    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, preexec_fn=fill)


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


def shape(table: Table) -> list[tuple[object, ...]]:
    return [(r.trial, r.step, r.repeat, r.branch, r.spine_length, round(r.pressures[8], -4)) for r in table]


def always(table: Table) -> list[str]:
    """All columns but the mark of a set-point that was reduced: on a busy computer a step of a ramp may come late."""
    return [name for name in table.columns if name != "clipped"]


def test_a_killed_run_is_resumed_from_its_first_unfinished_trial(real_lab: VirtualLab, tmp_path: Path) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert lab("run", "bending", "--rig", real_lab.rig, *SHORT, "--out", whole) in (0, 3)
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
    assert (
        lab("recover", first) == 3
    )  # as the how-to has it: the torn file, its recovered one and the resumed run together
    together = [first, broken / f"{first.stem}-recovered.mcap", second]
    assert read_case(together).table.rows == read_case([second, broken / "first.mcap"]).table.rows
    assert [(run.planned, run.rows) for run in runs(broken) if run.path == second.name] == [(6, 4)]
    resumed, plain = read_case([second, broken / "first.mcap"]).table, read_case(list(whole.glob("*.mcap"))).table
    assert len(resumed) == 6 and [row[:4] for row in shape(resumed)] == [row[:4] for row in shape(plain)]
    assert [row[4] for row in shape(resumed)] == pytest.approx([row[4] for row in shape(plain)], abs=1e-3)
    assert [row[5] for row in shape(resumed)] == [row[5] for row in shape(plain)]
    assert (resumed["t"][1:] > resumed["t"][:-1]).all() and always(resumed) == always(plain)

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


def test_what_cannot_be_resumed_is_told(
    virtual_lab: VirtualLab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.journal").write_text(
        '{"journal": 1, "campaign": "c", "protocol": "bending"}\n{"recording": "gone.mcap", "first_trial": 1}\n'
    )
    assert lab("run", "--resume", tmp_path / "a.journal", "--rig", virtual_lab.rig) == 2
    assert "gone.mcap" in capsys.readouterr().err
    assert lab("run", "--resume", tmp_path / "a.journal", "--rig", virtual_lab.rig, "--set", "repeats=2") == 2
    assert lab("run", "--rig", virtual_lab.rig) == 2


def test_a_full_disk_ends_the_run_safe_and_says_so(real_lab: VirtualLab, tmp_path: Path) -> None:
    freed(real_lab)
    process = started(real_lab.rig, tmp_path, limit=60_000)
    wait_for('"recording"', tmp_path, process)
    output, _ = process.communicate(timeout=600)
    plant = real_lab.fakes.plant
    assert process.returncode == 1 and "recording stopped" in output and "lab recover" in output
    assert timing.wait(lambda: max(plant.chamber_pressure) < 5e3 and not plant.valve_on, 30.0)
    (file,) = tmp_path.glob("*.mcap")
    assert file.stat().st_size <= 60_000
    assert lab("recover", file, "--out", tmp_path / "saved.mcap", "--json") == 3
    assert len(Recording.open(tmp_path / "saved.mcap").stream("/tip")) > 10
    assert json.loads(os.fsdecode((tmp_path / f"{file.stem}.journal").read_bytes().splitlines()[0]))["journal"] == 1
