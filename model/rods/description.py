"""Rods and their loads as arrays: what every method takes, checked field by field before it is solved.

A `Rods` is one array, a row a rod (columns in `columns`), with its fields as views into it: writing to
`rods.field("tip_force")[:]` changes the rods. The rod stands in the mount frame with its base at the origin; its z axis
points from base to tip when it is straight and the base not turned. Elements run from base to tip and meet exactly where
the section or its loads change (the end of a spine, a marker).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array, Mask, Order
from model.errors import BadCondition
from model.rods import columns

_PER_ROD = {
    "tip_force": (columns.TIP_FORCE, 3),
    "tip_moment": (columns.TIP_MOMENT, 3),
    "dead_force": (columns.DEAD_FORCE, 3),
    "dead_moment": (columns.DEAD_MOMENT, 3),
    "base_turn": (columns.BASE_TURN, 3),
    "base_compliance": (columns.BASE_COMPLIANCE, 3),
    "base_relief": (columns.BASE_RELIEF, 1),
    "base_stiffening": (columns.BASE_STIFFENING, 1),
}
_PER_SPRING = {
    "spring_direction": (columns.SPRING_DIRECTION, 3),
    "spring_stiffness": (columns.SPRING_STIFFNESS, 1),
    "spring_origin": (columns.SPRING_ORIGIN, 1),
    "spring_softness": (columns.SPRING_SOFTNESS, 1),
    "spring_arm": (columns.SPRING_ARM, 3),
}
_PER_ELEMENT = {
    "length": (columns.LENGTH, 1),
    "bend_stiffness": (columns.BEND, 3),
    "stretch_stiffness": (columns.STRETCH, 3),
    "rest_curvature": (columns.REST_CURVATURE, 3),
    "rest_strain": (columns.REST_STRAIN, 3),
    "load": (columns.LOAD, 3),
    "series": (columns.SERIES, 3),
    "curvature_rise": (columns.RISE, 9),
    "active": (columns.ACTIVE, 12),
}
MOST_SPRINGS = 4
BASIC = ("rest_curvature", "active", "load", "tip_force", "tip_moment", "dead_force", "dead_moment")
"""Fields that every method knows, besides lengths and stiffnesses; `active` says nothing of sections that are linear."""


@dataclass(frozen=True)
class Form:
    """What rods of one batch have in common."""

    elements: int
    springs: int = 0

    def __post_init__(self) -> None:
        if self.elements < 1:
            raise BadCondition(f"elements: {self.elements}, a rod has at least one")
        if not 0 <= self.springs <= MOST_SPRINGS:
            raise BadCondition(f"springs: {self.springs}, must be 0 to {MOST_SPRINGS}")

    @property
    def head(self) -> int:
        """Columns before the first element."""
        return columns.HEAD + columns.SPRING * self.springs

    @property
    def width(self) -> int:
        """Columns of a row."""
        return self.head + columns.BLOCK * self.elements

    def fields(self) -> dict[str, tuple[int, int]]:
        """Name -> (offset in the rod, spring or element block it belongs to, columns) of every field."""
        return _PER_ROD | (_PER_SPRING if self.springs else {}) | _PER_ELEMENT

    def view(self, values: Array, name: str) -> Array:
        """The field `name` of rows (..., width) as a view: (...[, k]), (..., springs[, k]) or (..., elements[, k])."""
        known = self.fields()
        if name not in known:
            raise BadCondition(f"{name}: no such field in rods of {self}; there are {', '.join(known)}")
        offset, size = known[name]
        if name not in _PER_ROD:
            of_springs = columns.HEAD, self.springs, columns.SPRING
            first, count, block = of_springs if name in _PER_SPRING else (self.head, self.elements, columns.BLOCK)
            values = values[..., first : first + count * block].reshape(*values.shape[:-1], count, block)
        return values[..., offset] if size == 1 else values[..., offset : offset + size]


@dataclass(frozen=True)
class Rods:
    """n rods and their loads; make one with `rods`, or write into its fields and `check` it."""

    form: Form
    values: Array
    """(n, form.width), C order."""

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.shape[1] != self.form.width:
            raise BadCondition(f"values: shape {self.values.shape}, must be (n, {self.form.width}) for {self.form}")
        if self.values.dtype != np.float64 or not self.values.flags.c_contiguous:
            raise BadCondition("values: must be C-contiguous float64")

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, rows: slice | Mask | Order) -> Rods:
        """The rods picked by a slice, mask or index array."""
        return Rods(self.form, np.ascontiguousarray(self.values[rows]))

    def field(self, name: str) -> Array:
        """View of one field, see `Form.view`."""
        return self.form.view(self.values, name)

    @property
    def whole_length(self) -> Array:
        """(n,) m."""
        return self.field("length").sum(axis=1)

    def changed(self, **fields: ArrayLike) -> Rods:
        """A copy with other values in the named fields (broadcast to the shapes of `Form.view`), checked."""
        return _filled(Rods(self.form, self.values.copy()), fields)

    def arcs(self, arc_lengths: ArrayLike) -> Array:
        """(n, k) m: arc lengths (k,) or (n, k) for every rod, none beyond its tip by rounding; `BadCondition` off the rod."""
        n = len(self)
        arcs = np.atleast_1d(np.asarray(arc_lengths, dtype=np.float64))
        arcs = np.broadcast_to(arcs, (n, arcs.shape[-1]))
        beyond = (arcs < 0) | (arcs > self.whole_length[:, None] * (1 + 1e-9)) | ~np.isfinite(arcs)
        if beyond.any():
            i, j = (int(x) for x in np.argwhere(beyond)[0])
            raise BadCondition(
                f"arc_lengths: {arcs[i, j]:g} m of rod {i} must lie between 0 and its length {self.whole_length[i]:g} m"
            )
        return np.ascontiguousarray(np.minimum(arcs, self.whole_length[:, None]))

    def shares(self, i: int, edges: ArrayLike) -> Array:
        """(k, elements) of the k stretches between `edges` (k + 1,) m of rod `i`, how much of each lies in each element: for
        methods with elements of their own.

        >>> from model.rods import Form, rods
        >>> rods(Form(elements=2), 1, length=[0.1, 0.3], bend_stiffness=1.0, stretch_stiffness=1.0).shares(0, [0.0, 0.2, 0.4])
        array([[0.5, 0.5],
               [0. , 1. ]])
        """
        cut = np.asarray(edges, float)
        ends = np.concatenate([[0.0], np.cumsum(self.field("length")[i])])
        low, high = np.maximum(cut[:-1, None], ends[None, :-1]), np.minimum(cut[1:, None], ends[None, 1:])
        return np.asarray(np.maximum(high - low, 0.0) / np.diff(cut)[:, None])

    def refuse_terms(self, method: str) -> None:
        """Raise `BadCondition` where a field is used that `method` does not know: one that is not BASIC."""
        for name in self.form.fields():
            neutral = (0.0, 0.0, 1.0) if name == "rest_strain" else 0.0
            if name in ("length", "bend_stiffness", "stretch_stiffness", "spring_direction", *BASIC):
                continue
            if np.any(self.field(name) != neutral):
                raise BadCondition(f"{name}: must be {neutral} for the method {method}, which supports nothing else; use Fast")

    def check(self) -> Rods:
        """Itself; raises `BadCondition` naming the field, rod and value that no kernel may see."""
        if not np.isfinite(self.values).all():
            for name in self.form.fields():
                self._refuse(name, ~np.isfinite(self.field(name)), "must be finite")
        for name in ("bend_stiffness", "stretch_stiffness"):
            self._refuse(name, self.field(name) <= 0, "must be positive")
        self._refuse("length", self.field("length") < 0, "must not be negative: does the spine end beyond the tip?")
        self._refuse("length", (self.whole_length <= 0)[:, None], "the elements of a rod must add up to more than 0 m")
        for name in ("base_compliance", "base_stiffening"):
            self._refuse(name, self.field(name) < 0, "must not be negative")
        if self.form.springs:
            for name in ("spring_stiffness", "spring_softness"):
                self._refuse(name, self.field(name) < 0, "must not be negative")
            norm = np.linalg.norm(self.field("spring_direction"), axis=-1)
            self._refuse("spring_direction", np.abs(norm - 1) > 1e-6, "must be unit vectors")
        return self

    def _refuse(self, name: str, wrong: Mask, reason: str) -> None:
        if wrong.any():
            where = tuple(int(i) for i in np.argwhere(wrong)[0])
            value = self.field(name)[where]
            raise BadCondition(f"{name}{list(where[1:])} of rod {where[0]}: {value}, {reason} ({int(wrong.sum())} such)")


def rods(form: Form, n: int, **fields: ArrayLike) -> Rods:
    """n rods from named fields that broadcast to the shapes of `Form.view`, checked; what is not named is zero but
    v* = (0, 0, 1) and springs, which pull along z."""
    made = Rods(form, np.zeros((n, form.width)))
    made.field("rest_strain")[..., 2] = 1.0
    if form.springs:
        made.field("spring_direction")[..., 2] = 1.0
    return _filled(made, fields)


def _filled(made: Rods, fields: Mapping[str, ArrayLike]) -> Rods:
    """The rods with these fields written into them, checked; raises `BadCondition` for a shape or value that does not fit."""
    for name, value in fields.items():
        view = made.field(name)
        given = np.asarray(value, dtype=np.float64)
        try:
            view[...] = given
        except ValueError as error:
            raise BadCondition(f"{name}: shape {given.shape} does not broadcast to {view.shape}") from error
    return made.check()
