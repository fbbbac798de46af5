"""What the tests of safety share: the fakes, their rig.yaml, and what the plant shows."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import timing
from lab.rig.assembly import Rig
from lab.verbs.fakes import PATIENT_SETTLE
from sim_fakes.rig import FakeRig


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

    def start(self, folder: Path, *settings: str) -> subprocess.Popen[str]:
        """A bending run in a process of its own, as soon as it has inflated the robot."""
        command = [sys.executable, "-m", "lab.cli", "run", "bending", "--rig", str(self.rig), "--out", str(folder)]
        command += [word for setting in (*PATIENT_SETTLE, *settings) for word in ("--set", setting)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if not until(lambda: self.highest() > 40e3 or process.poll() is not None, 120) or process.poll() is not None:
            process.kill()
            raise AssertionError(process.communicate()[0])
        return process


def inflate(rig: Rig, house: House) -> None:
    """Something to land."""
    rig.actuators.call("valve", "set", True)
    for _ in range(20):
        rig.actuators.call("pressure", "set", (60e3, 60e3, 60e3))
        timing.sleep(0.02)
    assert until(lambda: house.highest() > 40e3)


def until(condition: Callable[[], bool], within: float = 30.0) -> bool:
    """Look until the condition holds; False when it does not within `within` host seconds, far more than it takes."""
    deadline = timing.now() + within
    while not condition():
        if timing.now() > deadline:
            return False
        timing.sleep(0.005)
    return True
