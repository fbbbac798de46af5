"""Where the blocks of a page are run: a folder with the examples and a rig of fakes, and a shell that knows `lab`."""

import argparse
import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from lab.cli import main, parser
from lab.verbs.fakes import PATIENT, PATIENT_SETTLE, merged
from tests.docs.blocks import ROOT, Block

START = 180.0
"""Host seconds that fakes have for their start on a busy computer."""
SHORT = ("spine_lengths=[0, 10 cm]", "pressures=[100 kPa, 200 kPa]", "repeats=1")
BUSY = ("settle.min_samples=3", *PATIENT_SETTLE)
"""On a busy computer samples of fakes at twenty times real speed are few and late."""
CONNECTS = re.compile(r"lab (?:check|run|safe) .*?--rig (\w+)/rig\.yaml")
SHELL = re.compile(r"[|;&<>`]|\$\(")
"""What a line of nothing but words does not have."""


@dataclass
class Rigs:
    """Fakes that `lab fakes` lines of the pages have started, by their folder; asleep while nobody needs them."""

    root: Path
    commands: dict[str, list[str]] = field(default_factory=dict)
    running: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    def start(self, words: Sequence[str]) -> Path:
        """Start them as a page says, unless they were started before; returns the folder of their rig.yaml."""
        a = parser().parse_args(words)
        folder = self.root / a.rig.parent.name
        if folder.name not in self.commands:
            options = [w for w in words[1:] if w not in ("--rig", str(a.rig))]
            command = [sys.executable, "-m", "lab.cli", "fakes", *options, "--rig", str(folder / a.rig.name)]
            self.commands[folder.name] = command
            self.wake(folder.name)
        return folder

    def wake(self, name: str) -> None:
        """Have them run."""
        if name in self.commands and name not in self.running:
            rig = Path(self.commands[name][-1])
            rig.unlink(missing_ok=True)
            self.running[name] = subprocess.Popen(self.commands[name], stdout=subprocess.DEVNULL)
            patient(rig)

    def sleep(self) -> None:
        """End them all; their rig.yaml stays."""
        for process in self.running.values():
            process.send_signal(signal.SIGINT)
            process.wait(60)
        self.running.clear()


def needs(text: str) -> str:
    """The folder of the rig that a line of a shell connects to; empty when it connects to none."""
    found = CONNECTS.search(text)
    return found[1] if found else ""


def patient(rig: Path) -> None:
    """Wait for a rig.yaml, and have the rig wait longer for fakes on a busy computer."""
    until = time.monotonic() + START
    while not (rig.exists() and rig.read_text().endswith("\n")):
        assert time.monotonic() < until, f"no {rig} after {START:g} s"
        time.sleep(0.1)
    data = yaml.safe_load(rig.read_text())
    changes = {**PATIENT, "instruments": {k: v for k, v in PATIENT["instruments"].items() if k in data["instruments"]}}
    rig.write_text(yaml.safe_dump(merged(data, changes), sort_keys=False))


class Workplace:
    """One page's folder."""

    def __init__(self, folder: Path, rigs: Rigs) -> None:
        self.folder, self.rigs = folder, rigs
        self.names: dict[str, Any] = {"__name__": "page"}
        folder.mkdir()
        (folder / "examples").symlink_to(ROOT / "examples")

    def do(self, block: Block) -> None:
        """Run a block, or write the file that it is; raises what goes wrong."""
        if block.file:
            path = self.folder / block.file
            path.parent.mkdir(exist_ok=True)
            path.write_text(block.text)
            if path.suffix == ".py":
                exec(compile("\n" * block.line + block.text, str(block.page), "exec"), {"__name__": path.stem})  # noqa: S102
        elif block.kind == "python":
            exec(compile("\n" * block.line + block.text, str(block.page), "exec"), self.names)  # noqa: S102
        elif block.kind == "bash":
            for line in block.text.replace("\\\n", " ").splitlines():
                self.line(line.strip())

    def line(self, line: str) -> None:
        """One line of a shell; `lab` in this process, since starting it anew takes seconds."""
        if not line or line.startswith("#"):
            return
        command, arrow, target = line.partition(" > ")
        words = shlex.split(command, comments=True)
        if words[0] != "lab" or SHELL.search(command.partition(" #")[0]):
            path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
            subprocess.run(["bash", "-euc", line], cwd=self.folder, check=True, env={**os.environ, "PATH": path})
        elif words[1] == "fakes":
            self.link(self.rigs.start(words[1:]))
        else:
            self.rigs.wake(needs(command))
            with contextlib.ExitStack() as stack:
                if arrow:
                    file = stack.enter_context((self.folder / target.strip()).open("w"))
                    stack.enter_context(contextlib.redirect_stdout(file))
                code = lab(self.expanded(command)[1:])
            assert code in (0, 3), f"{line}: exit code {code}"

    def link(self, rig: Path) -> None:
        place = self.folder / rig.name
        if not place.exists():
            place.symlink_to(rig)

    def expanded(self, command: str) -> list[str]:
        """The words of a command as the shell gives them, patterns replaced by files."""
        said = subprocess.run(
            ["bash", "-c", f"printf '%s\\0' {command}"], cwd=self.folder, capture_output=True, text=True, check=True
        )
        return said.stdout.split("\0")[:-1]


def _named(protocol: str | None) -> str | None:
    """The protocol that a word of the command names, be it by a protocol file."""
    if protocol is not None and protocol.endswith(".yaml"):
        return str(yaml.safe_load(Path(protocol).read_text())["protocol"])
    return protocol


def lab(words: Sequence[str]) -> int:
    """The command; a sweep on fakes is shortened, and patient."""
    try:
        given: argparse.Namespace = parser().parse_args(list(words))
        if given.verb == "run" and _named(given.protocol) == "bending":
            short = SHORT if given.protocol == "bending" else ()  # a proposal is as short as what it follows
            words = [*words, *(w for setting in (*short, *BUSY) for w in ("--set", setting))]
        return main(words)
    except SystemExit as end:  # --version
        return int(end.code or 0)
