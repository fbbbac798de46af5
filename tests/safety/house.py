"""What the tests of safety share: the fakes, their rig.yaml, and what the plant shows."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import timing
from lab.cli import main
from lab.driver_contract import until as until
from lab.files.rig_file import load_rig
from lab.rig.assembly import Rig
from lab.verbs.fakes import PATIENT_SETTLE
from recordings.campaign.replay import compare
from recordings.file.reader import Recording
from tests.lab.virtual_lab import VirtualLab, meanwhile, settings

during = meanwhile
BENDING = settings("spine_lengths=[0.05]", "pressures=[60 kPa, 120 kPa]")
STIFFNESS = settings("spine_lengths=[0.1]", "steps=3", "min_samples=20", "zero_samples=20")
UNUSED = {"bending": ("arm", "force"), "stiffness": ("mocap",)}
"""Instruments that only take time to open in a run of this protocol."""


@dataclass(frozen=True)
class House(VirtualLab):
    """A virtual lab that is kept safe."""

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
            data["instruments"].pop(name, None)
        self.rig.write_text(yaml.safe_dump(data))

    def change_instrument(self, name: str, **values: Any) -> None:
        """Rewrite one instrument's table in rig.yaml."""
        known = yaml.safe_load(self.rig.read_text())["instruments"][name]
        self.change(instruments={name: known | values})

    def highest(self) -> float:
        """The highest chamber pressure in truth, Pa."""
        return float(max(self.fakes.plant.chamber_pressure))

    def vented(self) -> bool:
        """Whether all chambers fall below 5 kPa and the valve drops."""
        return until(lambda: self.highest() < 5e3 and not self.fakes.plant.valve_on)

    def landed(self) -> bool:
        """Whether it is vented and then no longer locked."""
        return self.vented() and until(lambda: not self.latch.exists())

    @contextlib.contextmanager
    def opened(self, inflated: bool = False, **how: Any) -> Iterator[Rig]:
        """The rig with all its instruments open."""
        with Rig(load_rig(self.rig), **how) as rig:
            assert rig.open_all(str) == {}
            if inflated:
                inflate(rig, self)
            yield rig

    def lab(self, folder: Path, protocol: str, *words: str) -> int:
        """`lab run` in this process, with the instruments that it uses; its exit code."""
        self.change(without=UNUSED[protocol])
        return main(["run", protocol, "--rig", str(self.rig), *words, "--out", str(folder)])

    def completed(self, folder: Path, protocol: str, *words: str) -> Recording:
        """The file of a run that comes to its end, perhaps with lost samples."""
        assert self.lab(folder, protocol, *words) in (0, 3)
        return recorded(folder)

    def start(self, folder: Path, *more: str) -> subprocess.Popen[str]:
        """A bending run without arm and force in a process of its own, as soon as it has inflated the robot."""
        self.change(without=UNUSED["bending"])
        command = [sys.executable, "-m", "lab.cli", "run", "bending", "--rig", str(self.rig), "--out", str(folder)]
        command += settings(*PATIENT_SETTLE, *more)
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


def inflate(rig: Rig, house: House) -> None:
    """Something to land."""
    rig.actuators.valve.set(True)
    for _ in range(20):
        rig.actuators.pressure.set((60e3, 60e3, 60e3))
        timing.sleep(0.02)
    assert until(lambda: house.highest() > 40e3)
