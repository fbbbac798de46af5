"""Pieces of a recording as they come, or, of one that was recorded before, at the pace at which they came."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable

from recordings.file.tail import Piece, Tail

AT_ONCE = 256
"""Pieces that are read in one go while the beginning of a long run is caught up with."""


async def following(tail: Tail, over: Callable[[], bool]) -> AsyncIterator[list[Piece]]:
    """What is in the file, then what comes, until it is finished; or until nothing more comes once `over`."""
    while not tail.contents.finished:
        if tail.grown():
            yield await asyncio.to_thread(tail.read)
        elif over():
            return
        else:
            await asyncio.sleep(0.02)


async def played(tail: Tail, speed: float) -> AsyncIterator[list[Piece]]:
    """The pieces of a recording at `speed` times rig time (inf: at once); ends where nothing more can be read."""
    begin, first = time.monotonic(), None
    due: list[Piece] = []
    while pieces := await asyncio.to_thread(tail.read):
        for piece in pieces:
            first = piece.until if first is None else first
            wait = begin + (piece.until - first) / 1e9 / speed - time.monotonic()
            if wait > 0.05 or (due and math.isfinite(speed) and wait > 0):
                if due:
                    yield due
                    due = []
                await asyncio.sleep(max(wait, 0.0))
            due.append(piece)
            if len(due) >= AT_ONCE:
                yield due
                due = []
    if due:
        yield due
