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
from .criticism.outside import odds_outside
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
from .judgement import BENCHMARK, LEAST_NAMED_SIZE, TEMPERATURE, UNCHANGED

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
    effects = len(after.problem.parameters.ids)
    whole = posterior(candidates, effects, TEMPERATURE)
    # A change is named for what it moves in the later campaign, as a cause is.
    offset = len(before.problem.observed)
    where = [replace(part, rows=part.rows + offset) for part in parts(after)]
    known = by_what_is_carried(budget(search.problem, where, search.tried, TEMPERATURE), whole)
    first, answer = search.leading_and_answer(*(k.candidates[k.ranking[0][0]] for k in (whole, known)))
    trials = [before.labels.trial, after.labels.trial + before.labels.trial.max() + 1]
    excess_scatter = max(before.noise_components.excess_scatter, after.noise_components.excess_scatter)
    misfit = misfit_diagnostics(search.problem, first, np.concatenate(trials), excess_scatter, answer)
    odds = odds_outside(search.tried, (), misfit.law_error_gain, excess_scatter, effects)
    found = with_unknown(known, whole.candidates[NONE], odds / (1 + odds))
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
    (named, p), benchmark = found.ranking[0], BENCHMARK
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
    """Two campaigns as one forward model.

    Its parameters theta are those of the reference; those that the later campaign has for itself (`later_only`: trials, repeats,
    drift, what another day brings); and the change of each effect since. The later campaign is predicted with the values that it
    shares with the reference, plus the changes, and with its own.
    """

    def __init__(self, before: Prepared, after: Prepared) -> None:
        self._parts = before.problem, after.problem
        self._forwards = tuple(p.forward for p in self._parts)
        reference, later = (p.parameters for p in self._parts)
        lasting = {i.name for i in before.forward.parameters if i.lasts and i.source not in ANOTHER_DAY}
        self._shared = {i: reference.names.index(name) for i, name in enumerate(later.names) if name in lasting}
        """Index of a parameter in the later campaign -> in the reference."""
        self._later_only = [i for i in range(len(later.names)) if i not in self._shared]
        self._effects = np.flatnonzero(later.of_effect)
        """Indices in the later campaign."""
        k, changes = len(reference.names), len(reference.names) + len(self._later_only)
        self._places = slice(0, k), slice(k, changes), slice(changes, None)
        """In theta, of the reference's parameters, the later campaign's own, and the changes."""
        self.parameters = self._table(reference, later)

    def _table(self, reference: Parameters, later: Parameters) -> Parameters:
        """The parameters theta, see above, with their priors; only the changes can be named as a cause."""
        # Effects present in the reference are no change: each is free there, within its whole scale.
        free = [replace(i, group="nuisance") for i in (*reference.infos, *(later.infos[i] for i in self._later_only))]
        # What another day brings anyway has tolerances of its own: such an effect has changed when it is named, or not at all.
        changes = [
            replace(i, name=i.name + CHANGE, starts=(0.0,), tolerated=i.tolerated and i.source not in ANOTHER_DAY.values())
            for i in (later.infos[i] for i in self._effects)
        ]
        least = [later.least_of_each[i] for i in self._effects]
        return Parameters(
            (*free, *changes),
            np.concatenate([reference.sd, later.sd[self._later_only], later.sd[self._effects]]),
            (*(LEAST_NAMED_SIZE,) * len(free), *least),
            changes=True,
        )

    def _split(self, theta: Array) -> tuple[Array, Array]:
        """Parameters of the reference and of the later campaign, each within its campaign's bounds, from theta."""
        reference, later = (p.parameters for p in self._parts)
        first, own, changes = (theta[place] for place in self._places)
        second = np.zeros(len(later.names))
        for i, j in self._shared.items():
            second[i] = first[j]
        second[self._later_only] = own
        second[self._effects] += changes
        return np.clip(first, reference.lower, reference.upper), np.clip(second, later.lower, later.upper)

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        """Both campaigns' values (n,), reference first."""
        return np.concatenate([f.predict(t, trial, whole) for f, t in zip(self._forwards, self._split(theta), strict=True)])

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Both campaigns' values (n,), reference first, and their derivatives by theta (n, k), or by those `columns` of it."""
        first, second = self._split(theta)
        (y_first, slope_first), (y_second, slope_second) = (
            forward.linearise(t) for forward, t in zip(self._forwards, (first, second), strict=True)
        )
        n, (of_reference, own, changes) = len(y_first), self._places
        slope = np.zeros((n + len(y_second), len(theta)))
        slope[:n, of_reference] = slope_first
        for i, j in self._shared.items():
            slope[n:, j] = slope_second[:, i]
        slope[n:, own] = slope_second[:, self._later_only]
        slope[n:, changes] = slope_second[:, self._effects]
        return np.concatenate([y_first, y_second]), slope if columns is None else slope[:, list(columns)]

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
    """Errors that last from one reading to the next (see `data.noise`), of the values of both; None where neither has any."""
    if first.lasting is None and second.lasting is None:
        return None
    before, after = (noise.lasting or Lasting.none(len(noise.sd)) for noise in (first, second))
    return before.then(after)


def _wide(columns: Array, wide: int) -> Array:
    """Columns (n, r) with empty ones behind (n, wide)."""
    return np.pad(columns, ((0, 0), (0, wide - columns.shape[1])))
