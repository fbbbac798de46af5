"""States in, readings out: checked arrays, in batches on several cores, with intervals and gradients where they are wanted."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from model.condition import conditions
from model.effects.catalogue import CATALOGUE
from model.effects.design import HOLD, NOMINAL_VACUUM, RATE
from model.effects.spec import EffectSpec
from model.errors import BadCondition
from model.prediction.chain import Chain, Varied
from model.prediction.residual import residual_of
from model.prediction.spread import PRESSURE, standard_deviations, uncertain
from model.prediction.states import States, design_of, states_of
from model.robot import Robot
from model.stated import AREA_FACTOR

Array = NDArray[np.float64]
Order = NDArray[np.intp]

SAME_LENGTH = 0.02
"""m of spine length within which states are put beside each other."""
BATCH = 4096
"""States that are worked on together: their arrays stay within a processor's cache."""
PRESSURE_STEP, LENGTH_STEP = 50.0, 1e-5
"""Pa and m by which inputs are varied for a gradient."""
SHARE = 1e-3
"""Of its standard deviation by which a parameter is varied."""
PRESSURE_NOISE = 2e3
"""Pa by which a reading of a regulator may lie outside the robot's limits."""
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Prediction:
    """What is expected of n states; NaN where the rod has no equilibrium. Base frame, SI."""

    tip: Array
    """(n, 3) m, as the cameras read it."""
    orientation: Array
    """(n, 4) unit quaternion w, x, y, z of the tip, w >= 0."""
    shape: Array
    """(n, k, 3) m at the arc lengths that were asked for, the robot's markers unless given."""
    model_sd: Array | None = None
    """(n, 3) m: standard deviation of where the tip is (parameters, law error, discrepancy, pressure, spine grown anew)."""
    sd: Array | None = None
    """(n, 3) m: the same of a reading of it, its noise included."""
    orientation_sd: Array | None = None
    """(n, 3) rad, about the base frame's axes, as `model_sd`, without discrepancy."""
    shape_sd: Array | None = None
    """(n, k, 3) m, as `sd`."""
    tip_by_pressure: Array | None = None
    """(n, 3, chambers) m/Pa."""
    tip_by_length: Array | None = None
    """(n, 3) m/m: by the spine's length."""
    outside: NDArray[np.bool_] | None = None
    """(n,) whether a pressure is below 0 or above the robot's `max_pressure`, by more than `PRESSURE_NOISE`: nothing was
    measured there. None from `campaign`."""

    @property
    def converged(self) -> NDArray[np.bool_]:
        """(n,) whether the rod has a trusted equilibrium."""
        return np.asarray(np.isfinite(self.tip).all(axis=1))

    def interval(self, model_only: bool = False) -> tuple[Array, Array]:
        """Ends (n, 3) m of the 95 % interval of a reading of the tip, or of where it is; raises `BadCondition` without."""
        sd = self.model_sd if model_only else self.sd
        if sd is None:
            raise BadCondition("interval: was not asked for, give intervals=True")
        return self.tip - NORMAL_95 * sd, self.tip + NORMAL_95 * sd


