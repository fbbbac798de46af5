"""Yesterday it matched, today it does not: what changed between a reference campaign and a later one?

The reference is diagnosed for what the robot is; whatever it already had, named or not, is common to both. The later
campaign gets parameters of its own for every effect, and those are weighed: one effect changed, two, none, or something
outside the catalogue. What both campaigns have in common, the smooth discrepancy included, can change nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from model.actuators import Chambers, Words
from model.effects.catalogue import CATALOGUE
from model.effects.spec import EffectSpec

from .answer.headline import for_people
from .answer.result import Change
from .answer.sentences import OUTSIDE, plain_name, with_id
from .criticism.misfit import misfit_diagnostics
from .criticism.probability_calibration import CALIBRATED
from .data.campaign import Campaign
from .data.case import CaseLike, states
from .data.noise import Lasting, Noise
from .errors import TooLittle
from .inference.budget import budget, by_what_is_carried, parts
from .inference.evidence import NONE, Hypothesis
from .inference.executor import SINGLE_THREAD, Executor, one_thread
from .inference.posterior import UNKNOWN, Posterior, posterior, with_unknown
from .inference.prepare import Prepared, prepare
from .inference.problem import Parameters, Problem
from .inference.search import Search
from .judgement import LEAST_NAMED_SIZE, UNCHANGED

Array = NDArray[np.float64]


ANOTHER_DAY = {
    "tilt": "base_tilt",
    "frame_turn": "frame_misalignment",
    "frame_shift": "",
    "youngs_modulus": "body_modulus",
}
"""Tolerances that each campaign has for itself, beside trials, repeats and drift, and the effect that does the same: the robot
was mounted and the cameras were calibrated anew, and silicone is as soft as the room is warm and as it has been worked. Such
an effect has changed when it is named, and not a little besides."""
CHANGE = " (change)"
"""End of the name of a parameter that may differ between the campaigns."""


@one_thread
def compare_campaigns(
    later: CaseLike,
    reference: CaseLike,
    catalogue: Mapping[str, EffectSpec] = CATALOGUE,
    executor: Executor = SINGLE_THREAD,
) -> Change:
    """What changed from `reference` to `later`; raises `TooLittle` when they share no setting, or the robots differ."""
    if later.robot != reference.robot:
        raise TooLittle(
            f"the robots differ: {reference.robot.name!r} in the reference, {later.robot.name!r} in this campaign, "
            "or robot.yaml was changed: give both the same robot.yaml with --robot"
        )
    both = _comparable(states(reference)[0], states(later)[0])
    before, after = (prepare(later.robot, s, catalogue=catalogue) for s in both)
    search = Search(_joined(before, after), executor=executor)
    candidates = search.run()
    unknown = search.unknown()
    whole = posterior(candidates, len(after.problem.parameters.ids), CALIBRATED.temperature)
    # A change is named for what it moves in the later campaign, as a cause is.
    offset = len(before.problem.observed)
    where = [replace(part, rows=part.rows + offset) for part in parts(after)]
    known = by_what_is_carried(budget(search.problem, where, search.tried, CALIBRATED.temperature), whole)
    first, answer = search.leading_and_answer(*(k.candidates[k.ranking[0][0]] for k in (whole, known)))
    trials = [before.labels.trial, after.labels.trial + before.labels.trial.max() + 1]
    kinds = [x.labels.experiment for x in (before, after)]
    excess_scatter = max(before.noise_components.excess_scatter, after.noise_components.excess_scatter)
    misfit = misfit_diagnostics(
        search.problem, first, np.concatenate(trials), np.concatenate(kinds), excess_scatter, answer
    )
    found = with_unknown(known, unknown, CALIBRATED.probability_outside(misfit))
    named = found.ranking[0][0]
    best = found.candidates[named]
    parameters = search.problem.parameters
    sizes = {
        name: float(best.fit.theta[i])
        for i, name in enumerate(parameters.names)
        if parameters.effects[i] in named and named != UNKNOWN
    }
    told = what_is_told(found)
    return Change(sentence(found, told, sizes, catalogue, later.robot.actuators.words), found.ranking[:10], sizes, told)


def _comparable(before: Campaign, after: Campaign) -> tuple[Campaign, Campaign]:
    """What both campaigns hold: states of the robot, stiffness trials, or both."""
    kinds = [sum(bool((s.pushed == pushed).any()) for s in (before, after)) == 2 for pushed in (False, True)]
    if not any(kinds):
        raise TooLittle(
            "one campaign has only stiffness trials and the other has none: compare campaigns of the same kind, or "
            "record what is missing"
        )
    both = [s.take(np.array(kinds)[s.pushed.astype(int)]) for s in (before, after)]
    return both[0], both[1]


def what_is_told(found: Posterior) -> Hypothesis:
    """The most probable change, where it is hardly possible that nothing changed."""
    return found.ranking[0][0] if found.probability(NONE) < UNCHANGED else NONE


def sentence(
    found: Posterior,
    told: Hypothesis,
    sizes: Mapping[str, float],
    catalogue: Mapping[str, EffectSpec],
    words: Words = Chambers.words,
) -> str:
    """What changed, in words; `sizes` of the most probable change's parameters."""
    (named, p), benchmark = found.ranking[0], CALIBRATED.benchmark
    names = {e: words.say(spec.name) for e, spec in catalogue.items()}
    effects = OUTSIDE if named == UNKNOWN else " and ".join(with_id(e, names) for e in named)
    if named == NONE:
        return f"No change since the reference stands out from the noise (p = {p:.2f}, {benchmark})."
    if told == NONE:
        return (
            f"No change since the reference is certain: that nothing changed has p = {found.probability(NONE):.2f}; most "
            f"probable otherwise: {effects} (p = {p:.2f}, {benchmark})."
        )
    if named == UNKNOWN:
        return f"Something has changed since the reference that no effect of the catalogue explains (p = {p:.2f}, {benchmark})."
    units = {f"{e}.{q.name}": q.unit for e in named for q in catalogue[e].parameters}
    by = "; ".join(_changed(name.removesuffix(CHANGE), value, units, names, words) for name, value in sizes.items())
    return f"Since the reference {effects} changed ({by}; p = {p:.2f}, {benchmark})."


