"""`python -m benchmarks.faults.fuzz`: every kind of file that is read, mutated: each gives a result or one of our errors.

Anything else counts as uncaught and is printed with the seed that makes it again. Of each input the memory beyond what the
process had before is measured, and its processor time (the host may be busy with other things).
"""

from __future__ import annotations

import argparse
import contextlib
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from diagnosis.answer.result import Diagnosis
from diagnosis.errors import DiagnosisError
from lab.campaign.design import campaign_of
from lab.campaign.journal import read as read_campaign_journal
from lab.files.config import ConfigError, Source, check, parse_yaml
from lab.files.inputs import read_case
from lab.files.resume import find
from lab.files.rig_file import RigFile
from lab.files.robot_file import paper_robot
from lab.guard.latch import Latch
from model.errors import ModelError
from model.robot import Robot, load_robot
from protocols.bending import Bending
from protocols.stiffness import Stiffness
from recordings.campaign.export import export_streams
from recordings.campaign.info import info
from recordings.campaign.replay import compare, merged, replay_states, table_of
from recordings.campaign.shelf import INDEX, runs
from recordings.errors import RecordingError
from recordings.file.reader import Recording
from recordings.file.recover import recover
from recordings.file.verify import verify

from . import hostile_mcap
from .foreign_files import foreign_tables
from .text_files import (
    CAMPAIGN,
    CAMPAIGN_JOURNAL,
    DIAGNOSIS,
    JOURNAL,
    LATCH,
    PROTOCOL,
    RIG,
    TABLE,
    either,
    mutated_bytes,
    mutated_text,
)

EXPECTED = (ConfigError, RecordingError, ModelError, DiagnosisError)
RIG_EXAMPLE = Path(__file__).parent.parent.parent / "examples" / "rig" / "rig.yaml"
SLOW = 2.0
"""s of processor time that one input may take."""
MOST_MEMORY = 64.0
"""MB that one input may take beyond what the process has."""
Read = Callable[[], object]
Go = Callable[[random.Random], Read]
"""Makes one mutation; what it gives reads it."""


def small_files(folder: Path) -> dict[str, Go]:
    """Kind -> what is done with one mutation: everything that people or this software write beside recordings."""

    def yaml(text: str, model: type) -> Go:
        def read(changed: str) -> None:
            source = parse_yaml(changed, "fuzzed.yaml")
            data = source.data
            if model in (Bending, Stiffness) and isinstance(data, dict):
                data = {k: v for k, v in data.items() if k != "protocol"}
            check(Source(source.name, data, source.lines), model)

        return lambda rng: partial(read, mutated_text(text, rng))

    def file(name: str, sound: str, read: Callable[[Path], object]) -> Go:
        def go(rng: random.Random) -> Read:
            place = folder / name
            place.write_bytes(either(sound.encode(), rng))
            return partial(read, place)

        return go

    case = folder / "case"
    case.mkdir()
    (case / "robot.yaml").write_bytes(paper_robot().read_bytes())

    def table(rng: random.Random) -> Read:
        (case / "trials.csv").write_bytes(either(TABLE.encode(), rng))
        return partial(read_case, [case])

    shelf = folder / "shelf"
    shelf.mkdir()
    (shelf / "one.mcap").write_text("no recording")
    runs(shelf)
    index = (shelf / INDEX).read_bytes()

    def listed(rng: random.Random) -> Read:
        (shelf / INDEX).write_bytes(either(index, rng))
        return partial(runs, shelf)

    return {
        "rig.yaml": yaml(RIG, RigFile),
        "robot.yaml": yaml(paper_robot().read_text(), Robot),
        "robot.yaml, of the model": file("robot.yaml", paper_robot().read_text(), load_robot),
        "bending.yaml": yaml(PROTOCOL, Bending),
        "stiffness.yaml": yaml("spine_lengths: [5 cm]\nsteps: 3\n", Stiffness),
        "trials.csv": table,
        "campaign.yaml": file("campaign.yaml", CAMPAIGN, lambda p: campaign_of(p, RIG_EXAMPLE, 1)),
        "campaign.journal": file("campaign.journal", CAMPAIGN_JOURNAL, read_campaign_journal),
        "journal": file("fuzzed.journal", JOURNAL, find),
        "latch": file("rig.latch", LATCH, lambda place: Latch(place.with_suffix(".yaml")).read()),
        "diagnosis.json": file("diagnosis.json", DIAGNOSIS, lambda p: Diagnosis.from_json(p.read_text("utf-8", "replace"))),
        "index of recordings": listed,
        "tables of others": foreign_tables(folder),
    }  # fmt: skip


