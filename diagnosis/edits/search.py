"""Find edits of robot.yaml and table that improve the rod's fit greatly, alone and in pairs, before the diagnosis.

The diagnosis is local: around a description that is far off, each of its hypotheses is wrong. So the edits of the list are
weighed against the robot as described, and those that are probable are made first. What the diagnosis names itself (a weight, a
chamber a little weaker, a drift) competes, and where it does as well, nothing is changed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import groupby
from operator import attrgetter

import numpy as np
from scipy.special import softmax

from model.effects.laws.actuation import orders
from model.effects.shows import sides_apart
from model.robot import Robot
from recordings.trials import Table, pressure_columns

from .. import judgement
from ..arrays import Array
from ..data.campaign import Campaign
from ..findings import Finding, finding
from .edit import AREA, AZIMUTH, MODULUS, Edit, Variants, times
from .listed import every_edit, of_attitudes
from .misfit import Fit, Sample, as_described, sample_of
from .of_table import of_table
from .order import ORDER, equal, order_at, with_order

STILL = Edit("still", 0.1, apply=times(0.0, "pressure", "gravity", "mass", "force", "moment"), left=True)
"""A rod that nothing moves: an edit that does no better, as it stiffens all motion away, is no mistake that can be named."""


@dataclass(frozen=True)
class Edited:
    """The robot and the states for the diagnosis, with the changes made."""

    robot: Robot
    states: Campaign
    changes: tuple[Finding, ...] = ()
    before_mm: float = 0.0
    after_mm: float = 0.0
    """Robust rms of the tip within `EDIT_USUAL`, and with the edits."""
    fit: Fit | None = None
    """None where nothing was changed."""
    with_order: bool = False
    """Whether chambers connected in another order are now an effect of the robot."""

    @property
    def concerns(self) -> list[Finding]:
        """Findings for a person to check; empty if nothing was changed."""
        changes, before, after = [*self.changes], self.before_mm, self.after_mm
        return [finding("refitted_first", before_mm=before, after_mm=after, changes=changes)] if changes else []

    @property
    def numbers(self) -> tuple[Finding, ...]:
        """The changes that are no effect of the robot."""
        return self.changes[self.with_order :]

    @property
    def named(self) -> str:
        """The changes, or their number, in a few words; empty if there are none."""
        names = [str(c.values["short"]) for c in self.numbers]
        return f"{len(names)} numbers of robot.yaml" if len(names) > 1 else "".join(names)

    @property
    def headline(self) -> str:
        """The mistake that is not a number of robot.yaml, in a line; empty if there is none."""
        first = next((c for c in self.changes if c.code != "refitted"), None)
        return "" if first is None else f"{first.text[0].upper()}{first.text[1:].partition(':')[0]}."

    @property
    def at_bound(self) -> bool:
        """Whether a number reached the limit of its fit, so that another one is wrong too."""
        return any(c.values.get("limit") for c in self.changes)

    def detail(self) -> dict[str, object]:
        """Plain values for the answer's JSON."""
        adjusted = [{"code": c.code, **c.values, "at_bound": bool(c.values.get("limit"))} for c in self.numbers]
        numbers = {"before_mm": self.before_mm, "after_mm": self.after_mm, "adjusted": adjusted}
        return numbers | ({"order": self.changes[0].text} if self.with_order else {})

    def moved(self, states: Campaign) -> Campaign:
        """Other states with the same edits, but for those of one campaign alone."""
        if self.fit is None:
            return states
        own = {e.kind for e in self.fit.edits if e.of_this_campaign or (self.with_order and e.kind == "order")}
        trials = corrected(self.robot, states.trials, self.fit, _beyond_usual(self.fit), own)[1]
        return replace(states, trials=trials, history=states.history and self.moved(states.history))


def edit_first(robot: Robot, states: Campaign, effects: Collection[str] = ()) -> Edited:
    """Make the edits that fit far better. A robot that is near its data, or has its own effects, is returned unchanged.

    `effects`: those that are weighed afterwards. Where the one that exchanges chambers is among them and they were inflated
    on several sides, another order that it knows is taken for that, as an effect of the robot.
    """
    sample = None if robot.effects or robot.tolerances else sample_of(robot, states)
    found = None if sample is None else judged(sample)
    return Edited(robot, states) if found is None or not found.chosen else _made(robot, states, found, found.chosen, effects)


