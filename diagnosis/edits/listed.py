"""The list of edits: possible mistakes in a robot.yaml or a table, with prior probabilities and messages.

Priors are shares of the descriptions that are wrong, by a rough count of those that other laboratories sent; of an edit that
exists for each chamber, pair or trial, the share is divided by their number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import permutations, product

import numpy as np
import scipy

from model.effects import CATALOGUE, ForwardModel, design_from_columns
from model.errors import ModelError
from model.robot import Robot
from model.rotation import CONJUGATE, from_vector, multiply, to_base, turn_onto
from model.section import body_mass
from recordings.trials import NO_MOUNT, TIP, Mapped, Table

from .. import judgement, remedies
from ..arrays import Array
from ..data.plausible import FARTHEST, METRES, NEWTONS, PASCALS, SAME_RATIO, USUAL_PRESSURE, misread, pairs_near
from ..remedies import listed
from .edit import AREA, AZIMUTH, GRAVITY, MODULUS, ORIGIN, WIDEST, Edit, Mistake, Says, Variants, mistake, stating, times
from .misfit import Fit, Sample
from .order import SAME, apart, equal, order_at, swaps

EIGHTHS = tuple((k * np.pi / 4,) for k in (0, 1, -1, 2, -2, 3, -3, 4))
"""rad, azimuths that may be off: a body that bends far finds its own from no more than an eighth of a turn away."""
GAINS = (2.0, 6.895, 1e2, 1e3, 6895.0, 1 / 6.895, 1e-2, 1e-3, 1 / 6895.0)
"""Factors at which fits of one column's scale begin."""
SMALL, LARGE = 20e3, 500e3
"""Pa: soft robots hold more than the first in a larger unit than Pa, and less than the second."""
EFFECT = 6.0
"""Prior standard deviations of a parameter within which an effect competes."""
RIGHT = np.pi / 2
"""rad by which gravity's direction may be off: farther, its sign or its axis is."""
AXES = np.eye(3)
FRAMES = [np.diag(signs) @ AXES[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)]
"""Each way in which axes of a file can be those of the base."""
NO_TURN, ASKEW = np.array([1.0, 0.0, 0.0, 0.0]), 0.004
"""Identity; agreement (cosine of half an angle) that a tracked body turned by any angle must gain on turns by quarters."""
MIRROR = ("mirror", 6e-4)
"""Kind and prior of a frame of the other hand: cameras have none, only columns that were swapped or changed in sign."""


def every_edit(sample: Sample, near: Fit) -> list[Edit]:
    """Return the edits that apply to this robot and table; `near`: the robot as described."""
    of_table = *_of_frame(sample, near), *of_attitudes(sample, near), *_of_columns(sample)
    return [*_of_robot(sample), *of_table, *_left_to_the_diagnosis(sample, near)]


