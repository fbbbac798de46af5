"""The body of each lane before it is loaded: mesh, section stiffness, rest shape, weight, base; and where effects act on it.

Paper: E_eq by volume over the part with spine, on the annulus; K = (GA, GA, EA, EI, EI, 2 EI); weight of the body, mass at
the tip. An effect changes the body where it is named in `build`, in this order; without size it changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .equilibrium import Field
from .frames import turn
from .robot import AREA, DENSITY, GRAVITY, MODULUS, NOMINAL_VACUUM, SECOND, SHEAR, SPINE_AREA, SPINE_LENGTHS, SPINE_MODULI, Lanes

Array = NDArray[np.float64]

SEGMENTS = 20
ORDER = (
    "spine_length_offset", "vacuum_leak", "spine_shear", "body_modulus", "area_moment", "spine_slip", "viscoelastic",
    "hyperelastic", "precurvature", "self_weight", "tether_load", "contact", "base_tilt", "base_compliance",
)  # fmt: skip
"""Effects that change the body, in the order in which they act; causes outside the catalogue follow."""

Change = Callable[["WorldBody", Array], None]
"""An effect of given sizes (n,), in plausible scales times the form's own scale, changes a body."""


@dataclass
class Slip:
    """Friction elements of the spine: `level` (n, N) N m, `yields` 1/m, and the rule by which they give."""

    level: Array
    yields: float
    rule: str
    rate: float = 0.0
    """1/(m s) over which a rate-dependent level falls."""
    by_pressure: float = 0.0
    """Growth of the level at full pressure."""


@dataclass
class Fibre:
    """Another law of the silicone's fibres: stress / E over strain and its derivative, at `weight` (n,)."""

    law: Callable[[Array], tuple[Array, Array]]
    weight: Array


