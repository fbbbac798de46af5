"""Find the tip's columns, frame and orientation from headings, numbers and the robot.

How the tip moves is held against the model of robot.yaml, whose pressures are scaled so that it moves as far. The agreement of a
frame is the cosine between both movements from rest, over all rows; it is free of where the cameras have their origin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.data.campaign import spread_over
from model.arrays import Array, Ints, Mask
from model.condition import HIGHEST_PRESSURE
from model.prediction import Prediction, Predictor
from model.robot import Robot
from recordings.trials import AXES

from ..files.config import ConfigError
from ..files.jumps import at_rest
from ..files.map_file import Frame, Order, Orientation, units_for
from ..files.units import KINDS
from .headings import BASE_WORDS, TIP_WORDS, Heading, Triple, heading, own_column, quantity, triples
from .joining import JOIN
from .proposal import Guess
from .quantities import clearly_worse, misfits
from .series import Series, unit_in, unseen

ORDERS_IN_WORDS = (
    "small letters turn about fixed axes (extrinsic, as in SciPy), capitals about axes that turn with the body (intrinsic); "
    "Universal Robots' arms write a rotation vector"
)
NO_ORDER_FITS = 10.0
"""Deg (rms) that the tip may turn about other axes than that of its bending under the best order of three angles."""
FITS = 1.5
"""Largest factor between the resting tip's distance and the robot's length that identifies a unit of length."""
AXES_OF_BASE = "axis of the robot's base (z from base to tip): axis of the file"
MOST_ROWS = 60
"""Rows that are compared with the model."""
CLEAR, OF_MODEL = 2.0, 0.02
"""Times less that a clear frame lacks of full agreement than another, and what models of robots lack anyway."""
AGREES = 0.9
"""Agreement from which a frame is not doubted."""
AT_BASE, EXACT = 0.25, 0.05
"""Share of a length by which the resting body may lie elsewhere where the origin is at the base, and where it surely is."""


@dataclass(frozen=True)
class Tip:
    """The columns taken for the tip."""

    columns: tuple[str, ...]
    places: Array
    """(n, 3) m, in the recorded axes, against the base where one is recorded."""
    resting: Mask
    """(n,) rows with the lowest pressures and a place."""
    mentioned: tuple[str, ...]
    """Columns of all places, used or not."""


@dataclass(frozen=True)
class Driven:
    """What drives the robot in n rows."""

    pressures: Array
    """(n, actuators) Pa above the lowest of each; (n, 0) where they are unknown."""
    roll: Array
    """(n,) deg by which the body is turned in its mount."""
    mass: float | None
    """kg that hang there at rest, where the file says so."""

    def predicted(self, robot: Robot, rows: Ints, size: float = 1.0) -> Prediction:
        """Where the model has tip and markers in m rows, with pressures of another size."""
        known = self.pressures if self.pressures.shape[1] else np.zeros((len(self.pressures), len(robot.actuators.azimuths_deg)))
        pressures = np.clip(size * known[rows], 0.0, HIGHEST_PRESSURE)
        unlimited = robot.model_copy(update={"max_pressure": None})  # of which nothing is asked here
        return Predictor(unlimited)(pressures, tip_mass=self.mass, roll=np.radians(self.roll[rows]))


def guess_tip(g: Guess, series: Series, headings: Sequence[Heading], robot: Robot) -> Tip:
    """Propose the tip's columns, markers, frame and where the straight robot is; raises ConfigError where there is no tip."""
    candidates = [t for t in triples(headings) if all(c in series.numbers for c in t.columns)]
    candidates = [t for t in candidates if t.unit in ("", *KINDS["m"])]
    if not candidates:
        raise ConfigError(
            f"{series.path}: found no columns x, y, z of a tip; there are "
            f"{', '.join(map(repr, series.names[:12]))}. If they are in another file, give both, or {JOIN}; else write map.yaml "
            "by hand, of pixels with `scale` and of one camera with `constants` (docs: data from elsewhere)"
        )
    tips, bases = (_whole([t for t in candidates if t.words & words]) for words in (TIP_WORDS, BASE_WORDS))
    if not tips:
        unnamed = _whole([t for t in candidates if t not in bases]) or candidates
        tips = [max(unnamed, key=lambda t: _spread(_xyz(series, t)))]
        if len(unnamed) > 1:
            g.doubt("columns.x", f"no heading names a tip; {' / '.join(tips[0].columns)} move most")
    bases = [t for t in bases if t not in tips] or _still(g, series, [t for t in candidates if t not in tips], tips[0])
    pressures = proposed_pressures(g, series, robot)
    rest = at_rest(pressures) if pressures.shape[1] else np.ones(len(series), bool)
    unit_of = {c: unit_in(series, c, KINDS["m"]) for t in (*tips, *bases) for c in t.columns}
    tip_unit = unit_of[tips[0].columns[0]]
    tip = np.mean([_xyz(series, t, rest, tip_unit) for t in tips], axis=0)
    base = np.mean([_xyz(series, t, rest, tip_unit) for t in bases], axis=0) if bases else np.zeros(3)
    from_base = tip - base
    has_place = np.isfinite(from_base).all(axis=1)
    if not has_place.any():
        raise ConfigError(
            f"{series.path}: {' / '.join(tips[0].columns)}: no row has a position; write map.yaml by hand (docs: data from "
            "elsewhere)"
        )
    rests = bool((rest & has_place).any())
    total = pressures.sum(axis=1)
    total = np.where(has_place & np.isfinite(total), total, np.inf)
    rest = has_place & (rest if rests else total <= total.min())
    unit, why = _length_unit(g, tip_unit, tips[0], from_base[rest], robot.length)
    names = [c for t in tips for c in t.columns]
    if bases or len(tips) > 1:
        g.say("points.tip.of", [list(t.columns) for t in tips], f"{len(tips)} group(s) of columns that move with the tip")
        if bases:
            g.say("points.tip.against", [list(t.columns) for t in bases], "they are at the base")
            names += [c for t in bases for c in t.columns]
        if len(set(unit_of.values())) == 1:  # else each column is read in its own
            g.say("points.tip.unit", unit, why)
    else:
        for axis, column in zip("xyz", tips[0].columns, strict=True):
            reason = f"the file says {unit_of[column]} of {column!r}" if unit_of[column] else why
            g.say(f"columns.{axis}", {"column": column, "unit": unit_of[column] or unit}, reason)
    other_places = [t for t in candidates if t not in tips and t not in bases]
    # as many other places as robot.yaml has markers are these markers: the less one moves, the nearer it is to the base
    markers = {t: _xyz(series, t, rest, tip_unit) - base for t in other_places} if len(other_places) == len(robot.markers) else {}
    markers = dict(sorted(markers.items(), key=lambda place: _spread(place[1])))
    moves = _spread(from_base)
    size = KINDS["m"][unit]
    # NaN of a marker that is never seen at rest
    resting = [np.ma.masked_invalid(m[rest]).mean(axis=0).filled(np.nan) * size for m in markers.values() if _spread(m) < moves]
    in_m = from_base * size
    own = pressures if pressures.shape[1] == len(robot.actuators.azimuths_deg) else pressures[:, :0]
    mounted = [h.name for h in headings if own_column(h) == "roll_deg" and not changes_throughout(series.numbers[h.name])]
    in_deg = [KINDS["deg"].get(unit_in(series, name, KINDS["deg"]), 1.0) for name in mounted[:1]]
    roll = np.nan_to_num(series.numbers[mounted[0]]) * in_deg[0] if mounted else np.zeros(len(series))
    driven = Driven(own - np.nanmin(own, axis=0, initial=np.inf), roll, _mass_at_rest(series, rest))
    _guess_frame(g, in_m, rest, resting, robot, rests, driven)
    for k, t in enumerate(markers, 1):
        g.say(f"points.m{k}.of", [list(t.columns)], "in the order of their motion; the one nearest to the base moves least")
        if bases:
            g.say(f"points.m{k}.against", [list(b.columns) for b in bases], "as the tip")
        if not unit_in(series, t.columns[0], KINDS["m"]):
            g.say(f"points.m{k}.unit", unit, "as the tip")
    if len(markers) > 1:
        g.doubt("points.m1", f"{len(markers)} markers found, m1, m2 .. assigned by how far they move; check the order")
    elif other_places and not markers:
        g.doubts.append(
            f"not used: {', '.join('/'.join(t.columns) for t in other_places)}; markers along the body go under points.m1 .."
        )
    return Tip(tuple(names), in_m, rest, tuple(c for t in candidates for c in t.columns))


