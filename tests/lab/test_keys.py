"""Keys at the terminal of a run, pressed at a real one: each is in the recording, and the rig does what was asked."""

from __future__ import annotations

import csv
import json
import os
import signal
import sys
import termios
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from terminal import WITHIN, Terminal
from virtual_lab import VirtualLab

import timing
from lab.cli import main
from lab.files.inputs import read_case
from lab.rig.keys import HELP, Line
from lab.verbs.fakes import PATIENT_SETTLE
from protocols.errors import BadRequest
from protocols.steering import LONGEST, Steering
from recordings.campaign.journal import read
from recordings.campaign.replay import compare, replay, table_of
from recordings.file.reader import Recording

LATE = [word for setting in PATIENT_SETTLE for word in ("--set", setting)]
SHORT = ("--set", "spine_lengths=[0.0, 3 cm]", "--set", "pressures=[60 kPa, 90 kPa]", *LATE)
HOSTILE = "[red]<b>3</b>"


@pytest.fixture
def rig(real_lab: VirtualLab) -> Path:
    """The rig of fakes, with a person at the terminal."""
    told = yaml.safe_load(real_lab.rig.read_text())
    own = real_lab.rig.with_name("at_terminal.yaml")
    own.write_text(yaml.safe_dump({**told, "operator": "console"}))
    own.with_suffix(".latch").unlink(missing_ok=True)
    return own


def at_terminal(rig: Path, folder: Path, *words: object) -> Terminal:
    """A bending run whose person has just said that the rig is ready."""
    terminal = Terminal("run", "bending", "--rig", rig, *(words or SHORT), "--out", folder)
    terminal.until("Enter when ready")
    assert terminal.mode == terminal.before
    terminal.press("\n")
    terminal.until("Repeat 1 of 1")
    return terminal


def asked(file: Path) -> list[tuple[str, str, str, bool]]:
    return [(r.kind, r.by, r.text, r.done) for r in Recording.open(file, truncated=True).requests]


def wait(holds: Callable[[], bool]) -> None:
    assert timing.wait(holds, WITHIN)


