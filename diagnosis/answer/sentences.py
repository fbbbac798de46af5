"""The statement of the answer. docs/explanations/diagnosis.md explains it.

No two sentences of one answer contradict each other: what is "not explained" leaves at least half of the reducible gap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from model.actuators import Chambers, Words
from model.condition import HOLD, RATE
from model.effects.design import rate_of_ramps
from model.effects.laws.surroundings import OBSTACLE
from model.effects.spec import EffectSpec
from model.effects.tolerance import TRACKED_TURN
from model.robot import Robot
from model.rotation import from_vector
from recordings.trials import counted

from .. import judgement
from ..arrays import Array
from ..data.campaign import Campaign
from ..data.noise_components import PRESSURE
from ..data.plausible import differ_by
from ..findings import Finding, finding
from ..inference.fit import Fit
from ..inference.prepare import Prepared
from ..inference.problem import FitParameters
from ..remedies import listed, of_mount
from .attribute import Attribution
from .decision import share_closed
from .headline import concentrated, for_people, percent, plain_name, relative, stated, with_id
from .result import Alike, Calibration, Diagnosis, SetUp, Shrink, Waterfall
from .size import Size
from .verdict import stage


def statement(d: Diagnosis) -> str:
    """The answer in a few sentences, the verdict first."""
    present = also_present(d, lambda effect: with_id(effect, d.names), _what(d)[1])
    parts = (
        _verdict(d), _gap(d), _alike(d), _simulator(d), _moved(d), _closing(d), _robot(d), present, _odd(d),
        _pushed(d), held_out(d),
    )  # fmt: skip
    return " ".join(filter(None, parts))


def _named(effects: Iterable[str], d: Diagnosis, joint: str = " and ") -> str:
    return joint.join(with_id(e, d.names) for e in effects)


def _what(d: Diagnosis) -> tuple[str, int]:
    """What the gap is of, and digits of its mm: deflections of stiffness trials are small."""
    return ("the tip", 2) if d.locate.of == "tip" else ("the deflections of the stiffness trials", 3)


def _verdict(d: Diagnosis) -> str:
    """The conclusion: cause, candidates or none, with its probability; the stage in error if outside the catalogue."""
    a, named = d.attribute, _named(d.attribute.effects, d)
    sure = (limit := limited(d)) or f"{a.p}; {judgement.BENCHMARK}"
    if not limit and a.verdict != "unknown" and a.outside >= judgement.OUTSIDE_STATED:
        catalogued = "it is in the catalogue" if a.effects else "no cause is outside the catalogue"
        sure = f"{a.p}; {a.probability / (1 - a.outside):.2f} if {catalogued}; {judgement.BENCHMARK}"
    each = [f"{with_id(e, d.names)} (p = {p:.2f})" for e, p in a.second.items()]
    second = f" A second cause of comparable size acts with it: {' or '.join(each)}." if each else ""
    if a.conclusion == "cause":
        return f"Cause: {named} ({sure}).{second}"
    if a.conclusion == "one of several":
        experiment = next((f" To tell them apart: {x.do}." for x in d.next_experiment if x.separates), "")
        text = f"The most probable cause is {named} ({sure}); the data cannot rule out {_others(d)}."
        return f"{text}{experiment}{second}{_relatives(d)}"
    if a.conclusion in ("none", "noise"):
        likely = f" The most probable one is {_named(a.too_small, d)}{a.p_too_small}." if a.too_small else ""
        why = f"{'nothing is' if a.conclusion == 'noise' else 'no effect explains enough of the gap'} above the noise floor"
        why = f"probably no effect moves the tip by {judgement.OUTSTANDING_FLOORS:.0f} noise floors" if likely else why
        closed, nothing = closed_by_calibration(d), "No gap:" if a.conclusion == "noise" else "No cause:"
        most = f"Calibration closes {percent(closed or 0.0)} % of the reducible gap; beyond it,"
        return f"{nothing if closed is None else most} {why} ({sure}).{likely}"
    if a.conclusion == "too little data":
        return f"Too little data to name a cause{': ' if a.missing else ''}{'; '.join(a.missing)}."
    leading_error = None if "shifted" in {f.code for f in d.findings} else stage(a.stage_errors)
    stage_clause, where, digits = "", "", _what(d)[1]
    if leading_error is not None:
        runner_up = next((f", in the {e.stage} {e.gain:.1f}" for e in a.stage_errors if e.stage != leading_error.stage), "")
        stage_clause = (
            f" An error in the {leading_error.stage} that {d.words.fill(leading_error.varies)} fits best (log evidence "
            f"{leading_error.gain:.1f}{runner_up}), but a cause in another stage may look the same in these states."
        )
    if (c := d.locate.concentrated) is not None:
        remain = f"{c.rmse_mm:.{digits}f} mm rms in {counted(c.n, 'state')}, {c.others_mm:.{digits}f} mm in the others"
        where = f" Most of what calibration leaves lies {concentrated(c, d.words)}: {remain}."
    return f"The cause is not in the catalogue ({sure}).{where}{stage_clause}{_relatives(d)}"


def limited(d: Diagnosis) -> str:
    """That a doubt limits the probability of the cause, and the first that does; empty where none does."""
    if not d.attribute.limited:
        return ""
    doubt = next((why.partition(": ")[2] for why in d.attribute.doubts), "numbers of robot.yaml are in doubt")
    return f"p is at most {d.attribute.probability:.2f}, as {doubt}"


def _relatives(d: Diagnosis) -> str:
    """Causes outside the catalogue with the same signature, and the test for each."""
    a = d.attribute
    said = [(names[0], test) for names, test in (relative(id, a.at_places, d.words) for id in a.relatives[:2])]
    if a.verdict == "unknown":
        return "".join(f" It may be {name}. To find out, {test}." for name, test in said)
    return "".join(f" {name[0].upper()}{name[1:]} would look the same. To find out, {test}." for name, test in said)


def _others(d: Diagnosis) -> str:
    """The alternatives to an effect that is named without certainty."""
    a = d.attribute
    if a.rivals:
        return _named(a.rivals[:3], d, " or ") + (f" or {counted(len(a.rivals) - 3, 'other')}" if len(a.rivals) > 3 else "")
    outside = a.relatives or a.outside >= 1 - a.probability - a.outside
    return "a cause that this software does not know" if outside else "that no effect is large enough"


def _gap(d: Diagnosis) -> str:
    """How far the model misses the measurements, in mm rms, before and after calibration, what it moves, and the noise floor."""
    what, digits = _what(d)
    model = "the model" if d.simulator is None else d.simulator.name
    floor = f"the noise floor is {d.locate.noise_floor_mm:.{digits}f} mm"
    # beside a cause, the area factor stated is that of the robot with it, see `_robot`
    factor = "" if d.fitted is not None else _factor(d)
    if (w := d.waterfall) is None:
        missed = f"{d.locate.gap_rmse_mm:.{digits}f} mm rms (in-sample)"
        factor = " and moved towards the rod" if d.simulator is not None else factor
        return f"Calibrated with {d.words.an_area_factor}{factor}, {model} misses {what} by {missed}; {floor}."
    calibrated = w.steps[0].left_mm
    remark = ", which is no better" * (d.attribute.conclusion != "noise" and calibrated >= w.given_mm)
    lost = f" in {w.n} of {w.n + w.lost} states (in the other {w.lost} a fit without them finds no equilibrium)" * (w.lost > 0)
    moved = d.calibration.set_up if d.calibration is not None and d.fitted is None else ()
    far = [s for s in moved if s.value > judgement.BEYOND_SD * s.sd]
    each = [f"{_by(s, s.name, s.value)}, {_by(s, 'stated to', s.sd)}, moves {what} by {s.mm:.2f} mm" for s in far[:MOST_NUMBERS]]
    each += [counted(len(far) - MOST_NUMBERS, "more number")] * (len(far) > MOST_NUMBERS)
    why = "measure again" if d.attribute.verdict == "none" else "they may stand in for the cause"
    set_up = f" ({'; '.join(each)}: {why})" if each else ""
    on_walls = " but with `thrust: walls`" * any(f.code in ("thrust_settled", "thrust_likely") for f in d.findings)
    return (
        f"Uncalibrated{on_walls}, {model} misses {what} by {w.given_mm:.{digits}f} mm rms{lost}; calibrated with one "
        f"{d.words.area_factor}{factor} and the set-up fitted{set_up}, by "
        f"{calibrated:.{digits}f} mm on unseen states{remark}; {floor}."
    )


def _by(s: SetUp, what: str, value: float) -> str:
    return "{} {:.2g} {}".format(what, *_in_percent(value, s.unit))


def _factor(d: Diagnosis) -> str:
    """Value of the calibrated area factor, in brackets; empty where it is that of robot.yaml."""
    c = d.calibration
    if c is None or abs(c.stiffness - 1) < judgement.CALIBRATION_STATED:
        return ""
    if d.simulator is not None:
        return f" ({c.area_factor:.2f}; the rod comes nearest to {d.simulator.name} with {c.given:.2f})"
    body = f"a body {as_stiff(c)}"
    how = f"; {body} would look the same"
    if c.at_bound or c.determined:
        how = f", with {c.modulus:.2f} times the modulus{', at the limit of the fit' if c.at_bound else ''}"
    elif abs(c.modulus - 1) >= judgement.CALIBRATION_STATED:
        return f" ({body}: these data determine only the ratio of its stiffness to the {d.words.area_factor})"
    new, given = f"{c.area_factor:.2f}", f"{c.given:.2f}"
    return f" ({given} as stated{how})" if new == given else f" ({new} instead of {given}{how})"


def changed_by(d: Diagnosis) -> str:
    """The calibration in a few words; empty if there is none."""
    if d.calibration is None:
        return ""
    if d.simulator is not None:
        return f"{d.simulator.name} acts as with {d.calibration.stiffness:.2f} times the {d.words.pressure}"
    c = d.calibration
    alike = [a for a in c.alike if not a.parameter.startswith("body_modulus")][:1]  # as stiff a body
    creeps = " before it creeps" * ("viscoelastic" in d.attribute.effects)
    body = " or ".join([f"a body {as_stiff(c)}{creeps}", *(alike_in_words(a, d.names) for a in alike)])
    first = [_by(s, s.name, s.value) for s in c.set_up if s.mm > c.body_mm and d.fitted is None]
    return ", ".join([*first[:MOST_NUMBERS], *([body] if _factor(d) or not first else [])])


def alike_in_words(a: Alike, names: Mapping[str, str], ids: bool = False) -> str:
    """Name and size of an effect that acts like the area factor, with or without its identifier."""
    value, unit = _in_percent(a.value, a.unit)
    return f"{(with_id if ids else plain_name)(a.parameter.partition('.')[0], names)} {value:+.3g} {unit}"


def _alike(d: Diagnosis) -> str:
    """Alternatives to a calibrated area factor that closes most of the gap, and how to test them."""
    c = d.calibration
    if c is None or d.simulator is not None or closed_by_calibration(d) is None or not (c.alike if d.fitted else _factor(d)):
        return ""
    each = [f"{alike_in_words(a, d.names, ids=True)} ({a.left_mm:.2f} mm remain)" for a in c.alike]
    others = ", ".join([*each, f"the gain of the {d.words.pressures}, a radius of robot.yaml"])
    return (
        f"The calibrated {d.words.area_factor} may stand for any of these, which move the tip alike: {others}. What is said "
        "beyond the calibration holds whichever it is. To tell them apart, weigh what the tip carries, hang "
        f"a known mass on it without {d.words.pressure}, {_checked(d.words)}."
    )


def _checked(words: Words) -> str:
    return f"check the {words.pressures} with a gauge, and measure a cross-section of the body"


def as_stiff(c: Calibration) -> str:
    """The equivalent stiffness of the body, relative to robot.yaml."""
    if c.stiffness > 2:
        return f"{c.stiffness:.1f} times as stiff"
    percents = f"{100 * abs(c.stiffness - 1):.0f}"
    return "as stiff as stated" if percents == "0" else f"{percents} % {'stiffer' if c.stiffness > 1 else 'softer'}"


ORIGINS = {
    "pressures": "the readings of the {pressures}",
    "cavities": "the body's stiffness (robot.yaml's section leaves out the cavities of the {actuators})",
    "area_factor": "area_factor (effective over geometric area of the {actuators})",
}
"""Origins that have no key in robot.yaml, or an unclear one -> their names, as templates of `Words`."""


def stands_for(c: Calibration | None, words: Words) -> str:
    """Numbers of robot.yaml that may have caused the calibration, and how to test them; empty if it changed nothing."""
    if c is None or abs(c.stiffness - 1) < judgement.CALIBRATION_STATED or not c.origins:
        return ""
    possible = [
        f"{words.fill(ORIGINS.get(o.name, o.name))} {100 * abs(o.factor - 1):.1f} % {'larger' if o.factor > 1 else 'smaller'} "
        f"(p = {stated(o.probability)})"
        for o in c.origins
        if o.probability >= judgement.LEAST_STATED or o is c.origins[0]
    ]
    stiff = any(o.name in ("youngs_modulus", "bending_stiffness") for o in c.origins)
    by_mass = f"measure the body's stiffness without {words.pressures} (a stiffness trial, or a mass at the tip), " * stiff
    return (
        "One wrong number could account for most of the calibration (probability of each by itself; several may be wrong, so "
        f"these need not sum to 1): {', or '.join(possible)}. To find out, {by_mass}{_checked(words)}"
    )


def closed_by_calibration(d: Diagnosis) -> float | None:
    """Share of the reducible gap that calibration closes, where that is most; None otherwise."""
    w = d.waterfall
    if d.calibration is None or w is None:
        return None
    closed = share_closed(w.given_mm, w.steps[0].left_mm, d.locate.noise_floor_mm)
    return closed if closed is not None and closed > judgement.EXPLAINS else None


def numbers_beyond(p: FitParameters, moved: Mapping[int, float], robot: Robot) -> Iterator[Finding]:
    """The numbers of robot.yaml that a fit moves beyond their tolerances (`FitParameters.tense`)."""
    names = {s: n for s, n in (("youngs_modulus", "bending_stiffness"), ("density", "mass_per_length")) if getattr(robot, n)}
    names["area"] = "area_factor"
    for i, value in moved.items():
        (by, unit), (sd, sd_unit) = (_in_percent(v, p.infos[i].unit) for v in (abs(value), float(p.sd[i])))
        name = names.get(p.infos[i].source, p.infos[i].name.removesuffix(".excess"))
        name += " (`zero` of the positions)" * (p.infos[i].source == "frame_shift")
        yield finding("number_moved", name=name, by=by, unit=unit, side="above" if value > 0 else "below", sd=sd, sd_unit=sd_unit)


MOST_NUMBERS = 6
"""Numbers that are listed: where more are beyond their tolerance, the mistake is elsewhere."""


def beyond_tolerance(
    p: Prepared, fit: Fit, robot: Robot, moved: Mapping[int, float], name: str = "the fit", instead: Iterable[Finding] = ()
) -> Finding:
    """The finding on `numbers_beyond`, and on those that the readings hardly tell apart at a fit: their variance inflation
    factors in the least squares of all of them are above `HARDLY_APART`; `instead`: what else it may be."""
    farthest = sorted(moved, key=lambda i: -abs(moved[i]) / p.problem.parameters.sd[i])[:MOST_NUMBERS]
    more = [counted(len(moved) - len(farthest), "more number")] * (len(moved) > len(farthest))
    moved = {i: value for i, value in moved.items() if i in farthest}
    numbers, slope = [*numbers_beyond(p.problem.parameters, moved, robot)], fit.derivatives(p.problem).every
    white = slope.take(np.isin(np.arange(slope.shape[1]), [*moved])).whole
    unit = white / np.linalg.norm(white, axis=0)
    inflation = np.diag(np.linalg.inv(unit.T @ unit + np.finfo(float).eps * np.eye(len(moved))))
    alike = [number.values["name"] for number, factor in zip(numbers, inflation, strict=True) if factor > judgement.HARDLY_APART]
    named = "these" if len(alike) == len(numbers) else " and ".join(filter(None, (", ".join(alike[:-1]), *alike[-1:])))
    together = [finding("known_together", names=named)] if alike else []
    return finding("beyond_tolerance", fit=name, numbers=[*numbers, *more, *together, *instead])


def within_with_effect(f: Attribution, moved: Mapping[int, float], names: Mapping[str, str]) -> list[Finding]:
    """The finding on the one effect that alone closes the gap, with fewest of the numbers `moved` (index -> value), and no
    others, beyond their tolerance; none if none leaves any of them within."""
    p, found = f.prepared.problem.parameters, dict[int, Finding]()
    for effect, theta in f.closing_alone.items():
        within = [p.infos[i].name.removesuffix(".excess") for i in moved if abs(theta[i]) <= judgement.BEYOND_SD * p.sd[i]]
        if within and moved.keys() >= p.tense(theta).keys():
            first, *more = (k for k, i in enumerate(p.infos) if (i.source, i.role) == (effect, "size"))
            amount = "" if more else " {:+.3g} {}".format(*_in_percent(float(theta[first]), p.infos[first].unit))
            stay = "all of these" if len(within) == len(moved) else " and ".join(within)
            said = finding("within_with_effect", effect=with_id(effect, names) + amount, numbers=stay)
            found.setdefault(len(within), said)
    return [found[max(found)]] if found else []


def tracked_turn(p: Prepared, theta: Array) -> Iterator[Finding]:
    """A finding if a fit (k,) turns the tracked body beyond its tolerance about an axis, and no map took it as it rests."""
    own = np.array([info.source == TRACKED_TURN.spec.id for info in p.problem.parameters.infos])
    turn, trials = theta[own], p.states.trials
    angle = float(np.linalg.norm(turn))
    if (np.abs(turn) > p.problem.parameters.sd[own]).any() and not trials.moved_to_model:
        deg, remedy = float(np.degrees(angle)), of_mount(from_vector(-turn), trials.mapped)
        yield finding("tracked_turn", deg=deg, about=listed(turn / angle), remedy=remedy)


def _in_percent(value: float, unit: str, words: Words = Chambers.words) -> tuple[float, str]:
    """A value and its unit as a person reads them; a pure number in percent."""
    return (100 * value, "%") if unit == "1" else for_people(value, unit, words)


def far_off(stiffness: float, words: Words) -> Iterator[Finding]:
    """A finding if the calibrated body is `stiffness` times as stiff as robot.yaml's, which only a wrong unit explains."""
    if not 1 / judgement.OTHER_UNIT < stiffness < judgement.OTHER_UNIT:
        units = differ_by(stiffness, words)
        yield finding("stiffness_far_off", words, stiffness=stiffness, pressure_ratio=1 / stiffness, units=units)


