"""Equilibrium of discrete rods: section frames joined by segments of constant strain, found by Newton's method.

N segments of lengths h join N + 1 frames H_i. The strain of a segment is that of the screw between its frames,

    xi = log(H_i^-1 H_(i+1)) / h = (v, u),     energy = sum h U(xi) - work of the loads,

with the stress sigma = dU/dxi = (n, m) in the section's frame. A virtual motion eta of the frames in their own axes gives the
out-of-balance wrench of each; stationary energy, or balance where loads follow the tip, is where all vanish:

    G_i = front_(i-1)^T sigma_(i-1) - behind_i^T sigma_i - W_i,      `frames.log_derivatives`.

Newton's matrix is banded (6 unknowns a frame, neighbours alone are joined). All rods of a batch stand behind one another in
one band. The base turns and moves by what it gives under its wrench: log(B^-1 H_0) = give(wrench).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from .frames import adjoint, apply, cross, hat, log_derivatives, rotation_vector, screw, transposed, twist

Array = NDArray[np.float64]

MOST_STEPS = 40
LARGEST = np.array([0.03] * 3 + [0.3] * 3)
"""Largest correction in one step, m and rad: keeps Newton on the branch it started on."""
BAND = 11
UP = np.array([0.0, 0.0, 1.0])


class NoWorldEquilibrium(RuntimeError):
    """A rod of the batch found no equilibrium."""


@dataclass
class Shape:
    """Frames of n rods: positions r (n, N + 1, 3) in m, rotations (n, N + 1, 3, 3)."""

    r: Array
    turns: Array

    def copy(self) -> Shape:
        """Another one."""
        return Shape(self.r.copy(), self.turns.copy())

    def strains(self, h: Array) -> Array:
        """(n, N, 6) for segments h (n, N)."""
        back = transposed(self.turns[:, :-1])
        return twist(apply(back, np.diff(self.r, axis=1)), back @ self.turns[:, 1:]) / h[..., None]


Material = Callable[[Array], tuple[Array, Array]]
"""Strains (n, N, 6) to stresses (n, N, 6) and tangents (n, N, 6, 6)."""
Field = Callable[[Shape], tuple[Array, Array]]
"""A shape to forces in the world (n, N + 1, 3) and their derivatives with the positions (n, N + 1, 3, 3)."""


@dataclass
class Loads:
    """What acts on n rods, and how their bases hold them."""

    line: Array
    """(n, N, 3) N/m, spread along each segment and fixed in the world."""
    force: Array
    """(n, N + 1, 3) N, fixed in the world."""
    moment: Array
    """(n, N + 1, 3) N m, following the frames."""
    tip: Array
    """(n, 3) N, following the tip's frame."""
    fields: tuple[Field, ...]
    base: tuple[Array, Array]
    """Position (n, 3) and rotation (n, 3, 3) of the unloaded base."""
    give: Callable[[Array], tuple[Array, Array]] | None
    """Wrench (n, 6) on the base to its twist (n, 6) and derivative (n, 6, 6)."""


def straight(h: Array) -> Shape:
    """Rods along z."""
    n, count = h.shape
    r = np.zeros((n, count + 1, 3))
    r[:, 1:, 2] = np.cumsum(h, axis=1)
    return Shape(r, np.broadcast_to(np.eye(3), (n, count + 1, 3, 3)).copy())


def settle(shape: Shape, h: Array, material: Material, loads: Loads) -> Shape:
    """The equilibrium next to `shape`. Raises `NoWorldEquilibrium`."""
    shape = shape.copy()
    for _ in range(MOST_STEPS):
        residual, band = _system(shape, h, material, loads)
        try:
            step = -solve_banded((BAND, BAND), band, residual.reshape(-1), overwrite_ab=True, check_finite=False)
        except np.linalg.LinAlgError as e:
            raise NoWorldEquilibrium("a rod of the batch is on the point of buckling") from e
        step = step.reshape(residual.shape)
        if not np.all(np.isfinite(step)):
            break
        largest = np.abs(step / LARGEST).max(axis=(1, 2))
        step /= np.maximum(largest, 1.0)[:, None, None]
        p, r = screw(step)
        shape.r += apply(shape.turns, p)
        shape.turns = shape.turns @ r
        # each correction, in units of `LARGEST`, is a hundred times smaller than the one before
        if largest.max() < 1e-6:
            return shape
    raise NoWorldEquilibrium(f"no equilibrium in {MOST_STEPS} steps")


