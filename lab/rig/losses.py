"""What became of each stream of a recording, as a table for people: generated = written + dropped, and what never came."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from recordings.campaign.info import StreamInfo, info
from recordings.messages import is_stream

HEAD = [
    "recording",
    "stream",
    "generated",
    "written",
    "dropped",
    "lost in transit",
    "gaps",
    "rate, Hz",
    "jitter p99, ms",
]


def newly_lost(before: int, now: int) -> int:
    """Samples lost since a driver had counted `before` of them: one that was opened again counts from zero."""
    return now - before if now >= before else now


def losses(files: Sequence[Path]) -> tuple[str, list[str], list[list[str]]]:
    """A sentence, and head and rows of the table, one row for each stream that had samples. Raises what `info` raises.

    A sample counts as lost when the recorder dropped it or it never came; where neither is known, the sentence says of how many
    streams.
    """
    rows, lost, total, restarts, unknown = [], 0, 0, 0, 0
    for file in files:
        for topic, stream in info(file).streams.items():
            lost_here = (stream.dropped or 0) + (stream.lost or 0)
            if is_stream(topic) and stream.timing.count + lost_here:
                rows.append([file.name, topic, *_row(stream)])
                restarts += stream.restarts
                unknown += None in (stream.dropped, stream.lost)
                lost += lost_here
                total += stream.timing.count + lost_here
    none = "No loss is known" if unknown else "No sample was lost"
    said = f"{lost} of {total} samples were lost" if lost else f"{none}; {total} samples were recorded"
    if unknown:
        said += f"; of {unknown} of {len(rows)} streams it is not known whether any was lost"
    if restarts:
        said += f"; streams restarted {restarts} times (their sample numbers went back), losses at those moments are not known"
    return f"{said}. A gap is an interval longer than 2.5 times the usual one.", HEAD, rows


def _row(stream: StreamInfo) -> list[str]:
    at = stream.timing
    dropped, lost = ("unknown" if n is None else str(n) for n in (stream.dropped, stream.lost))
    generated = "unknown" if stream.dropped is None else str(at.count + stream.dropped)
    return [generated, str(at.count), dropped, lost, str(at.gaps), f"{at.rate:.1f}", f"{at.jitter_p99 * 1e3:.1f}"]
