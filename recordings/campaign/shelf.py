"""The recordings of a folder tree at a glance: what, when, how it ended, and what was lost.

The index is a file in the folder. It holds nothing that is not in the recordings: a recording is read again when its size or
time of change differ, and the whole index is made anew when it is missing, damaged, or of another version.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_type_hints

from ..bounded import read_bounded
from ..errors import RecordingError
from ..file.reader import Recording
from ..json_text import Plain, read_json
from ..own_files import replaced
from .info import info, planned_of
from .labels import MOST, RECORD
from .replay import campaign_of

INDEX = ".recordings.json"
VERSION = 6


@dataclass(frozen=True)
class RecordedRun(Plain):
    """One recording. `path`: below the folder. `start`: wall time of its first message, ISO 8601 UTC. `spines`: lengths
    (m). `outcome`: completed, stopped, failed, finished (it does not state how), abrupt (its end is missing), or
    unreadable. `lost`: samples dropped or lost, as far as known."""

    path: str
    size: int
    start: str
    duration: float
    protocol: str
    spines: tuple[float, ...]
    outcome: str
    detail: str
    states: int
    rows: int
    lost: int
    campaign: str
    labels: Mapping[str, str]
    """What a person said of it (see `labels`)."""
    notes: int
    """How many lines people wrote down while it went on."""
    planned: int
    """States of the whole plan; 0 where it does not say."""

    @property
    def complete(self) -> bool:
        """It came to an end, and nothing was lost."""
        return self.outcome in ("completed", "stopped", "failed") and self.lost == 0


def runs(folder: str | os.PathLike[str], where: Sequence[tuple[str, str]] = ()) -> list[RecordedRun]:
    """Recordings below a folder, oldest first, once the index is up to date; `where`: labels that they have, name and text."""
    folder = Path(folder)
    place = folder / INDEX
    if place.is_symlink() or (place.exists() and not place.is_file()):
        raise RecordingError(f"{place}: is a symbolic link or not a regular file, and is not followed; remove it")
    known, indexed = _read(place), dict[str, tuple[int, RecordedRun]]()
    for file in sorted(folder.rglob("*.mcap")):
        if file.name.startswith("."):
            continue
        name = file.relative_to(folder).as_posix()
        try:
            status = file.stat()
        except OSError:
            continue
        changed, run = known.get(name, (0, None))
        if run is None or (changed, run.size) != (status.st_mtime_ns, status.st_size):
            run = _entry(file, name, status)
        indexed[name] = status.st_mtime_ns, run
    if indexed != known:
        lines = [{"changed": changed, **asdict(run)} for changed, run in indexed.values()]
        with contextlib.suppress(OSError):  # a folder that cannot be written has none
            replaced(place, json.dumps({"version": VERSION, "runs": lines}))
    return [
        run
        for run in sorted((run for _, run in indexed.values()), key=lambda run: (run.start, run.path))
        if all(run.labels.get(key) == text for key, text in where)
    ]


def _read(place: Path) -> dict[str, tuple[int, RecordedRun]]:
    """The index by path: time of change (ns), and what is known; empty where there is none or it is of no use."""
    try:
        index = read_json(read_bounded(place, 100_000_000, ValueError))  # a recording has some 500 bytes
        lines = index["runs"] if index["version"] == VERSION else []
        return {line["path"]: (int(line.pop("changed")), _run(line)) for line in lines}
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError):
        return {}


def _run(line: dict[str, Any]) -> RecordedRun:
    """A line of the index; ValueError or TypeError when it is none."""
    run, hints = RecordedRun(**line | {"spines": tuple(map(float, line["spines"]))}), get_type_hints(RecordedRun)
    right = all(type(value) is hints[name] for name, value in vars(run).items() if hints[name] in (str, int, float))
    if not right or not all(isinstance(text, str) for text in run.labels.values()):
        raise TypeError(f"{run.path!r}: not a line of this index")
    return run


def _entry(file: Path, name: str, status: os.stat_result) -> RecordedRun:
    """What there is to say of a file; one that cannot be read is listed as such."""
    try:
        summary, recording = info(file), Recording.open(file, truncated=True)
        states = [event.state for event in recording.states]
    except RecordingError as error:
        changed = datetime.fromtimestamp(status.st_mtime, UTC).isoformat(timespec="seconds")
        return RecordedRun(name, status.st_size, changed, 0.0, "", (), "unreadable", str(error)[:2000], 0, 0, 0, "", {}, 0, 0)
    return RecordedRun(
        path=name, size=status.st_size, start=summary.start, duration=summary.duration,
        protocol=", ".join(sorted({state.protocol for state in states})) or planned_of(recording)[0],
        spines=tuple(sorted({float(state.spine_length) for state in states})),
        outcome=(summary.outcome or "finished") if summary.finished else "abrupt", detail=summary.detail[:2000],
        states=summary.states, rows=summary.rows,
        lost=sum((s.dropped or 0) + (s.lost or 0) for s in summary.streams.values()),
        campaign=(campaign_of(recording) or "")[:200], labels=dict([*recording.metadata.get(RECORD, {}).items()][:MOST]),
        notes=sum(request.kind == "note" for request in summary.requests), planned=summary.planned,
    )  # fmt: skip
