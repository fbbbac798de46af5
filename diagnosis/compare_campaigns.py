"""What changed between a reference campaign and a later one.

Both are fitted at once. What the robot already had is common to both; the later campaign has parameters of its own for every
effect, and those are weighed: one effect changed, two, none, or something outside the catalogue.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from model.actuators import Words
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.scales import scales
from model.effects.spec import EffectSpec

from .answer.headline import for_people, hypothesis_name, plain_name
from .answer.result import Change
from .arrays import Array
from .criticism.stage_errors import odds_unnamed
from .data.case import Case, states
from .errors import BadCase
from .inference.budget import weighed
from .inference.evidence import NONE
from .inference.executor import SINGLE_THREAD, Executor, one_thread
from .inference.posterior import UNKNOWN, EffectPosterior, with_unknown
from .inference.prepare import Prepared, parts, prepare, table_columns
from .inference.problem import FitForward, FitParameters, Problem
from .judgement import BENCHMARK, LEAST_NAMED_SIZE, UNCHANGED

ANOTHER_DAY = {"tilt": "base_tilt", "frame_turn": "frame_misalignment", "frame_shift": "", "youngs_modulus": "body_modulus"}
"""Tolerances that each campaign has for itself, beside trials, repeats and drift, and the effect that does the same: the robot
was mounted and the cameras were calibrated anew, and silicone is as soft as the room is warm and as it has been worked. Such
an effect has changed when it is named, and not a little besides."""
CHANGE = " (change)"
"""End of the name of a parameter that may differ between the campaigns."""


@one_thread()
def compare_campaigns(
    later: Case, reference: Case, catalogue: Mapping[str, EffectSpec] = CATALOGUE, executor: Executor = SINGLE_THREAD
) -> Change:
    """What changed from `reference` to `later`; raises `BadCase` when they share no setting, or the robots differ."""
    if later.robot != reference.robot:
        raise BadCase(
            f"the robots differ: {reference.robot.name!r} in the reference, {later.robot.name!r} in this campaign, "
            "or robot.yaml was changed: give both the same robot.yaml with --robot"
        )
    both = states(reference)[0], states(later)[0]
    kinds = np.array([all((s.pushed == pushed).any() for s in both) for pushed in (False, True)])
    if not kinds.any():
        raise BadCase(
            "one campaign has only stiffness trials and the other has none: compare campaigns of the same kind, or "
            "record what is missing"
        )
    campaigns = tuple(s.take(kinds[s.pushed.astype(int)]) for s in both)
    pace = design_from_columns(later.robot, table_columns(campaigns[1])).pace
    sized = scales(later.robot, np.vstack([s.pressure for s in campaigns]), pace)
    before, after = (prepare(later.robot, s, catalogue=catalogue, sized=sized) for s in campaigns)
    before.forward.face(after.forward.plane_direction)  # what is on one side in one is there in the other
    # A change is named for what it moves in the later campaign, as a cause is.
    # of the values of both, reference first; the model-form error is of the later one
    forward, first, second = _JointForward(before, after), before.problem, after.problem
    measured, n = np.concatenate([first.observed, second.observed]), len(first.observed)
    joined = Problem(forward, forward.parameters, measured, first.noise.then(second.noise), first.smooth.then(second.smooth))
    w = weighed(joined, [replace(part, rows=part.rows + n) for part in parts(after)], executor)
    odds = odds_unnamed(w.best.weighed.law_error_gain, max(p.noise_components.excess_scatter for p in (before, after)))
    ranked = with_unknown(w.known, w.whole.candidates[NONE], odds)
    named, parameters = ranked.ranking[0][0], w.search.problem.parameters
    of_named = [i for i, effect in enumerate(parameters.effects) if effect in named and named != UNKNOWN]
    sizes = {parameters.names[i]: float(ranked.candidates[named].fit.theta[i]) for i in of_named}
    statement = sentence(ranked, sizes, catalogue, later.robot.actuators.words)
    return Change(statement, ranked.ranking[:10], sizes, named if ranked.probability(NONE) < UNCHANGED else NONE)


def sentence(posterior: EffectPosterior, sizes: Mapping[str, float], catalogue: Mapping[str, EffectSpec], words: Words) -> str:
    """What changed, in words; `sizes` of the most probable change's parameters."""
    named, p = posterior.ranking[0]
    probability = f"p = {p:.2f}, {BENCHMARK}"
    names = {e: spec.name(words) for e, spec in catalogue.items()}
    effects = hypothesis_name(named, names, joint=" and ")
    if named == NONE:
        return f"No change since the reference stands out from the noise ({probability})."
    if posterior.probability(NONE) >= UNCHANGED:
        return (
            f"No change since the reference is certain: that nothing changed has p = {posterior.probability(NONE):.2f}; most "
            f"probable otherwise: {effects} ({probability})."
        )
    if named == UNKNOWN:
        return f"Something has changed since the reference that no effect of the catalogue explains ({probability})."
    units = {f"{e}.{q.name}": q.unit for e in named for q in catalogue[e].parameters}
    read = {name: for_people(value, units[name], words) for key, value in sizes.items() for name in [key.removesuffix(CHANGE)]}
    by = "; ".join(f"{plain_name(name, names)} by {number:.3g} {unit}".rstrip() for name, (number, unit) in read.items())
    return f"Since the reference {effects} changed ({by}; {probability})."


