"""How one rod of the forward model is laid out as a row of numbers, and what comes back as columns of a result.

A row is one of `model.rods` with four springs at the tip and every kind of term; only its rest strain is counted from an
unstretched section. Each piece of the body is two elements, one that holds the spine and one beyond its end, either of them
empty; without spine only the first piece is. A change of parameters is a row of the same layout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from model.body import Body
from model.rods import Form
from model.rods import columns as col

SPRING_COUNT = 4
SPRINGS, SPRING_WIDTH = col.HEAD, col.SPRING
ELEMENTS, ELEMENT_WIDTH = col.HEAD + col.SPRING * SPRING_COUNT, col.BLOCK

TIP, ORIENTATION, JOINT, BASE, STRAIN, MARKERS = 0, 3, 7, 11, 15, 17
"""Columns of a result: tip (m), quaternions of the tip, of the spine's end and of the base, mean axial strain of the
two parts, then positions (m) at the arc lengths asked for. All in the base frame."""

INNER, OUTER = 0, 1
"""Parts of the body: from the base to the spine's end, and from there to the tip."""


@dataclass(frozen=True)
class Layout:
    """Which elements the rod of one robot has, base to tip."""

    pieces: tuple[int, ...]
    """The piece of the body that each belongs to."""
    parts: tuple[int, ...]
    """INNER or OUTER."""
    tied: Mapping[int, Mapping[int, float]]
    """Column -> columns that are always this many times as large: sections are round, and silicone without spine is the same
    all along the body."""

    @cached_property
    def form(self) -> Form:
        """That of the rods."""
        return Form(elements=len(self.pieces), springs=SPRING_COUNT)

    @property
    def width(self) -> int:
        """Columns of a row."""
        return self.form.width

    @cached_property
    def follows(self) -> Mapping[int, tuple[int, float]]:
        """Column that is tied -> the one that it follows, and how many times that it is."""
        return {other: (column, factor) for column, others in self.tied.items() for other, factor in others.items()}

    @cached_property
    def moved(self) -> Mapping[int, Mapping[int, float]]:
        """`tied`, and column of what actuators make of a rest strain -> column of that rest strain."""
        rises = ((col.ACTIVE + 3 * power + k, col.RISE + 3 * (power - 1) + k) for power in (1, 2, 3) for k in (0, 1))
        rests = (*((col.ACTIVE + k, col.REST_CURVATURE + k) for k in (0, 1)), (col.ACTIVE + 2, col.REST_STRAIN + 2), *rises)
        return {**self.tied, **{e + made: {e + rest: 1.0} for e in self.elements for made, rest in rests}}

    @cached_property
    def elements(self) -> tuple[int, ...]:
        """First column of each element."""
        return tuple(ELEMENTS + ELEMENT_WIDTH * e for e in range(len(self.pieces)))

    @cached_property
    def of_part(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Numbers of the elements of the inner and of the outer part."""
        inner, outer = (tuple(e for e, part in enumerate(self.parts) if part == own) for own in (INNER, OUTER))
        return inner, outer


def layout_of(body: Body, spine: bool) -> Layout:
    """Elements of a body of k pieces, 2 k with spine and k + 1 without, and which of their columns are `tied`.

    Sections are round: bending about y is as stiff as about x, torsion J / I times, and the hyperelastic strain term is half the
    coupling. Inner elements hold the spine and are tied to nothing else. Outer ones are silicone alone: their columns are those
    of the `first` times the ratio of the sections' I (bending), A (stretching), r^2 (hyperelastic curvature) or weighing area.
    """
    order = [(k, part) for k in range(len(body)) for part in (INNER, OUTER) if spine or part == OUTER or k == 0]
    pieces, parts = zip(*order, strict=True)
    first = ELEMENTS + ELEMENT_WIDTH * order.index((0, OUTER))
    tied: dict[int, dict[int, float]] = {first + col.BEND: {}, first + col.STRETCH: {}, first + col.STRETCH + 2: {}}
    tied |= {first + col.SERIES: {}, first + col.SERIES + 1: {}, **{first + col.LOAD + k: {} for k in range(3)}}
    for e, (piece, part) in enumerate(order):
        column = ELEMENTS + ELEMENT_WIDTH * e  # the element's first column
        twisting = float(body.polar[piece] / body.second[piece])  # J / I
        if part == INNER:
            tied[column + col.BEND] = {column + col.BEND + 1: 1.0, column + col.BEND + 2: twisting}
            tied[column + col.STRETCH] = {column + col.STRETCH + 1: 1.0}
            tied[column + col.SERIES + 1] = {column + col.SERIES + 2: 0.5}
            continue
        bend, axial = (float(x[piece] / x[0]) for x in (body.second, body.area))
        strained = float(body.outer_radius[piece] / body.outer_radius[0]) ** 2
        tied[first + col.BEND] |= {column + col.BEND: bend, column + col.BEND + 1: bend, column + col.BEND + 2: bend * twisting}
        tied[first + col.STRETCH] |= {column + col.STRETCH: axial, column + col.STRETCH + 1: axial}
        tied[first + col.STRETCH + 2] |= {column + col.STRETCH + 2: axial}
        tied[first + col.SERIES] |= {column + col.SERIES: strained}
        tied[first + col.SERIES + 1] |= {column + col.SERIES + 1: 1.0, column + col.SERIES + 2: 0.5}
        if body.weight_area[0] > 0:
            weight = float(body.weight_area[piece] / body.weight_area[0])
            for k in range(3):
                tied[first + col.LOAD + k] |= {column + col.LOAD + k: weight}
    tied[col.BASE_COMPLIANCE] = {col.BASE_COMPLIANCE + 1: 1.0}
    # no column is tied to itself
    to_others = {c: {o: f for o, f in times.items() if o != c} for c, times in tied.items()}
    return Layout(pieces, parts, {c: times for c, times in to_others.items() if times})
