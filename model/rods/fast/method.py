"""The fast method: every rod is first solved directly. Where that does not converge, or converges near or beyond a buckling
point, the load is followed from zero; what snaps on the way is flagged and holds NaN."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.arrays import Array, Ints, Mask
from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.fast import direct
from model.rods.fast.compiler import inline, kernel
from model.rods.fast.direct import exchange, write_result
from model.rods.fast.group import ROD, Rod, RodGroup, cut, gather, new_group
from model.rods.fast.lanes import LANES, copy, new_numbers
from model.rods.fast.newton import buckling_margin, correct, difference_jacobian, expected_residual, first_guess, improve
from model.rods.fast.passes import WHOLE, evaluate
from model.rods.fast.walk import AT_PLACE, states_at
from model.rods.solution import AT_LARGEST, AT_MARGIN, AT_RESIDUAL, RESULT, Solution, Status
from model.rotation import from_vector, to_base

FIRST_STEP, LEAST_STEP = 0.1, 1e-4
"""Share of the load."""
MOST_TRIES = 300
ROUNDS, QUICK_ROUNDS = 6, 3
"""The most of a step of load, and those after which the next one may be twice as large."""
FARTHEST = 0.35
"""rad: a tip that turns by more within one step may have changed branch."""
STRAIGHT = 1e-6
"""rad: a rod that bends by less is straight."""
_NO_STEPS = np.zeros((0, 1), np.int64)


@kernel
def follow_load(
    rods: Array, springs: int, settings: tuple[float, float, float], rows: Ints, memory: Array, out: Array, reached: Mask
) -> None:
    """Load the rods listed in `rows` from zero and write their rows of `out` and of `memory` (n or 0 rows), from which a solve
    nearby then starts; `reached[i]` says whether all of its load was followed.

    Each step starts from the last equilibrium with a fresh Jacobian, and counts only when the new equilibrium is close by and
    still on the near side of buckling; otherwise it is halved. What cannot be passed that way is a fold or a branching point:
    there the rod snaps, and the last share of the load is the answer.

    `settings` are divisions, close and the least margin to buckling. A rod that is lost holds its last equilibrium and the
    share of load it belongs to.
    """
    divisions, close, least_margin = settings
    room = new_group(rods, springs, ROD)
    group = RodGroup(room.work, room.elements, room.parts, springs, room.linear, 1)
    kept = new_numbers(ROD * LANES)
    for i in range(rows.shape[0]):
        row = rows[i]
        gather(rods, group, row)
        rod, saved = Rod(room.work, 0), Rod(kept, 0)
        rod.largest_moment = out[row, AT_LARGEST]
        cut(group, divisions)
        rod.load_share = 0.0
        first_guess(group)
        difference_jacobian(group)
        share, step = 0.0, FIRST_STEP
        tries = 0
        while share < 1.0 and step >= LEAST_STEP and tries < MOST_TRIES:
            tries += 1
            copy(rod, saved, ROD)
            rod.load_share = min(1.0, share + step)
            evaluate(group, group.springs, WHOLE)
            rounds = improve(group, close, ROUNDS)
            if expected_residual(rod) < close and turned_by(rod, saved) < FARTHEST:
                difference_jacobian(group)
                if buckling_margin(rod, group.springs) > least_margin:
                    share = rod.load_share
                    if rounds <= QUICK_ROUNDS:
                        step *= 2.0
                    continue
            copy(saved, rod, ROD)
            step *= 0.5
        rod.load_share = share
        evaluate(group, group.springs, WHOLE)
        correct(group)
        write_result(rod, group.springs, out, row)
        if memory.shape[0] > 0:
            exchange(rod, group.springs, memory, row, True)
        reached[i] = share >= 1.0


@inline
def turned_by(rod: Rod, saved: Rod) -> float:
    """Angle (rad) between the tip's orientation now and when it was saved."""
    q, p = rod.tip.turn, saved.tip.turn
    return 2.0 * math.acos(min(1.0, abs(q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3])))


