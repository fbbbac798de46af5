"""The statement of the answer. docs/explanations/diagnosis.md explains it.

No two sentences of one answer contradict each other: what is "not explained" leaves at least half of the reducible gap.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

from model.actuators import Chambers, Words
from model.robot import Robot

from .. import judgement
from ..criticism.relatives import RELATIVES
from ..criticism.stage_errors import StageError
from ..findings import Finding, finding
from ..inference.posterior import UNKNOWN
from ..inference.problem import FitParameters
from .decision import Decision
from .headline import LEAST_STATED, for_people, percent, stated
from .result import Alike, Calibration, Carries, Conclusion, FittedRobot, Locate, Ranked, Shrink, Simulator, Waterfall
from .shrink import share_closed
from .size import Size
from .verdict import stage


@dataclass(frozen=True)
class Facts:
    """All that the sentences are made from."""

    decision: Decision
    conclusion: Conclusion | None
    where: Locate
    budget: tuple[Carries, ...] = ()
    shrink: Shrink | None = None
    waterfall: Waterfall | None = None
    rivals: Sequence[str] = ()
    tie_breaker: str | None = None
    """The experiment that separates the candidates best."""
    nearest: Sequence[str] = ()
    """Effects of the hypothesis that `shrink` is about where nothing is named."""
    asking: Sequence[StageError] = ()
    odd_trial: int | None = None
    missing: Sequence[str] = ()
    """What the table lacks."""
    simulator: Simulator | None = None
    """What takes the rod's place; None: nothing does."""
    calibration: Calibration | None = None
    first: str = ""
    """The number of robot.yaml that was calibrated first, or how many; empty where none was."""
    names: Mapping[str, str] = field(default_factory=dict)
    """Effect -> plain name."""
    words: Words = Chambers.words
    fitted: FittedRobot | None = None
    """The robot with what is named."""


NO_EFFECT, OUTSIDE = "no effect", "a cause outside the catalogue"


def plain_name(effect: str, names: Mapping[str, str]) -> str:
    """Name of an effect or of a parameter of one, as effect.parameter.

    >>> plain_name("spine_slip.yield_moment", {"spine_slip": "friction in the spine"}), plain_name("unknown", {})
    ('friction in the spine, yield moment', 'a cause outside the catalogue')
    """
    own, _, parameter = effect.partition(".")
    if own == UNKNOWN[0]:
        return OUTSIDE
    name = names.get(own) or own.replace("_", " ")
    return f"{name}, {parameter.replace('_', ' ')}" if parameter else name


def with_id(effect: str, names: Mapping[str, str]) -> str:
    """The plain name, followed by the identifier in square brackets.

    >>> with_id("spine_slip", {"spine_slip": "friction in the spine"})
    'friction in the spine [spine_slip]'
    """
    name = plain_name(effect, names)
    return name if name == OUTSIDE else f"{name} [{effect}]"


def hypothesis_name(effects: Iterable[str], names: Mapping[str, str], ids: bool = True) -> str:
    """Name of a hypothesis, with or without the identifiers of its effects."""
    return " + ".join(with_id(e, names) if ids else plain_name(e, names) for e in effects) or NO_EFFECT


def statement(f: Facts) -> str:
    """The answer in a few sentences, the verdict first."""
    present = also_present(f.budget, lambda effect: with_id(effect, f.names), _what(f)[1])
    parts = (_verdict(f), _gap(f), _alike(f), _simulator(f), _moved(f), _closing(f), _robot(f), _absorbed(f), present, _odd(f))
    return " ".join(filter(None, parts))


def _what(f: Facts) -> tuple[str, int]:
    """What the gap is of, and digits of its mm: deflections of stiffness trials are small."""
    return ("the tip", 2) if f.where.of == "tip" else ("the deflections of the stiffness trials", 3)


def _sure(f: Facts) -> str:
    d = f.decision
    open_ended = d.verdict != "unknown" and d.outside >= judgement.OUTSIDE_STATED
    given = f"; {d.within:.2f} if it is in the catalogue" if open_ended else ""
    return f"p = {d.probability:.2f}{given}; {judgement.BENCHMARK}"