def ramps_assumed(states: Campaign, named: Sequence[EffectSpec], words: Words) -> Iterator[Finding]:
    """A finding on the times of named effects if the table does not state how fast pressures change or how long they are held."""
    usual = {"rate": f"{words.number(RATE)} {words.unit}/s", "hold": f"{HOLD:g} s"}
    if rate_of_ramps(states.trials.values, states.trials.trial, states.pressure):
        del usual["rate"]
    assumed = " and ".join(f"{k} {value}" for k, value in usual.items() if not np.isfinite(states.trials.get(k)).any())
    for spec in named:
        if assumed and any(p.unit == "s" for p in spec.parameters):
            yield finding("ramps_assumed", effect=spec.name(words), assumed=assumed)


SCATTERS = {
    PRESSURE: "the readings of the {pressures} scatter by {}",
    "repeat_turn": "from repeat to repeat the robot turns in its mount by {} about each axis",
    "repeat_shift": "from repeat to repeat the robot shifts in its mount by {} along each axis",
    "spine_length": "from trial to trial the spine's length differs by {}",
    "spine_stiffness": "from trial to trial the spine's stiffness differs by {}",
}
"""Noise component -> what it does, as a template of `Words` with its standard deviation."""


def scatter(p: Prepared, floor_mm: float) -> Iterator[Finding]:
    """A finding if repeats scatter more than usual: each component that does, the largest excess first."""
    noise, words = p.noise_components, p.robot.actuators.words
    units, each = {PRESSURE: "Pa", **{i.source: i.unit for i in p.forward.parameters}}, []
    for name, factor in sorted(noise.excess.items(), key=lambda x: -x[1]):
        if factor >= judgement.USUAL_EXCESS:
            size = noise.pressure if name == PRESSURE else noise.trial[name]
            amount = "{:.2g} {}".format(*_in_percent(size, units[name], words))
            at_least = "at least " * (factor > 0.99 * judgement.COMPONENT_RANGE)  # the limit of the fit
            each.append(f"{words.fill(SCATTERS[name], f'{at_least}{amount}')}, {at_least}{factor:.2g} times as much as usual")
    if each:
        state = p.states.farthest(p.states.repeated(p.points(p.given)))
        worst = f". Farthest off is {state} from its repeats at the same {words.pressures}" if state else ""
        yield finding("scatter_of_repeats", words, floor_mm=floor_mm, scatter=each, worst=worst)


