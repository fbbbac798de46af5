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


def fit(device: Numbers, host: Numbers) -> ClockModel | None:
    """The model of stamps in the order in which they arrived, both in s; None when there are too few to tell."""
    use = (np.abs(device) < LATEST) & (np.abs(host) < LATEST)
    device, host = device[use], host[use]
    back = np.flatnonzero(np.diff(device) < 0)
    if len(back):  # restarts: only what came after the last counts
        device, host = device[back[-1] + 1 :], host[back[-1] + 1 :]
    if len(device) < 20 or not device[-1] > device[0]:
        return None
    reference = float(device[0])
    x = device - reference
    y = (host - host[0]) - x  # s: drift and delay, relative to the first sample
    a, b = _edge(x, y)
    drift = float((y[b] - y[a]) / (x[b] - x[a]))
    delay = y - (y[a] + drift * (x - x[a]))
    at_reference = float(y[a] - drift * x[a])
    offset, p99 = float(host[0]) - reference + at_reference, float(np.quantile(delay, 0.99))
    return ClockModel(reference, offset, drift, float(np.median(delay)), p99, len(device), len(back))


def _edge(x: Numbers, y: Numbers) -> tuple[int, int]:
    """Indices of the two points whose line is the lower convex hull's edge at the mean of x; x ascends (monotone chain)."""
    xs, ys = x.tolist(), y.tolist()
    hull: list[int] = []
    for i in range(len(xs)):
        if hull and xs[i] == xs[hull[-1]]:
            if ys[i] >= ys[hull[-1]]:
                continue
            hull.pop()
        while len(hull) > 1:
            p, q = hull[-2], hull[-1]
            if (ys[q] - ys[p]) * (xs[i] - xs[p]) < (ys[i] - ys[p]) * (xs[q] - xs[p]):
                break  # q lies below the line from p to i
            hull.pop()
        hull.append(i)
    mean = math.fsum(xs) / len(xs)
    after = next((k for k, i in enumerate(hull) if xs[i] > mean), len(hull) - 1)
    return hull[max(after, 1) - 1], hull[max(after, 1)]


def clocks(recording: Recording) -> dict[str, ClockModel]:
    """The models of all streams that carry device stamps, from the samples in the file."""
    samples = {topic: recording.stream(topic) for topic in recording.streams if has_stamp(topic)}
    models = {topic: fit(stream[STAMP], stream["t"]) for topic, stream in samples.items()}
    return {topic: model for topic, model in models.items() if model is not None}


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
