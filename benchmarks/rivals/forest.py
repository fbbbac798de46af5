"""Simulation-based inference: approximate Bayesian computation with random forests (Pudlo et al., Bioinformatics 32, 2016).

Each case has simulations of its own (`simulate`), from which a forest of scikit-learn learns the hypothesis:

1. `BROAD` simulations of none and of every single effect; the forest's votes for the case choose the effects to follow.
2. `CLOSE` simulations of none, of the effects followed and of their pairs, with the prior of the diagnosis for none, one and two.
   The most votes name the hypothesis.
3. A second forest learns from all simulations of 2 whether the first errs on them, out of bag. What it says of the case is the
   stated probability.

A simulation is reduced to summaries in the linear problem about the calibrated model: log evidence of each effect by itself, with
and without small sizes of all others, the joint estimate of all sizes, the misfits, and the axes of a linear discriminant.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.ensemble import RandomForestClassifier, RandomForestRegressor

from diagnosis.inference.fit import Fit
from diagnosis.inference.posterior import Posterior
from diagnosis.inference.problem import Problem
from diagnosis.inference.starts import Starts
from diagnosis.judgement import PRIOR_OF_NUMBER

from .simulate import Hypothesis, Simulator
from .textbook import fitted

Array = NDArray[np.float64]

BROAD, CLOSE = 800, 1200
"""Simulations of one case."""
FOLLOWED = 5
"""Effects that the second set of simulations is about."""
TREES = 300
SPIKE, DISCREPANCY = 0.1, 0.25
"""Sizes of all effects, plausible scales, and of the discrepancy in the second of two covariances."""


@dataclass(frozen=True)
class Budget:
    """What a case may cost."""

    broad: int = BROAD
    close: int = CLOSE
    trees: int = TREES


def forest(problem: Problem, budget: Budget = Budget()) -> dict[str, Any]:  # noqa: B008 (frozen)
    """The answer to one case."""
    rng = np.random.default_rng(len(problem.observed))
    calibrated = fitted(problem, (), problem.parameters.mean)
    simulator, summaries = Simulator(problem, calibrated), Summaries.of(problem, calibrated)
    here = summaries(problem.observed[:, None])
    ids = problem.parameters.ids
    every = {(): PRIOR_OF_NUMBER[0]} | {(e,): PRIOR_OF_NUMBER[1] / len(ids) for e in ids}
    first = Learnt.of(*_drawn(simulator, summaries, every, budget.broad, rng), budget.trees)
    votes = first.votes(here)
    followed = sorted((h for h in votes if h), key=lambda h: -votes[h])[:FOLLOWED]
    pairs = [tuple(sorted((*a, *b))) for a, b in itertools.combinations(followed, 2)]
    close = {(): PRIOR_OF_NUMBER[0]} | {h: PRIOR_OF_NUMBER[1] / len(followed) for h in followed}
    close |= {h: PRIOR_OF_NUMBER[2] / len(pairs) for h in pairs}
    second = Learnt.of(*_drawn(simulator, summaries, close, budget.close, rng), budget.trees)
    close_votes = second.votes(here)
    rest = {h: v for h, v in votes.items() if h and h not in followed}
    shares = {h: v * (1 - sum(rest.values())) for h, v in close_votes.items()} | rest
    return _stated(shares, max(close_votes, key=lambda h: close_votes[h]), second.certainty(here))


def _stated(shares: dict[Hypothesis, float], chosen: Hypothesis, probability: float) -> dict[str, Any]:
    """The hypothesis with its probability; all others share the remainder as they share the votes."""
    rest = sum(v for h, v in shares.items() if h != chosen)
    stated = {h: v * (1 - probability) / rest if rest > 0 else 0.0 for h, v in shares.items()} | {chosen: probability}
    ranked = sorted(stated.items(), key=lambda item: -item[1])
    credible = [list(h) for h in Posterior(tuple(ranked), {}).credible_set]
    return {
        "attribute": {
            "verdict": "effect" if chosen else "none", "effects": list(chosen), "probability": probability,
            "ranking": [{"effects": list(h), "probability": p} for h, p in ranked], "credible_set": credible,
        }
    }  # fmt: skip


def _drawn(
    simulator: Simulator, summaries: Summaries, prior: dict[Hypothesis, float], count: int, rng: np.random.Generator
) -> tuple[Array, NDArray[np.intp], list[Hypothesis]]:
    """Summaries (s, f) of simulations, the hypothesis of each (s,), and the hypotheses; each is drawn as often as its prior
    asks, to a whole number, and at least twice."""
    names = list(prior)
    weight = np.array([prior[h] for h in names])
    times = np.maximum(np.floor(count * weight / weight.sum() + rng.random()).astype(int), 2)
    readings, label = [], []
    for k, (named, n) in enumerate(zip(names, times.tolist(), strict=True)):
        for found in (simulator.readings(named, rng) for _ in range(n)):
            if found is not None:
                readings.append(found)
                label.append(k)
    return summaries(np.column_stack(readings)), np.array(label, np.intp), names


@dataclass(frozen=True)
class Learnt:
    """A forest that tells hypotheses by their summaries."""

    names: list[Hypothesis]
    axes: LinearDiscriminantAnalysis
    which: RandomForestClassifier
    seen: Array
    """(s, f) what it was trained on, the axes included."""
    label: NDArray[np.intp]
    """(s,) the hypothesis of each."""

    @staticmethod
    def of(seen: Array, label: NDArray[np.intp], names: list[Hypothesis], trees: int) -> Learnt:
        """From summaries (s, f) and the hypothesis of each (s,)."""
        axes = LinearDiscriminantAnalysis(solver="eigen", shrinkage=0.1).fit(seen, label)
        every = np.hstack([seen, axes.transform(seen)])
        which = RandomForestClassifier(trees, oob_score=True, random_state=1).fit(every, label)
        return Learnt(names, axes, which, every, label)

    def votes(self, case: Array) -> dict[Hypothesis, float]:
        """Share of the trees that vote for each hypothesis, of one case (1, f)."""
        shares = self.which.predict_proba(self._with_axes(case))[0]
        return {self.names[k]: float(v) for k, v in zip(self.which.classes_, shares, strict=True)}

    def certainty(self, case: Array) -> float:
        """Probability that the hypothesis with most votes is right, of one case (1, f): a second forest learns from which
        summaries the first errs, on simulations that a tree has not seen."""
        votes = np.nan_to_num(self.which.oob_decision_function_)
        error = (self.which.classes_[votes.argmax(axis=1)] != self.label).astype(float)
        trees = len(self.which.estimators_)
        errs = RandomForestRegressor(trees, min_samples_leaf=5, max_features="sqrt", random_state=2).fit(self.seen, error)
        return float(1 - errs.predict(self._with_axes(case))[0])

    def _with_axes(self, case: Array) -> Array:
        return np.hstack([case, self.axes.transform(case)])


@dataclass(frozen=True)
class Summaries:
    """From readings of one case's states to summaries."""

    problem: Problem
    predicted: Array
    """(n,) by the calibrated model."""
    columns: tuple[Array, ...]
    """(n, c) each, whitened: derivatives of one effect at one of its starting points, and what it does there."""
    effects: Array
    """(n, p) whitened derivatives of all effects about the calibrated model, by one plausible scale."""
    beside: tuple[Array, Array]
    """(n, q) whitened columns, by one standard deviation, of all that is integrated out; with small effects and without."""

    @staticmethod
    def of(problem: Problem, calibrated: Fit) -> Summaries:
        """About the calibrated model."""
        p, linear = problem.parameters, problem.at(calibrated.theta)
        nuisance = linear.nuisance.whole
        small = SPIKE * linear.effects[:, p.sizes & p.tolerable]
        every = np.hstack([nuisance, small, DISCREPANCY * problem.whitened_discrepancy])
        columns = [linear.effects[:, p.mask((e,))] for e in p.ids]
        for effect in p.ids:
            own = [i for i, e in enumerate(p.effects) if e == effect]
            starts = [s for s in Starts(problem).of((effect,), calibrated) if not isinstance(s, Fit)]
            for start in starts:
                predicted, slope = problem.linearise(start, own)
                if np.isfinite(predicted).all():
                    done = np.column_stack([slope * p.sd[own], predicted - calibrated.predicted])
                    columns.append(problem.noise.whiten(done))
        return Summaries(problem, calibrated.predicted, tuple(columns), linear.effects, (nuisance, every))

    def __call__(self, readings: Array) -> Array:
        """(s, f) of readings (n, s)."""
        missed = self.problem.noise.whiten(readings - self.predicted[:, None])
        found = []
        for beside in self.beside:
            solve = _solver(beside)
            pulled = solve(missed)
            misfit = (missed * pulled).sum(axis=0)
            evidence = np.array([_evidence(x, solve(x), pulled) for x in self.columns])
            found += [np.log(misfit)[None], evidence.max(axis=0)[None] / misfit, evidence, evidence - evidence.max(axis=0)]
        inner = self.effects.T @ solve(self.effects)
        found.append(np.linalg.solve(inner + np.eye(len(inner)), self.effects.T @ pulled))
        return np.vstack(found).T


def _solver(columns: Array) -> Any:
    """A function that applies (I + B B^T)^-1 to columns (n, m), for B (n, q)."""
    factor = np.linalg.inv(np.eye(columns.shape[1]) + columns.T @ columns)
    return lambda values: values - columns @ (factor @ (columns.T @ values))


def _evidence(columns: Array, solved: Array, pulled: Array) -> Array:
    """(s,) by which log evidence grows with one effect's columns (n, c), `solved` (n, c), for readings `pulled` (n, s)."""
    inner = np.eye(columns.shape[1]) + columns.T @ solved
    along = columns.T @ pulled
    half_log_det = 0.5 * float(np.linalg.slogdet(inner)[1])
    return np.asarray(0.5 * (along * np.linalg.solve(inner, along)).sum(axis=0) - half_log_det)
