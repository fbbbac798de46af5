"""A whole rig of fakes for tests of the command."""

import os
import shlex
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import timing
from lab.cli import main
from sim_fakes.rig import FakeRig


@dataclass(frozen=True)
class VirtualLab:
    """The fakes, and the rig.yaml that reaches them."""

    fakes: FakeRig
    rig: Path


def lab(*arguments: object) -> int:
    """The command, in this process; its exit code."""
    return main([str(a) for a in arguments])


def settings(*values: str) -> list[str]:
    """`--set` for each."""
    return [word for value in values for word in ("--set", value)]


def recorded(folder: Path) -> Path:
    """The only recording in a folder."""
    (file,) = folder.glob("*.mcap")
    return file


def go_on(output: str) -> list[str]:
    """The words of the line with which a command says how to go on."""
    (told,) = [line for line in output.splitlines() if line.startswith("go on with: ")]
    return shlex.split(told.removeprefix("go on with: "))


def meanwhile(condition: Callable[[], object], *acts: Callable[[], object], within: float = 120.0) -> threading.Thread:
    """Do something to a command of this process as soon as a condition holds, host seconds."""

    def watch() -> None:
        if timing.wait(lambda: bool(condition()), within):
            for act in acts:
                act()
                timing.sleep(0.3)

    thread = timing.Thread(target=watch, name="meanwhile", daemon=True)
    thread.start()
    return thread


def journal_says(text: str, folder: Path) -> bool:
    """Whether the journal of a run in this folder holds this text."""
    return any(text in path.read_text() for path in folder.glob("*.journal"))


def press_ctrl_c() -> None:
    """As a person at the terminal of this process."""
    os.kill(os.getpid(), signal.SIGINT)
