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
    """A sentence, and head and rows of the table. Raises what `recordings.campaign.info.info` raises."""
    rows, gone, total, anew = [], 0, 0, 0
    for file in files:
        for topic, stream in info(file).streams.items():
            if is_stream(topic) and stream.timing.count + (stream.dropped or 0) + (stream.lost or 0):
                rows.append([file.name, topic, *_row(stream)])
                anew += stream.restarts
                missing = stream.lost or 0
                gone += (stream.dropped or 0) + missing
                total += stream.timing.count + (stream.dropped or 0) + missing
    said = f"{gone} of {total} samples were lost" if gone else f"No sample was lost; {total} were recorded"
    if anew:
        said += (
            f"; streams restarted {anew} times (their sample numbers went back), losses at those moments are not known"
        )
    return f"{said}. A gap is an interval longer than 2.5 times the usual one.", HEAD, rows


def _row(stream: StreamInfo) -> list[str]:
    at = stream.timing
    dropped, lost = ("unknown" if n is None else str(n) for n in (stream.dropped, stream.lost))
    generated = "unknown" if stream.dropped is None else str(at.count + stream.dropped)
    return [generated, str(at.count), dropped, lost, str(at.gaps), f"{at.rate:.1f}", f"{at.jitter_p99 * 1e3:.1f}"]
