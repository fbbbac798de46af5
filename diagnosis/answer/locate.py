"""Where the gap lies: root mean square by factor, with trial-bootstrap intervals, against the noise floor.

The gap is measured minus baseline model, calibrated with one area factor and nothing else; that of stiffness trials is the force
missed over the specimen's stiffness. A cell is significant when its mean square exceeds that of the noise floor, readings of one
trial counted as fully correlated, with the false discovery rate over all cells held to 5 % (Benjamini and Hochberg 1995).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
from scipy.special import chdtrc

from model.errors import ModelError
from model.robot import Robot
from model.rods import FINE, PAPER, solve
from model.section import rods_of

from ..arrays import Array, Ints, Mask, rms
from ..data.campaign import Campaign, settings
from ..data.levels import SPINE_GAP, levels
from ..inference.prepare import Prepared
from ..judgement import FALSE_DISCOVERY_RATE
from .attribute import Attribution
from .result import FACTORS, STAGES, Cell, Locate


def locate(f: Attribution, stages: Mapping[str, str]) -> Locate:
    """The section `locate`; `stages` effect id -> stage of the chain."""
    p = f.prepared
    missed = p.problem.observed - p.problem.forward.predict(p.common(f.calibrated.theta))
    gap = p.gap(missed)
    finite = np.asarray(np.isfinite(gap).all(axis=1))
    cells: dict[str, list[tuple[Cell, float]]] = {name: [] for name in FACTORS}
    for factor, cell, probability in _cells(p, missed, gap, finite):
        cells.setdefault(factor, []).append((cell, probability))
    by_factor = _mark_significant(cells)
    return Locate(
        gap_rmse_mm=1e3 * rms(gap[finite]),
        noise_floor_mm=1e3 * p.noise_floor,
        significant=any(c.significant for group in by_factor.values() for c in group),
        by=by_factor,
        stage=dict.fromkeys(STAGES, 0.0) | f.posterior.by_stage(stages),
        numerical_error_mm=float("nan") if p.baseline is not None else 1e3 * numerical_error(p.robot, p.states.take(finite)),
        of="deflection" if p.pushes_only else "tip",
    )


def _cells(p: Prepared, missed: Array, gap: Array, seen: Mask) -> Iterator[tuple[str, Cell, float]]:
    """Each cell with its factor and the probability of such a gap by noise alone, of states `seen` (states,): residuals `missed`
    (values,) and the `gap` (states, 3) m that they make."""
    rng = np.random.default_rng(20240)
    s, tips = p.states.take(seen), not p.pushes_only
    gap = gap[seen] if tips else gap[seen, :1]
    splits = {"spine_length": (s.spine_length, levels(s.spine_length, SPINE_GAP))}
    if tips:
        splits["pressure"] = (s.highest, levels(s.highest, s.pressure_gap))
    for factor, (values, level) in splits.items():
        for in_cell in _masks(level):
            yield factor, *_cell(_mean(values, in_cell), s.trial[in_cell], gap[in_cell], p.noise_floor, rng)
    for k, axis in enumerate("xyz" if tips else ""):
        yield "axis", *_cell(axis, s.trial, gap[:, [k]], p.noise_floor * np.sqrt(1 / 3), rng)
    for branch, in_cell in (("load", s.branch > 0), ("unload", s.branch < 0)):
        if in_cell.any():
            yield "branch", *_cell(branch, s.trial[in_cell], gap[in_cell], p.noise_floor, rng)
    for in_cell in _quarters(s.time):
        yield "time", *_cell(_mean(s.time, in_cell), s.trial[in_cell], gap[in_cell], p.noise_floor, rng)
    for k, arc in enumerate(p.robot.markers, 1):
        marker = _marker(p, missed, k)[seen]
        in_cell = np.asarray(np.isfinite(marker).all(axis=1))
        if np.isfinite(marker).any():
            yield "arc_length", *_cell(float(arc), s.trial[in_cell], marker[in_cell], p.noise_floor, rng)
    if p.pushes is not None:
        yield from _specimens(p, p.deflection(missed), p.pushes.noise_floor, rng)


def _marker(p: Prepared, missed: Array, k: int) -> Array:
    """(states, 3) m by which marker k is missed; NaN where it was not measured."""
    own = np.char.startswith(p.labels.channel, f"m{k}")
    out = np.full((len(p.states), 3), np.nan)
    out[p.labels.state[own], p.labels.axis[own]] = missed[own]
    return out


def _specimens(p: Prepared, missed: Array, floor: float, rng: np.random.Generator) -> Iterator[tuple[str, Cell, float]]:
    """A cell for each specimen and spine length of the stiffness trials; `missed` (states,) and `floor`: m of deflection."""
    missed, s = missed[p.states.pushed], p.states.take(p.states.pushed)
    body = (s.trials.get("specimen") == "body").astype(np.int64)
    length = levels(s.spine_length, SPINE_GAP)
    for specimen, k in np.unique(np.column_stack([body, length]), axis=0):
        own = (body == specimen) & (length == k)
        name = f"{'body, ' if specimen else ''}spine {100 * float(s.spine_length[own].mean()):.3g} cm"
        yield "stiffness", *_cell(name, s.trial[own], missed[own, None], floor, rng)


def _masks(level: Ints) -> list[Mask]:
    return [np.asarray(level == k) for k in np.unique(level)]


def _quarters(time: Array) -> list[Mask]:
    """Quarters of the campaign by time."""
    known = np.isfinite(time)
    if known.sum() < 4 or np.ptp(time[known]) == 0:
        return []
    edges = np.quantile(time[known], [0.25, 0.5, 0.75])
    return [m for m in _masks(np.where(known, np.searchsorted(edges, time), -1)) if known[m].all()]


def _mean(values: Array, own: Mask) -> float:
    return float(np.round(values[own].mean(), 6))


def _cell(value: float | str, trial: Ints, missed: Array, floor: float, rng: np.random.Generator) -> tuple[Cell, float]:
    """The cell with its bootstrap interval, and the probability of such a mean square by `floor` (m rms) alone."""
    squared = (missed**2).sum(axis=1)
    names, index = np.unique(trial, return_inverse=True)
    total, count = np.bincount(index, squared), np.bincount(index)
    drawn = rng.integers(0, len(names), (400, len(names)))
    spread = np.sqrt(total[drawn].sum(axis=1) / count[drawn].sum(axis=1))
    low, high = np.quantile(spread, [0.025, 0.975])
    # Readings of a trial erring together leave as many independent vectors as there are trials.
    freedom = missed.shape[1] * len(names)
    probability = float(chdtrc(freedom, freedom * (total / count).mean() / floor**2)) if floor > 0 else 1.0
    return Cell(
        value, 1e3 * rms(missed), 1e3 * float(missed[:, 0].mean()), len(missed), 1e3 * float(low), 1e3 * float(high), False
    ), probability


def _mark_significant(found: Mapping[str, list[tuple[Cell, float]]]) -> dict[str, tuple[Cell, ...]]:
    """Mark the significant cells, over all factors together."""
    probabilities = np.sort([p for group in found.values() for _, p in group])
    allowed = FALSE_DISCOVERY_RATE * np.arange(1, len(probabilities) + 1) / max(len(probabilities), 1)
    limit = max(probabilities[probabilities <= allowed], default=-1.0)
    return {name: tuple(replace(c, significant=bool(p <= limit)) for c, p in group) for name, group in found.items()}


def numerical_error(robot: Robot, states: Campaign) -> float:
    """Rms tip error (m) of the paper's Euler integration alone, over the distinct states; NaN where none has an equilibrium."""
    states = states.take(~states.pushed)
    if not len(states):
        return float("nan")
    _, first = np.unique(states.condition, return_index=True)
    try:
        rods = rods_of(robot, settings(robot, states.trials.take(first)))
        converged, stepped = solve(rods, FINE), solve(rods, PAPER)
    except ModelError:
        return float("nan")
    return rms((stepped.tip - converged.tip)[converged.converged & stepped.converged])
