"""The problem of a table: which parameters do anything, the noise, where fits begin, and the least size of a cause."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from model.cause import Cause

from .. import judgement
from ..arrays import Array, Ints, Mask, rms, scattered
from ..criticism.stage_errors import gains_of
from ..errors import BadCase
from ..inference.discrepancy import SmoothErrors, eigenfunctions
from ..inference.evidence import NONE, Hypothesis
from ..inference.fit import Fit, fit_alone
from ..inference.problem import FitParameters, Problem
from .answer import Left
from .cause import Parameter
from .model import Model, Predict
from .noise import NOISE_FLOOR, NoiseEstimate, left, of_repeats, parts
from .table import FUNCTIONS, Table, repeats, rows_in_words, scaled

FREE_ROUNDS, ESTIMATES, MOST_STARTS = 12, 3, 8
"""Steps of a fit by itself; times the noise is estimated; most starts of a cause."""
TIMES_STARTED, TIMES_PLAUSIBLE = (1.0, 3.0), (1.0, 3.0, 10.0, 30.0)
"""Times its stated plausible size at which fits of a cause begin, and that it may be expected to have."""
STRAY, MOST_STRAYS = 15.0, 0.05
"""Median distances from the richest model beyond which a value is a mistake of reading, ten standard deviations of noise; and the
largest share of an output's values that are."""
NONLINEAR = 0.3
"""Share by which what a parameter does at its plausible size may miss a straight line, beyond which fits begin there too."""


@dataclass(frozen=True)
class Built:
    """A problem, and what its values mean."""

    table: Table
    model: Model
    problem: Problem
    parameters: tuple[Parameter, ...]
    row: Ints
    """(n,) row of each value."""
    output: Ints
    """(n,) output of each value."""
    estimate: NoiseEstimate
    noise_from: str
    by_row: bool
    """Whether the model answers each row by itself; else it integrates over the rows of a group."""
    notes: tuple[str, ...]
    response: Array
    """(k, n) what each parameter does at its plausible size, per unit of it."""
    calibrated: Fit
    """The fit of the calibration alone."""
    richest: Fit
    """That of all causes at once and the calibration."""
    apart: bool
    """Whether something is calibrated for one group alone, such as where it begins, which no other group repeats or shows."""
    of_relatives: tuple[Parameter, ...] = ()
    """Those of the causes' relatives that change anything."""
    begun: tuple[tuple[Hypothesis, Array], ...] = ()
    """Causes that are not linear, each by itself, with parameters (k,) fitted from their plausible size."""
    estimated: bool = False
    """Whether an output has too few repeats to show its noise."""
    lasting: tuple[str, ...] = ()
    """Outputs whose errors seem to last, by what the richest model leaves of them."""

    @property
    def sd(self) -> Array:
        """(outputs,) noise floor, in each output's unit."""
        return self.estimate.floor

    def left(self, residual: Array) -> Left:
        """Root mean square of residuals (n,)."""
        each = {name: rms(residual[self.output == i]) for i, name in enumerate(self.table.outputs)}
        return Left(rms(residual / self.sd[self.output]), each)

    def by_row_and_output(self, values: Array) -> Array:
        """(rows, outputs) of values (n,); NaN where not measured."""
        return scattered(self.table.measured.shape, self.table.kept, values)

    def functions(self, fitted: Fit) -> dict[str, Array]:
        """(values, m) smooth functions of the inputs, the place in the group, and the predicted outputs and their change."""
        if self.by_row:
            return {"the inputs": self.table.functions[self.row]}
        state = self.model.table(fitted.theta)
        change = np.vstack([np.zeros((1, state.shape[1])), np.diff(state, axis=0)])
        change[np.flatnonzero(np.diff(self.table.group, prepend=-1))] = 0.0
        places = {"time": self.table.time(), "the state": scaled(np.hstack([state, change]), judgement.CORRELATION_PRESSURE)}
        return {name: eigenfunctions(place, FUNCTIONS)[self.row] for name, place in places.items()}

    def with_noise(self, estimate: NoiseEstimate) -> Built:
        """The same with other noise."""
        noise = estimate.noise(self.table, self.row, self.output)
        return replace(self, estimate=estimate, problem=replace(self.problem, noise=noise))


