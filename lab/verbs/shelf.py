"""`lab runs FOLDER`: the recordings of a folder tree, with outcome and losses."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from functools import partial
from pathlib import Path

from rich.table import Table as Sheet

from recordings.campaign.labels import split
from recordings.campaign.shelf import RecordedRun
from recordings.campaign.shelf import runs as recorded
from recordings.errors import BadMessage

from ..console import clock, out
from ..files.config import ConfigError
from ..options import ANY_SIZE, JSON, Result, Verb, option


def _listed(found: Sequence[RecordedRun]) -> None:
    """The same where a table would be too wide: each recording with two lines below its path."""
    for run in found:
        notes = f", {run.notes} note{'s' if run.notes > 1 else ''}" if run.notes else ""
        spines = ", ".join(f"{100 * length:g}" for length in run.spines)
        spine = f", spine {spines} cm" if spines else ""
        out.print(run.path, soft_wrap=True, style="bold")
        out.print(f"  {run.start[:19].replace('T', ' ')} UTC, {clock(run.duration)}, {run.protocol or 'no protocol'}{spine}, "
                  f"{_states(run)} states, {run.outcome}, {run.lost} lost{notes}", soft_wrap=True)  # fmt: skip
        if run.labels:
            out.print("  " + ", ".join(f"{k}={v}" for k, v in run.labels.items()), soft_wrap=True)


def _states(run: RecordedRun) -> str:
    """How many states were read, of those planned or, where that is not known, asked for."""
    return f"{run.rows} of {run.planned} planned" if run.planned else f"{run.rows} of {run.states}"


def continued(found: Sequence[RecordedRun]) -> list[tuple[RecordedRun, RecordedRun]]:
    """Return each run that resumed another one, behind that one; `found` is in the order of time."""
    last: dict[str, RecordedRun] = {}
    pairs: list[tuple[RecordedRun, RecordedRun]] = []
    for run in found:
        if run.campaign and run.campaign in last and not run.path.endswith("-recovered.mcap"):
            pairs.append((last[run.campaign], run))
        if run.campaign:
            last[run.campaign] = run
    return pairs


def runs(folder: Path, since: str, protocol: str, spine: float | None, where: Sequence[str] = ()) -> Result:
    """List them, oldest first; `spine` in m; `where`: KEY=VALUE of labels."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: is not a folder")
    try:
        datetime.fromisoformat(since or "2000-01-01")
    except ValueError:
        raise ConfigError(f"--since {since}: write a date or time like 2025-03-01 or 2025-03-01T14:00") from None
    try:
        said = [split(text) for text in where]
    except BadMessage as e:
        raise ConfigError(f"--where {e}") from e
    found = recorded(folder, since=since, protocol=protocol, spine=spine, where=said)
    return Result([run.to_dict() for run in found], partial(_show, found))


def _show(found: Sequence[RecordedRun]) -> None:
    columns = ("recording", "start (UTC)", "duration", "protocol", "spine, cm", "states", "outcome", "lost", "notes", "labels")
    sheet = Sheet(*columns)
    for run in found:
        spines = ", ".join(f"{100 * length:g}" for length in run.spines)
        notes, labels = str(run.notes or ""), ", ".join(f"{k}={v}" for k, v in run.labels.items())
        sheet.add_row(run.path, run.start[:19].replace("T", " "), clock(run.duration), run.protocol, spines,
                      _states(run), run.outcome, str(run.lost), notes, labels)  # fmt: skip
    if out.measure(sheet, options=out.options.update(max_width=10_000)).maximum <= out.width:
        out.print(sheet)
    else:
        _listed(found)
    for before, after in continued(found):
        out.print(f"{before.path}: continued in {after.path}", soft_wrap=True)
    for run in found:
        if run.outcome == "unreadable":
            out.print(f"{run.path}: {run.detail}")
        elif run.outcome == "abrupt" and not run.detail:
            out.print(f"{run.path}: the recording was not finished; `lab recover` writes a complete file from what can be read")


VERBS = (
    Verb(
        "runs",
        lambda a: runs(a.folder, a.since, a.protocol, a.spine, a.where),
        options=(
            JSON,
            ANY_SIZE,
            option("folder", type=Path),
            option("--since", default="", metavar="DATE", help="from this date or time on (UTC)"),
            option("--protocol", default="", help="only runs of this protocol"),
            option("--spine", type=float, metavar="M", help="only runs that set this spine length, m"),
            option(
                "--where",
                action="append",
                default=[],
                metavar="KEY=VALUE",
                help="only runs with this label: operator, specimen, or a tag (repeatable)",
            ),
        ),
        examples=("lab runs runs", "lab runs runs --since 2026-01-02 --where operator=Ada"),
        page="docs/howto/campaign.md",
    ),
)