LEAST_MARGIN = 0.5
"""A direct solution with less margin to buckling is not trusted before its load was followed."""
_NO_MEMORY = np.zeros((0, direct.MEMORY))


@dataclass(frozen=True, eq=False)
class Fast:
    """Shooting from the tip on its orientation, sixth-order steps, Newton with Broyden's updates, sixteen rods at a time.

    Knows every field of `Rods`. Converged means that the base misses its pose by less than `close` and that the margin to
    buckling is above `least_margin` (LEAST_MARGIN where a start misled and the rod was solved from nothing), or that the load
    was followed from zero. Raises `BadCondition` for numbers out of range and for `steps` or a start that do not fit the rods.
    """

    divisions: float = 4.0
    """Integration steps along a whole rod that is not strongly bent; the error falls with the sixth power."""
    close: float = 2e-6
    """What may be left of the base's residual (rad, lengths) after the last correction."""
    least_margin: float = LEAST_MARGIN
    """Rods with less margin to buckling are loaded in steps from zero; one that starts near a trusted solution may have
    less."""
    steps: Ints | None = None
    """(n, elements) fixes the integration steps, so that solutions are smooth in all parameters."""
    remember: bool = False
    """Keep what a later solve of nearly the same rods can start from, which about halves its time."""
    follow: bool = True
    """Whether a rod that this leaves open is loaded in steps from zero, at a thousand times the cost; else it has FAILED."""
    cores: int = 1
    """Threads that the rods are shared out to."""

    def __post_init__(self) -> None:
        if not 1 <= self.divisions <= 1000:
            raise BadCondition(f"divisions: {self.divisions}, must be from 1 to 1000")
        if not 1e-14 <= self.close <= 1e-2:
            raise BadCondition(f"close: {self.close} rad, must be from 1e-14 to 0.01")
        if self.cores < 1:
            raise BadCondition(f"cores: {self.cores}, must be at least 1")

    def solve(self, rods: Rods, arcs: Array | None = None, start: Solution | None = None) -> Solution:
        """See `model.rods.solver.solve`."""
        n, form = len(rods), rods.form
        memory = np.empty((n, direct.memory_of(form.springs))) if self.remember else _NO_MEMORY
        if start is not None:
            if start.memory.shape != (n, direct.memory_of(form.springs)):
                raise BadCondition("start: must be a solution of as many rods of the same form, made with Fast(remember=True)")
            memory = start.memory.copy()
        fixed = steps_of(rods, self.steps)
        values = self._direct(rods, fixed, memory, start is not None)
        converged = (values[:, AT_RESIDUAL] < self.close) & (values[:, AT_MARGIN] > self.least_margin)
        if start is None:
            converged &= ~_may_snap(rods, values)
        if start is not None and not converged.all():
            # Far from its start the Jacobian from there may mislead; what a solve from nothing finds and trusts is as good.
            again = np.flatnonzero(~converged)
            memory_anew = memory[again]
            anew = self._direct(rods[again], fixed[again] if len(fixed) else fixed, memory_anew, False)
            trusted = (anew[:, AT_RESIDUAL] < self.close) & (anew[:, AT_MARGIN] > LEAST_MARGIN) & ~_may_snap(rods[again], anew)
            values[again[trusted]], memory[again[trusted]] = anew[trusted], memory_anew[trusted]
            converged[again[trusted]] = True
        status = np.zeros(n, np.int8)
        if self.follow and not converged.all():
            self._follow(rods, np.flatnonzero(~converged), memory, values, status)
        elif not converged.all():
            status[~converged], values[~converged, :AT_RESIDUAL] = Status.FAILED, np.nan
        found = Solution(values, status, np.zeros((n, 0, 3)), memory)
        if arcs is None:
            return found
        place = states_at(rods, found, arcs, self.divisions, fixed)[..., AT_PLACE : AT_PLACE + 3]
        return Solution(values, status, place, memory)

    def _direct(self, rods: Rods, fixed: Ints, memory: Array, warm: bool) -> Array:
        """Results (n, RESULT) of the direct solve, from `memory` (n or 0 rows) or from nothing; it writes the memory."""
        n, form = len(rods), rods.form
        values = np.empty((n, RESULT))
        settings = (float(self.divisions), float(self.close), warm)

        def part(rows: slice) -> None:
            direct.solve_direct(rods.values[rows], form.springs, settings, fixed[rows], memory[rows], values[rows])

        share_out(part, n, self.cores)
        return values

    def _follow(self, rods: Rods, doubtful: NDArray[np.intp], memory: Array, values: Array, status: NDArray[np.int8]) -> None:
        """Settle the rods that the direct solve left open."""
        found = values[doubtful, AT_RESIDUAL] < self.close
        reached = np.zeros(len(doubtful), np.bool_)
        # Near buckling small errors grow. Rounding lets a rod reach 1e-11 in any case; with a margin below 1e-3 it snaps.
        settings = (2.0 * self.divisions, max(0.01 * self.close, 1e-11), 1e-3)

        def part(rows: slice) -> None:
            follow_load(rods.values, rods.form.springs, settings, doubtful[rows], memory, values, reached[rows])

        share_out(part, len(doubtful), self.cores)
        lost = np.where(found, Status.OTHER_BRANCH, Status.FAILED)
        status[doubtful] = np.where(reached, Status.SOLVED_IN_STEPS, lost)
        values[doubtful[~reached], :AT_RESIDUAL] = np.nan


