"""Repeats requests on a disturbed line and counts that: now and then is noise, as a rule it is a fault of the line."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeVar

from .errors import BadReply, NoReply
from .serial_line import SerialLine

T = TypeVar("T")


class Retries:
    """The requests of one line."""

    def __init__(self, line: SerialLine) -> None:
        """`line`: on which they are made."""
        self._line = line
        self._repeated: deque[bool] = deque(maxlen=40)
        self._told: set[str] = set()
        self.total = 0
        """Repeated requests since the line was made."""

    def twice(self, request: Callable[[], T]) -> T:
        """Make a harmless request, and repeat it once on a disturbed line."""
        try:
            answer = request()
        except (NoReply, BadReply):
            self.count(True)
            self._line.listen(self._line.timeout)  # an answer that is only late must not be taken for the next one's
            return request()
        self.count(False)
        return answer

    def count(self, repeated: bool) -> None:
        """A request was made; whether it had to be repeated."""
        self._repeated.append(repeated)
        self.total += repeated

    def notices(self) -> list[str]:
        """What is worth a warning and was not yet reported."""
        found = {}
        # a sound line needs no repeats, a disturbed one a few in a thousand requests
        if sum(self._repeated) > 10:
            found["retries"] = (
                f"{sum(self._repeated)} of the last {len(self._repeated)} requests on {self._line.port} had to be repeated, "
                f"{self.total} since it was opened; check cable, baud rate and adapter"
            )
        if self._line.echoes:
            found["echo"] = f"the adapter on {self._line.port} echoes what is sent; switch its local echo off"
        new = [text for what, text in found.items() if what not in self._told]
        self._told |= found.keys()
        return new
