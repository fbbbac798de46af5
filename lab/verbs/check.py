"""`lab check`: is everything there? With `--move`: does it do what it is told?"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

import timing
from drivers.errors import InstrumentError
from drivers.interfaces import Identity
from model.robot import Robot
from protocols.bench import Setup
from protocols.errors import ProtocolError, Stopped
from recordings.states.demands import too_far

from ..console import Screen, err, out, questions, styled, warn
from ..files.checked import Moved, adapters_now, keep, place
from ..files.config import ConfigError, unit_of
from ..files.rig_file import RigFile, load_rig, table_of
from ..files.units import shown
from ..guard.latch import Latch
from ..options import JSON, Result, Verb, option, rig
from ..rig.assembly import Rig, newly_lost
from ..rig.interrupts import Interrupts
from ..rig.limits import bodies

LOOK = 0.05
"""Host seconds between two looks at what has come."""


def check(rig_path: Path, seconds: float, move: bool = False, yes: bool = False) -> Result:
    """Connect to everything, count samples for `seconds` of host time, and say what is missing and what to do.

    With `move` try each actuator by a little; a person is asked once unless `yes`.
    """
    file = load_rig(rig_path)
    robot = _may_move(file, yes) if move else None
    if move:
        place(rig_path).unlink(missing_ok=True)  # this check takes its place, whatever it finds, also other adapters
    moved: list[Moved] = []
    with Rig(file, despite_latch=not move) as rig:
        outcome: dict[str, Identity | InstrumentError] = {}

        def note(name: str, result: Identity | InstrumentError) -> None:
            outcome[name] = result
            if not isinstance(result, InstrumentError):
                out.print(f"  {name}: {result.maker} {result.model} {result.serial}".rstrip(), style="dim")

        failures = rig.open_all(note)
        before, lost_before = dict(rig.counts), rig.lost()
        span = _listen(rig, before, seconds)
        rows = [_row(rig, name, outcome[name], before, lost_before, span) for name in rig.names]
        rig.notices += _misplaced(rig)
        if robot is not None and all(r["ok"] for r in rows):
            moved = _moved(rig, robot)
            keep(rig_path, file, moved, adapters_now(file, rig.identities))
    lost = sum(r.get("lost", 0) for r in rows)
    warn(rig.notices)

    def show() -> None:
        out.print(_table(rig.file.name, rows, span))
        for f in failures:
            err.print(f"missing: {f}")
        for r in (r for r in rows if not r["ok"] and "samples" in r):
            err.print(f"silent: {r['instrument']}: {r['problem']}")
        if locked := Latch(rig_path).read():
            err.print(f"locked: {locked}. Nothing can be run until `lab safe --clear --rig {rig_path}`")

    data = {"rig": rig.file.name, "seconds": span, "instruments": rows, "warnings": rig.notices}
    failed = not all(r["ok"] for r in rows) or not all(m.ok for m in moved)
    data |= {"moved": [asdict(m) for m in moved]} if move else {}
    return Result(data, show, 1 if failed else (3 if lost else 0))


def _may_move(file: RigFile, yes: bool) -> Robot:
    """The robot that may be moved; raises ConfigError, or Stopped when the person says no."""
    from ..rig.moves import STEP  # with the rod model, which no other check waits for; here, before the rig is opened

    robot = file.body
    if file.instruments.pressure is not None and robot.max_pressure is None:
        raise ConfigError(f"{file.robot}: max_pressure: is missing; write the highest pressure that its chambers may hold")
    if yes:
        return robot
    if not sys.stdin.isatty():
        raise ConfigError(
            "--move: cannot ask for confirmation (not a terminal); add --yes when nobody is within reach of the rig"
        )
    questions().print(
        f"This inflates each channel to {STEP / 1e3:g} kPa, homes the spine and moves it by 1 cm, opens the valve and moves the "
        f"arm by 5 mm. The robot must hang free with {robot.tip_mass * 1e3:g} g at its tip, with nobody within reach."
    )
    if input("Type yes to continue: ").strip().lower() not in ("y", "yes"):
        raise Stopped("not confirmed; nothing moved")
    return robot


def _moved(rig: Rig, robot: Robot) -> list[Moved]:
    """Try what the rig has, land it, and tell each outcome; the landing is the last of them."""
    from ..rig.moves import moves

    seen: list[Moved] = []
    screen = Screen("check", rig.clock.speed)

    def tell(result: Moved) -> None:
        seen.append(result)
        out.print(f"  {result.what}: {'ok' if result.ok else 'FAILED'}: {result.text}")

    with tempfile.TemporaryDirectory() as folder, Interrupts(screen.say, rig.actuators.pulse) as interrupts:
        recorder = rig.recorder(Path(folder) / "moves.mcap")
        rig.stop_now = lambda: interrupts.now
        bench = rig.bench(recorder, screen, interrupts.stopping, list(rig.identities))
        rig.record_to(recorder)
        try:
            if rig.file.operator != "console":  # a person at the console has just been asked
                bench.operator.prepare(Setup("robot", robot.tip_mass, 0.0, 80e3))  # Pa below ambient
            for result in moves(bench, rig.file, robot):
                tell(result)
        except (ProtocolError, KeyboardInterrupt) as e:
            tell(Moved("check", False, str(e) or "stopped immediately by the operator"))
        finally:
            report = rig.make_safe()
            rig.record_to(None)
            recorder.close("completed", "")
    tell(Moved("safe state", report.confirmed, str(report)))
    return seen


def _misplaced(rig: Rig) -> list[str]:
    """What speaks against the places of tip and markers as the cameras report them."""
    try:
        seen = rig.streams["mocap"].latest() if "mocap" in rig.identities else None
    except InstrumentError:  # a body that is not tracked: reported when it is needed
        seen = None
    if seen is None:
        return []
    said = too_far(np.array([[seen.position, *seen.markers]]), bodies(rig.file, rig.file.body))
    return [f"mocap: {said}; check mocap_to_base, the names of the bodies, and length and markers of robot.yaml"] if said else []


def _listen(rig: Rig, before: dict[str, int], seconds: float) -> float:
    """Let samples come for `seconds` of host time, and until each instrument has brought one; return how long that took."""
    began = timing.now()
    timing.sleep(max(0.0, seconds))
    awaited = [topic for name in rig.identities if (topic := rig.topic(name))]
    while (span := timing.now() - began) < rig.file.limits.max_age:
        if all(rig.counts.get(topic, 0) > before.get(topic, 0) for topic in awaited):
            break
        timing.sleep(LOOK)
    return span


def _row(
    rig: Rig, name: str, result: Identity | InstrumentError, before: dict[str, int], lost_before: dict[str, int], span: float
) -> dict[str, Any]:
    if isinstance(result, InstrumentError):
        return {"instrument": name, "ok": False, "problem": result.message}
    row: dict[str, Any] = {"instrument": name, "ok": True, **asdict(result)}
    topic = rig.topic(name)
    if topic:
        row["samples"] = rig.counts.get(topic, 0) - before.get(topic, 0)
        row["rate_hz"] = round(row["samples"] / span, 1) if span > 0 else None
    if topic in lost_before:
        row["lost"] = newly_lost(lost_before[topic], rig.lost()[topic])
        if row["samples"] == 0:
            row |= {
                "ok": False,
                "problem": f"opened, and no sample in {span:.1f} s; " + timing.busy_or("check its cable, and that it sends"),
            }
    config = table_of(rig.file.instruments, name)
    row["limits"] = {k: v for k, v in config.model_dump(mode="json").items() if k.startswith("max_")}
    row["units"] = {k: unit_of(type(config).model_fields[k]) or "" for k in row["limits"]}
    return row


def _table(title: str, rows: list[dict[str, Any]], span: float) -> Table:
    heading = f"{title}: instruments, counted over {span:.1f} s"
    table = Table("instrument", "identity", "rate", "lost", "limits", title=heading, title_justify="left")
    for r in rows:
        if not r["ok"]:
            table.add_row(r["instrument"], styled("missing" if "samples" not in r else "silent", "red"), "", "", "")
            continue
        identity = " ".join(x for x in (r["maker"], r["model"], r["serial"], r["firmware"]) if x)
        rate = f"{r['rate_hz']:g} Hz" if r.get("rate_hz") is not None else ""
        limits = ", ".join(
            f"{k.removeprefix('max_')} {shown(v, r['units'][k])}" for k, v in r["limits"].items() if isinstance(v, (int, float))
        )
        table.add_row(r["instrument"], identity, rate, str(r.get("lost", "")), limits)
    return table


VERBS = (
    Verb(
        "check",
        lambda a: check(a.rig, a.seconds, a.move, a.yes),
        options=(
            JSON,
            rig(),
            option("--move", action="store_true", help="move each actuator a little and compare with rig.yaml"),
            option("--yes", action="store_true", help="with --move: do not ask for confirmation; nobody is within reach"),
            option("--seconds", type=float, default=2.0, help="host seconds over which rates and losses are counted"),
        ),
        examples=("lab check --rig rig/rig.yaml", "lab check --rig rig/rig.yaml --move"),
        page="docs/tutorials/your-rig.md",
    ),
)