def _verdict(f: Facts) -> str:
    """The conclusion: cause, candidates or none, with its probability; where it is outside the catalogue, which stage errs."""
    named = " and ".join(with_id(e, f.names) for e in f.decision.effects)
    if f.conclusion == "cause":
        return f"Cause: {named} ({_sure(f)}).{_second(f)}"
    if f.conclusion == "one of several":
        experiment = f" To tell them apart: {f.tie_breaker}." if f.tie_breaker else ""
        text = f"Behaves most like {named} ({_sure(f)}); the data do not exclude {_others(f)}."
        return f"{text}{experiment}{_second(f)}{_relatives(f)}"
    if f.conclusion == "none" and f.decision.too_small:
        leading = " and ".join(with_id(e, f.names) for e in f.decision.too_small)
        return (
            f"{_by_calibration(f, 'No cause stands out', 'no cause stands out')}: probably no effect carries "
            f"{judgement.OUTSTANDING_FLOORS:.0f} noise floors ({_sure(f)}). The most probable one is {leading}."
        )
    if f.conclusion == "none":
        return f"{_by_calibration(f, 'No cause:')} no effect accounts for enough above the noise floor ({_sure(f)})."
    if f.conclusion == "noise":
        return f"{_by_calibration(f, 'No gap:')} nothing is above the noise floor ({_sure(f)})."
    if f.conclusion == "too little data":
        return f"Too little data to name a cause{': ' if f.missing else ''}{'; '.join(f.missing)}."
    stage_clause, leading_error = "", stage(f.asking)
    if leading_error is not None:
        runner_up = next((f", in the {e.stage} {e.gain:.1f}" for e in f.asking if e.stage != leading_error.stage), "")
        stage_clause = (
            f" An error in the {leading_error.stage} that {f.words.fill(leading_error.varies)} fits best (log evidence "
            f"{leading_error.gain:.1f}{runner_up}); a cause of another stage may do the same to these states."
        )
    return f"The cause is not in the catalogue ({_sure(f)}).{stage_clause}{_relatives(f)}"


def _second(f: Facts) -> str:
    """One of several effects that acts together with what is named."""
    each = [f"{with_id(e, f.names)} (p = {p:.2f})" for e, p in f.decision.second.items()]
    return f" Together with it acts another of comparable size: {' or '.join(each)}." if each else ""


def _relatives(f: Facts) -> str:
    """Causes outside the catalogue that do what these readings show, and how to find out."""
    said = [RELATIVES[r] for r in f.decision.relatives[:2]]
    if f.decision.verdict == "unknown":
        return "".join(f" It may be {s.name(f.words)}: {f.words.fill(s.seen_best_in)}, to find out." for s in said)
    each = [(s.name(f.words), f.words.fill(s.seen_best_in)) for s in said]
    return "".join(f" {name[0].upper()}{name[1:]} would do this too: {test}, to find out." for name, test in each)


def _others(f: Facts) -> str:
    """What else it may be, where an effect is named and not sure."""
    if f.rivals:
        more = f" or {len(f.rivals) - 3} others" if len(f.rivals) > 3 else ""
        return " or ".join(with_id(e, f.names) for e in f.rivals[:3]) + more
    if f.decision.relatives:
        return OUTSIDE
    none = 1 - f.decision.probability - f.decision.outside
    return OUTSIDE if f.decision.outside >= none else "that no effect carries enough"


def _gap(f: Facts) -> str:
    """How far the model misses the measurements, in mm rms, before and after calibration, and the noise floor."""
    what, digits = _what(f)
    model = "the model" if f.simulator is None else f.simulator.name
    floor = f"the noise floor is {f.where.noise_floor_mm:.{digits}f} mm"
    # beside a cause, the area factor stated is that of the robot with it, see `_robot`
    factor = "" if f.fitted is not None else _factor(f)
    if f.waterfall is None:
        missed = f"{f.where.gap_rmse_mm:.{digits}f} mm rms (in-sample)"
        factor = " and towards the rod" if f.simulator is not None else factor
        return f"Calibrated with one {f.words.area_factor}{factor} {model} misses {what} by {missed}; {floor}."
    calibrated = f.waterfall.steps[0].left_mm
    no_better = f.conclusion != "noise" and calibrated >= f.waterfall.given_mm
    remark = f", no less: no {f.words.area_factor} makes up for what is wrong" if no_better else ""
    return (
        f"Uncalibrated, {model} misses {what} by {f.waterfall.given_mm:.{digits}f} mm rms, calibrated with one "
        f"{f.words.area_factor}{factor} by {calibrated:.{digits}f} mm on states that the fit did not see{remark}; {floor}."
    )


