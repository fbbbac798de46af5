"""The slow converged reference of the static rod, by SciPy: what the fast solver is checked against.

It shares no code with `model.rods.fast`: another integrator, another state, another Newton method.

Method: shooting from the tip on its orientation (three unknowns), starting from the rod bent by the chambers' moment
alone. Newton at a coarse tolerance brings each rod close, then steps with the Jacobian kept polish it at 1e-11. A rod
that does not converge, or lands on an equilibrium beyond a buckling point, is followed from zero load in steps; what
still fails is flagged and holds NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.solution import Solution, Status, assembled
from model.rotation import from_vector, multiply, to_base, unit
from tests.model.rods.reference_sweep import sweep

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHUNK = 64
"""Rods integrated together: enough to spread the integrator's overhead, few enough that none hides in the RMS error."""
APPROACH, POLISH = 1e-6, 1e-11
"""Relative tolerances of the integrator while approaching and while polishing."""
CLOSE = 1e-3
"""rad, base misalignment from which the kept Jacobian does."""
CONVERGED = 1e-10
"""rad, base misalignment of a solved rod; moves the tip of a 0.4 m rod by well under 1e-9 m."""
NUDGE = 1e-4
"""rad, finite-difference turn of the tip: its truncation error matches the coarse tolerance."""
LONGEST_STEP = 1.0
"""rad, a Newton step is shortened to this."""
LOAD_STEPS = 20
SNAP = 0.8
"""rad, a tip that turns by more within one load step has snapped to another branch."""


@dataclass(frozen=True)
class Reference:
    """SciPy's DOP853 in a shooting method, converged to about 1e-9 m; 0.5 ms a rod in a batch.

    Converged means that the base is turned by less than 1e-10 rad against its place and that no buckling point was passed.
    Raises `BadCondition` for springs, supports and hyperelastic or graded sections, which it does not know, and for a
    start; `SolveFailed` where the integrator gives up.
    """

    def solve(self, rods: Rods, arcs: Array | None = None, start: Solution | None = None) -> Solution:
        """See `model.rods.solver.solve`."""
        rods.refuse_terms("Reference")
        if start is not None:
            raise BadCondition("start: the method Reference starts from the chambers' moment alone; leave it out")
        n = len(rods)
        arcs = np.zeros((n, 0)) if arcs is None else arcs
        tip, status = np.zeros((n, 4)), np.zeros(n, np.int8)
        chunks = [slice(i, i + CHUNK) for i in range(0, n, CHUNK)]
        for rows in chunks:
            tip[rows], status[rows] = _solve_chunk(rods[rows])
        parts = [_swept_solution(rods[rows], tip[rows], status[rows], arcs[rows]) for rows in chunks]
        if not parts:
            return assembled(tip[:, :3], tip, tip[:, :3], tip[:, :3], status, np.zeros((0, arcs.shape[1], 3)))
        values, how, shape = (np.concatenate([getattr(p, k) for p in parts]) for k in ("values", "status", "shape"))
        return Solution(values, how, shape)


REFERENCE = Reference()


def _solve_chunk(batch: Rods) -> tuple[Array, NDArray[np.int8]]:
    """Orientation of the tips (n, 4) and status."""
    tip = _bent_by_chambers(batch)
    tip, jacobian, near = _approach(batch, tip)
    tip, converged = _polish(batch, tip, jacobian, near)
    status = np.where(converged & _unbuckled(jacobian, tip), Status.SOLVED, Status.FAILED).astype(np.int8)
    retry = np.flatnonzero(status != Status.SOLVED)
    if retry.size:
        tip[retry], followed = _follow_load(batch[retry])
        # An equilibrium exists when either way converged, but only the followed one is known to be the rod's own.
        elsewhere = np.where(converged[retry], Status.OTHER_BRANCH, Status.FAILED)
        status[retry] = np.where(followed, Status.SOLVED_IN_STEPS, elsewhere)
    return tip, status


def _bent_by_chambers(batch: Rods) -> Array:
    """Tip orientation (n, 4) under the follower moment alone: each element is bent to a constant curvature."""
    moment = batch.field("tip_moment")[:, None, :]
    curvature = moment / batch.field("bend_stiffness") + batch.field("rest_curvature")
    turn = from_vector(curvature * batch.field("length")[..., None])
    tip = turn[:, 0]
    for e in range(1, batch.form.elements):
        tip = multiply(tip, turn[:, e])
    return tip


def _loaded(batch: Rods, share: float) -> Rods:
    """The same rods under a share (0..1) of all their loads."""
    made = Rods(batch.form, batch.values.copy())
    for name in ("tip_force", "tip_moment", "dead_force", "dead_moment", "load"):
        made.field(name)[:] *= share
    return made


def _misalignment(base_orientation: Array) -> Array:
    """Rotation by which the base misses the identity, (n, 3), equal to the rotation vector (rad) to second order."""
    q = base_orientation * np.where(base_orientation[:, :1] < 0, -1.0, 1.0)
    return 4 * q[:, 1:] / (1 + q[:, :1])


