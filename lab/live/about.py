"""What a recording says of itself before its first sample: which protocol, which robot, which limits, which plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from model.robot import Robot
from recordings.campaign.labels import MOST, RECORD
from recordings.file.contents import Contents
from recordings.json_text import read_json

from ..files.config import ConfigError, check, parse_yaml
from ..files.rig_file import RigFile
from ..plain import plain
from ..rig.limits import within_robot

PLAN = "plan.json"
"""The attachment that holds the steps of the plan."""
LONGEST = 300
"""Characters of a name that are shown."""


@dataclass(frozen=True)
class About:
    """Of one recording; what it does not tell is None or empty. SI units."""

    file: str
    protocol: str = ""
    rig: str = ""
    robot: str = ""
    labels: tuple[str, ...] = ()
    """What the person said of it: name and text."""
    speed: float = 1.0
    """Of the rig's clock: rig seconds in a second."""
    start_wall_ns: int = 0
    length: float | None = None
    """Of the robot, m."""
    channels: tuple[tuple[int, ...], ...] = ()
    """Chambers on each channel of the regulators, counted from 1."""
    limits: Mapping[str, float] = field(default_factory=dict)
    steps: tuple[tuple[str, float], ...] = ()
    """Of the plan: what is done, s."""
    missing: tuple[str, ...] = ()
    """Why something is not told."""

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "file": shown(self.file), "protocol": shown(self.protocol), "rig": shown(self.rig), "robot": shown(self.robot),
            "labels": [shown(label) for label in self.labels], "speed": self.speed,
            "length": self.length, "limits": dict(self.limits),
            "channels": [list(chambers) for chambers in self.channels],
            "steps": [[shown(label), seconds] for label, seconds in self.steps],
            "missing": [shown(why) for why in self.missing],
        }  # fmt: skip


def shown(text: str) -> str:
    """A text from outside as it may be shown: no control characters, not longer than anybody reads."""
    text = plain(text)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def about(path: Path, contents: Contents) -> About:
    """What the attachments and the metadata tell; never raises for what stands in them."""
    missing: list[str] = []
    rig, robot, limits = _rig(contents, missing)
    start = contents.metadata.get("recording", {}).get("start_wall_ns", "")
    return About(
        file=path.name,
        protocol=_protocol(contents, missing),
        rig="" if rig is None else rig.name,
        robot="" if robot is None else robot.name,
        labels=tuple(f"{name} {text}" for name, text in contents.metadata.get(RECORD, {}).items())[:MOST],
        speed=1.0 if rig is None else rig.clock.speed,
        start_wall_ns=int(start) if start.isascii() and start.isdigit() and len(start) < 20 else 0,
        channels=() if rig is None or rig.instruments.pressure is None else rig.instruments.pressure.chambers,
        length=None if robot is None else robot.length,
        limits=limits,
        steps=_steps(contents, missing),
        missing=tuple(missing),
    )


def robot_text(contents: Contents) -> str | None:
    """The attached robot.yaml; None where there is none."""
    return _text(contents, "robot.yaml")


def _text(contents: Contents, name: str) -> str | None:
    data = contents.attachments.get(name)
    return None if data is None else data.decode("utf-8", "backslashreplace")


def _rig(contents: Contents, missing: list[str]) -> tuple[RigFile | None, Robot | None, dict[str, float]]:
    rig, robot = None, None
    try:
        robot = check(parse_yaml(robot_text(contents) or "", "robot.yaml"), Robot)
    except ConfigError as e:
        missing.append(f"no model and no prediction: {e}")
    try:
        rig = check(parse_yaml(_text(contents, "rig.yaml") or "", "rig.yaml"), RigFile)
    except ConfigError as e:
        missing.append(f"no limits: {e}")
        return None, robot, {}
    if robot is not None:
        rig = within_robot(rig, robot)
    found = rig.instruments
    limits = {
        "force": rig.limits.max_force, "moment": rig.limits.max_moment, "vacuum": rig.limits.max_vacuum,
        "total_pressure": rig.limits.max_total_pressure, "hidden": rig.limits.max_hidden,
    }  # fmt: skip
    if found.pressure is not None:
        limits["pressure"] = found.pressure.max_pressure
    if found.spine is not None:
        limits["spine"] = found.spine.max_length
    return rig, robot, limits


def _protocol(contents: Contents, missing: list[str]) -> str:
    try:
        table = parse_yaml(_text(contents, "protocol.yaml") or "", "protocol.yaml").data
    except ConfigError as e:
        missing.append(str(e))
        return ""
    return str(table.get("protocol", "")) if isinstance(table, dict) else ""


def _steps(contents: Contents, missing: list[str]) -> tuple[tuple[str, float], ...]:
    """The plan, when it is one."""
    data = contents.attachments.get(PLAN)
    if data is None:
        missing.append("no plan: the recording was made by an older version")
        return ()
    try:
        steps = tuple((str(step["label"]), float(step["seconds"])) for step in read_json(data)["steps"][:10_000])
    except (ValueError, KeyError, TypeError) as e:
        missing.append(f"no plan: {PLAN} cannot be understood ({e!r:.80})")
        return ()
    return steps if all(math.isfinite(seconds) for _, seconds in steps) else ()