def _factor(f: Facts) -> str:
    """Value of the calibrated area factor, in brackets; empty where it is that of robot.yaml."""
    c = f.calibration
    if c is None or max(abs(c.stiffness - 1), abs(c.modulus - 1)) < judgement.CALIBRATION_STATED:
        return ""
    if f.simulator is not None:
        return f" ({c.area_factor:.2f} in place of the {c.given:.2f} with which the rod comes nearest to {f.simulator.name})"
    body = f"a body {as_stiff(c)}"
    how = f"; {body} would look the same"
    if c.at_bound:
        how = f", with {c.modulus:.2f} times the modulus, at the limit of the fit"
    elif abs(c.modulus - 1) >= judgement.CALIBRATION_STATED:
        how = f", with {c.modulus:.2f} times the modulus; these data show hardly more than their ratio, that of {body}"
    return f" ({c.area_factor:.2f} instead of {c.given:.2f}{how})"


def changed_by(f: Facts) -> str:
    """What calibration comes to, in a few words; empty where there is none."""
    if f.calibration is None:
        return ""
    if f.simulator is not None:
        return _acts_as(f, f.simulator, f.calibration)
    return " or ".join([f"a body {as_stiff(f.calibration)}", *(alike_in_words(a, f.names) for a in f.calibration.alike[:1])])


def _acts_as(f: Facts, own: Simulator, c: Calibration) -> str:
    return f"{own.name} acts as with {c.stiffness:.2f} times the {f.words.pressure}"


def alike_in_words(a: Alike, names: Mapping[str, str], ids: bool = False) -> str:
    """Name and size of an effect that does what the area factor does, with or without its identifier."""
    value, unit = _in_percent(a.value, a.unit)
    return f"{(with_id if ids else plain_name)(a.parameter.partition('.')[0], names)} {value:+.3g} {unit}"


def _alike(f: Facts) -> str:
    """What else would do what a calibrated area factor does that closes most of the gap, and the experiment that tells."""
    c = f.calibration
    if c is None or f.simulator is not None or closed_by_calibration(f) is None or (f.fitted is not None and not c.alike):
        return ""
    each = [f"{alike_in_words(a, f.names, ids=True)} ({a.left_mm:.2f} mm remain)" for a in c.alike]
    others = ", ".join([*each, f"the gain of the {f.words.pressures}, a radius of robot.yaml"])
    return (
        f"With robot.yaml's {f.words.area_factor} the same would be done by: {others}. To tell them apart: weigh what the tip "
        f"carries, hang a known mass on it without {f.words.pressure}, hold a gauge against the {f.words.pressures}, and measure "
        "a section."
    )


def as_stiff(c: Calibration) -> str:
    """What a body that looks the same is, against that of robot.yaml."""
    if c.stiffness > 2:
        return f"{c.stiffness:.1f} times as stiff"
    return f"{100 * abs(c.stiffness - 1):.0f} % {'stiffer' if c.stiffness > 1 else 'softer'}"


ORIGINS = {
    "pressures": "the readings of the {pressures}",
    "cavities": "the body's stiffness, as its section is drawn without the cavities of the {actuators},",
    "area_factor": "area_factor (effective over geometric area of the {actuators})",
}
"""Origins that robot.yaml does not hold, or whose key says little -> what to call them, in templates of `Words`."""