def _system(shape: Shape, h: Array, material: Material, loads: Loads) -> tuple[Array, Array]:
    """Out-of-balance wrenches (n, N + 1, 6) and Newton's matrix as a band."""
    xi = shape.strains(h)
    sigma, tangent = material(xi)
    sigma = sigma + _within(shape, h, loads, xi, sigma, tangent)
    behind, front = log_derivatives(xi * h[..., None])
    bt, ft = transposed(behind), transposed(front)
    pushed, pulled = apply(bt, sigma), apply(ft, sigma)
    # how the wrenches turn with the segment's own shape, first order of the series
    bend = 0.5 * _wrench_derivative(sigma)
    c = tangent / h[..., None, None]
    right, left = ft @ c + bend, bt @ c - bend
    n, count = h.shape
    g = np.zeros((n, count + 1, 6))
    g[:, 1:] += pulled
    g[:, :-1] -= pushed
    diag = np.zeros((n, count + 1, 6, 6))
    diag[:, 1:] += right @ front
    diag[:, :-1] += left @ behind
    below = -(right @ behind)
    above = -(left @ front)
    _external(shape, h, loads, g, diag)
    _base(shape, loads, pushed[:, 0], left[:, 0], behind[:, 0], front[:, 0], g, diag, above)
    return g, _band(diag, below, above)


def _within(shape: Shape, h: Array, loads: Loads, xi: Array, sigma: Array, tangent: Array) -> Array:
    """What is missing of a segment's stress when its strain is taken as constant, to the fourth order in h.

    Balance says how the strain changes along it, xi' = C^-1 (ad(xi)^T sigma - (f, 0)). Rotations do not commute, which leaves
    h^2 / 12 [xi', xi] (Magnus' second term) of the strain, and as much of the wrenches' way to the ends.
    """
    stiff = np.diagonal(tangent, axis1=-2, axis2=-1)
    turned = _wrench_derivative(sigma)
    change = apply(turned, xi)
    back = transposed(shape.turns)
    change[..., :3] -= 0.5 * (apply(back[:, :-1], loads.line) + apply(back[:, 1:], loads.line))
    change = change / stiff
    return np.asarray((h * h / 12)[..., None] * (stiff * apply(adjoint(change), xi) + apply(turned, change)))


def _wrench_derivative(sigma: Array) -> Array:
    """B with ad(x)^T sigma = B x."""
    out = np.zeros((*sigma.shape, 6))
    out[..., :3, 3:] = out[..., 3:, :3] = hat(sigma[..., :3])
    out[..., 3:, 3:] = hat(sigma[..., 3:])
    return out


def _external(shape: Shape, h: Array, loads: Loads, g: Array, diag: Array) -> None:
    half = 0.5 * h[..., None] * loads.line
    force = loads.force.copy()
    force[:, 1:] += half
    force[:, :-1] += half
    back = transposed(shape.turns)
    # a load spread over a segment bends it like its halves at the ends and a couple at each, f h^2 / 12
    for nodes, sign in ((slice(None, -1), 1.0), (slice(1, None), -1.0)):
        across = apply(back[:, nodes], half * (h / 6)[..., None])
        g[:, nodes, 3:] -= sign * cross(UP, across)
    for field in loads.fields:
        more, slope = field(shape)
        force = force + more
        diag[..., :3, :3] -= back @ slope @ shape.turns
    own = apply(back, force)
    g[..., :3] -= own
    g[..., 3:] -= loads.moment
    g[:, -1, :3] -= loads.tip
    diag[..., :3, 3:] -= hat(own)


def _base(
    shape: Shape, loads: Loads, wrench: Array, left: Array, behind: Array, front: Array, g: Array, diag: Array, above: Array
) -> None:  # fmt: skip
    """The first frame's rows: its place against what the base gives under the rod's wrench."""
    place, turned = loads.base
    back = transposed(turned)
    relative = np.concatenate([apply(back, shape.r[:, 0] - place), rotation_vector(back @ shape.turns[:, 0])], axis=-1)
    g[:, 0] = relative
    diag[:, 0] = np.eye(6)
    above[:, 0] = 0.0
    if loads.give is not None:
        given, slope = loads.give(wrench)
        g[:, 0] -= given
        # the wrench is pushed = behind^T sigma; its derivative with the two frames is -left behind and left front
        diag[:, 0] += slope @ left @ behind
        above[:, 0] = -(slope @ left @ front)


def _band(diag: Array, below: Array, above: Array) -> Array:
    """The blocks of all rods as one band: entry (row, column) at [BAND + row - column, column]."""
    n, frames = diag.shape[:2]
    band = np.zeros((2 * BAND + 1, n * frames * 6))
    start = (np.arange(n * frames) * 6).reshape(n, frames)
    for i in range(6):
        for j in range(6):
            band[BAND + i - j, start + j] = diag[..., i, j]
            band[BAND + 6 + i - j, start[:, :-1] + j] = below[..., i, j]
            band[BAND - 6 + i - j, start[:, 1:] + j] = above[..., i, j]
    return band
