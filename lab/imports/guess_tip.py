"""Find the tip's columns, frame and orientation from headings, numbers and the robot."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from model.arrays import Array, Mask
from model.robot import Robot

from ..files.config import ConfigError
from ..files.units import KINDS
from .guess_frame import Driven, guess_frame
from .headings import BASE_WORDS, TIP_WORDS, Heading, Triple, heading, own_column, quantity, triples
from .joining import JOIN
from .map_file import Frame, Orientation, units_for
from .proposal import Guess
from .quantities import clearly_worse, misfits
from .series import Series, at_rest, unit_in, unseen

ORDERS_IN_WORDS = (
    "small letters turn about fixed axes (extrinsic, as in SciPy), capitals about axes that turn with the body (intrinsic); "
    "Universal Robots' arms write a rotation vector"
)
NO_ORDER_FITS = 10.0
"""Deg (rms) that the tip may turn about other axes than that of its bending under the best order of three angles."""
FITS = 1.5
"""Largest factor between the resting tip's distance and the robot's length that identifies a unit of length."""


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


def guess_tip(g: Guess, series: Series, headings: Sequence[Heading], robot: Robot) -> Tip:
    """Propose the tip's columns, markers, frame and where the straight robot is; raises ConfigError where there is no tip."""
    candidates = [t for t in triples(headings) if all(c in series.numbers for c in t.columns)]
    candidates = [t for t in candidates if t.unit in ("", *KINDS["m"])]
    if not candidates:
        raise ConfigError(
            f"{series.path}: found no columns x, y, z of a tip; there are "
            f"{', '.join(map(repr, series.names[:12]))}. If they are in another file, give both, or {JOIN}; else write map.yaml "
            "by hand (docs: data from elsewhere)"
        )
    tips, bases = (_whole([t for t in candidates if t.words & words]) for words in (TIP_WORDS, BASE_WORDS))
    if not tips:
        unnamed = _whole([t for t in candidates if t not in bases]) or candidates
        tips = [max(unnamed, key=lambda t: _spread(_xyz(series, t)))]
        if len(unnamed) > 1:
            g.doubt("columns.x", f"no heading names a tip; {' / '.join(tips[0].columns)} move most")
    bases = [t for t in bases if t not in tips] or _still(g, series, [t for t in candidates if t not in tips], tips[0])
    rest = _at_rest(g, series, robot)
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
    rest = rest & has_place if rests else _lowest(g, series, has_place, robot)
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a marker that is never seen at rest
        resting = [np.nanmean(m[rest], axis=0) * KINDS["m"][unit] for m in markers.values()]
    in_m = from_base * KINDS["m"][unit]
    guess_frame(g, in_m, rest, resting, robot, rests, _driven(g, series, headings, robot, rest))
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


def _lowest(g: Guess, series: Series, known: Mask, robot: Robot) -> Mask:
    """(n,) of the rows with a place those with the lowest pressures in sum."""
    total = proposed_pressures(g, series, robot).sum(axis=1)
    total = np.where(known & np.isfinite(total), total, np.inf)
    return known & (total <= total.min())


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
    """(n, chambers) Pa of the columns proposed for the chambers."""
    columns = [c for k, c in g.values.get("columns", {}).items() if re.fullmatch(r"p\d+", k) and "column" in c]
    units = units_for("p1", robot.actuators.words)
    every = [series.numbers[c["column"]] * units[c["unit"]] for c in columns]
    return np.column_stack(every) if every else np.zeros((len(series), 0))


def _at_rest(g: Guess, series: Series, robot: Robot) -> Mask:
    """(n,) rows with the lowest pressures."""
    pressures = proposed_pressures(g, series, robot)
    return at_rest(pressures) if pressures.shape[1] else np.ones(len(series), bool)


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


def _driven(g: Guess, series: Series, headings: Sequence[Heading], robot: Robot, rest: Mask) -> Driven:
    """What drives the robot in all rows; pressures only where each actuator has a column of its own."""
    pressures = proposed_pressures(g, series, robot)
    own = pressures if pressures.shape[1] == len(robot.actuators.azimuths_deg) else pressures[:, :0]
    return Driven(own - np.nanmin(own, axis=0, initial=np.inf), _roll(series, headings), _mass_at_rest(series, rest))


def _roll(series: Series, headings: Sequence[Heading]) -> Array:
    """(n,) deg by which the body was turned in its mount, where a heading says so and the angle stays for some rows; else 0."""
    for h in headings:
        values = series.numbers[h.name]
        if own_column(h) == "roll_deg" and not changes_throughout(values):
            unit = h.unit if h.unit in KINDS["deg"] else series.unit_of(h.name, KINDS["deg"])
            return np.nan_to_num(values) * KINDS["deg"].get(unit, 1.0)
    return np.zeros(len(series))


def changes_throughout(angle: Array) -> bool:
    """Whether an angle changes between most rows rather than now and then."""
    steps = np.abs(np.diff(angle[np.isfinite(angle)]))
    return bool(len(steps) and (steps > 0).mean() > 0.5)


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
    order = "euler XYZ" if misfit_of and clearly_worse(misfit_of["euler xyz"], misfit_of["euler XYZ"]) else "euler xyz"
    if three.words & {"rotvec", "vector", "axis"}:
        order = orientation.order
    entry = {"columns": list(three.columns), "order": order, "unit": unit}
    g.say("orientation", entry, f"three angles, up to {largest:.4g} {unit}")
    fits = ", ".join(f"{deg:.1f} deg with {name}" for name, deg in misfit_of.items())
    misfits_text = f"; the tip turns about axes that differ from its bending axis by {fits}" if fits else ""
    remedy = f"Check the order: {ORDERS_IN_WORDS}"
    if misfit_of and min(misfit_of.values()) > NO_ORDER_FITS:
        remedy = "No order fits: two columns of the tip or of the actuators may be swapped, or the frame is wrong"
    g.doubt("orientation.order", f"{' / '.join(three.columns)} are taken as {order} in {unit}{misfits_text}. {remedy}")
