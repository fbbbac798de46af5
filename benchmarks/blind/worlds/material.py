"""Stress in the sections: elastic, other fibre laws, creep, friction of the spine, and the gas that pulls inside.

creep      overstress of a branch: q' = xi' - q / tau, exact for strains that change evenly within a step
friction   z of an element follows the change dy of (u1, u2, v3 / rho): z -> d - (d - z) exp(-|dy| / yield), d = dy / |dy| (Dahl);
           or z' = (1 - |z|^2 [z.dy > 0]) dy / yield (Bouc and Wen, n = 2), or a slider that slips at |z| = 1 (Prandtl)
gas        -P A e3 and its moment about the axis, of the share that the walls balance
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .body import Slip, WorldBody
from .robot import AREA, FULL, INNER, OUTER, SECOND

Array = NDArray[np.float64]

REFERENCE = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
ARM = 0.03
"""m: axial strain over this is the curvature at which the same slip begins."""
SUBSTEPS = 6
"""Of the elements without a closed form."""


def strips() -> tuple[Array, Array]:
    """Places y (m) and areas (m^2) of strips across the annulus whose sum and second moment are exactly its own."""
    y, w = np.polynomial.legendre.leggauss(24)
    y, w = y * OUTER, w * OUTER
    width = 2 * (np.sqrt(np.maximum(OUTER**2 - y**2, 0)) - np.sqrt(np.maximum(INNER**2 - y**2, 0)))
    y, area = y[y > 0], 2 * (w * width)[y > 0]
    area *= AREA / area.sum()
    return y * np.sqrt(SECOND / np.sum(area * y * y)), area


Y, STRIP_AREA = strips()


@dataclass
class Gas:
    """What the gas does inside the sections: (n, N, 6) stress that it takes, and mean of the three highest pressures (n,)."""

    taken: Array
    pressures: Array


class SectionStates:
    """Stress of all lanes' sections with their memory."""

    def __init__(self, body: WorldBody) -> None:
        self.body = body
        self.linear = body.stiff_silicone + body.stiff_spine
        n, count = body.h.shape
        self.strain: Array | None = None
        """At the last step; None before the first."""
        self.over = [np.zeros((n, count, 6)) for _ in body.creep]
        self.speed = np.zeros((n, count))
        """Of slipping in the last step, 1/(m s); taken for this one's where it matters."""
        self.play = [np.zeros((n, count, 3)) for _ in body.slips]

    @property
    def remembers(self) -> bool:
        """Whether the way matters."""
        return bool(self.body.creep or self.body.slips)

    def stress(self, xi: Array, gas: Gas, dt: float) -> tuple[Array, Array]:
        """Stress (n, N, 6) and tangent (n, N, 6, 6) at strain xi after a step of dt seconds."""
        body = self.body
        e = xi - REFERENCE - body.rest
        sigma = self.linear * e
        tangent = self.linear[..., None] * np.eye(6)
        if body.coupled is not None:
            sigma = sigma + np.einsum("...ij,...j->...i", body.coupled, e)
            tangent = tangent + body.coupled
        for fibre in body.fibres:
            self._fibres(fibre.law, fibre.weight, e, sigma, tangent)
        if body.stiffening is not None:
            factor = body.stiffening(e, gas.pressures)[..., None]
            sigma, tangent = sigma * factor, tangent * factor[..., None]
        if self.strain is not None:
            change = xi - self.strain
            for (share, tau), q in zip(body.creep, self.over, strict=True):
                kept, fresh = _relaxation(dt, tau)
                k = share[:, None, None] * body.stiff_silicone
                sigma = sigma + k * (kept * q + fresh * change)
                tangent = tangent + (fresh * k)[..., None] * np.eye(6)
            for slip, z in zip(body.slips, self.play, strict=True):
                self._friction(slip, z, change, gas, dt, sigma, tangent)
        return sigma - gas.taken, tangent

    def commit(self, xi: Array, gas: Gas, dt: float) -> None:
        """Move the memory on to strain xi; the first time it only learns where it is."""
        if self.strain is not None:
            change = xi - self.strain
            for i, (_, tau) in enumerate(self.body.creep):
                kept, fresh = _relaxation(dt, tau)
                self.over[i] = kept * self.over[i] + fresh * change
            for i, slip in enumerate(self.body.slips):
                self.speed = np.linalg.norm(_slipping(change), axis=-1) / max(dt, 1e-6)
                self.play[i] = _slid(slip, self.play[i], _slipping(change), dt)[0]
        self.strain = xi.copy()

    def _fibres(self, law, weight, e, sigma, tangent) -> None:  # type: ignore[no-untyped-def]
        body = self.body
        bend = e[..., 3:5]
        kappa = np.sqrt(np.sum(bend * bend, axis=-1)) + 1e-9
        direction = bend / kappa[..., None]
        outer, inner = e[..., 2, None] + kappa[..., None] * Y, e[..., 2, None] - kappa[..., None] * Y
        (fo, so), (fi, si) = law(outer), law(inner)
        half = 0.5 * STRIP_AREA
        # share of silicone in the section and its size
        axial = weight[:, None] * body.stiff_silicone[..., 2] / AREA
        bending = weight[:, None] * body.stiff_silicone[..., 3] / SECOND
        dn = np.sum(half * (fo + fi - outer - inner), axis=-1)
        dm = np.sum(half * Y * (fo - fi - outer + inner), axis=-1)
        nn = np.sum(half * (so + si - 2), axis=-1)
        nm = np.sum(half * Y * (so - si), axis=-1)
        mm = np.sum(half * Y * Y * (so + si - 2), axis=-1)
        sigma[..., 2] += axial * dn
        sigma[..., 3:5] += (bending * dm)[..., None] * direction
        tangent[..., 2, 2] += axial * nn
        tangent[..., 2, 3:5] += (axial * nm)[..., None] * direction
        tangent[..., 3:5, 2] += (bending * nm)[..., None] * direction
        along = direction[..., :, None] * direction[..., None, :]
        tangent[..., 3:5, 3:5] += (bending * mm)[..., None, None] * along
        tangent[..., 3:5, 3:5] += (bending * dm / kappa)[..., None, None] * (np.eye(2) - along)

    def _friction(self, slip: Slip, z: Array, change: Array, gas: Gas, dt: float, sigma: Array, tangent: Array) -> None:
        dy = _slipping(change)
        moved, slope = _slid(slip, z, dy, dt)
        level = slip.level
        if slip.by_pressure:
            level = level * (1 + slip.by_pressure * gas.pressures.max(axis=1) / FULL)[:, None]
        if slip.rate:
            level = level * (1 + 0.4 * np.exp(-((self.speed / slip.rate) ** 2)))
        sigma[..., 3:5] += level[..., None] * moved[..., :2]
        sigma[..., 2] += level / ARM * moved[..., 2]
        k = level * slope
        tangent[..., 3, 3] += k
        tangent[..., 4, 4] += k
        tangent[..., 2, 2] += k / ARM**2


