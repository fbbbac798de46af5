"""Which experiment would tell the remaining candidates apart best, for its time.

Each candidate predicts the outcome of an experiment as a normal distribution: its own fit, with what it does not know
about its parameters, the noise floor and the discrepancy. The expected information is the mutual information between
candidate and outcome, in bits, by drawing outcomes from the candidates (fixed seed).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.errors import ModelError

from ..inference.discrepancy import by_channel, settings
from ..inference.discrepancy import columns as smooth_columns
from ..inference.evidence import Hypothesis
from ..inference.posterior import UNKNOWN, Posterior
from ..inference.prepare import KINDS, Prepared
from ..inference.problem import Problem
from ..inference.search import Candidate
from .candidate_experiments import Experiment, candidate_experiments, columns
from .distinguishability import Distinguishability
from .result import Proposal

Array = NDArray[np.float64]

CANDIDATES = 5
LEAST_WEIGHT = 0.05
"""Least probability that a candidate counts with, so that experiments also test what the data have nearly excluded."""
DRAWS = 60
SEED = 4711
SHOWN = 6
SEPARATED = 0.5
"""Two candidates count as separated when outcomes of one are told from the other's by at least this many bits."""


@dataclass(frozen=True)
class _Prediction:
    mean: Array
    factor: Array
    """Lower Cholesky factor of the covariance."""

    def log_density(self, outcomes: Array) -> Array:
        """(draws,) of outcomes (draws, n), up to a constant common to all."""
        white = solve_triangular(self.factor, (outcomes - self.mean).T, lower=True)
        return -0.5 * (white**2).sum(axis=0) - float(np.log(np.diag(self.factor)).sum())


def propose(p: Prepared, weighed: Posterior, separation: Distinguishability) -> tuple[Proposal, ...]:
    """Experiments that are not in the campaign, best bits for their time first; none after stiffness trials alone."""
    remaining = _remaining(weighed, separation)
    if len(remaining) < 2 or p.pushes_only:
        return ()
    weight = np.maximum([weighed.probability(c.named) for c in remaining], LEAST_WEIGHT)
    weight /= weight.sum()
    spread = [_covariance(p.problem, c) for c in remaining]
    found = []
    for experiment in candidate_experiments(p.robot, p.states.take(~p.states.pushed)):
        predictions = _predictions(p, experiment, remaining, spread)
        if predictions is None:
            continue
        bits, pairs = _information(predictions, weight)
        names = tuple(tuple(" + ".join(remaining[k].named) or "none" for k in pair) for pair in pairs)
        found.append(
            Proposal(
                experiment.id, experiment.do, names, round(bits, 3), experiment.minutes, dict(experiment.parameters)
            )
        )
    return tuple(sorted(found, key=lambda x: -x.expected_bits / (x.cost_min + 5.0))[:SHOWN])


def _remaining(weighed: Posterior, separation: Distinguishability) -> list[Candidate]:
    """The leading hypotheses, and the rivals of the first that this data cannot tell from it."""
    leading: list[Hypothesis] = [h for h, _ in weighed.ranking if h != UNKNOWN][:CANDIDATES]
    if len(leading[0]) == 1:
        leading[1:1] = [(e,) for e in separation.rivals(leading[0][0]) if (e,) in weighed.candidates]
    return [weighed.candidates[h] for h in dict.fromkeys(leading)][:CANDIDATES]


def _covariance(problem: Problem, c: Candidate) -> Array:
    """Posterior covariance (k, k) of all parameters of the base problem under a candidate."""
    p = problem.parameters
    scale, _ = p.scaled(c.prior(p))
    linear, at = c.fit.linear, c.grid_point
    own = p.of_effect
    ours = np.empty((len(linear.observed), len(scale)))
    ours[:, own], ours[:, ~own] = linear.effects * (scale / p.sd)[own], linear.nuisance
    every = np.hstack(
        [ours, at.form_error * linear.form_error, linear.discrepancy_size(at.size, at.form_error) * linear.discrepancy]
    )
    inverse = np.linalg.inv(np.eye(every.shape[1]) + every.T @ every)[: len(scale), : len(scale)]
    out: Array = scale[:, None] * inverse * scale[None, :]
    return out