def _still(g: Guess, series: Series, others: Sequence[Triple], tip: Triple) -> list[Triple]:
    """The one point that is fixed while the tip moves."""
    moves = _spread(_xyz(series, tip))
    still = [t for t in others if t.unit == tip.unit and _spread(_xyz(series, t)) < 0.02 * moves]
    # near zero they are standard deviations, or a base that changes nothing
    still = [t for t in still if np.nanmax(np.abs(_xyz(series, t))) > 0.02 * moves]
    if len(still) != 1:
        return []
    g.doubt("points.tip.against", f"{' / '.join(still[0].columns)} does not move: taken for a marker at the base")
    return still


def _whole(found: Sequence[Triple]) -> list[Triple]:
    """Bodies rather than their markers, where both are there."""
    return [t for t in found if not any(w.startswith("marker") for w in t.words)] or list(found)


def _xyz(series: Series, t: Triple, rest: Mask | None = None, unit: str = "") -> Array:
    """(n, 3) of the file's numbers, without rows in which nothing was seen; in `unit` where the file states others."""
    length = KINDS["m"]
    factors = [length[said] / length[unit] if unit and (said := unit_in(series, c, KINDS["m"])) else 1.0 for c in t.columns]
    found = np.column_stack([series.numbers[c] * f for c, f in zip(t.columns, factors, strict=True)])
    return np.where(unseen(found, rest)[:, None], np.nan, found)


