"""Measured poses of an arm: whether they can be its own, where its base stands among them, what they are worth weighing for.

The instrument seldom knows the base's frame: base and tool are fitted first, from the rotation that fits all points best (Kabsch
1976), by soft L1, so that single wrong poses do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from model.arm.causes import LARGEST_ANGLE, ArmModel
from model.arm.description import Arm
from model.arm.kinematics import base_rotation
from model.arrays import Mask
from model.cause import Cause
from model.errors import BadCondition
from model.robot import Array, Pose
from model.rotation import turn_onto

FRAME = tuple(f"{kind}_{axis}" for kind, axes in (("base", "x y z rx ry rz"), ("tool", "x y z")) for axis in axes.split())
"""Parameters that say where base and tool are."""
ROBUST = 1e-3
"""m, misfit above which a pose counts less than its square."""
FITS = 0.05
"""Of the poses' extent: largest median misfit with base and tool fitted; no error of a sound arm is as large."""
STRAY = 15.0
"""Median misfits beyond which a pose is left out: something else was measured there."""
MOST_STRAYS = 0.2
"""Share of poses that may be left out one by one; beyond it something is wrong with all."""
STATED = 3.0
"""Plausible sizes within which base and tool are where arm.yaml has them."""
TRIED = 200
"""Poses on which other readings of a table are tried."""
MOST_PARAMETERS = 50
"""Of a cause; one with more fits anything smooth."""
VALUES = 2
"""Measured values for each fitted parameter."""
UNITS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254}
EXTENT = 2.0
"""Most times the arm's own extent that measured positions have, or least part of it."""
STEPS = 30
"""Of the fit of base and tool: one that fits needs fewer."""


def placed(arm: Arm, inputs: pd.DataFrame, at: Array, place: Callable[[int], str]) -> tuple[Arm, Mask, tuple[str, ...]]:
    """The arm with base and tool where measured positions `at` (n, 3) m show them, if not where they are stated; (n,) the poses
    that can be its own; notes, in which `place` names a row. Raises `BadCondition` where the poses are not its own in rad and m.
    """
    q = inputs[list(arm.joints)].to_numpy(float)
    wide = (np.abs(q) > LARGEST_ANGLE).any(axis=1)
    kept, misfit = ~wide, _misfit(arm, inputs, at)
    if not misfit <= FITS:
        raise BadCondition(_otherwise(arm, inputs, at, misfit))
    fitted, missed = _fitted(arm, inputs[kept], at[kept])
    middle = float(np.median(missed))
    notes = [f"{place(i)}: an angle beyond two turns, {LARGEST_ANGLE:.4g} rad; left out" for i in np.flatnonzero(wide).tolist()]
    rows = np.flatnonzero(kept)
    stray = missed > max(STRAY * middle, ROBUST)
    stray &= stray.mean() <= MOST_STRAYS
    kept[rows[stray]] = False
    for i in np.flatnonzero(stray).tolist():
        far = f"{1e3 * missed[i]:.3g} mm from where the arm reaches, the others {1e3 * middle:.2g} mm (median)"
        notes.append(f"{place(int(rows[i]))}: the position is {far}; left out")
    moved = _moved(arm, fitted)
    return fitted if moved else arm, kept, (*notes, *([moved] if moved else []))


def _fitted(arm: Arm, inputs: pd.DataFrame, at: Array) -> tuple[Arm, Array]:
    """The arm with base and tool where positions (n, 3) show them, and how far each is missed (n,), m."""
    points = ArmModel(arm)({}, inputs)
    turn = Rotation.from_matrix(turn_onto(at - at.mean(axis=0), points - points.mean(axis=0)))
    base = turn.apply(np.array(arm.base_to_world.position) - points.mean(axis=0)) + at.mean(axis=0)
    arm = _at(arm, base, turn, np.zeros(3))
    model = ArmModel(arm)
    size = np.array([model.parameters[name][1] for name in FRAME])

    def theta(x: Array) -> dict[str, float]:
        return dict(zip(FRAME, x * size, strict=True))

    x = least_squares(
        lambda x: (model(theta(x), inputs) - at).ravel(), np.zeros(len(FRAME)),
        lambda x: np.transpose([d.ravel() for d in model.derivatives(theta(x), inputs).values()]) * size,
        loss="soft_l1", f_scale=ROBUST, max_nfev=STEPS,
    ).x  # fmt: skip
    missed = np.linalg.norm(model(theta(x), inputs) - at, axis=1)
    shift, tilt, tool = np.split(x * size, 3)
    return _at(arm, base + shift, Rotation.from_euler("xyz", tilt), tool), missed


def _at(arm: Arm, base: Array, turn: Rotation, tool: Array) -> Arm:
    """The arm with its base at `base`, turned with gravity by `turn`, and its tool moved by `tool`."""
    x, y, z, w = (turn * Rotation.from_matrix(base_rotation(arm))).as_quat().tolist()
    pose = Pose(position=tuple(base.tolist()), orientation=(w, x, y, z))
    down, moved = (tuple(v.tolist()) for v in (turn.apply(arm.down), np.array(arm.tool) + tool))
    return arm.model_copy(update={"base_to_world": pose, "tool": moved, "down": down})