def build(predict: Predict, table: Table, causes: Sequence[Cause], every: tuple[Parameter, ...]) -> Built:
    """The problem of a table. Raises `BadCase` where the model has no answer at nominal parameters or plausible sizes."""
    model = Model(predict, table.inputs, list(table.outputs), every, table.kept, {p.key: p.nominal for p in every})
    at_nominal = model.table(np.zeros(len(every)))
    table = _answered(table, at_nominal)
    model = model.by(every, table.kept)
    made, response = _with_roles(model, every, at_nominal)
    listed = {*(c.name for c in causes)}
    of_relatives = tuple(p for p in made if p.group == "effect" and p.source not in listed)
    every = tuple(p for p in every if p.group != "effect" or p.source in listed)
    chosen = np.array([p not in of_relatives for p in made], bool)
    made, response = tuple(itertools.compress(made, chosen)), response[chosen]
    known = {p.source for p in made}
    unseen = [*(c.name for c in causes if c.name not in known)]
    unseen += [p.name for p in every if p.source in known | {p.key} and p.name not in {m.name for m in made}]
    notes = (*table.notes, *(f"{name} cannot be seen in these data: at its plausible size it changes nothing" for name in unseen))
    if not any(p.group == "effect" for p in made):
        raise BadCase("causes: none of them changes a measured output at its plausible size; check that predict uses theta")
    if table.kept.sum() < len(made) + 3:
        text = f"data: {table.kept.sum()} measured values are too few for {len(made)} parameters"
        raise BadCase(f"{text}; measure {len(made) + 3} or more")
    by_row = _answers_by_row(model.by(every), _plausible(every))
    row, output = np.nonzero(table.kept)
    moved_by = [{*table.group[row[moved != 0]].tolist()} for p, moved in zip(made, response, strict=True) if p.group != "effect"]
    apart = not by_row and int(table.group.max()) > 0 and any(len(groups) == 1 for groups in moved_by)
    estimate = of_repeats(table, np.arange(len(table.group)) if apart else repeats(table, by_row))
    estimated = np.isnan(estimate.sd)
    text = "from repeats"
    if estimated.any():
        whose = ", ".join(name for name, own in zip(table.outputs, estimated, strict=True) if own)
        text = f"too few repeats, so the noise of {whose} is what the richest model leaves, {NOISE_FLOOR:g} of its spread or more"
        notes = (*notes, f"{text}; repeat some rows for a noise of their own")
    rough = np.sqrt(np.nanmean(np.where(table.kept, table.measured - at_nominal, np.nan) ** 2, axis=0))
    sd = np.where(estimated, np.maximum(0.1 * rough, NOISE_FLOOR * table.spread), estimate.sd)
    estimate = replace(estimate, sd=sd, floor=sd)
    of_made = model.by(made)
    parameters = FitParameters(made, np.array([p.sd for p in made]), (judgement.LEAST_NAMED_SIZE,) * len(made))
    no_errors = SmoothErrors(np.zeros((len(row), 0)), output, len(sd), np.zeros(len(row)))
    problem = Problem(of_made, parameters, table.measured[table.kept], estimate.noise(table, row, output), no_errors)
    calibrated = fit_alone(problem, NONE, np.zeros_like(parameters.sd), FREE_ROUNDS)
    built = Built(
        table, of_made, problem, made, row, output, estimate, text, by_row, notes, response, calibrated, calibrated, apart,
        of_relatives,
    )  # fmt: skip
    return _with_discrepancy(_with_sizes(_with_richest(replace(built, begun=tuple(_begun(built))), estimated)))