def _spread(found: Array) -> float:
    """How far places (n, 3) move: their standard deviation, summed over the axes."""
    seen = found[np.isfinite(found).all(axis=1)]
    return float(seen.std(axis=0).sum()) if len(seen) else 0.0


def proposed_pressures(g: Guess, series: Series, robot: Robot) -> Array:
    """(n, chambers) Pa of the columns proposed for the chambers, 0 of one without; (n, 0) if none has a column."""
    columns, units = g.values.get("columns", {}), units_for("p1", robot.actuators.words)
    pressures = np.zeros((len(series), len(robot.actuators.azimuths_deg)))
    proposed = {k: c for k in range(pressures.shape[1]) if (c := columns.get(f"p{k + 1}"))}
    for k, c in proposed.items():
        pressures[:, k] = series.numbers[c["column"]] * units[c["unit"]]
    return pressures if proposed else pressures[:, :0]


def _length_unit(g: Guess, said: str, t: Triple, rest: Array, length: float) -> tuple[str, str]:
    if said:
        return said, f"the file says {said} of {t.columns[0]!r}"
    far = float(np.nanmedian(np.linalg.norm(rest, axis=1)))
    times = {unit: max(far, 1e-9) * KINDS["m"][unit] / length for unit in ("m", "cm", "mm")}
    best = min(times, key=lambda unit: abs(np.log(times[unit])))
    why = f"at rest the tip is {far:.4g} from the origin, the robot is {length:g} m long"
    if not 1 / FITS < times[best] < FITS:
        g.doubt("columns.x", f"the file states no unit; {best} is a guess: {why}")
    return best, why


def _mass_at_rest(series: Series, rest: Mask) -> float | None:
    """kg that hang at the tip in the rows at rest, where a column of the file says so; else None."""
    for name, values in series.numbers.items():
        h = heading(name, series.units.get(name, ""))
        unit = KINDS["kg"].get(h.unit, 1.0 if own_column(h) == "tip_mass" else None)
        if unit is not None and quantity(h) == "tip_mass" and np.isfinite(values[rest]).any():
            return float(np.nanmedian(values[rest])) * unit
    return None


def changes_throughout(angle: Array) -> bool:
    """Whether an angle changes between most rows rather than now and then."""
    steps = np.abs(np.diff(angle[np.isfinite(angle)]))
    return bool(len(steps) and (steps > 0).mean() > 0.5)


