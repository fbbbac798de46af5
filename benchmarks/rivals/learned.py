"""A learned residual: a Gaussian process of scikit-learn from the inputs of a state to what the calibrated model misses there.

It is what most papers do about a sim-to-real gap. Each spine length is predicted by a model calibrated, and a process trained, on
the states of the other lengths, as for the share that the diagnosis closes. It names nothing: its answer is always none, and
right only where none is.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from diagnosis.answer.attribute import calibrated
from diagnosis.answer.shrink import rms, share_closed
from diagnosis.data.levels import SPINE_GAP, levels
from diagnosis.inference.cross_validation import only
from diagnosis.inference.fit import fit
from diagnosis.inference.prepare import Prepared
from model.prediction.residual import section_sums

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


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
    problem, prior = p.problem, p.problem.parameters.no_effects()
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
    sums = section_sums(p.robot, p.states.pressure)
    branch = np.asarray(p.states.branch, float)
    every = np.column_stack([sums, p.states.spine_length, branch])
    return every / np.maximum(np.ptp(every, axis=0), 1e-12)


def predicted(x: Array, missed: Array, seen: NDArray[np.bool_]) -> Array:
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
