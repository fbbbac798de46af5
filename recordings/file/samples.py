"""One stream's samples, decoded batch by batch into one array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..messages import MessageType


class Samples:
    """Collects messages of fixed layout; `expected` is how many there will probably be."""

    def __init__(self, message: MessageType, expected: int) -> None:
        self.message = message
        self._out = np.zeros(expected, message.dtype)
        self._count = 0
        self._other = False

    def add(self, rows: NDArray[np.uint8] | None) -> None:
        """Messages as rows of bytes, shape (n, size); None when their sizes differ."""
        if self._other or rows is None or not self.message.fits(rows):
            self._other = True
            return
        end = self._count + len(rows)
        if end > len(self._out):
            larger = np.zeros(end + len(self._out) // 2, self.message.dtype)
            larger[: self._count] = self._out[: self._count]
            self._out = larger
        self.message.decode(rows.reshape(-1), self._out[self._count : end])
        self._count = end

    @property
    def array(self) -> NDArray[np.void] | None:
        """All samples; None when some message has another layout."""
        return None if self._other else self._out[: self._count]
