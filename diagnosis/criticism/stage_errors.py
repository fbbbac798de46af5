"""Evidence for an unexplained error in each stage of the chain, in addition to the named effects.

A cause outside the catalogue enters the chain from pressure to reading somewhere. The readings respond to it as
to the effects of that stage, with an unknown dependence on the state. So, in addition to the leading hypothesis, each effect
of each stage in turn gets a free form: with a_j the readings' responses to its sizes at their plausible scale,

    y = (hypothesis) + s sum_j a_j(x) f_j(x),     f_j ~ GP(0, k),

a smooth unknown function of the state x each, in turn of the pressure and branch, of the spine's length, of the time, of
both pressure and length, and of the kind of experiment. A stage's evidence is the mean of its effects'.
All of the hypothesis (sizes, tolerances, model-form error, discrepancy) is integrated out: y ~ N(0, I + X X^T), and with C
the columns a_j times the leading eigenfunctions of k the log evidence gained by size s is

    log Z(s) = b^T (I / s^2 + B)^-1 b / 2 - log det(I + s^2 B) / 2,
    B = C^T (I + X X^T)^-1 C,  b = C^T (I + X X^T)^-1 r,

averaged over a grid of sizes. A known cause whose law differs from the catalogue's looks the same; therefore model-form
error is part of the hypothesis.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from .. import judgement
from ..arrays import Array
from ..inference.discrepancy import eigenfunctions, settings
from ..inference.problem import FitParameters
from .gaussian import Gaussian


@dataclass(frozen=True)
class StageError:
    """What a free-form error of a stage would gain beside what is named."""

    stage: str
    dependence: str
    """What the error goes with."""
    gain: float
    """Log evidence gained, averaged over its size."""

    @property
    def varies(self) -> str:
        """What it does, after "an error that" or "the error", as a template of `Words`."""
        return "is the same in all states" if self.dependence == "nothing" else f"varies with {in_words(self.dependence)}"


def in_words(factor: str) -> str:
    """A factor of the data as a template of `Words`."""
    factor = factor.replace("experiment", "the kind of trial (which {actuators} act, and loads)")
    return factor.replace("_", " ").replace("pressure", "{pressure}")


WANDER = ("measurement", "time")
"""A free-form error that cameras of every rig have, slowly and a little."""


def stage_errors(
    g: Gaussian, parameters: FitParameters, stages: Mapping[str, str], functions: Mapping[str, Array]
) -> tuple[StageError, ...]:
    """All stages with all dependences, largest gain first.

    `g`: the linear problem under the leading hypothesis, with derivatives by all effects; `stages`: effect -> stage;
    `functions`: dependence -> (n, m) functions at each value, from `smooth_functions`.
    """
    gains: dict[tuple[str, str], list[float]] = {}
    for effect in parameters.ids:
        response = g.linear.effects[:, parameters.mask((effect,)) & parameters.sizes]
        for dependence, function in functions.items():
            columns = (response[:, :, None] * function[:, None, :]).reshape(len(response), -1)
            gains.setdefault((stages[effect], dependence), []).append(free_form_gain(g, columns))
    errors = [StageError(*place, _mean(of_effects)) for place, of_effects in gains.items()]
    return tuple(sorted(errors, key=lambda s: -s.gain))


def _mean(gains: Sequence[float]) -> float:
    """Log of the mean evidence."""
    return float(logsumexp(gains) - np.log(len(gains)))


def total_gain(errors: Sequence[StageError]) -> float:
    """Log evidence that any of them gains, each as probable as the others beforehand; 0 where there are none.

    Changes over time do not count: every camera drifts (decision 059).
    """
    counted = [e.gain for e in errors if (e.stage, e.dependence) != WANDER]
    return _mean(counted) if counted else 0.0


def odds_unnamed(free_form: float, excess_scatter: float) -> float:
    """Odds of a cause that nobody listed, by the log evidence that errors of free form gain and the excess scatter of repeats."""
    free_form_odds = math.exp(min(free_form / judgement.TEMPERATURE, judgement.LARGEST_ODDS))
    unnamed = judgement.SAME_ODDS + judgement.FREE_FORM_ODDS * free_form_odds
    return unnamed * max(min(excess_scatter, judgement.LARGEST_EXCESS) / judgement.USUAL_EXCESS, 1.0)


def free_form_gain(g: Gaussian, columns: Array) -> float:
    """log of the mean of Z(s) over `STAGE_ERROR_SIZES`, columns C (n, m): see the module's docstring."""
    columns = columns[:, (columns**2).sum(axis=0) > 1e-12]
    return _mean(gains_of(g.inner(columns), columns.T @ g.residual, judgement.STAGE_ERROR_SIZES))


def gains_of(inner: Array, pulled: Array, sizes: Sequence[float]) -> list[float]:
    """log Z(s) of each size s, from B (m, m) and b (m,), with B diagonal: see the module's docstring."""
    value, vector = np.linalg.eigh(inner)
    value, along = np.maximum(value, 0.0), (vector.T @ pulled) ** 2
    return [0.5 * float((along * s**2 / (1 + s**2 * value)).sum() - np.log1p(s**2 * value).sum()) for s in sizes]


def smooth_functions(spine_length: Array, pressure: Array, branch: Array, time: Array, robot_length: float) -> dict[str, Array]:
    """(n, m) draws of size 1 of smooth functions of n states: spine length m, highest pressure Pa, branch -1 or 1, time s (NaN
    where it is not known, then none of it)."""
    at = settings(spine_length, pressure, branch, np.zeros(len(branch)), robot_length)[0]
    place: dict[str, Array] = {"pressure": at[:, [1, 2]], "spine length": at[:, [0]]}
    place["pressure and spine length"] = at[:, [1, 2, 0]]
    if np.isfinite(time).all() and np.ptp(time) > 0:
        place["time"] = ((time - time.min()) / np.ptp(time) / judgement.CORRELATION_TIME)[:, None]
    return {dependence: eigenfunctions(own) for dependence, own in place.items()}