@lru_cache(maxsize=judgement.EDIT_SAMPLES)
def judged(sample: Sample) -> Judged:
    """The edits of robot and states that were tried, once for each sample; none where the robot is near its data."""
    near = max(sample.fitted([(f.edits, f.x) for f in as_described(sample)], 10), key=attrgetter("log_posterior"))
    near = replace(near, log_posterior=near.log_posterior + float(np.log(judgement.EDIT_NONE)))
    usual = not (np.abs(near.theta) > judgement.EDIT_NEAR_BOUND * judgement.EDIT_USUAL)[1:].any()
    if sample.aligned(near) and not sample.ambient and (sample.reached(near) or sample.near(near) and usual):
        return Judged(sample, [near], np.ones(1))
    still = sample.fitted([((STILL,), near.x)], 3, alone=True)
    edits = [*every_edit(sample, near), *of_table(sample, near)]
    fits = [near, *still, *_weighed(sample, edits, near, pairs=not sample.near(near))]
    return Judged(sample, fits, softmax([f.log_posterior for f in fits]))


def _weighed(sample: Sample, edits: list[Edit], near: Fit, pairs: bool) -> list[Fit]:
    """Fits of single edits, and of `pairs` with the best ones where none of them is enough."""

    def nearness(f: Fit) -> float:  # what is minimised tells more than the evidence before a fit has converged
        return -float(sample.rms(f.missed))

    def tried(first: Sequence[Fit], edits: Sequence[Edit], steps: int, both: bool = False) -> list[Fit]:
        sets = [(f, (*f.edits, edit)) for f in first for edit in edits if edit.kind not in {e.kind for e in f.edits}]
        if not sets:
            return []
        starts = [(each, pair) for f, each in sets for pair in sample.starts(each, f)]
        begun = sample.fitted([(each, x) for each, pair in starts for x in pair], 0)
        better = begun if both else [max(begun[k : k + 2], key=nearness) for k in range(0, len(begun), 2)]
        begun = sample.fitted([(f.edits, f.x) for f in better], steps, alone=True)
        fits = [max(own, key=nearness) for _, own in groupby(begun, key=lambda f: id(f.edits))]
        best = _best_of_kinds(fits, nearness)[: judgement.EDIT_REFINED]
        return [*sample.fitted([(f.edits, f.x) for f in best], 8), *(f for f in fits if not any(f is b for b in best))]

    alone = tried([near], edits, 2)
    if pairs and not any(map(sample.reached, alone)):  # the nearer start may lie in another valley than the solution
        alone = tried([near], edits, 2, both=True)
    best = _best_of_kinds(alone, attrgetter("log_posterior"))[: judgement.EDIT_FOLLOWED]
    if sample.reached(best[0]):
        explained = sample.aligned(best[0]) or best[0].edits[0].kind == "attitude"
        return alone if explained else [*alone, *tried(best[:1], list(of_attitudes(sample, best[0])), 1)]
    return [*alone, *tried(best, edits, 1)] if pairs else alone


def _best_of_kinds(fits: list[Fit], merit: Callable[[Fit], float]) -> list[Fit]:
    """The fit of most merit whose last edit is of each kind, with parameters of its own or without, the best first."""
    best: dict[tuple[str, bool], Fit] = {}
    for f in sorted(fits, key=merit, reverse=True):
        best.setdefault((f.edits[-1].kind, bool(f.edits[-1].bounds)), f)
    return [*best.values()]


def _beyond_usual(fit: Fit) -> Array:
    """(8,) the calibration without what the diagnosis can describe itself; the area factor goes with the others, in proportion to
    the modulus: with this alone left out a limp body may snap to another equilibrium."""
    widened = np.isin(np.arange(8), [number for edit in fit.edits for number in edit.widens])
    theta = np.where(widened & (np.abs(fit.theta) > judgement.EDIT_USUAL), fit.theta, 0.0)
    theta[AREA] = fit.theta[AREA] - (fit.theta[MODULUS] - theta[MODULUS])
    return theta


