"""The ordered table of parameters of a campaign, and how a parameter vector becomes values at each state.

A parameter that exists once a trial (or once a spine length) acts on its own rows alone: all its copies share one
slot, whose value differs from row to row, so that a derivative by all of them costs one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from model.arrays import Array, Ints, Mask
from model.condition import States
from model.effects.shows import PARTS
from model.effects.spec import Sign, Values
from model.effects.tolerance import Group, Scope, VariationSource, mounts
from model.robot import Robot


@dataclass(frozen=True)
class ParameterInfo:
    """One entry of the parameter vector."""

    name: str
    """spine_slip.moment, area.excess, area.excess[spine_length=0.1], spine_length.excess[trial=3] .."""
    quantity: str
    """The same of all copies: spine_length.excess .."""
    source: str
    """Id of the effect, or of the tolerance or calibration."""
    group: Group
    unit: str
    sd: float
    """Prior standard deviation about 0, in `unit`."""
    low: float
    high: float
    sign: Sign
    role: str
    """size or shape; see `spec.Parameter`."""
    starts: tuple[float, ...]
    slot: int
    """Column of the derivative it shares with its copies."""
    trial: int | None = None
    """The trial whose own it is, as the table numbers it; None for one of several trials."""
    scope: Scope = "all"
    tolerated: bool = True
    exact: bool = False
    """See `spec.EffectSpec`, as `tolerated`."""
    least: float = -np.inf
    """See `spec.Parameter`."""

    @property
    def recurs(self) -> bool:
        """Drawn anew with each trial or repeat of the sweep: what it was once says nothing of the next."""
        return self.scope in ("trial", "push", "repeat")

    @property
    def lasts(self) -> bool:
        """The same in another campaign."""
        return not self.recurs and self.scope != "campaign"


@dataclass(frozen=True)
class Spread:
    """Values of all slots at all rows, in one or many variants."""

    values: Array
    """(p + 1,) of the parameters, then 0."""
    of_row: Ints
    """As in `ParameterTable`."""
    applied: frozenset[int]
    """The sources whose laws are applied: those of which some size is not zero, and those that were asked for."""
    stepped: Array | None = None
    """(variants of a slot, n): the value of the slot in its own variant."""
    chosen: tuple[int, ...] = ()
    """The slot of each variant, -1 for one of no slot."""

    def slot(self, k: int) -> Array:
        """(v, n), or (1, n) where no variant has another value."""
        if self.stepped is None or k not in self.chosen:
            return self.values[self.of_row[k]][None]
        out = np.repeat(self.values[self.of_row[k]][None], len(self.chosen), axis=0)
        variant = self.chosen.index(k)
        out[variant] = self.stepped[variant]
        return out


@dataclass(frozen=True)
class ParameterTable:
    """All parameters of a campaign."""

    infos: tuple[ParameterInfo, ...]
    sources: tuple[VariationSource, ...]
    of_row: Ints
    """(slots, n) which parameter a row takes for a slot; -1 where none exists."""

    def at(self, theta: Array, asked: frozenset[int] = frozenset()) -> Spread:
        """One variant: these parameters; laws of size zero change nothing and are left out, but for those `asked` for."""
        return Spread(np.append(theta, 0.0), self.of_row, asked.union(self._sized[theta != 0].tolist()) - {-1})

    def variants(self, spread: Spread, stepped: Array, slots: tuple[int, ...], more: int) -> Spread:
        """One variant for each of `slots`, in which the slot takes its value of `stepped` (p,); then `more` as `spread`."""
        values = np.append(stepped, 0.0)[self.of_row[list(slots)]]
        return Spread(spread.values, self.of_row, spread.applied, values, (*slots, *(-1,) * more))

    def values(self, source: int, spread: Spread) -> Values:
        """The values of one source by its own parameter names, (v, n) each."""
        first = self.source_index.index(source)
        return {p.name: spread.slot(first + i) for i, p in enumerate(self.sources[source].spec.parameters)}

    @cached_property
    def _sized(self) -> Ints:
        """(p,) the source of each parameter that is a size, -1 for others."""
        return np.array([self.source_index[p.slot] if p.role == "size" else -1 for p in self.infos], np.int64)

    def source_of(self, slot: int) -> VariationSource:
        """The source a slot belongs to."""
        return self.sources[self.source_index[slot]]

    @cached_property
    def source_index(self) -> list[int]:
        """(slots,) place of each slot's source among `sources`."""
        return [i for i, s in enumerate(self.sources) for _ in s.spec.parameters]


def parameter_table(design: States, sources: tuple[VariationSource, ...], robot: Robot) -> ParameterTable:
    """Lay out the parameters of all sources; one by the name of a part that the robot lacks stays 0."""
    infos, of_row = list[ParameterInfo](), list[Ints]()
    for source in sources:
        for p in source.spec.parameters:
            absent = p.name in PARTS and getattr(robot, p.name) is None
            rows = np.full(len(design), -1, np.int64)
            for label, trial, states_of_copy in () if absent else _copies(design, source):
                rows[states_of_copy] = len(infos)
                name = f"{source.spec.id}.{p.name}"
                infos.append(ParameterInfo(
                    f"{name}{label}", name, source.spec.id, source.group, p.unit, p.scale, p.low, p.high, p.sign, p.role,
                    p.starts, len(of_row), trial, source.scope, source.spec.tolerated, source.spec.exact, p.least,
                ))  # fmt: skip
            of_row.append(rows)
    return ParameterTable(tuple(infos), sources, np.array(of_row))


def _copies(design: States, source: VariationSource) -> list[tuple[str, int | None, Mask]]:
    """Copies of a source's parameters: what the copy adds to their names, its trial's number if it is one trial's, its rows."""
    if source.scope in ("all", "campaign"):
        return [("", None, np.ones(len(design), bool))]
    if source.scope == "spine_length":
        rounded = np.round(design.spine_length, 4)
        of_robot = ~design.stiffness
        return [(f"[spine_length={x:g}]", None, (rounded == x) & of_robot) for x in np.unique(rounded[of_robot])]
    if source.scope == "mount":
        roll_deg = np.round(np.degrees(design.roll))
        mountings = mounts(design)
        several = len({roll for roll, _ in mountings}) < len(mountings)
        rows_of = {(roll, k): (roll_deg == roll) & (design.sitting == k) & ~design.stiffness for roll, k in mountings[1:]}
        sittings = {k: f", sitting {k + 1}" if several else "" for _, k in mountings}
        return [(f"[roll={roll:g} deg{sittings[k]}]", None, rows) for (roll, k), rows in rows_of.items()]
    if source.scope == "repeat":
        numbers = np.unique(design.repeat[~design.stiffness])
        return [(f"[repeat={k}]", None, (design.repeat == k) & ~design.stiffness) for k in numbers]
    concerned = design.stiffness if source.scope == "push" else design.spine_length > 0
    trials = [k for k in range(len(design.trial_id)) if concerned[design.trial == k].any()]
    ids = [int(design.trial_id[k]) for k in trials]
    in_parts = len(set(ids)) < len(ids)
    return [
        (f"[trial={trial}, part {k}]" if in_parts else f"[trial={trial}]", trial, design.trial == k)
        for trial, k in zip(ids, trials, strict=True)
    ]