@dataclass
class WorldBody:
    """n lanes of N segments; effects write into it. Diagonals of stiffness are (v1, v2, v3, u1, u2, u3)."""

    lanes: Lanes
    segments: int
    true_length: Array
    """(n,) m of spine in the body."""
    modulus_length: Array
    """(n,) m that decides on the spine's apparent modulus."""
    h: Array = field(init=False)
    s: Array = field(init=False)
    """(n, N) m, middle of the segments."""
    cover: Array = field(init=False)
    """(n, N) 1 where there is spine."""
    silicone_axial: Array = field(init=False)
    silicone_bending: Array = field(init=False)
    silicone_shear: Array = field(init=False)
    """(n, N) Pa: E for stretch, E for bending, G."""
    spine_e: Array = field(init=False)
    spine_g: Array = field(init=False)
    stiff_silicone: Array = field(init=False)
    stiff_spine: Array = field(init=False)
    """(n, N, 6)."""
    coupled: Array | None = None
    """(n, N, 6, 6) beyond the diagonals."""
    rest: Array = field(init=False)
    """(n, N, 6) strain without stress, beyond (0, 0, 1, 0, 0, 0)."""
    line: Array = field(init=False)
    """(n, N) kg/m."""
    node_mass: Array = field(init=False)
    gravity: Array = field(init=False)
    """(n, 3) m/s^2."""
    fields: list[Field] = field(default_factory=list)
    base_place: Array = field(init=False)
    base_turn: Array = field(init=False)
    give: Callable[[Array], tuple[Array, Array]] | None = None
    slips: list[Slip] = field(default_factory=list)
    creep: list[tuple[Array, float]] = field(default_factory=list)
    """Share (n,) of the silicone's stiffness and relaxation time (s) of each branch."""
    fibres: list[Fibre] = field(default_factory=list)
    stiffening: Callable[[Array, Array], Array] | None = None
    """Strains (n, N, 6) and pressures (n, 9) to a factor (n, N) of all elastic stress, outside the catalogue only."""

    def mesh(self) -> None:
        """Segments that end where the spine ends; how many there are in it depends on the length read alone."""
        n, count = len(self.lanes), self.segments
        length = self.lanes.length
        inside = np.where(self.lanes.spine > 0, np.clip(np.rint(count * self.lanes.spine / length), 1, count - 1), 0)
        inner = np.clip(self.true_length, 1e-3, length - 1e-3)
        place = np.arange(count)[None, :]
        self.cover = (place < inside[:, None]).astype(float)
        short = np.where(inside > 0, inner / np.maximum(inside, 1), 0.0)
        long = (length - np.where(inside > 0, inner, 0.0)) / (count - inside)
        self.h = np.where(self.cover > 0, short[:, None], long[:, None])
        self.s = np.cumsum(self.h, axis=1) - self.h / 2
        self.silicone_axial = np.full((n, count), MODULUS)
        self.silicone_bending = np.full((n, count), MODULUS)
        self.silicone_shear = np.full((n, count), SHEAR)
        # one node more than segments: masses and whatever else sits on frames
        self.rest = np.zeros((n, count, 6))
        self.line = np.full((n, count), DENSITY * AREA)
        self.node_mass = np.zeros((n, count + 1))
        self.node_mass[:, -1] = self.lanes.tip_mass
        self.gravity = np.tile(np.array([0.0, 0.0, GRAVITY]), (n, 1))
        self.base_place = np.zeros((n, 3))
        self.base_turn = turn(np.concatenate([self.lanes.tilt, np.zeros((n, 1))], axis=1))

    def along(self) -> Array:
        """(n, N) from 0 at the base to 1 at the tip."""
        return np.asarray(self.s / self.lanes.length[:, None])

    def nodes(self) -> Array:
        """(n, N + 1) arc length of the frames, m."""
        return np.concatenate([np.zeros((len(self.lanes), 1)), np.cumsum(self.h, axis=1)], axis=1)

    def jam(self, share: Array) -> Array:
        """Jammed stiffness at this share of the nominal vacuum, relative to nominal."""
        return np.asarray(np.maximum(share, 1e-4) ** 0.5)

    def vacuum_share(self) -> Array:
        """(n, 1) vacuum relative to nominal."""
        return np.asarray((self.lanes.vacuum / NOMINAL_VACUUM)[:, None])

    def mix(self) -> None:
        """Section by volume, eq. 10: silicone and spine on the annulus."""
        share = self.cover * SPINE_AREA / (AREA + SPINE_AREA)
        self.stiff_silicone = (1 - share)[..., None] * self.silicone_sections()
        self.stiff_spine = share[..., None] * diagonal(self.spine_g, self.spine_e, self.spine_e, AREA, SECOND)

    def silicone_sections(self) -> Array:
        """(n, N, 6) stiffness of the annulus alone."""
        return diagonal(self.silicone_shear, self.silicone_axial, self.silicone_bending, AREA, SECOND)


def diagonal(g: Array, axial: Array, bending: Array, area: float | Array, second: float | Array) -> Array:
    """(GA, GA, EA, EI, EI, 2 EI)."""
    return np.stack([g * area, g * area, axial * area, bending * second, bending * second, 2 * bending * second], axis=-1)


def table_modulus(length: Array) -> Array:
    """Apparent modulus of the spine (Pa) at a length (m)."""
    return np.asarray(np.interp(length, SPINE_LENGTHS, SPINE_MODULI))


def build(lanes: Lanes, changes: Mapping[str, Change], segments: int = SEGMENTS) -> WorldBody:
    """The body of each lane with its effects. `changes` by effect; sizes are the lanes' own."""

    def act(effect: str) -> None:
        size = lanes.sizes.get(effect)
        if size is not None and effect in changes and np.any(size):
            changes[effect](body, size)

    read = lanes.spine + np.where(lanes.spine > 0, lanes.grown, 0.0)
    body = WorldBody(lanes, segments, read.copy(), read.copy())
    act("spine_length_offset")
    body.mesh()
    share = body.vacuum_share()
    jam = body.jam(share) * lanes.jammed[:, None]
    body.spine_e = table_modulus(body.modulus_length)[:, None] * jam * np.ones_like(body.h)
    body.spine_g = body.spine_e * (SHEAR / MODULUS)
    for effect in ("vacuum_leak", "spine_shear", "body_modulus"):
        act(effect)
    body.mix()
    for effect in ORDER[4:]:
        act(effect)
    for effect in changes:
        if effect not in ORDER:
            act(effect)
    return body
