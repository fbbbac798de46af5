"""What the page shows: what a recording says of itself before its first sample (robot, limits, plan), then its state, kept up to
date from the pieces of the recording, and handed out whole or by what is new.

Every number is one of the file, unchanged. Of each stream the newest sample of a piece (a tenth of a second) is shown; of the
force the piece's largest too, so that no peak is missed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from model.robot import Robot
from recordings.campaign.labels import MOST, RECORD
from recordings.events import UNCONFIRMED, Request, StateEvent
from recordings.file.contents import Contents
from recordings.file.counts import counted
from recordings.file.tail import Piece
from recordings.json_text import read_json
from recordings.trials import TrialRow

from ..console import seconds_left
from ..files.config import ConfigError, Source, check, parse_yaml
from ..files.rig_file import RigFile, within_robot
from ..plain import plain

T = TypeVar("T")

PLAN = "plan.json"
"""The attachment that holds the steps of the plan."""
LONGEST = 300
"""Characters of a name that are shown."""


@dataclass(frozen=True)
class About:
    """Of one recording; missing items are None or empty. SI units."""

    file: str
    protocol: str = ""
    rig: str = ""
    robot: str = ""
    labels: tuple[str, ...] = ()
    """The person's labels: name and text."""
    speed: float = 1.0
    """Of the rig's clock: rig seconds in a second."""
    start_wall_ns: int = 0
    length: float | None = None
    """Of the robot, m."""
    channels: tuple[tuple[int, ...], ...] = ()
    """Chambers on each channel of the regulators, counted from 1."""
    limits: Mapping[str, float] = field(default_factory=dict)
    steps: tuple[tuple[str, float], ...] = ()
    """Of the plan: completed time, s."""
    missing: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {name: _plain_values(value) for name, value in vars(self).items() if name != "start_wall_ns"}


def _plain_values(value: Any) -> Any:
    """Sanitised texts, tuples as lists."""
    if isinstance(value, str):
        return shown(value)
    return [_plain_values(item) for item in value] if isinstance(value, tuple) else value


def shown(text: str) -> str:
    """Sanitise a text from outside: no control characters, limited length."""
    text = plain(text)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]} ..."


