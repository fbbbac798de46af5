"""The diagnosis of any forward function: its problem, the hypotheses of the listed causes, and what may lie outside of them.

Noise floors take the place of mm: each output is counted in standard deviations of its own noise. A cause outside of the list
may do anything smooth: a function of the inputs, of the place within a group, or of the predicted outputs and their change, by
itself or as a factor of what a listed cause does (`criticism.stage_errors`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from numbers import Integral
from typing import Any

import numpy as np
import pandas as pd

from model.cause import Cause

from .. import judgement
from ..answer.decision import Decision, behaves_like, capped, decide, doubted, outside_at_most, share_closed, without_nothing
from ..answer.distinguishability import distinguishability
from ..arrays import Array, Mask
from ..criticism.gaussian import Gaussian
from ..criticism.stage_errors import StageError, free_form_gain, odds_unnamed, stage_errors, total_gain
from ..errors import BadCase
from ..inference.budget import BudgetPart, Naming, weighed
from ..inference.candidate import Candidate
from ..inference.cross_validation import CrossValidation
from ..inference.cross_validation import Model as Refitted
from ..inference.discrepancy import SmoothErrors
from ..inference.evidence import KNOWN, NONE, Hypothesis, weigh
from ..inference.executor import SINGLE_THREAD, one_thread
from ..inference.fit import Fit, fit, fit_alone
from ..inference.posterior import UNKNOWN, EffectPosterior, Related, alike, log_weight, odds_of_relatives, with_unknown
from ..inference.problem import FitParameters
from ..inference.search import LAST_ROUNDS, Search
from .answer import Answer, Experiment, Left, Ranked, Size, Step
from .built import FREE_ROUNDS, Built, build, without_strays
from .cause import parameters
from .model import Predict
from .table import Table, read, repeats, series

FOLDS, PIECES, ONE_PART = 5, 8, 0.8
"""Parts in which a table without groups is held out; pieces of a series in each, where one part has that share of what acts."""
NAMING = Naming(comparable=0.1, outstanding=judgement.LEAST_NAMED_FLOORS)
"""Several causes of a machine act at once: all are named that carry a noise floor."""
LEFT_SQUARES, LARGEST_SIZE = 0.02, 3.0
"""Share of the squared gap left on unseen rows, and plausible sizes, above which a cause is doubted."""
LEAST_LEFT, OUTSTANDING = 3.0, 5.0
"""Standard errors within which the remainder may be noise, and noise floors of a gap above which it is certainly no noise, though
that had to be estimated."""
MOST_PROPOSED, MOST_COMPARED = 5, 4
"""Rows or groups of the candidates that are proposed; hypotheses that they separate."""


@one_thread()
def diagnose_model(
    predict: Predict,
    data: pd.DataFrame,
    outputs: Mapping[str, str],
    causes: Sequence[Cause],
    calibration: Mapping[str, Sequence[Any]] | None = None,
    group: str | None = None,
    repeat: str | None = None,
    candidates: pd.DataFrame | None = None,
) -> Answer:
    """Name the cause of the gap between any model and its data, or say that there is none, or that it is not in the list.

    `predict(theta, inputs)` returns an array (n, outputs) for n rows; theta is a dict. Where outputs depend on earlier rows it
    integrates within each `group`. Its attribute `derivatives(theta, inputs)`, if any, returns parameter -> (n, outputs).
    `outputs`: column -> unit; `calibration`: parameter -> (nominal, plausible spread, unit), fitted in every hypothesis;
    `candidates`: inputs that could be measured next. Raises `BadCase`.
    """
    table = read(data, outputs, group, repeat)
    next_ = None if candidates is None else _candidates(candidates, table)
    made = parameters(causes, calibration or {})
    built = build(predict, table, list(causes), made)
    if (rest := without_strays(built)) is not None:
        built = build(predict, rest, list(causes), made)
    return _Diagnosis(built, [c for c in causes if c.name in built.problem.parameters.ids]).answer(next_)


def _candidates(candidates: pd.DataFrame, table: Table) -> pd.DataFrame:
    """The inputs of candidates. Raises `BadCase` where one that the model needs is missing."""
    if not isinstance(candidates, pd.DataFrame):
        raise BadCase(f"candidates: {type(candidates).__name__}, must be a pandas.DataFrame of inputs")
    needed = [name for name in table.inputs.columns if name not in table.ignored]
    if lacking := [name for name in needed if name not in candidates.columns]:
        raise BadCase(f"candidates: no column {lacking[0]!r}; candidates must have the inputs {', '.join(needed)}")
    return candidates.reset_index(drop=True)


# ------------------------------------------------------------------ the answer
class _Diagnosis:
    """Weighs the causes of one problem, and says what follows."""

    def __init__(self, b: Built, causes: Sequence[Cause]) -> None:
        self._b, self._causes, self._p = b, {c.name: c for c in causes}, b.problem.parameters
        white = np.zeros(len(b.row)) + 1 / b.sd[b.output]
        every = [np.arange(len(b.row)), *(np.flatnonzero(b.output == i) for i in range(len(b.sd)))]
        parts = [BudgetPart(rows, white[rows], 1.0, len(rows)) for rows in every]
        self._w = weighed(b.problem, parts[: 1 if len(parts) == 2 else None], SINGLE_THREAD, b.begun, NAMING, together)
        self._calibrated, self._fits = b.calibrated, {NONE: b.calibrated}

    def answer(self, candidates: pd.DataFrame | None) -> Answer:
        """Everything that is said."""
        b, w = self._b, self._w
        asking = min((self._asking(c) for c in {c.named: c for c in (w.leading, w.best)}.values()), key=total_gain)
        among = related(b, self._causes.values(), [*{c.named: c for c in (w.leading, w.best)}.values()])
        weights = [log_weight((*r.beside, r.relative), r.log_evidence, max(len(self._p.ids), len(r.beside) + 1)) for r in among]
        odds = odds_of_relatives([*w.search.found.values()], weights, len(self._p.ids)) + odds_unnamed(total_gain(asking), 1.0)
        ranked = with_unknown(w.known, w.whole.candidates[NONE], odds)
        decision = decide(ranked, True, w.budget.nothing_stands_out)
        lowest = {e: w.budget.interval(e, 0.025)[0] for e in decision.effects}
        known = [(s.effect, s.role == "size" and s.certain) for s in self._sizes(w.best.named)]
        decision = without_nothing(decision, known, lowest, ranked.probability(NONE))
        unseen, how = self._held_out()
        before, after, corrected = map(b.left, unseen)
        closed = share_closed(before.floors, max(after.floors, 1.0), 1.0)
        decision = behaves_like(decision, w.best.named, ranked, closed)
        if decision.verdict == "none" and before.floors > judgement.LEFT_FLOORS and closed and closed > judgement.FOLLOWED_SHARE:
            # one of several that cannot be told apart, so that each may be zero
            named, outside = w.best.named, ranked.probability(UNKNOWN)
            decision = replace(decision, verdict="effect", effects=named, probability=ranked.probability(named), outside=outside)
        elif decision.verdict == "none" and before.floors > judgement.LEFT_FLOORS:
            decision = outside_at_most(decision, 1 - 1 / before.floors**2)
        as_well = alike(among, decision.effects, w.search.found.get(w.best.named, w.best).log_evidence)
        why = self._doubts(decision, before.floors, corrected.floors, as_well)
        if decision.verdict != "unknown":
            decision = doubted(decision, why, 0)
        elif why:
            decision = outside_at_most(decision, decision.probability)
        if why:
            decision = capped(decision, closed)
        ranked = with_unknown(w.known, w.whole.candidates[NONE], decision.outside / max(1 - decision.outside, 1e-9))
        fitted = self._fitted(decision.effects)
        at_fit = b.model.values(fitted.theta)
        given = b.problem.forward.predict(np.zeros_like(self._p.sd))
        seen = [b.left(b.problem.observed - predicted) for predicted in (given, self._calibrated.predicted, fitted.predicted)]
        steps = [Step("as given", seen[0], None), Step("calibrated", seen[1], before)]
        steps += [Step("with the cause", seen[2], after)] if decision.effects else []
        steps.append(Step("noise floor", Left(1.0, dict(zip(b.table.outputs, b.sd.tolist(), strict=True))), None))
        ranking = tuple(
            Ranked(h, q, () if h == UNKNOWN else self._sizes(h, fitted if h == decision.effects else None))
            for h, q in ranked.ranking
        )
        return Answer(
            **vars(replace(decision, relatives=as_well)),
            ranking=ranking,
            calibration={p.key: (at_fit[p.key], p.unit) for p in b.parameters if p.group == "calibration"},
            cannot_tell_apart=distinguishability(b.problem, w.best, ranked).groups(ranked), steps=tuple(steps),
            how=how, share_closed=closed if decision.effects else None,
            goes_with=asking[0].dependence if decision.verdict == "unknown" and asking else "",
            next_experiment=() if candidates is None else self._proposed(ranked, candidates),
            noise_from=b.noise_from, doubts=tuple(why), notes=b.notes, rows=len(b.table.inputs), outputs=b.table.outputs,
            names={name: cause.says or name for name, cause in self._causes.items()}, budget=self._budget(),
            corrected=lambda: b.model.values(self._every),
            residuals={s.step: b.by_row_and_output(r) for s, r in zip(steps[1:], unseen, strict=False)},
        )  # fmt: skip

    def _budget(self) -> dict[str, Mapping[str, float]]:
        """How far each cause moves the outputs in the best model, beyond what calibration would do in its place."""
        b, p, theta = self._b, self._p, self._w.best.fit.theta
        whole, slope = b.problem.forward.linearise(theta)
        moved = [whole - b.problem.forward.predict(np.where(np.isin(p.effects, effect), 0.0, theta)) for effect in p.ids]
        sd = b.sd[b.output][:, None]
        beyond = p.beyond_calibration(np.transpose(moved) / sd, slope / sd) * sd
        moves = {effect: b.left(own) for effect, own in zip(p.ids, beyond.T, strict=True)}
        return {effect: moves[effect].by_output for effect in sorted(moves, key=lambda e: -moves[e].floors)}

    def _doubts(self, d: Decision, before: float, after: float, as_well: Sequence[str]) -> list[str]:
        """Why it is not certain, with noise floors on unseen rows `before` and `after` corrections, and relatives `as_well`."""
        b, why = self._b, list[str]()
        if d.verdict != "effect" and b.lasting:
            return [
                f"errors of {' and '.join(b.lasting)} last over several rows, and without repeats they may be noise or a cause"
            ]
        if d.verdict != "effect":
            unsure = d.verdict == "unknown" and before < OUTSTANDING and b.estimated
            return ["the noise had to be estimated without repeats"] if unsure else []
        limit = min(max(judgement.LEFT_FLOORS, judgement.LEFT_SHARE * before), np.sqrt(1 + LEFT_SQUARES * before**2))
        if after > max(limit, 1 + LEAST_LEFT / np.sqrt(2 * len(b.row))):
            why.append(f"on unseen rows {after:.2g} noise floors remain of {before:.2g}, so that other causes may act too")
        if as_well:
            why.append(f"as good an explanation: {', '.join(as_well)}")
        sizes = [s for s in self._sizes(d.effects) if s.role == "size"]
        why += [f"the size of {e} may be zero" for e in d.effects if not any(s.certain for s in sizes if s.effect == e)]
        theta = self._fitted(d.effects).theta
        for p, x in zip(b.parameters, theta.tolist(), strict=True):
            if p.source in d.effects and x and min(x - p.low, p.high - x) < 1e-3 * p.sd:
                why.append(f"{p.key} lies at its bound {p.nominal + x:.4g} {p.unit}".removesuffix(" 1"))
            elif p.source in d.effects and p.role == "size" and abs(x) > LARGEST_SIZE * p.sd:
                why.append(f"{p.key} is {abs(x) / p.sd:.2g} times its plausible size")
            elif p.group == "calibration" and abs(x) > judgement.TENSE_SD * p.sd:
                size = f"{p.nominal + x:.4g} {p.unit}".removesuffix(" 1")
                why.append(f"{p.key} = {size} lies {abs(x) / p.sd:.2g} spreads from nominal")
        return why

    def _asking(self, c: Any) -> tuple[StageError, ...]:
        """What errors of free form gain beside a hypothesis, largest first."""
        b, p = self._b, self._p
        g = Gaussian(c.fit.linear(b.problem), c.prior(p), c.weighed.peak.size, c.weighed.peak.form_error)
        functions = b.functions(c.fit)
        of_effect = np.array([x.sd * moved for x, moved in zip(b.parameters, b.response, strict=True) if x.group == "effect"])
        size = np.array([np.sqrt(np.mean(of_effect[:, b.output == i] ** 2)) for i in range(len(b.sd))])
        errors = list(stage_errors(g, p, {e: self._causes[e].stage for e in p.ids}, functions))
        for name, function in functions.items():
            columns = SmoothErrors(function, b.output, len(b.sd), (size / b.sd)[b.output]).discrepancy
            errors.append(StageError("outside the list", name, free_form_gain(g, columns)))
        return tuple(sorted(errors, key=lambda e: -e.gain))

    def _fitted(self, named: Hypothesis) -> Fit:
        """What is named and the calibration fitted, nothing else."""
        if named not in self._fits:
            self._fits[named] = fit_alone(self._b.problem, named, self._w.best.fit.theta, FREE_ROUNDS)
        return self._fits[named]

    def _sizes(self, named: Hypothesis, fitted: Fit | None = None) -> tuple[Size, ...]:
        """Parameters of what a hypothesis names; values of `fitted` where it is given."""
        c, out, count = self._w.known.candidates.get(named), [], -1
        for i, p in enumerate(self._b.parameters):
            count += p.group == "effect"
            if c is not None and p.source in named and p.group == "effect":
                mean, spread = float(c.weighed.averaged_mean[count]), float(c.weighed.averaged_sd[count])
                value = mean * self._p.sd[i] if fitted is None else float(fitted.theta[i])
                sd, determined = judgement.SIZE_SD_FACTOR * spread * self._p.sd[i], spread < judgement.UNDETERMINED_SHARE
                certain = determined and abs(mean) > judgement.SIZE_CERTAIN_SD * judgement.SIZE_SD_FACTOR * spread
                out.append(Size(p.key, p.source, p.nominal + value, sd, p.unit, p.nominal, determined, certain, p.role))
        return tuple(out)

    @cached_property
    def _every(self) -> Array:
        """(k,) all causes and the calibration, fitted within their plausible sizes."""
        b = self._b
        if b.by_row:  # what lasts over the rows is no matter, as others will be measured in another order
            b = b.with_noise(replace(b.estimate, share=np.zeros(len(b.sd))))
        return fit_alone(b.problem, self._p.ids, self._w.best.fit.theta, FREE_ROUNDS).theta

    def _held_out(self) -> tuple[list[Array], str]:
        """Residuals (n,) of the calibrated model, of what the best hypothesis names, nothing else, and of that with all others
        within their tolerance, on rows that their fits did not see, and how."""
        b, w = self._b, self._w
        whole = next((x for x in (series(b.table), b.table.group) if x.any()), None)
        if whole is not None and not b.apart:
            part, how = whole % FOLDS, "groups left out in turn"
        elif b.by_row:
            cell = repeats(b.table, True)
            cell = cell if cell.any() else np.arange(len(cell))  # all rows repeat one
            part = np.random.default_rng(0).permutation(int(cell.max()) + 1)[cell] % FOLDS
            how = "a fifth of the rows left out in turn"
        else:
            # the first part is in every fit, as it alone says where the series begins
            part, how = (b.table.order * (FOLDS - 1e-9)).astype(np.int64) - 1, "a fifth of the series left out in turn"
        named, fitted = w.best.named, self._fitted(w.best.named)
        without = b.problem.forward.predict(np.where(self._p.of_effect, 0.0, fitted.theta))
        done = np.bincount(part[b.row] + 1, np.nan_to_num(fitted.predicted - without) ** 2)
        if not b.by_row and done.max() > ONE_PART * done.sum() > 0:  # what acts there alone is not seen without it
            part = (b.table.order * (FOLDS * PIECES - 1e-9)).astype(np.int64) % FOLDS
            how = f"every fifth of {FOLDS * PIECES} pieces of each series left out in turn"
        models = [
            Refitted(self._p.prior_of(NONE), 0.0, self._calibrated.theta),
            Refitted(self._p.prior_of(named), 0.0, fitted.theta),
            Refitted(self._p.prior_of(named, judgement.FIT_TOLERATED_SIZE), 0.0, w.best.fit.theta),
        ]
        return CrossValidation(b.problem, part[b.row]).residuals(models)(), how

    def _proposed(self, ranked: EffectPosterior, candidates: pd.DataFrame) -> tuple[Experiment, ...]:
        """Rows (or, where the model integrates, groups) of the candidates that tell most about what the model predicts of all."""
        listed = [(h, q) for h, q in ranked.ranking if h != UNKNOWN]
        worth = sum(q > judgement.RIVAL_WORTH_SEPARATING for _, q in listed)
        leading = listed[: min(max(worth, 2), MOST_COMPARED)]
        b, model, every = self._b, self._b.model.of(candidates), self._every
        weight = np.array([max(q, judgement.RIVAL_LEAST_WEIGHT) for _, q in leading])
        sd = np.tile(b.sd, len(candidates))[:, None]
        fits = [self._w.known.candidates[h].fit if h else self._calibrated for h, _ in leading]
        predicted = np.transpose([model.table(f.theta).ravel() for f in fits]) / sd
        between = (predicted - (predicted @ weight / weight.sum())[:, None]) * np.sqrt(weight / weight.sum())
        known = b.problem.noise.whiten(b.problem.forward.linearise(every)[1] * self._p.sd)
        uncertain = np.linalg.cholesky(np.linalg.inv(np.eye(known.shape[1]) + known.T @ known))
        columns = np.hstack([between, model.linearise(every)[1] * self._p.sd / sd @ uncertain])
        labels = pd.Series(candidates.index)
        if not b.by_row and b.table.group_name in candidates.columns:
            labels = candidates[b.table.group_name]
        answered = np.isfinite(columns).all(axis=1)
        columns = np.where(answered[:, None], columns, 0.0)
        rows = {at: np.repeat(labels.to_numpy() == at, len(b.sd)) for at in labels.unique()}
        rows = {at: own for at, own in rows.items() if answered[own].all()}
        names = tuple(" + ".join(h) or "none" for h, _ in leading)
        first = candidates.groupby(labels.to_numpy()).first()
        return tuple(
            Experiment(
                int(at) if isinstance(at, Integral) else str(at),
                float((columns[rows[at]] ** 2).sum()),
                names,
                first.loc[at].to_dict(),
            )
            for at in most_telling(columns, rows)
        )


def most_telling(columns: Array, rows: Mapping[Any, Mask], count: int = MOST_PROPOSED) -> list[Any]:
    """Labels of `count` candidates that, measured one after the other, most reduce the sum over all values of the squared error
    of their prediction: columns (n, k) times independent standard normals, measured with an error of 1; `rows` (n,) of each."""
    squares, covariance, chosen = columns.T @ columns, np.eye(columns.shape[1]), list[Any]()
    for _ in range(min(count, len(rows))):
        halves = dict[Any, Array]()
        for at in (at for at in rows if at not in chosen):
            own = columns[rows[at]]
            across = own @ covariance
            halves[at] = np.linalg.solve(np.linalg.cholesky(across @ own.T + np.eye(len(own))), across)
        chosen.append(max(halves, key=lambda at: float(np.sum((halves[at] @ squares) * halves[at]))))
        covariance = covariance - halves[chosen[-1]].T @ halves[chosen[-1]]
    return chosen


def together(search: Search) -> list[Candidate]:
    """Weigh hypotheses of more causes than a search follows: cause after cause is added to the best one of as many as that, or
    taken away again, whatever makes the data most probable, until nothing repays its prior."""
    ids, most = search.problem.parameters.ids, max(judgement.PRIOR_OF_NUMBER)

    def weight(c: Candidate) -> float:
        return log_weight(c.named, c.log_evidence, len(ids))

    out: dict[Hypothesis, Candidate] = {}
    here = max((c for c in search.tried if len(c.named) == most and not c.with_tolerances), key=weight, default=None)
    here = None if here is None else search.with_all_derivatives(here)
    while here is not None:
        added = [tuple(e for e in ids if e in (*here.named, new)) for new in ids if new not in here.named]
        found = search.around(here.fit, added, False)
        for taken in here.named if len(here.named) > most + 1 else ():
            found += search.around(here.fit.without_law(taken), [tuple(e for e in here.named if e != taken)], False)
        out = {c.named: c for c in found} | out
        first = max(found, key=weight, default=here)
        fitted = search.fit(first.named, False, judgement.FIT_DISCREPANCY_SIZE, first.fit.theta, LAST_ROUNDS)
        (first,) = search.around(fitted.whole(search.problem, first.named), [first.named], False)
        here = replace(first, turns=1, ended=True) if weight(first) > weight(here) else None
        if here is not None:
            out[here.named] = here
    return [*out.values()]


def related(b: Built, causes: Iterable[Cause], candidates: Sequence[Candidate]) -> tuple[Related, ...]:
    """Relatives in the place of each cause that candidates name, and alone where they name none, the most probable first."""
    out, known = dict[tuple[str, Hypothesis], Related](), {p.source for p in b.of_relatives}
    for c, cause in ((c, cause) for c in candidates for cause in causes if not c.named or cause.name in c.named):
        beside = tuple(e for e in c.named if e != cause.name)
        for relative in (r for r in cause.relatives if r.name in known and (r.name, beside) not in out):
            out[relative.name, beside] = _with_relative(b, relative, beside, c)
    return tuple(sorted(out.values(), key=lambda r: -r.log_evidence))


def _with_relative(b: Built, relative: Cause, beside: Hypothesis, c: Candidate) -> Related:
    """A relative and the causes beside it, fitted from a candidate with the relative at its plausible size on every side."""
    own = [p for p in b.of_relatives if p.source == relative.name]
    infos, p = (*b.parameters, *own), b.problem.parameters
    least = (*p.least, *(judgement.LEAST_NAMED_SIZE for _ in own))
    wider = FitParameters(infos, np.array([*p.sd, *(x.sd for x in own)]), least)
    problem = replace(b.problem, forward=b.model.by(infos), parameters=wider)
    named = (*beside, relative.name)
    kept = np.where(np.isin(p.effects, ["", *beside]), c.fit.theta, 0.0)
    starts = [np.append(kept, [x.sides[min(side, len(x.sides) - 1)] for x in own]) for side in (0, 1)]
    fits = (fit(problem, wider.prior_of(named), judgement.FIT_DISCREPANCY_SIZE, s, FREE_ROUNDS) for s in starts)
    best = min(fits, key=lambda f: f.cost)
    (w,) = weigh(best.whole(problem, named).linear(problem), KNOWN, wider, [named])
    return Related(relative.says or relative.name, beside, w.log_evidence - best.predicted_decrease)
