"""Find mistakes in a table or its robot.yaml when they are read, by the list of edits.

A table that is not in SI units and in the base's frame is refused; what else is far better is asked about. Units of force and
deflection in stiffness trials are judged by the beam F = 3 E I d / L^3:

    p(unit) ~ prior exp(-ln^2(m) / 2 s^2),    m: slope of F over d in this unit, over the slope expected,

and s, by specimen: how far from robot.yaml its modulus may be.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
import scipy

from model.body import annulus_second_moment, body_of
from model.errors import BadCondition
from model.robot import Robot
from model.rotation import CONJUGATE, from_vector, to_base
from recordings.trials import Table

from .. import judgement
from ..data import plausible
from ..data.campaign import Campaign
from ..data.case import campaign_of, finite
from ..data.plausible import METRES, NEWTONS, SHORTEST, cantilevers, complete, implausible_values, in_si
from ..findings import Finding, finding
from ..remedies import marker_entry, misread_by, of_origin, of_unit
from .edit import AREA, MODULUS
from .misfit import MOST, Fit, Sample, as_described, sample_of
from .of_table import at_rest

UNITS = ("stiffness_unit", "pressures_in_unit", "places_in_unit", "pressures_absolute", "attitudes_elsewhere")
"""Findings for which a table is refused."""
FRAMES = ("frame_turned", "frame_mirrored", "displacements")
"""Those for which it is refused where its tips are far from the rod's."""
PLACES = (*FRAMES, "origin_elsewhere", "axis_in_unit", "axis_stretched")
"""Those which explain tips that no rod reaches."""
OF_NUMBERS = 2.0
"""Factor on all pressures within which an area factor or a modulus is off, and no unit."""
OF_NO_UNIT = ("column_in_unit", "scale_far_off", "tip_far_off")
"""What follows from pressures that were read in another unit."""
PUSH_UNITS = {"mN": "force", "gram-force": "force", "mm": "deflection", "cm": "deflection", "inches": "deflection"}
PRIOR, MODULUS_SD = 0.01, {"body": np.log(3.0), "spine": np.log(6.0)}
"""Of each of them; s: a body's modulus is known within a few, a jammed spine's may be a guess."""
FOLLOWS = 0.9
"""Correlation of force and deflection from which there is a slope."""


@dataclass(frozen=True)
class Reading:
    """Findings about a table: column, value, probable meaning, remedy."""

    refused: tuple[str, ...]
    asked: tuple[str, ...]
    """Empty where something is refused."""
    table: Table = field(default_factory=Table, compare=False)
    """The table to be used: without places of markers that are elsewhere than robot.yaml has them."""


def read(robot: Robot, table: Table) -> Reading:
    """Judge a table of trials of a robot."""
    impossible, tips, elsewhere = implausible_values(robot, table)
    found = [(f, True) for f in _wrong_units(robot, table)]
    with suppress(BadCondition):  # states that do not fit this robot, which is said where they are used
        off, enough = [] if impossible else [*_off_axis(robot, tips)], len(tips) >= judgement.EDIT_FEWEST
        unseen = {f"m{f.values['number']}{axis}": np.full(len(table), np.nan) for f in off for axis in "xyz"}
        without = tips.replaced({name: nan[: len(tips)] for name, nan in unseen.items()})
        by_rod = [*_by_rod(robot, without)] if enough else []
        if off and by_rod and _explains(robot, tips):
            off, by_rod = [], [*_by_rod(robot, tips)]
        table = table.replaced(unseen) if off else table
        found += (*((f, False) for f in off), *by_rod)
    found.sort(key=lambda one: one[0].code not in UNITS)  # what is wrong with every number comes first
    highest, mapped, words = float(np.nan_to_num(table.pressures).max(initial=0.0)), table.mapped, robot.actuators.words
    no_unit = mapped is not None and mapped.unit == "" and 0 < highest < plausible.LOWEST_USUAL
    if no_unit and not any(f.code == "pressures_in_unit" for f, _ in found):
        low = finding("pressures_without_unit", words, highest=highest, remedy=of_unit(mapped, robot, words.unit))
        found = [(low, bool(impossible)), *(one for one in found if one[0].code not in OF_NO_UNIT)]
    if elsewhere:
        causes = [str(f) for f, _ in found if f.code in PLACES]
        remedy = ", and ".join(causes) or f"{plausible.CHECK_FRAME}; if its origin is not at the base, {of_origin(mapped)}"
        impossible = tuple(text.replace(plausible.CHECK_FRAME, remedy) if text is elsewhere else text for text in impossible)
        found = [one for one in found if str(one[0]) not in causes]
    refused = (*(str(f) for f, refuse in found if refuse), *impossible)
    return Reading(refused, () if refused else tuple(str(f) for f, _ in found), table)


