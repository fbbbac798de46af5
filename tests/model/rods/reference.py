"""The slow converged reference of the static rod, by SciPy: what the fast solver is checked against.

It shares no code with `model.rods.fast`. Each rod is shot from its tip, where the loads are known and only the orientation is
not, to its base, whose orientation must be the identity: forces only turn and collect weight on the way. Newton at a coarse
tolerance brings each rod close, then steps with the Jacobian kept polish it at 1e-11. A rod that does not converge, or lands on
an equilibrium beyond a buckling point, is followed from zero load in steps; what still fails holds NaN.

Equations 1 and 2 of the paper in the body frame, arc length s, n and m turning with it:

    p' = R v,  q' = q (0, u) / 2,  n' = -u x n - R^T f,  m' = -u x m - v x n,  v = n / K_se + e3,  u = m / K_bt + u*
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from model.arrays import Array, Mask
from model.errors import BadCondition, SolveFailed
from model.rods.description import Rods
from model.rods.solution import Solution, Status, assembled
from model.rotation import cross, from_vector, multiply, to_base, unit

CHUNK = 64
"""Rods integrated together: enough to spread the integrator's overhead, few enough that none hides in the RMS error."""
APPROACH, POLISH = 1e-6, 1e-11
"""Relative tolerances of the integrator."""
CLOSE, CONVERGED = 1e-3, 1e-10
"""rad, base misalignment below which the kept Jacobian does, and that of a solved rod."""
NUDGE = 1e-4
"""rad, finite-difference turn of the tip: its truncation error matches the coarse tolerance."""
LONGEST_STEP, SNAP = 1.0, 0.8
"""rad, a Newton step is shortened to this; a tip that turns by more within one load step has snapped to another branch."""
LOAD_STEPS = 20


@dataclass(frozen=True)
class Reference:
    """SciPy's DOP853 in a shooting method, converged to about 1e-9 m, as a method of `model.rods.solve`."""

    def solve(self, rods: Rods, arcs: Array | None = None, start: Solution | None = None) -> Solution:
        """See `model.rods.solver.solve`."""
        rods.refuse_terms("Reference")
        if start is not None:
            raise BadCondition("start: the method Reference starts from the chambers' moment alone; leave it out")
        n = len(rods)
        arcs = np.zeros((n, 0)) if arcs is None else arcs
        tip, status, base, shape = np.zeros((n, 4)), np.zeros(n, np.int8), np.zeros((n, 13)), np.zeros((*arcs.shape, 3))
        for i in range(0, n, CHUNK):
            own = slice(i, i + CHUNK)
            tip[own], status[own] = _solve_chunk(rods[own])
            base[own], shape[own] = _sweep(rods[own], tip[own], POLISH, arcs[own])
        tip = np.where(tip[:, :1] < 0, -tip, tip)
        force, moment = (to_base(base[:, 3:7], part) for part in (base[:, 7:10], base[:, 10:]))
        return assembled(-base[:, :3], tip, force, moment, status, shape - base[:, None, :3])


REFERENCE = Reference()


def _sweep(rods: Rods, tip: Array, tolerance: float, arcs: Array | None = None) -> tuple[Array, Array]:
    """Integrate from tips at the origin with orientations (n, 4): p, q, n, m at the base (n, 13), places at arcs (n, k, 3)."""
    state = np.hstack([
        np.zeros((len(rods), 3)), tip,
        rods.field("tip_force") + _to_local(tip, rods.field("dead_force")),
        rods.field("tip_moment") + _to_local(tip, rods.field("dead_moment")),
    ])  # fmt: skip
    arcs = np.zeros((len(rods), 0)) if arcs is None else arcs
    shape, top = np.zeros((*arcs.shape, 3)), rods.whole_length
    for e in reversed(range(rods.form.elements)):
        names = ("length", "stretch_stiffness", "bend_stiffness", "load", "rest_curvature")
        fields = [rods.field(name)[:, e] for name in names]
        found = solve_ivp(
            _slope, (0.0, 1.0), state.ravel(), "DOP853", rtol=tolerance, atol=0.01 * tolerance, args=fields, dense_output=True
        )
        if not found.success:
            raise SolveFailed(f"integration along the rod stopped: {found.message}; check stiffness and loads")
        state, share = found.y[:, -1].reshape(-1, 13), (top[:, None] - arcs) / np.maximum(fields[0], 1e-300)[:, None]
        for i, k in np.argwhere((share >= 0) & (share <= 1 + 1e-12)):
            shape[i, k] = found.sol(share[i, k]).reshape(-1, 13)[i, :3]
        top = top - fields[0]
    return state, shape


def _slope(_: float, flat: Array, length: Array, stretch: Array, bend: Array, load: Array, rest: Array) -> Array:
    """d(state) / d(share of the element travelled towards the base) of all rods."""
    state = flat.reshape(-1, 13)
    q, n, m = state[:, 3:7], state[:, 7:10], state[:, 10:]
    v, u = n / stretch + (0.0, 0.0, 1.0), m / bend + rest
    turned = 0.5 * multiply(q, np.hstack([np.zeros((len(u), 1)), u]))
    slope = np.hstack([to_base(q, v), turned, -cross(u, n) - _to_local(q, load), -cross(u, m) - cross(v, n)])
    return (-length[:, None] * slope).ravel()


