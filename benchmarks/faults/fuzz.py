"""`python -m benchmarks.faults.fuzz`: mutated configuration, tables, journals, recordings: each gives a result or a clear error.

Anything else than the package's own error counts as a crash and is printed with the seed that makes it again.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from lab.config import ConfigError, Source, check, parse_yaml
from lab.example import paper_robot
from lab.inputs import read_case
from lab.resume import find
from lab.rig_file import RigFile
from model.errors import ModelError
from model.robot import Robot
from protocols.bending import Bending
from protocols.stiffness import Stiffness
from recordings.errors import RecordingError
from recordings.reader import Recording
from recordings.replay import replay_states, table_of

EXPECTED = (ConfigError, RecordingError, ModelError)
SLOW = 5.0
"""s that one input may take."""
MOST_MEMORY = 500.0
"""MB that the process may have used at its most."""
TOKENS = (
    "null", "~", "[]", "{}", "-1", "1e400", "-.inf", ".nan", "0x10", "0o7", "1_000", "true", "no", "2001-01-01", '"', "'", "|",
    ">", "&a", "*a", "<<: *a", "!!python/object/apply:os.system [id]", "!!binary aGk=", "250 kPa", "250 kpa", "kPa", "9" * 400,
    "[" * 200, "{a: " * 100, "- " * 300, "\t", "\0", "\ufeff", "\u202e", "\ud7ff", "? ", ": ", "---", "...", "%YAML 9.9",
    "../../../../etc/passwd", "/dev/zero", "\N{PILE OF POO}", "a" * 100_000,
)  # fmt: skip
RIG = """
name: virtual rig
robot: robot.yaml
clock: {speed: 20.0}
operator: unix:/run/lab/operator.sock
instruments:
  arm: {driver: ur5, host: 127.0.0.1, max_speed: 0.1, workspace_min: [-0.75, -0.75, 0.02]}
  force: {driver: ft300s, port: /dev/ttyUSB0}
  pressure: {driver: alicat, port: /dev/ttyUSB1, chambers: [[9, 1, 2], [3, 4, 5], [6, 7, 8]], max_pressure: 300 kPa}
  spine: {driver: dynamixel, port: /dev/ttyUSB2, metres_per_turn: 0.1, max_length: 35 cm}
  valve: {driver: numato, port: /dev/ttyACM0, on_close: release}
  gauge: {driver: pfeiffer, port: /dev/ttyUSB3}
  mocap:
    driver: natnet
    server: 127.0.0.1
    body: Tip
    markers: [M1, M2]
    mocap_to_base: {position: [0, 0, 1.2], quaternion: [1, 0, 0, 0]}
stand: {origin: [0.5, 0, 0.6], axis: [0, 0, 1], push: [1, 0, 0], tool_rotation: [0, 1.57, 0]}
safe: {order: [arm, pressure, spine, valve], vented_below: 5 kPa, within: 10 s, keep_vacuum: false}
limits: {max_total_pressure: 1500 kPa, max_force: 60 N}
"""
PROTOCOL = """
protocol: bending
spine_lengths: [0, 5 cm, 10 cm]
pressures: [50 kPa, 100 kPa]
chambers: [9, 1, 2]
reading: settled
rate: 25 kPa/s
settle: {band: 1.5 kPa, still: 1.5 s}
"""
TABLE = """trial,step,protocol,repeat,branch,t,spine_length,p1,p2,p3,tip_mass,roll_deg,x,y,z,qw,qx,qy,qz,sd_x
1,1,bending,1,load,3.5,0.05,0.0,0.0,0.0,0.053,0,0.001,0.0,0.39,1,0,0,0,0.0001
1,2,bending,1,load,9.25,0.05,50000.0,50000.0,50000.0,0.053,0,0.051,0.001,0.37,0.99,0,0.1,0,0.0001
"""
JOURNAL = """{"journal": 1, "campaign": "c", "protocol": "bending"}
{"recording": "gone.mcap", "first_trial": 1}
{"trial": 1, "step": 1}
{"trial": 1, "done": 5}
"""


def mutated_text(text: str, rng: random.Random) -> str:
    """One to four edits."""
    for _ in range(rng.randint(1, 4)):
        lines = text.split("\n")
        i, at = rng.randrange(len(lines)), rng.randrange(max(1, len(text)))
        match rng.randrange(8):
            case 0:
                lines.pop(i)
                text = "\n".join(lines)
            case 1:
                lines.insert(rng.randrange(len(lines)), lines[i])
                text = "\n".join(lines)
            case 2:
                text = text[:at] + rng.choice(TOKENS) + text[at:]
            case 3:
                key, colon, _ = lines[i].partition(":")
                lines[i] = f"{key}{colon} {rng.choice(TOKENS)}"
                text = "\n".join(lines)
            case 4:
                text = text[:at] + chr(rng.randrange(1, 0x2000)) + text[at + 1 :]
            case 5:
                text = text[:at]
            case 6:
                text = text[:at] + text[at + rng.randint(1, 20) :]
            case _:
                words = text.split(" ")
                a, b = rng.randrange(len(words)), rng.randrange(len(words))
                words[a], words[b] = words[b], words[a]
                text = " ".join(words)
    return text


def mutated_bytes(data: bytes, rng: random.Random) -> bytes:
    """One to six edits: flipped bits, huge lengths, holes, doubles, a cut."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(max(1, len(out)))
        match rng.randrange(6):
            case 0:
                out[at : at + 1] = bytes([out[at] ^ 1 << rng.randrange(8)]) if out else b""
            case 1:
                out[at : at + 8] = rng.choice((b"\xff" * 8, b"\xff" * 7 + b"\x7f", b"\0" * 8, b"\0\0\0\x40\0\0\0\0"))
            case 2:
                del out[at : at + rng.randint(1, 400)]
            case 3:
                out[at:at] = out[at : at + rng.randint(1, 400)]
            case 4:
                out[at:at] = rng.randbytes(rng.randint(1, 64))
            case _:
                del out[at:]
    return bytes(out)


