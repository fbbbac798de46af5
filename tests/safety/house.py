"""What the tests of safety share: the fakes, their rig.yaml, and what the plant shows."""

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import timing
from lab.cli import main
from lab.files.rig_file import load_rig
from lab.rig.assembly import Rig
from lab.verbs.fakes import PATIENT_SETTLE
from recordings.campaign.replay import compare
from recordings.file.reader import Recording
from sim_fakes.rig import FakeRig

BENDING = [word for setting in ("spine_lengths=[0.05]", "pressures=[60 kPa, 120 kPa]") for word in ("--set", setting)]
STIFFNESS = [w for s in ("spine_lengths=[0.1]", "steps=3", "min_samples=20", "zero_samples=20") for w in ("--set", s)]


@dataclass(frozen=True)
class House:
    """The fakes, and the rig.yaml that reaches them."""

    fakes: FakeRig
    rig: Path

    @property
    def latch(self) -> Path:
        """The file that locks the rig."""
        return self.rig.with_suffix(".latch")

    def change(self, without: tuple[str, ...] = (), **tables: dict[str, Any]) -> None:
        """Rewrite rig.yaml: tables of it changed, instruments left out."""
        data = yaml.safe_load(self.rig.read_text())
        for name, values in tables.items():
            data[name] = {**data.get(name, {}), **values}
        for name in without:
            data["instruments"].pop(name)
        self.rig.write_text(yaml.safe_dump(data))

    def change_instrument(self, name: str, **values: Any) -> None:
        """Rewrite one instrument's table in rig.yaml."""
        data = yaml.safe_load(self.rig.read_text())
        data["instruments"][name].update(values)
        self.rig.write_text(yaml.safe_dump(data))

    def highest(self) -> float:
        """The highest chamber pressure in truth, Pa."""
        return float(max(self.fakes.plant.chamber_pressure))

    def vented(self) -> bool:
        """Whether all chambers fall below 5 kPa and the valve drops."""
        return until(lambda: self.highest() < 5e3 and not self.fakes.plant.valve_on)

    @contextlib.contextmanager
    def opened(self, **how: Any) -> Iterator[Rig]:
        """The rig with all its instruments open."""
        with Rig(load_rig(self.rig), **how) as rig:
            assert rig.open_all(lambda name, outcome: None) == []
            yield rig

    def lab(self, folder: Path, protocol: str, *words: str) -> int:
        """`lab run` in this process; its exit code."""
        return main(["run", protocol, "--rig", str(self.rig), *words, "--out", str(folder)])

    def completed(self, folder: Path, protocol: str, *words: str) -> Recording:
        """The file of a run that comes to its end, perhaps with lost samples."""
        assert self.lab(folder, protocol, *words) in (0, 3)
        return recorded(folder)

    def start(self, folder: Path, *settings: str) -> subprocess.Popen[str]:
        """A bending run in a process of its own, as soon as it has inflated the robot."""
        command = [sys.executable, "-m", "lab.cli", "run", "bending", "--rig", str(self.rig), "--out", str(folder)]
        command += [word for setting in (*PATIENT_SETTLE, *settings) for word in ("--set", setting)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if not until(lambda: self.highest() > 40e3 or process.poll() is not None, 120) or process.poll() is not None:
            process.kill()
            raise AssertionError(process.communicate()[0])
        return process


def recorded(folder: Path) -> Recording:
    """The only recording there; its replay gives the same rows."""
    (file,) = folder.glob("*.mcap")
    recording = Recording.open(file)
    assert compare(recording).equal
    return recording


def during(condition: Callable[[], bool], act: Callable[[], object]) -> threading.Thread:
    """Do something as soon as a condition of the plant holds."""

    def watch() -> None:
        if timing.wait(condition, 60.0):
            act()

    thread = timing.Thread(target=watch, daemon=True)
    thread.start()
    return thread


def inflate(rig: Rig, house: House) -> None:
    """Something to land."""
    rig.actuators.valve.set(True)
    for _ in range(20):
        rig.actuators.pressure.set((60e3, 60e3, 60e3))
        timing.sleep(0.02)
    assert until(lambda: house.highest() > 40e3)


def until(condition: Callable[[], bool], within: float = 30.0) -> bool:
    """Look until the condition holds, which may wait for the rig itself; False when it does not within `within` host seconds."""
    deadline = timing.now() + within
    while not condition():
        if timing.now() > deadline:
            return False
        timing.sleep(0.005)
    return True