def stands_for(c: Calibration | None, words: Words) -> str:
    """What a calibrated area factor may stand for, and what tells; empty where it is that of robot.yaml."""
    if c is None or abs(c.stiffness - 1) < judgement.CALIBRATION_STATED or not c.origins:
        return ""
    possible = [
        f"{words.fill(ORIGINS.get(o.name, o.name))} {100 * abs(o.factor - 1):.1f} % {'larger' if o.factor > 1 else 'smaller'} "
        f"(p = {stated(o.probability)})"
        for o in c.origins
        if o.probability >= LEAST_STATED or o is c.origins[0]
    ]
    stiff = any(o.name in ("youngs_modulus", "bending_stiffness") for o in c.origins)
    by_mass = (
        f"measure the body's stiffness without {words.pressures} (a stiffness trial, or a mass at the tip), " if stiff else ""
    )
    return (
        "What calibration changed may stem from one wrong number (p: probability that it makes up most of the change): "
        f"{', or '.join(possible)}. To find out, {by_mass}hold a gauge against the {words.pressures}, and measure a section"
    )


def closed_by_calibration(f: Facts) -> float | None:
    """Share of the reducible gap that calibration closes, where it changed a number and that is most; None otherwise."""
    w = f.waterfall
    if f.calibration is None or w is None or not (_factor(f) or f.first):
        return None
    closed = share_closed(w.given_mm, w.steps[0].left_mm, f.where.noise_floor_mm)
    return closed if closed is not None and closed > judgement.EXPLAINS else None


def _by_calibration(f: Facts, otherwise: str, rest: str = "") -> str:
    """What calibration closes of the uncalibrated gap and then the `rest`, where that is most of it; else `otherwise`."""
    closed = closed_by_calibration(f)
    return (
        otherwise if closed is None else f"Calibration closes {percent(closed)} % of the reducible gap; beyond it, {rest}".strip()
    )


def beyond_tolerance(p: FitParameters, moved: Mapping[int, float], robot: Robot) -> Iterator[Finding]:
    """One finding on the numbers of robot.yaml that a fit moves beyond their tolerances (`FitParameters.tense`)."""
    by_stiffness = robot.bending_stiffness is not None
    each = []
    for i, value in moved.items():
        (by, unit), (sd, sd_unit) = (_in_percent(v, p.infos[i].unit) for v in (abs(value), float(p.sd[i])))
        name = "bending_stiffness" if p.infos[i].source == "youngs_modulus" and by_stiffness else p.infos[i].source
        each.append(finding("number_above" if value > 0 else "number_below", name=name, by=by, unit=unit, sd=sd, sd_unit=sd_unit))
    if each:
        yield finding("beyond_tolerance", numbers=each)


def _in_percent(value: float, unit: str) -> tuple[float, str]:
    """A value and its unit as a person reads them; a pure number in percent."""
    return (100 * value, "%") if unit == "1" else for_people(value, unit)


def far_off(stiffness: float, words: Words) -> Iterator[Finding]:
    """A finding where the calibrated body is `stiffness` times as stiff as that of robot.yaml: a wrong unit does that."""
    if not 1 / judgement.OTHER_UNIT < stiffness < judgement.OTHER_UNIT:
        yield finding("stiffness_far_off", words, stiffness=stiffness, pressure_ratio=1 / stiffness)


def scatter(excess: float) -> Iterator[Finding]:
    """A finding where repeats scatter `excess` times more than usual."""
    if excess >= judgement.USUAL_EXCESS:
        yield finding("scatter_of_repeats", factor=excess)


def against(
    sizes: Sequence[Size], named: Sequence[str], errors: Sequence[StageError], names: Mapping[str, str], words: Words
) -> Iterator[Finding]:
    """What speaks against the effects named: a size that cannot be, a stage that asks for an error of its own next to them."""
    for x in (x for x in sizes if x.impossible):
        number, unit = for_people(x.mean, x.unit, words)
        yield finding("impossible_size", parameter=with_id(x.name, names), size=f"{number:.3g} {unit}".rstrip())
    for e in errors[:2] if named else ():
        yield finding("stage_error", stage=e.stage, varies=words.fill(e.varies), gain=e.gain)