# ------------------------------------------------------------------ frame
def _guess_frame(g: Guess, tip: Array, rest: Mask, markers: Sequence[Array], robot: Robot, rests: bool, driven: Driven) -> None:
    """Propose the frame, right-handed, and `straight: at rest` where the tip rests elsewhere than the model; doubt what is not
    clear. z: the axis of the file along which the resting tip lies from the first marker; without one, that along which the
    body lies from the origin, unless the movement clearly contradicts, else that which fits the movement best. x, y: as the
    movement has them.

    `tip`: (n, 3) m; `rest`: (n,) rows with the lowest pressures, in which the robot `rests`; `markers`: (3,) m of those of
    robot.yaml in these rows."""
    at_rest = tip[rest].mean(axis=0)
    likeness = _likeness(tip, rest, robot, driven)
    turns = {z: max(_turned(z), key=lambda xy: round(_agreement(likeness, *xy, z), 3)) for z in ("z", "-z", "x", "-x", "y", "-y")}
    lack = {z: 1 - _agreement(likeness, *xy, z) for z, xy in turns.items()}
    # of frames with another hand: two columns of the tip or of the actuators are swapped
    swapped = {z: 1 - max(_agreement(likeness, y, x, z) for x, y in _turned(z)) for z in turns}
    least = {z: min(lack[z], swapped[z]) for z in turns}
    best = min(lack, key=(swapped if _clear(min(swapped.values()), min(lack.values())) else lack).__getitem__)
    model = driven.predicted(robot, _some(rest))
    # the body rests along an axis of the file from the origin: it sags least at its base, so the first marker shows it best
    lies = _straight_along(markers[0], float(np.linalg.norm(robot.marker_places()[0]))) if markers else None
    lies = lies or _straight_along(at_rest, robot.length)
    points = _points_along(at_rest, markers, robot, model)
    z = best if likeness.any() else _axis(at_rest)
    exact = abs(np.linalg.norm(at_rest) - np.linalg.norm(model.tip, axis=1).mean()) < EXACT * robot.length
    if points is not None and lies != best:  # a body that is bent at rest may point elsewhere
        z = points
    elif lies is not None and not _clear(least[best], least[lies]):  # swapped columns would explain the movement, too
        z = lies if exact or not _clear(lack[best], lack[lies]) else best
    (x, y), agreement = turns[z], 1 - lack[z]
    rival = min((other for other in lack if other != z), key=lack.__getitem__)
    compared = f"movement and model agree to {agreement:.2f} of 1, along {rival} to {1 - lack[rival]:.2f}"
    if points is not None and _clear(lack[best], lack[points]):
        g.doubt(
            "frame.z",
            f"at rest the tip lies along the file's {points} from the first marker, but it moves as if the base's z were its "
            f"{best}. The file's {z} is proposed ({compared}). Check whether {robot.actuators.words.actuators} are exchanged, "
            "and whether m1 is where robot.yaml states its marker",
        )
    elif points is None and lies not in (None, z):
        g.doubt(
            "frame.z",
            f"the resting tip lies along the file's {lies} from the origin, but the tip moves as if the base's z were its {z} "
            f"({compared}): the origin is taken to be elsewhere than the base",
        )
    elif not (points or lies and exact) and not _clear(lack[z], lack[rival]):
        text = "neither the resting tip nor its movement determines which axis points from base to tip"
        askew = "for a base that stands askew write directions along the file's axes, such as `z: [0.6, -0.8, 0]`"
        g.doubt("frame.z", f"{text}. The file's {z} fits best ({compared}); {askew}")
    sense = "away from the chambers inflated" if robot.tendons is None else "towards the tendons pulled"
    bends = f"the tip bends {sense} (agreement with the model {agreement:.2f} of 1)"
    if agreement < AGREES and driven.pressures.shape[1]:
        columns = " Two columns of the tip or of the actuators may be swapped." if _clear(swapped[z], lack[z]) else ""
        elsewhere = points is None and _clear(lack[best], lack[z])
        columns += f" Or the origin is not at the base, and its z is the file's {best}." if elsewhere else ""
        g.doubts.append(
            f"frame.x, frame.y: with the base's x along the file's {x} and its y along the file's {y} {bends}. This is the best "
            f"turn about the base's z, but the data do not force it.{columns} If base and cameras have not moved since an "
            "earlier table, copy the frame from its map"
        )
    if (x, y, z) != ("x", "y", "z"):
        start = "the first marker" if points == z else "the origin" if lies == z else ""
        shown_by = f"the resting tip lies there from {start}" if start else "the tip moves so"
        why = f"{AXES_OF_BASE}. Its z is the file's {z}, as {shown_by}; with these x and y {bends}"
        g.say("frame", {"x": x, "y": y, "z": z}, why)
    _straight(g, Frame(x=x, y=y, z=z).matrix @ at_rest, model.tip, robot, rests)


