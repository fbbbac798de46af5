"""The forward model of a whole campaign: parameters in, all readings and their derivatives out."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from model.effects import layout as at
from model.effects.catalogue import CATALOGUE
from model.effects.compose import RodColumns, directions, rod_columns
from model.effects.design import Columns, Design, with_rest
from model.effects.history import DRIVES, by_element, drive, history_of, loading_path, rest_columns
from model.effects.nominal import beyond, fixed_laws, nominal_values, obstacle_direction
from model.effects.observation import Noise, measured, observations
from model.effects.parameters import ParameterInfo, Spread, parameter_table
from model.effects.quantities import Quantities, baseline
from model.effects.readings import Readings, readings
from model.effects.solver import Solved, differentiate, integration_steps, look_inside, nudged, solve
from model.effects.spec import EffectSpec, Law, Values
from model.effects.spine import ShearSpine, shear_spine
from model.effects.tolerance import sources
from model.errors import BadCondition
from model.robot import Robot

Array = NDArray[np.float64]

NUDGE = 1e-5
"""By which assembly and history are differenced, in prior widths, and readings, in m and rad."""
ROUNDING = 1e-9
"""By which a bound may be missed, in prior widths: where robot.yaml has an effect, bounds are counted from it."""
KEPT = 3
"""Latest points that are kept: a search predicts where it then linearises."""


@dataclass(frozen=True)
class _At:
    """Everything solved at one set of parameter values."""

    theta: Array
    quantities: Quantities
    built: RodColumns
    """Rods of all states without memory."""
    bare: Solved
    """The same solved, rest states included."""
    driven: Array
    """(1, full, DRIVES) what drives memory."""
    rest: Array
    """(1, full, DRIVES) what memory adds."""
    final: Solved
    """With memory, without the rest states."""
    remembers: bool
    predicted: Array
    """(1, observations)."""
    settled: bool
    """Whether every state without a result has no equilibrium, and was not given up."""
    asked: frozenset[int]
    """Sources whose laws are applied though all their sizes are zero."""


@dataclass(frozen=True)
class _Beside:
    """Variants close to a point, one for each of some slots; all before the rod."""

    slots: tuple[int, ...]
    spread: Spread
    by_row: Array
    """(v, full) their steps, in the parameters' units; 1 where a row has no such parameter."""
    quantities: Quantities
    built: RodColumns
    columns: list[int]
    """The a columns of the rods that change."""
    change: Array
    """(full, v, a) by how much, per unit of the parameter."""
    moves: bool
    """Whether any of them enters before the rod."""
    remembers: bool
    """Whether any of them adds memory of its own."""
    reads: bool
    """Whether any of them changes what is read of the same rods."""


