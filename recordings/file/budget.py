"""What reading a file may cost, settled by the file's size before anything is unpacked or memory is taken for it.

A packed file can say in a few bytes what fills the memory of any computer. An honest recording cannot: each message
costs 16 bytes of index alone, and numbers of instruments do not pack well (measured: 2 to 8 times; a rig at rest, all
values constant, is the 8). So every way of reading counts what it takes against a share of the file's size, several
times of what honest files need, and stops with `Oversized` where a file wants more. Whatever a file says of itself is
counted before it is believed.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from ..errors import Oversized

MAX_CHUNK = 64 * 2**20
"""Bytes that the largest chunk of the largest file may hold; ours hold 1 MB at most."""
SMALL_CHUNK = 8 * 2**20
"""Bytes that a chunk of any file may hold."""
SMALLEST_CHUNK = 1024
"""Bytes that a chunk counts at least: what is done for each."""
PER_TEXT = 12
"""Bytes of memory that a byte of metadata costs at most, once its short texts are taken apart."""
PER_CHANNEL = 1000
"""Bytes of memory that a channel costs, however little it says."""


class Cost(Enum):
    """What is counted: (what it is called, free of charge, as much for each byte of the file)."""

    UNPACKED = ("bytes in its chunks", 8 * 2**20, 24.0)
    RECORDS = ("records in its chunks, walked over one by one", 50_000, 1 / 4)
    DEFINITIONS = ("bytes of schemas, channels and metadata", 16 * 2**20, 4.0)
    EVENTS = ("bytes of states, rows and log lines", 2**20, 4.0)
    LOOKED_AT = ("samples, looked at state by state", 500_000, 4.0)


MAX_TOTAL = 4 * 2**30
"""Of any of these, whatever the size of the file: bytes of more than twelve hours of the rig."""
OPTION = "--any-size"
"""Of every verb that reads recordings: lifts these limits."""
_lifted = False


def lift() -> None:
    """Read files of this process whatever size they claim, as far as the memory goes."""
    global _lifted
    _lifted = True


def lifted() -> bool:
    """Whether the limits are lifted."""
    return _lifted


def largest_chunk(size: int) -> int:
    """Bytes that a chunk of a file of `size` bytes may hold."""
    return MAX_TOTAL if _lifted else max(SMALL_CHUNK, min(size, MAX_CHUNK))


def largest_message() -> int:
    """Bytes of one message that the protobuf runtime takes apart."""
    return MAX_TOTAL if _lifted else 64 * 2**10  # a state has about a thousand


def _most(cost: Cost, size: int) -> int:
    return 2**62 if _lifted else min(int(cost.value[1] + cost.value[2] * size), MAX_TOTAL)


@dataclass
class ReadingBudget:
    """What is left for one pass over the file `name` of `size` bytes."""

    name: str
    size: int

    def __post_init__(self) -> None:
        self._left = {cost: _most(cost, self.size) for cost in Cost}

    def grow(self, size: int) -> None:
        """The file has grown to `size` bytes, and may cost accordingly more."""
        for cost in Cost:
            self._left[cost] += max(0, _most(cost, size) - _most(cost, self.size))
        self.size = max(size, self.size)

    def left(self, cost: Cost) -> int:
        """How much may still be taken."""
        return self._left[cost]

    def take(self, cost: Cost, count: int) -> None:
        """Count something before it is done; raises `Oversized` when it is more than is left."""
        self._left[cost] -= count
        if self._left[cost] < 0:
            what, most = cost.value[0], _most(cost, self.size)
            raise Oversized(
                f"{self.name}: claims to hold more than {most} {what}, the limit for a file of {self.size} bytes; "
                f"if you trust the file, {OPTION} lifts the limit"
            )