def _approach(batch: Rods, tip: Array, rounds: int = 12) -> tuple[Array, Array, Mask]:
    """Newton with a fresh finite-difference Jacobian each round until the base is `CLOSE` to its place.

    Returns the tip orientation, the last Jacobian (n, 3, 3) and which rods came close.
    """
    n = len(batch)
    tip = tip.copy()
    jacobian = np.tile(np.eye(3), (n, 1, 1))
    near = np.zeros(n, bool)
    nudges = np.concatenate([np.zeros((1, 3)), NUDGE * np.eye(3)])
    for _ in range(rounds):
        open_ = np.flatnonzero(~near)
        if not open_.size:
            break
        turned = multiply(np.repeat(tip[open_], 4, axis=0), from_vector(np.tile(nudges, (open_.size, 1))))
        missed = _misalignment(sweep(batch[np.repeat(open_, 4)], turned, APPROACH).orientation).reshape(-1, 4, 3)
        jacobian[open_] = np.swapaxes((missed[:, 1:] - missed[:, :1]) / NUDGE, 1, 2)
        near[open_] = np.linalg.norm(missed[:, 0], axis=1) < CLOSE
        tip[open_] = _newton_step(tip[open_], jacobian[open_], missed[:, 0])
    return tip, jacobian, near


def _polish(batch: Rods, tip: Array, jacobian: Array, near: Mask, rounds: int = 8) -> tuple[Array, Mask]:
    """Steps with the Jacobian kept, at the tight tolerance; returns the tip orientation and which rods converged."""
    tip = tip.copy()
    converged = np.zeros(len(batch), bool)
    for _ in range(rounds):
        open_ = np.flatnonzero(near & ~converged)
        if not open_.size:
            break
        missed = _misalignment(sweep(batch[open_], tip[open_], POLISH).orientation)
        converged[open_] = np.linalg.norm(missed, axis=1) < CONVERGED
        step = open_[~converged[open_]]
        tip[step] = _newton_step(tip[step], jacobian[step], missed[~converged[open_]])
    return tip, converged


def _newton_step(tip: Array, jacobian: Array, missed: Array) -> Array:
    """Turn the tips (n, 4) by -J^-1 r, shortened to `LONGEST_STEP`."""
    turn = np.empty_like(missed)
    regular = np.abs(np.linalg.det(jacobian)) > 1e-12
    turn[regular] = -np.linalg.solve(jacobian[regular], missed[regular][:, :, None])[:, :, 0]
    turn[~regular] = -missed[~regular]
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    return unit(multiply(tip, from_vector(turn * np.minimum(1.0, LONGEST_STEP / np.maximum(size, LONGEST_STEP)))))


def _unbuckled(jacobian: Array, tip: Array) -> Mask:
    """Which rods lie on the near side of every buckling or snapping point.

    A small turn of the tip, seen in the base frame, turns the base by the same amount when the rod carries no dead
    load: the Jacobian is then the identity. An eigenvalue through zero is a point where equilibria meet.
    Eigenvalues and not the determinant are looked at, because a straight rod buckles in two planes at once.
    """
    seen_from_base = to_base(tip[:, None, :], jacobian)
    return np.linalg.eigvals(seen_from_base).real.min(axis=1) > 0


def _follow_load(batch: Rods) -> tuple[Array, Mask]:
    """Grow all loads from zero in steps; returns tip orientation and which rods stayed on their branch to the end."""
    alive = np.ones(len(batch), bool)
    tip = _bent_by_chambers(_loaded(batch, 0.0))
    jacobian = np.tile(np.eye(3), (len(batch), 1, 1))
    for step in range(1, LOAD_STEPS + 1):
        rows = np.flatnonzero(alive)
        if not rows.size:
            break
        reached, jacobian[rows], near = _approach(_loaded(batch[rows], step / LOAD_STEPS), tip[rows])
        stayed = near & _unbuckled(jacobian[rows], reached) & (angle_between(reached, tip[rows]) < SNAP)
        tip[rows] = reached
        alive[rows] = stayed
    return _polish(batch, tip, jacobian, alive)


def _swept_solution(batch: Rods, tip: Array, status: NDArray[np.int8], arcs: Array) -> Solution:
    """Sweep once more at the tip orientations found, and see all from the base."""
    swept = sweep(batch, tip, POLISH, arcs)
    orientation = np.where(tip[:, :1] < 0, -tip, tip)
    force, moment = (to_base(swept.orientation, x) for x in (swept.force, swept.moment))
    return assembled(-swept.position, orientation, force, moment, status, swept.shape - swept.position[:, None, :])


def angle_between(a: Array, b: Array) -> Array:
    """Angle (...) in rad, 0..pi, of the rotation that takes a to b."""
    return 2 * np.arccos(np.clip(np.abs(np.sum(a * b, axis=-1)), 0, 1))