class _JointForward:
    """Two campaigns as one forward model: parameters of the reference, the later campaign's own, and each effect's change."""

    def __init__(self, before: Prepared, after: Prepared) -> None:
        """theta: the reference's parameters, those that the later campaign has for itself, the changes of its effects'."""
        self._parts = before.problem, after.problem
        self._forwards = tuple(p.forward for p in self._parts)
        reference, later = (p.parameters for p in self._parts)
        lasting = {i.name for i in before.forward.parameters if i.lasts and i.source not in ANOTHER_DAY}
        later_only = [i for i, name in enumerate(later.names) if name not in lasting]
        changed, common = np.flatnonzero(later.of_effect).tolist(), {n: i for i, n in enumerate(later.names) if n in lasting}
        self._later = np.array([*(common.get(name, -1) for name in reference.names), *later_only, *changed])
        """The parameter of the later campaign that each of theta is added to; -1: none."""
        # Effects present in the reference are no change: each is free there, within its whole scale.
        free = [replace(i, group="nuisance") for i in (*reference.infos, *(later.infos[i] for i in later_only))]
        # What another day brings anyway has tolerances of its own: such an effect has changed when it is named, or not at all.
        changes = [
            replace(i, name=i.name + CHANGE, starts=(0.0,), tolerated=i.tolerated and i.source not in ANOTHER_DAY.values())
            for i in (later.infos[i] for i in changed)
        ]
        least_sizes = [later.least[i] for i in changed]
        sd = np.concatenate([reference.sd, later.sd[later_only], later.sd[changed]])
        self.parameters = FitParameters((*free, *changes), sd, (*(LEAST_NAMED_SIZE,) * len(free), *least_sizes), changes=True)

    def _split(self, theta: Array) -> Iterable[tuple[FitForward, Array]]:
        """The model and the parameters of the reference and of the later campaign, each within its campaign's bounds."""
        reference, later = (p.parameters for p in self._parts)
        second = np.bincount(self._later[self._later >= 0], theta[self._later >= 0], len(later.names))
        first = np.clip(theta[: len(reference.names)], reference.lower, reference.upper)
        return zip(self._forwards, (first, np.clip(second, later.lower, later.upper)), strict=True)

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        """Both campaigns' values (n,), reference first."""
        return np.concatenate([forward.predict(own, trial, whole) for forward, own in self._split(theta)])

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Both campaigns' values (n,), reference first, and their derivatives by theta (n, k), or by those `columns` of it."""
        (y_first, of_first), (y_second, of_second) = (forward.linearise(own) for forward, own in self._split(theta))
        of_first = np.pad(of_first, ((0, 0), (0, len(theta) - of_first.shape[1])))
        slope = np.vstack([of_first, np.where(self._later < 0, 0.0, of_second[:, self._later])])
        return np.concatenate([y_first, y_second]), slope if columns is None else slope[:, list(columns)]

    def near(self, theta: Array) -> _JointForward:
        """The same, made quicker close to parameters (k,)."""
        other = copy(self)
        other._forwards = tuple(forward.near(own) for forward, own in self._split(theta))
        return other