class ForwardModel:
    """Readings of a campaign as a function of all parameters; see the package's docstring for how to use it.

    `parameters` is the ordered table; a parameter vector holds their values in their units, and the zero vector is the
    baseline: the robot as its robot.yaml describes it, the effects that stand there included. A parameter of such an effect
    is what is added to the value stated. States without equilibrium give NaN.
    """

    def __init__(
        self,
        robot: Robot,
        design: Design,
        area: Literal["one", "per_length"] = "one",
        catalogue: Mapping[str, EffectSpec] = CATALOGUE,
        area_factor: float | None = None,
        plane_direction: Array | None = None,
        every_law: bool = False,
    ) -> None:
        """`every_law`: laws are applied also where all their sizes are zero, to see that they do nothing there.

        `area_factor` is what area = 0 means: by default the robot's, its mean over the states with area "one".

        `plane_direction` (2,) is the way sideways to the plane that may be touched: by default the robot's, or where the
        campaign bends to. Raises `BadRobot` for an effect in robot.yaml that neither the project nor `catalogue` knows.
        """
        if area not in ("one", "per_length"):
            raise BadCondition(f"area {area!r}: must be 'one' or 'per_length'")
        self.robot, self.design, self.area, self.catalogue = robot, design, area, catalogue
        self._every_law = every_law
        self._full, self._rest_of = with_rest(design)
        self._moved_rows = np.flatnonzero(~design.stiffness)
        self._in_bare = np.flatnonzero(~self._full.stiffness)
        self._path = loading_path(design, self._rest_of)
        self._table = parameter_table(
            self._full, sources(design, tuple(catalogue.values()), area, robot.uncertainty.stated)
        )
        self._fixed = fixed_laws(robot, catalogue)
        rank = {id: k for k, id in enumerate({**CATALOGUE, **catalogue})}
        places: dict[int | str, int] = {id: rank.get(id, len(rank)) for id in self._fixed}
        places |= {i: rank.get(s.spec.id, len(rank)) for i, s in enumerate(self._table.sources)}
        # the sort is stable: tolerances stay behind effects, in their own order
        self._order = sorted(places, key=places.__getitem__)
        self._nominal = nominal_values(robot, self._table.infos)
        self.parameters: tuple[ParameterInfo, ...] = beyond(robot, self._table.infos, self._nominal)
        self._shear = shear_spine(robot.spine) if robot.spine is not None else ShearSpine(1.0, 1.0, 1.0)
        factor = robot.area_factor_at(self._full.spine_length)
        if area_factor is not None:
            factor = np.full(len(self._full), area_factor)
        elif area == "one" and self._moved_rows.size:
            factor = np.full(len(self._full), factor[self._moved_rows].mean())
        self.area_factor = factor[: len(design)]
        """(n,) A_effect / A_norm of each state at zero parameters."""
        self._arcs = np.array(robot.markers[: design.markers])
        self._baseline = baseline(robot, self._full, factor, np.array([1.0, 0.0]))
        self._sd = np.array([p.sd for p in self.parameters])
        low, high = np.array([[p.low, p.high] for p in self._table.infos]).T
        self._low, self._high = low, high
        self._memory_sizes = {
            k
            for k, p in enumerate(self._table.infos)
            if p.role == "size" and self._table.source_of(p.slot).spec.law.path is not None
        }
        self._start: Solved | None = None
        self._remembering: Solved | None = None
        self._points: tuple[_At, ...] = ()
        if plane_direction is None:
            plane_direction = obstacle_direction(robot)
        self._layout = self._baseline.layout
        self._rest_columns = rest_columns(self._layout)
        nominal = self._rows(rod_columns(self._baseline, self._shear))
        self._steps = integration_steps(self._layout, nominal)
        first = solve(self._layout, nominal, self._arcs, self._steps, inside=False)
        self._start = first
        tips = first.result[: self._moved_rows.size]
        side = (
            tips[first.converged[: self._moved_rows.size], :2].sum(axis=0)
            if plane_direction is None
            else plane_direction
        )
        if np.linalg.norm(side) > 1e-6:
            self._baseline.plane_direction = side / np.linalg.norm(side)
        reference = self._every_row(tips[None])[0, :, at.ORIENTATION : at.ORIENTATION + 4]
        self.observations = observations(design, np.where(np.isfinite(reference), reference, [1.0, 0.0, 0.0, 0.0]))
        self.labels: tuple[tuple[int, str], ...] = tuple(
            zip(self.observations.row.tolist(), self.observations.channel.tolist(), strict=True)
        )
        """(row of the design, channel) of each observation."""

    def __getstate__(self) -> dict[str, Any]:
        """Without the points that it has kept."""
        return vars(self) | {"_points": ()}

    @property
    def plane_direction(self) -> Array:
        """(2,) unit vector sideways to the plane that may be touched."""
        return self._baseline.plane_direction

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

    def predict(self, theta: Array, trial: bool = False) -> Array:
        """(observations,) at parameters (p,); NaN where a state has no equilibrium.

        In a `trial` also where its load would have to be followed to find it, at a thousand times the cost.
        """
        return self._solved(self._checked(theta), trial=trial).predicted[0].copy()

    def near(self, theta: Array) -> ForwardModel:
        """The same model, whose rods are solved from those at parameters (p,) on: quicker close by, and the same within the
        tolerance of the solver. What this model has kept is not touched by what the other solves."""
        here = self._solved(self._checked(theta))
        if not here.bare.converged.all() or not here.final.converged.all():
            return self
        other = copy.copy(self)
        other._points = (here,)
        other._start, other._remembering = here.bare, here.final if here.remembers else None
        return other

    def shapes(self, theta: Array, arcs: Array) -> Array:
        """Backbones (n, k, 3) m at parameters (p,) and arc lengths (k,) m, base frame, as motion capture would read them.

        An arc length beyond the tip gives the tip. NaN where a state has no equilibrium; rows of stiffness trials are 0.
        """
        here = self._solved(self._checked(theta))
        final = here.final
        along = solve(self._layout, final.rows, np.asarray(arcs, float), final.steps, final, inside=False)
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
        here = self._asked(
            self._solved(theta, bool(self._memory_sizes & set(wanted))),
            frozenset(self._table.source_index(self.parameters[k].slot) for k in wanted),
        )
        slots = tuple(sorted({self.parameters[k].slot for k in wanted}))
        of_row = self._table.of_row[list(slots)][:, self.observations.row]
        place = np.full(len(self.parameters) + 1, len(wanted))
        place[wanted] = np.arange(len(wanted))
        # Each row takes one parameter for a slot; what is not wanted, or does not exist (-1), goes to a last column.
        jacobian = np.zeros((len(self), len(wanted) + 1))
        jacobian[np.arange(len(self)), place[of_row]] = self._slopes(here, slots)
        return here.predicted[0].copy(), jacobian[:, :-1]

    def respond(self, change: Array) -> Array:
        """(observations,) by how much the baseline's readings change with its pressures (n, chambers), Pa; what the robot
        remembers stays."""
        spread = self._table.at(self._nominal)
        q = self._quantities(spread, np.pad(change, ((0, len(self._full) - len(change)), (0, 0))))
        built = self._rows(rod_columns(q, self._shear))
        own = slice(0, self._moved_rows.size)
        moved = solve(self._layout, built, self._arcs, self._steps, self._start, inside=False).take(own)
        here = self._solved(self._nominal)
        still = self._read(here.quantities, here.bare.take(own).result[None], spread)
        return np.asarray(self._read(q, moved.result[None], spread)[0] - still[0])

    def _checked(self, theta: Array) -> Array:
        """Values of the laws' parameters from what is added to those of robot.yaml."""
        values = np.asarray(theta, float)
        if values.shape != (len(self.parameters),):
            raise BadCondition(f"theta: shape {values.shape}, must be ({len(self.parameters)},)")
        values = values + self._nominal
        slack = ROUNDING * self._sd
        wrong = ~((values >= self._low - slack) & (values <= self._high + slack))
        if wrong.any():
            info = self.parameters[int(np.flatnonzero(wrong)[0])]
            raise BadCondition(
                f"{info.name} = {theta[wrong][0]:g} {info.unit}: must be within {info.low:g} and {info.high:g}"
            )
        return np.clip(values, self._low, self._high)

    def _laws(self, spread: Spread, asked: frozenset[int] = frozenset()) -> Iterator[tuple[Law, Callable[[], Values]]]:
        """Every law and what makes its values, in the order of the catalogue, the robot's own that are not varied among them;
        those of size zero that are `asked` alone."""
        working = self._table.working(spread) | asked
        for known in self._order:
            if isinstance(known, str):
                law, values = self._fixed[known]
                yield law, partial(dict, values)
            elif self._every_law or known in working:
                yield self._table.sources[known].spec.law, partial(self._table.values, known, spread)

    def _quantities(self, spread: Spread, more: Array | None = None, asked: frozenset[int] = frozenset()) -> Quantities:
        """All laws before the rod; `more` (full, chambers) Pa is what is read beyond the table."""
        q = copy.copy(self._baseline)
        if more is not None:
            q.pressure = q.pressure + more
        for law, values in self._laws(spread, asked):
            if law.before is not None:
                law.before(q, values())
        return q

    def _solved(self, theta: Array, moving: bool = False, trial: bool = False) -> _At:
        """`moving`: what drives memory is wanted even where nothing remembers. `trial`: see `predict`."""
        points = self._points  # another thread may put others in its place
        same = [bool(np.array_equal(p.theta, theta)) and (trial or p.settled) for p in points]
        here = points[same.index(True)] if any(same) else self._solve(theta, trial)
        if moving and not here.bare.inside:
            bare = look_inside(here.bare)
            here = replace(here, bare=bare, driven=self._drive(here.built, bare.result[None]))
        self._keep(here)
        return here

    def _keep(self, here: _At) -> None:
        others = [p for p in self._points if not np.array_equal(p.theta, here.theta)]
        self._points = (here, *others)[:KEPT]

    def _asked(self, here: _At, sources: frozenset[int]) -> _At:
        """The same point with laws by which it is to be differentiated: one of size zero does nothing, but says where and how it
        would act."""
        spread = self._table.at(here.theta)
        asked = here.asked | (sources - self._table.working(spread))
        if asked == here.asked:
            return here
        q = self._quantities(spread, asked=asked)
        built = rod_columns(q, self._shear)
        bare = replace(here.bare, rows=self._rows(built))
        rows = bare.rows[: self._moved_rows.size].copy()
        if here.remembers:
            rows[:, self._rest_columns] += by_element(self._layout, here.rest[0, self._moved_rows])
        here = replace(here, quantities=q, built=built, bare=bare, final=replace(here.final, rows=rows), asked=asked)
        self._keep(here)
        return here

    def _solve(self, theta: Array, trial: bool) -> _At:
        spread = self._table.at(theta)
        q = self._quantities(spread)
        built = rod_columns(q, self._shear)
        remembers = any(theta[k] for k in self._memory_sizes) or any(
            law.path is not None for law, _ in self._fixed.values()
        )
        bare = solve(self._layout, self._rows(built), self._arcs, self._steps, self._start, remembers, trial)
        final = bare.take(slice(0, self._moved_rows.size))
        driven = rest = np.zeros((1, len(self._full), DRIVES))
        if remembers:
            driven = self._drive(built, bare.result[None])
            rest = self._memory(q, built, driven, spread)
            rows = final.rows.copy()
            rows[:, self._rest_columns] += by_element(self._layout, rest[0, self._moved_rows])
            begin = self._remembering or final
            final = solve(self._layout, rows, self._arcs, final.steps, begin, False, trial)
            # What drives memory is the rod without it: where that has no equilibrium, nothing can be said of the state.
            final.result[~bare.converged[: len(final.rows)]] = np.nan
        predicted = self._read(q, final.result[None], spread)
        settled = not trial or bool(bare.converged.all() and final.converged.all())
        return _At(theta.copy(), q, built, bare, driven, rest, final, remembers, predicted, settled, frozenset())

    def _rows(self, built: RodColumns) -> Array:
        """(m, layout.width) rods of one variant that are solved."""
        return built.rows(len(self._full))[self._in_bare]

    def _drive(self, built: RodColumns, results: Array) -> Array:
        """(v, full, DRIVES) from results (v, m, columns)."""
        n = len(self._full)
        own = (built.length(part) for part in (at.INNER, at.OUTER))
        lengths = [np.broadcast_to(long, (len(long), n)) for long in own]
        return drive([long[:, self._in_bare] for long in lengths], results, self._in_bare, n)

    def _memory(
        self, q: Quantities, built: RodColumns, driven: Array, spread: Spread, asked: frozenset[int] = frozenset()
    ) -> Array:
        """(v, full, DRIVES) rest curvature and strain of all laws with memory."""
        history = history_of(q, self._path, built, driven)
        for law, values in self._laws(spread, asked):
            if law.path is not None:
                law.path(history, values())
        return history.rest

    def _slopes(self, here: _At, slots: tuple[int, ...]) -> Array:
        """(slots, observations) derivatives in the parameters' units, by the chain rule.

        Rods by parameters and readings by equilibria are differenced, equilibria by rods are not. Slots that enter at the same
        stage are varied together: what none of them changes is computed once.
        """
        step = NUDGE * self._sd * np.where(here.theta + NUDGE * self._sd <= self._high, 1.0, -1.0)
        batches = [self._beside(here, step, part) for part in self._by_stage(slots)]
        out = np.empty((len(slots), len(self)))
        for b, moved in zip(batches, self._moved(here, batches), strict=True):
            slope = self.observations.pick(moved)
            if b.reads:
                read = self._read(b.quantities, here.final.result[None], b.spread, here.asked)
                slope = slope + (read - here.predicted) / b.by_row[:, self.observations.row]
            out[[slots.index(k) for k in b.slots]] = slope
        return out

    def _by_stage(self, slots: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Slots that enter at the same stage; those that change readings alone by themselves."""
        found: dict[tuple[bool, str], list[int]] = {}
        for k in slots:
            spec = self._table.source_of(k).spec
            found.setdefault((_moves(spec), spec.stage), []).append(k)
        return [tuple(own) for own in found.values()]

    def _beside(self, here: _At, step: Array, slots: tuple[int, ...]) -> _Beside:
        """Variants of `here`, one for each slot, that is a step away."""
        spread = self._table.beside(here.theta, here.theta + step, slots)
        by_row = self._by_slot(step)[list(slots)]
        laws = [self._table.source_of(k).spec.law for k in slots]
        q, built = here.quantities, here.built
        moves = any(law.before is not None for law in laws)
        if moves:
            q = self._quantities(spread, asked=here.asked)
            built = rod_columns(q, self._shear)
        changed, change = built.changes(here.built, by_row)
        remembers = any(law.path is not None for law in laws)
        reads = bool(self.design.stiffness.any()) or any(law.after is not None for law in laws)
        return _Beside(slots, spread, by_row, q, built, changed, change, moves, remembers, reads)

    def _moved(self, here: _At, batches: Sequence[_Beside]) -> list[Array]:
        """(v, full, channels) of each batch: derivatives of readings by what the slots do to rods, in the parameters' units."""
        rests = self._rests(here, batches)
        changed = sorted(
            {c for b in batches for c in b.columns} | {c for r in rests if r is not None for c in self._rest_columns}
        )
        by_column = np.zeros((len(self._full), len(changed), self.observations.channels))
        if changed:
            spread = self._table.at(here.theta)

            def every(results: Array) -> Array:
                return self.observations.every(self._readings(here.quantities, results, spread, here.asked))[
                    :, self._moved_rows
                ]

            by_column[self._moved_rows] = _by_columns(here.final, changed, every)
        out = []
        for b, rest in zip(batches, rests, strict=True):
            moved = b.change @ by_column[:, [changed.index(c) for c in b.columns]]
            if rest is not None:
                remembered = by_column[:, [changed.index(c) for c in self._rest_columns]]
                moved = moved + by_element(self._layout, rest) @ remembered
            out.append(moved.swapaxes(0, 1))
        return out

    def _rests(self, here: _At, batches: Sequence[_Beside]) -> list[Array | None]:
        """(full, v, DRIVES) of each batch: derivatives of what memory adds, in the parameters' units; None where it stays."""
        changed = sorted({c for b in batches for c in b.columns})
        by_column = np.zeros((len(self._full), len(changed), DRIVES))
        if here.remembers and changed:

            def driven_by(results: Array) -> Array:
                return self._drive(here.built, results)[:, self._in_bare]

            by_column[self._in_bare] = np.nan_to_num(_by_columns(here.bare, changed, driven_by))
        out: list[Array | None] = []
        for b in batches:
            driven = here.driven
            if here.remembers and b.columns:
                moved = b.change @ by_column[:, [changed.index(c) for c in b.columns]]
                driven = self._drive(b.built, here.bare.result[None]) + b.by_row[..., None] * moved.swapaxes(0, 1)
            elif not b.remembers and not (here.remembers and b.moves):
                out.append(None)
                continue
            rest = self._memory(b.quantities, b.built, driven, b.spread, here.asked)
            out.append(((rest - here.rest) / b.by_row[..., None]).swapaxes(0, 1))
        return out

    def _by_slot(self, per_parameter: Array) -> Array:
        """(slots, full) the value of the parameter that each row takes for a slot; 1 where it takes none."""
        return np.append(per_parameter, 1.0)[self._table.of_row]

    def _read(self, q: Quantities, results: Array, spread: Spread, asked: frozenset[int] = frozenset()) -> Array:
        """(v, observations) from results (v, moved, columns) of the solver."""
        return self.observations.of(self._readings(q, results, spread, asked))

    def _readings(self, q: Quantities, results: Array, spread: Spread, asked: frozenset[int] = frozenset()) -> Readings:
        """What instruments read of results (v, moved, columns): all laws after the rod."""
        r = readings(q, self._shear, self._every_row(results))
        for law, values in self._laws(spread, asked):
            if law.after is not None:
                law.after(r, values())
        return r

    def _every_row(self, results: Array) -> Array:
        """(v, full, columns): results of the moved rows in their places, an unbent rod elsewhere."""
        out = np.zeros((len(results), len(self._full), results.shape[2]))
        out[:, :, at.ORIENTATION] = 1.0
        out[:, self._moved_rows] = results
        return out


def _moves(spec: EffectSpec) -> bool:
    """Whether a source changes the rod, not its readings alone."""
    return spec.law.before is not None or spec.law.path is not None


def _by_columns(solved: Solved, changed: Sequence[int], made_of: Callable[[Array], Array]) -> Array:
    """(n, a, outputs) derivatives by `changed` columns (a) of the rods of what is made of results (v, n, columns)."""
    made = made_of(nudged(solved, NUDGE))
    by_motion = ((made[1:] - made[0]) / NUDGE).swapaxes(0, 1)
    return np.asarray(differentiate(solved, directions(solved.layout, changed)) @ by_motion)
