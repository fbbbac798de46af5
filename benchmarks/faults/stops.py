"""`python -m benchmarks.faults.stops`: from the decision to land until every regulator that can be reached is told to vent.

With every subset of the other instruments dead, silent, late or refusing, and with every subset of the regulators themselves
dead; landed by the guard that owns the rig, and anew by a process that finds it inflated. Prints the figures; exits 0 when all
are within the limit.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from lab.files.rig_file import load_rig
from lab.guard.instruments import ACTUATORS
from lab.guard.new_guard import make_safe_with_new_guard
from lab.rig.assembly import Rig
from lab.verbs.fakes import write_rig
from sim_fakes.rig import FakeRig
from timing import RigClock

SPEED = 20.0
OTHERS = ("arm", "spine", "valve", "gauge")
STATES = {"dead": "disconnect", "silent": "silence", "late": "delay", "refusing": "nak"}
LIMIT_MS = 250.0
INFLATED = 60e3
"""Pa."""
SEEN_WITHIN = 20.0


@dataclass(frozen=True)
class Landing:
    """One landing."""

    regulators: str
    way: str
    """"own": by the guard that owns the rig; "anew": by a process that opens every actuator."""
    state: str
    failing: tuple[str, ...]
    dead_units: str
    """Regulators that do not answer, by channel."""
    told_ms: float
    """From the decision until the last regulator that can be reached holds 0, ms of host time; nan: never."""
    ended_s: float
    """Until the landing had reported."""


class LandingBench:
    """Fakes of one rig."""

    def __init__(self, regulators: str, folder: Path) -> None:
        self.regulators = regulators
        self.fakes = FakeRig(speed=SPEED, seed=3, regulators=regulators).start()
        self.rig = folder / f"{regulators}.yaml"

    def one(self, way: str, state: str, failing: tuple[str, ...], dead_units: str = "") -> Landing:
        """One landing, from a sound rig to a sound rig."""
        write_rig(self.fakes, self.rig)
        self.rig.with_suffix(".latch").unlink(missing_ok=True)
        file = load_rig(self.rig)
        if way == "own":
            with Rig(file, despite_latch=True) as rig:
                for name in (*OTHERS, "pressure"):
                    rig.actuators.open(name)
                self._inflate()
                told, ended = self._timed(rig.make_safe, state, failing, dead_units)
                self.fakes.switch.end()
        else:
            self._inflate()
            clock = RigClock(SPEED)
            told, ended = self._timed(
                lambda: make_safe_with_new_guard(file, clock, ACTUATORS, "bench", unlock=True), state, failing, dead_units
            )
        return Landing(self.regulators, way, state, failing, dead_units, told, ended)

    def _inflate(self) -> None:
        """Set-points as an earlier program left them."""
        for unit in self._units().values():
            counts = round(INFLATED / unit.full_scale * 1023)
            unit.setpoint = INFLATED if self.regulators == "alicat" else counts  # type: ignore[attr-defined]
        time.sleep(0.1)
        assert float(self.fakes.plant.regulator.min()) > 0.9 * INFLATED

    def _units(self) -> dict[str, object]:
        if self.regulators == "alicat":
            return dict(self.fakes.lines["pressure"].device)  # type: ignore[attr-defined]
        lines = self.fakes.lines
        return {str(i): lines[f"pressure{i}"].device for i in range(1, 4)}  # type: ignore[attr-defined]

    def _timed(self, land: object, state: str, failing: tuple[str, ...], dead: str) -> tuple[float, float]:
        fakes = self.fakes
        for name in failing:
            fakes.switch.begin(name, STATES[state])
        for channel in dead:
            if self.regulators == "alicat":
                extra = fakes.lines["pressure"].faults.extra
                extra["dead"] = str(extra.get("dead", "")) + "ABC"[int(channel) - 1]
            else:
                fakes.lines[f"pressure{channel}"].faults.silent = True
                fakes.lines[f"pressure{channel}"].faults.extra["ignore"] = True
        time.sleep(0.3)  # the fault is there before it is noticed
        alive = [c - 1 for i, group in enumerate(fakes.wiring, 1) if str(i) not in dead for c in group]
        at = time.monotonic()
        landing = threading.Thread(target=land, daemon=True)  # type: ignore[arg-type]
        landing.start()
        told = float("nan")
        while np.isnan(told) and time.monotonic() - at < SEEN_WITHIN:
            if float(fakes.plant.regulator[alive].max()) == 0.0:
                told = 1e3 * (time.monotonic() - at)
            time.sleep(0.001)
        landing.join(60.0)
        ended = time.monotonic() - at
        fakes.switch.end()
        return told, ended


def plan(ways: tuple[str, ...]) -> Iterator[tuple[str, str, tuple[str, ...], str]]:
    """Way, state, failing instruments, dead regulators."""
    subsets = [s for n in range(1, 5) for s in itertools.combinations(OTHERS, n)]
    for way in ways:
        yield way, "dead", (), ""
        for state, failing in itertools.product(STATES, subsets):
            yield way, state, failing, ""
        for n in (1, 2):
            for dead in itertools.combinations("123", n):
                yield way, "dead", (), "".join(dead)
                yield way, "silent", OTHERS, "".join(dead)


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults.stops", description=__doc__)
    parser.add_argument("--way", choices=("own", "anew"), action="append")
    parser.add_argument("--regulators", choices=("alicat", "smc_itv"), action="append")
    parser.add_argument("--share", type=float, default=1.0, help="of the cells, drawn by chance (default all)")
    parser.add_argument("--report", type=Path)
    a = parser.parse_args()
    rng, trials = random.Random(0), []
    folder = Path(tempfile.mkdtemp(prefix="stops-"))
    for regulators in a.regulators or ("alicat", "smc_itv"):
        bench = LandingBench(regulators, folder)
        try:
            for way, state, failing, dead in plan(tuple(a.way or ("anew", "own"))):
                if rng.random() > a.share:
                    continue
                trial = bench.one(way, state, failing, dead)
                trials.append(trial)
                what = f"{'+'.join(failing) or 'none'} {state}{f', regulators {dead} dead' if dead else ''}"
                print(f"{regulators:8s} {way:5s} told {trial.told_ms:7.1f} ms, ended {trial.ended_s:5.1f} s  {what}", flush=True)
        finally:
            bench.fakes.stop()
    if a.report is not None:
        a.report.write_text(json.dumps([asdict(t) for t in trials]))
    return summary(trials)


def summary(trials: list[Landing]) -> int:
    """The figures of each way; 1 when a landing was later than the limit."""
    late = [t for t in trials if not t.told_ms <= LIMIT_MS]
    for regulators, way in sorted({(t.regulators, t.way) for t in trials}):
        values = np.array([t.told_ms for t in trials if (t.regulators, t.way) == (regulators, way)])
        figures = f"median {np.nanmedian(values):.0f}, p99 {np.nanpercentile(values, 99):.0f}, worst {values.max():.0f} ms"
        print(f"{regulators}, {way}: {figures} (n = {len(values)}, limit {LIMIT_MS:g} ms)")
    for t in late:
        print(f"LATE: {t}")
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main())
