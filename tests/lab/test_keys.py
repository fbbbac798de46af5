"""Keys at the terminal of a run, pressed at a real one: each is in the recording, and the rig does what was asked."""

from __future__ import annotations

import csv
import functools
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
from virtual_lab import VirtualLab, journal_says, meanwhile

import timing
from lab.cli import main
from lab.console import Screen
from lab.files.inputs import read_case
from lab.rig.assembly import Rig
from lab.rig.keys import HELP, Line
from lab.verbs.fakes import PATIENT_SETTLE
from lab.verbs.run import connect, execute, job
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


def test_the_last_reading_of_a_state_counts_and_a_skipped_trial_is_not_done_again(
    virtual_lab: VirtualLab, tmp_path: Path
) -> None:
    steering, rig = Steering(), virtual_lab.rig
    words = ["spine_lengths=[0.0, 3 cm]", "pressures=[60 kPa]"]
    first, then = '{"trial": 1, "step": 1}', '{"trial": 2, "step": 1}'
    for seen, kind in (('"recording"', "repeat"), (first, "skip"), ('"skipped"', "repeat"), (then, "finish")):
        meanwhile(functools.partial(journal_says, seen, tmp_path), functools.partial(steering.ask, kind, "test"))
    asked_for = job("bending", rig, words)
    with Rig(asked_for.rig) as opened:
        connect(opened, asked_for.experiment.needs, quiet=True)
        done = execute(opened, asked_for, tmp_path, Screen("test", quiet=True), steering=steering)
    assert done.outcome == "stopped"
    file, (journal,) = done.file, tmp_path.glob("*.journal")
    recording = Recording.open(file)
    again, second = [t for t in recording.trials if t.repeats]
    before = {t.number: t.row for t in recording.trials}[again.repeats]
    assert (again.row.trial, again.row.step) == (before.trial, before.step) and again.row.t > before.t
    assert {s.number: s.repeats for s in recording.states}[again.number] == again.repeats
    assert read(journal).skipped == {1} and compare(recording).equal
    table = table_of(recording)
    assert not any(row.trial == 1 for row in table) and "trial 1: was skipped" in table.warnings[0]
    assert replay(file).rows == table.rows and replay(file).warnings == table.warnings
    assert [r.trial for r in recording.requests if r.kind == "skip" and r.done] == [1]
    case = read_case([file]).table
    assert second.row == case.rows[0] and any("was read again" in text for text in case.warnings)

    assert main(["run", "--resume", str(file), "--rig", str(rig)]) in (0, 3)
    (other,) = set(tmp_path.glob("*.mcap")) - {file}
    assert {e.row.trial for e in Recording.open(other).trials} == {2}
    assert [(r.trial, r.step) for r in read_case([file, other]).table] == [(2, s) for s in range(1, 4)]


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


def test_a_run_that_is_told_to_end_leaves_the_terminal_as_it_was(real_lab: VirtualLab, rig: Path, tmp_path: Path) -> None:
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
        for piece in ("n" + "y" * (LONGEST + 100), "\r", "n", "given up", "\x1b", "pp", "r", "s", "q"):
            line.take(piece)
    notes = [text for kind, _, text, _ in run.kept if kind == "note"]
    assert notes == ["wet", "abq", "y" * LONGEST] and run.finished == 1 and run.typed[-1] is None
    asked = [
        ("pause", "terminal"),
        ("go on", "terminal"),
        ("repeat", "terminal"),
        ("skip", "terminal"),
        ("finish", "terminal"),
    ]
    assert run.kept[-5:] == [(*words, "", False) for words in asked]
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