def _predictions(
    p: Prepared, e: Experiment, remaining: list[Candidate], spread: list[Array]
) -> list[_Prediction] | None:
    """What each candidate predicts; None where the model has no equilibrium there."""
    measured = tuple(name for name in ("x", "y", "z", "qw", "qx", "qy", "qz") if name in _channels(p))
    table = columns(e, len(p.robot.chambers.azimuths_deg), measured)
    try:
        forward = p.forward.on(design_from_columns(p.robot, table))
    except ModelError:
        return None
    names = {info.name: i for i, info in enumerate(forward.parameters)}
    base = list(p.problem.parameters.names)
    own = p.problem.parameters.recurs
    shared = [(names[n], i) for i, n in enumerate(base) if n in names and not own[i]]
    new, old = np.array(shared).T
    own_sd = np.array([p.noise_components.trial.get(info.source, info.sd) for info in forward.parameters])
    fresh = np.setdiff1d(np.arange(len(own_sd)), new)
    white, smooth = _noise(p, forward)
    made = []
    for c, covariance in zip(remaining, spread, strict=True):
        theta = np.zeros(len(own_sd))
        theta[new] = c.fit.theta[old]
        mean, slope = forward.linearise(theta)
        if not np.isfinite(mean).all() or not np.isfinite(slope).all():
            return None
        total = slope[:, new] @ covariance[np.ix_(old, old)] @ slope[:, new].T
        total += (slope[:, fresh] * own_sd[fresh] ** 2) @ slope[:, fresh].T
        pressure = p.noise_components.pressure * slope[:, names["pressure_offset.offset"]]
        row = forward.observations.row
        total += np.where(row[:, None] == row[None, :], np.outer(pressure, pressure), 0.0)
        total += max(c.grid_point.size, 0.25) ** 2 * smooth @ smooth.T + np.diag(white**2)
        made.append(_Prediction(mean, np.asarray(np.linalg.cholesky(total), np.float64)))
    return made


def _channels(p: Prepared) -> set[str]:
    named = set(p.labels.channel.tolist())
    return named | ({"qw", "qx", "qy", "qz"} if "rx" in named else set())


def _noise(p: Prepared, forward: ForwardModel) -> tuple[Array, Array]:
    """White noise (n,) of the new values, and the columns (n, m) of a discrepancy of size 1 over them."""
    channel = forward.observations.channel
    kind = [1 if c.startswith("r") else 2 if c.startswith("m") else 0 for c in channel]
    white = np.array([p.noise_components.channel[KINDS[k]] for k in kind])
    design = forward.design
    highest = design.pressure.max(axis=1)
    where = settings(
        design.spine_length, highest, np.where(design.unload, -1.0, 1.0), np.zeros(len(design)), p.robot.length
    )
    names = sorted(set(channel.tolist()))
    size = np.array([2 * p.unit / p.robot.length if n.startswith("r") else p.unit for n in names])
    number = np.array([names.index(c) for c in channel])
    return white, by_channel(smooth_columns(where), forward.observations.row, number, size)


def _information(predictions: list[_Prediction], weight: Array) -> tuple[float, list[tuple[int, int]]]:
    """Mutual information in bits, and the pairs of candidates that would be told apart."""
    rng = np.random.default_rng(SEED)
    n = len(predictions)
    log_weight = np.log(weight)
    bits = 0.0
    density = np.empty((n, n, DRAWS))
    for i, p in enumerate(predictions):
        outcomes = p.mean + rng.normal(size=(DRAWS, len(p.mean))) @ p.factor.T
        density[i] = [q.log_density(outcomes) for q in predictions]
        mixture = logsumexp(density[i] + log_weight[:, None], axis=0)
        bits += weight[i] * float(np.mean(density[i, i] - mixture)) / np.log(2)
    separated = [
        (i, j)
        for i in range(n)
        for j in range(i + 1, n)
        if min(_pair_bits(density[i, i], density[i, j]), _pair_bits(density[j, j], density[j, i])) > SEPARATED
    ]
    return max(bits, 0.0), separated


def _pair_bits(own: Array, other: Array) -> float:
    """Bits by which outcomes of one candidate tell it from one other, both as likely before."""
    return float(1 - np.mean(np.logaddexp(0.0, other - own)) / np.log(2))
