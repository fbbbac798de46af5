"""Three other methods with the forward model and the noise of the diagnosis.

    alone       each effect fitted by itself, by least squares; the least BIC = 2 cost + k ln n names it, or none
    sparse      group lasso over the effects' columns about the calibrated model, its penalty by BIC; named: what is not zero
    learned     a Gaussian process from the inputs of a state to what the calibrated model misses there; names nothing

The nuisances (trials, mounting, cameras, calibration) and their priors are those of the diagnosis in all of them; effects have no
prior but their bounds. A learned residual is what most papers do about a sim-to-real gap: each spine length is predicted by a
model calibrated, and a process trained, on the states of the other lengths. Its answer is always none.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from benchmarks.blind.folder import SetFolder
from diagnosis.answer.attribute import calibrated
from diagnosis.answer.decision import share_closed
from diagnosis.arrays import Array, Ints, Mask, rms
from diagnosis.data.case import states
from diagnosis.data.levels import SPINE_GAP, levels
from diagnosis.inference.cross_validation import only
from diagnosis.inference.executor import one_thread
from diagnosis.inference.fit import Fit, fit
from diagnosis.inference.prepare import Prepared, prepare
from diagnosis.inference.problem import Problem
from diagnosis.inference.search import starts
from lab.files.inputs import read_case

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
    prior = p.prior_of(named)
    wide = type(prior)(prior.mean, prior.variance * 100.0, prior.wide)
    return fit(problem, wide, 0.0, start, rounds)


def best(problem: Problem, named: Hypothesis, here: Fit) -> Fit:
    """The fit of least cost from another fit and from the starting points of the diagnosis."""
    begun = [here.theta, *(s for s in starts(problem.parameters, named, here) if not isinstance(s, Fit))]
    return min((fitted(problem, named, theta) for theta in begun), key=lambda f: f.cost)


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
    none = fitted(problem, (), np.zeros_like(problem.parameters.sd))
    criteria: dict[Hypothesis, float] = {(): bic(problem, (), none)}
    for effect in problem.parameters.ids:
        criteria[(effect,)] = bic(problem, (effect,), best(problem, (effect,), none))
    return stated(criteria)


def sparse(problem: Problem) -> dict[str, Any]:
    """Group lasso in the linear problem about the calibrated model."""
    p = problem.parameters
    none = fitted(problem, (), np.zeros_like(p.sd))
    linear = problem.whitened(none.theta, none.predicted, problem.jacobian(none.theta)[1].every)
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


def learned(p: Prepared) -> dict[str, Any]:
    """The answer none, with the share of the gap that the process closes on lengths that it has not seen, and on repeats of the
    sweep that it has not seen."""
    start = calibrated(p)
    by_length = levels(p.states.spine_length, SPINE_GAP)
    before, after, share = closed(p, start.theta, by_length)
    again = closed(p, start.theta, p.states.repeat)[2]
    return {
        "attribute": {"verdict": "none", "effects": [], "probability": 0.0, "ranking": [], "credible_set": [[]]},
        "shrink": {"share_closed": share, "share_closed_of_repeats": again, "before_mm": 1e3 * before, "after_mm": 1e3 * after},
    }


def closed(p: Prepared, start: Array, part: Ints) -> tuple[float, float, float | None]:
    """rms (m) that the calibrated model misses, and with the process, on parts (states,) that neither has seen, and the share of
    the gap closed; None where there is none. `start` (k,): parameters near which each part's calibration is."""
    problem, prior = p.problem, p.problem.parameters.prior_of(())
    before = np.full((len(p.states), 3), np.nan)
    after, x = before.copy(), inputs(p)
    for one in np.unique(part):
        seen = part != one
        theta = fit(only(problem, seen[p.labels.state]), prior, 0.0, start).theta
        before[~seen] = p.tip(problem.observed - problem.forward.predict(theta))[~seen]
        # what the parameters of single trials take up in the fit is there again in a trial that was not fitted
        missed = p.tip(problem.observed - problem.forward.predict(p.common(theta)))
        after[~seen] = (missed - predicted(x, missed, seen))[~seen]
    own = np.isfinite(before).all(axis=1)
    left = [rms(errors[own]) for errors in (before, after)]
    return left[0], left[1], share_closed(left[0], left[1], p.noise_floor)


def inputs(p: Prepared) -> Array:
    """(states, 5): pressures summed over the section, spine length, and the branch; each by its range."""
    azimuth = np.radians(p.robot.actuators.azimuths_deg)
    sums = p.states.pressure @ np.column_stack([np.cos(azimuth), np.sin(azimuth), np.ones(len(azimuth))])
    branch = np.asarray(p.states.branch, float)
    every = np.column_stack([sums, p.states.spine_length, branch])
    return every / np.maximum(np.ptp(every, axis=0), 1e-12)


def predicted(x: Array, missed: Array, seen: Mask) -> Array:
    """(n, 3) m that a process trained on the states marked `seen` (n,) expects the model to miss, of inputs (n, c)."""
    own = seen & np.isfinite(missed).all(axis=1)
    varied = np.ptp(x[own], axis=0) > 0
    size = max(float(missed[own].std()), 1e-9)
    kernel = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(np.ones(int(varied.sum())), (0.05, 50.0)) + WhiteKernel(0.1, (1e-6, 10.0))
    process = GaussianProcessRegressor(kernel, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # a scale at its bound
        process.fit(x[own][:, varied], missed[own] / size)
    return np.asarray(size * process.predict(x[:, varied]))


METHODS: dict[str, Callable[[Prepared], dict[str, Any]]] = {
    "alone": lambda p: alone(p.problem),
    "sparse": lambda p: sparse(p.problem),
    "learned": learned,
}


@one_thread()
def answer(root: Path, out: Path, methods: Sequence[str], name: str) -> str:
    """The answers of some methods to one case, each in its folder, with the seconds of processor that it took."""
    places = {m: place for m in methods if not (place := out / m / f"{name}.json").exists()}
    if not places:
        return name
    began = time.process_time()
    case = read_case([SetFolder(root).case(name)])
    prepared = prepare(case.robot, states(case)[0])
    ready = time.process_time() - began
    for method, place in places.items():
        began = time.process_time()
        try:
            found = METHODS[method](prepared)
        except (np.linalg.LinAlgError, ValueError) as e:
            found = {"error": repr(e)[:200]}
            found["attribute"] = {"verdict": "failed", "effects": [], "probability": 0.0, "ranking": []}
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(json.dumps({**found, "seconds": ready + time.process_time() - began}))
    return name