def without_strays(b: Built) -> Table | None:
    """The table without single values that are `STRAY` times farther from the richest model than the median; None where there are
    none."""
    missed = np.abs(b.by_row_and_output(b.problem.observed - b.richest.predicted))
    far: Mask = missed > STRAY * np.nanmedian(missed, axis=0)
    far &= far.mean(axis=0) <= MOST_STRAYS
    if not far.any():
        return None
    rows: Mask = np.asarray(far.any(axis=1))
    text = f"{int(far.sum())} values lie {STRAY:g} times farther from the richest model than the median"
    note = f"{text} and are ignored: {rows_in_words(rows)}"
    return replace(b.table, measured=np.where(far, np.nan, b.table.measured), notes=(*b.table.notes, note))


def _answered(table: Table, at_nominal: Array) -> Table:
    """The table without values that the model does not answer at nominal parameters. Raises `BadCase` where none is left."""
    lost: Mask = np.logical_and(~np.isfinite(at_nominal), table.kept)
    rows: Mask = np.asarray(lost.any(axis=1))
    kept = table.kept & ~lost
    if not kept.any(axis=0).all() or kept.sum() < 3:
        text = f"predict returned NaN at nominal parameters in {rows.sum()} of {len(rows)} rows, the first {rows.argmax()}"
        raise BadCase(f"{text}; it must answer there")
    if not rows.any():
        return table
    note = f"predict has no answer at nominal parameters in {rows.sum()} rows, which are ignored: {rows_in_words(rows)}"
    return replace(table, measured=np.where(lost, np.nan, table.measured), notes=(*table.notes, note))


def _answers_by_row(model: Model, plausible: Array) -> bool:
    """Whether the order of rows is of no matter to the model."""
    turned = model.of(model.inputs.iloc[::-1].reset_index(drop=True))
    # at nominal a model may rest, so that the order shows at plausible sizes alone
    for theta in (np.zeros(len(plausible)), plausible):
        try:
            expected, answer = model.table(theta), turned.table(theta)[::-1]
        except BadCase:  # times that run backwards, say
            return False
        if not np.allclose(answer, expected, rtol=1e-9, atol=1e-12 * np.nanmax(np.abs(expected)), equal_nan=True):
            return False
    return True


def _plausible(every: Sequence[Parameter]) -> Array:
    """(k,) all parameters at their plausible size, within bounds."""
    return np.array([p.sd if p.high >= p.sd else max(p.low, -p.sd) for p in every])


def _with_roles(model: Model, every: Sequence[Parameter], at_nominal: Array) -> tuple[tuple[Parameter, ...], Array]:
    """The parameters that change anything, their roles and where fits begin; what each does per unit at its plausible size."""
    size, offered = _plausible(every), model.offered(np.zeros(len(every)))
    made: dict[int, tuple[Parameter, Array]] = {}

    def moved(theta: Array, since: Array) -> Array:
        change = model.table(theta) - since
        return np.where(np.isfinite(change), change, 0.0)[model.kept]

    def least(change: Array) -> bool:
        return bool(np.abs(change).max(initial=0.0) > 1e-12 * np.abs(at_nominal[model.kept]).max(initial=1e-300))

    for i, p in enumerate(every):
        one = np.arange(len(every)) == i
        slope = offered.get(p.key)
        if slope is not None and p.group == "calibration" and least(slope[model.kept] * p.sd):
            made[i] = p, slope[model.kept]
            continue
        sides = [s for s in (p.sd, -p.sd) if p.low <= s <= p.high] or [float(size[i])]
        change = {s: moved(np.where(one, s, 0.0), at_nominal) for s in (sides if p.group == "effect" else sides[:1])}
        acts = [s for s, own in change.items() if least(own)]
        for times in TIMES_PLAUSIBLE[1:] if p.group == "effect" and not acts else ():  # it may begin to act at a larger size
            larger = np.clip(times * np.array(sides), p.low, p.high).tolist()
            change = {s: np.nan_to_num(model.predict(np.where(one, s, 0.0)) - at_nominal[model.kept]) for s in larger}
            if acts := [s for s, own in change.items() if least(own)]:
                sides, size[i] = [*change], acts[0]
                break
        if acts:
            most = max(change, key=lambda s: float(change[s] @ change[s]))
            if p.group == "effect":
                # by the other side, else by a tenth of the size
                line = -change[sides[1]] if len(sides) == 2 else 10 * moved(np.where(one, 0.1 * sides[0], 0.0), at_nominal)
                bent = np.linalg.norm(change[sides[0]] - line) > NONLINEAR * np.linalg.norm(change[most])
                p = replace(p, sides=tuple(acts), linear=not bent)
            made[i] = p, change[most] / abs(most)
    for i, p in ((i, p) for i, p in enumerate(every) if i not in made):
        together = np.where([q.source == p.source for q in every], size, 0.0)
        in_shape = moved(together, model.table(np.where(np.arange(len(every)) == i, 0.0, together)))
        if least(in_shape):
            made[i] = replace(p, role="shape", sides=(float(size[i]),), linear=False), in_shape / abs(size[i])
    kept, responses = [made[i][0] for i in sorted(made)], [made[i][1] for i in sorted(made)]
    for cause in dict.fromkeys(p.source for p in kept if p.group == "effect"):
        own = [i for i, p in enumerate(kept) if p.source == cause]
        if all(kept[i].role == "shape" for i in own):  # none does anything without the others
            kept[own[0]] = replace(kept[own[0]], role="size")
    return tuple(kept), np.array(responses)


