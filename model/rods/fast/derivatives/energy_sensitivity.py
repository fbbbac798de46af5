"""What the energy stored in rods does with a parameter: by the virtual work of what moves, no differences.

Stored is W(u - u*, v - v*; K) per length. With orientation and position as functions of the share z of an element,
u = R^T R_z / l and v = R^T p_z / l, so that, all else being in equilibrium under the internal N and M and the load f,
    dU = [N . dp + M . dphi] (tip minus base) + sum l int f . dp dz
         + sum int l (k . dK k / 2 - m . du* - n . dv*) + (W - m . u - n . v) dl dz
with k the elastic strains, dp and dphi at fixed z. Integrals are by Gauss's rule over each element.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from model.errors import BadCondition
from model.rods.description import Rods
from model.rods.fast.derivatives.sensitivity import sensitivities
from model.rods.fast.method import FAST, Fast
from model.rods.fast.stations import GAUSS, stations
from model.rods.solution import Solution
from model.rotation import to_local

Array = NDArray[np.float64]


def energy_sensitivities(rods: Rods, solution: Solution, directions: Array, method: Fast = FAST) -> Array:
    """(n, k) J per unit of each parameter: derivative of `energy` along directions (n or 1, k, form.width).

    NaN where a rod was not solved; raises `BadCondition` where hyperelastic terms are used, for which this is not offered.
    """
    form, length = rods.form, rods.field("length")
    if form.full and (rods.field("series").any() or form.view(directions, "series").any()):
        raise BadCondition("series: must be zero in rods and directions; dU is available for linear sections only")
    n, elements = length.shape
    places, weights = np.polynomial.legendre.leggauss(GAUSS)
    z, weights = 0.5 * (1.0 + places), 0.5 * weights
    starts = np.cumsum(length, axis=1) - length
    inner = (starts[:, :, None] + length[:, :, None] * z).reshape(n, elements * GAUSS)
    whole = rods.whole_length[:, None]
    arcs = np.concatenate([np.minimum(inner, whole), np.zeros((n, 1)), whole], axis=1)
    at = stations(rods, solution, arcs, method)
    change = sensitivities(
        rods, solution, directions, method, arc_lengths=np.minimum(inner, whole), attached=elements * GAUSS
    )
    ends = np.einsum("ni,nki->nk", at.force[:, -1], change.tip)
    ends += np.einsum("ni,nki->nk", at.moment[:, -1], change.rotation)
    ends -= np.einsum("ni,nki->nk", at.moment[:, -2], change.base_rotation)
    moved = change.position.reshape(n, -1, elements, GAUSS, 3)
    loads = np.einsum("ne,g,nei,nkegi->nk", length, weights, rods.field("load"), moved)
    turn = at.orientation[:, :-2].reshape(n, elements, GAUSS, 4)
    m = to_local(turn, at.moment[:, :-2].reshape(n, elements, GAUSS, 3))
    force = to_local(turn, at.force[:, :-2].reshape(n, elements, GAUSS, 3))
    return np.asarray(ends + loads + _at_fixed_strain(rods, directions, m, force, z, weights))


def _at_fixed_strain(rods: Rods, directions: Array, m: Array, force: Array, z: Array, weights: Array) -> Array:
    """(n, k) J: what a parameter does to the energy of rods whose shape over the shares z stays as it is."""
    form, length = rods.form, rods.field("length")
    bend, stretch = rods.field("bend_stiffness")[:, :, None], rods.field("stretch_stiffness")[:, :, None]
    curvature, strain = m / bend, force / stretch
    density = 0.5 * (m * curvature + force * strain).sum(-1)
    work = (m * (curvature + _rest(rods.field, form.full, z))).sum(-1)
    work += (force * (strain + rods.field("rest_strain")[:, :, None])).sum(-1)

    def by(name: str) -> Array:
        return form.view(directions, name)

    per_length = 0.5 * np.einsum("negi,nkei->nkeg", curvature**2, by("bend_stiffness"))
    per_length += 0.5 * np.einsum("negi,nkei->nkeg", strain**2, by("stretch_stiffness"))
    per_length -= np.einsum("negi,nkegi->nkeg", m, _rest(by, form.full, z))
    per_length -= np.einsum("negi,nkei->nkeg", force, by("rest_strain"))
    total = np.einsum("nkeg,ne,g->nk", per_length, length, weights)
    return np.asarray(total + np.einsum("neg,nke,g->nk", density - work, by("length"), weights))


def _rest(field: Callable[[str], Array], full: bool, z: Array) -> Array:
    """(..., E, GAUSS, 3) 1/m: u*, or its change, at the shares z of each element."""
    rest = field("rest_curvature")[..., None, :] + np.zeros((len(z), 1))
    if full:
        rises = field("curvature_rise")
        for power in (1, 2, 3):
            rest = rest + z[:, None] ** power * rises[..., None, 3 * power - 3 : 3 * power]
    return np.asarray(rest)
