"""Edits of a table as a whole: columns that hold another quantity, and points that were taken for each other or along other axes.

A map may put a robot at rest where its model stands (`straight`), so axes are also exchanged about the places at rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from model.robot import Robot
from model.rotation import CONJUGATE, multiply

from ..arrays import Array, Mask
from ..data.units import PRESSURE_UNITS, Unit
from ..findings import Finding, finding
from .edit import Edit, Variants
from .listed import FRAMES, axes_say
from .misfit import AMBIENT, Fit, Sample

AT_REST = 0.03
"""Share of the range of pressures above the lowest within which a robot is at rest."""
PLAINEST = 0.02
"""Share of the likeness that an axis of a frame counts where it stays as it is: who bends little does not show them all."""


def of_table(sample: Sample, near: Fit) -> Iterator[Edit]:
    """The edits that this table can have."""
    table, robot = sample.table, sample.robot
    yield Edit("origin", 0.01, _displacements_say, _displacements)
    for factor in (1e-3, 1e3):
        yield Edit("modulus", 0.01, partial(_stiffness_says, factor), partial(_stiffness, factor))
    for unit in PRESSURE_UNITS if robot.chambers is not None else ():
        if AMBIENT[0] < (ambient := float(table.pressures.min() / unit.per_si)) < AMBIENT[1]:
            yield Edit("zero", 0.01, partial(_absolute_says, unit, ambient), partial(_absolute, unit, ambient))
    highest = np.abs(table.pressures).max(axis=1)
    rest = np.asarray(highest <= highest.min() + AT_REST * np.ptp(highest))
    markers = sample.described.markers.shape[2]
    for k in range(markers):
        for own in (rest, rest & False):
            yield Edit("points", 0.02 / markers, partial(_exchanged_say, k), partial(_exchanged, k, own))
    rods, every = sample.rods(sample.edited([((), near.x[None])])), tuple(range(-1, markers))
    apart = markers or np.isfinite(sample.described.orientation).any()
    for bodies, handed in ((every, (1,)), (every, (-1,)), *(((body,), (1, -1)) for body in every if apart)):
        predicted, measured = ([_from_rest(_place(v, body), rest)[0] for body in bodies] for v in (rods, sample.described))
        axes = _nearest_axes(predicted, measured, [m for m in FRAMES if round(np.linalg.det(m)) in handed])
        if not np.array_equal(axes, np.eye(3)):
            whole = len(handed) == 1
            kind, says = ("frame", axes_say) if whole else ("points", partial(_axes_of_one_say, bodies[0]))
            yield Edit(kind, 0.02 / len(every), partial(says, axes), partial(_about_rest, axes, bodies, rest, whole))


def _place(v: Variants, body: int) -> Array:
    """(v, n, 3) m of the tip (-1) or a marker."""
    return v.tip if body < 0 else v.markers[:, :, body]


def _from_rest(places: Array, rest: Mask) -> Array:
    """(v, n, 3) m from the mean of the states at rest, those that were seen."""
    return places - _mean(places[:, rest])


def _mean(places: Array) -> Array:
    """(v, 1, 3) m, of the states (v, n, 3) that were seen; 0 of none."""
    seen = np.isfinite(places).all(axis=2, keepdims=True)
    return np.asarray(np.where(seen, places, 0.0).sum(axis=1, keepdims=True) / np.maximum(seen.sum(axis=1, keepdims=True), 1))


def _nearest_axes(predicted: Sequence[Array], measured: Sequence[Array], frames: Sequence[Array]) -> Array:
    """(3, 3) the axes along which moves (n, 3) m of some bodies are most like those of the rod."""
    like = np.array([sum(np.nansum(a * (b @ m.T)) for a, b in zip(predicted, measured, strict=True)) for m in frames])
    plainest = PLAINEST * like.max() * np.array([np.trace(m) for m in frames])
    return frames[int(np.argmax(like + plainest))]


def _about_rest(axes: Array, bodies: Sequence[int], rest: Mask, with_attitude: bool, v: Variants, own: Array) -> Variants:
    """Places of some bodies, and perhaps attitudes, along other axes of the file about where they rest."""
    tip, markers, orientation = v.tip, v.markers.copy(), v.orientation
    for body in bodies:
        moved = _from_rest(_place(v, body), rest)
        placed = _place(v, body) - moved + moved @ axes.T
        if body < 0:
            tip = placed
        else:
            markers[:, :, body] = placed
    if with_attitude:
        turn = Rotation.from_matrix(axes * np.round(np.linalg.det(axes))).as_quat(scalar_first=True)
        orientation = multiply(multiply(turn, orientation), turn * CONJUGATE)
    return replace(v, tip=tip, markers=markers, orientation=orientation)


def _axes_of_one_say(
    body: int, axes: Array, robot: Robot, theta: Array, own: Array, p: float, rather: str
) -> list[Finding]:  # fmt: skip
    point = "the tip" if body < 0 else f"marker {body + 1}"
    named = [f"{a}: {'-' * bool(row.sum() < 0)}{'xyz'[int(np.abs(row).argmax())]}" for a, row in zip("xyz", axes, strict=True)]
    return [finding("axes_of_point", point=point, axes=", ".join(named), short=f"columns of {point}", p=p, rather=rather)]


def _stiffness(factor: float, v: Variants, own: Array) -> Variants:
    return replace(v, modulus=factor * v.modulus)


def _stiffness_says(factor: float, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    given, found = robot.youngs_modulus / 1e3, factor * robot.youngs_modulus / 1e3
    name = "bending_stiffness" if robot.bending_stiffness else "youngs_modulus"
    values = {"name": name, "given": given, "found": found, "unit": "kPa", "short": name}
    return [finding("refitted", p=p, rather=rather, **values)]


def _displacements(v: Variants, own: Array) -> Variants:
    return v.moved(np.broadcast_to([0.0, 0.0, v.robot.length], (len(own), 1, 3)))


def _displacements_say(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    return [finding("displacements", length=robot.length, short="columns x, y, z", p=p, rather=rather)]


def _absolute(unit: Unit, ambient: float, v: Variants, own: Array) -> Variants:
    return replace(v, pressure=v.pressure / unit.per_si - ambient)


def _absolute_says(unit: Unit, ambient: float, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    shared = {"short": "gauge or absolute pressures", "p": p, "rather": rather}
    words, factor = robot.actuators.words, 1 / unit.per_si
    return [finding("pressures_in_unit", words, factor=factor, looks=unit.name, **{**shared, "rather": ""}),
            finding("pressures_absolute", words, ambient=ambient, **shared)]  # fmt: skip


def _exchanged(k: int, rest: Mask, v: Variants, own: Array) -> Variants:
    """Tip and marker k in each other's place; with states at `rest` (n,), each moved to where the other rests."""
    tip, marker, markers = v.tip, v.markers[:, :, k], v.markers.copy()
    apart = _mean((tip - marker)[:, rest])
    markers[:, :, k] = tip - apart
    return replace(v, tip=marker + apart, markers=markers)


def _exchanged_say(k: int, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    return [finding("points_exchanged", number=k + 1, short="tip and markers", p=p, rather=rather)]