# ------------------------------------------------------------------ robot.yaml
def _of_robot(sample: Sample) -> Iterator[Edit]:
    robot, arcs = sample.robot, sample.robot.marker_places()[:, 2]
    stiffer = tuple((area, stiff) for stiff in np.log([2, 4, 9, 1 / 2, 1 / 4, 1 / 9]).tolist() for area in (0.0, stiff))
    says = partial(_stiffness, "youngs_modulus", 1e3, "kPa")
    yield Edit("modulus", 0.05, says, starts=stiffer, widens={AREA: WIDEST, MODULUS: WIDEST})
    if robot.bending_stiffness and robot.spine is None:
        tenfold = tuple((share * WIDEST,) for share in (0.75, -0.75))
        apply, widest = lambda v, own: replace(v, bending=v.bending * np.exp(own)), ((-WIDEST, WIDEST),)
        yield Edit("modulus", 0.02, partial(_stiffness, "bending_stiffness", 1.0, "N m^2"), apply, tenfold, widest)
    for sense, prior in ((1, 0.05), (-1, 0.03)):  # chambers turned, and counted the other way round, from the first one
        counted = partial(lambda s, v, _: replace(v, azimuth=s * v.azimuth + (1 - s) * v.azimuth[..., :1]), sense)
        # an eighth more than half a turn, as a fit that begins there may end beyond
        yield Edit("order", prior, partial(_azimuths, sense), counted, EIGHTHS, widens={AZIMUTH: 1.25 * np.pi})
    given, size = np.array(robot.gravity), float(np.linalg.norm(robot.gravity))
    known, signs = [given], ((0.01, given * each) for each in product((1.0, -1.0), repeat=3))
    for prior, down in ((0.03, -given), *signs, *((0.005, sign * size * axis) for axis in AXES for sign in (1, -1))):
        if min(np.linalg.norm(down - other) for other in known) > 0.1 * size:
            known.append(down)
            yield Edit("gravity", prior, gravity_says(robot, down), partial(gravity_along, down))
    around = tuple((float(a), float(b)) for a, b in np.radians([(15, 0), (-15, 0), (0, 15), (0, -15)]))
    anywhere = tuple((times * a, times * b) for times in (1, 4) for a, b in around)
    across = scipy.linalg.null_space(given[None]).T[:2]  # of no gravity any
    apply, within = lambda v, own: v.with_gravity_turned(from_vector(own @ across)), ((-RIGHT, RIGHT),) * 2
    yield Edit("gravity", 0.01, partial(_gravity_says, across), apply, anywhere, within)
    yield Edit("tilt", 0.03, _tilt_says, _tilt, around, ((-0.9, 0.9),) * 2)
    yield Edit(
        "length", 0.03, _length, lambda v, own: replace(v, stretch=v.stretch * (1 + own)), ((-0.05,), (0.05,)), ((-0.25, 0.35),)
    )
    for k in np.flatnonzero(np.isfinite(sample.described.markers).any(axis=(0, 1, 3))).tolist():
        moved = partial(lambda which, v, own: replace(v, arcs=v.arcs + own[:, None] * which), np.eye(len(arcs))[k])
        starts, bounds = ((-0.05 * robot.length,), (0.05 * robot.length,)), ((-arcs[k], robot.length - arcs[k]),)
        yield Edit(f"arc {k}", 0.03 / len(arcs), partial(_arc, k), moved, starts, bounds)