def _off_axis(robot: Robot, tips: Table) -> Iterator[Finding]:
    """Markers that are, from the tip at rest, farther from where robot.yaml has them, at any arc length, than half the body's
    radius and the tip's error."""
    tips, arcs = tips.take(finite(tips)), np.linspace(0.0, robot.length, 401)[1:]
    if not (len(tips) and robot.markers and tips.markers.size):
        return
    rest = tips.take(np.flatnonzero(at_rest(tips))[:MOST])
    sample = Sample(robot, rest, np.zeros(len(rest), np.int64))
    solution, axis = sample.axes(sample.described, arcs[None, None])
    off_tip = float(np.linalg.norm(np.median(solution.tip - rest.tip, axis=0)))
    most = robot.outer_radius / 2 + 3 * (robot.uncertainty.marker_shift or 0.0) + off_tip
    roll = np.radians(rest.get("roll_deg", 0.0))
    places, upright = robot.marker_places(roll), from_vector(np.outer(roll, [0.0, 0.0, 1.0]))[:, None]
    for k in range(min(places.shape[1], rest.markers.shape[1])):
        seen = rest.markers[:, k] - rest.tip + solution.tip
        known = np.isfinite(seen).all(axis=1)
        # (rows, arcs, 3) m of the marker in the sections' frames, from where robot.yaml has it and from the axis
        from_axis = to_base(axis.orientation * CONJUGATE, seen[:, None] - axis.position)[known]
        off, here = (np.median(np.linalg.norm(x, axis=2), axis=0) if known.any() else np.zeros(1)
                     for x in (from_axis - places[known, k, None] * [1.0, 1.0, 0.0], from_axis))  # fmt: skip
        if off.min() > max(most, plausible.FARTHEST * robot.length):  # NaN without an equilibrium
            yield finding("marker_out_of_reach", number=k + 1, off=float(off.min()))
        elif off.min() > most:
            nearest = int(np.argmin(here))
            x, y, _ = np.median(to_base(upright[known] * CONJUGATE, from_axis[:, [nearest]])[:, 0], axis=0)
            entry = marker_entry(np.array([x, y, arcs[nearest]]))
            yield finding("marker_off_axis", number=k + 1, off=1e3 * float(off.min()), entry=entry)


def _explains(robot: Robot, tips: Table) -> bool:
    """Whether the mistakes that tips and markers show together, such as another frame, bring the markers to their places."""
    from .search import edit_first

    first = edit_first(*_in_the_rod(robot, tips))
    return bool(first.changes) and not [*_off_axis(first.robot, first.states.trials)]


def _in_the_rod(robot: Robot, tips: Table) -> tuple[Robot, Campaign]:
    """The states with a tip, and the robot without effects, which are not in the rod."""
    plain = robot.model_copy(update={"effects": {}, "tolerances": {}})
    return plain, campaign_of(tips, np.arange(len(tips)), np.arange(0))


def _by_rod(robot: Robot, tips: Table) -> Iterator[tuple[Finding, bool]]:
    """Findings about states with a tip, and whether they refuse the table; of a robot with effects only those that do."""
    plain, states = _in_the_rod(robot, tips)
    if (sample := sample_of(plain, states)) is None:
        return
    moved, findings = float(sample.rms(sample.table.tip - sample.table.tip.mean(axis=0))), list[Finding]()
    least, most = judgement.EDIT_LEAST * robot.length, judgement.EDIT_GROSS * robot.length
    gross = float(np.clip(judgement.EDIT_OF_MOVED * moved, least, most))
    fits = as_described(sample)
    left = [float(sample.rms(f.missed[sample.places])) for f in fits]
    # of those that are near, the one that changes least
    best = min(range(len(fits)), key=lambda k: (left[k] > gross, left[k] if left[k] > gross else abs(fits[k].theta[AREA])))
    rms, fit = left[best], fits[best]
    missed = fit.missed[sample.places]
    ratio, words = float(np.exp(fit.theta[AREA] - fit.theta[MODULUS])), robot.actuators.words
    scaled = not 1 / judgement.OTHER_UNIT < ratio < judgement.OTHER_UNIT
    if rms > gross or not sample.aligned(fit) or sample.ambient or scaled:
        from .search import edit_first  # with the list of edits, for which a robot that is near does not wait

        first = edit_first(plain, states)
        findings, fit = [*first.changes], first.fit or fit
    if (stretched := _stretched(sample, fit)) is not None:
        findings = [stretched]
    elif not findings and (unit := unit_of_all(robot, sample.table, ratio)) is not None:
        findings.append(unit)
    elif not findings and scaled and rms <= gross:
        findings.append(finding("scale_far_off", words, factor=ratio))
    elif not findings and rms > judgement.EDIT_UNEXPLAINED * robot.length:
        findings.append(finding("tip_far_off", mm=1e3 * rms))
    far = float(np.median(np.linalg.norm(missed, axis=1))) > judgement.EDIT_FAR * robot.length
    for f in findings:
        refuse = f.values.get("p", 0.0) > judgement.CAUSE_PROBABILITY and (f.code in UNITS or (f.code in FRAMES and far))
        if refuse or not (robot.effects or robot.tolerances):
            yield f, refuse


