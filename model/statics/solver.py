"""Solving rods: the call that everything else makes.

    from model.statics import Form, rods, solve
    batch = rods(Form(elements=2), n, length=..., bend_stiffness=..., stretch_stiffness=..., tip_force=..., ...)
    found = solve(batch)
    found.tip, found.orientation, found.ok

Every rod is first solved directly. Where that does not converge, or converges near or beyond a buckling point, the
load is followed from zero; what snaps on the way is flagged and holds NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model.batch import Status
from model.errors import BadCondition, SolveFailed
from model.statics import group
from model.statics.follow import FOLLOWED, follow_load
from model.statics.problem import Form, Rods

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Accuracy:
    """How finely rods are cut and how well the base must fit."""

    divisions: float
    """Steps along a whole rod that is not strongly bent; the error falls with the sixth power."""
    close: float
    """What may be left of the base's miss (rad, lengths) after the last correction."""

    def __post_init__(self) -> None:
        if not 1 <= self.divisions <= 1000:
            raise BadCondition(f"divisions: {self.divisions}, must be from 1 to 1000")
        if not 1e-14 <= self.close <= 1e-2:
            raise BadCondition(f"close: {self.close} rad, must be from 1e-14 to 0.01")


DEFAULT = Accuracy(divisions=4.0, close=2e-6)
"""Within 0.01 mm for a rod of 0.4 m."""
FINE = Accuracy(divisions=20.0, close=1e-11)
"""Within 1e-5 mm for a rod of 0.4 m."""

LEAST_MARGIN = 0.5
"""A direct solution with less margin to buckling is not trusted before its load was followed."""
FOLLOW_FINER = 2.0
"""Near buckling small errors grow: followed rods get so many times the divisions, and a hundredth of `close`."""
CLOSEST = 1e-11
"""What rounding lets a followed rod reach in any case."""
STOP_MARGIN = 1e-3
"""Following stops with less margin than this: the rod is at the point of snapping."""

Steps = NDArray[np.int64]
_NO_MEMORY, _NO_STEPS = np.zeros((0, group.MEMORY)), np.zeros((0, 1), np.int64)


@dataclass(frozen=True)
class Solution:
    """Equilibria of n rods in the mount frame; rows whose `ok` is False hold NaN up to `base_moment`."""

    values: Array
    """(n, group.RESULT)."""
    status: NDArray[np.int8]
    """(n,) `Status`."""
    memory: Array
    """(n, group.MEMORY or MEMORY_SPRINGS) for warm starts, or no rows."""

    @property
    def tip(self) -> Array:
        """(n, 3) m."""
        return self.values[:, group.AT_TIP : group.AT_TIP + 3]

    @property
    def orientation(self) -> Array:
        """(n, 4) unit quaternion w, x, y, z of the tip frame, w >= 0."""
        return self.values[:, group.AT_ORIENTATION : group.AT_ORIENTATION + 4]

    @property
    def base_force(self) -> Array:
        """(n, 3) N, internal force at the base."""
        return self.values[:, group.AT_FORCE : group.AT_FORCE + 3]

    @property
    def base_moment(self) -> Array:
        """(n, 3) N m, internal moment at the base."""
        return self.values[:, group.AT_MOMENT : group.AT_MOMENT + 3]

    @property
    def margin(self) -> Array:
        """(n,) 1 without dead loads, 0 at buckling."""
        return self.values[:, group.AT_MARGIN]

    @property
    def load_reached(self) -> Array:
        """(n,) share 0..1 of the load up to which the rod's own equilibrium was followed."""
        return self.values[:, group.AT_FRACTION]

    @cached_property
    def ok(self) -> NDArray[np.bool_]:
        """(n,) True where the tip can be trusted."""
        return self.status <= Status.SOLVED_IN_STEPS

    def trusted(self) -> Solution:
        """Itself when every rod was solved; raises `SolveFailed` naming those that were not."""
        bad = np.flatnonzero(~self.ok)
        if bad.size:
            listed = ", ".join(
                f"{i} ({Status(self.status[i]).name} at {self.load_reached[i]:.3g} of the load)" for i in bad[:8]
            )
            raise SolveFailed(
                f"{bad.size} of {len(self.status)} rods have no trusted equilibrium: {listed}"
                f"{', ...' if bad.size > 8 else ''}; lower the load, or check stiffness and length"
            )
        return self