def _straight(g: Guess, at_rest: Array, stands: Array, robot: Robot, rests: bool) -> None:
    """Propose to move the resting tip, (3,) m in the base's axes, to where the model `stands`, (m, 3) m, if it is elsewhere."""
    stands = stands.mean(axis=0) if np.isfinite(stands).all() else np.array([0.0, 0.0, robot.length])
    # how far it sags or bends by robot.yaml's weight and stiffness may be half as much again
    if np.linalg.norm(at_rest - stands) <= 0.05 * robot.length + 1.5 * np.hypot(*stands[:2]):
        return
    found, expected = (", ".join(str(round(1e3 * v)) for v in place) for place in (at_rest, stands))
    which = "at rest" if rests else "the robot is at rest in no row with a tip. In those with the lowest pressures"
    text = f"{which} the recorded tip is at ({found}) mm along the base's axes; the model expects ({expected}) mm"
    g.say("straight", "at rest", f"{text}: the origin is probably not at the base")
    g.doubt(
        "straight",
        f"{text}. The origin is probably not at the base. `at rest` moves all points to the model's position in these states, "
        "which hides any error there. To see that error, measure the base position in camera coordinates and enter it as `zero` "
        "of columns x, y, z",
    )


# ------------------------------------------------------------------ movement
def _likeness(tip: Array, rest: Mask, robot: Robot, driven: Driven) -> Array:
    """(3, 3) sum over rows of the model's movement from rest by the tip's, (n, 3) m, over the sizes of both: the cosine between
    them where both are along the same axes. 0 where nothing moves, or the pressures are unknown."""
    known = np.isfinite(np.column_stack([tip, driven.pressures])).all(axis=1)
    rows, still, size = _some(known & ~rest), _some(known & rest), 1.0
    if not (driven.pressures.shape[1] and rows.size and still.size):
        return np.zeros((3, 3))
    moved, resting = tip[rows] - tip[still].mean(axis=0), driven.predicted(robot, still).tip.mean(axis=0)
    for _ in range(3):
        predicted = np.nan_to_num(driven.predicted(robot, rows, size).tip - resting)
        solved = predicted.any(axis=1)
        far, predicted_far = (float(np.linalg.norm(movement[solved])) for movement in (moved, predicted))
        if not far * predicted_far > 0:
            return np.zeros((3, 3))
        size *= float(np.clip(far / predicted_far, 1 / 8, 8))
    return np.asarray(predicted[solved].T @ moved[solved] / (far * predicted_far))


def _agreement(likeness: Array, *axes: str) -> float:
    """Cosine between movements where the base's x, y, z are these axes of the file."""
    return float(sum(row @ AXES[name] for row, name in zip(likeness, axes, strict=True)))


def _some(rows: Mask) -> Ints:
    """Numbers of some rows of a mask, evenly spread."""
    found = np.flatnonzero(rows)
    return found[spread_over(len(found), MOST_ROWS)] if len(found) else found


def _clear(lack: float, other: float) -> bool:
    """Whether a frame agrees clearly better than another."""
    return CLEAR * (lack + OF_MODEL) < other + OF_MODEL


def _turned(z: str) -> list[tuple[str, str]]:
    """x and y of the four right-handed frames with this z."""
    along = "xyz".index(z[-1])
    first, second = "xyz"[(along + 1) % 3], "xyz"[(along + 2) % 3]
    one, two = (second, first) if z.startswith("-") else (first, second)
    return [(one, two), (two, f"-{one}"), (f"-{one}", f"-{two}"), (f"-{two}", one)]


