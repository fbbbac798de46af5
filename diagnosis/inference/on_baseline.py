"""Effects on top of another simulator's prediction.

With y_sim what the simulator predicts of the states and rod(theta) the rod with parameters theta,

    y(theta, s) = rod(theta) + (1 - s) (y_sim - rod(0) + sum_k theta_k (dy_sim/dtheta_k - drod/dtheta_k)),    0 <= s <= 1,

k over the parameters that the simulator can vary itself,
rod(0) having the area factor with which it comes nearest to y_sim, so that effects act on a rod that bends as far. The share s
is fitted beside the area factor, in every hypothesis: it states how much of the simulator's difference from the rod is
absent from the measurements (an error of its numerics, its mesh or its form). How the simulator's response to an effect
differs from the rod's is part of the effect's law error; a factor common to all states is its size.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from model.condition import States
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from model.effects.spec import EffectSpec, Law, Parameter
from model.robot import Robot
from recordings.trials import Table

from ..arrays import Array, Ints
from ..errors import BadCase

SIMULATOR_DIFFERENCE = EffectSpec(
    id="simulator_difference",
    stage="simulator",
    equation="y = y_sim - s (y_sim - y_rod)",
    parameters=(Parameter("share", "1", 1.0, 0.0, 1.0, "blend"),),
    law=Law(),
    citation="this package: diagnosis.inference.on_baseline",
    seen_best_in="states in which simulator and rod differ",
)
SHARE = "simulator_difference.share"
ROUNDS, ENOUGH = 12, 1e-6
"""Of Gauss-Newton, at most; largest step of a parameter at which it ends."""
LEAST_AREA_EXCESS, MOST_AREA_EXCESS = -0.85, 7.5


@dataclass(frozen=True)
class Baseline:
    """What another simulator predicts of n states, in the order of the case's table."""

    name: str
    """Of the simulator, or of the file of its predictions."""
    predicted: Table
    """Tip, orientation and markers, NaN where there are none, at spine lengths and pressures that may differ a little from the
    measured ones."""
    varied: Mapping[str, tuple[float, Baseline]] = field(default_factory=dict)
    """Parameter -> a small step in its unit, and the simulator's prediction after that step."""

    def take(self, own: Ints) -> Baseline:
        """The predictions of some states, by their rows in the table (m,)."""
        varied = {name: (step, there.take(own)) for name, (step, there) in self.varied.items()}
        return replace(self, predicted=self.predicted.take(own), varied=varied)


@dataclass(frozen=True)
class OnBaseline:
    """A forward model with a simulator's difference from the rod added."""

    name: str
    forward: ForwardModel
    difference: Array
    """(observations,) simulator minus rod; NaN where the simulator predicts nothing."""
    varied: Mapping[int, Array]
    """Index of a parameter -> (observations,) by how much the simulator's derivative exceeds the rod's."""
    area_factor: float
    """The one with which the rod comes closest to the simulator."""

    @cached_property
    def _share(self) -> int:
        return [p.name for p in self.forward.parameters].index(SHARE)

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        """(observations,) at parameters (k,)."""
        return np.asarray(self.forward.predict(theta, trial, whole) + (1.0 - theta[self._share]) * self._apart(theta))

    def _apart(self, theta: Array) -> Array:
        """(observations,) simulator minus rod at these parameters."""
        return sum((theta[k] * excess for k, excess in self.varied.items()), self.difference)

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Prediction, and its derivatives (observations, k)."""
        predicted, slope = self.forward.linearise(theta, columns)
        kept, apart = 1.0 - theta[self._share], self._apart(theta)
        beside = {k: kept * excess for k, excess in self.varied.items()} | {self._share: -apart}
        for j, k in enumerate(range(slope.shape[1]) if columns is None else columns):
            slope[:, j] += beside.get(k, 0.0)
        return predicted + kept * apart, slope

    def near(self, theta: Array) -> OnBaseline:
        """The same, made quicker close to parameters (k,)."""
        return replace(self, forward=self.forward.near(theta))


def on_baseline(
    robot: Robot,
    design: States,
    table: Mapping[str, NDArray[np.generic]],
    catalogue: Mapping[str, EffectSpec],
    baseline: Baseline,
) -> OnBaseline:
    """The model of the states of a design with a table's columns; raises `BadCase` where the rod cannot stand in.

    A simulator's settings may differ a little from those measured: its difference from the rod is taken at its own
    settings (`shifted`), and added to the rod at the measured ones.
    """
    at_simulator = {**table, **baseline.predicted.values}
    shifted = design_from_columns(robot, at_simulator, design.channels)
    factor = _nearest_area_factor(robot, shifted, at_simulator, baseline.name)
    effects = {**catalogue, SIMULATOR_DIFFERENCE.id: SIMULATOR_DIFFERENCE}
    forward = ForwardModel(robot, design, "one", effects, area_factor=factor)
    rod = ForwardModel(robot, shifted, "one", effects, area_factor=factor, sized=forward.scales)
    names = [p.name for p in rod.parameters]
    varied_by_both = [names.index(name) for name in baseline.varied if name in names]
    predicted, slope = rod.linearise(np.zeros(len(names)), varied_by_both)
    simulator_values = rod.observe(at_simulator)
    varied = {}
    for k, column in zip(varied_by_both, slope.T, strict=True):
        step, predictions = baseline.varied[names[k]]
        varied[k] = (rod.observe({**table, **predictions.predicted.values}) - simulator_values) / step - column
    return OnBaseline(baseline.name, forward, simulator_values - predicted, varied, factor)


def _nearest_area_factor(robot: Robot, design: States, simulator_table: Mapping[str, NDArray[np.generic]], name: str) -> float:
    """The one area factor of the rod whose tips come nearest to a simulator's."""
    model = ForwardModel(robot, design, catalogue={})
    of_tip = np.isin(model.observations.channel, ("x", "y", "z"))
    tips = np.where(of_tip, model.observe(simulator_table), np.nan)
    area = model.index("area")
    theta, left = least_squares(model, tips, area, np.array([np.inf]), [LEAST_AREA_EXCESS], [MOST_AREA_EXCESS])
    if not np.isfinite(left).any():
        raise BadCase(
            f"the baseline {name} has no state in which the rod of robot.yaml has an equilibrium: check its stiffness and "
            "area factor"
        )
    return float(model.area_factor[~design.stiffness].mean()) * (1.0 + float(theta[area[0]]))


def least_squares(
    model: ForwardModel, observed: Array, free: Sequence[int], sd: Array, low: Sequence[float], high: Sequence[float]
) -> tuple[Array, Array]:
    """Parameters (k,), 0 but for those of indices `free` (f,), fitted within bounds to the observed values (n,) that are finite,
    with priors of standard deviation `sd` (f,) in units of a value's error; and observed minus predicted values (n,) there."""
    theta, free = np.zeros(len(model.parameters)), list(free)
    for _ in range(ROUNDS):
        predicted, slope = model.linearise(theta, free)
        left = observed - predicted
        usable = np.isfinite(left) & np.isfinite(slope).all(axis=1)
        rows = np.vstack([slope[usable], np.diag(1 / sd)])
        step = np.linalg.lstsq(rows, np.concatenate([left[usable], -theta[free] / sd]), rcond=None)[0]
        before, theta[free] = theta[free], np.clip(theta[free] + step, low, high)
        if np.abs(theta[free] - before).max() < ENOUGH:
            break
    return theta, observed - model.predict(theta)