def _changed(name: str, value: float, units: Mapping[str, str], names: Mapping[str, str], words: Words) -> str:
    number, unit = for_people(value, units[name], words)
    return f"{plain_name(name, names)} by {number:.3g} {unit}".rstrip()


class _JointForward:
    """Two campaigns as one forward model: parameters common to both, then the later campaign's own changes of effects."""

    def __init__(self, before: Prepared, after: Prepared) -> None:
        self._parts = before.problem, after.problem
        self._forwards = tuple(p.forward for p in self._parts)
        a, b = self._parts[0].parameters, self._parts[1].parameters
        lasting = {i.name for i in before.forward.parameters if i.lasts and i.source not in ANOTHER_DAY}
        shared = [i for i, name in enumerate(b.names) if name in lasting]
        self._own = [i for i in range(len(b.names)) if i not in set(shared)]
        self._to_before = {i: a.names.index(b.names[i]) for i in shared}
        self._change = np.flatnonzero(b.of_effect)
        self.parameters = self._table(a, b)
        self._k, self._changes = len(a.names), len(self._change)

    def _table(self, a: Parameters, b: Parameters) -> Parameters:
        """Parameters of the reference, those that only the later campaign has, and the change of each effect since."""
        daily = ANOTHER_DAY.values()
        changed = [b.infos[i] for i in self._change]
        # Effects present in the reference are no change: each is free there, within its whole scale.
        free = [replace(i, group="nuisance") for i in (*a.infos, *(b.infos[i] for i in self._own))]
        changes = [
            replace(i, name=i.name + CHANGE, starts=(0.0,), tolerated=i.tolerated and i.source not in daily)
            for i in changed
        ]
        least = [b.least[i] if b.least else LEAST_NAMED_SIZE for i in self._change]
        return Parameters(
            (*free, *changes),
            np.concatenate([a.sd, b.sd[self._own], b.sd[self._change]]),
            (*(LEAST_NAMED_SIZE,) * len(free), *least),
            changes=True,
        )

    def _split(self, theta: Array) -> tuple[Array, Array]:
        """Each campaign's own parameters, within its bounds: the later campaign's are the reference's plus the changes."""
        a, b = self._parts[0].parameters, self._parts[1].parameters
        first = theta[: self._k]
        second = np.zeros(len(b.names))
        for i, j in self._to_before.items():
            second[i] = first[j]
        second[self._own] = theta[self._k : self._k + len(self._own)]
        second[self._change] += theta[self._k + len(self._own) :]
        return np.clip(first, a.lower, a.upper), np.clip(second, b.lower, b.upper)

    def predict(self, theta: Array, trial: bool = False) -> Array:
        """Both campaigns' values, reference first."""
        return np.concatenate([f.predict(t, trial) for f, t in zip(self._forwards, self._split(theta), strict=True)])

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """The same with derivatives by common parameters, the later campaign's own, and its changes, or some of them."""
        first, second = self._split(theta)
        y0, s0 = self._forwards[0].linearise(first)
        y1, s1 = self._forwards[1].linearise(second)
        slope = np.zeros((len(y0) + len(y1), len(theta)))
        slope[: len(y0), : self._k] = s0
        for i, j in self._to_before.items():
            slope[len(y0) :, j] = s1[:, i]
        slope[len(y0) :, self._k : self._k + len(self._own)] = s1[:, self._own]
        slope[len(y0) :, self._k + len(self._own) :] = s1[:, self._change]
        return np.concatenate([y0, y1]), slope if columns is None else slope[:, list(columns)]

    def near(self, theta: Array) -> _JointForward:
        """The same, made quicker close to parameters (k,)."""
        other = copy(self)
        other._forwards = tuple(f.near(t) for f, t in zip(self._forwards, self._split(theta), strict=True))
        return other