def _simulator(f: Facts) -> str:
    """How the simulator in the rod's place differs from the rod, and how much of that the measurements do not show."""
    simulator = f.simulator
    if simulator is None:
        return ""
    acts = _simulator_acts(f, simulator)
    difference = f"{acts}{simulator.name} differs from the rod of robot.yaml by {simulator.differs_mm:.2f} mm rms"
    beyond = f"and by {simulator.beyond_calibration_mm:.2f} mm after {f.words.an_area_factor} is fitted"
    if simulator.beyond_calibration_mm < f.where.noise_floor_mm:
        return f"{difference}, {beyond}: less than the noise floor."
    step = next((s for s in (f.waterfall.steps if f.waterfall else ()) if s.step == "simulator"), None)
    remark = f" Without that part, {step.left_mm:.2f} mm of the gap remain on unseen states." if step else ""
    explains = judgement.EXPLAINS
    if step and simulator.share > explains and step.mm > explains * (step.mm + step.left_mm - f.where.noise_floor_mm):
        remark += f" The gap is in {simulator.name}."
    return f"{difference}, {beyond}; the measurements do not show {simulator.not_measured_mm:.2f} mm of that (in-sample).{remark}"


def _simulator_acts(f: Facts, s: Simulator) -> str:
    """At how many times the pressure the simulator acts, and where to look for why; empty where calibration closes little."""
    c, w = f.calibration, f.waterfall
    if c is None or w is None or closed_by_calibration(f) is None:
        return ""
    calibrated_mm = w.steps[0].left_mm
    text = f"{_acts_as(f, s, c)}; that closes {w.given_mm - calibrated_mm:.1f} of {w.given_mm:.1f} mm."
    if s.of_robot is None:
        return f"{text} "
    of_rod, of_data = s.area_factor / s.of_robot, c.area_factor / s.of_robot
    if abs(of_data - 1) < judgement.SAME_FACTOR < abs(of_rod - 1):
        text += f" The rod of robot.yaml does not: the gap is in {s.name}; check its {f.words.pressures}, areas and modulus."
    elif abs(of_rod - 1) < judgement.SAME_FACTOR:
        text += f" So does the rod: check area_factor and youngs_modulus of robot.yaml, and the gain of the {f.words.pressures}."
    return f"{text} "


def _moved(f: Facts) -> str:
    what, digits = _what(f)
    shares = [
        f"{plain_name(c.effect, f.names)} moves {what} by {c.mm:.{digits}f} mm (95 %: {c.low95_mm:.{digits}f} to "
        f"{c.high95_mm:.{digits}f} mm)"
        for c in f.budget
        if c.role == "named"
    ]
    if not shares:
        return ""
    gap = f.waterfall.steps[0].left_mm if f.waterfall is not None else f.where.gap_rmse_mm
    more = max(c.mm for c in f.budget if c.role == "named") > judgement.MORE_THAN_GAP * gap
    hidden = ", more than the gap, since tolerances of other effects counteract it" if more else ""
    return f"Beyond what {f.words.an_area_factor} takes up, {'; '.join(shares)}{hidden}."


def _closing(f: Facts) -> str:
    """What the leading hypothesis does on unseen states."""
    if f.shrink is None or f.conclusion in ("none", "noise", "too little data"):
        return ""
    _, digits = _what(f)
    before, after = f"{f.shrink.before_mm:.{digits}f}", f"{f.shrink.after_mm:.{digits}f}"
    share, alone = f.shrink.share_closed, closed_alone(f.waterfall, f.shrink)
    if f.decision.verdict == "effect":
        if share is None:
            return f"On unseen states {after} mm remain; calibration alone leaves {before} mm, hardly above the noise floor."
        if share < 0:
            return f"On unseen states it makes the prediction worse: {before} mm without it, {after} mm with it."
        clause = "" if alone is None else f", {percent(alone)} % by itself and the rest by tolerances of other effects"
        return f"With it, {after} mm remain on unseen states: {percent(share)} % of the reducible gap is closed{clause}."
    nearest = " and ".join(with_id(e, f.names) for e in f.nearest)
    if not nearest or share is None:
        return ""
    if share < judgement.EXPLAINS:
        return (
            f"Closest: {nearest}, which does not explain the gap ({before} mm without it, {after} mm with it on unseen states)."
        )
    return (
        f"Closest: {nearest}, which closes {percent(share)} % of the reducible gap on unseen states but leaves errors that "
        "are no noise."
    )


