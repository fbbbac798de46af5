"""Diagnose, choose the most informative experiment for its time, predict it, do it, diagnose again.

    bits gained = sum_h q_h log2(q_h / p_h),    p before the experiment, q after

What each rival predicts is written down before the experiment runs. The readings then judge it, by their density and by their
distance from it. If no rival predicted the readings, the cause is probably outside the catalogue.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from model.effects.design import design_from_columns

from .answer.experiments import planned
from .answer.result import Diagnosis, Proposal
from .answer.rivals import Rivals
from .arrays import rms
from .data.case import Case, states
from .diagnose import Examined, Options, examine
from .errors import BadCase
from .inference.prepare import table_columns
from .judgement import CERTAIN, UNFORESEEN


@dataclass(frozen=True)
class RivalPrediction:
    """What one hypothesis predicts for the planned states."""

    effects: tuple[str, ...]
    probability: float
    """Among the rivals."""
    tip_mm: Sequence[Sequence[float]]
    sd_mm: Sequence[Sequence[float]]
    """By state: x, y, z and their standard deviations."""


@dataclass(frozen=True)
class Predicted:
    """An experiment, and what is expected of it, before it runs."""

    proposal: Proposal
    rivals: tuple[RivalPrediction, ...]

    @property
    def telling(self) -> int | None:
        """The state in which the predictions differ most, for their uncertainty; None where nothing is predicted."""
        if not self.rivals or not self.rivals[0].tip_mm:
            return None
        tip, sd = (np.array([getattr(r, name) for r in self.rivals]) for name in ("tip_mm", "sd_mm"))
        return int(np.nanargmax(np.nanmax(np.ptp(tip, axis=0) / np.maximum(sd.min(axis=0), 1e-6), axis=-1)))


@dataclass(frozen=True)
class Tested:
    """How the prediction of one hypothesis came out."""

    effects: tuple[str, ...]
    rms_mm: float
    """Distance of the tips read from those predicted at the pressures that were reached."""
    p_value: float
    bits: float
    """By which the readings speak for it against the best of the rivals; 0 for that one."""

    @property
    def failed(self) -> bool:
        """The readings are not among what it predicts."""
        return self.p_value < UNFORESEEN


@dataclass(frozen=True)
class Round:
    """A diagnosis, and the experiment chosen after it."""

    diagnosis: Diagnosis
    minutes: float
    """Spent on experiments so far."""
    predicted: Predicted | None = None
    judged: tuple[Tested, ...] = ()
    bits: float = 0.0
    """Gained by the experiment, from this diagnosis to the next."""
    refused: Mapping[str, str] = field(default_factory=dict)
    """More informative experiments, and why they were not done."""

    @property
    def unforeseen(self) -> bool:
        """No rival predicted the readings."""
        return bool(self.judged) and all(j.failed for j in self.judged)


@dataclass(frozen=True)
class Investigation:
    """All rounds, and why it ended."""

    rounds: tuple[Round, ...]
    ended: str

    @property
    def answer(self) -> Diagnosis:
        """The last diagnosis."""
        return self.rounds[-1].diagnosis

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {"schema": "investigation/1", "ended": self.ended, "rounds": [_round(r) for r in self.rounds]}


class NotDone(Exception):
    """An experiment that cannot be done here, or that the person does not want; says why."""


class Laboratory(Protocol):
    """Where experiments are done."""

    def refusal(self, proposal: Proposal) -> str:
        """Why this one cannot be done; empty where it can."""

    def perform(self, predicted: Predicted) -> Case:
        """Save the prediction, do the experiment and return the campaign with its states appended. Raises `NotDone`."""


def settled(d: Diagnosis) -> bool:
    """Whether nothing more needs to be asked."""
    return d.attribute.verdict != "unknown" and d.attribute.probability >= CERTAIN


def investigate(
    case: Case,
    laboratory: Laboratory,
    options: Options,
    minutes: float,
    experiments: int,
    diagnosed: Callable[[Round], None] = lambda _: None,
) -> Investigation:
    """Diagnose and experiment until the cause is settled, no experiment on the menu is informative, or a limit is reached:
    `minutes`, the estimated time of all experiments with their preparation, or the number of `experiments`.

    `diagnosed` gets each round as soon as its diagnosis is there. Raises `BadCase`, and what the laboratory raises.
    """
    rounds: list[Round] = []
    spent = 0.0
    while True:
        examined = examine(case, options)
        if rounds:
            rounds[-1] = replace(rounds[-1], bits=bits_gained(rounds[-1].diagnosis, examined.diagnosis))
        this_round = Round(examined.diagnosis, spent)
        diagnosed(this_round)
        if settled(examined.diagnosis) or len(rounds) >= experiments:
            reason = "settled" if settled(examined.diagnosis) else f"{len(rounds)} experiments were done"
            return Investigation((*rounds, this_round), reason)
        refused: dict[str, str] = {}
        done = {r.predicted.proposal.id for r in rounds if r.predicted is not None}
        for proposal in (p for p in examined.diagnosis.next_experiment if p.id not in done):
            try:
                predicted, extended = _performed(examined.rivals, proposal, laboratory, minutes - spent)
            except NotDone as e:
                refused[proposal.id] = str(e)
                continue
            rounds.append(replace(this_round, predicted=predicted, judged=judge(examined, case, extended), refused=refused))
            spent, case = spent + proposal.cost_min, extended
            break
        else:
            ended = f"no {'further possible ' if refused else ''}experiment is expected to be informative"
            return Investigation((*rounds, replace(this_round, refused=refused)), ended)


def _performed(rivals: Rivals, proposal: Proposal, laboratory: Laboratory, minutes: float) -> tuple[Predicted, Case]:
    """The prediction, and the campaign with the experiment. Raises `NotDone`, also if it takes more than `minutes`."""
    if why := laboratory.refusal(proposal):
        raise NotDone(why)
    if proposal.cost_min > minutes:
        raise NotDone(f"takes {proposal.cost_min:g} min, {minutes:.0f} are left")
    predictions = rivals.predict(planned(rivals.prepared, replace(proposal, channels=()))) or ()
    of_rivals = zip(rivals.candidates, rivals.weight, predictions, strict=False)
    made = tuple(RivalPrediction(c.named, float(w), *(1e3 * np.array(q.tip)).round(3).tolist()) for c, w, q in of_rivals)
    predicted = Predicted(proposal, made)
    return predicted, laboratory.perform(predicted)


def judge(examined: Examined, case: Case, extended: Case) -> tuple[Tested, ...]:
    """Judge each rival's prediction, made from `case`, by the rows that `extended` adds to it; empty without tips."""
    rivals, p = examined.rivals, examined.rivals.prepared
    new_rows = extended.table.take(np.arange(len(case.table), len(extended.table)))
    try:
        read = examined.first.moved(states(Case(p.robot, new_rows))[0])
    except BadCase:
        return ()
    read = read.take(~read.pushed)
    table = table_columns(read)
    predictions = rivals.predict(table) if len(read) else None
    if predictions is None:
        return ()
    observed = p.forward.on(design_from_columns(p.robot, table)).observe(table)
    log_p = [float(q.log_density(np.nan_to_num(observed[None, :]))[0]) for q in predictions]
    contrasts = p.noise_components.contrasts
    return tuple(
        Tested(c.named, 1e3 * rms(read.tip - q.tip[0]), q.p_value(observed, contrasts), float((own - max(log_p)) / np.log(2)))
        for c, q, own in zip(rivals.candidates, predictions, log_p, strict=True)
    )