def to_look_at(p: Prepared, sizes: Mapping[str, Size]) -> Iterator[Finding]:
    """Findings on what is named, by its parameters: where an obstacle stands, if robot.yaml does not say it, and that a
    difference between actuators may be one between what measures them."""
    if "contact.turn" in sizes and p.robot.obstacle_azimuth_deg is None:
        x, y = p.forward.plane_direction.tolist()
        azimuth = float(np.degrees(np.arctan2(y, x) + sizes["contact.turn"].median) % 360)
        yield finding("obstacle_stands", azimuth=azimuth, mm=1e3 * (OBSTACLE * p.robot.length + sizes["contact.distance"].median))
    if any(name.startswith("chamber_gain.") for name in sizes):
        yield finding("gauge_looks_alike", p.robot.actuators.words)


def _simulator(d: Diagnosis) -> str:
    """How the simulator differs from the rod it replaces, and how much of that the measurements do not show."""
    simulator = d.simulator
    if simulator is None:
        return ""
    difference = f"{_simulator_acts(d)}{simulator.name} differs from the rod of robot.yaml by {simulator.differs_mm:.2f} mm rms"
    beyond = f"and by {simulator.beyond_calibration_mm:.2f} mm after {d.words.an_area_factor} is fitted"
    if simulator.beyond_calibration_mm < d.locate.noise_floor_mm:
        return f"{difference}, {beyond}: less than the noise floor."
    step = next((s for s in (d.waterfall.steps if d.waterfall else ()) if s.step == "simulator"), None)
    remark = f" Without that part, {step.left_mm:.2f} mm of the gap would remain on unseen states." if step else ""
    explains = judgement.EXPLAINS
    if step and simulator.share > explains and step.mm > explains * (step.mm + step.left_mm - d.locate.noise_floor_mm):
        remark += f" The gap is in {simulator.name}."
    return f"{difference}, {beyond}; {simulator.not_measured_mm:.2f} mm of that is not in the measurements (in-sample).{remark}"


