"""From states to readings: laws before the rod, the rod, laws with memory, laws after the rod; and the derivatives.

Without memory, rods by inputs and readings by equilibria are differenced, equilibria by rods are not. Laws with memory are
solved twice (what drives them is the rod without), and differenced as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from model.effects import layout as at
from model.effects import solver
from model.effects.catalogue import CATALOGUE
from model.effects.compose import rod_columns
from model.effects.history import Path, by_element, drive, history_of, rest_columns
from model.effects.nominal import TOLERANCES, obstacle_direction, stated_effects, values_of
from model.effects.quantities import Quantities, baseline
from model.effects.readings import Readings, readings
from model.effects.rotations import CONJUGATE, rotation_vector
from model.effects.spec import EffectSpec, Law
from model.effects.spine import ShearSpine, shear_spine
from model.effects.tolerance import BY_TRIAL
from model.errors import BadRobot
from model.prediction.equilibria import moved_by, solved
from model.prediction.states import States, with_rest
from model.robot import Robot
from model.rotation import multiply

Array = NDArray[np.float64]
Values = Mapping[str, Mapping[str, Array]]
"""Effect or tolerance -> parameter -> (v, 1)."""


@dataclass(frozen=True)
class Read:
    """What is read of n states; NaN where there is no equilibrium."""

    tip: Array
    """(n, 3) m."""
    orientation: Array
    """(n, 4) quaternion w, x, y, z."""
    shape: Array
    """(n, k, 3) m at the arc lengths."""


@dataclass(frozen=True)
class Slopes:
    """Derivatives of readings by v inputs, per unit of each."""

    tip: Array
    """(v, n, 3)."""
    turn: Array
    """(v, n, 3) rad, rotation vector in the base frame."""
    shape: Array
    """(v, n, k, 3)."""


@dataclass(frozen=True)
class Varied:
    """v inputs, each varied by itself: the states and values beside, and by how much each is varied."""

    states: States
    values: Values
    by: Array
    """(v,) in the input's unit."""


