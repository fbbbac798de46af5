"""The slow converged reference of the static rod, by SciPy: what the fast solver is checked against.

It shares no code with `model.statics`: another integrator, another state, another Newton method.

Method: shooting from the tip on its orientation (three unknowns), starting from the rod bent by the chambers' moment
alone. Newton at a loose tolerance brings each rod close, then steps with the Jacobian kept polish it at 1e-11. A rod
that does not converge, or lands on an equilibrium beyond a buckling point, is followed from zero load in steps; what
still fails is flagged and holds NaN.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.batch import INNER, OUTER, RodBatch, RodResult, Status
from model.condition import Condition
from model.errors import BadCondition
from model.integrate import sweep
from model.robot import Robot
from model.rotation import angle_between, from_vector, multiply, to_base, unit
from model.section import rods

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CHUNK = 64
"""Rods integrated together: enough to spread the integrator's overhead, few enough that none hides in the RMS error."""
LOOSE, TIGHT = 1e-6, 1e-11
"""Relative tolerances of the integrator while approaching and while polishing."""
CLOSE = 1e-3
"""rad, base misalignment from which the kept Jacobian does."""
CONVERGED = 1e-10
"""rad, base misalignment of a solved rod; moves the tip of a 0.4 m rod by well under 1e-9 m."""
NUDGE = 1e-4
"""rad, finite-difference turn of the tip: its truncation error matches the loose tolerance."""
LONGEST_STEP = 1.0
"""rad, a Newton step is shortened to this."""
LOAD_STEPS = 20
SNAP = 0.8
"""rad, a tip that turns by more within one load step has snapped to another branch."""


def solve(robot: Robot, condition: Condition, arc_lengths: ArrayLike = ()) -> RodResult:
    """Equilibrium of every state; `arc_lengths` (k,) in m get positions in `shape`.

    A state without trusted equilibrium is flagged in `status`. Raises `BadCondition` when the states do not fit the
    robot.
    """
    arcs = np.asarray(arc_lengths, float).reshape(-1)
    if arcs.size and not (np.isfinite(arcs).all() and arcs.min() >= 0 and arcs.max() <= robot.length * (1 + 1e-9)):
        raise BadCondition(f"arc_lengths: {arcs} m must lie between 0 and the robot's length {robot.length:g} m")
    return solve_rods(rods(robot, condition), arcs)


def solve_rods(batch: RodBatch, arc_lengths: Array | None = None) -> RodResult:
    """Equilibrium of every rod of a batch; see `solve`."""
    arcs = np.zeros(0) if arc_lengths is None else arc_lengths
    chunks = [_solve_chunk(batch.take(slice(i, i + CHUNK)), arcs) for i in range(0, len(batch), CHUNK)]
    if not chunks:
        return _gathered(batch, np.zeros((0, 4)), np.zeros(0, np.int8), arcs)
    return RodResult(
        tip=np.concatenate([c.tip for c in chunks]),
        orientation=np.concatenate([c.orientation for c in chunks]),
        base_force=np.concatenate([c.base_force for c in chunks]),
        base_moment=np.concatenate([c.base_moment for c in chunks]),
        status=np.concatenate([c.status for c in chunks]),
        shape=np.concatenate([c.shape for c in chunks]),
    )


def _solve_chunk(batch: RodBatch, arcs: Array) -> RodResult:
    tip = _bent_by_chambers(batch)
    tip, jacobian, near = _approach(batch, tip)
    tip, converged = _polish(batch, tip, jacobian, near)
    status = np.where(converged & _unbuckled(jacobian, tip), Status.SOLVED, Status.FAILED).astype(np.int8)
    retry = np.flatnonzero(status != Status.SOLVED)
    if retry.size:
        tip[retry], followed = _follow_load(batch.take(retry))
        # An equilibrium exists when either way converged, but only the followed one is known to be the rod's own.
        elsewhere = np.where(converged[retry], Status.OTHER_BRANCH, Status.FAILED)
        status[retry] = np.where(followed, Status.SOLVED_IN_STEPS, elsewhere)
    return _gathered(batch, tip, status, arcs)