def _simulator_acts(d: Diagnosis) -> str:
    """The simulator's equivalent pressure scale, and where to look for its reason; empty if calibration closes little."""
    s, c, w = d.simulator, d.calibration, d.waterfall
    if s is None or c is None or w is None or closed_by_calibration(d) is None:
        return ""
    text = f"{changed_by(d)}; that closes {w.given_mm - w.steps[0].left_mm:.1f} of {w.given_mm:.1f} mm. "
    of_rod, of_data = s.area_factor / s.of_robot, c.area_factor / s.of_robot
    if abs(of_data - 1) < judgement.SAME_FACTOR < abs(of_rod - 1):
        return f"{text}The rod of robot.yaml does not: the gap is in {s.name}; check its {d.words.pressures}, areas and modulus. "
    if abs(of_rod - 1) < judgement.SAME_FACTOR:
        gain = d.words.fill("the gain of the {pressures}")
        return f"{text}So does the rod: check area_factor and youngs_modulus of robot.yaml, and {gain}. "
    return text


def _moved(d: Diagnosis) -> str:
    what, digits = _what(d)
    shares = [
        f"{plain_name(c.effect, d.names)} moves {what} by {c.mm:.{digits}f} mm (95 % over all "
        f"hypotheses: {c.low95_mm:.{digits}f} to {c.high95_mm:.{digits}f} mm)"
        for c in d.budget
        if c.role == "named"
    ]
    if not shares:
        return ""
    gap = d.waterfall.steps[0].left_mm if d.waterfall is not None else d.locate.gap_rmse_mm
    more = max(c.mm for c in d.budget if c.role == "named") > judgement.MORE_THAN_GAP * gap
    hidden = ". This exceeds the gap because calibration and other effects take up part of it" if more else ""
    return f"After {d.words.an_area_factor} is refitted, {'; '.join(shares)}{hidden}."


