"""From the regulators to the sections: chamber pressures, areas, where the chambers lie, and where their thrust acts.

Paper: force sum_i A P_i e3 and moment sum_i r_i x A P_i e3 at the tip, turning with it. Of a share w (n, N) the side walls
balance the thrust instead: the gas then takes w A P e3, and its moment, in every section.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .body import WorldBody
from .material import Gas
from .robot import AZIMUTHS, CHAMBER_AREA, PATH_RADIUS

Array = NDArray[np.float64]

ORDER = (
    "pressure_offset", "pressure_deadband", "chamber_ballooning", "chamber_azimuth", "chamber_twist", "chamber_thrust",
)  # fmt: skip


@dataclass
class GasChambers:
    """The chambers of n lanes; effects write into it."""

    body: WorldBody
    azimuths: Array
    """(n, 9) rad."""
    radius: Array
    """(n, 9) m from the axis."""
    aside: Array
    """(n, 2) m by which the pattern lies off the axis."""
    winding: Array
    """(n, N) rad by which the chambers have turned about the axis."""
    on_walls: Array
    """(n, N) share of the thrust that the side walls balance."""
    pressures: list[Callable[[Array], Array]] = field(default_factory=list)
    """What is in the chambers, (n, 9) Pa from what the regulators say, one after another; called once a step."""
    areas: list[Callable[[Array], Array]] = field(default_factory=list)
    """Factors of the effective area from the pressures."""

    def act(self, regulator: Array) -> tuple[Gas, Array, Array]:
        """Gas in the sections, follower force at the tip (n, 3) and follower moments at the frames (n, N + 1, 3)."""
        n, count = self.body.h.shape
        p = np.broadcast_to(regulator, (n, len(regulator))).copy()
        for law in self.pressures:
            p = law(p)
        force = p * CHAMBER_AREA * self.body.lanes.area_factor[:, None]
        for law in self.areas:
            force = force * law(p)
        angle = self.azimuths + self.body.lanes.roll[:, None]
        thrust = force.sum(axis=1)
        mx = np.sum(force * (self.radius * np.sin(angle) + self.aside[:, 1:]), axis=1)
        my = -np.sum(force * (self.radius * np.cos(angle) + self.aside[:, :1]), axis=1)
        c, s = np.cos(self.winding), np.sin(self.winding)
        wound = np.zeros((n, count, 3))
        wound[..., 0] = mx[:, None] * c - my[:, None] * s
        wound[..., 1] = mx[:, None] * s + my[:, None] * c
        taken = np.zeros((n, count, 6))
        taken[..., 2] = self.on_walls * thrust[:, None]
        taken[..., 3:] = self.on_walls[..., None] * wound
        outside = (1 - self.on_walls)[..., None] * wound
        moments = np.zeros((n, count + 1, 3))
        moments[:, 1:] = outside
        moments[:, 1:-1] -= outside[:, 1:]
        tip = np.zeros((n, 3))
        tip[:, 2] = thrust * (1 - self.on_walls[:, -1])
        return Gas(taken, p), tip, moments


Change = Callable[[GasChambers, Array], None]


def chambers(body: WorldBody, changes: Mapping[str, Change]) -> GasChambers:
    """The chambers of the paper with the effects of `changes`, by effect."""
    n, count = body.h.shape
    made = GasChambers(
        body, np.tile(AZIMUTHS, (n, 1)), np.full((n, 9), PATH_RADIUS), np.zeros((n, 2)), np.zeros((n, count)),
        np.zeros((n, count)),
    )  # fmt: skip
    for effect in [*(e for e in ORDER if e in changes), *(e for e in changes if e not in ORDER)]:
        size = body.lanes.sizes.get(effect)
        if size is not None and np.any(size):
            changes[effect](made, size)
    return made