@dataclass(frozen=True)
class Judged:
    """Fits of all edits and pairs that were tried, and the probability of each."""

    sample: Sample
    fits: list[Fit]
    weight: Array

    def probability(self, kind: str) -> float:
        """Of a mistake of a kind."""
        return float(sum(w for w, kinds in zip(self.weight, self._kinds, strict=True) if kind in kinds))

    @cached_property
    def _kinds(self) -> list[set[str]]:
        """Of the mistakes of each fit."""
        return [{edit.kind for edit, _ in mistakes(self.sample.robot, fit)} for fit in self.fits]

    @property
    def chosen(self) -> Fit | None:
        """The most probable fit, or one of the same mistakes that misses clearly less and may be right; None where it holds no
        mistake, or it is not certain that there is one."""
        best = int(np.argmax(self.weight))
        alike = [k for k in np.flatnonzero(self.weight > judgement.EDIT_STATED).tolist() if self._kinds[k] == self._kinds[best]]
        floor, rms = judgement.EDIT_MODEL_ERROR * self.sample.robot.length, self.sample.between_and_within
        between = {k: np.hypot(rms(self.fits[k].missed)[0], floor) for k in (*alike, best)}
        nearest = min(between, key=between.__getitem__)
        best = nearest if between[nearest] < judgement.EDIT_AS_WELL * between[best] else best
        of_mistakes = float(sum(w for w, kinds in zip(self.weight, self._kinds, strict=True) if kinds))
        return self.fits[best] if of_mistakes >= judgement.CAUSE_PROBABILITY and self._kinds[best] else None

    def rather(self, edit: Edit, own: Array, fit: Fit) -> str:
        """What else may be wrong in place of a mistake of a fit, for the end of its sentence: mistakes of other kinds, and those
        of its kind that are stated in other words."""
        made, others = edit.findings(self.sample.robot, fit.theta, own)[0], dict[str, tuple[float, str]]()
        for k in np.argsort(-self.weight):
            tried, p = self.fits[k], float(self.weight[k])
            for other, at in mistakes(self.sample.robot, tried) if p >= judgement.EDIT_STATED else ():
                said, same = other.findings(self.sample.robot, tried.theta, at, p)[0], other.kind == edit.kind
                elsewhere = (said.code, said.values["short"]) != (made.code, made.values["short"])
                if edit.kind not in self._kinds[k] or (same and elsewhere):
                    others.setdefault(other.kind, (p, f"{'instead, included in this p, ' if same else ''}{said}"))
        return "".join(f"; or {text}" for _, text in sorted(others.values(), reverse=True))


def mistakes(robot: Robot, fit: Fit) -> list[tuple[Edit, Array]]:
    """The edits of a fit that change something, and their parameters."""
    pairs = zip(fit.edits, fit.own, strict=True)
    return [(edit, own) for edit, own in pairs if not edit.left and edit.says(robot, fit.theta, own)]


def corrected(robot: Robot, table: Table, fit: Fit, theta: Array, left_out: Collection[str] = ()) -> tuple[Robot, Table]:
    """Robot and table with calibrations theta (8,) and the mistakes of a fit, but for those of the kinds `left_out`."""
    made = Variants.of(robot, table).calibrated(theta[None]).levered(1.0)
    for edit, own in mistakes(robot, fit):
        made = made if edit.kind in left_out else edit.apply(made, own[None])
    return made.levered(-1.0).written()


def _made(robot: Robot, states: Campaign, found: Judged, fit: Fit, effects: Collection[str]) -> Edited:
    """Robot and states with the edits of a fit."""
    theta = _beyond_usual(fit)
    # without chambers inflated that bend to several sides, nothing tells one order from another
    weighed = ORDER in effects and sides_apart(robot, states.pressure[~states.pushed])
    place = _place(robot, fit, theta) if weighed else None
    if place is not None:
        theta[AZIMUTH] = 0.0
    as_effect = {"order"} if place is not None else set[str]()
    made, table = corrected(robot, states.trials, fit, theta, as_effect)
    if place is not None:
        made = with_order(made, place)
    changes = list[Finding]()
    for edit, own in sorted(mistakes(robot, fit), key=lambda one: one[0].kind not in as_effect):
        changes += edit.findings(found.sample.robot, fit.theta, own, found.probability(edit.kind), found.rather(edit, own, fit))
    before, after = (1e3 * float(found.sample.rms(f.missed[found.sample.places])) for f in (found.fits[0], fit))
    edited = Edited(made, states, tuple(changes), before, after, fit, place is not None)
    return replace(edited, states=replace(states, trials=table, history=states.history and edited.moved(states.history)))


def _place(robot: Robot, fit: Fit, theta: Array) -> int | None:
    """Which order that the effect knows has the chambers act as in a fit; None where none does."""
    edit = next((e for e in fit.edits if e.kind == "order"), None)
    if edit is None:
        return None
    every = np.arange(len(robot.actuators.azimuths_deg))
    numbered = Table({name: np.array([float(k)]) for k, name in enumerate(pressure_columns(len(every)))})
    azimuth = (theta * (np.arange(8) == AZIMUTH))[None]
    made = edit.apply(Variants.of(robot, numbered).calibrated(azimuth), np.zeros((1, len(edit.bounds))))
    acting, order = np.empty(len(every)), made.pressure[0, 0].astype(np.int64)
    acting[order] = made.azimuth[0, 0]
    known, acts = orders(robot.actuators.azimuths_deg).tolist(), order_at(robot, acting)
    return known.index(acts) if acts in known and ((order != every).any() or equal(robot, acts)) else None
