"""Where the gap lies: root mean square by factor, with trial-bootstrap intervals, against the noise floor.

The gap is measured minus baseline model, calibrated with one area factor and nothing else; that of stiffness trials is the force
missed over the specimen's stiffness. A cell is significant when its mean square exceeds that of the noise floor, readings of one
trial counted as fully correlated, with the false discovery rate over all cells held to 5 % (Benjamini and Hochberg 1995).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from ..arrays import Array, Ints, Mask, rms, rows_by
from ..data.campaign import Campaign
from ..data.levels import MASS_GAP, SPINE_GAP, distinct, levels
from ..inference.posterior import UNKNOWN
from ..inference.prepare import TINY, Prepared
from ..judgement import CONCENTRATED_GAIN, CONCENTRATED_RATIO, FALSE_DISCOVERY_RATE, FEWEST_CONCENTRATED
from .attribute import Attribution
from .result import FACTORS, STAGES, Cell, Concentrated, Locate
from .unseen import mean_squares


def locate(f: Attribution) -> Locate:
    """The section `locate`."""
    p = f.prepared
    missed = p.problem.observed - p.problem.forward.predict(p.common(f.calibrated.theta))
    gap = p.gap(missed)
    finite = np.asarray(np.isfinite(gap).all(axis=1))
    parts = (*_parts(p, missed, gap, finite), *_specimens(p, p.deflection(missed)))
    cells = [(part[0], *_cell(*part[1:])) for part in parts]
    probabilities = np.sort([probability for *_, probability in cells])
    allowed = FALSE_DISCOVERY_RATE * np.arange(1, len(cells) + 1) / max(len(cells), 1)  # over all factors together
    limit = max(probabilities[probabilities <= allowed], default=-1.0)
    by: dict[str, tuple[Cell, ...]] = dict.fromkeys(FACTORS, ())
    for factor, cell, probability in cells:
        by[factor] = (*by.get(factor, ()), replace(cell, significant=bool(probability <= limit)))
    stage = dict.fromkeys(STAGES, 0.0)
    for named, share in f.posterior.ranking:
        for of_effect in (p.forward.catalogue[effect].stage for effect in named if named != UNKNOWN):
            stage[of_effect] = stage.get(of_effect, 0.0) + share / len(named)  # an effect of a pair counts for half
    return Locate(
        gap_rmse_mm=1e3 * rms(gap[finite]),
        noise_floor_mm=1e3 * p.noise_floor,
        significant=any(cell.significant for group in by.values() for cell in group),
        by=by,
        stage=stage,
        of="deflection" if p.pushes_only else "tip",
        concentrated=concentrated(p.states.take(finite), p.gap(p.problem.observed - f.calibrated.predicted)[finite]),
    )


def concentrated(s: Campaign, gap: Array) -> Concentrated | None:
    """The part of n states in which most of the `gap` (n, 3) m lies that calibration leaves: those above or below a limit of one
    chamber's pressure, of the highest or of a load, of one branch, or before or after a trial; None where no part stands out.

    Two parts of n_1 and n_2 states with mean squares s_1^2 and s_2^2, against s^2 of all n, gain the log likelihood
    (3 / 2) (n log s^2 - n_1 log s_1^2 - n_2 log s_2^2); the part is that of the factor and limit that gain most.
    """
    factors = {f"p{k}": (values, s.pressure_gap) for k, values in enumerate(s.pressure.T, 1)}
    factors["highest"] = (s.highest, s.pressure_gap)
    factors |= {"trial": (s.trial, 0.0), "branch": (s.branch, 0.0), "spine_length": (s.spine_length, SPINE_GAP)}
    factors["tip_mass"] = (s.trials.get("tip_mass", 0.0), MASS_GAP)
    square, below = (gap**2).sum(axis=1), np.arange(1, len(s))
    counts = np.stack([below, len(s) - below])
    best, most = None, CONCENTRATED_GAIN
    for factor, (values, least) in factors.items():
        order = np.argsort(values, kind="stable")
        steps, lower = np.diff(values[order]), np.cumsum(square[order])[:-1]
        means = np.maximum(np.stack([lower, square.sum() - lower]) / counts, TINY)
        gain = 1.5 * (len(s) * np.log(square.mean()) - (counts * np.log(means)).sum(axis=0))
        parted = steps > (least if (steps > least).any() else 0.0)
        parted &= (counts.min(axis=0) >= FEWEST_CONCENTRATED) & (means.max(axis=0) > CONCENTRATED_RATIO**2 * means.min(axis=0))
        k = int(np.argmax(np.where(parted, gain, -np.inf))) if parted.any() else -1
        if k >= 0 and gain[k] > most:
            above, most = bool(means[1, k] > means[0, k]), float(gain[k])
            others, own = np.sort(1e3 * np.sqrt(means[:, k])).tolist()
            best = Concentrated(factor, above, float(values[order[k]]), int(counts[int(above), k]), own, others)
    return best


_Part = tuple[str, float | str, Ints, Array, float]
"""Factor and value; of the states there, trials (n,) and what they are missed by (n, k) m; m rms by noise alone."""


def _parts(p: Prepared, missed: Array, gap: Array, seen: Mask) -> Iterator[_Part]:
    """Parts of the states `seen` (states,): of residuals `missed` (values,) and the `gap` (states, 3) m that they make."""
    s, tips, floor = p.states.take(seen), not p.pushes_only, p.noise_floor
    gap = gap[seen] if tips else gap[seen, :1]
    splits = [("spine_length", s.spine_length, levels(s.spine_length, SPINE_GAP))]
    splits += [("pressure", s.highest, levels(s.highest, s.pressure_gap))] if tips else []
    for factor, values, level in splits:
        for own in (level == k for k in np.unique(level)):
            yield (factor, float(np.round(values[own].mean(), 6)), s.trial[own], gap[own], floor)
    for k, axis in enumerate("xyz" if tips else ""):
        yield ("axis", axis, s.trial, gap[:, [k]], floor * np.sqrt(1 / 3))
    for branch, own in (("load", s.branch > 0), ("unload", s.branch < 0)):
        if own.any():
            yield ("branch", branch, s.trial[own], gap[own], floor)
    known = np.flatnonzero(np.isfinite(s.time))
    if known.size >= 4 and np.ptp(s.time[known]) > 0:  # quarters of the campaign
        for rows in rows_by(np.searchsorted(np.quantile(s.time[known], [0.25, 0.5, 0.75]), s.time[known])):
            own = known[rows]
            yield ("time", float(np.round(s.time[own].mean(), 6)), s.trial[own], gap[own], floor)
    for arc, marker in zip(p.robot.marker_places()[:, 2], p.points(missed)[1:, seen], strict=False):
        own = np.asarray(np.isfinite(marker).all(axis=1))
        if np.isfinite(marker).any():
            yield ("arc_length", float(arc), s.trial[own], marker[own], floor)


def _specimens(p: Prepared, missed: Array) -> Iterator[_Part]:
    """Each specimen and spine length of the stiffness trials, if there are any; `missed` (states,) m of deflection."""
    if p.pushes is None:
        return
    missed, s = missed[p.states.pushed], p.states.take(p.states.pushed)
    body = (s.trials.get("specimen") == "body").astype(np.int64)
    for own in rows_by(distinct(body, levels(s.spine_length, SPINE_GAP))):
        name = "body" if p.robot.spine is None else f"{'body, ' * body[own[0]]}spine {100 * s.spine_length[own].mean():.3g} cm"
        yield ("stiffness", name, s.trial[own], missed[own, None], p.pushes.noise_floor)


def _cell(value: float | str, trial: Ints, missed: Array, floor: float) -> tuple[Cell, float]:
    """The cell with its bootstrap interval, and the probability of such a mean square by `floor` (m rms) alone."""
    index = np.unique(trial, return_inverse=True)[1]
    total, count = np.bincount(index, (missed**2).sum(axis=1)), np.bincount(index)
    low, high = np.sqrt(np.quantile(mean_squares(np.linalg.norm(missed, axis=1), trial)[1:], [0.025, 0.975]))
    # Readings of a trial erring together leave as many independent vectors as there are trials.
    freedom = missed.shape[1] * len(total)
    probability = float(chdtrc(freedom, freedom * (total / count).mean() / floor**2)) if floor > 0 else 1.0
    return Cell(
        value, 1e3 * rms(missed), 1e3 * float(missed[:, 0].mean()), len(missed), 1e3 * float(low), 1e3 * float(high), False
    ), probability