def closed_alone(w: Waterfall | None, s: Shrink | None) -> float | None:
    """Share of the reducible gap that what is named closes without any tolerance of other effects; None where tolerances hardly
    add to it."""
    left = [step.left_mm for step in (w.steps if w else ()) if step.step == "cause"]
    if not left or s is None or s.share_closed is None or s.share_closed < 0:
        return None
    alone = share_closed(s.before_mm, left[-1], s.floor_mm)
    return None if alone is None or alone >= judgement.EXPLAINS * s.share_closed else max(alone, 0.0)


def _robot(f: Facts) -> str:
    """What the robot with the cause alone leaves, which is the one that other commands use."""
    if f.fitted is None:
        return ""
    return (
        f"The robot with it, one {f.words.area_factor}{_factor(f)} and nothing else, as `lab fit --with` writes it, misses the "
        f"tip by {f.fitted.left_mm:.2f} mm (in-sample; {f.fitted.calibrated_mm:.2f} mm without it)."
    )


def _absorbed(f: Facts) -> str:
    a = None if f.waterfall is None else f.waterfall.absorbed
    if a is None or f.decision.verdict != "effect" or a.per_length_mm > judgement.ABSORBED * a.one_mm:
        return ""
    left = f"{a.per_length_mm:.2f} mm would remain of {a.one_mm:.2f} mm"
    return f"{f.words.an_area_factor.capitalize()} for each spine length would hide it: {left} ({a.how})."


def also_present(budget: Sequence[Carries], name: Callable[[str], str], digits: int) -> str:
    """The sentence on effects that are there without being a cause, each by its `name`; empty where there is none."""
    found = ", ".join(f"{name(c.effect)} {c.mm:.{digits}f} mm" for c in budget if c.role == "present")
    return f"Also present: {found}." if found else ""


def _odd(f: Facts) -> str:
    if f.decision.verdict != "unknown" or f.odd_trial is None:
        return ""
    return f"Trial {f.odd_trial} does not fit the others: check it first."


def stiffness_sentence(pushes: Mapping[str, Any], d: Decision) -> str:
    """A sentence about the stiffness trials beside tips; `pushes` is the diagnosis' detail of them."""
    before, after = (pushes["waterfall_mm"][name] for name in ("calibrated", "explained"))
    floor = pushes["floor_mm"]
    of = "noise floor" if pushes["floor_from_repeats"] else "none was repeated; assumed noise floor"
    text = (
        f"The calibrated model misses the deflections of the stiffness trials by {before:.3f} mm rms (in-sample; {of} "
        f"{floor:.3f} mm)"
    )
    if d.verdict != "effect":
        return f"{text}."
    return f"{text}; with the cause, by " + ("as much." if f"{after:.3f}" == f"{before:.3f}" else f"{after:.3f} mm.")


def disorder(ranking: Sequence[Ranked]) -> str:
    """Why probability and evidence disagree in order; empty where they agree.

    That a cause lies outside the catalogue has no evidence of its own.
    """
    listed = [r for r in ranking if r.effects != UNKNOWN and r.probability >= LEAST_STATED]
    disordered = [(a, b) for a, b in combinations(listed, 2) if a.probability > b.probability and a.log_evidence < b.log_evidence]
    if not disordered:
        return ""
    if any(len(b.effects) <= len(a.effects) and b.effects for a, b in disordered):
        return (
            "Probability and evidence differ in order: a probability counts how often an effect moves the readings by more than "
            "the noise floor, over the fits of all hypotheses, in which the other effects are tolerances; log evidence is that "
            "of one fit. Take the first for a candidate, and make the proposed experiment."
        )
    return (
        "Probability and evidence differ in order: of two hypotheses the one with more log evidence may be less probable, since "
        "one that names more effects has a smaller prior, and only an effect that carries more than the noise floor is named."
    )