# ------------------------------------------------------------------ place
def _points_along(at_rest: Array, markers: Sequence[Array], robot: Robot, model: Prediction) -> str | None:
    """The axis of the file along which the tip rests from the first marker; None where their distance or that of the model,
    or the model's direction, is not that of a straight body."""
    if not markers:
        return None
    arc = float(np.linalg.norm(robot.marker_places()[0] - [0.0, 0.0, robot.length]))
    lines = at_rest - markers[0], (model.tip - model.shape[:, 0]).mean(axis=0)
    seen, expected = (_straight_along(line, arc) for line in lines)
    return seen if expected == "z" else None


def _straight_along(line: Array, arc: float) -> str | None:
    """The axis of the file along which a line, (3,) m, spans an arc of this length, m, of the body; None where it does not."""
    axis = _axis(line)
    across = np.linalg.norm(np.cross(line, AXES[axis]))
    return axis if abs(np.linalg.norm(line) - arc) < AT_BASE * arc and across <= 0.5 * arc else None


def _axis(place: Array) -> str:
    """The axis of the file on which a place is farthest from the origin, with its sign."""
    along = int(np.argmax(np.abs(place)))
    return "-" * bool(place[along] < 0) + "xyz"[along]


# ------------------------------------------------------------------ orientation
def guess_quaternion(g: Guess, series: Series, found: Sequence[tuple[str, str, str, str]], tip: Sequence[str]) -> None:
    for four in sorted(found, key=lambda f: -_shared(f, tip)):
        if not all(c in series.numbers for c in four) or set(heading(four[0]).words) & BASE_WORDS:
            continue
        values = np.column_stack([series.numbers[c] for c in four])
        norm = np.linalg.norm(values[np.isfinite(values).all(axis=1)], axis=1)
        if len(norm) and abs(float(np.median(norm)) - 1) < 0.02:
            g.say("orientation", {"columns": list(four), "order": "wxyz"}, "four columns w, x, y, z of norm 1")
            return


def _shared(columns: Sequence[str], tip: Sequence[str]) -> int:
    """Words that headings have in common with those of the tip."""
    return len(set(heading(columns[0]).words) & {w for name in tip for w in heading(name).words})


def guess_angles(g: Guess, series: Series, found: Sequence[Triple], tip: Tip) -> None:
    """Propose three angles as the tip's orientation, in the order that fits its bending best, with a doubt."""
    usable = [t for t in found if all(c in series.numbers for c in t.columns)]
    usable = sorted([t for t in usable if not t.words & BASE_WORDS], key=lambda t: -_shared(t.columns, tip.columns))
    if not usable or "orientation" in g.reasons:
        return
    three = usable[0]
    largest = float(np.nanmax(np.abs([series.numbers[c] for c in three.columns])))
    unit = three.unit or series.unit_of(three.columns[0], KINDS["deg"]) or ("deg" if largest > 2 * np.pi else "rad")
    orientation = Orientation.model_validate({"columns": three.columns, "order": "rotation vector", "unit": unit})
    frame = Frame(**g.values.get("frame", {})).matrix
    misfit_of = misfits(series, orientation, frame, tip.places @ frame.T, tip.resting)
    nearest: Order = min(misfit_of, key=misfit_of.__getitem__, default="euler xyz")
    order = nearest if misfit_of and clearly_worse(misfit_of["euler xyz"], misfit_of[nearest]) else "euler xyz"
    if three.words & {"rotvec", "vector", "axis"} or (unit == "rad" and nearest == orientation.order):
        order = orientation.order
    entry = {"columns": list(three.columns), "order": order, "unit": unit}
    g.say("orientation", entry, f"three angles, up to {largest:.4g} {unit}")
    fits = ", ".join(f"{deg:.1f} deg with {name}" for name, deg in misfit_of.items())
    misfits_text = f"; the tip turns about axes that differ from its bending axis by {fits}" if fits else ""
    remedy = f"Check the order: {ORDERS_IN_WORDS}"
    if min(misfit_of.values(), default=0.0) > NO_ORDER_FITS:
        remedy = "No order fits: two columns of the tip or of the actuators may be swapped, or the frame is wrong"
    g.doubt("orientation.order", f"{' / '.join(three.columns)} are taken as {order} in {unit}{misfits_text}. {remedy}")