def test_a_run_is_paused_noted_in_and_goes_on_with_every_state_there_once(
    real_lab: VirtualLab, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = real_lab.fakes.plant
    with at_terminal(rig, tmp_path) as terminal:
        assert HELP in terminal.shown and terminal.mode != terminal.before
        (journal,) = tmp_path.glob("*.journal")
        wait(lambda: '{"trial": 1, "step": 3}' in journal.read_text())  # then comes the way down
        terminal.press("p")
        terminal.until("Paused: vented and stopped")
        assert float(plant.regulator.max()) < 5e3
        terminal.press("n")
        terminal.until("note: _")
        terminal.press(f"{HOSTILE} häxy\x7f\x7f\x7falf\rq")  # what follows in one piece was pasted
        terminal.until(f"Note: {HOSTILE} half (terminal)")
        terminal.press(" ")
        terminal.until("Resuming")
        assert terminal.end() in (0, 3), terminal.shown
        assert terminal.mode == terminal.before
    (file,) = tmp_path.glob("*.mcap")
    assert asked(file) == [
        ("pause", "terminal", "", False), ("pause", "terminal", "", True), ("note", "terminal", f"{HOSTILE} half", True),
        ("go on", "terminal", "", False), ("go on", "terminal", "", True),
    ]  # fmt: skip
    recording = Recording.open(file)
    rows = table_of(recording)
    assert [(r.trial, r.step) for r in rows] == [(t, s) for t in (1, 2) for s in range(1, 6)]
    # Down from the highest again: the state after the pause, at 60 kPa, was come to from 90 kPa (as far as was sampled).
    pause, after = recording.requests[1], next(s for s in recording.states if s.t > recording.requests[-1].t)
    pressure = recording.stream("/pressure")
    between = pressure["setpoint"][(pressure["t"] > pause.t) & (pressure["t"] < after.t)].max(axis=1)
    assert after.state.branch == "unload" and between.min() < 1e3 and between.max() > 75e3
    assert compare(recording).equal
    capsys.readouterr()
    assert main(["info", str(file)]) in (0, 3)
    said = capsys.readouterr().out
    assert f"note (terminal): {HOSTILE} half" in said and "pause done, asked for by terminal" in said
    assert main(["info", str(file), "--json"]) in (0, 3)
    assert json.loads(capsys.readouterr().out)["requests"][2]["text"] == f"{HOSTILE} half"
    assert main(["runs", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["notes"] == 1
    assert main(["export", "--out", str(tmp_path / "out"), str(file)]) == 0
    with open(tmp_path / "out" / "requests.csv", newline="") as lines:
        assert [row["text"] for row in csv.DictReader(lines)][2] == f"{HOSTILE} half"


def test_a_state_read_once_more_counts_once_and_a_skipped_trial_is_not_done_again(
    real_lab: VirtualLab, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with at_terminal(rig, tmp_path) as terminal:
        terminal.press("r")
        terminal.until("This state is read once more (terminal)")
        (file,) = tmp_path.glob("*.mcap")
        wait(lambda: any(t.repeats for t in Recording.open(file, truncated=True).trials))
        terminal.press("s")
        terminal.until("Trial 1 is left out")
        terminal.press("q")
        terminal.until("Ending after this step (terminal)")
        assert terminal.end() == 1 and "stopped: " in terminal.shown and "go on with:" in terminal.shown
    recording, (journal,) = Recording.open(file), tmp_path.glob("*.journal")
    again = [t for t in recording.trials if t.repeats]
    first = {t.number: t.row for t in recording.trials}[again[0].repeats]
    assert (again[0].row.trial, again[0].row.step) == (first.trial, first.step) and again[0].row.t > first.t
    assert {s.number: s.repeats for s in recording.states}[again[0].number] == again[0].repeats
    assert read(journal).skipped == {1} and compare(recording).equal
    table = table_of(recording)
    assert not any(row.trial == 1 for row in table) and "trial 1: was skipped" in table.warnings[0]
    assert replay(file).rows == table.rows and replay(file).warnings == table.warnings
    skips = [r for r in recording.requests if r.kind == "skip" and r.done]
    assert [r.trial for r in skips] == [1]

    assert main(["run", "--resume", str(file), "--rig", str(rig)]) in (0, 3)
    (other,) = set(tmp_path.glob("*.mcap")) - {file}
    assert {e.row.trial for e in Recording.open(other).trials} == {2}
    rows = read_case([file, other]).table
    assert [(r.trial, r.step) for r in rows] == [(2, s) for s in range(1, 6)]
    capsys.readouterr()


def test_the_last_reading_of_a_state_is_the_one_that_counts(real_lab: VirtualLab, rig: Path, tmp_path: Path) -> None:
    words = ("--set", "spine_lengths=[0.0]", "--set", "pressures=[60 kPa]", *LATE)
    with at_terminal(rig, tmp_path, *words) as terminal:
        terminal.press("r")
        assert terminal.end() in (0, 3), terminal.shown
    (file,) = tmp_path.glob("*.mcap")
    recording = Recording.open(file)
    (again,) = [t for t in recording.trials if t.repeats]
    table = read_case([file]).table
    assert len(recording.trials) == 4 and [(r.trial, r.step) for r in table] == [(1, 1), (1, 2), (1, 3)]
    assert again.row in table.rows and any("was read again" in text for text in table.warnings)
    assert replay(file).rows == table.rows


def test_in_a_pause_somebody_may_stand_before_the_cameras(real_lab: VirtualLab, rig: Path, tmp_path: Path) -> None:
    fakes = real_lab.fakes
    with at_terminal(rig, tmp_path) as terminal:
        terminal.press("p")
        terminal.until("Paused: vented and stopped")
        fakes.door.answer(b'{"tip_visible": false}')
        try:
            terminal.press("n")
            terminal.until("note: _")
            terminal.press("\x1b")  # nothing to note
            wait(lambda: "note:" not in terminal.shown.rpartition("bending")[2])
            terminal.press("p")
            terminal.until("Going on")
        finally:
            fakes.door.answer(b'{"tip_visible": true}')
        terminal.until("Resuming")
        terminal.press("q")
        assert terminal.end() == 1
        assert terminal.mode == terminal.before


SHELL = """
import os, signal, subprocess, sys, termios

signal.signal(signal.SIGTTOU, signal.SIG_IGN)
job = subprocess.Popen([sys.executable, "-m", "lab.cli", *sys.argv[1:]], process_group=0)
while True:
    os.tcsetpgrp(0, job.pid)
    os.killpg(job.pid, signal.SIGCONT)
    _, status = os.waitpid(job.pid, os.WUNTRACED)
    os.tcsetpgrp(0, os.getpgrp())
    if not os.WIFSTOPPED(status):
        sys.exit(os.waitstatus_to_exitcode(status))
    print("stopped, as it was:", bool(termios.tcgetattr(0)[3] & termios.ICANON), flush=True)
"""
"""The least of a shell: a job that Ctrl-Z stops is told of, and goes on in the foreground."""


def test_by_ctrl_z_the_terminal_is_the_shells_and_keys_work_again_when_the_run_goes_on(
    real_lab: VirtualLab, rig: Path, tmp_path: Path
) -> None:
    words = ("run", "bending", "--rig", rig, *SHORT, "--out", tmp_path)
    with Terminal(*words, program=(sys.executable, "-c", SHELL)) as terminal:
        terminal.until("Enter when ready")
        terminal.press("\n")
        terminal.until("Repeat 1 of 1")
        assert terminal.mode != terminal.before
        terminal.press("\x1a")
        terminal.until("stopped, as it was: True")
        wait(lambda: terminal.mode != terminal.before)
        terminal.press("q")
        terminal.until("Ending after this step (terminal)")
        terminal.end()
        assert terminal.mode == terminal.before


def test_a_run_that_is_told_to_end_leaves_the_terminal_as_it_was(
    real_lab: VirtualLab, rig: Path, tmp_path: Path
) -> None:
    with at_terminal(rig, tmp_path) as terminal:
        cbreak = terminal.mode
        assert not cbreak[3] & termios.ICANON and not cbreak[3] & termios.ECHO and cbreak[3] & termios.ISIG
        os.kill(terminal.program.pid, signal.SIGTERM)
        assert terminal.end() == 1 and terminal.mode == terminal.before


class Asked:
    """A run that takes requests, and what was recorded of them."""

    def __init__(self) -> None:
        self.kept: list[tuple[str, str, str, bool]] = []
        self.said: list[str] = []
        self.finished = 0
        self.typed: list[str | None] = []
        self.steering = Steering()

    def finish(self) -> None:
        self.finished += 1

    def keep(self, kind: str, by: str, text: str, done: bool, trial: int, step: int) -> None:
        self.kept.append((kind, by, text, done))


def test_what_is_typed_is_keys_or_a_note_and_nothing_that_acts_gets_into_it() -> None:
    run = Asked()
    line = Line(run.steering, run.said.append, run.typed.append)
    with run.steering.of_run(run.keep, run.finish, run.said.append):
        for piece in (
            "x\x1b[A\x1b",
            "n",
            "tip ",
            "\x1b[D",
            "l\x00o\x1b[31mo",
            "se\x15",
            "wet",
            "\r",
            "n",
            "ab\x1b",
            "q\nq",
        ):
            line.take(piece)
        line.take("n" + "y" * (LONGEST + 100))
        line.take("\r")
        line.take("pp")
    notes = [text for kind, _, text, _ in run.kept if kind == "note"]
    assert notes == ["wet", "abq", "y" * LONGEST]
    assert run.kept[-2:] == [("pause", "terminal", "", False), ("go on", "terminal", "", False)]
    assert not any(ord(c) < 32 for text in notes for c in text)


def test_a_request_counts_once_and_what_was_never_carried_out_is_told() -> None:
    run = Asked()
    steering = run.steering
    assert steering.ask("note", "page", "early") == "No run goes on"
    with steering.of_run(run.keep, run.finish, run.said.append):
        for kind in ("pause", "pause", "repeat", "finish", "finish", "go on", "go on"):
            steering.ask(kind, "page")
        for kind, text in (("dance", ""), ("note", "  \n "), ("note", "x" * (LONGEST + 1))):
            with pytest.raises(BadRequest):
                steering.ask(kind, "page", text)
        assert run.finished == 1 and not steering.take("pause") and not steering.take("skip")
    assert [kind for kind, *_ in run.kept] == ["pause", "repeat", "finish", "go on"]
    assert run.said[-1].startswith("repeat: this was asked and not carried out")
