"""Recordings that belong together: a run that was broken off and those that resumed it make one table of trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..errors import Damaged
from ..file.reader import Recording
from ..trials import Table
from .replay import table_of, units_of


def metadata(campaign: str, journal: str, first_trial: int) -> dict[str, dict[str, str]]:
    """The metadata record of a recording that belongs to a campaign."""
    return {"campaign": {"id": campaign, "journal": journal, "first_trial": str(first_trial)}}


def campaign_of(recording: Recording) -> str | None:
    """The campaign that a recording belongs to; None for one that stands alone."""
    return recording.metadata.get("campaign", {}).get("id")


def first_trial(recording: Recording) -> int:
    """The number of the first trial that was done in a recording."""
    text = recording.metadata.get("campaign", {}).get("first_trial", "1")
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise Damaged(f"{recording.path}: its metadata 'campaign' has first_trial {text[:40]!r}, which is not a number")
    return int(text)


def campaigns(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Recordings of one campaign together, one that stands alone by itself, in the order of their first recording."""
    groups: dict[str, list[Recording]] = {}
    for number, recording in enumerate(recordings):
        groups.setdefault(campaign_of(recording) or f"alone {number}", []).append(recording)
    return list(groups.values())


def tables(recordings: Sequence[Recording]) -> list[Table]:
    """One table for each campaign, and for each recording that stands alone, in the order of their first recording."""
    return [merged(group) for group in campaigns(recordings)]


def merged(recordings: Sequence[Recording]) -> Table:
    """The table of one campaign: a trial that was begun again counts as it was done last.

    `t` goes on from recording to recording: later ones count from the start of the first (wall time, but never
    backwards).
    """
    parts = sorted(recordings, key=lambda recording: (first_trial(recording), _span(recording)[0]))
    kept: list[Table] = []
    doubts: list[str] = []
    shift = 0.0
    for number, recording in enumerate(parts):
        if number:
            before = parts[number - 1]
            ended = (_span(before)[1] - before.start_wall_ns) / 1e9
            shift = max((recording.start_wall_ns - parts[0].start_wall_ns) / 1e9, shift + ended)
            kept = [table.take(table.trial < first_trial(recording)) for table in kept]
        table = table_of(recording)
        kept.append(table.replaced({"t": table.get("t") + shift}) if shift and len(table) else table)
        doubts += table.warnings
    units = {column: unit for recording in parts for column, unit in units_of(recording).items()}
    return replace(Table.stacked(kept), warnings=tuple(doubts), sensor_units=units)


def _span(recording: Recording) -> tuple[int, int]:
    """Wall time (ns) of a recording's first and last message: rig time 0 may lie long before them."""
    return recording.contents.span or (recording.start_wall_ns, recording.start_wall_ns)