class Chain:
    """One robot with its effects and tolerances. Raises `BadRobot` for what robot.yaml states wrongly."""

    def __init__(self, robot: Robot, catalogue: Mapping[str, EffectSpec] = CATALOGUE) -> None:
        effects = stated_effects(robot, catalogue)
        self.robot = robot
        self.specs: dict[str, EffectSpec] = {
            **effects,
            **{id: spec for id, spec in TOLERANCES.items() if id in robot.tolerances},
        }
        if robot.spine is not None:
            self.specs |= {source.spec.id: source.spec for source in BY_TRIAL}
        tables = {**robot.effects, **robot.tolerances}
        self.values: dict[str, dict[str, Array]] = {
            id: values_of(tables.get(id, {}), spec) for id, spec in self.specs.items()
        }
        direction = obstacle_direction(robot)
        if "contact" in effects and direction is None:
            raise BadRobot(
                f"robot {robot.name!r}: effects.contact needs obstacle_azimuth_deg, the direction in which the obstacle stands"
            )
        self._direction = np.array([1.0, 0.0]) if direction is None else direction
        self._shear = shear_spine(robot.spine) if robot.spine is not None else ShearSpine(1.0, 1.0, 1.0)

    @property
    def remembers(self) -> bool:
        """Whether what is read depends on how a state was reached."""
        return any(spec.law.path is not None for spec in self.specs.values())

    def without(self, effect: str) -> dict[str, dict[str, Array]]:
        """The values with one effect absent."""
        return {**self.values, effect: {name: np.zeros((1, 1)) for name in self.values[effect]}}

    def read(self, s: States, values: Values, arcs: Array) -> Read:
        """Readings of one variant of states."""
        q = self._quantities(s, values)
        if self.remembers:
            result = self._with_memory(s, values, arcs)
        else:
            result = solved(q.layout, rod_columns(q, self._shear).rows(len(s))).result(arcs)
        return _read(self._after(q, result[None], values))

    def slopes(self, s: States, values: Values, arcs: Array, varied: Varied) -> tuple[Read, Slopes]:
        """Readings, and their derivatives by the inputs that are varied."""
        if self.remembers:
            return self._differences(s, values, arcs, varied)
        q, beside = self._quantities(s, values), self._quantities(varied.states, varied.values)
        built, moved = rod_columns(q, self._shear), rod_columns(beside, self._shear)
        by = np.broadcast_to(varied.by[:, None], (len(varied.by), len(s)))
        changed, change = moved.changes(built, by)
        equilibria = solved(q.layout, built.rows(len(s)))
        result = equilibria.result(arcs)
        here = self._after(q, result[None], values)
        motion = equilibria.motion(arcs, changed, change) * varied.by[:, None, None]
        there = self._after(beside, moved_by(result, motion), varied.values)
        step = varied.by[:, None, None]
        turn = rotation_vector(multiply(there.orientation, here.orientation * CONJUGATE))
        shape = (there.markers - here.markers) / step[..., None]
        return _read(here), Slopes((there.tip - here.tip) / step, turn / step, shape)

    def _quantities(self, s: States, values: Values) -> Quantities:
        q = baseline(self.robot, s.design, s.area_factor[0], self._direction)
        q.pressure, q.spine_length, q.tabulated_length = s.pressure, s.spine_length, s.spine_length
        chambers = len(self.robot.actuators.azimuths_deg)
        q.area_factor = np.broadcast_to(s.area_factor[..., None], (*s.area_factor.shape, chambers))
        for law, own in self._laws(values):
            if law.before is not None:
                law.before(q, own)
        return q

    def _laws(self, values: Values) -> list[tuple[Law, Mapping[str, Array]]]:
        return [(spec.law, values[id]) for id, spec in self.specs.items()]

    def _after(self, q: Quantities, result: Array, values: Values) -> Readings:
        r = readings(q, self._shear, result)
        for law, own in self._laws(values):
            if law.after is not None:
                law.after(r, own)
        return r

    def _with_memory(self, s: States, values: Values, arcs: Array) -> Array:
        """(n, columns): the rods of the states and, behind them, of their rest drive what is remembered."""
        n = len(s)
        both = self._quantities(with_rest(s), values)
        columns = rod_columns(both, self._shear)
        rows = columns.rows(2 * n)
        layout = both.layout
        bare = solver.solve(layout, rows, np.zeros(0), solver.integration_steps(layout, rows))
        lengths = [np.broadcast_to(columns.length(part), (1, 2 * n)) for part in (at.INNER, at.OUTER)]
        driven = drive(lengths, bare.result[None], np.arange(2 * n), 2 * n)
        history = history_of(both, _path(s), columns, driven)
        for law, own in self._laws(values):
            if law.path is not None:
                law.path(history, own)
        final = rows[:n].copy()
        final[:, rest_columns(layout)] += by_element(layout, history.rest[0, :n])
        start = bare.take(slice(0, n))
        return solver.solve(layout, final, arcs, start.steps, start, inside=False).result

    def _differences(self, s: States, values: Values, arcs: Array, varied: Varied) -> tuple[Read, Slopes]:
        here = self.read(s, values, arcs)
        tips, turns, shapes = [], [], []
        for k, by in enumerate(varied.by.tolist()):
            there = self.read(_variant(varied.states, k), _variant_of(varied.values, k), arcs)
            tips.append((there.tip - here.tip) / by)
            turns.append(rotation_vector(multiply(there.orientation, here.orientation * CONJUGATE)) / by)
            shapes.append((there.shape - here.shape) / by)
        return here, Slopes(np.array(tips), np.array(turns), np.array(shapes))


def _read(r: Readings) -> Read:
    return Read(r.tip[0], r.orientation[0], r.markers[0])


def _variant(s: States, k: int) -> States:
    def own(a: Array) -> Array:
        return a[k : k + 1] if len(a) > 1 else a

    return replace(s, pressure=own(s.pressure), spine_length=own(s.spine_length), area_factor=own(s.area_factor))


def _variant_of(values: Values, k: int) -> Values:
    return {id: {n: v[k : k + 1] if len(v) > 1 else v for n, v in own.items()} for id, own in values.items()}


def _path(s: States) -> Path:
    """Each state from its rest, which stands behind all states, by one ramp and a hold."""
    n = len(s)
    rows = np.arange(n)
    ramp = np.abs(s.design.pressure).max(axis=1) / s.design.rate
    return Path(rows + n, rows, np.ones(n, bool), np.full(n, np.inf), ramp, np.maximum(s.design.hold, 0.0))