def about(path: Path, contents: Contents) -> About:
    """What the attachments and the metadata of a recording state; never raises: what cannot be read is in `missing`."""
    missing: list[str] = []
    rig, robot, limits = _rig(contents, missing)
    start = contents.metadata.get("recording", {}).get("start_wall_ns", "")
    return About(
        file=path.name,
        protocol=_attached(contents, "protocol.yaml", lambda source: str(source.table.get("protocol", "")), missing) or "",
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


def text_of(contents: Contents, name: str) -> str | None:
    """An attached file; None where there is none."""
    data = contents.attachments.get(name)
    return None if data is None else data.decode("utf-8", "backslashreplace")


def _rig(contents: Contents, missing: list[str]) -> tuple[RigFile | None, Robot | None, dict[str, float]]:
    """Rig, robot and limits (SI) from the attached files; None or none where a file cannot be read, which `missing` then says."""
    robot = _attached(contents, "robot.yaml", lambda source: check(source, Robot), missing, "no model and no prediction: ")
    rig = _attached(contents, "rig.yaml", lambda source: check(source, RigFile), missing, "no limits: ")
    if rig is None:
        return None, robot, {}
    if robot is not None:
        rig = within_robot(rig, robot.max_pressure)
    pressure, spine = rig.instruments.pressure, rig.instruments.spine
    limits = {name: getattr(rig.limits, f"max_{name}") for name in ("force", "moment", "vacuum", "total_pressure", "hidden")}
    limits |= {"pressure": max(pressure.limits)} if pressure is not None else {}
    return rig, robot, limits | ({"spine": spine.max_length} if spine is not None else {})


def _attached(contents: Contents, name: str, read: Callable[[Source], T], missing: list[str], without: str = "") -> T | None:
    """What is read from an attached file; None where it cannot be, which `missing` then says, after what is lost `without` it."""
    try:
        return read(parse_yaml(text_of(contents, name) or "", name))
    except ConfigError as e:
        missing.append(f"{without}{e}")
        return None


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


LINES, LISTED = 200, 2000
"""Lines of the log and finished states that a page receives."""
SAME_MOMENT = 0.2
"""Host seconds by which a tip and the pressures of its prediction may differ."""

Numbers = dict[str, Any]


@dataclass
class StreamCount:
    """One stream so far."""

    count: int = 0
    dropped: int = 0
    """Numbers that are missing between its samples."""
    lost: int | None = None
    """On the way from the instrument; None until the recording's end tells."""
    newest: float = -math.inf
    number: int | None = None
    recent: deque[tuple[float, int]] = field(default_factory=lambda: deque(maxlen=40))
    """(stamp, count) at the end of the last pieces."""

    def take(self, t: float, numbers: list[int]) -> None:
        """Add this many samples, the newest at `t` s."""
        seen = numbers if self.number is None else [self.number, *numbers]
        self.dropped += sum(max(0, after - before - 1) for before, after in pairwise(seen))
        self.number = seen[-1]
        self.count += len(numbers)
        self.newest = t
        self.recent.append((t, self.count))

    @property
    def rate(self) -> float:
        """Hz of rig time over the last pieces; 0 while too few are there."""
        (t0, n0), (t1, n1) = self.recent[0], self.recent[-1]
        return (n1 - n0) / (t1 - t0) if t1 > t0 else 0.0


class Picture:
    """The state of the page."""

    def __init__(self, about: About) -> None:
        self.about = about
        self.t = 0.0
        """Rig time of the newest message, s."""
        self.first: float | None = None
        self.outcome: Numbers | None = None
        self.state: StateEvent | None = None
        self.rows: list[TrialRow] = []
        self._again: list[bool] = []
        """Of each row, whether it is of a state that was read before, which has a line of its own again."""
        self.newest: Numbers = {}
        """By stream, the newest sample that is shown."""
        self.progress: Numbers | None = None
        self.trouble = ""
        """Why the recording is not read any further."""
        self._unsafe = False
        """The safe state was not confirmed at the end."""
        self._streams: dict[str, StreamCount] = {}
        self._points: deque[Numbers] = deque(maxlen=600)
        self._log: deque[Numbers] = deque(maxlen=LINES)
        self._gaps: list[Numbers | None] = []
        self._now: Numbers | None = None
        self._begun: float | None = None
        """Planned seconds that were over when the recording began: those of the run that it resumes."""
        self._pause: Numbers | None = None
        """A pause that is asked for, or has begun."""
        self._model = {"stands": "starting", "why": ""}
        self._seen: float | None = None
        """Stamp of the last tip that was tracked."""

    # -- what comes
    def take(self, pieces: Iterable[Piece]) -> Numbers:
        """Add pieces of the recording to the state; returns the update for viewers that have the earlier ones."""
        points: list[Numbers] = []
        lines: list[Numbers] = []
        first_row = len(self.rows)
        for piece in pieces:
            points.append(self._point(piece))
            for line in piece.events["/log"]:
                t = (line.log_time - self.about.start_wall_ns) / 1e9
                lines.append({"t": t, "level": line.level, "text": shown(line.text)})
            lines += [self._asked_of(request) for request in piece.events["/request"]]
            for state in piece.events["/state"]:
                self.state = state
            self.rows += [trial.row for trial in piece.events["/trial"]]
            self._again += [trial.repeats > 0 for trial in piece.events["/trial"]]
            for message in piece.events["/progress"]:
                self._progress(message)
        self._points.extend(points)
        self._log.extend(lines)
        # of a recording played fast, the newest
        new: Numbers = {"t": self.t, "points": points[-60:], "newest": self.newest, "streams": self._counts()}
        if lines:
            new["log"] = lines[-LINES:]
        if len(self.rows) > first_row:
            new["rows"] = self._listed(first_row)
            new["of"] = len(self.rows)
        return {**new, **self._standing()}

    def whole(self) -> Numbers:
        """The whole state, for a viewer who has none of it; of the streams the points of the last minute."""
        since = self.t - 60.0 * self.about.speed
        return {
            "about": self.about.to_dict(),
            "t": self.t,
            "points": [point for point in self._points if point["t"] >= since],
            "newest": self.newest,
            "streams": self._counts(),
            "log": list(self._log),
            "rows": self._listed(max(0, len(self.rows) - LISTED)),
            "of": len(self.rows),
            **self._compared(),
            "model": self._model,
            "now": self._now,
            **self._standing(),
        }

    def end(self, metadata: Mapping[str, Mapping[str, str]], finished: bool) -> Numbers:
        """Read from the metadata how the recording ended and what was lost; returns the update for viewers."""
        ending = metadata.get("outcome", {})
        self._unsafe = ending.get("safe_state") == UNCONFIRMED
        if finished and "outcome" in ending:
            self.outcome = {"outcome": shown(ending["outcome"]), "detail": shown(ending.get("detail", ""))}
        else:
            self.outcome = {"outcome": "abrupt", "detail": "the recording was never finished"}
        for topic, counts in counted(metadata).items():
            if topic in self._streams:
                self._streams[topic].lost = counts.get("lost")
                self._streams[topic].dropped = counts.get("dropped", self._streams[topic].dropped)
        return {"streams": self._counts(), **self._standing()}

    def broken(self, why: str) -> Numbers:
        """The recording cannot be read any further."""
        self.trouble = shown(why)
        return self._standing()

    # -- what the model says
    def model_says(self, stands: str, why: str = "") -> Numbers:
        """State of the model: "starting", "ready" or "none", and why."""
        self._model = {"stands": stands, "why": shown(why)}
        return {"model": self._model}

    @property
    def ended(self) -> bool:
        """Nothing more comes."""
        return self.outcome is not None or bool(self.trouble)

    def question(self) -> tuple[Numbers, Numbers] | None:
        """The question to the model (see `expected`) about the robot as it is now, and its moment: rig time `t` (s) and the tip
        `measured` then (m; None where it was hidden). None without pressures, and of specimens and the arm."""
        state, pressure = self.state, self.newest.get("pressure")
        of_arm = state is not None and (state.state.specimen is not None or "/arm" in state.state.topics)
        if state is None or of_arm or pressure is None or None in pressure["measured"]:
            return None
        spine = self.newest.get("spine", {}).get("length")
        conditions = {
            "pressures": pressure["measured"],
            "spine": state.state.spine_length if spine is None else spine,
            "mass": state.state.tip_mass,
            "roll": math.radians(state.state.roll_deg),
        }
        tip = self.newest.get("tip")
        seen = tip is not None and tip["valid"] and abs(tip["t"] - pressure["t"]) <= SAME_MOMENT * self.about.speed
        return {"now": conditions}, {"t": pressure["t"], "measured": tip["position"] if tip and seen else None}

    def expected_now(self, now: Numbers) -> Numbers:
        """Where the tip should be at the moment of a question, and the tip measured then."""
        self._now = {**now, "error": shown(now["error"])} if "error" in now else now
        return {"now": self._now}

    def gaps(self, gaps: list[Numbers | None]) -> Numbers:
        """Of each finished state, the distance between measured and expected tip; None where there is none."""
        self._gaps = gaps
        return self._compared()

    # -- parts
    def _compared(self) -> Numbers:
        """The gaps of the last states that were compared, and the number of all."""
        return {"gaps": self._gaps[-LISTED:], "compared": len(self._gaps)}

    def _standing(self) -> Numbers:
        """The small part that is sent with every update."""
        return {
            "state": self._asked(),
            "pause": self._pause,
            "progress": self.progress,
            "outcome": self.outcome,
            "unsafe": self._unsafe,
            "trouble": self.trouble,
        }

    def _point(self, piece: Piece) -> Numbers:
        """Count the samples of a piece, keep the newest of each stream that is shown, and return these with the time."""
        for topic, samples in piece.samples.items():
            t = float(samples["t"][-1])
            self.t = max(self.t, t)
            self._streams.setdefault(topic, StreamCount()).take(t, piece.numbers[topic])
        if self.first is None and piece.samples:
            self.first = self.t
        new = {name: show(piece.samples[topic]) for topic, (name, show) in SHOWN.items() if topic in piece.samples}
        tip = piece.samples.get("/tip")
        if tip is not None and tip["valid"].any():
            self._seen = float(tip["t"][np.flatnonzero(tip["valid"])[-1]])
        if "tip" in new:
            new["tip"]["seen"] = self._seen
        self.newest = {**self.newest, **new}
        return {"t": self.t, **new}

    def _asked_of(self, request: Request) -> Numbers:
        """Add a request to the events; a pause is shown from its request to its end."""
        if request.kind == "pause":
            self._pause = {"t": request.t, "by": shown(request.by), "begun": request.done}
        elif request.kind == "go on" and (request.done or not (self._pause or {}).get("begun")):
            self._pause = None
        if request.kind == "note":
            return {"t": request.t, "level": "note", "text": shown(f"{request.text} ({request.by})")}
        done = "done" if request.done else f"asked for ({request.by})"
        return {"t": request.t, "level": "asked", "text": shown(f"{request.kind}: {done}")}

    def _listed(self, first: int) -> list[Numbers]:
        return [_listed(row, again) for row, again in zip(self.rows[first:], self._again[first:], strict=True)]

    def _progress(self, message: Any) -> None:
        """Keep the progress of the plan, and estimate the time left (s) from the pace since this recording began."""
        first = self.first if self.first is not None else message.t
        elapsed = (message.t - first) / self.about.speed
        if self._begun is None:
            self._begun = message.seconds
        own, planned = message.seconds - self._begun, message.seconds_planned - self._begun
        self.progress = {
            "t": message.t, "steps": message.steps, "planned": message.steps_planned, "seconds": message.seconds,
            "seconds_planned": message.seconds_planned, "left": seconds_left(own, planned, elapsed, self.about.speed),
        }  # fmt: skip

    def _asked(self) -> Numbers | None:
        """The last request, and whether it was read since."""
        if self.state is None:
            return None
        state = self.state.state
        last = self.rows[-1] if self.rows else None
        return {
            "t": self.state.t, "trial": state.trial, "step": state.step, "protocol": shown(state.protocol),
            "repeat": state.repeat, "branch": shown(state.branch), "rule": state.rule_name, "targets": list(state.targets),
            "spine": state.spine_length, "specimen": state.specimen, "clipped": state.clipped,
            "read": last is not None and (last.trial, last.step) == (state.trial, state.step),
        }  # fmt: skip

    def _counts(self) -> Numbers:
        return {
            topic: {"t": s.newest, "count": s.count, "rate": s.rate, "dropped": s.dropped, "lost": s.lost}
            for topic, s in self._streams.items()
        }


def _listed(row: TrialRow, again: bool) -> Numbers:
    return {
        "trial": row.trial, "step": row.step, "branch": shown(row.branch), "t": row.t, "spine": row.spine_length,
        "pressures": row.pressures, "tip": row.tip, "specimen": row.specimen, "force": row.force, "deflection": row.deflection,
        "clipped": row.clipped, "again": again,
    }  # fmt: skip


def _force(s: NDArray[np.void]) -> Numbers:
    """The newest force and moment, and the largest force of the piece."""
    net = s["raw"] - s["zero"]
    force, moment = (np.sqrt((half**2).sum(axis=1)) for half in (net[:, :3], net[:, 3:]))
    newest = {"force": float(force[-1]), "peak": float(force.max()), "moment": float(moment[-1]), "components": net[-1].tolist()}
    return {"t": float(s["t"][-1]), **newest}


def _newest(*fields: str) -> Callable[[NDArray[np.void]], Numbers]:
    """The newest sample's stamp and these of its fields."""
    return lambda s: {name: s[name][-1].tolist() for name in ("t", *fields)}


SHOWN = {
    "/pressure": ("pressure", _newest("setpoint", "measured")), "/spine": ("spine", _newest("length", "goal")),
    "/valve": ("valve", _newest("on")), "/vacuum": ("vacuum", _newest("absolute")), "/force": ("force", _force),
    "/tip": ("tip", _newest("position", "valid")),
}  # fmt: skip
"""What is shown of a stream: its name on the page, and its numbers."""