def _joined(before: Prepared, after: Prepared) -> Problem:
    """One problem of the values of both campaigns, reference first: each has a discrepancy of its own, the model-form error is
    of the later one, whose changes are named."""
    forward = _JointForward(before, after)
    first, second = before.problem, after.problem
    wide = max(x.noise.pressure_response.shape[1] for x in (first, second))
    noise = replace(
        first.noise,
        state=np.concatenate([first.noise.state, second.noise.state + first.noise.state.max() + 1]),
        sd=np.concatenate([first.noise.sd, second.noise.sd]),
        pressure_response=np.concatenate([_wide(x.noise.pressure_response, wide) for x in (first, second)]),
        lasting=_lasting(first.noise, second.noise),
    )
    smooth = block_diag(first.discrepancy, second.discrepancy)
    later = (second.shared_basis, second.channel_basis)
    shared_basis, channel_basis = (np.vstack([np.zeros((len(first.observed), x.shape[1])), x]) for x in later)
    measured = np.concatenate([first.observed, second.observed])
    return Problem(forward, forward.parameters, measured, noise, smooth, shared_basis, channel_basis)


def _lasting(first: Noise, second: Noise) -> Lasting | None:
    """What lasts of the errors of both; where none does in one, none of it lasts there."""
    if first.lasting is None and second.lasting is None:
        return None
    both = (x.lasting or Lasting.none(len(x.sd)) for x in (first, second))
    before, after = both
    return before.then(after)


def _wide(columns: Array, wide: int) -> Array:
    """Columns (n, r) with empty ones behind (n, wide)."""
    return np.pad(columns, ((0, 0), (0, wide - columns.shape[1])))