def _closing(d: Diagnosis) -> str:
    """What the leading hypothesis does on unseen states."""
    if d.shrink is None or d.attribute.conclusion in ("none", "noise", "too little data"):
        return ""
    _, digits = _what(d)
    before, after = f"{d.shrink.before_mm:.{digits}f}", f"{d.shrink.after_mm:.{digits}f}"
    share, alone = d.shrink.share_closed, closed_alone(d.waterfall, d.shrink)
    if d.attribute.verdict == "effect":
        if share is None:
            return f"On unseen states {after} mm remain; calibration alone leaves {before} mm, near the noise floor."
        if share < 0:
            return f"This cause makes the prediction of unseen states worse: {before} mm without it, {after} mm with it."
        closed = f"{percent(share)} % of the reducible gap is closed{by_itself(alone)}"
        return f"With the cause, and other effects within their tolerances, {after} mm remain on unseen states: {closed}."
    nearest = _named(d.detail["best_hypothesis"], d)
    if not nearest or share is None or share < 0:
        return ""
    if share < judgement.EXPLAINS:
        return (
            f"Nearest comes {nearest}, without explaining the gap (unseen states: {before} mm without this, {after} mm with it)."
        )
    return (
        f"Nearest comes {nearest}. This closes {percent(share)} % of the reducible gap on unseen states, but the remaining "
        "errors are not noise."
    )


