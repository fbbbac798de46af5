"""`python -m benchmarks.faults.night`: a night's campaign in which instruments fail and the program is killed.

Is any state lost, or there twice? The program is killed and instruments fail at drawn moments; what a person does in the morning
(look, `lab safe --clear`, go on) is done at once. At the end the table that a diagnosis reads out of the folder is held against
the planned one. Prints the figures; exits 0 when every planned state is there exactly once, and none else.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml

from lab.campaign.design import campaign_of, planned_table
from lab.files.inputs import read_case
from lab.verbs.fakes import PATIENT, PATIENT_SETTLE, write_rig
from recordings.campaign.replay import compare
from recordings.file.reader import Recording
from sim_fakes.rig import FakeRig

SPEED = 20.0
KILL = "kill"
FAULTS = (
    "pressure silence", "pressure garbage", "pressure disconnect", "spine bad_crc", "spine silence", "valve silence",
    "gauge silence", "gauge garbage", "mocap silence", "mocap stuck", "mocap disconnect",
)  # fmt: skip
MOST_SESSIONS = 60
SAFE_WITHIN = 120.0
"""Host seconds after which a rig that cannot be made safe counts as broken."""
SAME_PRESSURE, SAME_LENGTH = 10e3, 2e-3
"""Pa and m by which a state may differ from the planned one."""


@dataclass(frozen=True)
class Trouble:
    """Something that happens once a run has this many states on the disk: `kill`, or an instrument and its fault."""

    run: int
    """0: the warm-up."""
    states: int
    what: str
    delay: float = 0.0
    """Host seconds after that."""


@dataclass(frozen=True)
class NightReport:
    """What became of a night."""

    runs: int
    planned: int
    """States."""
    found: int
    missing: int
    """Planned states that are not in the table."""
    beyond: int
    """States of the table that were not planned, or stand there twice."""
    differing: int
    """Rows that replay gives otherwise."""
    kills: int
    faults: int
    sessions: int
    """Processes that the campaign took."""
    failures: int
    """Runs that an instrument ended."""
    recordings: int
    torn: int
    seconds: float

    @property
    def sound(self) -> bool:
        """Every planned state is there once, none else, and each follows from its recording."""
        return not (self.missing or self.beyond or self.differing)


class Night:
    """One campaign on running fakes, with its troubles."""

    def __init__(self, fakes: FakeRig, rig: Path, file: Path, folder: Path, troubles: Sequence[Trouble]) -> None:
        self.fakes, self.rig, self.file, self.folder = fakes, rig, file, folder
        self._left = list(troubles)
        self._due: dict[Trouble, float] = {}
        self._fault_since = 0
        """Lines of the journal when a fault was switched on; 0: none is."""
        self.kills = self.faults = self.sessions = 0

    def go(self) -> NightReport:
        """From the first session to the last."""
        began = time.monotonic()
        self.fakes.on_confirm = lambda trouble: self._mend()
        command = ["campaign", str(self.file), "--out", str(self.folder)]
        while self._session([*command, "--rig", str(self.rig)]) not in (0, 3):
            assert self.sessions < MOST_SESSIONS, f"not done after {self.sessions} sessions"
            self._morning()
            begun = (self.folder / "campaign.journal").exists()
            command = ["campaign", "--resume", str(self.folder)] if begun else command
        self.fakes.on_confirm = None
        self._mend()
        return self._report(time.monotonic() - began)

    def _session(self, words: list[str]) -> int:
        self.sessions += 1
        log = (self.folder.parent / "night.log").open("a")
        with (
            log,
            subprocess.Popen(
                [sys.executable, "-m", "lab.cli", *words], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            ) as program,
        ):
            while program.poll() is None:
                self._look(program)
                time.sleep(0.005)
        return program.returncode

    def _look(self, program: subprocess.Popen[bytes]) -> None:
        """Begin what is due, end what has been seen."""
        lines = self._journal()
        if self._fault_since and sum('"outcome"' in line for line in lines) >= self._fault_since:
            self._mend()
        now = time.monotonic()
        for trouble in self._left:
            if trouble not in self._due and self._has_come(trouble, lines):
                self._due[trouble] = now + trouble.delay
        for trouble, at in list(self._due.items()):
            if at > now:
                continue
            self._left.remove(trouble)
            del self._due[trouble]
            if trouble.what == KILL:
                self.kills += 1
                os.kill(program.pid, signal.SIGKILL)
                program.wait()
                return
            self.faults += 1
            self._fault_since = 1 + sum('"outcome"' in line for line in lines)
            instrument, _, fault = trouble.what.partition(" ")
            self.fakes.switch.begin(instrument, fault)

    def _journal(self) -> list[str]:
        place = self.folder / "campaign.journal"
        return place.read_text().splitlines() if place.exists() else []

    def _has_come(self, trouble: Trouble, lines: Sequence[str]) -> bool:
        begun = f'"run": {trouble.run}, "begun"' if trouble.run else '"warm_up": 1, "begun"'
        if not any(begun in line for line in lines):
            return False
        journals = self.folder.glob(f"{trouble.run:04d}-*/*.journal")
        return sum(journal.read_text().count('"step"') for journal in journals) >= trouble.states

    def _mend(self) -> None:
        self._fault_since = 0
        self.fakes.switch.end()

    def _morning(self) -> None:
        """What a person does who finds a campaign that has ended before its time."""
        self._mend()
        give_up = time.monotonic() + SAFE_WITHIN
        clear = [sys.executable, "-m", "lab.cli", "safe", "--clear", "--rig", str(self.rig)]
        while (done := subprocess.run(clear, capture_output=True, text=True)).returncode != 0:
            assert time.monotonic() < give_up, done.stdout + done.stderr
            time.sleep(0.5)

    def _report(self, seconds: float) -> NightReport:
        files = sorted(self.folder.glob("*/*.mcap"))
        campaign = campaign_of(self.folder / "campaign.yaml", self.rig, 0)
        planned = planned_table(campaign)
        table = read_case(files).table
        wanted = [_state(planned, i) for i in range(len(planned["trial"]))]
        had = [_state({name: table[name] for name in planned}, i) for i in range(len(table))]
        missing = [state for state in wanted if not any(_same(state, other) for other in had)]
        beyond = [s for k, s in enumerate(had) if any(s[:2] == o[:2] for o in had[:k]) or not any(_same(w, s) for w in wanted)]
        again = [compare(Recording.open(file)) for file in files]
        outcomes = [json.loads(line) for line in self._journal() if '"outcome"' in line]
        return NightReport(
            runs=len(campaign.runs), planned=len(wanted), found=len(had), missing=len(missing), beyond=len(beyond),
            differing=sum(len(c.differences) for c in again), kills=self.kills, faults=self.faults, sessions=self.sessions,
            failures=sum(line["outcome"] == "failed" for line in outcomes), recordings=len(files),
            torn=len(list(self.folder.glob("*/*.torn"))), seconds=seconds,
        )  # fmt: skip


State = tuple[int, int, str, float, tuple[float, ...]]


def _state(columns: dict[str, np.ndarray], i: int) -> State:
    """Trial, step, branch, spine length (m) and pressures (Pa) of a row."""
    pressures = tuple(float(columns[name][i]) for name in columns if name[0] == "p" and name[1:].isdigit())
    return (
        int(columns["trial"][i]),
        int(columns["step"][i]),
        str(columns["branch"][i]),
        float(columns["spine_length"][i]),
        pressures,
    )


def _same(planned: State, found: State) -> bool:
    """Whether a row is the state that was planned."""
    near = all(abs(a - b) <= SAME_PRESSURE for a, b in zip(planned[4], found[4], strict=True))
    return planned[:3] == found[:3] and abs(planned[3] - found[3]) <= SAME_LENGTH and near


def write_campaign(path: Path, lengths: Sequence[float], blocks: int, unload: bool = True) -> Path:
    """A campaign of quick bending runs, one for each spine length (m) in each block."""
    settle: dict[str, str] = dict(s.removeprefix("settle.").split("=") for s in PATIENT_SETTLE)  # type: ignore[misc]
    file = {
        "campaign": "night", "seed": 5, "blocks": blocks, "warm_up": {"cycles": 1}, "stop": {"max_failed": 4},
        "protocols": [
            {
                "protocol": "bending",
                "parameters": {"pressures": ["60 kPa", "120 kPa"], "unload": unload, "settle": settle},
                "conditions": {"spine_lengths": list(lengths)},
            }
        ],
    }  # fmt: skip
    path.write_text(yaml.safe_dump(file))
    return path


def drawn(runs: int, states: int, kills: int, faults: int, rng: random.Random) -> list[Trouble]:
    """Troubles at drawn moments of drawn runs."""
    whats = [KILL] * kills + [rng.choice(FAULTS) for _ in range(faults)]
    return [
        Trouble(run := rng.randint(0, runs), rng.randint(0, states - 1) if run else 0, what, rng.uniform(0.0, 0.5))
        for what in whats
    ]


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults.night", description=__doc__)
    parser.add_argument("--kills", type=int, default=6)
    parser.add_argument("--faults", type=int, default=8)
    parser.add_argument("--blocks", type=int, default=5, help="of four runs each")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--report", type=Path)
    a = parser.parse_args()
    place = Path(tempfile.mkdtemp(prefix="night-"))
    troubles = drawn(4 * a.blocks, 5, a.kills, a.faults, random.Random(a.seed))
    for trouble in sorted(troubles, key=lambda t: (t.run, t.states)):
        print(f"run {trouble.run:2d}, after {trouble.states} states: {trouble.what}", flush=True)
    with FakeRig(speed=SPEED, seed=a.seed) as fakes:
        write_rig(fakes, place / "rig.yaml", PATIENT)
        file = write_campaign(place / "night.yaml", (0.0, 0.03, 0.06, 0.09), a.blocks)
        report = Night(fakes, place / "rig.yaml", file, place / "night", troubles).go()
    for name, value in asdict(report).items():
        print(f"{name}: {value:.0f}" if isinstance(value, float) else f"{name}: {value}")
    print(f"{'nothing lost, nothing doubled' if report.sound else 'NOT SOUND'}; {place}")
    if a.report is not None:
        a.report.write_text(json.dumps(asdict(report), indent=1))
    return 0 if report.sound else 1


if __name__ == "__main__":
    sys.exit(main())