def _begun(b: Built) -> list[tuple[Hypothesis, Array]]:
    """Each cause that is not linear, by itself, fitted with the calibration, which without it may have gone astray and begins at
    nominal, too; from its plausible size and more on every side; the better two of each cause."""
    points, p = list[tuple[Hypothesis, Array]](), b.problem.parameters
    for cause in p.ids:
        own = [i for i, p in enumerate(b.parameters) if p.source == cause]
        if all(b.parameters[i].linear for i in own):
            continue
        fits = []
        ways = itertools.product(
            TIMES_STARTED, (b.calibrated.theta, np.zeros_like(p.sd)), itertools.product(*(b.parameters[i].sides for i in own))
        )
        for times, calibration, sizes in itertools.islice(ways, MOST_STARTS):
            theta = calibration.copy()
            theta[own] = np.clip(times * np.array(sizes), p.lower[own], p.upper[own])
            fits.append(fit_alone(b.problem, (cause,), theta, FREE_ROUNDS))
        points += [((cause,), f.theta) for f in sorted(fits, key=lambda f: f.cost)[:2]]
    return points


def _with_richest(b: Built, estimated: Mask) -> Built:
    """With the richest model, all causes at once and calibration, and what it and smooth functions leave as the noise of outputs
    of too few repeats; fits of causes that are not linear begin there, too."""
    p = b.problem.parameters
    points = [b.calibrated.theta, *(theta for _, theta in b.begun)]
    costs = [float(np.sum(b.problem.noise.whiten(b.problem.observed - b.model.predict(theta)) ** 2)) for theta in points]
    points = [points[0], *(points[i] for i in np.argsort(costs)[:1] if i)]
    for _ in range(ESTIMATES if estimated.any() else 1):
        richest = min((fit_alone(b.problem, p.ids, point, FREE_ROUNDS) for point in points), key=lambda f: f.cost)
        points = [richest.theta]
        if estimated.any():
            b = b.with_noise(_left(b, richest, estimated))
    lasting = tuple(name for name, q, own in zip(b.table.outputs, b.estimate.share, estimated, strict=True) if own and q)
    named = dict.fromkeys(h for h, _ in b.begun)
    begun = (*b.begun, *((h, fit_alone(b.problem, h, richest.theta, FREE_ROUNDS).theta) for h in named))
    again = fit_alone(b.problem, NONE, b.calibrated.theta, FREE_ROUNDS)
    return replace(b, calibrated=again, richest=richest, estimated=bool(estimated.any()), lasting=lasting, begun=begun)


