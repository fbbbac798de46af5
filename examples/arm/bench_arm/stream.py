"""What the two streams share: a thread that reads lines, and the newest sample with its age."""

import threading
from collections.abc import Callable
from typing import Any

import timing
from drivers.errors import BadReply, InstrumentError, NotReady, StaleReading
from drivers.interfaces import Identity

from .line import Line


class LineStream:
    """Samples made from lines; a subclass says how a line becomes a sample, and whether it may be used."""

    def __init__(self, name: str, line: Line, request: str, max_age: float, sink: Callable[[Any], None]) -> None:
        self.name, self.lost = name, 0
        self._line, self._request, self._max_age, self._sink = line, request, max_age, sink
        self._newest: tuple[float, Any] | None = None
        self._thread: threading.Thread | None = None
        self._stopping = timing.Event()

    def sample(self, words: list[str]) -> Any:
        """One line as a sample; raises BadReply."""
        raise NotImplementedError

    def usable(self, sample: Any) -> bool:
        """Whether `latest` may give it."""
        return True

    def open(self) -> Identity:
        """Connect, and begin to read."""
        self.close()
        self._line.open()
        try:
            if self._request:
                self._line.send(self._request)
            self._take()
        except InstrumentError:
            self._line.close()
            raise
        self._stopping.clear()
        self._thread = timing.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        return Identity("Bench", type(self).__name__)

    def close(self) -> None:
        """End the stream."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2.0)
        self._line.close()
        self._thread = self._newest = None

    def latest(self) -> Any:
        """The newest sample; raises NotReady, StaleReading."""
        if self._thread is None:
            raise NotReady(self.name, "is not open; call open() first")
        if self._newest is None or timing.now() - self._newest[0] > self._max_age:
            raise StaleReading(self.name, f"nothing good for {self._max_age:g} s; check its cable and what it sees")
        return self._newest[1]

    def _take(self) -> None:
        sample = self.sample(self._line.read())
        if self.usable(sample):
            self._newest = timing.now(), sample
        self._sink(sample)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._take()
            except BadReply:
                self.lost += 1
            except InstrumentError:
                return  # `latest` tells that nothing comes
