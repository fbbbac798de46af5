"""A way through states: ramps and holds of the chambers, solved for all lanes at once, each from the last one's shape."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .body import SEGMENTS, build
from .equilibrium import Loads, Shape, settle, straight
from .forms import Physics
from .frames import apply, screw
from .gas import chambers
from .material import SectionStates
from .robot import MARKERS, Lanes
from .seen import SeenPath, seeing

Array = NDArray[np.float64]

HOLD_EDGES = (0.1, 0.35, 1.0)


@dataclass(frozen=True)
class Leg:
    """Go to pressures (Pa) at a rate (Pa/s), hold (s), and read or not."""

    pressures: tuple[float, ...]
    rate: float
    hold: float
    read: bool = True


def walk(lanes: Lanes, physics: Physics, legs: Sequence[Leg], segments: int = SEGMENTS) -> SeenPath:
    """The readings of all lanes. Raises `NoWorldEquilibrium`."""
    body = build(lanes, physics.body, segments)
    gas_of = chambers(body, physics.chambers)
    seen = seeing(lanes, physics.seen)
    sections = SectionStates(body)
    fine = sections.remembers or seen.needs_time
    line = body.line[..., None] * body.gravity[:, None]
    force = body.node_mass[..., None] * body.gravity[:, None]
    shape, before = straight(body.h), None
    pressure = np.zeros(9)
    track = _Track(body.h, lanes)

    def step(target: Array, dt: float, read: bool) -> None:
        nonlocal shape, before, pressure
        gas, tip, moment = gas_of.act(target)
        loads = Loads(line, force, moment, tip, tuple(body.fields), (body.base_place, body.base_turn), body.give)
        start = shape if before is None or dt == 0 else _ahead(before, shape, body.h, pressure, target)

        def material(xi: Array) -> tuple[Array, Array]:
            return sections.stress(xi, gas, dt)

        moved = settle(start, body.h, material, loads)
        sections.commit(moved.strains(body.h), gas, dt)
        before, shape, pressure = (shape, pressure), moved, target
        track.add(dt, shape, target, read)

    step(pressure, 1e6, False)
    before = None
    for leg in legs:
        target = np.asarray(leg.pressures, float)
        change = float(np.abs(target - pressure).max())
        # what remembers does so exactly while strains change evenly within a step
        start, count = pressure, max(1, math.ceil(change / 50e3 - 1e-9)) if change else 0
        for i in range(1, count + 1):
            last = i == count and not leg.hold
            step(start + (target - start) * i / count, change / leg.rate / count, leg.read and last)
        edges = HOLD_EDGES if fine and leg.hold else (1.0,)
        for a, b in zip((0.0, *edges[:-1]), edges, strict=True):
            if leg.hold:
                step(target, leg.hold * (b - a), leg.read and b == 1.0)
        if leg.read and not leg.hold and not count:
            step(target, 0.0, True)
    return seen.look(track.path())


def _ahead(before: tuple[Shape, Array], now: Shape, h: Array, reached: Array, target: Array) -> Shape:
    """A guess: strains go on as from the last step to this."""
    past, was = before
    span = float(np.abs(reached - was).max())
    move = float(np.max(np.abs(target - reached)))
    if span == 0 or move == 0:
        return now
    k = int(np.argmax(np.abs(reached - was)))
    ratio = float(np.clip((target[k] - reached[k]) / (reached[k] - was[k]), -1.0, 1.5))
    xi = now.strains(h)
    xi = xi + ratio * (xi - past.strains(h))
    p, r = screw(xi * h[..., None])
    guess = now.copy()
    for i in range(h.shape[1]):
        guess.r[:, i + 1] = guess.r[:, i] + apply(guess.turns[:, i], p[:, i])
        guess.turns[:, i + 1] = guess.turns[:, i] @ r[:, i]
    return guess


class _Track:
    """Collects the path of the tips."""

    def __init__(self, h: Array, lanes: Lanes) -> None:
        nodes = np.concatenate([np.zeros((len(h), 1)), np.cumsum(h, axis=1)], axis=1)
        self._at = [np.array([np.searchsorted(row, m) - 1 for row in nodes]) for m in MARKERS]
        self._part = [(m - nodes[np.arange(len(h)), k]) / h[np.arange(len(h)), k] for m, k in zip(MARKERS, self._at, strict=True)]
        self._h = h
        self._time = 0.0
        self._rows: list[tuple[float, bool, Array, Array, Array, Array]] = []

    def add(self, dt: float, shape: Shape, pressures: Array, read: bool) -> None:
        self._time += min(dt, 60.0)
        lane = np.arange(len(self._h))
        markers = []
        xi = shape.strains(self._h)
        for k, part in zip(self._at, self._part, strict=True):
            p, _ = screw(xi[lane, k] * (part * self._h[lane, k])[:, None])
            markers.append(shape.r[lane, k] + apply(shape.turns[lane, k], p))
        self._rows.append((self._time, read, shape.r[:, -1], shape.turns[:, -1], np.stack(markers, axis=1), pressures))

    def path(self) -> SeenPath:
        times = np.array([row[0] for row in self._rows])
        # a step of no time would fold the path
        times += 1e-9 * np.arange(len(times))
        reads = np.array([i for i, row in enumerate(self._rows) if row[1]], np.intp)
        tip, turns, markers, pressures = (np.array([row[i] for row in self._rows]) for i in (2, 3, 4, 5))
        return SeenPath(times, reads, tip, turns, markers, pressures)
