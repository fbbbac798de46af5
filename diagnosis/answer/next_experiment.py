"""Which experiment would tell the remaining candidates apart best, for its time.

The expected information is the mutual information, in bits, between candidate and outcome, by drawing outcomes from what the
candidates predict (`rivals`), with a fixed seed.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from ..inference.executor import SINGLE_THREAD, DiagnosisStep, Executor
from ..inference.posterior import Posterior
from ..inference.prepare import Prepared
from ..judgement import OVERHEAD_MIN, RIVAL_WORTH_SEPARATING, SEPARATED_BITS
from .candidate_experiments import Experiment, candidate_experiments, columns
from .result import Proposal
from .rivals import Prediction, Rivals

Array = NDArray[np.float64]

CHANNELS = ("x", "y", "z", "qw", "qx", "qy", "qz")


def propose(p: Prepared, rivals: Rivals, weighed: Posterior, executor: Executor = SINGLE_THREAD) -> tuple[Proposal, ...]:
    """Experiments that are not in the campaign; none after stiffness trials alone.

    Those that separate candidates with a probability above `RIVAL_WORTH_SEPARATING` come first, then best bits for their time;
    where a person sets each state, whose time no rig tells, most bits.
    """
    if len(rivals.candidates) < 2 or p.pushes_only:
        return ()
    menu = candidate_experiments(p.robot, p.states.take(~p.states.pushed))
    possible = frozenset(" + ".join(h) or "none" for h, probability in weighed.ranking if probability > RIVAL_WORTH_SEPARATING)
    found = executor.map(partial(_proposal, p, rivals, possible), menu, DiagnosisStep.EXPERIMENTS)
    by_rig = p.robot.actuators.words.by_rig

    def worth(x: Proposal) -> float:
        return x.expected_bits / (x.cost_min + OVERHEAD_MIN) if by_rig else x.expected_bits

    return tuple(sorted(filter(None, found), key=lambda x: (not x.separates, -worth(x))))


def _proposal(p: Prepared, rivals: Rivals, possible: frozenset[str], experiment: Experiment) -> Proposal | None:
    """What an experiment would tell; None where a rival has no equilibrium there."""
    predictions = rivals.predict(planned(p, experiment.parameters, experiment.channels))
    if predictions is None:
        return None
    bits, pairs = _information(predictions, rivals.weight)
    separated = (tuple(rivals.names[k] for k in pair) for pair in pairs)
    names = tuple(pair for pair in separated if possible.issuperset(pair))
    return Proposal(
        experiment.id, experiment.do, names, round(bits, 3), experiment.minutes, dict(experiment.parameters),
        experiment.hands,
    )  # fmt: skip


def planned(p: Prepared, protocol: Mapping[str, Any], more: tuple[str, ...] = ()) -> dict[str, NDArray[np.generic]]:
    """The table's columns that a protocol's run would give, in the channels that the campaign has and `more`."""
    named = set(p.labels.channel.tolist())
    named |= {"qw", "qx", "qy", "qz"} if "rx" in named else set()
    channels = tuple(name for name in CHANNELS if name in named)
    return columns(protocol, len(p.robot.actuators.azimuths_deg), tuple(dict.fromkeys((*channels, *more))))


def _information(
    predictions: tuple[Prediction, ...], weight: Array, draws: int = 60, seed: int = 4711
) -> tuple[float, list[tuple[int, int]]]:
    """Mutual information between candidate and outcome in bits, and the pairs (i, j) of candidates that would be told apart.

    I = sum_i w_i E_i[log2 p_i(y) - log2 sum_j w_j p_j(y)], p_i the normal density that candidate i predicts of the outcome y,
    w_i = `weight` its probability (sum 1), E_i the mean over `draws` outcomes drawn from p_i.
    """
    rng = np.random.default_rng(seed)
    n = len(predictions)
    log_weight = np.log(weight)
    bits = 0.0
    log_density = np.empty((n, n, draws))  # of outcomes drawn from candidate i, under candidate j
    for i, p in enumerate(predictions):
        outcomes = p.mean + rng.normal(size=(draws, len(p.mean))) @ p.factor.T
        log_density[i] = [q.log_density(outcomes) for q in predictions]
        mixture = logsumexp(log_density[i] + log_weight[:, None], axis=0)
        bits += weight[i] * float(np.mean(log_density[i, i] - mixture)) / np.log(2)
    separated = [
        (i, j)
        for i in range(n)
        for j in range(i + 1, n)
        if min(_pair_bits(*log_density[i, [i, j]]), _pair_bits(*log_density[j, [j, i]])) > SEPARATED_BITS
    ]
    return max(bits, 0.0), separated  # the mean of few draws can fall below 0


def _pair_bits(true: Array, other: Array) -> float:
    """Bits by which outcomes drawn from one candidate tell it from one other, both as likely before; `true` and `other` (draws,)
    are the outcomes' log densities under the two."""
    return float(1 - np.mean(np.logaddexp(0.0, other - true)) / np.log(2))
