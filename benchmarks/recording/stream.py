"""Messages as a rig sends them, made up: the rates of the instruments, noise of their size, as many hours as wanted."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from recordings.file.writer import QUEUE_LIMIT, Recorder
from recordings.states.rules import State, Window

Message = tuple[str, float, tuple[object, ...]]

RATES = {"/pressure": 20, "/spine": 20, "/valve": 10, "/vacuum": 20, "/force": 100, "/arm": 125, "/tip": 120}
"""Hz; together about 1.5 million messages an hour."""
TOTAL = sum(RATES.values())
START_NS = 1_750_000_000_000_000_000
HOLD = 20.0
"""s between two states that are read."""


def schedule(seconds: float, factor: float = 1.0) -> Iterator[tuple[float, str, int]]:
    """(t, topic, number) of every message of this many seconds, in order, at `factor` times the rig's rates."""
    parts = []
    for place, rate in enumerate(RATES.values()):
        count = int(seconds * rate * factor)
        parts.append((np.arange(count) / (rate * factor) + place * 1e-4, np.full(count, place), np.arange(count)))
    times, places, numbers = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    topics = list(RATES)
    for i in np.argsort(times, kind="stable"):
        yield float(times[i]), topics[places[i]], int(numbers[i])


class Values:
    """The values of each message; noise comes from a table, so that making them costs little."""

    def __init__(self, seed: int = 1) -> None:
        self._noise = np.random.default_rng(seed).normal(0.0, 1.0, 4096).tolist()

    def of(self, topic: str, k: int, t: float) -> tuple[object, ...]:
        """In the order of the message's fields after `t`."""
        n = self._noise
        a, b, c = n[k * 7 % 4096], n[k * 11 % 4096], n[k * 13 % 4096]
        level = 50e3 * (1 + int(t / HOLD) % 5)
        if topic == "/pressure":
            asked = (0.0,) * 6 + (level,) * 3
            return (asked, tuple(p + 80.0 * n[(k * 9 + i) % 4096] for i, p in enumerate(asked)))
        if topic == "/tip":
            place = (1e-7 * level + 1e-4 * a, 1e-4 * b, 0.4 + 1e-4 * c)
            return (t + 500.0, k, place, (1.0, 1e-4 * a, 1e-4 * b, 1e-4 * c), 1e-4, True, ())
        if topic == "/force":
            return (tuple(0.05 * n[(k * 6 + i) % 4096] for i in range(6)), (0.0,) * 6)
        if topic == "/arm":
            pose = (0.4 + 1e-6 * a, 0.1, 0.3, math.pi, 0.0, 0.0)
            return (t + 90.0, (0.1 + 1e-5 * a, -1.2, 1.5, 0.0, 1.57, 1e-5 * b), pose, (0.0,) * 6, 1, True)
        if topic == "/spine":
            return (0.2 + 1e-6 * a, 0.0, 0.2, False, True)
        return (21e3 + 30.0 * a,) if topic == "/vacuum" else (True,)


def state(number: int, t: float) -> State:
    """One state of the made-up campaign, begun at `t` s and read 10 s later."""
    level = 50e3 * (1 + int(t / HOLD) % 5)
    return State(
        trial=1 + number // 10, step=1 + number % 10, protocol="bending", repeat=1, branch="load",
        rule=Window(10.0, 2.0), t_start=t, ramp_end=t, rate=25e3, targets=(0.0,) * 6 + (level,) * 3, spine_length=0.2,
        tip_mass=0.053,
    )  # fmt: skip


def record(path: Path, seconds: float) -> int:
    """Record this many seconds as fast as the writer takes them; returns how many messages of the rig there are."""
    values, count, states = Values(), 0, 0
    with Recorder(path, start_wall_ns=START_NS, keep=60.0) as recorder:
        for t, topic, k in schedule(seconds):
            if t >= states * HOLD:
                recorder.state(t, state(states, states * HOLD))
                states += 1
            recorder.push(topic, t, values.of(topic, k, t))
            count += 1
            if count % (QUEUE_LIMIT // 4) == 0:
                recorder.sync()
    return count