def by_itself(alone: float | None) -> str:
    """The share of the gap that the cause itself closes (see `closed_alone`); empty if that is nearly all."""
    return "" if alone is None else f", {percent(alone)} % by the cause itself and the rest by tolerances of other effects"


def closed_alone(w: Waterfall | None, s: Shrink | None) -> float | None:
    """Share of the reducible gap that the named effects close without tolerances of other effects; None if tolerances add
    little."""
    left = [step.left_mm for step in (w.steps if w else ()) if step.step == "cause"]
    if not left or s is None or s.share_closed is None or s.share_closed < 0:
        return None
    alone = share_closed(s.before_mm, left[-1], s.floor_mm)
    return None if alone is None or alone >= judgement.EXPLAINS * s.share_closed else max(alone, 0.0)


def _robot(d: Diagnosis) -> str:
    """The error of the robot that `lab fit` writes, which is the one that other commands use."""
    if d.fitted is None:
        return ""
    return (
        f"With this cause and no other effect, one {d.words.area_factor}{_factor(d)} and the set-up fitted, as `lab fit --with` "
        f"does, the robot misses the tip by {d.fitted.left_mm:.2f} mm (in-sample; {d.fitted.calibrated_mm:.2f} mm without the "
        "cause)."
    )


def also_present(d: Diagnosis, name: Callable[[str], str], digits: int) -> str:
    """The sentence on effects that are present beside a cause, each by its `name`; empty if there is none. Where no cause is
    named they may only stand in for it."""
    present = (c for c in d.budget if c.role == "present" and d.attribute.verdict == "effect")
    found = ", ".join(f"{name(c.effect)} {c.mm:.{digits}f} mm" for c in present)
    return f"Also present: {found}." if found else ""


