"""Frames in the order in which they were sent, each once; what never came is counted as lost."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..interfaces import BodySample

WINDOW = 0.3
"""Host seconds for which a frame that has overtaken others waits for them: several times the jitter of a network. What
comes later than that is lost to the recording, and is counted so."""
AHEAD, FASTEST = 1000, 1000.0
"""Frames that may be missing at once, and frames a second of silence that may be missing beyond them: more is no gap, the
count has changed."""


@dataclass
class _Held:
    sample: BodySample
    came: float


class Order:
    """Sorts one server's frames."""

    def __init__(self) -> None:
        self.lost = 0
        """Frames that never came, or too late."""
        self.newest: BodySample | None = None
        """Of those that came, the one with the highest number."""
        self._next: int | None = None
        self._held: dict[int, _Held] = {}
        self._strange: list[BodySample] = []
        self._out: list[BodySample] = []
        self._anew = False
        self._came = 0.0

    def connected_again(self) -> None:
        """The server may have been restarted: a lower number begins a new count."""
        self._anew = True

    def take(self, sample: BodySample, now: float) -> bool:
        """Whether this frame, which has come at the host's time `now`, is a new one. Take what is `ready` afterwards."""
        number, newest = sample.frame, self.newest
        if newest is not None and (number, sample.device_time) == (newest.frame, newest.device_time):
            return False
        if self._next is None:
            self._next = number
        ahead = number - self._next
        if 0 <= ahead <= AHEAD + FASTEST * (now - self._came if self._came else 0.0):
            return self._accept(sample, now)
        if newest is not None and -300 <= ahead < 0 and sample.device_time <= newest.device_time and not self._anew:
            return False
        if self._strange and not 0 < number - self._strange[-1].frame <= AHEAD:
            self._strange.clear()
        self._strange.append(sample)
        # three frames in a row that fit no gap and no lateness: the server's count has begun anew
        if len(self._strange) < 3 and not (self._anew and ahead < 0):
            return False
        self._begin(self._strange[0].frame)
        for earlier in self._strange[:-1]:
            self._accept(earlier, now, keep=True)
        return self._accept(sample, now)

    def ready(self, now: float) -> list[BodySample]:
        """Samples in order, for which nothing is waited any more. One that was overtaken gets the time of the next."""
        out, self._out = self._out, []
        while self._held and self._next is not None:
            first = min(self._held)
            if first > self._next and now - min(h.came for h in self._held.values()) < WINDOW:
                break
            self.lost += first - self._next
            held = self._held.pop(first)
            out.append(held.sample)
            self._next = first + 1
        t = min((h.sample.t for h in self._held.values()), default=float("inf"))
        for k in range(len(out) - 1, -1, -1):
            t = min(t, out[k].t)
            out[k] = out[k] if out[k].t == t else replace(out[k], t=t)
        return out

    def _begin(self, number: int) -> None:
        """A new count; what still waits comes before it."""
        self._out += [self._held[k].sample for k in sorted(self._held)]
        self.newest, self._next, self._held = None, number, {}

    def _accept(self, sample: BodySample, now: float, keep: bool = False) -> bool:
        if sample.frame in self._held or (self._next is not None and sample.frame < self._next):
            return False
        self._held[sample.frame] = _Held(sample, now)
        self._came, self._anew = now, False
        if self.newest is None or sample.frame > self.newest.frame:
            self.newest = sample
        if not keep:
            self._strange.clear()
        return True