def recordings(folder: Path, sound: bytes) -> dict[str, Go]:
    """The same of recordings: bytes changed anywhere, and changes inside with right checksums."""
    place, out = folder / "fuzzed.mcap", folder / "out"

    def every_way(data: bytes) -> None:
        place.write_bytes(data)
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()

        def replayed(recording: Recording) -> None:
            compare(recording, replay_states(recording))

        ways: tuple[Callable[[], object], ...] = (
            lambda: info(place), lambda: verify(place), lambda: recover(place, out / "new.mcap"), lambda: read_case([place]),
            lambda: replayed(Recording.open(place, truncated=True)), lambda: table_of(Recording.open(place, truncated=True)),
            lambda: export_streams(Recording.open(place, truncated=True), out), lambda: find(place),
            lambda: merged([Recording.open(place, truncated=True)]), lambda: Recording.open(place, truncated=True).log,
        )  # fmt: skip
        for way in ways:
            with contextlib.suppress(*EXPECTED):
                way()

    return {
        "recording": lambda rng: partial(every_way, mutated_bytes(sound, rng)),
        "recording, checksums right": lambda rng: partial(every_way, hostile_mcap.mutated(sound, rng)),
    }


def sources(folder: Path, recording: Path | None) -> dict[str, Go]:
    """Every kind of file, and what is done with one mutation of it, which is written to `folder`."""
    found = small_files(folder)
    if recording is not None:
        found |= recordings(folder, recording.read_bytes())
    return found


@dataclass
class FuzzTally:
    """What came of one kind."""

    n: int = 0
    refused: int = 0
    uncaught: list[str] = field(default_factory=list)
    memory: float = 0.0
    """MB, the most."""
    seconds: float = 0.0
    """Of processor time, the most."""
    worst: dict[str, int] = field(default_factory=dict)
    """Seed of the most memory and of the most time."""


def memory_of(what: str) -> float:
    """MB of this process now (VmRSS), or at its most since `forget_peak` (VmHWM)."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{what}:"):
            return int(line.split()[1]) / 1024
    raise OSError(f"/proc/self/status tells no {what}")


def forget_peak() -> None:
    """From here on the peak counts anew."""
    Path("/proc/self/clear_refs").write_text("5")


def tried(name: str, go: Go, seed: int, tally: FuzzTally) -> None:
    """One mutation."""
    read = go(random.Random(f"{name} {seed}"))
    forget_peak()
    before, began = memory_of("VmRSS"), time.process_time()
    try:
        read()
    except EXPECTED:
        tally.refused += 1
    except Exception as e:  # noqa: BLE001 - that is what is looked for
        trace = e.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        where = "" if trace is None else f" ({Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno})"
        tally.uncaught.append(f"{name} seed {seed}: {type(e).__name__}{where}: {str(e)[:150]}")
    seconds, memory = time.process_time() - began, memory_of("VmHWM") - before
    tally.n += 1
    for what, value in (("seconds", seconds), ("memory", memory)):
        if value > getattr(tally, what):
            setattr(tally, what, value)
            tally.worst[what] = seed


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000, help="mutations of each kind")
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    parser.add_argument("--recording", type=Path, help="a sound recording to mutate as well")
    parser.add_argument("--kind", help="only kinds whose name holds this")
    a = parser.parse_args()
    tallies = {}
    print(f"{a.count} mutations of each kind, seeds from {a.seed}; bounds {MOST_MEMORY:g} MB, {SLOW:g} s\n")
    print(f"{'kind':28s} {'n':>6s} {'refused':>8s} {'uncaught':>9s} {'memory':>9s} {'time':>8s}  seeds of the worst", flush=True)
    for name, go in sources(Path(tempfile.mkdtemp(prefix="fuzz-")), a.recording).items():
        if a.kind and a.kind not in name:
            continue
        tally = tallies[name] = FuzzTally()
        tried(name, go, -1, FuzzTally())  # whatever is loaded late is no cost of an input
        for seed in range(a.seed, a.seed + a.count):
            tried(name, go, seed, tally)
        counts = f"{name:28s} {tally.n:6d} {tally.refused:8d} {len(tally.uncaught):9d}"
        print(f"{counts} {tally.memory:6.1f} MB {tally.seconds:6.2f} s  {tally.worst}")
        for line in tally.uncaught[:5]:
            print(f"    {line}")
        sys.stdout.flush()
    good = all(not t.uncaught and t.seconds <= SLOW and t.memory <= MOST_MEMORY for t in tallies.values())
    print("all within the bounds" if good else "NOT within the bounds")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