def _to_local(q: Array, vector: Array) -> Array:
    """R(q)^T v: base-frame vectors (..., 3) in the frame of q (..., 4)."""
    return to_base(q * (1.0, -1.0, -1.0, -1.0), vector)


def _solve_chunk(batch: Rods) -> tuple[Array, NDArray[np.int8]]:
    """Orientation of the tips (n, 4) and status."""
    tip, jacobian, near = _approach(batch, _bent_by_chambers(batch))
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
    curvature = batch.field("tip_moment")[:, None, :] / batch.field("bend_stiffness") + batch.field("rest_curvature")
    turn = from_vector(curvature * batch.field("length")[..., None])
    tip = turn[:, 0]
    for e in range(1, batch.form.elements):
        tip = multiply(tip, turn[:, e])
    return tip


def _missed(batch: Rods, tip: Array, tolerance: float) -> Array:
    """Rotation by which the base misses the identity, (n, 3), equal to the rotation vector (rad) to second order."""
    q = _sweep(batch, tip, tolerance)[0][:, 3:7]
    q = q * np.where(q[:, :1] < 0, -1.0, 1.0)
    return 4 * q[:, 1:] / (1 + q[:, :1])


def _approach(batch: Rods, tip: Array, rounds: int = 12) -> tuple[Array, Array, Mask]:
    """Newton with a fresh finite-difference Jacobian each round: tip orientations, last Jacobians (n, 3, 3), which came close."""
    n, tip = len(batch), tip.copy()
    jacobian, near = np.tile(np.eye(3), (n, 1, 1)), np.zeros(n, bool)
    nudges = from_vector(np.concatenate([np.zeros((1, 3)), NUDGE * np.eye(3)]))
    for _ in range(rounds):
        open_ = np.flatnonzero(~near)
        if not open_.size:
            break
        turned = multiply(np.repeat(tip[open_], 4, axis=0), np.tile(nudges, (open_.size, 1)))
        missed = _missed(batch[np.repeat(open_, 4)], turned, APPROACH).reshape(-1, 4, 3)
        jacobian[open_] = np.swapaxes((missed[:, 1:] - missed[:, :1]) / NUDGE, 1, 2)
        near[open_] = np.linalg.norm(missed[:, 0], axis=1) < CLOSE
        tip[open_] = _newton_step(tip[open_], jacobian[open_], missed[:, 0])
    return tip, jacobian, near


def _polish(batch: Rods, tip: Array, jacobian: Array, near: Mask, rounds: int = 8) -> tuple[Array, Mask]:
    """Steps with the Jacobian kept, at the tight tolerance; returns the tip orientation and which rods converged."""
    tip, converged = tip.copy(), np.zeros(len(batch), bool)
    for _ in range(rounds):
        open_ = np.flatnonzero(near & ~converged)
        if not open_.size:
            break
        missed = _missed(batch[open_], tip[open_], POLISH)
        converged[open_] = done = np.linalg.norm(missed, axis=1) < CONVERGED
        step = open_[~done]
        tip[step] = _newton_step(tip[step], jacobian[step], missed[~done])
    return tip, converged


def _newton_step(tip: Array, jacobian: Array, missed: Array) -> Array:
    """Turn the tips (n, 4) by -J^-1 r, shortened to `LONGEST_STEP`."""
    turn, regular = -missed, np.abs(np.linalg.det(jacobian)) > 1e-12
    turn[regular] = np.linalg.solve(jacobian[regular], turn[regular][:, :, None])[:, :, 0]
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    return unit(multiply(tip, from_vector(turn * np.minimum(1.0, LONGEST_STEP / np.maximum(size, LONGEST_STEP)))))


def _unbuckled(jacobian: Array, tip: Array) -> Mask:
    """Which rods lie on the near side of every buckling or snapping point.

    A small turn of the tip, seen in the base frame, turns the base by the same amount when the rod carries no dead load: the
    Jacobian is then the identity. An eigenvalue through zero is a point where equilibria meet; not the determinant, because a
    straight rod buckles in two planes at once.
    """
    return np.linalg.eigvals(to_base(tip[:, None, :], jacobian)).real.min(axis=1) > 0


def _follow_load(batch: Rods) -> tuple[Array, Mask]:
    """Grow all loads from zero in steps; returns tip orientation and which rods stayed on their branch to the end."""

    def loaded(rows: object, share: float) -> Rods:
        made = Rods(batch.form, batch[rows].values.copy())
        for name in ("tip_force", "tip_moment", "dead_force", "dead_moment", "load"):
            made.field(name)[:] *= share
        return made

    alive, jacobian = np.ones(len(batch), bool), np.tile(np.eye(3), (len(batch), 1, 1))
    tip = _bent_by_chambers(loaded(slice(None), 0.0))
    for step in range(1, LOAD_STEPS + 1):
        rows = np.flatnonzero(alive)
        if not rows.size:
            break
        reached, jacobian[rows], near = _approach(loaded(rows, step / LOAD_STEPS), tip[rows])
        turned = 2 * np.arccos(np.clip(np.abs(np.sum(reached * tip[rows], axis=-1)), 0, 1))
        alive[rows] = near & _unbuckled(jacobian[rows], reached) & (turned < SNAP)
        tip[rows] = reached
    return _polish(batch, tip, jacobian, alive)