def _left(b: Built, fitted: Fit, estimated: Mask) -> NoiseEstimate:
    """The noise that a fit leaves of the outputs `estimated`."""
    block, place = parts(b.table)
    slope = b.problem.noise.colour(fitted.derivatives(b.problem).every.whole)
    missed, known = b.problem.observed - fitted.predicted, b.estimate
    sd, share, memory, floor = known.sd.copy(), known.share.copy(), known.memory.copy(), known.floor.copy()
    functions = {name: f for name, f in b.functions(fitted).items() if name != "time"}
    basis, _, _ = np.linalg.svd(slope / known.sd[b.output][:, None], full_matrices=False)
    for i in np.flatnonzero(estimated):
        own = b.output == i
        free = int(own.sum()) - float((basis[own] ** 2).sum())  # what parameters, shared by all outputs, absorb of this one
        sd[i] = floor[i] = np.sqrt((missed[own] ** 2).sum() / max(free, 1.0))
        share[i] = 0.0
        if own.sum() > 4 * slope.shape[1]:
            most = int(own.sum()) // (4 * max(len(functions), 1))  # functions take at most a quarter of the values
            columns = np.hstack([slope[own], *(f[own, ::-1][:, :most] for f in functions.values())])
            row = b.row[own]
            sd[i], share[i], memory[i], floor[i] = left(block[row], place[row], missed[own], columns)
    least = NOISE_FLOOR * b.table.spread
    return NoiseEstimate(np.maximum(sd, least), share, memory, np.maximum(floor, least))


def _with_sizes(b: Built) -> Built:
    """With causes larger than their plausible sizes, which are guesses, added one by one in the size that explains most."""
    p, white = b.problem.parameters, b.problem.noise.whiten
    sd, columns = p.sd.copy(), white(b.response.T * p.sd)
    gram, pulled = columns.T @ columns, columns.T @ white(b.problem.observed - b.calibrated.predicted)
    own = {e: np.array([x == e for x in p.effects]) for e in p.ids}
    left_out, active = [*p.ids], ~p.of_effect
    while left_out:
        scale = (sd / p.sd)[active]
        across = gram[:, active] * scale
        taken = across @ np.linalg.inv(np.eye(len(scale)) + scale[:, None] * across[active])
        left, apart = gram - taken @ across.T, pulled - taken @ (scale * pulled[active])
        of_each = {e: gains_of(left[np.ix_(own[e], own[e])], apart[own[e]], TIMES_PLAUSIBLE) for e in left_out}
        gains = {(e, s): gain for e, of_sizes in of_each.items() for s, gain in zip(TIMES_PLAUSIBLE, of_sizes, strict=True)}
        effect, times = max(gains, key=lambda key: gains[key])
        if gains[effect, times] < judgement.SEPARATED_EVIDENCE:
            break
        if all(x.linear for x, chosen in zip(b.parameters, own[effect], strict=True) if chosen):
            sd[own[effect]] *= times
        left_out.remove(effect)
        active = active | own[effect]
    return replace(b, problem=replace(b.problem, parameters=replace(p, sd=sd)))


def _with_discrepancy(b: Built) -> Built:
    """With the discrepancy, the form of laws' errors, and the least size of a cause: that of one noise floor."""
    problem, p = b.problem, b.problem.parameters
    gap = np.array([*b.left(problem.observed - b.calibrated.predicted).by_output.values()])
    draws = (b.table.functions if b.by_row else eigenfunctions(b.table.time(), FUNCTIONS))[b.row]
    white = b.response.T / b.sd[b.output][:, None]
    left = p.beyond_calibration(white * p.sd, white)
    carried = np.sqrt((left**2).mean(axis=0))
    least = np.minimum(judgement.LEAST_NAMED_SIZE, judgement.LEAST_NAMED_FLOORS / np.maximum(carried, 1e-300))
    whole = replace(
        problem, smooth=SmoothErrors(draws, b.output, len(b.sd), np.maximum(b.sd, gap)[b.output]),
        parameters=replace(p, least=tuple(least.tolist()), narrow=True),
    )  # fmt: skip
    return replace(b, problem=whole)