def _stiffness(name: str, size: float, unit: str, robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    change, given = float(own[0] if own.size else theta[MODULUS]), getattr(robot, name) / size
    limit = ", the limit of the fit: another number is wrong too" * (abs(change) > judgement.EDIT_AT_BOUND * WIDEST)
    said = mistake("refitted", name, name=name, given=given, found=given * float(np.exp(change)), unit=unit, limit=limit)
    return [said] if abs(change) > judgement.EDIT_USUAL[MODULUS] else []


def _azimuths(sense: int, robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    given, turn, words = np.array(robot.actuators.azimuths_deg), float(np.degrees(theta[AZIMUTH])), robot.actuators.words
    quarter = 90.0 * round(turn / 90.0)
    whole = quarter if abs(turn - quarter) < judgement.EDIT_LEAST_TILT else round(turn)
    found = (sense * given + (1 - sense) * given[0] + whole) % 360
    order = order_at(robot, found)
    alike, of_two = bool(order) and equal(robot, order), order in swaps(len(given)).values()
    if sense < 0:
        if alike and of_two:
            return _exchanged_say(order, robot)
        how = short = words.fill("{actuators} counted the other way round")
        as_stated = given[order] if of_two else -given  # in the other sense
        found = as_stated if (apart(found, as_stated) < SAME).all() else found
    else:
        from_where = ", counted from the opposite direction" * (abs(whole) == 180.0)
        how, short = f"all azimuths are {abs(whole):.0f} deg off{from_where}", words.fill("azimuths of the {actuators}")
    whose = " ".join(str(k + 1) for k in order)
    how += words.fill(f", or {{actuators}} 1 to {len(order)} receive the {{pressures}} of {whose}") * alike
    said = mistake("azimuths_elsewhere", short, how=how, given=given[0], found=found[0], line=listed(found))
    return [said] if sense < 0 or abs(theta[AZIMUTH]) > judgement.EDIT_USUAL[AZIMUTH] else []


def _exchanged_say(order: Sequence[int], robot: Robot, *_: Array) -> list[Mistake]:
    """State that two actuators get each other's pressures, (actuators,) indices, and the remedies that predict the same."""
    first, second = (k + 1 for k, other in enumerate(order) if k != other)
    remedy = f"swap p{first} and p{second} in the table or in its map"
    remedy += ", or their azimuths_deg in robot.yaml" * equal(robot, order)
    return [mistake("actuators_exchanged", "order of the {actuators}", first=first, second=second, remedy=remedy)]


def gravity_along(down: Array, v: Variants, own: Array, tip: Array | float = 0.0, markers: Array | float = 0.0) -> Variants:
    """Gravity along `down`, the tip and the markers moved (m)."""
    return replace(v, gravity=np.broadcast_to(down, v.gravity.shape), tip=v.tip + tip, markers=v.markers + markers)


def gravity_says(robot: Robot, down: Array, short: str = "gravity") -> Says:
    """State that gravity points along `down` (m/s^2)."""
    return stating("gravity_elsewhere", short, found=listed(down), given=listed(robot.gravity))


def _gravity_says(across: Array, robot: Robot, theta: Array, own: Array) -> Sequence[Mistake]:
    down = to_base(from_vector(own @ across), np.array(robot.gravity))
    turned = np.linalg.norm(own) > judgement.EDIT_USUAL[GRAVITY].max()
    return gravity_says(robot, down, "direction of gravity")(robot, theta, own) if turned else ()


def _tilt(v: Variants, own: Array) -> Variants:
    """Base turned by own (v, 2) rad about x and y: places as the level base would have them, gravity as the tilted one has it."""
    turn = from_vector(-np.pad(own, ((0, 0), (0, 1))))
    return v.with_gravity_turned(turn).turned(turn)


def _tilt_says(robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    x, y = np.degrees(own)
    each = [f"{abs(v):.0f} deg about {'-' if v < 0 else ''}{axis}" for v, axis in ((x, "x"), (y, "y")) if abs(v) >= 1]
    said = mistake("base_tilted", "tilt of the base", about=" and ".join(each), given=listed(robot.gravity))
    return [said] if np.hypot(x, y) >= judgement.EDIT_LEAST_TILT else []


def _length(robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    given = 1e3 * robot.length
    return [mistake("length_differs", "length", given=given, found=given * (1 + float(own[0])), unit="mm")]


def _arc(k: int, robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    places = robot.marker_places()
    given, places[k, 2] = 1e3 * places[k, 2], places[k, 2] + own[0]
    line, found = ", ".join(map(remedies.marker_entry, places)), 1e3 * places[k, 2]
    return [mistake("arc_differs", "a marker's arc length", number=k + 1, given=given, found=found, line=line)]


def _origin(mapped: Mapped | None, robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    away, other_size = float(np.linalg.norm(theta[ORIGIN])), abs(theta[AREA] - theta[MODULUS]) > np.log(2)
    another_point = other_size and 0.3 < away < FARTHEST  # of the body: it moves less than the tip
    if another_point or not (np.abs(theta[ORIGIN]) > judgement.EDIT_USUAL[ORIGIN]).any():
        return []
    by = robot.length * theta[ORIGIN]
    (x, y, z), usual = np.round(1e3 * by, 1).tolist(), robot.length * float(judgement.EDIT_USUAL[ORIGIN][0])
    remedy = remedies.of_origin(mapped, by, usual)
    return [mistake("origin_elsewhere", "origin of the positions", x=x, y=y, z=z, remedy=remedy)]


# ------------------------------------------------------------------ the cameras' frame
def _of_frame(sample: Sample, near: Fit) -> Iterator[Edit]:
    seen, robot, mapped = sample.table.tip, sample.robot, sample.table.mapped
    tracked = sample.described.levered(1.0).tip[0]
    # from the robot as described, too: far off, a fit within usual bounds bends the rod to where the places are
    stated = sample.fitted([((), np.zeros_like(near.x))], 0)[0]
    starts = [fit.theta[ORIGIN] - np.median(fit.missed[: len(seen)], axis=0) / robot.length for fit in (near, stated)]
    widest = dict.fromkeys(range(5, 8), max(0.3, 2 * float(np.abs(starts).max())))
    yield Edit("origin", 0.03, partial(_origin, mapped), starts=tuple(tuple(s.tolist()) for s in starts), widens=widest)
    predicted = np.nan_to_num(sample.rods(sample.described).tip[0])
    turn = scipy.spatial.transform.Rotation.from_matrix(turn_onto(predicted, seen))
    for handed in (1, -1):
        axes = max((m for m in FRAMES if np.linalg.det(m) * handed > 0), key=lambda m: np.sum(predicted * (seen @ m.T)))
        if not np.array_equal(axes, np.eye(3)):
            sign = np.array([1.0, 1.0, handed])
            quaternion = scipy.spatial.transform.Rotation.from_matrix(np.diag(sign) @ axes).as_quat(scalar_first=True)
            kind, prior = ("frame", 0.006) if handed > 0 else MIRROR
            turned = partial(lambda q, s, v, own: v.framed(q[None]) if s[2] > 0 else v.turned(q[None], s), quaternion, sign)
            yield Edit(kind, prior, axes_say(axes, mapped), turned)
    start = tuple(turn.inv().as_rotvec().tolist())
    bounds = ((-4.0, 4.0),) * 3  # rad
    yield Edit("frame", 0.02, partial(_turn_says, mapped), lambda v, own: v.framed(from_vector(-own)), (start,), bounds)
    for unit, wrong in permutations(METRES, 2):
        factor = METRES[unit] / METRES[wrong]
        if 0.5 < factor * np.median(np.linalg.norm(tracked, axis=1)) / robot.length < 1.6:
            remedy = remedies.of_columns(list("xyz"), unit.replace("inches", "in"), mapped)
            remedy += ", and for its points" if sample.described.markers.size else ""
            says = stating("places_in_unit", "unit of the positions", unit=unit, wrong=wrong, factor=factor, remedy=remedy)
            yield Edit("unit", 0.01, says, times(factor, "tip", "markers"), enlarges=factor)
    for trial in _steps(sample, near.missed[: len(seen)]):
        share = 0.03 / len(np.unique(sample.table.trial))
        moved = partial(lambda trial, v, own: v.moved(-own[:, None] * (v.table.trial >= trial)[:, None]), trial)
        bound = ((-0.3 * robot.length, 0.3 * robot.length),) * 3
        yield Edit("step", share, partial(_step_says, trial), moved, ((0.0, 0.0, 0.0),), bound, of_this_campaign=True)


def _turn_says(mapped: Mapped | None, robot: Robot, theta: Array, own: Array) -> Sequence[Mistake]:
    turn = scipy.spatial.transform.Rotation.from_rotvec(own)
    tilted = turn.magnitude() >= np.radians(judgement.EDIT_LEAST_TILT)
    return axes_say(turn.inv().as_matrix(), mapped, turn.inv())(robot, theta, own) if tilted else []


def axes_say(axes: Array, mapped: Mapped | None, turn: scipy.spatial.transform.Rotation | None = None) -> Says:
    """State the frame's angle and axis, and what to write; `axes` (3, 3), and `turn` without a mirror, lead to the base."""
    handed = np.round(np.linalg.det(axes))
    back = (turn or scipy.spatial.transform.Rotation.from_matrix(handed * axes)).inv().as_rotvec()
    angle = float(np.linalg.norm(back))
    nearest = max(FRAMES, key=lambda m: float(np.sum(m * axes)))
    aligned = float(np.sum(nearest * axes)) > 1 + 2 * np.cos(np.radians(10.0)) and not np.array_equal(nearest, np.eye(3))
    remedy, short = remedies.of_frame(nearest if aligned else axes, mapped), "the cameras' frame"
    if handed < 0:
        return stating("frame_mirrored", short, remedy=remedy)
    return stating("frame_turned", short, angle=float(np.degrees(angle)), about=listed(back / max(angle, 1e-12)), remedy=remedy)


def _steps(sample: Sample, missed: Array) -> list[int]:
    """Numbers of the trials from which on tips are most elsewhere than the repeats before: two at most."""
    trials = np.unique(sample.table.trial)
    count = np.bincount(sample.condition)
    explained = []
    for trial in trials[1:]:
        late = (sample.table.trial >= trial).astype(float)
        late -= (np.bincount(sample.condition, late) / count)[sample.condition]  # from the mean of its condition
        explained.append(float(((late @ missed) ** 2).sum() / (late @ late)) if late @ late > 0.1 else 0.0)
    order = np.argsort(explained)[::-1][:2]
    return [int(trials[1:][k]) for k in order if explained[k] > 0]


def _step_says(trial: int, robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    x, y, z = (1e3 * own).tolist()
    mm, by = float(1e3 * np.linalg.norm(own)), f"({x:.1f}, {y:.1f}, {z:.1f}) mm"
    return [mistake("frame_moved", "the cameras' frame", mm=mm, trial=trial, by=by)]


# ------------------------------------------------------------------ attitudes
def of_attitudes(sample: Sample, near: Fit) -> Iterator[Edit]:
    """The way in which attitudes are written that agrees best with the rods of a fit."""
    edited = sample.edited([(near.edits, near.x[None])])
    measured, predicted = edited.orientation, sample.rods(edited).orientation
    if not np.isfinite(measured * predicted).any():
        return

    def agrees(way: Callable[[Array], Array]) -> float:
        return float(np.nanmean(np.abs((predicted * way(measured)).sum(axis=-1))))

    known, mapped = np.isfinite(measured * predicted).all(axis=-1), sample.table.mapped
    read, stands = (scipy.spatial.transform.Rotation.from_quat(q[known], scalar_first=True) for q in (measured, predicted))
    mount = (read.inv() * stands).mean().as_quat(canonical=True, scalar_first=True)
    ways = dict(_attitudes(mapped))
    best, askew = max(ways, key=lambda remedy: round(agrees(ways[remedy]), 3)), partial(_framed, NO_TURN, mount)
    if agrees(askew) > agrees(ways[best]) + ASKEW:
        ways[best := remedies.of_mount(mount, mapped)] = askew
    says = stating("attitudes_elsewhere", "the tip's orientation", remedy=best)
    yield Edit("attitude", 0.03, says, lambda v, _: replace(v, orientation=ways[best](v.orientation)))


def _attitudes(mapped: Mapped | None) -> Iterator[tuple[str, Callable[[Array], Array]]]:
    """Remedies and the resulting orientations (.., 4), the simplest first."""
    base = scipy.spatial.transform.Rotation.from_matrix((mapped or Mapped()).axes)
    onto, mount = base.as_quat(scalar_first=True), np.array((mapped or Mapped()).mount or NO_MOUNT)
    after = multiply(onto * CONJUGATE, mount / np.linalg.norm(mount))

    def reordered(held: list[int], read: Array) -> Array:
        return _framed(onto, after, _framed(onto * CONJUGATE, after * CONJUGATE, read)[..., held])

    for order, held in {"xyzw": [3, 0, 1, 2], "wxyz": [1, 2, 3, 0]}.items():
        yield remedies.of_order(order, mapped), partial(reordered, held)
    yield "change the sign of qx, qy and qz", partial(np.multiply, CONJUGATE)
    of_axes = (turns := scipy.spatial.transform.Rotation.create_group("O")), base.inv() * turns * base
    for turn, of_file in zip(*(q.as_quat(canonical=True, scalar_first=True) for q in of_axes), strict=True):
        left, right = (listed(q, 3) for q in (of_file, of_file * CONJUGATE))
        yield f"multiply each quaternion from the left by {left}", partial(_framed, turn, NO_TURN)
        yield remedies.of_mount(turn, mapped), partial(_framed, NO_TURN, turn)
        both = f"multiply each quaternion from the left by {left} and from the right by {right}"
        yield both, partial(_framed, turn, turn * CONJUGATE)


def _framed(left: Array, right: Array, orientation: Array) -> Array:
    return multiply(multiply(left, orientation), right)


# ------------------------------------------------------------------ columns of pressure
def _of_columns(sample: Sample) -> Iterator[Edit]:
    pressures, mapped, robot = sample.table.pressures, sample.table.mapped, sample.robot
    highest, columns = np.abs(pressures).max(axis=0), range(pressures.shape[1])
    given, words = robot.actuators.azimuths_deg, robot.actuators.words
    apart = np.abs(pressures[:, :, None] - pressures[:, None]).max(axis=0) > 0.1 * highest.max()
    pairs = {pair: order for pair, order in swaps(len(highest)).items() if apart[pair]}
    for (i, j), order in pairs.items():
        same, line = equal(robot, order), listed(np.take(given, order))
        share = 0.04 / len(pairs) / (1 if same else 2)
        exchanged = partial(lambda order, v, _: replace(v, pressure=v.pressure[:, :, order]), order)
        yield Edit("order", share, partial(_exchanged_say, order), exchanged)
        if not same:
            how = words.fill("azimuths of {actuators} {} and {} are swapped", str(i + 1), str(j + 1))
            says = stating("azimuths_elsewhere", how, how=how, given=given[i], found=given[j], line=line)
            yield Edit("order", share, says, partial(lambda order, v, _: replace(v, azimuth=v.azimuth[:, :, order]), order))
    driven, widest = np.flatnonzero(highest > 0), float(np.log(2e5))
    for k in driven.tolist():
        share, others = 1 / len(driven), highest[driven[driven != k]]
        if highest[k] >= 0.02 * highest.max():
            dead = stating("actuator_dead", f"{{actuator}} {k + 1}", number=k + 1)
            yield Edit(f"gain {k}", 0.04 * share, dead, partial(_gain, [k], 0.0))
        excess = highest[k] / (np.median(others) if others.size else highest[k])
        if starts := tuple((float(np.log(gain)),) for gain in GAINS if 0.1 < gain * excess < 10):
            says, apply = partial(_gain_says, mapped, k), partial(_gain, [k], 1.0)
            yield Edit(f"gain {k}", 0.03 * share, says, apply, starts, ((-widest, widest),))
    for sign, bounds in ((1.0, (np.log(30.0), widest)), (-1.0, (-widest, -np.log(30.0)))):
        starts = tuple((sign * float(np.log(factor)),) for factor in (1e2, 1e3, 6895.0, 1e5))
        if highest.max() < SMALL if sign > 0 else highest.max() > LARGE:
            prior, most = 0.3 if mapped is not None and mapped.unit == "" else 0.03, float(highest.max())
            yield Edit("pressures", prior, partial(_all_say, mapped, most), partial(_gain, columns, 1.0), starts, (bounds,))
    if 0 < np.abs(sample.table.get("roll_deg", 0.0)).max() < 2 * np.pi + 0.01:
        yield Edit("roll", 0.03, stating("roll_in_rad", "column roll_deg"), lambda v, _: replace(v, roll=np.degrees(v.roll)))


def _gain(columns: Sequence[int], factor: float, v: Variants, own: Array) -> Variants:
    pressure = v.pressure.copy()
    pressure[:, :, [*columns]] *= factor * np.exp(own.sum(axis=1))[:, None, None]
    return replace(v, pressure=pressure)


def _gain_says(mapped: Mapped | None, k: int, robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    factor, sizes = float(np.exp(own[0])), NEWTONS if robot.chambers is None else PASCALS
    if 1 / judgement.EDIT_USUAL_GAIN < factor < judgement.EDIT_USUAL_GAIN:
        return []
    alike = pairs_near(factor, sizes, SAME_RATIO)
    looks = " or ".join(map(" read as ".join, alike)) or "another unit"
    heading = remedies.heading(f"p{k + 1}", mapped)
    remedy = remedies.of_columns([f"p{k + 1}"], alike[0][0] if len(alike) == 1 else "", mapped)
    return [mistake("column_in_unit", f"column {heading}", heading=heading, factor=factor, looks=looks, remedy=remedy)]


def _all_say(mapped: Mapped | None, most: float, robot: Robot, theta: Array, own: Array) -> list[Mistake]:
    factor, usual = float(np.exp(own[0] + theta[AREA])), robot.highest_limit or USUAL_PRESSURE
    units = misread(robot, mapped)
    ratio = min(units, key=lambda ratio: np.log(ratio / factor) ** 2 + np.log(ratio * max(most, 1.0) / usual) ** 2)
    looks, remedy = remedies.misread_by(ratio, robot, mapped)
    return [mistake("pressures_in_unit", "unit of the {pressures}", factor=ratio, looks=looks, remedy=remedy)]


# ------------------------------------------------------------------ what the diagnosis names itself
def _left_to_the_diagnosis(sample: Sample, near: Fit) -> Iterator[Edit]:
    robot = sample.robot
    mass = max(body_mass(robot), 1e-6)
    starts = tuple((share * mass,) for share in (-0.3, 0.3, 1.2))
    yield Edit("weight", 0.1, apply=lambda v, own: replace(v, mass=np.maximum(v.mass + own, 0.0)), starts=starts,
               bounds=((-robot.tip_mass - mass, 3 * mass),), left=True)  # fmt: skip
    yield Edit("weight", 0.1, apply=lambda v, own: replace(v, gravity=own[:, :, None] * v.gravity),
               starts=((0.6,), (1.6,), (2.5,)), bounds=((0.3, 3.0),), left=True)  # fmt: skip
    wander = np.eye(3)[:, None] * robot.length * np.linspace(-0.5, 0.5, len(sample.table))[:, None]  # over the campaign
    yield Edit("drift", 0.2, apply=partial(_effect, wander), starts=((0.0,) * 3,), bounds=((-0.1, 0.1),) * 3, left=True)
    count, gain = len(robot.actuators.azimuths_deg), np.log(judgement.EDIT_USUAL_GAIN)
    for k in range(count):
        yield Edit(f"gain {k}", 0.1 / count, apply=partial(_gain, [k], 1.0), starts=((0.0,),), bounds=((-gain, gain),), left=True)
    signatures = _signatures(*sample.edited([((), near.x[None])]).written())
    for slope, bounds in signatures:
        apply = partial(_effect, slope)
        yield Edit("effect", 0.3 / len(signatures), apply=apply, starts=((0.0,) * len(slope),), bounds=bounds, left=True)


def _signatures(robot: Robot, table: Table) -> list[tuple[Array, tuple[tuple[float, float], ...]]]:
    """Of each effect of the catalogue that shows: (k, n, 3) m by which tips move with its k parameters, to first order and for
    one prior standard deviation of each, and their bounds in such."""
    try:
        design = design_from_columns(robot, {name: table[name] for name in table.columns}, TIP)
        shown = {id: spec for id, spec in CATALOGUE.items() if spec.shown is None or spec.shown(robot, design)}
        forward = ForwardModel(robot, design, "one", shown)
        wanted = [k for id in shown for k in forward.index(id)]
        slope = dict(zip(wanted, np.nan_to_num(forward.linearise(np.zeros(len(forward.parameters)), wanted)[1]).T, strict=True))
    except ModelError:  # a table so far off that nothing shows an effect
        return []
    out = []
    for id in shown:
        infos = [(k, forward.parameters[k]) for k in forward.index(id) if slope[k].any()]
        if infos:
            moved = np.stack([slope[k].reshape(-1, 3) * info.sd for k, info in infos])
            out.append((moved, tuple((max(p.low / p.sd, -EFFECT), min(p.high / p.sd, EFFECT)) for _, p in infos)))
    return out


def _effect(slope: Array, v: Variants, own: Array) -> Variants:
    """Places without the moves (k, n, 3) m of own (v, k) parameters."""
    return v.moved(-np.einsum("vk,kni->vni", own, slope))