def bits_gained(before: Diagnosis, after: Diagnosis) -> float:
    """Kullback-Leibler divergence of the probabilities after from those before, bits."""
    p = {r.effects: r.probability for r in before.attribute.ranking}
    q = {r.effects: r.probability for r in after.attribute.ranking}
    known = [(q[h], p[h]) for h in q if h in p and q[h] > 0 and p[h] > 0]
    # What only one of the rankings shows is taken together, as what the other leaves.
    rest = (max(1 - sum(a for a, _ in known), 0.0), max(1 - sum(b for _, b in known), 0.0))
    every = [*known, *([rest] if min(rest) > 0 else [])]
    return max(float(sum(a * np.log2(a / b) for a, b in every)), 0.0)


def _round(r: Round) -> dict[str, Any]:
    """A round as plain values for JSON."""
    attribution = r.diagnosis.attribute
    out: dict[str, Any] = {
        "verdict": attribution.verdict,
        "probability": attribution.probability,
        "ranking": [{"effects": x.effects, "probability": x.probability} for x in attribution.ranking[:6]],
        "minutes": r.minutes,
        "not_done": dict(r.refused),
    }
    if r.predicted is not None:
        out |= {
            "experiment": {name: getattr(r.predicted.proposal, name) for name in ("id", "do", "expected_bits", "cost_min")},
            "came_out": [{**asdict(j), "failed": j.failed} for j in r.judged],
            "unforeseen": r.unforeseen,
            "bits_gained": r.bits,
        }
    return out
