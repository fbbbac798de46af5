"""The forward model of a whole campaign: parameters in, all readings and their derivatives out."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array, Ints
from model.body import body_of
from model.condition import States, conditions
from model.effects import layout as at
from model.effects.catalogue import CATALOGUE
from model.effects.compose import RodColumns, directions, rod_columns
from model.effects.design import Columns, with_rest, with_rest_of
from model.effects.history import DRIVES, by_element, drive, history_of, loading_path, ramps, rest_columns
from model.effects.nominal import ROUNDING, beyond, fixed_laws, obstacle_direction, stated_effects
from model.effects.observation import channels, measured, observations
from model.effects.parameters import ParameterInfo, Spread, parameter_table
from model.effects.quantities import Quantities, baseline
from model.effects.readings import Readings, readings
from model.effects.scales import Scales, scales
from model.effects.solver import SolvedRods, differentiate, integration_steps, look_inside, nudged, solve
from model.effects.spec import EffectSpec, Values
from model.effects.spine import ShearSpine, shear_spine
from model.effects.tolerance import VariationSource, single_sources, sources
from model.errors import BadCondition, BadRobot, unit_text
from model.robot import Robot
from model.rods import columns as col

NUDGE = 1e-5
"""By which assembly and history are differenced, in prior widths, and readings, in m and rad."""
STEEP = 1e3
"""Robot lengths (rad) by which a plausible size may move a reading; a rod that snaps there would move by more."""
AT_ONCE = 512
"""Rods of which derivatives by all motions are held at once."""
HARD_KEPT = 8
"""Points of which equilibria are kept that were hard to find."""
FEW = 8192
"""Values of varied slots, one a state, up to which calls take longer than what is computed for nothing."""


@dataclass(frozen=True)
class _At:
    """Everything solved at one set of parameter values."""

    theta: Array
    spread: Spread
    """The same at all states; its laws are applied."""
    quantities: Quantities
    built: RodColumns
    """Rods of all states without memory."""
    bare: SolvedRods
    """The same solved, rest states included."""
    driven: Array
    """(1, full, DRIVES) what drives memory."""
    rest: Array
    """(1, full, columns) what memory adds to `rest_columns`."""
    final: SolvedRods
    """With memory, without the rest states."""
    remembers: bool
    readings: Readings
    """Of one variant."""
    settled: bool
    """Whether every state without a result has no equilibrium, and was not given up."""


@dataclass(frozen=True)
class InputChange:
    """v small changes of what is done in n states."""

    pressure: Array
    """(v, n or 1, chambers) Pa."""
    spine_length: Array
    """(v, 1) m."""
    by: Array
    """(v,) what derivatives by them are counted per."""

    def behind(self, more: int) -> InputChange:
        """The same behind `more` that change nothing."""
        return InputChange(*(np.pad(x, [(more, 0)] + [(0, 0)] * (x.ndim - 1)) for x in vars(self).values()))


NO_CHANGE = InputChange(np.zeros((0, 1, 1)), np.zeros((0, 1)), np.zeros(0))


@dataclass(frozen=True)
class _Varied:
    """Variants of a point up to the rows of their rods: one for each of some slots, a step away, and one for each change."""

    spread: Spread
    by_row: Array
    """(v, full) their steps, in the parameters' units; 1 where a row has no such parameter."""
    quantities: Quantities
    built: RodColumns
    """Lengths and stiffnesses of the elements, which memory reads."""
    change: Mapping[int, tuple[Ints, Array]]
    """By column of the rods that changes: the variants that do, and (k, full) by how much, per unit of the parameter."""
    remembers: bool
    """Whether any of them changes what memory adds."""
    reads: bool
    """Whether any of them changes what is read of the same rods."""

    def through(self, by_column: Array, columns: Sequence[int]) -> Array:
        """(v, full, c) derivatives by parameters of what has derivatives `by_column` (a, c, full) by a columns of the rods."""
        out = np.zeros((len(self.by_row), *by_column.shape[1:]))
        for column, (variants, change) in self.change.items():
            slope = by_column[columns.index(column)]
            for variant, of_states in zip(variants, change, strict=True):
                out[variant] += of_states * slope
        return out.swapaxes(1, 2)