def steps_of(rods: Rods, steps: Ints | None) -> Ints:
    """Fixed steps as the kernels take them, none as no rows; raises `BadCondition` when they do not fit the rods."""
    if steps is None:
        return _NO_STEPS
    if steps.shape != (len(rods), rods.form.elements) or steps.dtype != np.int64 or (steps < 1).any():
        raise BadCondition(f"steps: shape {steps.shape} of {steps.dtype}, must be positive int64 for each element")
    return np.ascontiguousarray(steps)


def share_out(part: Callable[[slice], None], n: int, cores: int) -> None:
    """Call `part` on slices that cover n rows, on `cores` threads (kernels release the interpreter lock)."""
    if cores == 1 or n < 2 * LANES:
        part(slice(0, n))
        return
    edges = np.linspace(0, -(-n // LANES), cores + 1).astype(int) * LANES
    slices = [slice(int(a), min(int(b), n)) for a, b in zip(edges[:-1], edges[1:], strict=True) if a < n]
    with ThreadPoolExecutor(len(slices)) as pool:
        list(pool.map(part, slices))


def _may_snap(rods: Rods, values: Array) -> Mask:
    """(n,) whether dead loads that could buckle the rod, P L^2 / EI > pi^2 / 4, may press on a part of it, by the angle between
    base and load and the largest moment (`values`): then several equilibria may be stable, and growing loads lead to one. They
    lead to the straight one where nothing bends the rod."""
    length, tangent = rods.field("length"), to_base(from_vector(rods.field("base_turn")), np.array([0.0, 0.0, 1.0]))
    weight = np.concatenate([rods.field("dead_force")[:, None], rods.field("load") * length[..., None]], axis=1)
    half = np.array([1.0] + [0.5] * length.shape[1])
    thrust, pull = np.linalg.norm(weight, axis=2) @ half, weight.sum(axis=1)
    soft = np.where(length > 0, rods.whole_length[:, None] / rods.field("bend_stiffness")[..., :2].min(axis=2), 0.0).max(axis=1)
    aside = np.arccos(np.clip((tangent * pull).sum(axis=1) / np.maximum(np.linalg.norm(pull, axis=1), 1e-300), -1.0, 1.0))
    bend = np.nan_to_num(values[:, AT_LARGEST], posinf=0.0) * soft  # rods that diverged have not converged
    return (thrust * rods.whole_length * soft > np.pi**2 / 4) & (aside + bend > np.pi / 2) & (bend > STRAIGHT)


FAST = Fast()
"""Within 0.01 mm for a rod of 0.4 m."""
FINE = Fast(divisions=20.0, close=1e-11)
"""Within 1e-5 mm for a rod of 0.4 m."""
