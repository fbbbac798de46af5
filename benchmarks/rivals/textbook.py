"""Two textbook methods with the forward model and the noise of the diagnosis.

    alone       each effect fitted by itself, by least squares; the least BIC = 2 cost + k ln n names it, or none
    sparse      group lasso over the effects' columns about the calibrated model, its penalty by BIC; named: what is not zero

The nuisances (trials, mounting, cameras, calibration) and their priors are those of the diagnosis in all of them; effects have no
prior but their bounds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.fit import Fit, fit
from diagnosis.inference.problem import Problem
from diagnosis.inference.starts import Starts

Array = NDArray[np.float64]
Hypothesis = tuple[str, ...]

PENALTIES = np.geomspace(1.0, 1e-3, 30)
"""Shares of the penalty at which every effect is zero."""
SWEEPS = 200
"""Passes of block coordinate descent at one penalty."""


def bic(problem: Problem, named: Hypothesis, found: Fit) -> float:
    """Twice the cost, misfit and nuisances, plus ln n for each parameter of an effect."""
    return 2 * found.cost + float(problem.parameters.mask(named).sum() * np.log(len(problem.observed)))


def fitted(problem: Problem, named: Hypothesis, start: Array | Fit, rounds: int = 12) -> Fit:
    """Least squares over the nuisances and the effects named, of which those have a prior ten plausible scales wide."""
    p = problem.parameters
    prior = p.prior(p.mask(named), 0.0)
    wide = type(prior)(prior.mean, prior.variance * 100.0, prior.wide)
    return fit(problem, wide, 0.0, start, rounds)


def best(problem: Problem, named: Hypothesis, here: Fit) -> Fit:
    """The fit of least cost from another fit and from the starting points of the diagnosis."""
    starts = [here.theta, *(s for s in Starts(problem).of(named, here) if not isinstance(s, Fit))]
    return min((fitted(problem, named, theta) for theta in starts), key=lambda f: f.cost)


def stated(criteria: dict[Hypothesis, float]) -> dict[str, Any]:
    """An answer with probabilities exp(-BIC / 2), shared out among what was tried."""
    names = list(criteria)
    value = np.array([criteria[n] for n in names])
    weight = np.exp(-0.5 * (value - value.min()))
    weight /= weight.sum()
    order = np.argsort(-weight)
    first = names[int(order[0])]
    ranking = [{"effects": list(names[i]), "probability": float(weight[i])} for i in order[:20].tolist()]
    return {
        "attribute": {
            "verdict": "effect" if first else "none", "effects": list(first), "probability": float(weight[order[0]]),
            "ranking": ranking, "credible_set": [r["effects"] for r in ranking if r["probability"] > 0.01],
        }
    }  # fmt: skip


def alone(problem: Problem) -> dict[str, Any]:
    """Each effect by itself."""
    none = fitted(problem, (), problem.parameters.mean)
    criteria: dict[Hypothesis, float] = {(): bic(problem, (), none)}
    for effect in problem.parameters.ids:
        criteria[(effect,)] = bic(problem, (effect,), best(problem, (effect,), none))
    return stated(criteria)


def sparse(problem: Problem) -> dict[str, Any]:
    """Group lasso in the linear problem about the calibrated model."""
    p = problem.parameters
    none = fitted(problem, (), p.mean)
    linear = problem.at(none.theta)
    nuisance = linear.nuisance.whole
    base = np.linalg.qr(np.vstack([nuisance, np.eye(nuisance.shape[1])]))[0]
    padded = [np.vstack([x, np.zeros((nuisance.shape[1], x.shape[1]))]) for x in (linear.effects, linear.observed[:, None])]
    x, y = (v - base @ (base.T @ v) for v in padded)
    groups = [np.flatnonzero(p.mask((e,)) & p.sizes) for e in p.ids]
    blocks = [np.linalg.qr(x[:, g])[0] for g in groups]
    left, signs = y[:, 0].copy(), [np.zeros(b.shape[1]) for b in blocks]
    top = max(float(np.linalg.norm(b.T @ left)) for b in blocks)
    criteria: dict[Hypothesis, float] = {(): float(left @ left)}
    for share in PENALTIES:
        for _ in range(SWEEPS):
            moved = 0.0
            for k, b in enumerate(blocks):
                score_ = b.T @ left + signs[k]
                size = float(np.linalg.norm(score_))
                new = score_ * max(0.0, 1 - share * top / size) if size > 0 else score_
                left -= b @ (new - signs[k])
                moved = max(moved, float(np.abs(new - signs[k]).max(initial=0.0)))
                signs[k] = new
            if moved < 1e-3:
                break
        named = tuple(e for e, s in zip(p.ids, signs, strict=True) if s.any())
        chosen = np.hstack([b for b, s in zip(blocks, signs, strict=True) if s.any()]) if named else np.zeros((len(y), 0))
        rest = y[:, 0] - chosen @ np.linalg.lstsq(chosen, y[:, 0], rcond=None)[0]
        value = float(rest @ rest) + chosen.shape[1] * float(np.log(len(problem.observed)))
        criteria[named] = min(value, criteria.get(named, np.inf))
    return stated(criteria)
