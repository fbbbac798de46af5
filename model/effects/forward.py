"""The forward model of a whole campaign: parameters in, all readings and their derivatives out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from model.effects import layout as at
from model.effects.catalogue import CATALOGUE
from model.effects.compose import INNER, OUTER, rows, silicone_share
from model.effects.design import Columns, Design, with_rest
from model.effects.history import DRIVES, History, add_rest, drive, loading_path
from model.effects.observation import Noise, measured, observations
from model.effects.parameters import ParameterInfo, Spread, parameter_table
from model.effects.quantities import Quantities, baseline
from model.effects.readings import Readings, readings
from model.effects.solver import Solved, differentiate, integration_steps, solve
from model.effects.spec import EffectSpec
from model.effects.spine import ShearSpine, shear_spine
from model.effects.tolerance import sources
from model.errors import BadCondition
from model.robot import Robot
from model.rods import Solution

Array = NDArray[np.float64]

NUDGE = 1e-5
"""Prior widths by which assembly, history and readings are differenced."""


@dataclass(frozen=True)
class _At:
    """Everything solved at one set of parameter values."""

    theta: Array
    quantities: Quantities
    built: Array
    """(1, full, WIDTH) rods without memory."""
    bare: Solved
    """The same solved, rest states included."""
    driven: Array
    """(1, full, DRIVES) what drives memory."""
    rest: Array
    """(1, full, DRIVES) what memory adds."""
    final: Solved
    """With memory, without the rest states."""
    remembers: bool


class ForwardModel:
    """Readings of a campaign as a function of all parameters; see the package's docstring for how to use it.

    `parameters` is the ordered table; a parameter vector holds their values in their units, and the zero vector is the
    baseline. States without equilibrium give NaN.
    """

    def __init__(
        self,
        robot: Robot,
        design: Design,
        area: Literal["one", "per_length"] = "one",
        catalogue: Mapping[str, EffectSpec] = CATALOGUE,
        area_factor: float | None = None,
        plane_direction: Array | None = None,
    ) -> None:
        """`area_factor` is what area = 0 means: by default the robot's, its mean over the states with area "one".

        `plane_direction` (2,) is the way sideways to the plane that may be touched: by default where the campaign bends to.
        """
        if area not in ("one", "per_length"):
            raise BadCondition(f"area {area!r}: must be 'one' or 'per_length'")
        self.robot, self.design, self.area, self.catalogue = robot, design, area, catalogue
        self._full, self._rest_of = with_rest(design)
        self._moved = np.flatnonzero(~design.stiffness)
        self._in_bare = np.flatnonzero(~self._full.stiffness)
        self._path = loading_path(design, self._rest_of)
        self._table = parameter_table(self._full, sources(design, tuple(catalogue.values()), area))
        self.parameters: tuple[ParameterInfo, ...] = self._table.infos
        self._shear = shear_spine(robot.spine) if robot.spine is not None else ShearSpine(1.0, 1.0, 1.0)
        factor = robot.area_factor_at(self._full.spine_length)
        if area_factor is not None:
            factor = np.full(len(self._full), area_factor)
        elif area == "one" and self._moved.size:
            factor = np.full(len(self._full), factor[self._moved].mean())
        self.area_factor = factor[: len(design)]
        """(n,) A_effect / A_norm of each state at zero parameters."""
        self._arcs = np.array(robot.markers[: design.markers])
        self._baseline = baseline(robot, self._full, factor, np.array([1.0, 0.0]))
        self._sd = np.array([p.sd for p in self.parameters])
        low, high = np.array([[p.low, p.high] for p in self.parameters]).T
        self._low, self._high = low, high
        self._memory_sizes = {
            k
            for k, p in enumerate(self.parameters)
            if p.role == "size" and self._table.source_of(p.slot).spec.law.path is not None
        }
        self._start: Solution | None = None
        nominal = rows(self._baseline, self._shear, 1)[0, self._in_bare]
        self._steps = integration_steps(nominal)
        first = self._solved(np.zeros(len(self.parameters)))
        self._start = first.bare.solution
        side = first.final.result[first.final.converged, :2].sum(axis=0) if plane_direction is None else plane_direction
        if np.linalg.norm(side) > 1e-6:
            self._baseline.plane_direction = side / np.linalg.norm(side)
        reference = self._every_row(first.final.result[None])[0, :, at.ORIENTATION : at.ORIENTATION + 4]
        self.observations = observations(design, np.where(np.isfinite(reference), reference, [1.0, 0.0, 0.0, 0.0]))
        self.labels: tuple[tuple[int, str], ...] = tuple(
            zip(self.observations.row.tolist(), self.observations.channel.tolist(), strict=True)
        )
        """(row of the design, channel) of each observation."""

    def __len__(self) -> int:
        return len(self.observations)

    def on(self, design: Design) -> ForwardModel:
        """The same model for other states: the catalogue, what area = 0 means and the plane that may be touched stay."""
        factor = float(self.area_factor[0]) if self.area == "one" else None
        return ForwardModel(self.robot, design, self.area, self.catalogue, factor, self._baseline.plane_direction)

    def index(self, source: str) -> list[int]:
        """Indices of the parameters of an effect, tolerance or calibration by its id."""
        found = self._table.of_effect(source)
        if not found:
            known = sorted({p.source for p in self.parameters})
            raise BadCondition(f"parameter source {source!r}: not in this model, which has {', '.join(known)}")
        return found

    def predict(self, theta: Array) -> Array:
        """(observations,) at parameters (p,); NaN where a state has no equilibrium."""
        return self._prediction(self._solved(self._checked(theta)))[0]

    def shapes(self, theta: Array, arcs: Array) -> Array:
        """Backbones (n, k, 3) m at parameters (p,) and arc lengths (k,) m, base frame, as motion capture would read them.

        An arc length beyond the tip gives the tip. NaN where a state has no equilibrium; rows of stiffness trials are 0.
        """
        here = self._solved(self._checked(theta))
        final = here.final
        along = solve(final.rows, np.asarray(arcs, float), final.steps, final.solution, inside=False)
        read = self._readings(here.quantities, along.result[None], self._table.at(here.theta))
        return read.markers[0, : len(self.design)]

    def observe(self, columns: Columns, noise: Noise = Noise()) -> tuple[Array, Array]:  # noqa: B008 (frozen)
        """Measured values and standard deviations of a table with the design's rows, in the order of `labels`.

        A cell that was not measured has value 0 and standard deviation inf.
        """
        return measured(self.observations, columns, noise)

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Prediction (observations,) and its derivative (observations, p) by the parameters, in their units.

        With `columns`, indices of parameters, the derivative has these columns alone, and costs as much less. At an
        upper bound the derivative is the one towards the inside.
        """
        theta = self._checked(theta)
        wanted = list(range(len(self.parameters))) if columns is None else list(columns)
        here = self._solved(theta, bool(self._memory_sizes & set(wanted)))
        predicted = self._prediction(here)
        slots = tuple(sorted({self.parameters[k].slot for k in wanted}))
        by_slot = self._slopes(here, predicted, slots)
        jacobian = np.zeros((len(self), len(wanted)))
        for column, k in enumerate(wanted):
            slot = self.parameters[k].slot
            own = self._table.of_row[slot][self.observations.row] == k
            jacobian[own, column] = by_slot[slots.index(slot), own]
        return predicted[0], jacobian

    def respond(self, change: Array) -> Array:
        """(observations,) by how much the baseline's readings change with its pressures (n, chambers), Pa."""
        baseline = np.zeros(len(self.parameters))
        spread = self._table.at(baseline)
        q = self._quantities(spread)
        q.pressure = q.pressure + np.pad(change, ((0, len(self._full) - len(change)), (0, 0)))
        built = rows(q, self._shear, 1)[0, self._in_bare]
        moved = solve(built, self._arcs, self._steps, self._start, inside=False).take(slice(0, self._moved.size))
        return np.asarray(self._read(q, moved.result[None], spread)[0] - self.predict(baseline))

    def _checked(self, theta: Array) -> Array:
        values = np.asarray(theta, float)
        if values.shape != (len(self.parameters),):
            raise BadCondition(f"theta: shape {values.shape}, must be ({len(self.parameters)},)")
        wrong = ~((values >= self._low) & (values <= self._high))
        if wrong.any():
            info = self.parameters[int(np.flatnonzero(wrong)[0])]
            raise BadCondition(
                f"{info.name} = {values[wrong][0]:g} {info.unit}: must be within {info.low:g} and {info.high:g}"
            )
        return values

    def _quantities(self, spread: Spread) -> Quantities:
        """All laws before the rod."""
        q = Quantities(**vars(self._baseline))
        for i, source in enumerate(self._table.sources):
            if source.spec.law.before is not None:
                source.spec.law.before(q, self._table.values(i, spread))
        return q

    def _solved(self, theta: Array, moving: bool = False) -> _At:
        """`moving`: what drives memory is wanted even where nothing remembers."""
        spread = self._table.at(theta)
        q = self._quantities(spread)
        built = rows(q, self._shear, 1)
        remembers = any(theta[k] for k in self._memory_sizes)
        bare = solve(built[0, self._in_bare], self._arcs, self._steps, self._start, remembers or moving)
        driven = self._drive(built, bare.result[None]) if bare.inside else np.zeros((1, len(self._full), DRIVES))
        rest = self._memory(q, built, driven, spread)
        final = bare.take(slice(0, self._moved.size))
        if remembers:
            changed = final.rows.copy()
            add_rest(changed[None], rest[:, self._moved])
            final = solve(changed, self._arcs, final.steps, final.solution, inside=False)
        return _At(theta, q, built, bare, driven, rest, final, remembers)

    def _prediction(self, here: _At) -> Array:
        """(1, observations)."""
        return self._read(here.quantities, here.final.result[None], self._table.at(here.theta))

    def _drive(self, built: Array, results: Array) -> Array:
        return drive(built[:, self._in_bare], results, self._in_bare, len(self._full))

    def _memory(self, q: Quantities, built: Array, driven: Array, spread: Spread) -> Array:
        """(v, full, DRIVES) rest curvature and strain of all laws with memory."""
        silicone, whole = silicone_share(q, built[..., INNER + at.BEND]), np.ones((*built.shape[:2], 4))
        history = History(
            q, self._path, driven,
            np.stack([built[..., INNER + at.BEND], built[..., OUTER + at.BEND]], axis=-1),
            np.stack([built[..., INNER + at.STRETCH + 2], built[..., OUTER + at.STRETCH + 2]], axis=-1),
            np.concatenate([np.repeat(np.broadcast_to(silicone, built.shape[:2])[..., None], 4, axis=2), whole], axis=2),
            np.zeros((1, len(self._full), DRIVES)),
        )  # fmt: skip
        for i, source in enumerate(self._table.sources):
            if source.spec.law.path is not None:
                source.spec.law.path(history, self._table.values(i, spread))
        return history.rest

    def _slopes(self, here: _At, predicted: Array, slots: tuple[int, ...]) -> Array:
        """(slots, observations) derivatives in the parameters' units, by differences of all but the equilibria."""
        chosen = list(slots)
        step = NUDGE * self._sd * np.where(here.theta + NUDGE * self._sd <= self._high, 1.0, -1.0)
        spread = self._table.beside(here.theta, here.theta + step, slots)
        q = self._quantities(spread)
        built = rows(q, self._shear, len(slots))
        # Directions are one prior width long, in every row that the slot reaches.
        by_row = self._by_slot(step / self._sd)[chosen, :, None]
        directions = (built - here.built) / by_row
        if here.remembers:
            moved = differentiate(here.bare, directions[:, self._in_bare])
            driven = self._drive(built, here.bare.result + by_row[:, self._in_bare] * moved)
        else:
            driven = here.driven
        rest = self._memory(q, built, driven, spread)
        add_rest(directions, (rest - here.rest) / by_row)
        moved = differentiate(here.final, directions[:, self._moved])
        read = self._read(q, here.final.result + by_row[:, self._moved] * moved, spread)
        return (read - predicted) / self._by_slot(step)[chosen][:, self.observations.row]

    def _by_slot(self, per_parameter: Array) -> Array:
        """(slots, full) the value of the parameter that each row takes for a slot; 1 where it takes none."""
        return np.append(per_parameter, 1.0)[self._table.of_row]

    def _read(self, q: Quantities, results: Array, spread: Spread) -> Array:
        """(v, observations) from results (v, moved, columns) of the solver."""
        return self.observations.of(self._readings(q, results, spread))

    def _readings(self, q: Quantities, results: Array, spread: Spread) -> Readings:
        """What instruments read of results (v, moved, columns): all laws after the rod."""
        r = readings(q, self._shear, self._every_row(results))
        for i, source in enumerate(self._table.sources):
            if source.spec.law.after is not None:
                source.spec.law.after(r, self._table.values(i, spread))
        return r

    def _every_row(self, results: Array) -> Array:
        """(v, full, columns): results of the moved rows in their places, an unbent rod elsewhere."""
        out = np.zeros((len(results), len(self._full), results.shape[2]))
        out[:, :, at.ORIENTATION] = 1.0
        out[:, self._moved] = results
        return out
