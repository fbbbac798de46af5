"""Edits of a whole table: columns with another quantity, swapped points, and points along other axes.

A map may move a robot at rest to its model (`straight`), so axes are also swapped about the places at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import permutations, product

import numpy as np
import scipy

from model.rotation import CONJUGATE, multiply
from recordings.trials import Mapped, Table

from ..arrays import Array, Mask
from ..data.plausible import METRES, PASCALS
from ..remedies import heading, named, of_columns, of_unit
from .edit import Edit, Variants, mistake, stating, times
from .listed import FRAMES, MIRROR, NO_TURN, axes_say, gravity_along, gravity_says
from .misfit import AMBIENT, Fit, Sample

AT_REST = 0.03
"""Share of the range of pressures above the lowest within which a robot is at rest."""
LEAST_MOTION = 0.005
"""Robot lengths (sd) that readings must move along an axis, in the unit that is read off: of one that rests, none is right."""
PLAINEST = 0.02
"""Share of the likeness that an axis of a frame counts where it stays as it is: who bends little does not show them all."""


def of_table(sample: Sample, near: Fit) -> Iterator[Edit]:
    """The edits that this table can have."""
    table, robot = sample.table, sample.robot
    says = stating("displacements", "columns x, y, z", length=robot.length)
    yield Edit("origin", 0.01, says, lambda v, _: v.moved(np.full((len(v.tip), 1, 3), (0.0, 0.0, v.robot.length))))
    number, given, unit = "youngs_modulus", robot.youngs_modulus / 1e3, "kPa"
    if robot.bending_stiffness:
        number, given, unit = "bending_stiffness", robot.bending_stiffness, "N m^2"
    for factor in (1e-3, 1e3):
        says = stating("refitted", number, name=number, given=given, found=factor * given, unit=unit, limit="")
        yield Edit("modulus", 0.01, says, times(factor, "modulus"))
    for unit, size in PASCALS.items() if robot.chambers is not None else ():
        if AMBIENT[0] < (ambient := float(table.pressures.min() * size)) < AMBIENT[1]:
            remedy, short = of_unit(table.mapped, robot, unit), "gauge or absolute pressures"
            in_unit = [mistake("pressures_in_unit", short, factor=size, looks=unit, remedy=remedy)] * (unit != "Pa")
            says = stating("pressures_absolute", short, *in_unit, ambient=ambient)
            apply = partial(lambda size, ambient, v, _: replace(v, pressure=v.pressure * size - ambient), size, ambient)
            yield Edit("zero", 0.01 if in_unit else 0.03, says, apply)
    rest = at_rest(table)
    yield from _gravity_about_rest(sample, rest)
    markers = sample.described.markers.shape[2]
    for k in range(markers):
        says = stating("points_exchanged", "tip and markers", number=k + 1)
        for about_rest in (True, False):
            yield Edit("points", 0.02 / markers, says, partial(_exchanged, k, about_rest))
    rods, every = sample.rods(sample.edited([((), near.x[None])])), tuple(range(1 + markers))
    seen = (v.tip[0][np.isfinite(v.tip[0]).all(axis=1)] for v in (sample.described, sample.rods(sample.described), rods))
    moves, *able = (tip.std(axis=0) if len(tip) else np.zeros(3) for tip in seen)  # no rod may stand
    columns = [(axis, of[-1]) for axis, of in enumerate((table.mapped or Mapped()).frame) if isinstance(of, str)]
    for (axis, name), (unit, wrong) in product(columns, permutations(METRES, 2)):
        factor = METRES[unit] / METRES[wrong]
        if any(max(by[axis] / 2, LEAST_MOTION * robot.length) < factor * moves[axis] < 2 * by[axis] for by in able):
            shown, remedy = heading(name, table.mapped), of_columns([name], unit.replace("inches", "in"), table.mapped)
            says = stating("axis_in_unit", f"column {shown}", heading=shown, unit=unit, wrong=wrong, factor=factor, remedy=remedy)
            yield Edit(f"unit of {name}", 0.001, says, partial(_scaled, np.where(np.arange(3) == axis, factor, 1.0)))
    apart = markers or np.isfinite(sample.described.orientation).any()
    for bodies, handed in ((every, (1,)), (every, (-1,)), *(((body,), (1, -1)) for body in every if apart)):
        places = (_points(v)[:, :, [*bodies]] for v in (rods, sample.described))
        predicted, measured = (own - _mean(own[:, rest]) for own in places)
        frames = [m for m in FRAMES if round(np.linalg.det(m)) in handed]
        like = np.array([np.nansum(predicted * (measured @ m.T)) for m in frames])
        axes = frames[int(np.argmax(like + PLAINEST * like.max() * np.array([np.trace(m) for m in frames])))]
        if not np.array_equal(axes, np.eye(3)):
            whole = len(handed) == 1
            kind, prior = ("points", 0.02) if not whole else ("frame", 0.02) if handed == (1,) else MIRROR
            point = f"marker {bodies[0]}" if bodies[0] else "the tip"
            axis_of = ", ".join(f"{a}: {name}" for a, name in zip("xyz", named(axes), strict=True))
            of_one = stating("axes_of_point", f"columns of {point}", point=point, axes=axis_of)
            says = axes_say(axes, table.mapped) if whole else of_one
            proper = axes * np.round(np.linalg.det(axes))
            turn = scipy.spatial.transform.Rotation.from_matrix(proper).as_quat(scalar_first=True) if whole else NO_TURN
            yield Edit(kind, prior / len(every), says, partial(_about_rest, axes, bodies, turn))


def at_rest(table: Table) -> Mask:
    """(n,) states whose actuators are the least loaded."""
    highest = np.abs(table.pressures).max(axis=1)
    return np.asarray(highest <= highest.min() + AT_REST * np.ptp(highest))


def _gravity_about_rest(sample: Sample, rest: Mask) -> Iterator[Edit]:
    """Gravity along another axis, of readings that were put where the robot stands at rest under the stated one."""
    stated = np.array(sample.robot.gravity)
    downs = [stated, -stated, *(float(np.linalg.norm(stated)) * sign * axis for axis in np.eye(3) for sign in (1, -1))]
    v = sample.described.take(np.zeros(len(downs), np.int64))
    stands = sample.rods(replace(v, gravity=np.array(downs)[:, None]))
    tip, markers = (np.nan_to_num(_mean(p[:, rest] - p[:1, rest])) for p in (stands.tip, stands.markers))
    for k, down in enumerate(downs):
        if np.linalg.norm(down - stated) > 0.1 * np.linalg.norm(stated):  # places at rest move with it
            apply = partial(gravity_along, down, tip=tip[k], markers=markers[k])
            yield Edit("gravity", 0.005, gravity_says(sample.robot, down), apply)


def _points(v: Variants) -> Array:
    """(v, n, 1 + k, 3) m of the tip, then the k markers."""
    return np.concatenate([v.tip[:, :, None], v.markers], axis=2)


def _mean(places: Array) -> Array:
    """(v, 1, ..) m, of the states (v, n, ..) that were seen; 0 of none."""
    return np.asarray(np.ma.masked_invalid(places).mean(axis=1, keepdims=True).filled(0.0))


def _about_rest(axes: Array, bodies: Sequence[int], turn: Array, v: Variants, own: Array) -> Variants:
    """Places of some bodies along other axes of the file about where they rest, and attitudes turned by a quaternion."""
    points, some = _points(v), [*bodies]
    rest = _mean(points[:, at_rest(v.table)])[:, :, some]
    points[:, :, some] = rest + (points[:, :, some] - rest) @ axes.T
    orientation = multiply(multiply(turn, v.orientation), turn * CONJUGATE)
    return replace(v, tip=points[:, :, 0], markers=points[:, :, 1:], orientation=orientation)


def _scaled(factors: Array, v: Variants, own: Array) -> Variants:
    """Places with each axis times a factor: about where they rest if the map moved them there, else from the origin."""
    if v.table.moved_to_model:
        return _about_rest(np.diag(factors), range(1 + v.markers.shape[2]), NO_TURN, v, own)
    return replace(v, tip=v.tip * factors, markers=v.markers * factors)


def _exchanged(k: int, about_rest: bool, v: Variants, own: Array) -> Variants:
    """Tip and marker k in each other's place; `about_rest`: each moved to where the other rests."""
    tip, marker, markers = v.tip, v.markers[:, :, k], v.markers.copy()
    apart = _mean((tip - marker)[:, at_rest(v.table) & about_rest])
    markers[:, :, k] = tip - apart
    return replace(v, tip=marker + apart, markers=markers)
