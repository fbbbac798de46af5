"""Sensitivities of a solution to any parameter of the rods, by implicit differentiation.

A parameter is a direction: how every number of a rod's row changes with it. `Rods.form.view` names the columns, so that
d(row)/d(parameter) of a law outside the solver (a pressure law, a composite section, a spine length) is written field by field:

    d = np.zeros((1, 1, batch.form.width))
    batch.form.view(d, "bend_stiffness")[0, 0, INNER] = stiffness_by_modulus
    found = sensitivities(batch, solve(batch), d)

Rods with n rows of their own directions have d of shape (n, k, width).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from model.arrays import Array
from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.fast.derivatives import implicit
from model.rods.fast.method import FAST, Fast, share_out, steps_of
from model.rods.solution import Solution


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of n solutions by k parameters, mount frame, per unit of the parameter; NaN where not solved."""

    values: Array
    """(n, k, outputs), see `implicit`."""
    strains: int
    """Elements whose mean strain is in it."""

    @property
    def tip(self) -> Array:
        """(n, k, 3) m."""
        return self._three(implicit.BY_TIP)

    @property
    def rotation(self) -> Array:
        """(n, k, 3) rad: rotation vector of the tip frame, so that dR = [rotation]x R."""
        return self._three(implicit.BY_ROTATION)

    @property
    def base_force(self) -> Array:
        """(n, k, 3) N."""
        return self._three(implicit.BY_BASE_FORCE)

    @property
    def base_moment(self) -> Array:
        """(n, k, 3) N m."""
        return self._three(implicit.BY_BASE_MOMENT)

    @property
    def base_rotation(self) -> Array:
        """(n, k, 3) rad, as `rotation`."""
        return self._three(implicit.BY_BASE_TURN)

    @property
    def strain(self) -> Array:
        """(n, k, elements) 1: mean axial strain of each element, where `strain` was asked for."""
        return self.values[..., implicit.OUTPUTS : implicit.OUTPUTS + self.strains]

    @property
    def position(self) -> Array:
        """(n, k, stations, 3) m."""
        return self._stations[..., :3]

    @property
    def turn(self) -> Array:
        """(n, k, stations, 3) rad: rotation vectors of the stations, as `rotation`."""
        return self._stations[..., 3:]

    def _three(self, at: int) -> Array:
        return self.values[..., at : at + 3]

    @property
    def _stations(self) -> Array:
        found = self.values[..., implicit.OUTPUTS + self.strains :]
        return found.reshape(*found.shape[:2], found.shape[2] // implicit.OF_STATION, implicit.OF_STATION)


def sensitivities(
    rods: Rods,
    solution: Solution,
    directions: Array,
    method: Fast = FAST,
    *,
    arc_lengths: ArrayLike = (),
    strain: bool = False,
    attached: int = 0,
) -> Sensitivities:
    """Derivatives of `solution` (of these rods, by this method) along directions (n or 1, k, form.width).

    `arc_lengths` (s,) or (n, s) in m from the base asks for stations, `strain` for the mean strain of every element.
    Stations stay at their arc length when lengths change; the first `attached` go with their share of an element (the
    end of a spine does). Raises `BadCondition` for directions, arc lengths or a solution that do not fit the rods.
    """
    n, form = len(rods), rods.form
    changes = np.ascontiguousarray(directions, dtype=np.float64)
    if changes.ndim != 3 or changes.shape[0] not in (1, n) or changes.shape[2] != form.width:
        raise BadCondition(f"directions: shape {changes.shape}, must be (1 or {n}, parameters, {form.width})")
    if not np.isfinite(changes).all():
        raise BadCondition("directions: must be finite")
    if len(solution.status) != n:
        raise BadCondition(f"solution: of {len(solution.status)} rods, must be of {n}")
    arcs = rods.arcs(arc_lengths)
    outputs = implicit.OUTPUTS + (form.elements if strain else 0) + implicit.OF_STATION * arcs.shape[1]
    fixed_steps = steps_of(rods, method.steps)
    out = np.empty((n, changes.shape[1], outputs))

    def part(rows: slice) -> None:
        implicit.differentiate(
            rods.values[rows],
            form.springs,
            (float(method.divisions), fixed_steps[rows]),
            (changes[rows if len(changes) > 1 else slice(0, 1)], arcs[rows], attached, strain),
            solution.values[rows],
            out[rows],
        )

    share_out(part, n, method.cores)
    out[~solution.converged] = np.nan
    return Sensitivities(out, form.elements if strain else 0)
