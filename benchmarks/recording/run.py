"""What the lab as a whole makes of its recordings: a disk that fills up under a run, and five replays of one file."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import yaml

from lab.verbs.fakes import PATIENT_SETTLE, write_rig
from recordings.file.recover import recover
from sim_fakes.plant import Plant
from sim_fakes.rig import FakeRig

from ..figures import Figure

SPEED = 20.0
MORE = 30_000
"""Bytes by which the file may still grow once the robot is inflated."""
LIMIT = 60.0
"""Host seconds after which the measurement is given up."""
SETTINGS = ("spine_lengths=[0.05]", "pressures=[100 kPa, 200 kPa]", "rate=10 kPa/s", *PATIENT_SETTLE)


def full_disk_in_a_run(folder: Path) -> Figure:
    """From the moment the file could grow no further: regulators told to vent, all chambers vented and the valve off."""
    place = folder / "full-run"
    place.mkdir()
    with FakeRig(speed=SPEED, seed=3) as fakes:
        write_rig(fakes, place / "rig.yaml")
        _without(place / "rig.yaml", "arm", "force")
        command = [sys.executable, "-m", "lab.cli", "run", "bending", "--rig", str(place / "rig.yaml"), "--out", str(place)]
        command += [word for setting in SETTINGS for word in ("--set", setting)]
        program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        try:
            plant = fakes.plant
            _until(lambda: float(plant.chamber_pressure.max()) > 40e3)
            (file,) = place.glob("*.mcap")
            most = file.stat().st_size + MORE
            resource.prlimit(program.pid, resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
            full, inflated = _full(file, most), float(plant.chamber_pressure.max())
            _until(lambda: float(plant.regulator.max()) <= 1.0)
            told = time.monotonic() - full
            _until(lambda: _safe(plant))
            safe = time.monotonic() - full
            output, _ = program.communicate(timeout=LIMIT)
        finally:
            program.kill()
        locked = (place / "rig.latch").exists()
    result = recover(file, place / "recovered.mcap")
    said = " ".join(output.split())
    good = program.returncode == 1 and "recording stopped" in said and not locked and result.holes == 0
    return Figure(
        "disk full in a run on the virtual rig",
        "rig safe within 1 s, file recoverable, error says so",
        f"inflated to {inflated / 1e3:.0f} kPa; regulators told to vent after {told * 1e3:.0f} ms, vented and valve off after "
        f"{safe * 1e3:.0f} ms; {result.seconds_kept:.1f} s recovered, {result.holes} holes",
        good and safe < 1.0,
        {"told_s": told, "safe_s": safe, "recovered_s": result.seconds_kept, "inflated_pa": inflated},
    )


def replays(file: Path, times: int = 5) -> Figure:
    """`lab replay`, each time in a process of its own: the digest of the rows that it concludes."""
    found = []
    for _ in range(times):
        command = [sys.executable, "-m", "lab.cli", "replay", str(file), "--json"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        found.append(json.loads(done.stdout))
    digests, rows = {one["sha256"] for one in found}, found[0]["replayed"]
    return Figure(
        f"{times} replays by `lab replay`", "one sha256", f"{len(digests)} sha256 of {rows} rows: {min(digests)[:16]}..",
        len(digests) == 1 and rows > 0, {"digests": len(digests), "rows": rows},
    )  # fmt: skip


def _without(rig: Path, *names: str) -> None:
    data = yaml.safe_load(rig.read_text())
    for name in names:
        data["instruments"].pop(name)
    rig.write_text(yaml.safe_dump(data))


def _safe(plant: Plant) -> bool:
    return float(plant.chamber_pressure.max()) < 5e3 and not plant.valve_on


def _full(file: Path, most: int) -> float:
    """Host time at which the file could grow no further; it is cut back to its last whole record then."""
    seen = 0

    def grown() -> bool:
        nonlocal seen
        size = file.stat().st_size
        over = size >= most or size < seen
        seen = size
        return over

    _until(grown)
    return time.monotonic()


def _until(condition: Callable[[], bool]) -> None:
    """Look each millisecond; RuntimeError when it takes too long."""
    deadline = time.monotonic() + LIMIT
    while not condition():
        if time.monotonic() > deadline:
            raise RuntimeError("the run did not come to the point that is measured")
        time.sleep(0.001)
