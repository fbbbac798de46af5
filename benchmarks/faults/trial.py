"""One cell: fakes here, the lab in a worker, the fault at its phase, and the plant looked at afterwards."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from lab.files.robot_file import paper_robot
from lab.verbs.fakes import PATIENT, PATIENT_SETTLE
from sim_fakes.rig import FakeRig

from .cells import CONNECT_HANG, HANG, LANDING, SPEED, TIME_OUTS, FaultCell, FaultJob, FaultResult, Verdict

ARM = {"max_age": 1.0, "watchdog_frequency": PATIENT["instruments"]["arm"]["watchdog_frequency"]}
"""Age of its state (s) and kicks of its watchdog (Hz): a fake's stream and ours are late when every processor is busy."""
LIMIT = 90.0
"""Host seconds after which a cell counts as hung and its worker is killed."""
QUICK = {
    "bending": ("spine_lengths=[0.05]", "pressures=[100 kPa, 200 kPa]", "unload=false", "zero_state=false", *PATIENT_SETTLE),
    "stiffness": ("spine_lengths=[0.1]", "steps=3", "min_samples=30", "zero_samples=20"),
}
STAYS = {"bending": ("arm", "force"), "stiffness": ("mocap",)}
"""Instruments that are left out of the rig of a protocol, which saves the time to connect them."""
TRIES = 3
"""Of a cell whose fault was never given: on a host that pauses for longer than the rig's limits allow, the rig stops before."""
SETTLED = 1.5
"""Host seconds after the end in which the plant may come to rest."""


