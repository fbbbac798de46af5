"""Sensitivities of a solution to any parameter of the rods, by implicit differentiation.

A parameter is a direction: how every number of a rod's row changes with it. `Rods.form.view` names the columns, so
that d(row)/d(parameter) of a law outside the solver (a pressure law, a composite section, a spine length) is written
field by field:

    d = np.zeros((1, 1, batch.form.width))
    batch.form.view(d, "bend_stiffness")[0, 0, INNER] = stiffness_by_modulus
    found = sensitivities(batch, solve(batch), d)

Rods with n rows of their own directions have d of shape (n, k, width).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.errors import BadCondition
from model.statics import differences
from model.statics.problem import Rods
from model.statics.solver import DEFAULT, Accuracy, Solution, room_for_terms, share_out

Array = NDArray[np.float64]

SHARE_OF_SIZE = 2e-5
"""A direction is followed until the first of its numbers has changed by this share of its size."""


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of n solutions by k parameters, mount frame, per unit of the parameter; NaN where not solved."""

    values: Array
    """(n, k, differences.OUTPUTS)."""

    @property
    def tip(self) -> Array:
        """(n, k, 3) m."""
        return self.values[..., differences.BY_TIP : differences.BY_TIP + 3]

    @property
    def rotation(self) -> Array:
        """(n, k, 3) rad: rotation vector of the tip frame, so that dR = [rotation]x R."""
        return self.values[..., differences.BY_TURN : differences.BY_TURN + 3]

    @property
    def base_force(self) -> Array:
        """(n, k, 3) N."""
        return self.values[..., differences.BY_FORCE : differences.BY_FORCE + 3]

    @property
    def base_moment(self) -> Array:
        """(n, k, 3) N m."""
        return self.values[..., differences.BY_MOMENT : differences.BY_MOMENT + 3]


def sensitivities(
    rods: Rods, solution: Solution, directions: Array, accuracy: Accuracy = DEFAULT, *, cores: int = 1
) -> Sensitivities:
    """Derivatives of `solution` (of these rods, at this accuracy) along directions (n or 1, k, form.width)."""
    n, form = len(rods), rods.form
    given = np.ascontiguousarray(directions, dtype=np.float64)
    if given.ndim != 3 or given.shape[0] not in (1, n) or given.shape[2] != form.width:
        raise BadCondition(f"directions: shape {given.shape}, must be (1 or {n}, parameters, {form.width})")
    if not np.isfinite(given).all():
        raise BadCondition("directions: must be finite")
    if len(solution.status) != n:
        raise BadCondition(f"solution: of {len(solution.status)} rods, must be of {n}")
    nudges = SHARE_OF_SIZE / np.maximum((np.abs(given) / natural_sizes(rods)).max(axis=2), 1e-300)
    out = np.empty((n, given.shape[1], differences.OUTPUTS))

    def part(rows: slice) -> None:
        own = rows if len(given) > 1 else slice(0, 1)
        differences.differentiate(
            rods.values[rows],
            form.head,
            form.block,
            *room_for_terms(form),
            form.springs,
            accuracy.divisions,
            given[own],
            nudges[own],
            solution.values[rows],
            out[rows],
        )

    share_out(part, n, cores)
    out[~solution.ok] = np.nan
    return Sensitivities(out)


def natural_sizes(rods: Rods) -> Array:
    """(width,) the size a number of each column has to have before it matters, from length and bending stiffness."""
    form = rods.form
    if not len(rods):
        return np.ones(form.width)
    length = float(np.median(rods.whole_length))
    bend = float(np.median(rods.field("bend_stiffness")[..., :2]))
    units = {
        "tip_force": bend / length**2,
        "tip_moment": bend / length,
        "dead_force": bend / length**2,
        "dead_moment": bend / length,
        "base_compliance": length / bend,
        "spring_stiffness": bend / length**3,
        "spring_origin": length,
        "spring_softness": length,
        "length": length,
        "bend_stiffness": bend,
        "stretch_stiffness": float(np.median(rods.field("stretch_stiffness"))),
        "rest_curvature": 1 / length,
        "curvature_rise": 1 / length,
        "load": bend / length**3,
    }
    sizes = np.ones(form.width)
    for name in form.fields():
        form.view(sizes, name)[...] = units.get(name, 1.0)
    # Small softnesses and short elements must not be stepped over.
    smallest = np.abs(rods.values).min(axis=0)
    kept = np.zeros(form.width, bool)
    for name in ("bend_stiffness", "stretch_stiffness", "spring_softness"):
        if name in form.fields():
            form.view(kept, name)[...] = True
    return np.where(kept & (smallest > 0), np.minimum(sizes, smallest), sizes)
