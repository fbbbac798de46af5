"""The answer in one line of at most 20 words: the cause, its size in a person's unit, and its probability."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from model.actuators import Chambers, Words
from model.effects.spec import EffectSpec
from model.robot import THRUST

from ..criticism.relatives import PLACES, RELATIVES
from ..inference.posterior import UNKNOWN
from ..judgement import CAUSE_PROBABILITY, LEAST_STATED, LIKELY, SAME_FACTOR, TIE_STATED
from .result import Concentrated, Diagnosis, Value
from .size import places_found
from .verdict import stage

MOST_WORDS = 20
ROOM = MOST_WORDS - 5
"""Words for the cause itself, without "most likely" and (p = ..)."""
UNITS = {
    "rad": (180 / math.pi, "deg"), "rad/m": (180 / math.pi, "deg/m"), "rad/(N m)": (180 / math.pi, "deg/(N m)"),
    "m": (1e3, "mm"), "m/N": (1e3, "mm/N"), "kg": (1e3, "g"), "1": (1.0, ""),
}  # fmt: skip
"""Unit of a parameter -> factor and unit in which a person reads it."""


def for_people(value: float, unit: str, words: Words = Chambers.words) -> tuple[float, str]:
    """Return a value and its unit as a person reads them; the logarithm of a factor (ln) becomes the factor. `words` holds the
    unit for pressure or tension, which tables hold in Pa.

    >>> for_people(0.1, "m"), for_people(0.0, "ln"), for_people(2e4, "Pa")
    ((100.0, 'mm'), (1.0, 'times'), (20.0, 'kPa'))
    """
    if unit == "Pa":
        return value / words.pascal, words.unit
    if unit == "ln":
        return math.exp(value), "times"
    factor, name = UNITS.get(unit, (1.0, unit))
    return factor * value, name


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


def hypothesis_name(effects: Iterable[str], names: Mapping[str, str], ids: bool = True, joint: str = " + ") -> str:
    """Name of a hypothesis, with or without the identifiers of its effects."""
    return joint.join(with_id(e, names) if ids else plain_name(e, names) for e in effects) or NO_EFFECT


LEAST_CLOSED = 0.1
"""Share of the gap on unseen states that a cause closes of which a headline says that it is likely."""


def stated(probability: float, limited: bool = False) -> str:
    """A probability as every table shows it; a `limited` one is the largest of an answer in doubt, and no result.

    >>> stated(0.876), stated(1e-4), stated(0.8), stated(0.8, limited=True)
    ('0.88', '< 0.01', '0.80', '≤ 0.80')
    """
    return "< 0.01" if probability < LEAST_STATED else f"{'≤ ' * limited}{probability:.2f}"


def percent(share: float) -> str:
    """Return the closed share of a gap in whole percent, at most 100.

    >>> percent(0.876), percent(1.02), percent(-0.001)
    ('88', '100', '0')
    """
    return f"{round(100 * min(share, 1.0)) + 0}"


def sized(v: Value, words: Words = Chambers.words) -> str:
    """A parameter with its standard deviation, as a person reads it.

    >>> sized(Value(0.3, 0.05, "ln")), sized(Value(0.994, 0.03, "1")), sized(Value(0.0, 0.01, "rad", bound="low"))
    ('1.35 times (± 5 %)', '0.994 ± 0.03', 'at its bound 0 deg (95 %: up to 1.12)')
    """
    if not v.determined:
        return v.note
    number, unit = for_people(v.value, v.unit, words)
    if v.bound:
        end = for_people(v.interval[v.bound == "low"], v.unit, words)[0]
        return f"at its bound {number:.3g} {unit}".rstrip() + f" (95 %: {'up to' if v.bound == 'low' else 'from'} {end:.3g})"
    if v.unit == "ln":
        return f"{number:.3g} {unit} (± {100 * math.expm1(v.sd):.0f} %)"
    spread = f" ± {for_people(v.sd, v.unit, words)[0]:.2g}" * bool(v.sd)  # none of what was taken, and not fitted
    return f"{number:.3g}{spread} {unit}".rstrip()


def headline(
    d: Diagnosis,
    catalogue: Mapping[str, EffectSpec],
    by_calibration: float | None = None,
    calibrated: str = "",
    beyond: bool = False,
    alone: bool = False,
) -> str:
    """Return the conclusion in at most 20 words.

    `by_calibration`: share of the reducible gap that calibration closes, if that is most of it; `calibrated`: what it changed;
    `beyond`: it reached its limit; `alone`: one effect in its place leaves no larger error than the named ones.
    """
    a, speech, found = d.attribute, Speech(d, catalogue), {f.code: f.values for f in d.findings}
    closed = None if d.shrink is None else d.shrink.share_closed
    p = f"({a.p})"
    if shift := found.get("shifted"):
        return "Unclear: positions are logged {by} {when} from {first} to {last}: correct this first.".format(**shift)
    if a.conclusion == "too little data":
        return f"Too little data to name a cause{': ' + a.missing[0] if a.missing else ''}."
    if beyond:
        return f"Unclear: robot.yaml is too far from the data ({calibrated}): check it first."
    unsettled = found if a.verdict != "effect" or a.effects == (THRUST,) else {}
    if "drift" in unsettled:
        return f"Unclear: the robot at rest drifts by {unsettled['drift']['mm']:.1f} mm over the trials; a cause may be hidden."
    if "thrust_likely" in unsettled:
        return d.words.fill("Unclear: robot.yaml must say whether cap or walls take the thrust of the {actuators}.")
    closes, changed = f"Calibration closes {percent(by_calibration or 0.0)} %", f": {calibrated}" if calibrated else ""
    calibration_closes = "" if by_calibration is None else f"{closes} of the gap{f' ({calibrated})' if calibrated else ''}"
    other = f"no other cause {'is needed' if a.probability >= CAUSE_PROBABILITY else 'stands out'} {p}"
    other = f"perhaps {speech.named(a.too_small)}{a.p_too_small}" if a.too_small else other
    if a.effects == (THRUST,) and "thrust_settled" in found:  # that is certain; p is of the rest
        walls = d.words.fill("The side walls carry the {actuators}' thrust")
        first = walls if by_calibration is None else f"{closes} of the gap"
        return _short_enough(f"{first}; {other}. Write `thrust: walls`.", f"{first}; {other}.")
    if a.verdict == "effect":
        several, name = a.conclusion == "one of several", speech.named(a.effects)
        closes_nothing = several and closed is not None and closed < LEAST_CLOSED
        if several and calibration_closes and alone:
            return _short_enough(f"{calibration_closes}; the rest has no clear cause.", f"{calibration_closes}.")
        if closes_nothing and calibration_closes:
            return f"{calibration_closes}; no effect closes the rest."
        if closes_nothing:
            text = f"unclear: no effect closes the gap; the closest is {name} {p}."
        elif several and a.probability < LIKELY:
            text = speech.tied() or f"possibly {name} {p}."
        else:
            text = f"{speech.with_sizes(a.effects)} {p}."
            text = (speech.tied() or f"most likely {text}") if several else text
            other_body = d.calibration is not None and abs(d.calibration.stiffness - 1) > SAME_FACTOR
            if not several and calibration_closes and other_body:
                text = _short_enough(f"{text[:-1]}, beside {calibrated}.", text)
        return text[0].upper() + text[1:]
    if a.verdict == "unknown":
        if d.locate.concentrated is not None and not a.relatives:
            return f"No listed effect fits {p}; the gap is {concentrated(d.locate.concentrated, d.words)}."
        error = stage(a.stage_errors)
        may_be = [f"in the {error.stage} and {d.words.fill(error.varies)}"] if error else []
        may_be = relative(a.relatives[0], a.at_places, d.words)[0] if a.relatives else may_be
        places = [f"; it may be {one}".replace("_", " ") for one in may_be] or [""]
        return _short_enough(*(f"No listed effect fits {p}{place}." for place in places))
    if by_calibration is not None and "beyond_tolerance" in found:
        return _short_enough(*(f"{closes}{gap} beyond tolerances{changed} {p}." for gap in (" of the gap, but", ", but")))
    if by_calibration is not None:
        return _short_enough(f"{calibration_closes}; {other}.", *(f"{closes}{of}{changed} {p}." for of in (" of the gap", "")))
    if a.conclusion == "noise":
        return f"No gap: model and robot agree down to the noise floor {p}."
    return f"No cause: no known effect explains enough of the gap {p}."


def concentrated(c: Concentrated, words: Words) -> str:
    """Where the gap is, after "the gap is"."""
    if c.factor == "trial":
        return f"{'after' if c.above else 'up to'} trial {c.limit:.0f}"
    if c.factor == "branch":
        return f"on the way {'up' if c.above else 'down'}"
    of_all = {"spine_length": ("the spine's length", "m"), "tip_mass": ("the mass at the tip", "kg")}
    of_all["highest"] = (f"the highest {words.pressure}", "Pa")
    name, unit = of_all.get(c.factor, (f"the {words.pressure} of {words.actuator} {c.factor[1:]}", "Pa"))
    return f"where {name} is {'above' if c.above else 'at most'} {'{:.3g} {}'.format(*for_people(c.limit, unit, words))}"


def relative(id: str, at_places: Mapping[str, Mapping[str, Value]], words: Words) -> tuple[list[str], str]:
    """Names of a relative, the one that says most first, and the test that shows it; `at_places` as in `Attribute`."""
    spec, sizes = RELATIVES[id], at_places.get(id, {})
    places = places_found(sizes)
    where = places[0] if places else words.fill(PLACES[id][1]) if id in PLACES else ""
    in_full = [f"{place} ({_amount(sizes[place].value, sizes[place].sd, sizes[place].unit, words)})" for place in places]
    names = [words.fill(spec.says, " and ".join(each)) for each in (in_full, places) if each]
    return [*names, spec.name(words)], words.fill(spec.seen_best_in, where)


def _short_enough(*texts: str, most: int = MOST_WORDS) -> str:
    """The first text of at most `most` words, else the last one."""
    return next((text for text in texts if len(text.split()) <= most), texts[-1])


@dataclass(frozen=True)
class Speech:
    """The sources of a sentence's words, and the effects in these words."""

    d: Diagnosis
    catalogue: Mapping[str, EffectSpec]

    def tied(self) -> str:
        """The named effects and the next hypothesis, if both fit and it is nearly as probable, or one of those that the rest
        shape would tell apart; else empty. Sizes are given only for what is likely."""
        a, hidden = self.d.attribute, any(f.code == "cause_hidden_at_rest" for f in self.d.findings)
        others = (r for r in a.ranking if r.effects != a.effects and (not hidden or set(r.effects) & set(a.rivals)))
        second = max(others, key=lambda r: r.probability, default=None)
        if second is None or not (hidden or second.probability >= a.probability - TIE_STATED):
            return ""
        both = (a.effects, second.effects)
        in_full, by_name = (self.with_sizes(effects, spread=False) for effects in both), map(self.named, both)
        ways = (in_full, by_name) if a.probability >= LIKELY else (by_name,)
        return _short_enough(*(f"{first} or {other} ({a.p}, {second.probability:.2f})." for first, other in ways), "")

    def named(self, effects: Sequence[str]) -> str:
        """The plain names of effects."""
        return hypothesis_name(effects, self.d.names, ids=False, joint=" and ")

    def with_sizes(self, effects: Sequence[str], spread: bool = True) -> str:
        """The effects with the sizes that the ranking has, or names alone if those do not fit; `spread` adds standard deviations
        if they fit."""
        if tuple(effects) == UNKNOWN:
            return "the cause is outside the catalogue"
        if not effects:
            return "there is no cause"
        found = ((r.parameters, r.in_words) for r in self.d.attribute.ranking if r.effects == tuple(effects))
        sizes, in_words = next(found, ({}, {}))
        said = (" and ".join(self._says(e, sizes, in_words.get(e, ()), each) for e in effects) for each in (spread, False))
        names = [self.named((e,)) for e in effects]
        return _short_enough(*said, *(", ".join(names[:k]) for k in (3, 2, 1)), most=ROOM)

    def _says(self, effect: str, sizes: Mapping[str, Value], in_words: Sequence[str], spread: bool) -> str:
        """One effect `in_words`, else with its size (parameter -> value) in a person's unit, and with `spread` its sd."""
        spec, words = self.catalogue.get(effect), self.d.words
        if spec is None or not spec.says:
            return f"{self.named((effect,))} is at work"
        if in_words:
            return in_words[0 if spread else 1]
        quoted = "{:.3g} {}".format(*for_people(self.d.data.quoted_pressure, "Pa", words))
        parts = [p for p in spec.parameters if p.role == "size" and f"{effect}.{p.name}" in sizes]
        if not any(sizes[f"{effect}.{p.name}"].determined for p in parts):
            return words.fill(re.sub(r"\[(\w+)\|(\w+)\]", r"\1 or \2", spec.says), "some amount", quoted=quoted)
        values = [sizes[f"{effect}.{p.name}"] for p in parts if p.unit == parts[0].unit]
        total = parts[0].sign == "positive" and len(values) > 1
        numbers = [v.value for v in values]
        size = numbers[0] if len(numbers) == 1 else sum(numbers) if total else math.hypot(*numbers)
        # of a vector's length, its parts independent; of a sum they are not
        sd = 0.0 if total or not size else math.hypot(*(v.value / size * v.sd for v in values))
        template = re.sub(r"\[(\w+)\|(\w+)\]", r"\1" if size >= 0 else r"\2", spec.says)
        amount = _amount(abs(size) if "[" in spec.says else size, sd if spread else 0.0, parts[0].unit, words)
        return words.fill(template, amount, quoted=quoted)


def _amount(value: float, sd: float, unit: str, words: Words) -> str:
    """A size to two digits, and its standard deviation if that is visible at this precision."""
    factor = 100.0 if unit == "1" else 0.0 if unit == "ln" else for_people(1.0, unit, words)[0]
    number, name = (100 * value, "%") if unit == "1" else for_people(value, unit, words)
    digits = max(0, 1 - math.floor(math.log10(abs(number)))) if number and unit != "1" else 0
    spread = f"{factor * sd:.{digits}f}"
    return f"{number:.{digits}f}{f' ± {spread}' if float(spread) else ''} {name}"