class FaultBench:
    """Fakes of one rig and a worker; cells run one after another."""

    def __init__(self, second_rig: bool, seed: int = 1) -> None:
        self.second_rig = second_rig
        self.fakes = FakeRig(
            speed=SPEED, seed=seed, regulators="smc_itv" if second_rig else "alicat", spine="tmcl" if second_rig else "dynamixel"
        ).start()
        self.folder = Path(tempfile.mkdtemp(prefix="faults-"))
        self.rig = self.folder / "rig.yaml"
        self._log = (self.folder / "worker.log").open("wb")
        self._worker: subprocess.Popen[bytes] | None = None
        self._line: Connection | None = None

    def close(self) -> None:
        """End worker and fakes."""
        self._end_worker()
        self.fakes.stop()

    def verdict(self, cell: FaultCell) -> Verdict:
        """How a cell goes; tried again where the rig stopped, safe, before the fault was given."""
        found = self.run(cell)
        while not found.given and not found.unsafe and found.tries < TRIES:
            print(f"again: {cell.subject} {cell.fault} {cell.phase}: {found.why[:250]}", flush=True)
            found = replace(self.run(cell), tries=found.tries + 1)
        return found

    def run(self, cell: FaultCell) -> Verdict:
        """One cell, from a sound rig to a sound rig."""
        for left in ("rig.latch", "rig.guard.log"):
            (self.folder / left).unlink(missing_ok=True)
        self._write_rig(cell.protocol)
        self.fakes.troubles.clear()
        trigger = Trigger(self.fakes, cell)
        if cell.phase == "connect":
            trigger.fire()
        else:
            trigger.start()
        line = self._start_worker()
        line.send(FaultJob(str(self.rig), str(self.folder), cell.protocol, QUICK[cell.protocol]))
        result = self._await(line, trigger)
        trigger.stop()
        verdict = self._judge(cell, trigger, result)
        self.fakes.switch.end()
        if verdict.mark in "lX":
            verdict = self._unlock(cell, verdict)
        for file in self.folder.glob("*.mcap"):
            file.unlink()
        return verdict

    def _write_rig(self, protocol: str) -> None:
        file = self.fakes.rig_file(str(paper_robot()))
        for name in STAYS[protocol]:
            file["instruments"].pop(name)
        if "arm" in file["instruments"]:
            file["instruments"]["arm"] |= {"serial": "20183500000"} | ARM
        for name, seconds in TIME_OUTS.items():
            if name in file["instruments"]:
                file["instruments"][name]["timeout"] = seconds
        file["safe"] = file.get("safe", {}) | PATIENT["safe"]
        file["limits"] = {"resume_within": 2.0, "max_hidden": 1.0, "max_age": 2.0}
        self.rig.write_text(yaml.safe_dump(file))

    # -- the worker
    def _start_worker(self) -> Connection:
        if self._worker is not None and self._worker.poll() is None and self._line is not None:
            return self._line
        ours, theirs = Pipe()
        self._worker = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.faults.worker", str(theirs.fileno())],
            pass_fds=(theirs.fileno(),),
            stdin=subprocess.DEVNULL,
            stderr=self._log,
        )
        theirs.close()
        self._line = ours
        return ours

    def _end_worker(self) -> None:
        if self._line is not None:
            self._line.close()
            self._line = None
        if self._worker is not None:
            self._worker.kill()
            self._worker.wait()
            self._worker = None

    def _await(self, line: Connection, trigger: Trigger) -> FaultResult | str:
        """The worker's result, or what became of it."""
        deadline = time.monotonic() + LIMIT
        with contextlib.suppress(EOFError, OSError):
            while line.poll(max(0.0, deadline - time.monotonic())):
                said = line.recv()
                if isinstance(said, FaultResult):
                    return said
                trigger.landing()
                line.send("go")
            self._end_worker()
            return "hung"
        code = self._worker.wait(5.0) if self._worker is not None else None
        self._end_worker()
        last = (self.folder / "worker.log").read_text(errors="replace").strip().rpartition("\n")[2]
        return f"the program died with code {code}: {last}"

    def _unlock(self, cell: FaultCell, verdict: Verdict) -> Verdict:
        """A repaired rig must be unlocked by `lab safe --clear`."""
        self._write_rig(cell.protocol)
        line = self._start_worker()
        line.send(FaultJob(str(self.rig), str(self.folder)))
        result = self._await(line, Trigger(self.fakes, cell))
        if isinstance(result, FaultResult) and not result.error:
            return verdict
        self._end_worker()
        text = result if isinstance(result, str) else result.error
        return Verdict(cell, "X", f"{verdict.why} repaired, but: {text}", verdict.seconds, verdict.error)

    # -- judging
    def _judge(self, cell: FaultCell, trigger: Trigger, result: FaultResult | str) -> Verdict:
        unsafe = self._unsafe(cell)
        if isinstance(result, str):
            return Verdict(cell, "X", result, unsafe=unsafe)
        if not trigger.fired:
            return Verdict(cell, "X", f"the phase never came: {result.kind} {result.error}", unsafe=unsafe, given=False)
        seconds = max(0.0, result.ended - trigger.at)
        unconfirmed = [name for name, confirmed, _ in result.steps if not confirmed]
        bad: list[str] = []
        longest = (CONNECT_HANG if cell.phase == "connect" else HANG) * (1 + len(self.fakes.troubles))
        if seconds > longest and result.error:  # each pause that a person ended starts the time anew
            bad.append(f"took {seconds:.1f} s to end")
        if result.landed - result.ended > LANDING:
            bad.append(f"took {result.landed - result.ended:.1f} s to land")
        if result.error and not result.names and cell.instrument not in result.error:
            bad.append("the error names no instrument")
        elif result.names and result.names.removesuffix("_state") != cell.instrument:
            bad.append(f"the error names {result.names}")
        excused = {cell.instrument, "valve" if cell.instrument == "gauge" else ""}  # the gauge confirms the valve
        others = [n for n in unconfirmed if n not in excused]
        if others:
            bad.append(f"not confirmed: {', '.join(others)}")
        if unconfirmed and not result.locked and not self._confirmed_late():
            bad.append("not confirmed and not locked")
        wrong = [n for n in unsafe if n != cell.instrument or (n not in unconfirmed and cell.phase != "connect")]
        if wrong:
            bad.append(f"in truth not safe: {', '.join(wrong)}")
        mark = "X" if bad else "l" if unconfirmed or result.locked else "e" if result.error else "."
        texts = [text for name, confirmed, text in result.steps if not confirmed]
        why = "; ".join(bad + texts)
        return Verdict(cell, mark, why, seconds, f"{result.kind}: {result.error}" if result.error else "", unsafe)

    def _confirmed_late(self) -> bool:
        """Whether the guard has unlocked the rig after its report, by a confirmation that came later."""
        return " s later: " in self.rig.with_suffix(".guard.log").read_text(encoding="utf-8")

    def _unsafe(self, cell: FaultCell) -> tuple[str, ...]:
        """Actuators that are not in the safe state in truth."""
        give_up = time.monotonic() + SETTLED
        while (found := self._moving_or_loaded(cell)) and time.monotonic() < give_up:
            time.sleep(0.05)
        return found

    def _moving_or_loaded(self, cell: FaultCell) -> tuple[str, ...]:
        plant = self.fakes.plant
        with plant.lock:
            drive, pressure, valve = plant.spine_drive, float(plant.chamber_pressure.max()), plant.valve_on
        time.sleep(0.03)
        found = []
        if pressure > 5e3:
            found.append("pressure")
        if abs(plant.spine_drive - drive) > 1e-5:
            found.append("spine")
        if valve:
            found.append("valve")
        if cell.protocol == "stiffness" and self.fakes.ur is not None:
            speed = self.fakes.ur.backdoor()["tcp_speed"]
            if max(abs(v) for v in speed[:3]) > 2e-3:
                found.append("arm")
        return tuple(found)