def _bent_by_chambers(batch: RodBatch) -> Array:
    """Tip orientation (n, 4) under the tip moment alone: each part is bent to a constant curvature."""
    curvature = batch.tip_moment[:, None, :] / batch.bend_stiffness + batch.rest_curvature[:, None, :]
    inner = from_vector(curvature[:, INNER] * batch.joint[:, None])
    outer = from_vector(curvature[:, OUTER] * (batch.length - batch.joint)[:, None])
    return multiply(inner, outer)


def _misalignment(base_orientation: Array) -> Array:
    """Rotation by which the base misses the identity, (n, 3), equal to the rotation vector (rad) to second order."""
    q = base_orientation * np.where(base_orientation[:, :1] < 0, -1.0, 1.0)
    return 4 * q[:, 1:] / (1 + q[:, :1])


def _approach(batch: RodBatch, tip: Array, rounds: int = 12) -> tuple[Array, Array, Mask]:
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
        missed = _misalignment(sweep(batch.take(np.repeat(open_, 4)), turned, LOOSE).orientation).reshape(-1, 4, 3)
        jacobian[open_] = np.swapaxes((missed[:, 1:] - missed[:, :1]) / NUDGE, 1, 2)
        near[open_] = np.linalg.norm(missed[:, 0], axis=1) < CLOSE
        tip[open_] = _newton_step(tip[open_], jacobian[open_], missed[:, 0])
    return tip, jacobian, near


def _polish(batch: RodBatch, tip: Array, jacobian: Array, near: Mask, rounds: int = 8) -> tuple[Array, Mask]:
    """Steps with the Jacobian kept, at the tight tolerance; returns the tip orientation and which rods converged."""
    tip = tip.copy()
    converged = np.zeros(len(batch), bool)
    for _ in range(rounds):
        open_ = np.flatnonzero(near & ~converged)
        if not open_.size:
            break
        missed = _misalignment(sweep(batch.take(open_), tip[open_], TIGHT).orientation)
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


def _follow_load(batch: RodBatch) -> tuple[Array, Mask]:
    """Grow all loads from zero in steps; returns tip orientation and which rods stayed on their branch to the end."""
    alive = np.ones(len(batch), bool)
    tip = _bent_by_chambers(batch.loaded(0.0))
    jacobian = np.tile(np.eye(3), (len(batch), 1, 1))
    for step in range(1, LOAD_STEPS + 1):
        rows = np.flatnonzero(alive)
        if not rows.size:
            break
        reached, jacobian[rows], near = _approach(batch.take(rows).loaded(step / LOAD_STEPS), tip[rows])
        stayed = near & _unbuckled(jacobian[rows], reached) & (angle_between(reached, tip[rows]) < SNAP)
        tip[rows] = reached
        alive[rows] = stayed
    return _polish(batch, tip, jacobian, alive)


def _gathered(batch: RodBatch, tip: Array, status: NDArray[np.int8], arcs: Array) -> RodResult:
    """Sweep once more at the solution, seen from the base; rods that were not solved become NaN."""
    n = len(batch)
    if n == 0:
        return RodResult(np.zeros((0, 3)), tip, np.zeros((0, 3)), np.zeros((0, 3)), status, np.zeros((0, arcs.size, 3)))
    swept = sweep(batch, tip, TIGHT, arcs)
    lost = status > Status.SOLVED_IN_STEPS
    orientation = np.where(tip[:, :1] < 0, -tip, tip)
    shape = swept.shape - swept.position[:, None, :]
    force, moment = (to_base(swept.orientation, x) for x in (swept.force, swept.moment))
    results = [-swept.position, orientation, force, moment, shape]
    for values in results:
        values[lost] = np.nan
    return RodResult(results[0], results[1], results[2], results[3], status, results[4])