def unit_of_all(robot: Robot, table: Table, gain: float) -> Finding | None:
    """The unit that all pressures or tensions probably have, where they must be `gain` times as large, with its probability; None
    where that of another area factor or modulus, or of none, is larger.

        p(unit) ~ prior N(ln gain; ln r, s) h(r),   p(number) ~ prior N(ln gain; 0, ln 3) h(1),   p(none) ~ N(ln gain; 0, s) h(1),

    r: ratio of the unit to that in which they were read, s: of area factor and modulus, h: of the highest pressure times r."""
    if 1 / OF_NUMBERS < gain < OF_NUMBERS:
        return None
    known, limit = robot.uncertainty, robot.highest_limit
    ratios = [*plausible.misread(robot, table.mapped)]
    s = float(np.hypot(known.area_factor or judgement.AREA_SD, known.youngs_modulus or judgement.MATERIAL_SD))
    r, sd = np.log([1.0, 1.0, *ratios]), np.array([s, np.log(3), *[s] * len(ratios)])
    high = r + np.log(max(float(np.abs(table.pressures).max()), 1e-9) / (limit or plausible.USUAL_PRESSURE))
    width = np.where((high > 0) & bool(limit), np.log(1.5), np.log(3 if limit else 6))
    prior = np.log([judgement.EDIT_NONE, 0.05, *[0.03 / len(ratios)] * len(ratios)])
    p = scipy.special.softmax(prior - ((np.log(gain) - r) / sd) ** 2 / 2 - np.log(sd) - (high / width) ** 2 / 2)
    if (best := int(np.argmax(p))) < 2:
        return None
    factor, (looks, remedy) = ratios[best - 2], misread_by(ratios[best - 2], robot, table.mapped)
    number = f"; or area_factor or the modulus of robot.yaml is {gain:.3g} times off (p = {p[1]:.2f})"
    rather = number if p[1] >= judgement.EDIT_STATED else ""
    words, chance = robot.actuators.words, float(p[best])
    return finding("pressures_in_unit", words, factor=factor, looks=looks, remedy=remedy, p=chance, rather=rather)


def _stretched(sample: Sample, fit: Fit) -> Finding | None:
    """The axis along which the tip moves much farther than the nearest fit, which moves, too."""
    seen = sample.edited([(fit.edits, fit.x[None])]).tip[0]
    moved, able = seen.std(axis=0), (seen + fit.missed[: len(seen)]).std(axis=0)
    axis, follows = int(np.argmax(moved - able)), np.linalg.norm(able) > 0.3 * np.linalg.norm(moved)
    least = max(judgement.EDIT_STRETCHED * able[axis], able[axis] + judgement.EDIT_STRETCHED_BY * sample.robot.length)
    found = finding("axis_stretched", axis="xyz"[axis], factor=moved[axis] / max(able[axis], 1e-9), mm=1e3 * moved[axis])
    return found if follows and moved[axis] >= least else None


def _wrong_units(robot: Robot, table: Table) -> Iterator[Finding]:
    """The units that forces and deflections probably have, where these are not N and m."""
    trials = table.take(complete(table))
    for specimen, sd in MODULUS_SD.items():
        own = trials.take((trials.get("specimen") == specimen) & (cantilevers(robot, trials) >= SHORTEST))
        if len(own) < judgement.EDIT_FEWEST or not (ratio := _stiffness_ratio(robot, own, specimen)) > 0:
            continue
        factors = np.array([1.0, *(1 / NEWTONS[u] if u in NEWTONS else METRES[u] for u in PUSH_UNITS)])
        prior = np.log([1 - PRIOR * len(PUSH_UNITS), *[PRIOR] * len(PUSH_UNITS)])
        p = scipy.special.softmax(prior - np.log(ratio / factors) ** 2 / (2 * sd**2))
        if p[0] > 1 - judgement.CAUSE_PROBABILITY:
            continue
        unit, column = [*PUSH_UNITS.items()][int(np.argmax(p[1:]))]
        si, size = ("N", NEWTONS[unit]) if column == "force" else ("m", METRES[unit])
        largest = int(np.argmax(np.abs(own.get(column))))
        yield finding(
            "stiffness_unit", place=own.place(largest), column=column, value=float(own.get(column)[largest]), si=si,
            looks=unit, p=float(p[1:].max()), ratio=ratio, remedy=in_si(size),
        )  # fmt: skip


def _stiffness_ratio(robot: Robot, own: Table, specimen: str) -> float:
    """Slope of force over deflection, of 3 E I / L^3; 0 where they do not follow each other, or the robot has no spine."""
    long, force, deflection = cantilevers(robot, own), own.get("force"), own.get("deflection")
    if specimen == "body":
        bending = np.full(len(own), robot.youngs_modulus * body_of(robot).mean_second)
    elif robot.spine is not None:
        bending = robot.spine.modulus_at(long) * annulus_second_moment(robot.spine.radius)
    else:
        return 0.0
    expected = 3 * bending / long**3 * deflection
    if np.ptp(expected) == 0 or np.ptp(force) == 0:
        return 0.0
    return abs(float(np.polyfit(expected, force, 1)[0])) if abs(np.corrcoef(force, expected)[0, 1]) > FOLLOWS else 0.0