class Trigger(threading.Thread):
    """Switches the fault on when the plant shows that its phase has come."""

    def __init__(self, fakes: FakeRig, cell: FaultCell) -> None:
        super().__init__(name="trigger", daemon=True)
        self._fakes, self._cell = fakes, cell
        self._ended = threading.Event()
        self._homed = False
        self._last: Any = None
        self.fired = False
        self.at = 0.0

    def fire(self) -> None:
        """Now."""
        if not self.fired:
            self.fired, self.at = True, time.monotonic()
            self._fakes.switch.begin(self._cell.instrument, self._cell.fault)

    def landing(self) -> None:
        """The experiment is over."""
        if self._cell.phase == "shutdown":
            self.fire()

    def run(self) -> None:
        """Look until the phase has come."""
        looks: dict[tuple[str, str], Callable[[], bool]] = {
            ("bending", "approach"): self._growing,
            ("bending", "sweep"): lambda: float(self._fakes.plant.regulator.max()) > 20e3,
            ("bending", "hold"): lambda: float(self._fakes.plant.regulator.max()) > 99e3,
            ("stiffness", "approach"): lambda: self._growing() or self._depth() > -0.075,
            ("stiffness", "sweep"): lambda: self._force() > 0.25,
            ("stiffness", "hold"): self._pressing,
        }
        look = looks.get((self._cell.protocol, self._cell.phase))
        while look is not None and not self._ended.is_set():
            if look():
                self.fire()
                return
            time.sleep(0.002)

    def stop(self) -> None:
        """No longer."""
        self._ended.set()

    def _growing(self) -> bool:
        drive = self._fakes.plant.spine_drive
        self._homed = self._homed or drive < 0.002
        return self._cell.protocol == "bending" and self._homed and drive > 0.01

    def _depth(self) -> float:
        """Probe in the push direction from the specimen's axis, m; only once the spine stands."""
        plant = self._fakes.plant
        if not (self._homed and plant.valve_on):
            return -1.0
        stand = np.array(self._fakes.truth.stand)
        return float((stand[:3, :3].T @ (plant.probe_position - stand[:3, 3]))[0])

    def _force(self) -> float:
        return float(np.linalg.norm(self._fakes.plant.probe_force))

    def _pressing(self) -> bool:
        here = self._fakes.plant.probe_position.copy()
        last, self._last = self._last, here
        time.sleep(0.03)
        return self._force() > 1.0 and last is not None and bool(np.abs(here - last).max() < 1e-6)
