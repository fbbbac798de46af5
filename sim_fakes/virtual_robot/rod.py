"""A rod that keeps its shape and memory from step to step, on a mesh with a node at the spine's end."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .balance import commit, equilibrium, foresee
from .chain import Chain, ChainLoads, straight
from .material import Sections, SliderHistory, fresh_history

Array = NDArray[np.float64]

FIRST_BRAKE, LAST_BRAKE = 8.0, 0.03
"""Viscosity of the intermediate steps when a step is too large for Newton."""


class NoEquilibrium(RuntimeError):
    """No equilibrium was found under these loads; the rod was left in its last one."""


def mesh(length: float, segments: int, spine: float) -> tuple[Array, Array]:
    """Segment lengths (m) and the share of each segment that a spine of that length (m) covers.

    The node nearest to the spine's end is moved onto it, so that no segment is part spine, part not; segments are
    between 0.5 and 1.5 times the even length. A spine shorter than half a segment covers a share of the first one.
    """
    even = length / segments
    nodes = np.arange(segments + 1) * even
    nearest = min(max(round(spine / even), 1), segments - 1)
    nodes[nearest] = min(max(spine, even / 2), length - even / 2)
    cover = np.zeros(segments)
    cover[:nearest] = 1.0
    if spine < even / 2:
        cover[0] = spine / (even / 2)
    elif spine > length - even / 2:
        cover[-1] = min((spine - nodes[-2]) / (even / 2), 1.0)
    return np.diff(nodes), cover


class ChainRod:
    """Chain and history of one specimen."""

    def __init__(self, h: Array) -> None:
        self.chain: Chain = straight(h)
        self.history: SliderHistory = fresh_history(len(h))
        self._before = (self.chain.r.copy(), self.chain.q.copy())
        self._last_step = math.inf

    def remesh(self, h: Array) -> None:
        """Move the nodes along the present shape to new segment lengths; the memory stays with its segment."""
        if np.array_equal(h, self.chain.h):
            return
        old, new = (np.concatenate([[0.0], np.cumsum(x)]) for x in (self.chain.h, h))
        r = np.stack([np.interp(new, old, self.chain.r[:, i]) for i in range(3)], axis=1)
        q = np.stack([np.interp(new, old, self.chain.q[:, i]) for i in range(4)], axis=1)
        q /= np.linalg.norm(q, axis=1)[:, None]
        self.chain = Chain(np.ascontiguousarray(r), np.ascontiguousarray(q), np.ascontiguousarray(h))
        self._last_step = math.inf

    def relax(self, sections: Sections, loads: ChainLoads, dt: float) -> float:
        """Go to the equilibrium at the end of dt seconds; returns the largest motion (m). Raises `NoEquilibrium`."""
        # the last motion foretells this one when the steps are alike; a contact could be lost by it, so not there
        ratio = math.inf if len(loads.contacts) else dt / self._last_step
        r, q = self._before  # of the step before; `foresee` overwrites them with the shape at the start of this one
        # the last motion is not carried on over a much longer step
        foresee(self.chain, r, q, ratio if ratio < 3.0 else 0.0)
        self._last_step = dt
        iterations = equilibrium(self.chain, sections, self.history, loads)
        if iterations < 0:
            self.chain.r[:], self.chain.q[:] = r, q
            self._last_step = math.inf
            self._reach_in_braked_steps(sections, loads)
        motion = float(np.abs(self.chain.r - r).max())
        commit(self.chain, sections, self.history)
        return motion

    def _reach_in_braked_steps(self, sections: Sections, loads: ChainLoads) -> None:
        """Go to a far equilibrium in steps with a higher viscosity, lowered as they succeed and raised when one fails."""
        state = (self.chain.r, self.chain.q, *self.history)
        begin = [a.copy() for a in state]
        viscosity = FIRST_BRAKE
        for _ in range(80):
            step_start = [a.copy() for a in state]
            last = viscosity < LAST_BRAKE
            step = sections if last else sections._replace(viscosity=max(viscosity, sections.viscosity))
            if equilibrium(self.chain, step, self.history, loads) < 0:
                _put_back(state, step_start)
                viscosity = 5 * max(viscosity, LAST_BRAKE)
            elif last:
                return
            else:
                commit(self.chain, step, self.history)
                viscosity /= 2
        _put_back(state, begin)
        raise NoEquilibrium(
            f"virtual robot: no equilibrium under a tip force of {loads.follower_force[2]:.1f} N and "
            f"{len(loads.contacts)} contacts; lower the chamber pressures or take the probe back"
        )


def _put_back(state: tuple[Array, ...], kept: list[Array]) -> None:
    for array, values in zip(state, kept, strict=True):
        array[:] = values
