"""Where the gap lies: root mean square by factor, with trial-bootstrap intervals, against the noise floor.

The gap is measured minus baseline model, the baseline being calibrated with one area factor and nothing else; that of
stiffness trials is the force missed over the specimen's stiffness. A cell is called significant when its mean square
exceeds that of the noise floor, readings of one trial counted as fully correlated, with the false discovery rate over all
cells held to 5 % (Benjamini and Hochberg 1995).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from model.errors import ModelError
from model.robot import Robot
from model.rods import FINE, PAPER, solve
from model.section import rods_of

from ..data.campaign import Campaign, settings
from ..data.levels import SPINE_GAP, levels
from ..judgement import FALSE_DISCOVERY_RATE
from .result import Cell

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Pushes:
    """The gap of stiffness trials."""

    states: Campaign
    """Those of the stiffness trials."""
    missed: Array
    """(n,) m of deflection."""
    floor: float
    """m of deflection, rms of a single reading."""


def cells(
    states: Campaign, gap: Array, floor: float, markers: Mapping[float, Array], pushes: Pushes | None = None
) -> dict[str, tuple[Cell, ...]]:
    """The gap (n, 3) m by factor; `floor` m, rms distance of a single reading; `markers` arc length m -> (n, 3) m.

    The gap is that of tips; of stiffness trials alone it is the deflection, along x. `pushes` adds their gap by specimen
    and spine length. A floor that is not known (NaN) makes no cell significant.
    """
    rng = np.random.default_rng(20240)
    length, pressure = levels(states.spine_length, SPINE_GAP), levels(states.highest, states.pressure_gap)
    found: dict[str, list[tuple[Cell, float]]] = {}

    def cell(value: float | str, own: Mask, missed: Array, share: float = 1.0) -> tuple[Cell, float]:
        return _cell(value, states.trial[own], missed[own], floor * np.sqrt(share), rng)

    tips = not states.pushed.all()
    gap = gap if tips else gap[:, :1]
    found["spine_length"] = [cell(_mean(states.spine_length, m), m, gap) for m in _masks(length)]
    found["pressure"] = [cell(_mean(states.highest, m), m, gap) for m in _masks(pressure) if tips]
    everything = np.ones(len(states), bool)
    found["axis"] = [cell(name, everything, gap[:, [k]], 1 / 3) for k, name in enumerate("xyz") if tips]
    branches: dict[str, Mask] = {"load": states.branch > 0, "unload": states.branch < 0}
    found["branch"] = [cell(name, own, gap) for name, own in branches.items() if own.any()]
    found["time"] = [cell(_mean(states.time, m), m, gap) for m in _bins(states.time)]
    found["arc_length"] = [
        cell(s, np.asarray(np.isfinite(missed).all(axis=1)), missed) for s, missed in markers.items() if np.isfinite(missed).any()
    ]
    if pushes is not None:
        found["stiffness"] = _specimens(pushes, rng)
    return _mark_significant(found)


def _specimens(p: Pushes, rng: np.random.Generator) -> list[tuple[Cell, float]]:
    """A cell for each specimen and spine length."""
    body = np.array([r.specimen == "body" for r in p.states.rows], np.int64)
    length = levels(p.states.spine_length, SPINE_GAP)
    found = []
    for specimen, k in np.unique(np.column_stack([body, length]), axis=0):
        own = (body == specimen) & (length == k)
        at = 100 * float(p.states.spine_length[own].mean())
        name = f"body, spine {at:.3g} cm" if specimen else f"spine {at:.3g} cm"
        found.append(_cell(name, p.states.trial[own], p.missed[own, None], p.floor, rng))
    return found


def _masks(level: NDArray[np.int64]) -> list[Mask]:
    return [np.asarray(level == k) for k in np.unique(level)]


def _bins(time: Array, bins: int = 4) -> list[Mask]:
    """Quarters of the campaign by time."""
    known = np.isfinite(time)
    if known.sum() < bins or np.ptp(time[known]) == 0:
        return []
    edges = np.quantile(time[known], np.linspace(0, 1, bins + 1)[1:-1])
    return [m for m in _masks(np.where(known, np.searchsorted(edges, time), -1)) if known[m].all()]


def _mean(values: Array, own: Mask) -> float:
    return float(np.round(values[own].mean(), 6))


def _cell(
    value: float | str, trial: NDArray[np.int64], missed: Array, floor: float, rng: np.random.Generator
) -> tuple[Cell, float]:
    """The cell, its 95 % interval from trials drawn anew, and the probability of a mean square as large when there is nothing but
    the floor. `missed` (n, axes) m, `trial` (n,), `floor` m rms."""
    squared = (missed**2).sum(axis=1)
    names, index = np.unique(trial, return_inverse=True)
    total, count = np.bincount(index, squared), np.bincount(index)
    drawn = rng.integers(0, len(names), (400, len(names)))
    spread = np.sqrt(total[drawn].sum(axis=1) / count[drawn].sum(axis=1))
    low, high = np.quantile(spread, [0.025, 0.975])
    # Readings of a trial erring together leave as many independent vectors as there are trials.
    freedom = missed.shape[1] * len(names)
    statistic = freedom * float((total / count).mean()) / floor**2 if floor > 0 else 0.0
    probability = float(chdtrc(freedom, statistic)) if np.isfinite(floor) and floor > 0 else 1.0
    rmse, bias = float(np.sqrt(squared.mean())), float(missed[:, 0].mean())
    made = Cell(value, rmse * 1e3, bias * 1e3, len(missed), float(low) * 1e3, float(high) * 1e3, False)
    return made, probability


def _mark_significant(found: Mapping[str, list[tuple[Cell, float]]]) -> dict[str, tuple[Cell, ...]]:
    """Mark the significant cells, over all factors together."""
    probabilities = np.sort([p for group in found.values() for _, p in group])
    allowed = FALSE_DISCOVERY_RATE * np.arange(1, len(probabilities) + 1) / max(len(probabilities), 1)
    passed = np.flatnonzero(probabilities <= allowed)
    limit = probabilities[passed[-1]] if passed.size else -1.0
    return {name: tuple(replace(c, significant=bool(p <= limit)) for c, p in group) for name, group in found.items()}


def numerical_error(robot: Robot, states: Campaign) -> float:
    """Rms tip error (m) of the paper's Euler integration alone, over the distinct states; NaN where none has an equilibrium."""
    states = states.take(~states.pushed)
    if not len(states):
        return float("nan")
    _, first = np.unique(states.condition, return_index=True)
    try:
        rods = rods_of(robot, settings(robot, [states.rows[i] for i in first]), full=True)
        converged, stepped = solve(rods, FINE), solve(rods, PAPER)
    except ModelError:
        return float("nan")
    ok = converged.converged & stepped.converged
    if not ok.any():
        return float("nan")
    return float(np.sqrt(((stepped.tip - converged.tip)[ok] ** 2).sum(axis=1).mean()))
