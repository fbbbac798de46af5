"""`lab check`: is everything there?"""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from drivers.errors import InstrumentError
from drivers.interfaces import Identity

from .console import err, out
from .latch import Latch
from .losses import newly_lost
from .rig import Rig
from .rig_file import load_rig

STREAMED = {"force": "/force", "mocap": "/tip", "arm_state": "/arm"}
POLLED = {"pressure": "/pressure", "spine": "/spine", "valve": "/valve", "gauge": "/vacuum"}


def check(rig_path: Path, seconds: float, as_json: bool) -> int:
    """Connect to everything, count samples for `seconds` of host time, and say what is missing and what to do."""
    with Rig(load_rig(rig_path), despite_latch=True) as rig:
        outcome: dict[str, Identity | InstrumentError] = {}

        def note(name: str, result: Identity | InstrumentError) -> None:
            outcome[name] = result
            if not as_json and not isinstance(result, InstrumentError):
                out.print(f"  {name}: {result.maker} {result.model} {result.serial}".rstrip(), style="dim")

        failures = rig.open_all(note)
        before, lost_before, began = dict(rig.counts), rig.lost(), time.monotonic()
        time.sleep(max(0.0, seconds))
        span = time.monotonic() - began
        rows = [_row(rig, name, outcome[name], before, lost_before, span) for name in rig.names]
    lost = sum(r.get("lost", 0) for r in rows)
    if as_json:
        print(json.dumps({"rig": rig.file.name, "seconds": span, "instruments": rows}, indent=1))
    else:
        out.print(_table(rig.file.name, rows, span))
        for f in failures:
            err.print(f"missing: {f}")
        if locked := Latch(rig_path).read():
            err.print(f"locked: {locked}. Nothing can be run until `lab safe --clear --rig {rig_path}`")
    return 1 if failures else (3 if lost else 0)


def _row(
    rig: Rig,
    name: str,
    result: Identity | InstrumentError,
    before: dict[str, int],
    lost_before: dict[str, int],
    span: float,
) -> dict[str, Any]:
    if isinstance(result, InstrumentError):
        return {"instrument": name, "ok": False, "problem": result.message}
    row: dict[str, Any] = {"instrument": name, "ok": True, **asdict(result)}
    topic = STREAMED.get(name) or POLLED.get(name)
    if topic is not None:
        row["samples"] = rig.counts.get(topic, 0) - before.get(topic, 0)
        row["rate_hz"] = round(row["samples"] / span, 1) if span > 0 else None
    if topic in lost_before:
        row["lost"] = newly_lost(lost_before[topic], rig.lost()[topic])
    config = getattr(rig.file.instruments, "arm" if name == "arm_state" else name)
    row["limits"] = {k: v for k, v in config.model_dump(mode="json").items() if k.startswith("max_")}
    return row


def _table(title: str, rows: list[dict[str, Any]], span: float) -> Table:
    table = Table(title=f"{title}: instruments, counted over {span:.1f} s", title_justify="left")
    for column in ("instrument", "identity", "rate", "lost", "limits"):
        table.add_column(column)
    for r in rows:
        if not r["ok"]:
            table.add_row(r["instrument"], f"[red]{r['problem']}[/red]", "", "", "")
            continue
        identity = " ".join(x for x in (r["maker"], r["model"], r["serial"], r["firmware"]) if x)
        rate = f"{r['rate_hz']:g} Hz" if r.get("rate_hz") is not None else ""
        limits = ", ".join(
            f"{k.removeprefix('max_')} {v:g}" for k, v in r["limits"].items() if isinstance(v, (int, float))
        )
        table.add_row(r["instrument"], identity, rate, str(r.get("lost", "")), limits)
    return table