def solve(
    rods: Rods,
    accuracy: Accuracy = DEFAULT,
    *,
    cores: int = 1,
    start: Solution | None = None,
    remember: bool = False,
    steps: Steps | None = None,
    least_margin: float = LEAST_MARGIN,
) -> Solution:
    """Equilibrium of every rod of a checked batch.

    `cores` share the rods out to so many threads. `remember` keeps what a later solve of nearly the same rods can
    start from (`start`), which about halves its time. `steps` (n, elements) fixes the integration steps, so that
    solutions are smooth in all parameters. Rods with less margin to buckling than `least_margin` are loaded in steps
    from zero; one that starts near a trusted solution may have less. The rods are not checked again: `Rods.check` does.
    """
    n, form = len(rods), rods.form
    memory = np.empty((n, group.MEMORY_SPRINGS if form.springs else group.MEMORY)) if remember else _NO_MEMORY
    if start is not None:
        if start.memory.shape != (n, group.MEMORY_SPRINGS if form.springs else group.MEMORY):
            raise BadCondition("start: must be a solution of as many rods of the same form, made with remember=True")
        memory = start.memory.copy()
    fixed = steps_of(rods, steps)
    values = np.empty((n, group.RESULT))

    def part(rows: slice) -> None:
        group.solve_direct(
            rods.values[rows],
            form.head,
            form.block,
            *room_for_terms(form),
            form.springs,
            accuracy.divisions,
            accuracy.close,
            fixed[rows] if len(fixed) else fixed,
            memory[rows] if len(memory) else memory,
            start is not None,
            values[rows],
        )

    share_out(part, n, cores)
    status = np.zeros(n, np.int8)
    good = (values[:, group.AT_MISS] < accuracy.close) & (values[:, group.AT_MARGIN] > least_margin)
    if not good.all():
        _follow(rods, accuracy, np.flatnonzero(~good), values, status, cores)
    return Solution(values, status, memory)


def steps_of(rods: Rods, steps: Steps | None) -> Steps:
    """Fixed steps as the kernels take them, none as no rows; raises `BadCondition` when they do not fit the rods."""
    if steps is None:
        return _NO_STEPS
    if steps.shape != (len(rods), rods.form.elements) or steps.dtype != np.int64 or (steps < 1).any():
        raise BadCondition(f"steps: shape {steps.shape} of {steps.dtype}, must be positive int64 for each element")
    return np.ascontiguousarray(steps)


def room_for_terms(form: Form) -> tuple[Array | None, Array | None]:
    """Arrays for the graded and the hyperelastic terms of one group, None for what rods of this form do not have."""
    if not form.full:
        return None, None
    return np.zeros(9 * form.elements * group.LANES), np.zeros(3 * form.elements * group.LANES)


def share_out(part: Callable[[slice], None], n: int, cores: int) -> None:
    """Call `part` on slices that cover n rows, on `cores` threads (kernels release the interpreter lock)."""
    if cores < 1:
        raise BadCondition(f"cores: {cores}, must be at least 1")
    if cores == 1 or n < 2 * group.LANES:
        part(slice(0, n))
        return
    edges = np.linspace(0, -(-n // group.LANES), cores + 1).astype(int) * group.LANES
    slices = [slice(int(a), min(int(b), n)) for a, b in zip(edges[:-1], edges[1:], strict=True) if a < n]
    with ThreadPoolExecutor(len(slices)) as pool:
        list(pool.map(part, slices))


def _follow(
    rods: Rods, accuracy: Accuracy, doubtful: NDArray[np.intp], values: Array, status: NDArray[np.int8], cores: int
) -> None:
    """Settle the rods that the direct solve left open."""
    form = rods.form
    found = values[doubtful, group.AT_MISS] < accuracy.close
    reached = np.zeros(len(doubtful), np.int8)

    def part(rows: slice) -> None:
        follow_load(
            rods.values,
            form.head,
            form.block,
            *room_for_terms(form),
            form.springs,
            FOLLOW_FINER * accuracy.divisions,
            max(0.01 * accuracy.close, CLOSEST),
            doubtful[rows],
            STOP_MARGIN,
            values,
            reached[rows],
        )

    share_out(part, len(doubtful), cores)
    followed = reached == FOLLOWED
    status[doubtful] = np.where(followed, Status.SOLVED_IN_STEPS, np.where(found, Status.OTHER_BRANCH, Status.FAILED))
    values[doubtful[~followed], : group.AT_MISS] = np.nan
