"""What an effect is: a declared cause of a gap between model and robot, with its law and the size that is plausible.

    EffectSpec          id, stage, equation, parameters, citation, and the law in code
    |-- Parameter       one number of it: unit, prior scale, bounds, whether it is a size or a shape
    `-- Law             what the effect does to quantities before the rod, along the loading history, to readings after

At zero parameters an effect does nothing, to the last bit, whatever other effects are present.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from model.actuators import Chambers, Words
from model.arrays import Array
from model.effects.scales import STANDARD, Scales
from model.errors import BadEffect

if TYPE_CHECKING:
    from model.condition import States
    from model.effects.history import History
    from model.effects.quantities import Quantities
    from model.effects.readings import Readings
    from model.robot import Robot

Values = Mapping[str, Array]
"""Parameter name -> value, shape (variants, 1) or (variants, states); the effect's own names without its id."""

Stage = Literal["actuation", "material", "structure", "load", "boundary", "measurement", "simulator"]
STAGES: tuple[Stage, ...] = ("actuation", "material", "structure", "load", "boundary", "measurement")
"""The chain from pressure to reading; beside it stands a simulator of the lab's own that takes the rod's place."""
Sign = Literal["both", "positive", "blend"]
"""both: either way; positive: zero or more; blend: 0 (baseline) to 1 (the other law in full)."""


def _add(names: Mapping[str, str | tuple[str, ...]], share: bool, q: Quantities, v: Values) -> None:
    for quantity, parameter in names.items():
        present = getattr(q, quantity)
        if isinstance(parameter, tuple):
            more = vector(*(v[name] for name in parameter), *[np.zeros((1, 1))] * (present.shape[-1] - len(parameter)))
        else:
            more = v[parameter] if present.ndim == 2 else v[parameter][..., None]
        setattr(q, quantity, present * (1 + more) if share else present + more)


def adding(**names: str | tuple[str, ...]) -> Callable[[Quantities, Values], None]:
    """The law that adds to each of some quantities a parameter: quantity=parameter, to that of every actuator alike, or
    quantity=(x, y[, z]) or (p1, p2 ..) where it is a vector or each actuator has its own."""
    return partial(_add, names, False)


def growing(**names: str | tuple[str, ...]) -> Callable[[Quantities, Values], None]:
    """The law by which each of some quantities is larger by a share: quantity=parameter, or (p1, p2 ..) as above."""
    return partial(_add, names, True)


def vector(*coordinates: Array) -> Array:
    """(v, n, k) of k coordinates (v, n)."""
    return np.stack(np.broadcast_arrays(*coordinates), axis=-1)


@dataclass(frozen=True)
class Parameter:
    """One number of an effect. A size makes the effect; a shape says how it looks and does nothing at size zero."""

    name: str
    unit: str
    scale: float
    """Prior standard deviation, in `unit`."""
    low: float
    high: float
    sign: Sign = "both"
    role: Literal["size", "shape"] = "size"
    starts: tuple[float, ...] = (0.0,)
    """Where a fit begins; several where the misfit has several valleys."""
    least: float = -np.inf
    """Smallest size, in `unit`, that the law is meant for; one below it is named with a doubt, as another law acts like that."""
    proportional_to: str = ""
    """Unit whose scale its sizes are in proportion to; empty: its own unit."""

    def __post_init__(self) -> None:
        if not (self.scale > 0 and self.low <= 0 <= self.high and self.low < self.high):
            raise BadEffect(
                f"parameter {self.name}: scale {self.scale:g} (unit {self.unit}) must be positive and "
                f"the bounds {self.low:g}..{self.high:g} must include zero, where the effect is absent"
            )

    def of(self, scales: Scales) -> Parameter:
        """The same with all numbers of a robot with these scales."""
        unit = self.proportional_to or self.unit
        factor, mass = scales.of(unit) / STANDARD.of(unit), scales.tip_mass * (unit == "kg")
        scaled = {name: factor * getattr(self, name) for name in ("scale", "low", "high", "least")}
        scaled |= {"scale": max(scaled["scale"], mass), "low": min(scaled["low"], -mass * (self.low < 0))}
        return replace(self, **scaled, starts=tuple(factor * start for start in self.starts))