def _moved(arm: Arm, fitted: Arm) -> str:
    """Where base and tool are, if that is not where they are stated; else empty."""
    shift = np.subtract(fitted.base_to_world.position, arm.base_to_world.position)
    tool = np.subtract(fitted.tool, arm.tool)
    angle = Rotation.from_matrix(base_rotation(fitted) @ base_rotation(arm).T).magnitude()
    size = ArmModel(arm).parameters
    far = np.linalg.norm(shift) > STATED * size["base_x"][1] or angle > STATED * size["base_rx"][1]
    if not far and np.linalg.norm(tool) <= STATED * size["tool_x"][1]:
        return ""
    return (
        f"base and tool are taken where these poses show them: the base {1e3 * np.linalg.norm(shift):.0f} mm and "
        f"{math.degrees(angle):.3g} deg from base_to_world of {arm.name}, the tool at "
        f"({', '.join(f'{1e3 * v:.1f}' for v in fitted.tool)}) mm"
    )


def _otherwise(arm: Arm, inputs: pd.DataFrame, at: Array, misfit: float) -> str:
    """The complaint about poses that cannot be the arm's own, with how they could be read instead."""
    some = slice(None, None, max(1, len(at) // TRIED))
    tried = list(_tried(arm, inputs[some], at[some]))
    best = min(left for left, _ in tried)
    remedy = " or ".join(way for left, way in tried if left <= 2 * best)
    if not best <= FITS or best > misfit / 3:
        remedy = "check order, signs and zeros of the joints and the lengths in the description of the arm, and units"
    angle, extent = inputs[list(arm.joints)].abs().median().max(), _extent(at)
    value = f"{misfit:.2g} of their extent" if math.isfinite(misfit) else f"far: angles of {angle:.3g} rad, {extent:.3g} m apart"
    return (
        f"{arm.joints[0]} .. {arm.joints[-1]} in rad and x, y, z in m are off by {value} (medians, base and tool of {arm.name} "
        f"fitted), must be at most {FITS:g}: {remedy}"
    )


def _extent(at: Array) -> float:
    """Distance of positions (n, 3) from their middle that all but `MOST_STRAYS` keep."""
    return float(np.quantile(np.linalg.norm(at - np.median(at, axis=0), axis=1), 1 - MOST_STRAYS))


def _tried(arm: Arm, inputs: pd.DataFrame, at: Array) -> Iterator[tuple[float, str]]:
    """Misfit of poses read in another way, see `_misfit`, and what to do about it."""
    names = list(arm.joints)
    degrees = inputs.assign(**{name: np.radians(inputs[name]) for name in names})
    ways = {"deg": (degrees, 1.0)} | {f"deg and {u}": (degrees, f) for u, f in UNITS.items()}
    for units, (read, factor) in (ways | {u: (inputs, f) for u, f in UNITS.items()}).items():
        remedy = f"the numbers look like {units}: write units into the headings, {names[0]} [deg], x [mm]"
        yield _misfit(arm, read, at * factor), remedy
    for name in names:
        yield _misfit(arm, inputs.assign(**{name: -inputs[name]}), at), f"{name} is counted the other way: change its sign"
    yield _misfit(arm, inputs, at * [1, 1, -1]), "the axes of x, y, z are left-handed: change the sign of z"


def _misfit(arm: Arm, inputs: pd.DataFrame, at: Array) -> float:
    """Median misfit with base and tool fitted, of the extent; infinite where angles or extent are not those of the arm at all."""
    within = (np.abs(inputs[list(arm.joints)]) <= LARGEST_ANGLE).all(axis=1).to_numpy()
    if within.mean() < 1 - MOST_STRAYS:
        return math.inf
    own = _extent(ArmModel(arm)({}, inputs[within]))
    if not 0 < own / EXTENT <= _extent(at[within]) <= own * EXTENT:
        return math.inf
    return float(np.median(_fitted(arm, inputs[within], at[within])[1])) / own


def weighed(model: ArmModel, poses: int) -> tuple[tuple[Cause, ...], Mapping[str, Sequence[Any]], tuple[str, ...]]:
    """Causes for which there are enough poses, what is always calibrated, and notes. Raises `BadCondition`."""
    calibration = {name: values for name, values in model.parameters.items() if name in FRAME}
    chosen, notes, count = list[Cause](), list[str](), len(calibration)
    for cause in (c for c in model.causes if not c.parameters.keys() <= {*FRAME} and len(c.parameters) <= MOST_PARAMETERS):
        needed = math.ceil(VALUES * (count + len(cause.parameters)) / 3)
        if poses >= needed:
            chosen.append(cause)
            count += len(cause.parameters)
        elif not chosen:
            raise BadCondition(f"{poses} poses, must be at least {needed} to weigh any cause of {model.arm.name}: measure more")
        else:
            notes.append(f"{cause.name} is not weighed: with {needed} poses it would be")
    return tuple(chosen), calibration, tuple(notes)


def poses_within(arm: Arm, count: int) -> pd.DataFrame | None:
    """Random poses within the joints' stated limits; None where a joint states none."""
    limits = [link.limits_deg for link in arm.links]
    if any(limit is None for limit in limits):
        return None
    low, high = np.radians(np.array(limits, float)).T
    return pd.DataFrame(np.random.default_rng(0).uniform(low, high, (count, len(low))), columns=list(arm.joints))
