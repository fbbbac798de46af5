"""Starting points of searches, recalibrated where needed."""

from __future__ import annotations

import itertools

import numpy as np

from ..arrays import Array
from ..judgement import FAR_START, ONE_SIDED_START
from .evidence import Hypothesis
from .fit import Fit
from .problem import FitParameters, Problem, derivatives


def needs_own(p: FitParameters, named: Hypothesis) -> bool:
    """Whether an effect is one-sided, or has several starting points."""
    own = [i for i, e in enumerate(p.effects) if e in named]
    return any(p.lower[i] == 0 or len(p.infos[i].starts) > 1 for i in own)


def starts(p: FitParameters, named: Hypothesis, none: Fit) -> list[Array | Fit]:
    """Where searches begin: the fit of none, or all combinations of the starts of what is named where it has several or is
    one-sided: at zero, where such an effect ends, the tolerances of the others could take its place."""
    if not needs_own(p, named):
        return [none]
    columns = [i for i, e in enumerate(p.effects) if e in named]
    values = np.array([*itertools.product(*(_start_values(p, i) for i in columns))])
    points = np.tile(none.theta, (len(values), 1))
    points[:, columns] = values
    return [*points]


def recalibrated(problem: Problem, start: Array) -> Array:
    """Parameters (k,) with those that are fitted in every model fitted to the data anew, all others as they are."""
    p, whiten = problem.parameters, problem.noise.whiten
    free = np.flatnonzero(p.calibration)
    if not free.size:
        return start
    theta, least_chi_square = start.copy(), np.inf
    for _ in range(8):
        predicted, slope = derivatives(problem.forward, theta, free.tolist())
        if not np.isfinite(predicted).all():
            theta[free] *= 0.5
            continue
        columns, residual = whiten(slope.whole * p.sd[free]), whiten(problem.observed - predicted)
        if least_chi_square - float(residual @ residual) < 0.01 * least_chi_square:
            break
        least_chi_square = float(residual @ residual)
        step = np.linalg.lstsq(columns, residual, rcond=None)[0]
        theta[free] = np.clip(theta[free] + p.sd[free] * step, p.lower[free], p.upper[free])
    return theta


def far(problem: Problem, predicted: Array, none: Fit) -> bool:
    """Whether a prediction (n,) is much further from the data than that of no effect, or has no equilibrium somewhere."""
    if not np.isfinite(predicted).all():
        return True
    there, here = (problem.noise.whiten(problem.observed - y) for y in (predicted, none.predicted))
    return float(there @ there) > FAR_START * float(here @ here)


def _start_values(p: FitParameters, i: int) -> tuple[float, ...]:
    """Values of a named effect's parameter to begin at."""
    given = p.infos[i].starts
    if p.infos[i].role == "shape":
        return given or (0.0,)
    return tuple(v for v in given if v) or (ONE_SIDED_START * float(p.sd[i]) if p.lower[i] == 0 else 0.0,)
