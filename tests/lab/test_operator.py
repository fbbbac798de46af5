"""The person at a run: who may prepare and confirm, and keys pressed at a real terminal."""

import csv
import functools
import io
import json
import os
import signal
import socket
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from commands import SOUND, Cli
from pydantic import ValidationError
from terminal import WITHIN, Terminal
from virtual_lab import VirtualLab, journal_says, meanwhile, press_ctrl_c, settings

import timing
from benchmarks.faults.night import write_campaign
from lab.console import Screen
from lab.files.inputs import read_case
from lab.files.rig_file import RigFile
from lab.rig.assembly import Rig
from lab.rig.keys import HELP, Line
from lab.rig.operator import Program, operator, preparations
from lab.verbs.fakes import PATIENT_SETTLE
from lab.verbs.jog import readings
from lab.verbs.run import connect, execute, job
from protocols.bench import Bench, Setup
from protocols.errors import BadRequest, ProtocolError, Stopped
from protocols.steering import LONGEST, Steering
from recordings.campaign.replay import compare, replay, table_of
from recordings.file.journal import read
from recordings.file.reader import Recording
from tests.simulated.bench import raises

# ------------------------------------------------------------------ who may prepare and confirm
SETUP = Setup("robot", 0.0, 0.0, 80e3)
needs_root = pytest.mark.skipif(os.getuid() != 0, reason="needs a second user")
NOBODY = 65534


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Short enough for a socket, of mode 0700."""
    folder = tmp_path_factory.mktemp("op", numbered=True)
    folder.chmod(0o700)
    yield folder


@contextmanager
def answering(path: Path, answer: object) -> Iterator[list[dict[str, object]]]:
    """A program that answers one question."""
    asked: list[dict[str, object]] = []
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen()

        def serve() -> None:
            try:
                connection, _ = server.accept()
            except OSError:
                return  # nobody asked
            with connection:
                asked.append(json.loads(connection.makefile().readline()))
                connection.sendall(json.dumps(answer).encode() + b"\n")

        thread = timing.Thread(target=serve, daemon=True)
        thread.start()
        yield asked
        server.shutdown(socket.SHUT_RDWR)
        thread.join(10)


def test_what_is_prepared_names_no_spine_and_vacuum_where_there_is_none() -> None:
    assert preparations(Setup("robot", 0.0, 0.0, 0.0)) == (
        "mount the robot in its frame, as robot.yaml's gravity has it; no mass at the tip; turn the mount to 0 deg"
    )


def test_a_program_of_ones_own_prepares_and_confirms(folder: Path) -> None:
    path = folder / "operator.sock"
    with answering(path, {"ok": True}) as asked:
        operator(f"unix:{path}").prepare(SETUP)
    assert asked[0]["prepare"]["mount"] == "robot"  # type: ignore[index]
    path.unlink()
    with answering(path, {"ok": False}), pytest.raises(Stopped, match="does not confirm"):
        operator(f"unix:{path}").confirm("the tip is hidden")


@pytest.mark.parametrize("mode", [0o755, 0o750, 0o701, 0o770, pytest.param(0o700, marks=needs_root, id="of another user")])
def test_a_folder_that_others_may_enter_or_own_is_refused_with_what_to_do(folder: Path, mode: int) -> None:
    says = f"mode {mode:04o}.*chmod 700 {folder}"
    folder.chmod(mode)
    if mode == 0o700:
        os.chown(folder, NOBODY, NOBODY)
        says = f"belongs to user {NOBODY}"
    with answering(folder / "operator.sock", {"ok": True}) as asked:
        for ask, about in ((Program.confirm, "the tip is hidden"), (Program.prepare, SETUP)):
            raises(ProtocolError, says, ask, Program(folder / "operator.sock"), about)
        assert asked == []


@needs_root
def test_another_user_who_listens_there_is_refused(folder: Path) -> None:
    path = folder / "operator.sock"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        child = os.fork()
        if child == 0:
            os.setuid(NOBODY)
            server.listen()
            server.accept()[0].recv(1000)
            os._exit(0)
        try:
            while "Connection refused" in (said := raises(ProtocolError, None, Program(path).prepare, SETUP)):
                pass  # until the other user listens
            assert f"user {NOBODY} listens there" in said
        finally:
            os.kill(child, 9)
            os.waitpid(child, 0)


def test_nobody_there_is_told_with_what_to_do(folder: Path) -> None:
    raises(ProtocolError, "no usable answer.*operator: console", Program(folder / "operator.sock").prepare, SETUP)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("tcp://127.0.0.1:4000", "anybody on this computer could connect to it; write console, or unix:/FOLDER"),
        ("unix:operator.sock", "unix:/FOLDER"),
        ("unix:/" + "a" * 200, "shorter than 108 bytes"),
        ("", "write console"),
    ],
)
def test_a_line_that_is_open_to_everybody_is_refused_with_what_to_write(spec: str, words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        RigFile.model_validate(yaml.safe_load(f"{{name: r, robot: robot.yaml, instruments: {{}}, operator: {spec!r}}}"))


# ------------------------------------------------------------------ keys
SHORT = settings("spine_lengths=[0.0, 3 cm]", "pressures=[60 kPa, 90 kPa]", *PATIENT_SETTLE)
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


@pytest.mark.parametrize("verb", ["run", "campaign"])
def test_a_run_begins_where_nobody_can_be_asked_only_after_a_person_said_that_all_is_prepared(
    real_lab: VirtualLab, rig: Path, tmp_path: Path, cli: Cli, verb: str
) -> None:
    words: tuple[object, ...] = ("run", "bending", "--rig", rig, *SHORT, "--out", tmp_path)
    if verb == "campaign":
        file = write_campaign(tmp_path / "night.yaml", (0.0,), 1, unload=False)
        words = ("campaign", file, "--rig", rig, "--out", tmp_path / "night")
        masses = yaml.safe_load(file.read_text()) | {"stop": {"max_failed": 1}}
        file.write_text(yaml.safe_dump(masses))
        masses["protocols"][0]["conditions"] = {"tip_mass": ["53 g", "80 g"]}
        (tmp_path / "masses.yaml").write_text(yaml.safe_dump(masses))
        told = cli("campaign", tmp_path / "masses.yaml", *words[2:], "--yes", code=2).flat
        assert "masses.yaml needs hands 2 times" in told and not (tmp_path / "night").exists()
    assert "nobody can confirm that all is prepared (not a terminal)" in (told := cli(*words, code=1).flat) and "--yes" in told
    assert not real_lab.fakes.plant.regulator.any()
    assert not [*tmp_path.rglob("*.mcap"), *tmp_path.rglob("bending-*")]
    words = words if verb == "run" else ("campaign", "--resume", tmp_path / "night", "--rig", rig)
    cli(*words, "--yes", code=(0, 3))


def test_a_run_is_paused_noted_in_and_goes_on_with_every_state_there_once(
    real_lab: VirtualLab, rig: Path, tmp_path: Path, cli: Cli
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
    assert [(r.trial, r.step) for r in table_of(recording)] == [(t, s) for t in (1, 2) for s in range(1, 6)]
    # Down from the highest again: the state after the pause, at 60 kPa, was come to from 90 kPa (as far as was sampled).
    pause, after = recording.requests[1], next(s for s in recording.states if s.t > recording.requests[-1].t)
    pressure = recording.stream("/pressure")
    between = pressure["setpoint"][(pressure["t"] > pause.t) & (pressure["t"] < after.t)].max(axis=1)
    assert after.state.branch == "unload" and between.min() < 1e3 and between.max() > 75e3
    assert compare(recording).equal
    said = cli("info", file, code=SOUND).out
    assert f"note (terminal): {HOSTILE} half" in said and "pause done, asked for by terminal" in said
    assert cli("info", file, "--json", code=SOUND).json["requests"][2]["text"] == f"{HOSTILE} half"
    assert cli("runs", tmp_path, "--json").json[0]["notes"] == 1
    cli("export", "--out", tmp_path / "out", file)
    with open(tmp_path / "out" / "requests.csv", newline="") as lines:
        assert [row["text"] for row in csv.DictReader(lines)][2] == f"{HOSTILE} half"


def test_the_last_reading_of_a_state_counts_and_a_skipped_trial_is_not_done_again(
    virtual_lab: VirtualLab, tmp_path: Path, cli: Cli
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

    cli("run", "--resume", file, "--rig", rig, code=(0, 3))
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
        for piece in ("x\x1b[A\x1b", "n", "tip ", "\x1b[D", "l\x00o\x1b[31mo", "se\x15", "wet", "\r", "n", "ab\x1b", "q\nq"):
            line.take(piece)
        for piece in ("n" + "y" * (LONGEST + 100), "\r", "n", "given up", "\x1b", "pp", "r", "s", "q"):
            line.take(piece)
    notes = [text for kind, _, text, _ in run.kept if kind == "note"]
    assert notes == ["wet", "abq", "y" * LONGEST] and run.finished == 1 and run.typed[-1] is None
    asked = [("pause", "terminal"), ("go on", "terminal"), ("repeat", "terminal"), ("skip", "terminal"), ("finish", "terminal")]
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
            raises(BadRequest, None, steering.ask, kind, "page", text)
        assert run.finished == 1 and not steering.take("pause") and not steering.take("skip")
    assert [kind for kind, *_ in run.kept] == ["pause", "repeat", "finish", "go on"]
    assert run.said[-1].startswith("repeat: this was asked and not carried out")


# ------------------------------------------------------------------ lab jog
def test_lines_move_the_rig_within_its_limits_and_the_end_vents(
    virtual_lab: VirtualLab, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    plant, reached = virtual_lab.fakes.plant, list[float]()

    def watched(bench: Bench) -> str:
        reached.append(float(plant.chamber_pressure[1]))
        return readings(bench)

    monkeypatch.setattr("lab.verbs.jog.readings", watched)
    lines = ("p2 20 kPa", "p2 2 bar 5", "p2 900 kPa", "p11 1 kPa", "spine 3 cm", "valve on", "dance", "", "help", "?")
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join(lines)))
    told = cli("jog", "--rig", virtual_lab.rig, code=0).flat
    assert "set-point of chamber 9, 1, 2: 20 kPa; pressures" in told and "tip " in told
    assert max(reached) == pytest.approx(20e3, abs=1e3)
    limit = f"max_pressure of {virtual_lab.rig.with_name('robot.yaml')}"
    assert f"p2 900 kPa: must be 0 to 250 kPa, {limit}" in told and "chamber 11 is on no channel" in told
    assert "'dance': no such command; this rig takes p2 20 kPa | spine 5 cm | valve on" in told and "p2: '2 bar 5'" in told
    help_line = "| vent | help | q; numbers without a unit are in Pa or m, pressures may be in Pa, "
    assert told.count(help_line) == 5  # at the start, too
    assert "spine at 3 cm" in told and "valve on" in told
    assert float(max(plant.chamber_pressure)) < 5e3 and not plant.valve_on


def test_one_ctrl_c_ends_jogging_and_vents(virtual_lab: VirtualLab, monkeypatch: pytest.MonkeyPatch, cli: Cli) -> None:
    plant = virtual_lab.fakes.plant
    monkeypatch.setattr("sys.stdin", io.StringIO("p2 20 kPa\np2 0 kPa\np2 20 kPa\n" * 40))
    meanwhile(lambda: plant.chamber_pressure[1] > 10e3, press_ctrl_c)
    cli("jog", "--rig", virtual_lab.rig, code=0)
    assert float(max(plant.chamber_pressure)) < 5e3
