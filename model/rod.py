"""The converged static Cosserat rod: tip, orientation and shape of any number of states of a robot.

    from model.rod import solve
    result = solve(robot, conditions(robot, spine_length=0.1, pressure=[...]))
    result.tip, result.orientation, result.ok

The work is done by `model.statics`; here robots and conditions become its rods, solved to 1e-5 mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model import statics
from model.batch import RodBatch, RodResult
from model.condition import Condition
from model.errors import BadCondition
from model.robot import Robot
from model.section import rods

Array = NDArray[np.float64]


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
    found = as_rods(batch)
    solution = statics.solve(found, statics.FINE)
    shape = np.zeros((len(batch), 0, 3))
    if arc_lengths is not None and arc_lengths.size:
        # An arc length may be beyond a rod's end by rounding.
        arcs = np.minimum(arc_lengths[None, :], found.whole_length[:, None])
        shape = statics.stations(found, solution, arcs, statics.FINE).position
    return RodResult(
        tip=solution.tip,
        orientation=solution.orientation,
        base_force=solution.base_force,
        base_moment=solution.base_moment,
        status=solution.status,
        shape=shape,
    )


def as_rods(batch: RodBatch) -> statics.Rods:
    """The batch as rods of two elements: base to joint, joint to tip."""
    made = statics.blank(statics.Form(elements=2), len(batch))
    made.field("length")[:] = np.stack([batch.joint, np.maximum(batch.length - batch.joint, 0.0)], axis=1)
    made.field("stretch_stiffness")[:] = batch.stretch_stiffness
    made.field("bend_stiffness")[:] = batch.bend_stiffness
    made.field("load")[:] = batch.weight[:, None, :]
    made.field("rest_curvature")[:] = batch.rest_curvature[:, None, :]
    made.field("tip_force")[:] = batch.tip_force
    made.field("tip_moment")[:] = batch.tip_moment
    made.field("dead_force")[:] = batch.dead_force
    return made.check()
