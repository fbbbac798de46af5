"""The list of edits: what can be wrong in a robot.yaml or a table, how probable that is beforehand, and how a person reads it.

Priors are shares of the descriptions that are wrong, by a rough count of those that other laboratories sent; of an edit that
exists for each chamber, pair or trial, the share is divided by their number.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import combinations, permutations, product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from model.robot import Robot
from model.section import body_mass
from recordings.trials import Table

from .. import judgement
from ..arrays import Array
from ..findings import Finding, finding
from .edit import (
    AREA,
    AZIMUTH,
    GRAVITY,
    MODULUS,
    ORIGIN,
    Edit,
    Edited,
    heavier,
    turned,
    with_gravity,
    with_length,
    with_pressures,
)
from .misfit import Fit, Sample

QUARTERS = ((0.0,), (np.pi / 2,), (-np.pi / 2,), (np.pi,))
"""Azimuths by which chambers may be counted from another one, rad."""
UNITS = {6.895: "psi", 1 / 6.895: "psi", 1e3: "kPa", 6895.0: "psi", 1e5: "bar", 100.0: "mbar"}
"""Times that a column's pressures must be larger -> the unit that it looks like, or that of all others."""
AXES = np.eye(3)
FRAMES = [
    np.array(signs)[:, None] * AXES[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
]
"""Each way in which axes of a file can be those of the base."""


def every_edit(sample: Sample, near: Fit) -> list[Edit]:
    """The edits that this robot and table can have; `near`: the robot as it is described."""
    found = [*_of_robot(sample.robot), *_of_frame(sample, near), *_of_columns(sample), *_left_to_the_diagnosis(sample.robot)]
    return [edit for edit in found if edit.starts]


# ------------------------------------------------------------------ robot.yaml
def _of_robot(robot: Robot) -> Iterator[Edit]:
    stiffer = tuple((area, stiff) for stiff in np.log([2, 4, 9, 1 / 2, 1 / 4, 1 / 9]).tolist() for area in (0.0, stiff))
    yield Edit("modulus", 0.05, _modulus, starts=stiffer, widens={AREA: np.log(20), MODULUS: np.log(20)})
    yield Edit("order", 0.05, _azimuth, starts=QUARTERS, widens={AZIMUTH: np.pi})
    yield Edit("order", 0.03, _counted, _mirrored, starts=QUARTERS, widens={AZIMUTH: np.pi})
    turned_round, size = -np.array(robot.gravity), float(np.linalg.norm(robot.gravity))
    yield Edit("gravity", 0.03, partial(_gravity_says, turned_round), partial(_gravity, turned_round))
    for down in (sign * size * axis for axis in AXES for sign in (1, -1)):
        if min(np.linalg.norm(down - other) for other in (robot.gravity, turned_round)) > 0.1 * size:
            yield Edit("gravity", 0.005, partial(_gravity_says, down), partial(_gravity, down))
    around = tuple((float(a), float(b)) for a, b in np.radians([(0, 0), (15, 0), (-15, 0), (0, 15), (0, -15)]))
    widest = np.radians(25)
    yield Edit("gravity", 0.01, _tilted, starts=around, widens={3: widest, 4: widest})
    half = ((-0.9, 0.9), (-0.9, 0.9))
    yield Edit("tilt", 0.03, _tilt_says, _tilt, around[1:], half)
    yield Edit("length", 0.03, _length_says, _length, ((-0.05,), (0.05,)), ((-0.25, 0.35),))
    yield Edit("origin", 0.03, _origin, starts=((0.0, 0.0, 0.0),), widens={5: 0.3, 6: 0.3, 7: 0.3})


def _refitted(
    name: str, given: float, found: float, unit: str, p: float, rather: str, limit: bool = False, short: str = ""
) -> Finding:  # fmt: skip
    return finding(
        "refitted_to_limit" if limit else "refitted", name=name, given=given, found=found, unit=unit, short=short or name, p=p,
        rather=rather,
    )  # fmt: skip


def _at_bound(value: float, bound: float) -> bool:
    return abs(value) > judgement.EDIT_AT_BOUND * bound


def _beyond(theta: Array, number: int) -> bool:
    return bool(abs(theta[number]) > judgement.EDIT_USUAL[number])


def _modulus(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    kilo, limit = robot.youngs_modulus / 1e3, _at_bound(theta[MODULUS], np.log(20))
    found = kilo * float(np.exp(theta[MODULUS]))
    return [_refitted("youngs_modulus", kilo, found, "kPa", p, rather, limit)] if _beyond(theta, MODULUS) else []


def _azimuth(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    first, words = robot.actuators.azimuths_deg[0], robot.actuators.words
    found, name = first + float(np.degrees(theta[AZIMUTH])), words.fill("azimuth of the first {actuator}")
    return [_refitted(name, first, found, "deg", p, rather)] if _beyond(theta, AZIMUTH) else []


def _mirrored(robot: Robot, table: Table, own: Array) -> Edited:
    """Chambers counted the other way round, from the first one."""
    azimuths = robot.actuators.azimuths_deg
    return robot.with_azimuths(tuple(2 * azimuths[0] - a for a in azimuths)), table


def _counted(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    azimuths, words = robot.actuators.azimuths_deg, robot.actuators.words
    second = azimuths[min(1, len(azimuths) - 1)]
    short = words.fill("{actuators} counted the other way")
    found = 2 * azimuths[0] - second + float(np.degrees(theta[AZIMUTH]))
    return [_refitted(f"{short} round, azimuth of the second", second, found, "deg", p, rather, short=short)]


def _gravity(down: Array, robot: Robot, table: Table, own: Array) -> Edited:
    x, y, z = down.tolist()
    return robot.model_copy(update={"gravity": (x, y, z)}), table


def _gravity_says(down: Array, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    given = listed(robot.gravity)
    return [finding("gravity_elsewhere", found=listed(down), given=given, short="gravity", p=p, rather=rather)]


def listed(vector: Any) -> str:
    """Three numbers as robot.yaml has them."""
    return f"[{', '.join(f'{x + 0.0:.3g}' for x in np.round(vector, 2))}]"


def _tilted(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    tilt = float(np.degrees(np.linalg.norm(theta[GRAVITY])))
    limit = _at_bound(float(np.abs(theta[GRAVITY]).max()), np.radians(25))
    if not (_beyond(theta, 3) or _beyond(theta, 4)):
        return []
    return [_refitted("gravity, turned from the one stated by", 0.0, tilt, "deg", p, rather, limit, "gravity")]


def _tilt(robot: Robot, table: Table, own: Array) -> Edited:
    """Base turned by own (2,) rad about x and y: places as the level base would have them, gravity as the tilted one has it."""
    turn = Rotation.from_rotvec([*own, 0.0]).inv()
    return with_gravity(robot, turn), turned(table, turn)


def _tilt_says(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    x, y = np.degrees(own)
    each = [f"{abs(v):.0f} deg about {'-' if v < 0 else ''}{axis}" for v, axis in ((x, "x"), (y, "y")) if abs(v) >= 1]
    if np.hypot(x, y) < judgement.EDIT_LEAST_TILT:
        return []
    about, given = " and ".join(each), listed(robot.gravity)
    return [finding("base_tilted", about=about, given=given, short="tilt of the base", p=p, rather=rather)]


def _length(robot: Robot, table: Table, own: Array) -> Edited:
    return with_length(robot, robot.length * (1 + float(own[0]))), table


def _length_says(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    given, words = 1e3 * robot.length, robot.actuators.words
    found = given * (1 + float(own[0]))
    return [finding("length_differs", words, given=given, found=found, unit="mm", short="length", p=p, rather=rather)]


def _origin(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    shift = theta[ORIGIN]
    return [
        _refitted(f"origin of the tip's {axis}", 0.0, 1e3 * float(d) * robot.length, "mm", p, rather, _at_bound(d, 0.3))
        for d, axis, usual in zip(shift, "xyz", judgement.EDIT_USUAL[ORIGIN], strict=True)
        if abs(d) > usual
    ]


# ------------------------------------------------------------------ the cameras' frame
def _of_frame(sample: Sample, near: Fit) -> Iterator[Edit]:
    seen, robot = sample.table.tip, sample.robot
    predicted = np.nan_to_num(sample.predicted(robot, sample.table))
    turn = Rotation.align_vectors(predicted, seen)[0]
    for handed in (1, -1):
        axes = max((m for m in FRAMES if np.linalg.det(m) * handed > 0), key=lambda m: np.sum(predicted * (seen @ m.T)))
        if not np.array_equal(axes, np.eye(3)):
            yield Edit("frame", 0.006, partial(_axes_say, axes), partial(_axes, axes))
    start = tuple(turn.inv().as_rotvec().tolist())
    yield Edit("frame", 0.02, _turn_says, _turn, (start,), ((-4.0, 4.0),) * 3)
    for trial in _steps(sample, near.missed):
        share = 0.03 / len(np.unique(sample.table.trial))
        moved, bound = partial(_step, trial), ((-0.3 * robot.length, 0.3 * robot.length),) * 3
        says = partial(_step_says, trial)
        yield Edit("step", share, says, moved, ((0.0, 0.0, 0.0),), bound, of_this_campaign=True)


def _axes(axes: Array, robot: Robot, table: Table, own: Array) -> Edited:
    """Places along other axes of the file; `axes` (3, 3) from the file's to the base's."""
    sign = np.array([1.0, 1.0, np.linalg.det(axes)])
    return robot, turned(table, Rotation.from_matrix(np.diag(sign) @ axes), sign.tolist())


def _axes_say(axes: Array, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    mirrored = np.linalg.det(axes) < 0
    angle, about, line = _turned_says(Rotation.from_matrix(-axes if mirrored else axes), axes)
    if mirrored:
        return [finding("frame_mirrored", line=line, short="the cameras' frame", p=p, rather=rather)]
    return [finding("frame_turned", angle=angle, about=about, line=line, short="the cameras' frame", p=p, rather=rather)]


def _turn(robot: Robot, table: Table, own: Array) -> Edited:
    """Places that a frame turned by own (3,) rad has as the base's own."""
    return robot, turned(table, Rotation.from_rotvec(own).inv())


def _turn_says(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    turn = Rotation.from_rotvec(own)
    if turn.magnitude() < np.radians(judgement.EDIT_LEAST_TILT):
        return []
    angle, about, line = _turned_says(turn.inv(), turn.inv().as_matrix())
    return [finding("frame_turned", angle=angle, about=about, line=line, short="the cameras' frame", p=p, rather=rather)]


def _turned_says(turn: Rotation, axes: Array) -> tuple[float, str, str]:
    """Angle (deg) and axis by which the frame is turned, and the line to correct; `turn` and `axes` (3, 3) lead to the base."""
    back = turn.inv().as_rotvec()
    angle = float(np.linalg.norm(back))
    nearest = max(FRAMES, key=lambda m: float(np.sum(m * axes)))
    named = [f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.abs(row).argmax())]}" for row in nearest]
    aligned = float(np.sum(nearest * axes)) > 1 + 2 * np.cos(np.radians(10.0))
    map_line = f"frame in map.yaml (x: {named[0]}, y: {named[1]}, z: {named[2]})" if aligned else "the cameras' axes"
    about = listed(back / max(angle, 1e-12))
    return float(np.degrees(angle)), about, map_line


def _steps(sample: Sample, missed: Array) -> list[int]:
    """Numbers of the trials from which on tips are most elsewhere than the repeats before: two at most."""
    trials = np.unique(sample.table.trial)
    count = np.bincount(sample.condition)

    def centred(values: Array) -> Array:
        return np.asarray(values - (np.bincount(sample.condition, values) / count)[sample.condition])

    rest = np.stack([centred(axis) for axis in missed.T], axis=1)
    explained = []
    for trial in trials[1:]:
        late = centred((sample.table.trial >= trial).astype(float))
        explained.append(float(((late @ rest) ** 2).sum() / (late @ late)) if late @ late > 0.1 else 0.0)
    order = np.argsort(explained)[::-1][:2]
    return [int(trials[1:][k]) for k in order if explained[k] > 0]


def _step(trial: int, robot: Robot, table: Table, own: Array) -> Edited:
    late = table.trial >= trial
    moved = table.moved((-own).tolist())
    return robot, table.replaced({n: np.where(late, moved.values[n], c) for n, c in table.values.items() if c.dtype.kind == "f"})


def _step_says(trial: int, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    x, y, z = (1e3 * own).tolist()
    mm, by = float(1e3 * np.linalg.norm(own)), f"({x:.1f}, {y:.1f}, {z:.1f}) mm"
    return [finding("frame_moved", mm=mm, trial=trial, by=by, short="the cameras' frame", p=p, rather=rather)]


# ------------------------------------------------------------------ columns of pressure
def _of_columns(sample: Sample) -> Iterator[Edit]:
    pressures, robot = sample.table.pressures, sample.robot
    highest = np.abs(pressures).max(axis=0)
    pairs = [(i, j) for i, j in combinations(range(len(highest)), 2)
             if np.abs(pressures[:, i] - pressures[:, j]).max() > 0.1 * highest.max()]  # fmt: skip
    for i, j in pairs:
        order = list(range(len(highest)))
        order[i], order[j] = j, i
        yield Edit("order", 0.04 / len(pairs), partial(_order_says, i, j), partial(_order, order))
    for k in np.flatnonzero(highest > 0).tolist():
        small = highest[k] < 0.02 * highest.max()
        factors = (1e3, 6895.0) if small else (6.895, 1 / 6.895, 2.0)
        share = 1 / np.count_nonzero(highest > 0)
        if not small:
            yield Edit(f"gain {k}", 0.04 * share, partial(_dead_says, k), partial(_gain, k, 0.0))
        for factor in factors:
            bound = ((np.log(factor) - 1.0, np.log(factor) + 1.0),)
            apply, start = partial(_gain, k, 1.0), ((float(np.log(factor)),),)
            yield Edit(f"gain {k}", 0.01 * share, partial(_gain_says, k), apply, start, bound)
    low = pressures.min()
    if robot.chambers is not None and 75e3 < low < 107e3:
        yield Edit("zero", 0.03, partial(_ambient_says, low), partial(_ambient, low))

    roll = np.abs(sample.table.get("roll_deg", 0.0))
    if 0 < roll.max() < 2 * np.pi + 0.01:
        yield Edit("roll", 0.03, _roll_says, _roll)


def _roll(robot: Robot, table: Table, own: Array) -> Edited:
    return robot, table.replaced({"roll_deg": np.degrees(table.get("roll_deg", 0.0))})


def _roll_says(robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    return [finding("roll_in_rad", short="column roll_deg", p=p, rather=rather)]


def _order(order: list[int], robot: Robot, table: Table, own: Array) -> Edited:
    return robot, with_pressures(table, table.pressures[:, order])


def _order_says(i: int, j: int, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    words = robot.actuators.words
    short = words.fill("order of the {actuators}")
    return [finding("actuators_exchanged", words, first=i + 1, second=j + 1, short=short, p=p, rather=rather)]


def _gain(k: int, factor: float, robot: Robot, table: Table, own: Array) -> Edited:
    pressures = table.pressures
    pressures[:, k] *= factor * float(np.exp(own.sum()))
    return robot, with_pressures(table, pressures)


def _dead_says(k: int, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    words = robot.actuators.words
    return [finding("actuator_dead", words, number=k + 1, short=f"{words.actuator} {k + 1}", p=p, rather=rather)]


def _gain_says(k: int, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    factor = float(np.exp(own[0]))
    if 1 / judgement.EDIT_USUAL_GAIN < factor < judgement.EDIT_USUAL_GAIN:
        return []
    unit = min(UNITS, key=lambda ratio: abs(np.log(ratio / factor)))
    looks = UNITS[unit] if abs(np.log(unit / factor)) < np.log(1.25) else "another unit"
    short = f"column p{k + 1}"
    return [finding("column_in_unit", number=k + 1, factor=factor, looks=looks, short=short, p=p, rather=rather)]


def _ambient(ambient: float, robot: Robot, table: Table, own: Array) -> Edited:
    return robot, with_pressures(table, table.pressures - ambient)


def _ambient_says(ambient: float, robot: Robot, theta: Array, own: Array, p: float, rather: str) -> list[Finding]:
    words, short = robot.actuators.words, "gauge or absolute pressures"
    return [finding("pressures_absolute", words, ambient=float(ambient), short=short, p=p, rather=rather)]


# ------------------------------------------------------------------ what the diagnosis names itself
def _left_to_the_diagnosis(robot: Robot) -> Iterator[Edit]:
    mass = max(body_mass(robot), 1e-6)
    starts = tuple((share * mass,) for share in (-0.3, 0.3, 1.2))
    yield Edit("weight", 0.1, apply=_payload, starts=starts, bounds=((-robot.tip_mass - mass, 3 * mass),), left=True)
    yield Edit("weight", 0.1, apply=_weight, starts=((0.6,), (1.6,), (2.5,)), bounds=((0.3, 3.0),), left=True)
    yield Edit("drift", 0.2, apply=_drift, starts=((0.0, 0.0, 0.0),), bounds=((-0.1, 0.1),) * 3, left=True)
    for k in range(len(robot.actuators.azimuths_deg)):
        gain = np.log(judgement.EDIT_USUAL_GAIN)
        apply = partial(_gain, k, 1.0)
        yield Edit(f"gain {k}", 0.1 / len(robot.actuators.azimuths_deg), apply=apply, starts=((0.0,),),
                   bounds=((-gain, gain),), left=True)  # fmt: skip


def _payload(robot: Robot, table: Table, own: Array) -> Edited:
    return heavier(robot, table, float(own[0]))


def _weight(robot: Robot, table: Table, own: Array) -> Edited:
    x, y, z = (own[0] * np.array(robot.gravity)).tolist()
    return robot.model_copy(update={"gravity": (x, y, z)}), table


def _drift(robot: Robot, table: Table, own: Array) -> Edited:
    """Tips that wander by own (3,) robot lengths over the campaign."""
    share = np.linspace(-0.5, 0.5, len(table))
    return robot, table.replaced({a: table.get(a) - d * robot.length * share for a, d in zip("xyz", own, strict=True)})