class Predictor:
    """The model of one robot, its effects and tolerances included, made once and used often.

    `catalogue`: effects of one's own besides the project's; `cores`: threads (all unless given). Raises `BadRobot` for an
    effect that robot.yaml states wrongly.

    >>> from pathlib import Path
    >>> from model.robot import load_robot
    >>> at = Predictor(load_robot(Path("robot.yaml")))
    >>> at([[60e3, 60e3, 60e3, 0, 0, 0, 0, 0, 0]], spine_length=0.1).tip.round(2)
    array([[-0.01, -0.01,  0.4 ]])
    """

    def __repr__(self) -> str:
        r = self.robot
        return f"<Predictor of {r.name}: {len(r.actuators.azimuths_deg)} actuators, effects: {', '.join(r.effects) or 'none'}>"

    def __init__(self, robot: Robot, catalogue: Mapping[str, EffectSpec] = CATALOGUE, cores: int | None = None) -> None:
        self.robot, self._chain, self._residual = robot, Chain(robot, catalogue), residual_of(robot)
        self._cores = cores if cores is not None else len(os.sched_getaffinity(0))
        self._names, self._covariance = uncertain(robot)
        bounds = {f"{id}.{p.name}": p for id, spec in self._chain.specs.items() for p in spec.parameters}
        sd = np.sqrt(np.diag(self._covariance))
        stated = robot.stated
        self._steps = np.array(
            [
                SHARE * s * (-1.0 if n in stated and stated[n].value + SHARE * s > bounds[n].high else 1.0)
                for n, s in zip(self._names, sd.tolist(), strict=True)
            ]
        )

    def __call__(
        self,
        pressures: ArrayLike,
        spine_length: ArrayLike = 0.0,
        tip_mass: ArrayLike | None = None,
        roll: ArrayLike = 0.0,
        *,
        vacuum: float = NOMINAL_VACUUM,
        rate: float = RATE,
        hold: float = HOLD,
        arcs: ArrayLike | None = None,
        intervals: bool = False,
        gradient: bool = False,
    ) -> Prediction:
        """Readings of n states, each reached from rest by one ramp of `rate` (Pa/s) and read `hold` (s) after its end.

        `pressures` (n, chambers) or (chambers,) Pa gauge as read; `spine_length` m, `tip_mass` kg (robot.yaml's unless
        given) and `roll` rad, each one number or (n,). `vacuum` Pa below ambient is the one at which the spine's moduli
        hold. Rate and hold matter to effects with memory alone. `arcs` (k,) m from the base. Raises `BadCondition`.
        """
        asked = conditions(self.robot, spine_length, pressures, tip_mass, roll)
        places = np.asarray(self.robot.markers if arcs is None else arcs, float).reshape(-1)
        if ((places < 0) | (places > self.robot.length)).any():
            raise BadCondition(
                f"arcs: {places[(places < 0) | (places > self.robot.length)][0]:g} m must lie between 0 and the robot's "
                f"length {self.robot.length:g} m"
            )

        def part(rows: Order) -> Prediction:
            own = states_of(self.robot, design_of(asked[rows], vacuum, rate, hold))
            return self._predicted(own, places, intervals, gradient)

        n = len(asked)
        # Rods that are solved together share their steps: alike ones need fewer.
        alike = np.lexsort((asked.pressure.sum(axis=1), np.round(asked.spine_length / SAME_LENGTH)))
        order = alike if n > BATCH else np.arange(n)
        batches = [order[k : k + BATCH] for k in range(0, n, BATCH)]
        found = _joined(self._shared_out(part, batches), order)
        return replace(found, outside=self._outside(asked.pressure))

    def _outside(self, pressure: Array) -> NDArray[np.bool_]:
        """(n,) of pressures (n, chambers) Pa; warns where there are any."""
        highest = np.inf if self.robot.max_pressure is None else self.robot.max_pressure
        outside: NDArray[np.bool_] = np.any(
            (pressure < -PRESSURE_NOISE) | (pressure > highest + PRESSURE_NOISE), axis=1
        )
        if self.robot.chambers is None:
            return np.zeros(len(pressure), bool)
        if outside.any():
            warnings.warn(
                f"{int(outside.sum())} of {len(pressure)} states have pressures outside 0 to {highest / 1e3:g} kPa, the "
                f"limits of {self.robot.name}; `.outside` marks them",
                stacklevel=3,
            )
        return outside

    def _shared_out(self, part: Callable[[Order], Prediction], batches: Sequence[Order]) -> list[Prediction]:
        if self._cores < 2 or len(batches) < 2:
            return [part(rows) for rows in batches]
        with ThreadPoolExecutor(self._cores) as pool:
            return list(pool.map(part, batches))

    def _predicted(self, s: States, arcs: Array, intervals: bool, gradient: bool) -> Prediction:
        chain = self._chain
        learnt = None
        if self._residual is not None:
            asked = s.design.pressure, s.design.spine_length
            learnt = self._residual(*asked, intervals=intervals, gradient=gradient)
        missed, unexplained = (0.0, None) if learnt is None else (learnt.mean, learnt.variance)
        if not gradient and not intervals:
            r = chain.read(s, chain.values, arcs)
            return Prediction(r.tip + missed, r.orientation, r.shape)
        by_input = None
        if gradient:
            r, by_input = chain.slopes(s, chain.values, arcs[:0], self._inputs(s))
        found: dict[str, Any] = {}
        if intervals:
            r, by_parameter = chain.slopes(s, chain.values, arcs, self._parameters(s))
            absent = [chain.read(s, chain.without(id), arcs) for id in self.robot.effects]
            covariance = self._covariance if self._names else np.zeros((1, 1))
            found |= standard_deviations(self.robot, covariance, r, by_parameter, absent, unexplained)
        elif gradient and len(arcs):
            r = chain.read(s, chain.values, arcs)
        if by_input is not None:
            found["tip_by_pressure"] = by_input.tip[:-1].transpose(1, 2, 0)
            found["tip_by_length"] = by_input.tip[-1]
            if learnt is not None and learnt.by_pressure is not None and learnt.by_length is not None:
                found["tip_by_pressure"] = found["tip_by_pressure"] + learnt.by_pressure
                found["tip_by_length"] = found["tip_by_length"] + learnt.by_length
        return Prediction(r.tip + missed, r.orientation, r.shape, **found)

    def _inputs(self, s: States) -> Varied:
        """Each chamber's pressure, then the spine's length."""
        chambers = s.pressure.shape[2]
        by = np.append(np.full(chambers, PRESSURE_STEP), LENGTH_STEP)
        pressure = np.repeat(s.pressure, chambers + 1, axis=0)
        for c in range(chambers):
            pressure[c, :, c] += PRESSURE_STEP
        length = np.repeat(s.spine_length, chambers + 1, axis=0)
        length[-1] += LENGTH_STEP
        factor = np.repeat(s.area_factor, chambers + 1, axis=0)
        factor[-1] = self.robot.area_factor_at(length[-1])
        return Varied(States(s.design, pressure, length, factor), self._chain.values, by)

    def _parameters(self, s: States) -> Varied:
        """Each parameter that is not exact; none: a single one that changes nothing."""
        values: dict[str, dict[str, Array]] = {id: dict(own) for id, own in self._chain.values.items()}
        k = max(len(self._names), 1)
        factor, pressure = np.repeat(s.area_factor, k, axis=0), np.repeat(s.pressure, k, axis=0)
        for i, name in enumerate(self._names):
            id, _, parameter = name.partition(".")
            if name == AREA_FACTOR:
                factor[i] += self._steps[i]
            elif name == PRESSURE:
                pressure[i] += self._steps[i] * s.design.used
            else:
                values[id][parameter] = np.repeat(values[id][parameter], k, axis=0)
                values[id][parameter][i] += self._steps[i]
        by = self._steps if len(self._names) else np.ones(1)
        return Varied(States(s.design, pressure, s.spine_length, factor), values, by)


def _joined(parts: Sequence[Prediction], order: Order) -> Prediction:
    if len(parts) == 1:
        return parts[0]
    back = np.argsort(order)
    columns = {f.name: [getattr(p, f.name) for p in parts] for f in fields(Prediction)}
    made: Any = {name: None if own[0] is None else np.concatenate(own)[back] for name, own in columns.items()}
    return Prediction(**made)
