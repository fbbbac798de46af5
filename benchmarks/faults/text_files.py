"""A sound file of each kind that is text, and how such files are changed."""

from __future__ import annotations

import random

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
CAMPAIGN = """campaign: a
blocks: 2
seed: 3
protocols:
  - protocol: bending
    parameters: {pressures: [60 kPa, 120 kPa]}
    conditions:
      spine_lengths: [0, 5 cm]
      tip_mass: [53 g, 80 g]
  - protocol: stiffness
warm_up: {cycles: 2, again_after: 30 min}
stop: {max_duration: 10 h, max_failed: 3, max_scatter: 5 mm}
labels: {specimen: S7}
"""
CAMPAIGN_JOURNAL = """{"campaign_journal": 1, "campaign": "c", "design": "d", "labels": {"specimen": "S7"}}
{"warm_up": 1, "begun": 1795449500.0}
{"run": 1, "begun": 1795449600.0}
{"run": 1, "outcome": "completed", "seconds": 212.4, "rows": 11, "lost": 0, "inflated": true, "at": 1795449812.4}
"""
LATCH = '{"since": "2025-03-01 12:00:00", "why": "the arm does not answer", "pid": 4711}'
DIAGNOSIS = """{"schema": "diagnosis/1", "statement": "x",
 "data": {"rows": 9, "trials": 3, "channels": ["x"], "noise_mm": 0.1, "noise_from": "repeats"},
 "locate": {"gap_rmse_mm": 1.0, "noise_floor_mm": 0.1, "significant": true, "by": {"axis": [{"value": "x", "rmse_mm": 1,
  "bias_mm": 0, "n": 9, "low95_mm": 0, "high95_mm": 2, "significant": true}]}, "stage": {"load": 1.0},
  "of": "tip"},
 "attribute": {"verdict": "effect", "effects": ["gravity_tilt"], "probability": 0.9, "credible_set": [["gravity_tilt"]],
  "ranking": [{"effects": ["gravity_tilt"], "probability": 0.9, "log_evidence": 1.0, "heldout_rmse_mm": null,
  "parameters": {"angle": {"value": 0.02, "sd": 0.001, "unit": "rad"}}}], "cannot_tell_apart": []},
 "shrink": {"how": "x", "before_mm": 1, "after_mm": 0.1, "floor_mm": 0.1, "share_closed": 1.0, "ci95": [0.9, 1.0],
  "by_spine_length": [{"value": 0.1, "before_mm": 1, "after_mm": 0.1, "n": 9}]},
 "next_experiment": [{"id": "roll", "do": "roll it", "separates": [], "expected_bits": 0.1, "cost_min": 5, "protocol": {}}],
 "concerns": [], "detail": {}}"""


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


def either(data: bytes, rng: random.Random) -> bytes:
    """Text mutated as text, as bytes, or as both."""
    if rng.random() < 0.7:
        data = mutated_text(data.decode(), rng).encode("utf-8", "surrogatepass")
    return mutated_bytes(data, rng) if rng.random() < 0.4 else data