@dataclass(frozen=True)
class Law:
    """The effect in code; each part may be absent."""

    before: Callable[[Quantities, Values], None] | None = None
    """Changes pressures, moduli, loads, boundary .. before the rod is solved."""
    path: Callable[[History, Values], None] | None = None
    """Adds rest curvature and strain that depend on what the trial has been through."""
    after: Callable[[Readings, Values], None] | None = None
    """Changes what the instruments read."""


@dataclass(frozen=True)
class EffectSpec:
    """One effect of the catalogue.

    >>> def stiffer(q, v):
    ...     q.body_modulus = q.body_modulus * (1 + v["excess"])
    >>> cold = EffectSpec(
    ...     id="cold", stage="material", equation="E = E0 (1 + d)", parameters=(Parameter("excess", "1", 0.1, -0.5, 1.0),),
    ...     law=Law(before=stiffer), citation="data sheet", seen_best_in="zero spine",
    ... )
    >>> cold.family_id
    'cold'
    """

    id: str
    stage: Stage
    equation: str
    parameters: tuple[Parameter, ...]
    law: Law
    citation: str
    seen_best_in: str
    label: str = ""
    """The effect as a noun phrase, for tables and figures, in which {actuators} and the like (`Words`) stand for what the robot
    has; empty: its id in words."""
    says: str = ""
    """The effect in plain words, {} for its size, {quoted} for the pressure at which it is stated, as [more|less] a word by the
    sign of a size; empty: its id says it."""
    standard: bool = False
    """Whether sizes are those of a robot with the scales `scales.STANDARD`, and others have theirs in proportion."""
    family: str = ""
    """Effects of one family are forms of one cause; empty: the effect is its own family."""
    tolerated: bool = True
    """Whether a robot has a little of it without it being worth a name; False where it is there or it is not."""
    exact: bool = False
    """Whether its law is geometry, with no unknown function of the state in it: a turned camera is turned in every state."""
    shown: Callable[[Robot, States], bool] | None = None
    """Whether states like these can show it at all; a diagnosis leaves it out where they cannot. Absent: any state can."""

    each: Callable[[Robot, Values], Array] | None = None
    """Factors (.., actuators) on what the actuators do, where the effect is no more than that."""

    def __post_init__(self) -> None:
        if not self.id.isidentifier():
            raise BadEffect(f"effect id {self.id!r}: letters, digits and _ only")
        if self.stage not in get_args(Stage):
            raise BadEffect(f"effect {self.id}: stage {self.stage!r} must be one of {', '.join(STAGES)}")
        try:
            Chambers.words.fill(f"{self.label}{self.says}", "", quoted="")
        except (LookupError, ValueError, AttributeError) as error:
            raise BadEffect(
                f"effect {self.id}: label and says: {error} in braces is no word for actuators; leave it out"
            ) from error
        names = [p.name for p in self.parameters]
        if not names or len(set(names)) != len(names):
            raise BadEffect(f"effect {self.id}: parameters {names}, needs at least one, and distinct names")
        if not any(p.role == "size" for p in self.parameters):
            raise BadEffect(f"effect {self.id}: no parameter is a size, so it could never be absent")

    def of(self, scales: Scales) -> EffectSpec:
        """The effect with sizes, bounds and starts of a robot with these scales."""
        if not self.standard:
            return self
        return replace(self, standard=False, parameters=tuple(p.of(scales) for p in self.parameters))

    def name(self, words: Words = Chambers.words) -> str:
        """The effect's plain name, in the words for the robot's actuators."""
        return words.fill(self.label) or self.id.replace("_", " ")

    @property
    def family_id(self) -> str:
        """The family, or the effect's own id."""
        return self.family or self.id
