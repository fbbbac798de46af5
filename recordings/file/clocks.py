"""The clock of an instrument against the clock of the host, from the stamps of its messages.

An instrument stamps a sample when it is taken, the host when it arrives: host = device + offset + drift * device + delay,
where the delay is never negative and now and then close to its smallest. The line under all points (device, host -
device) that is closest to them is an edge of their lower convex hull: the one below their mean (S. B. Moon, P. Skelly,
D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999). The smallest delay
itself cannot be distinguished from an offset and is part of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingStream
from ..messages import STREAMS
from .reader import Recording

Numbers = NDArray[np.float64]

STAMP = "device_time"
"""Name of the field that holds the instrument's own stamp, s."""
LATEST = 1e10
"""s: a stamp beyond is none."""


@dataclass(frozen=True)
class ClockModel:
    """host = device + `offset` + `drift` * (device - `reference`), both in s of rig time, plus the delay.

    `residual`, `residual_p99` (s): median and 99th percentile of the delay beyond the smallest. `restarts`: how often
    the instrument's clock went back; the model is of the time since the last.
    """

    reference: float
    offset: float
    drift: float
    residual: float
    residual_p99: float
    samples: int
    restarts: int

    def host(self, device: Numbers) -> Numbers:
        """Rig time (s) at which samples with these device stamps (s) were taken (and could have arrived at best)."""
        return np.asarray(device + self.offset + self.drift * (device - self.reference))


class ClockFit:
    """The model of stamps that come piece by piece, in the order in which they arrive.

    What is kept is the lower hull, and of the delays' samples every second, fourth .. once they are more than `MOST`.
    """

    MOST = 2**17

    def __init__(self) -> None:
        self._restarts = 0
        self._last = -math.inf
        self._begin()

    def _begin(self) -> None:
        """Forget what came before a restart."""
        self._count, self._sum, self._reference, self._host, self._step = 0, 0.0, 0.0, 0.0, 1
        self._hull: list[tuple[float, float]] = []
        self._points = np.zeros((0, 2))

    def add(self, device: Numbers, host: Numbers) -> None:
        """Take the next stamps, both in s."""
        use = (np.abs(device) < LATEST) & (np.abs(host) < LATEST)
        device, host = device[use], host[use]
        if not len(device):
            return
        back = np.flatnonzero(np.diff(device, prepend=self._last) < 0)
        self._last = float(device[-1])
        if len(back):  # restarts: only what came after the last counts
            self._restarts += len(back)
            self._begin()
            device, host = device[back[-1] :], host[back[-1] :]
        if not self._count:
            self._reference, self._host = float(device[0]), float(host[0])
        x = device - self._reference
        y = (host - self._host) - x  # s: drift and delay, relative to the first sample
        self._points = np.concatenate([self._points, np.column_stack([x, y])[-self._count % self._step :: self._step]])
        self._count, self._sum = self._count + len(x), self._sum + math.fsum(x)
        while len(self._points) > self.MOST:
            self._points, self._step = self._points[::2], 2 * self._step
        _extend(self._hull, x, y)

    @property
    def model(self) -> ClockModel | None:
        """The model of what came until now; None when there is too little to tell."""
        if self._count < 20 or not self._last > self._reference:
            return None
        mean, last = self._sum / self._count, len(self._hull) - 1
        corner = max(next((k for k, (x, _) in enumerate(self._hull) if x > mean), last), 1)
        (xa, ya), (xb, yb) = self._hull[corner - 1 : corner + 1]  # the edge at the mean of x
        x, y = self._points.T
        drift = (yb - ya) / (xb - xa)
        delay = y - (ya + drift * (x - xa))
        offset, p99 = self._host - self._reference + (ya - drift * xa), float(np.quantile(delay, 0.99))
        return ClockModel(self._reference, offset, drift, float(np.median(delay)), p99, self._count, self._restarts)


def _extend(hull: list[tuple[float, float]], xs: Numbers, ys: Numbers) -> None:
    """Extend a lower convex hull by points whose x ascends (monotone chain)."""
    for _ in range(3):  # what lies above the line between its neighbours is no corner; this leaves few
        before, after = (xs[1:-1] - xs[:-2], ys[1:-1] - ys[:-2]), (xs[2:] - xs[1:-1], ys[2:] - ys[1:-1])
        corner = np.concatenate([[True], before[1] * after[0] <= after[1] * before[0], [True]])[: len(xs)]
        xs, ys = xs[corner], ys[corner]
    for x, y in zip(xs.tolist(), ys.tolist(), strict=True):
        if hull and x == hull[-1][0]:
            if y >= hull[-1][1]:
                continue
            hull.pop()
        while len(hull) > 1:
            (xp, yp), (xq, yq) = hull[-2:]
            if (yq - yp) * (x - xp) < (y - yp) * (xq - xp):
                break  # q lies below the line from p to here
            hull.pop()
        hull.append((x, y))


def fit(device: Numbers, host: Numbers) -> ClockModel | None:
    """The model of stamps in the order in which they arrived, both in s; None when there are too few to tell."""
    stamps = ClockFit()
    stamps.add(device, host)
    return stamps.model


def aligned(recording: Recording, topic: str) -> Numbers:
    """Rig time (s) at which each sample of a stream was taken, by the instrument's own stamp.

    Free of the jitter with which messages arrive; samples from before a restart of the instrument, and streams too
    short for a model, keep the host's stamp. Raises `MissingStream` for a stream without device stamps.
    """
    if not has_stamp(topic):
        raise MissingStream(f"{topic} has no time stamp of its instrument; use its field t")
    samples = recording.stream(topic)
    device, out = samples[STAMP], samples["t"].copy()
    if (model := fit(device, out)) is not None:
        begin = len(device) - model.samples
        out[begin:] = np.where(np.isfinite(device), model.host(device), out)[begin:]
    return np.asarray(out)


def has_stamp(topic: str) -> bool:
    """Whether the messages of a stream carry the instrument's own stamp."""
    return topic in STREAMS and STAMP in STREAMS[topic].value_names
