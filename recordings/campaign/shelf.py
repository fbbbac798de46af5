"""The recordings of a folder tree at a glance: what, when, how it ended, and what was lost.

The index is an SQLite file in the folder. It holds nothing that is not in the recordings: a file is read again when its
size or time of change differ, and the whole index is made anew when it is missing, damaged, or of another version.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_type_hints

from ..errors import RecordingError
from ..file.reader import Recording
from ..json_text import read_json
from .info import info, planned_of
from .labels import MOST, labels_of
from .resumed import campaign_of

INDEX = ".recordings.sqlite"
VERSION = 5
LONGEST = 1_000_000
"""Bytes of a text in the index."""
TOLERANCE = 0.5e-3
"""m: a spine length that is asked for matches one that was set within this."""

_TABLE = """CREATE TABLE runs (
    path TEXT PRIMARY KEY, size INTEGER NOT NULL, changed INTEGER NOT NULL,
    start TEXT NOT NULL, duration REAL NOT NULL, protocol TEXT NOT NULL, spines TEXT NOT NULL, outcome TEXT NOT NULL,
    detail TEXT NOT NULL, states INTEGER NOT NULL, rows INTEGER NOT NULL, lost INTEGER NOT NULL, campaign TEXT NOT NULL,
    labels TEXT NOT NULL, notes INTEGER NOT NULL, planned INTEGER NOT NULL
)"""


@dataclass(frozen=True)
class Run:
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

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "complete": self.complete}


def runs(
    folder: str | os.PathLike[str],
    *,
    since: str = "",
    protocol: str = "",
    spine: float | None = None,
    where: Sequence[tuple[str, str]] = (),
) -> list[Run]:
    """The recordings below a folder, oldest first, after bringing the index up to date.

    `since`: ISO date or time (UTC); `protocol`: its name; `spine`: a length (m) that was set in the run;
    `where`: labels that it has, name and text.
    """
    folder = Path(folder)
    for place in (folder / INDEX, folder / INDEX, None):
        try:
            with contextlib.closing(_opened(place)) as index:
                _refresh(index, folder)
                columns = ", ".join(field.name for field in fields(Run))
                query = f"SELECT {columns} FROM runs WHERE start >= ? AND (? = '' OR protocol = ?) ORDER BY start, path"
                out = [_run(row) for row in index.execute(query, (since, protocol, protocol))]
        except (sqlite3.DatabaseError, sqlite3.DataError, ValueError, TypeError, OverflowError):
            # An index that is damaged is of no use: it is made anew, in memory where the folder cannot be written.
            if place is not None:
                with contextlib.suppress(OSError):
                    place.unlink(missing_ok=True)
            continue
        out = [run for run in out if spine is None or any(abs(length - spine) <= TOLERANCE for length in run.spines)]
        return [run for run in out if all(run.labels.get(name) == text for name, text in where)]
    raise RecordingError(
        f"{folder / INDEX}: no index can be created, not even in memory; check the installation of SQLite"
    )


def _run(row: tuple[Any, ...]) -> Run:
    """A line of the index; ValueError or TypeError when it is none."""
    names = [field.name for field in fields(Run)]
    values = dict(zip(names, row, strict=True))
    values |= {"duration": float(values["duration"]), "spines": tuple(map(float, read_json(values["spines"])))}
    values["labels"] = said = read_json(values["labels"])
    run, hints = Run(**values), get_type_hints(Run)
    if not isinstance(said, dict) or not all(isinstance(text, str) for text in said.values()):
        raise TypeError(f"{run.path!r}: not a line of this index")
    if not all(isinstance(values[name], hints[name]) for name in names if hints[name] in (str, int)):
        raise TypeError(f"{run.path!r}: not a line of this index")
    return run


def _opened(path: Path | None) -> sqlite3.Connection:
    """The index at a path, or None: in memory; made anew when it is of another version. Raises sqlite3.DatabaseError."""
    if path is not None and (path.is_symlink() or (path.exists() and not path.is_file())):
        raise RecordingError(f"{path}: is a symbolic link or not a regular file, and is not followed; remove it")
    index = sqlite3.connect(":memory:" if path is None else path, timeout=10.0)
    try:
        index.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
        # The index can be thrown away at any time: no files beside it.
        index.execute("PRAGMA journal_mode = MEMORY")
        index.execute("PRAGMA trusted_schema = OFF")
        (version,) = index.execute("PRAGMA user_version").fetchone()
        made = index.execute("SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
        if version != VERSION or made != [("table", "runs", _TABLE)]:
            if made or version:
                raise sqlite3.DatabaseError("an index of another kind")
            with index:
                index.execute(_TABLE)
                index.execute(f"PRAGMA user_version = {VERSION}")
    except BaseException:
        index.close()
        raise
    return index


def _refresh(index: sqlite3.Connection, folder: Path) -> None:
    """Read what is new or changed, forget what is gone."""
    known = {path: (size, changed) for path, size, changed in index.execute("SELECT path, size, changed FROM runs")}
    there: set[str] = set()
    for file in sorted(folder.rglob("*.mcap")):
        if file.name.startswith("."):
            continue
        name = file.relative_to(folder).as_posix()
        try:
            status = file.stat()
        except OSError:
            continue
        there.add(name)
        if known.get(name) != (status.st_size, status.st_mtime_ns):
            values = (name, status.st_size, status.st_mtime_ns, *_entry(file))
            with index:
                index.execute(f"REPLACE INTO runs VALUES ({', '.join('?' * len(values))})", values)
    with index:
        index.executemany("DELETE FROM runs WHERE path = ?", [(name,) for name in known.keys() - there])


def _entry(file: Path) -> tuple[Any, ...]:
    """What the index says of a file, from its start on; a file that cannot be read is listed as such."""
    try:
        summary, recording = info(file), Recording.open(file, truncated=True)
        states = [event.state for event in recording.states]
    except RecordingError as error:
        changed = datetime.fromtimestamp(file.stat().st_mtime, UTC).isoformat(timespec="seconds")
        return (changed, 0.0, "", "[]", "unreadable", str(error)[:2000], 0, 0, 0, "", "{}", 0, 0)
    lost = sum((s.dropped or 0) + (s.lost or 0) for s in summary.streams.values())
    outcome = (summary.outcome or "finished") if summary.finished else "abrupt"
    protocols = ", ".join(sorted({state.protocol for state in states})) or planned_of(recording)[0]
    spines = json.dumps(sorted({state.spine_length for state in states}))
    labels = json.dumps(dict(itertools.islice(labels_of(recording).items(), MOST)))
    campaign, detail = (campaign_of(recording) or "")[:200], summary.detail[:2000]
    notes = sum(request.kind == "note" for request in summary.requests)
    return (
        summary.start, summary.duration, protocols, spines, outcome, detail, summary.states, summary.rows, lost, campaign,
        labels, notes, summary.planned,
    )  # fmt: skip
