"""In which order the runs of a campaign are done: blocks in random order, a person's hands as seldom as possible.

Each block holds every condition once, shuffled within the block. What drifts over the day (silicone that warms up, a supply that
falls) then differs from block to block, and is not confounded with what is varied. What needs a person's hands is a whole plot:
all blocks at one set-up follow each other (a split-plot design), unless the file wants hands in random order too.
"""

from __future__ import annotations

import random
from collections.abc import Hashable, Mapping, Sequence

Cell = tuple[int, int]
"""Number of the protocol in the file, and of its condition."""
Slot = tuple[int, Cell]
"""A block and what is done in it."""


def ordered(hands: Sequence[Sequence[Hashable]], blocks: int, seed: int, grouped: bool) -> list[Slot]:
    """All runs in order; `hands`: of each protocol the set-up of each of its conditions.

    >>> ordered([["light", "light", "heavy"]], 2, 1, True)
    [(1, (0, 1)), (1, (0, 0)), (2, (0, 1)), (2, (0, 0)), (1, (0, 2)), (2, (0, 2))]
    """
    rng = random.Random(seed)
    cells = [[(part, k) for k in range(len(own))] for part, own in enumerate(hands)]
    if not grouped:
        return [(block, cell) for own in cells for block in range(1, blocks + 1) for cell in _shuffled(own, rng)]
    plots = [
        {setup: [(part, k) for k, s in enumerate(own) if s == setup] for setup in dict.fromkeys(own)}
        for part, own in enumerate(hands)
    ]
    return [
        (block, cell)
        for own, setups in zip(plots, fewest_changes([list(p) for p in plots], rng), strict=True)
        for setup in setups
        for block in range(1, blocks + 1)
        for cell in _shuffled(own[setup], rng)
    ]


def _shuffled(cells: Sequence[Cell], rng: random.Random) -> list[Cell]:
    return rng.sample(cells, len(cells))


def fewest_changes(parts: Sequence[Sequence[Hashable]], rng: random.Random) -> list[list[Hashable]]:
    """The set-ups of each part in random order, such that as many parts as possible begin with the set-up that the one before
    ended with."""
    best: Mapping[Hashable, tuple[int, list[list[Hashable]]]] = {None: (0, [])}
    for setups in parts:
        mixed = rng.sample(list(setups), len(setups))
        found: dict[Hashable, tuple[int, list[list[Hashable]]]] = {}
        for first in mixed:
            for last in mixed if len(mixed) == 1 else [s for s in mixed if s != first]:
                order = [first, *(s for s in mixed if s not in (first, last)), *([last] if last != first else [])]
                for before, (kept, orders) in best.items():
                    score = kept + (before == first and bool(orders))
                    if last not in found or score > found[last][0]:
                        found[last] = (score, [*orders, order])
        best = found
    return max(best.values(), key=lambda scored: scored[0])[1]


def changes(setups: Sequence[Sequence[Hashable]]) -> int:
    """How often a person's hands are needed for these set-ups of runs in order, the first included."""
    flat = [s for own in setups for s in own]
    return sum(k == 0 or s != flat[k - 1] for k, s in enumerate(flat))