def _odd(d: Diagnosis) -> str:
    trial, state = d.detail["misfit"]["outlier_trial"], d.detail["misfit"].get("outlier_state")
    if d.attribute.verdict != "unknown" or not state:
        return ""
    begin = "Check first" if trial is None else f"Trial {trial} does not fit the others: check it first, above all"
    return f"{begin} {state} from the fit."


def _pushed(d: Diagnosis) -> str:
    """A sentence on stiffness trials recorded together with tips."""
    if "stiffness" not in d.detail or d.locate.of != "tip":
        return ""
    pushes = d.detail["stiffness"]
    before, after = (f"{pushes['waterfall_mm'][name]:.3f}" for name in ("calibrated", "explained"))
    of = "noise floor" if pushes["floor_from_repeats"] else "none repeated; assumed noise floor"
    text = (
        f"The calibrated model misses the deflections of the stiffness trials by {before} mm rms (in-sample; {of} "
        f"{pushes['floor_mm']:.3f} mm)"
    )
    cause = f"; with the cause, by {'as much' if after == before else f'{after} mm'}"
    return f"{text}{cause * (d.attribute.verdict == 'effect')}."


def held_out(d: Diagnosis) -> str:
    """The gap on the held-out campaign; empty if none was given."""
    h = d.holdout
    if h is None:
        return ""
    lost = f", {h.unsolved} more without equilibrium" if h.unsolved else ""
    errors = (
        f"On the held-out campaign ({counted(h.trials, 'trial')}, {counted(h.states, 'state')}{lost}) the tip error is "
        f"{h.before_mm:.2f} mm rms before, {h.after_mm:.2f} mm after"
    )
    if not h.hypothesis:
        return f"{errors}; no effect is named, so none is tested."
    if h.share_closed is None:
        return f"{errors}: near the noise floor of {h.floor_mm:.2f} mm, so there is no gap to close."
    named = _named(h.hypothesis, d)
    drawn = ", from parts of its one trial" * (h.trials == 1)
    interval = "" if h.ci95 is None else f" (95 %: {percent(h.ci95[0])} .. {percent(h.ci95[1])} %{drawn})"
    closed = f"{errors}: {percent(h.share_closed)} % of the reducible gap is closed{interval}"
    if not h.named:
        return f"{closed} with {named}, the nearest effect. It was not named, so nothing is confirmed."
    verdict = {
        "confirmed": f"{named} confirmed",
        "contradicted": f"{named} contradicted: it makes the prediction worse",
        "open": f"this neither confirms nor contradicts {named}",
    }[h.verdict]
    return f"{closed}; {verdict}."