def _relaxation(dt: float, tau: float) -> tuple[float, float]:
    x = max(dt, 1e-9) / tau
    kept = float(np.exp(-x))
    return kept, (1 - kept) / x if x > 1e-6 else 1.0


def _slipping(change: Array) -> Array:
    return np.stack([change[..., 3], change[..., 4], change[..., 2] / ARM], axis=-1)


def _slid(slip: Slip, z: Array, dy: Array, dt: float) -> tuple[Array, Array]:
    """Where the element comes to, and about how stiff it is there (per level)."""
    size = np.linalg.norm(dy, axis=-1, keepdims=True)
    if slip.rule == "dahl":
        kept = np.exp(-size / slip.yields)
        goal = dy / np.maximum(size, 1e-15)
        return goal - (goal - z) * kept, kept[..., 0] / slip.yields
    if slip.rule == "prandtl":
        tried = z + dy / slip.yields
        over = np.maximum(np.linalg.norm(tried, axis=-1, keepdims=True), 1.0)
        return tried / over, np.where(over[..., 0] > 1, 0.2, 1.0) / slip.yields
    step = dy / (SUBSTEPS * slip.yields)
    for _ in range(SUBSTEPS):
        middle = z + 0.5 * _bouc_wen(z, step)
        z = z + _bouc_wen(middle, step)
    return z, np.full(size.shape[:-1], 0.6) / slip.yields


def _bouc_wen(z: Array, step: Array) -> Array:
    along = np.sum(z * step, axis=-1, keepdims=True)
    return np.asarray(step - np.maximum(along, 0.0) * z)