def sources(recording: Path | None) -> list[tuple[str, Callable[[random.Random], None]]]:
    """Name and what is done with one mutation."""

    def yaml(text: str, model: type) -> Callable[[random.Random], None]:
        def go(rng: random.Random) -> None:
            source = parse_yaml(mutated_text(text, rng), "fuzzed.yaml")
            data = source.data
            if model in (Bending, Stiffness) and isinstance(data, dict):
                data = {k: v for k, v in data.items() if k != "protocol"}
            check(Source(source.name, data, source.lines), model)

        return go

    found = [
        ("rig.yaml", yaml(RIG, RigFile)), ("robot.yaml", yaml(paper_robot().read_text(), Robot)),
        ("bending.yaml", yaml(PROTOCOL, Bending)), ("stiffness.yaml", yaml("lengths: [5 cm]\nsteps: 3\n", Stiffness)),
    ]  # fmt: skip
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    (folder / "case").mkdir()
    (folder / "case" / "robot.yaml").write_bytes(paper_robot().read_bytes())

    def table(rng: random.Random) -> None:
        text = mutated_text(TABLE, rng).encode("utf-8", "surrogatepass")
        (folder / "case" / "trials.csv").write_bytes(mutated_bytes(text, rng) if rng.random() < 0.3 else text)
        read_case([folder / "case"])

    def journal(rng: random.Random) -> None:
        (folder / "fuzzed.journal").write_bytes(mutated_bytes(mutated_text(JOURNAL, rng).encode(), rng))
        find(folder / "fuzzed.journal")

    found += [("trials.csv", table), ("journal", journal)]
    if recording is not None:
        whole = recording.read_bytes()
        place = folder / "fuzzed.mcap"

        def read(rng: random.Random) -> None:
            place.write_bytes(mutated_bytes(whole, rng))
            opened = Recording.open(place, truncated=rng.random() < 0.5)
            table_of(opened)
            replay_states(opened)
            with contextlib.suppress(*EXPECTED):  # it must be finished for that, and name its robot
                read_case([place])

        found += [("recording", read)] * 2
    return found


def main() -> int:
    """See the module's text."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.faults.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--recording", type=Path, help="a sound recording to mutate as well")
    a = parser.parse_args()
    kinds, outcomes, slowest = sources(a.recording), Counter[str](), 0.0
    crashes = []
    for seed in range(a.seed, a.seed + a.count):
        name, go = kinds[seed % len(kinds)]
        began = time.monotonic()
        try:
            go(random.Random(seed))
            outcomes[f"{name}: read"] += 1
        except EXPECTED:
            outcomes[f"{name}: refused"] += 1
        except Exception as e:  # noqa: BLE001 - that is what is looked for
            outcomes[f"{name}: CRASHED"] += 1
            crashes.append(f"seed {seed} {name}: {type(e).__name__}: {str(e)[:200]}")
        slowest = max(slowest, time.monotonic() - began)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    for key, n in sorted(outcomes.items()):
        print(f"{key:24s} {n:6d}")
    print("\n".join(crashes[:20]))
    print(f"{a.count} inputs, {len(crashes)} crashes, slowest {slowest:.2f} s, most memory {memory:.0f} MB")
    return 0 if not crashes and slowest < SLOW and memory < MOST_MEMORY else 1


if __name__ == "__main__":
    sys.exit(main())