class ForwardModel:
    """Readings of a campaign as a function of all parameters; see the package's docstring for how to use it.
    Of states that are each reached from rest (`of_single_states`) there are `read` and `motions` alone.

    `parameters` is the ordered table; a parameter vector holds their values in their units, and the zero vector is the
    baseline: the robot as its robot.yaml describes it, the effects that stand there included. A parameter of such an effect
    is what is added to the value stated. States without equilibrium give NaN.
    """

    def __init__(
        self,
        robot: Robot,
        design: States,
        area: Literal["one", "per_length"] = "one",
        catalogue: Mapping[str, EffectSpec] = CATALOGUE,
        area_factor: float | None = None,
        plane_direction: Array | None = None,
        every_law: bool = False,
        sized: Scales | None = None,
    ) -> None:
        """`every_law`: laws are applied also where all their sizes are zero, to see that they do nothing there.

        `sized`: the scales that sizes of effects are multiples of, by default those of the robot and the design.

        `area_factor` is what area = 0 means: by default the robot's, its mean over the states with area "one".

        `plane_direction` (2,) is the way sideways to the plane that may be touched: by default the robot's, or where the
        campaign bends to. Raises `BadRobot` for an effect in robot.yaml that neither the project nor `catalogue` knows.
        """
        self._steps: Ints | None
        self._start: SolvedRods | None
        self.scales = sized or scales(robot, design.pressure, design.pace)
        full, rest_of = with_rest(design)
        path, rests = loading_path(design, rest_of), np.arange(len(full)) >= len(design)
        order = np.lexsort((full.unread, rests))  # states that were read, those that were not, rests
        place, full, design = np.argsort(order), full[order], design[~design.unread]
        self._path = replace(path, before=place[path.before], after=place[path.after])
        catalogue = {id: spec.of(self.scales) for id, spec in catalogue.items()}
        self._vary(
            robot, full, area, catalogue, sources(design, tuple(catalogue.values()), area, self.scales, robot.uncertainty.stated)
        )
        self._every_law = every_law
        of_robot = ~design.stiffness
        factor = robot.area_factor_at(full.spine_length)
        if area_factor is not None:
            factor = np.full(len(full), area_factor)
        elif area == "one" and of_robot.any():
            factor = np.full(len(full), factor[: len(design)][of_robot].mean())
        self._place(design, full, factor, robot.marker_places(full.roll)[:, : design.markers])
        if plane_direction is None:
            plane_direction = obstacle_direction(robot)
        nominal = self._rows(rod_columns(self._quantities(self._table.at(self._nominal)), self._shear))
        self._steps = integration_steps(self._layout, nominal)
        self._start = solved = solve(self._layout, nominal, self._markers, self._steps, inside=False)
        tips = solved.result[: self._moved_rows.size]
        side = tips[solved.converged[: self._moved_rows.size], :2].sum(axis=0) if plane_direction is None else plane_direction
        if np.linalg.norm(side) > 1e-6:
            self.face(side / np.linalg.norm(side))
        reference = self._every_row(tips[None])[0, :, at.ORIENTATION : at.ORIENTATION + 4]
        self.observations = observations(design, np.where(np.isfinite(reference), reference, [1.0, 0.0, 0.0, 0.0]))

    @classmethod
    def of_single_states(cls, robot: Robot, catalogue: Mapping[str, EffectSpec] = CATALOGUE) -> ForwardModel:
        """The model of states that are each reached from rest by one ramp, with the effects of robot.yaml; `at` gives it states.

        A parameter of each trial is then one for all. Raises `BadRobot` for what robot.yaml states wrongly.
        """
        model = cls.__new__(cls)
        model.scales = scales(robot)
        effects = {id: spec.of(model.scales) for id, spec in stated_effects(robot, catalogue).items()}
        one_state = conditions(robot, 0.0, np.zeros(len(robot.actuators.azimuths_deg)))
        model._vary(robot, one_state, "per_length", effects, single_sources(robot, tuple(effects.values())))
        if "contact" in effects and obstacle_direction(robot) is None:
            raise BadRobot(
                f"robot {robot.name!r}: effects.contact needs obstacle_azimuth_deg, the direction in which the obstacle stands"
            )
        return model

    def at(self, design: States, arcs: Array | None = None) -> ForwardModel:
        """The model `of_single_states` for these, with the robot's markers, or points of its axis at arc lengths (k,) m."""
        other = copy.copy(self)
        full = design
        if any(spec.law.path is not None for spec in self.catalogue.values()):
            full, other._path = with_rest_of(design, np.arange(len(design))), ramps(design)
        points = self.robot.marker_places(full.roll) if arcs is None else _on_axis(len(full), arcs)
        other._place(design, full, self.robot.area_factor_at(full.spine_length), points)
        return other

    def _vary(
        self,
        robot: Robot,
        full: States,
        area: Literal["one", "per_length"],
        catalogue: Mapping[str, EffectSpec],
        varied: tuple[VariationSource, ...],
    ) -> None:
        """Lay out the parameters of `varied`, and their laws and those of the robot's own effects in the catalogue's order."""
        self.robot, self.area, self.catalogue, self._every_law = robot, area, catalogue, False
        self._steps, self._start = None, None
        self._table = parameter_table(full, varied, robot)
        self._fixed = fixed_laws(robot, catalogue)
        rank = {id: k for k, id in enumerate({**CATALOGUE, **catalogue})}
        rank_of: dict[int | str, int] = {id: rank.get(id, len(rank)) for id in self._fixed}
        rank_of |= {i: rank.get(s.spec.id, len(rank)) for i, s in enumerate(self._table.sources)}
        # the sort is stable: tolerances stay behind effects, in their own order
        order = sorted(rank_of, key=rank_of.__getitem__)
        laws = [(k, self._fixed[k][0] if isinstance(k, str) else self._table.sources[k].spec.law) for k in order]
        self._laws_of = {
            part: [(k, do) for k, law in laws if (do := getattr(law, part)) is not None] for part in ("before", "path", "after")
        }
        stated = robot.stated
        self._nominal = np.array([stated[i.name].value if i.name in stated else 0.0 for i in self._table.infos])
        self.parameters: tuple[ParameterInfo, ...] = beyond(robot, self._table.infos, self._nominal)
        self._body = body_of(robot)
        self._layout = at.layout_of(self._body, robot.spine is not None)
        self._rest_columns = rest_columns(robot, self._layout)
        direction = obstacle_direction(robot)
        self._direction = np.array([1.0, 0.0]) if direction is None else direction
        self._shear = shear_spine(robot.spine) if robot.spine is not None else ShearSpine(1.0, 1.0, 1.0)
        self._sd = np.array([p.sd for p in self.parameters])
        self._low, self._high = np.array([[p.low, p.high] for p in self._table.infos]).T
        self._memory_sizes = {
            k
            for k, p in enumerate(self._table.infos)
            if p.role == "size" and self._table.source_of(p.slot).spec.law.path is not None
        }
        self._remembering: SolvedRods | None = None
        self._hard: tuple[tuple[Array, SolvedRods, SolvedRods], ...] = ()
        self._points: tuple[_At, ...] = ()

    def _place(self, design: States, full: States, factor: Array, points: Array) -> None:
        """Take over states, with the rest states in `full`, their area factors (full,) and markers (full, k, 3)."""
        self.design, self._full = design, full
        self._moved_rows = np.flatnonzero(~design.stiffness)
        self._in_bare = np.flatnonzero(~full.stiffness)
        self._markers = points[self._in_bare]
        self.area_factor = factor[: len(design)]
        """(n,) A_effect / A_norm of each state at zero parameters."""
        self._baseline = baseline(self.robot, self._body, self._layout, full, factor, self._direction, self.scales)

    def __getstate__(self) -> dict[str, Any]:
        """Without the points that it has kept."""
        return vars(self) | {"_points": (), "_hard": ()}

    @property
    def plane_direction(self) -> Array:
        """(2,) unit vector sideways to the plane that may be touched."""
        return self._baseline.plane_direction

    def face(self, direction: Array) -> None:
        """Take the plane that may be touched to stand in this direction (2,), a unit vector."""
        self._baseline.plane_direction, self._points = direction, ()

    def __len__(self) -> int:
        return len(self.observations)

    def on(self, design: States) -> ForwardModel:
        """The same model for other states: the catalogue, what area = 0 means and the plane that may be touched stay."""
        factor = float(self.area_factor[0]) if self.area == "one" else None
        return ForwardModel(self.robot, design, self.area, self.catalogue, factor, self.plane_direction, sized=self.scales)

    def index(self, source: str) -> list[int]:
        """Indices of the parameters of an effect, tolerance or calibration by its id."""
        indices = [i for i, p in enumerate(self.parameters) if p.source == source]
        if not indices:
            sources = sorted({p.source for p in self.parameters})
            raise BadCondition(f"parameter source {source!r}: not in this model, which has {', '.join(sources)}")
        return indices

    def predict(self, theta: Array, trial: bool = False, whole: bool = False) -> Array:
        """(observations,) at parameters (p,); NaN where a state has no equilibrium.

        In a `trial` also where its load would have to be followed to find it, at a thousand times the cost; asked for the
        `whole`, in any other state too once one has none.
        """
        return self.observations.of(self._solved(self._checked(theta), trial=trial, whole=whole).readings)[0]

    def read(self, theta: Array) -> Readings:
        """What instruments read of the design's rows at parameters (p,); NaN where a state has no equilibrium."""
        return self._solved(self._checked(theta)).readings.first(len(self.design))

    def motions(self, theta: Array, quantities: Sequence[str], change: InputChange) -> tuple[Readings, Array]:
        """What `read` gives, and its derivatives (k + v, n, `channels`), turns counted from where the tip is: by each of k
        quantities (its copies together, 0 for one that there is not), then by changes."""
        slots = {p.quantity: p.slot for p in self.parameters}
        wanted = tuple(slots[name] for name in quantities if name in slots)
        here = self._differentiable(self._checked(theta), wanted)
        every = partial(channels, reference=here.readings.orientation[0])
        places = np.flatnonzero([name in slots for name in quantities] + [True] * len(change.by))
        out = np.zeros((len(quantities) + len(change.by), len(self.design), every(here.readings).shape[-1]))
        for of, slope in self._slopes(here, wanted, every, change):
            out[places[of]] = slope[:, : len(self.design)]
        return here.readings.first(len(self.design)), out

    def near(self, theta: Array) -> ForwardModel:
        """The same model, whose rods are solved from those at parameters (p,) on: quicker close by, and the same within the
        tolerance of the solver. What this model has kept is not touched by what the other solves."""
        here = self._solved(self._checked(theta))
        if not here.bare.converged.all() or not here.final.converged.all():
            return self
        other = copy.copy(self)
        other._points, other._steps = (here,), here.bare.steps
        other._start, other._remembering = here.bare, here.final if here.remembers else None
        return other

    def shapes(self, theta: Array, arcs: Array) -> Array:
        """Backbones (n, k, 3) m at parameters (p,) and arc lengths (k,) m, base frame, as motion capture would read them.

        An arc length beyond the tip gives the tip. NaN where a state has no equilibrium; rows of stiffness trials are 0.
        """
        here = self._solved(self._checked(theta))
        final = here.final
        # single states are solved in a form from which no other solve can go on
        begin = final if final.solution.memory.size else None
        along = solve(self._layout, final.rows, _on_axis(len(final.rows), arcs), final.steps, begin, inside=False)
        return self._readings(here.quantities, along.result[None], here.spread).markers[0, : len(self.design)]

    def observe(self, columns: Columns) -> Array:
        """Measured values of a table with the design's rows, in the order of `labels`; NaN for a cell that was not measured."""
        read = np.isin(columns["unread"], 0) if "unread" in columns else slice(None)
        return measured(self.observations, {name: column[read] for name, column in columns.items()})

    def linearise(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array]:
        """Prediction (observations,) and its derivative (observations, p) by the parameters, in their units.

        With `columns`, indices of parameters, the derivative has these columns alone, and costs as much less. At an
        upper bound the derivative is the one towards the inside; beyond `STEEP` it is given as 0.
        """
        predicted, slopes, column_of = self.slopes(theta, columns)
        jacobian = np.zeros((len(self), 1 + (len(self.parameters) if columns is None else len(columns))))
        jacobian[np.arange(len(self)), column_of] = slopes
        return predicted, jacobian[:, :-1]

    def slopes(self, theta: Array, columns: Sequence[int] | None = None) -> tuple[Array, Array, Ints]:
        """What `linearise` gives, without its zeros: the prediction, the derivatives (slots, observations) by the copy of each
        parameter that an observation takes, and the columns (slots, observations) that these belong to, -1 for none."""
        theta = self._checked(theta)
        wanted = list(range(len(self.parameters))) if columns is None else list(columns)
        slots = tuple(sorted({self.parameters[k].slot for k in wanted}))
        here = self._differentiable(theta, slots)
        of_row = self._table.of_row[list(slots)]
        column_of = np.full(len(self.parameters) + 1, -1)
        column_of[wanted] = np.arange(len(wanted))
        slopes = np.empty((len(slots), len(self)))
        for of, by_state in self._slopes(here, slots, partial(channels, reference=self.observations.reference)):
            slopes[of] = self.observations.pick(by_state)
        for slope, parameter in zip(slopes, of_row, strict=True):
            slope[np.abs(slope) * self._sd[parameter][self.observations.row] > STEEP * self.robot.length] = 0.0
        return self.observations.of(here.readings)[0], slopes, column_of[of_row][:, self.observations.row]

    def _differentiable(self, theta: Array, slots: tuple[int, ...]) -> _At:
        """The point at values of the laws' parameters, with all that derivatives by slots need."""
        sources = frozenset(self._table.source_index[slot] for slot in slots)
        moving = any(self._table.infos[k].slot in slots for k in self._memory_sizes)
        return self._with_sources(self._solved(theta, moving, also=sources), sources)

    def respond(self, change: Array) -> Array:
        """(observations,) change of the baseline's readings with pressures (n, chambers), Pa; what the robot remembers stays."""
        spread = self._table.at(self._nominal)
        q = self._quantities(spread, InputChange(change[None], np.zeros((1, 1)), np.ones(1)))
        built = self._rows(rod_columns(q, self._shear))
        own = slice(0, self._moved_rows.size)
        here = self._solved(self._nominal)
        moved = solve(self._layout, built, self._markers, here.bare.steps, self._start, inside=False).take(own)
        still = self._readings(here.quantities, here.bare.take(own).result[None], spread)
        there = self._readings(q, moved.result[None], spread)
        return np.asarray(self.observations.of(there)[0] - self.observations.of(still)[0])

    def _checked(self, theta: Array) -> Array:
        """Values of the laws' parameters from what is added to those of robot.yaml."""
        values = np.asarray(theta, float)
        if values.shape != (len(self.parameters),):
            raise BadCondition(f"theta: shape {values.shape}, must be ({len(self.parameters)},)")
        values = values + self._nominal
        slack = ROUNDING * self._sd  # where robot.yaml has an effect, bounds are counted from it
        wrong = ~((values >= self._low - slack) & (values <= self._high + slack))
        if wrong.any():
            p = self.parameters[int(np.flatnonzero(wrong)[0])]
            raise BadCondition(f"{p.name} = {theta[wrong][0]:g}{unit_text(p.unit)}: must be within {p.low:g} and {p.high:g}")
        return np.clip(values, self._low, self._high)

    def _laws(
        self, part: Literal["before", "path", "after"], spread: Spread
    ) -> Iterator[tuple[Callable[[Any, Values], None], Values]]:
        """This part of every law that is applied, with its values, in the catalogue's order, the robot's own among them."""
        for known, do in self._laws_of[part]:
            if isinstance(known, str):
                yield do, dict(self._fixed[known][1])
            elif self._every_law or known in spread.applied:
                yield do, self._table.values(known, spread)

    def _quantities(self, spread: Spread, change: InputChange = NO_CHANGE) -> Quantities:
        """All laws before the rod."""
        q = copy.copy(self._baseline)
        if change.by.size:
            pressure = np.repeat(q.pressure, len(change.by), axis=0)
            pressure[:, : len(self.design)] += change.pressure
            q.pressure = pressure
            if change.spine_length.any():
                q.spine_length = q.tabulated_length = q.spine_length + change.spine_length
                q.area_factor = self.robot.area_factor_at(q.spine_length)[..., None] * np.ones(pressure.shape[2])
        for law, values in self._laws("before", spread):
            law(q, values)
        return q

    def _solved(
        self, theta: Array, moving: bool = False, trial: bool = False, also: frozenset[int] = frozenset(), whole: bool = False
    ) -> _At:
        """Everything solved at parameters (p,), from the points that are kept if it is among them.

        `moving`: with what drives memory, even where nothing remembers. `trial`, `whole`: see `predict`. `also`: sources whose
        laws are applied even at size zero."""
        kept = [p for p in self._points if np.array_equal(p.theta, theta) and (trial or p.settled)]
        here = kept[0] if kept else self._solve(theta, trial, also, whole)
        if moving and not here.bare.inside:
            bare = look_inside(here.bare)
            here = replace(here, bare=bare, driven=self._drive(here.built, bare.result[None]))
        self._keep(here)
        return here

    def _keep(self, here: _At) -> None:
        # a search predicts where it then linearises
        self._points = (here, *(p for p in self._points if not np.array_equal(p.theta, here.theta)))[:2]

    def _with_sources(self, here: _At, sources: frozenset[int]) -> _At:
        """The point `here` with the laws of `sources` applied, too, so that it can be differentiated by those of size zero. Its
        values are the same and nothing is solved anew."""
        if sources <= here.spread.applied:
            return here
        spread = replace(here.spread, applied=here.spread.applied | sources)
        q = self._quantities(spread)
        built = rod_columns(q, self._shear)
        bare = replace(here.bare, rows=self._rows(built))
        rows = bare.rows[: self._moved_rows.size].copy()
        if here.remembers:
            rows[:, self._rest_columns] += here.rest[0, self._moved_rows]
        final = replace(here.final, rows=rows)
        here = replace(here, spread=spread, quantities=q, built=built, bare=bare, final=final)
        self._keep(here)
        return here

    def _solve(self, theta: Array, trial: bool, also: frozenset[int], whole: bool) -> _At:
        """Solve at parameters (p,) the rods without memory (`bare`) and, where a law remembers, the rods with the rest shapes
        that it makes of the history of those (`final`)."""
        spread = self._table.at(theta, also)
        q = self._quantities(spread)
        built = rod_columns(q, self._shear)
        remembers = any(theta[k] for k in self._memory_sizes) or any(law.path is not None for law, _ in self._fixed.values())
        rods = self._rows(built)
        single_states = self._steps is None
        nearest = min(self._hard, key=lambda hard: float(np.linalg.norm((hard[0] - theta) / self._sd)), default=None)
        hard_bare, hard_final = (None, None) if nearest is None else nearest[1:]  # equilibria that were hard to find
        plain = single_states and not remembers
        bare = solve(self._layout, rods, self._markers, self._steps, self._start, remembers, trial, plain, whole, hard_bare)
        final = bare.take(slice(0, self._moved_rows.size))
        driven, rest = (np.zeros((1, len(self._full), k)) for k in (DRIVES, len(self._rest_columns)))
        if remembers:
            driven = self._drive(built, bare.result[None])
            rest = self._memory(q, built, driven, spread)
            rows = final.rows.copy()
            rows[:, self._rest_columns] += rest[0, self._moved_rows]
            begin = self._remembering or final
            final = solve(self._layout, rows, final.points, final.steps, begin, False, trial, False, whole, hard_final)
            # What drives memory is the rod without it: where that has no equilibrium, nothing can be said of the state.
            final.result[~bare.converged[: len(final.rows)]] = np.nan
        if not trial and (bare.hard or final.hard):
            self._hard = ((theta.copy(), bare, final), *self._hard)[:HARD_KEPT]
        read = self._readings(q, final.result[None], spread)
        settled = not (trial or whole) or bool(bare.converged.all() and final.converged.all())
        return _At(theta.copy(), spread, q, built, bare, driven, rest, final, remembers, read, settled)

    def _rows(self, built: RodColumns) -> Array:
        """(m, layout.width) rods of one variant that are solved."""
        rods = built.rows(len(self._full))
        return rods if len(self._in_bare) == len(rods) else rods[self._in_bare]

    def _drive(self, built: RodColumns, results: Array) -> Array:
        """(v, full, DRIVES) from results (v, m, columns)."""
        n = len(self._full)
        lengths = [np.broadcast_to(long, (len(long), n)) for long in map(built.length, (at.INNER, at.OUTER))]
        return drive([long[:, self._in_bare] for long in lengths], results, self._in_bare, n)

    def _memory(self, q: Quantities, built: RodColumns, driven: Array, spread: Spread) -> Array:
        """(v, full, columns) what all laws with memory add to `rest_columns`."""
        history = history_of(q, self._path, built, driven)
        for law, values in self._laws("path", spread):
            law(history, values)
        return by_element(history, built)

    def _slopes(
        self, here: _At, slots: tuple[int, ...], every: Callable[[Readings], Array], change: InputChange = NO_CHANGE
    ) -> Iterator[tuple[list[int], Array]]:
        """Places among slots and changes, and derivatives (places, full, channels) by these of the channels that `every` makes of
        readings, in the parameters' units.

        By the chain rule: rows of rods by parameters and readings by equilibria are differenced, equilibria by rows are solved
        for. Slots that enter at the same stage are varied together: what none of them changes is computed once.
        """
        step = NUDGE * self._sd * np.where(here.theta + NUDGE * self._sd <= self._high, 1.0, -1.0)
        groups = [(of_stage, NO_CHANGE) for of_stage in self._by_stage(slots)]
        if change.by.size:
            # Of single states all together: what changes is one number for all states.
            groups = [(slots, change)] if self._steps is None else [*groups, ((), change)]
        batches = [self._varied(here, step, *group) for group in groups]
        for (of_stage, inputs), b, slope in zip(groups, batches, self._through_rods(here, batches, every), strict=True):
            if b.reads:
                varied_read = every(self._readings(b.quantities, here.final.result[None], b.spread))
                slope = slope + (varied_read - every(here.readings)) / b.by_row[..., None]
            yield [slots.index(k) for k in of_stage] + [len(slots) + k for k in range(len(inputs.by))], slope

    def _by_stage(self, slots: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Slots that enter at the same stage, or few of all stages; those that change readings alone by themselves."""
        by_stage: dict[tuple[bool, str], list[int]] = {}
        for k in slots:
            spec = self._table.source_of(k).spec
            moves_rod = spec.law.before is not None or spec.law.path is not None
            by_stage.setdefault((moves_rod, spec.stage if len(slots) * len(self._full) > FEW else ""), []).append(k)
        return [tuple(of_stage) for of_stage in by_stage.values()]

    def _varied(self, here: _At, step: Array, slots: tuple[int, ...], change: InputChange) -> _Varied:
        """Variants of `here`: for each slot one in which it is a step away, and one for each change."""
        spread = self._table.variants(here.spread, here.theta + step, slots, len(change.by))
        by_row = np.empty((len(slots) + len(change.by), len(self._full)))
        by_row[: len(slots)], by_row[len(slots) :] = np.append(step, 1.0)[self._table.of_row[list(slots)]], change.by[:, None]
        laws = [self._table.source_of(k).spec.law for k in slots]
        q, built = here.quantities, here.built
        moves = len(change.by) > 0 or any(law.before is not None for law in laws)
        if moves:
            q = self._quantities(spread, change.behind(len(slots)) if change.by.size else change)
            built = rod_columns(q, self._shear)
        remembers = (here.remembers and moves) or any(law.path is not None for law in laws)
        reads = bool(self.design.stiffness.any()) or any(law.after is not None for law in laws)
        read = (element + c for element in self._layout.elements for c in (col.LENGTH, col.BEND, col.STRETCH + 2))
        return _Varied(spread, by_row, q, built.only(read), built.changes(here.built, by_row), remembers, reads)

    def _through_rods(self, here: _At, batches: Sequence[_Varied], every: Callable[[Readings], Array]) -> Iterator[Array]:
        """(v, full, channels) of each batch: derivatives of readings through the rods' rows alone, in the parameters' units."""
        rest_slopes = self._rest_slopes(here, batches)
        columns = sorted(
            {c for b in batches for c in b.change} | {c for r in rest_slopes if r is not None for c in self._rest_columns}
        )
        by_column = np.zeros((len(columns), every(here.readings).shape[-1], len(self._full)))  # by columns of a rod's row
        if columns:
            by_column[..., self._moved_rows] = _by_columns(
                here.final, columns, lambda r: every(self._readings(here.quantities, r, here.spread))[:, self._moved_rows]
            )
        of_rest = np.moveaxis(by_column[[columns.index(c) for c in self._rest_columns if c in columns]], 2, 0)
        for b, rest_slope in zip(batches, rest_slopes, strict=True):
            slope = b.through(by_column, columns)
            if rest_slope is not None:
                slope += (rest_slope @ of_rest).swapaxes(0, 1)
            yield slope

    def _rest_slopes(self, here: _At, batches: Sequence[_Varied]) -> list[Array | None]:
        """(full, v, columns) of each batch: derivatives of what memory adds to `rest_columns`; None where it adds the same."""
        columns = sorted({c for b in batches for c in b.change})
        by_column = np.zeros((len(columns), DRIVES, len(self._full)))  # by columns of a rod's row
        if here.remembers and columns:
            by_column[..., self._in_bare] = np.nan_to_num(
                _by_columns(here.bare, columns, lambda results: self._drive(here.built, results)[:, self._in_bare])
            )
        lengths = {element + col.LENGTH for element in self._layout.elements}  # the drive depends on these directly, too
        out: list[Array | None] = []
        for b in batches:
            driven = here.driven
            if here.remembers and b.change:
                if lengths.intersection(b.change):
                    driven = self._drive(b.built, here.bare.result[None])
                # of the variants, to first order
                driven = driven + b.by_row[..., None] * b.through(by_column, columns)
            elif not b.remembers:
                out.append(None)
                continue
            rest = self._memory(b.quantities, b.built, driven, b.spread)
            out.append(((rest - here.rest) / b.by_row[..., None]).swapaxes(0, 1))
        return out

    def _readings(self, q: Quantities, results: Array, spread: Spread) -> Readings:
        """What instruments read of results (v, moved, columns): all laws after the rod."""
        r = readings(q, self._shear, self._every_row(results))
        for law, values in self._laws("after", spread):
            law(r, values)
        return r

    def _every_row(self, results: Array) -> Array:
        """(v, full, columns) results of rods in their places among all states, then rests; zeros for stiffness pushes."""
        if results.shape[1] == len(self._full):
            return results
        out = np.zeros((len(results), len(self._full), results.shape[2]))
        out[:, :, at.ORIENTATION] = 1.0
        out[:, self._moved_rows] = results
        return out


def _on_axis(n: int, arcs: ArrayLike) -> Array:
    """(n, k, 3) points of the axis at arc lengths (k,) m."""
    return np.broadcast_to(np.multiply.outer(arcs, [0.0, 0.0, 1.0]), (n, np.size(arcs), 3))


def _by_columns(solved: SolvedRods, changed: Sequence[int], made_of: Callable[[Array], Array]) -> Array:
    """(a, outputs, n) derivatives by `changed` columns (a) of the rods of what is made of results (v, n, columns)."""
    made = made_of(nudged(solved, NUDGE))
    by_motion, asked = ((made[1:] - made[0]) / NUDGE).swapaxes(0, 1), directions(solved.layout, changed)
    parts = [slice(first, first + AT_ONCE) for first in range(0, max(len(solved.rows), 1), AT_ONCE)]
    of_parts = (differentiate(replace(solved.take(part), inside=solved.inside), asked) @ by_motion[part] for part in parts)
    return np.concatenate([np.moveaxis(of_part, 0, 2) for of_part in of_parts], axis=2)
