"""Causes outside the catalogue that the diagnosis may be developed on. x (n,) is the size in the unit of the cause.

A cause that comes and goes over the campaign has a course: its size in each trial relative to its largest, by the part u of
the campaign that has passed (0 to 1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .body import WorldBody
from .equilibrium import Shape
from .frames import hat, turn
from .gas import GasChambers
from .robot import SPINE_AREA, SPINE_SECOND
from .seen import Seeing, SeenPath

Array = NDArray[np.float64]
Stage = Literal["actuation", "structure", "material", "load", "boundary", "measurement"]


@dataclass(frozen=True)
class Cause:
    """A cause without a name in the catalogue."""

    id: str
    stage: Stage
    scale: float
    """Plausible size in the unit of `change`."""
    change: Callable[[Any, Array], None]
    """Acts on what `on` says."""
    on: Literal["body", "chambers", "seen"]
    course: Callable[[Array], Array] | None = None
    one_way: bool = True


def chamber_crosstalk(c: GasChambers, x: Array) -> None:
    """Each chamber takes x of the mean of its neighbours and loses as much: leaks between them."""
    c.pressures.append(lambda p: p + x[:, None] * (0.5 * np.roll(p, 1, axis=1) + 0.5 * np.roll(p, -1, axis=1) - p))


def weak_chamber(c: GasChambers, x: Array) -> None:
    """One chamber has x less area than the others."""
    which = c.body.lanes.places.chamber

    def law(p: Array) -> Array:
        out = np.ones_like(p)
        out[:, which] = 1 - x
        return out

    c.areas.append(law)


def eccentric_spine(b: WorldBody, x: Array) -> None:
    """The spine's axis lies x (m) beside the body's."""
    a = b.lanes.places.other + b.lanes.roll
    arm = x[:, None] * np.stack([np.cos(a), np.sin(a), np.zeros_like(a)], axis=-1)
    share = SPINE_AREA / (SPINE_AREA + SPINE_SECOND / 0.025**2) * b.cover
    axial = share * b.stiff_spine[..., 2]
    # strain of the spine's axis: v3 + (u x arm)_3
    row = -hat(arm)[:, 2]
    coupled = np.zeros((*b.cover.shape, 6, 6))
    coupled[..., 3:, 3:] = axial[..., None, None] * (row[:, :, None] * row[:, None, :])[:, None]
    coupled[..., 2, 3:] = coupled[..., 3:, 2] = axial[..., None] * row[:, None]
    b.coupled = coupled


def granules_settle(b: WorldBody, x: Array) -> None:
    """The spine is stiffer by x at the end: granules pack closer with each jamming."""
    b.stiff_spine *= (1 + x)[:, None, None]


def graded_modulus(b: WorldBody, x: Array) -> None:
    """E (1 + x (2 a - 1)) along the body: it cured from one end."""
    b.stiff_silicone *= (1 + x[:, None] * (2 * b.along() - 1))[..., None]


def warm_room(b: WorldBody, x: Array) -> None:
    """E and G lower by x at the warmest hour."""
    b.stiff_silicone *= (1 - x)[:, None, None]


def cable_drag(b: WorldBody, x: Array) -> None:
    """x N over the outer half, against the way aside, full from some centimetres on: cables rub on the frame."""
    weights = np.clip((b.nodes() / b.lanes.length[:, None] - 0.5) / 0.1, 0, 1)
    weights /= weights.sum(axis=1, keepdims=True)

    def force(shape: Shape) -> tuple[Array, Array]:
        aside = shape.r * np.array([1.0, 1.0, 0.0])
        way = np.sqrt(np.sum(aside * aside, axis=-1, keepdims=True) + 0.03**2)
        return -(x[:, None] * weights)[..., None] * aside / way, np.zeros((*shape.r.shape, 3))

    b.fields.append(force)


def mount_turns(b: WorldBody, x: Array) -> None:
    """The mount has turned by x (rad) at the end of the campaign."""
    a = b.lanes.places.other
    b.base_turn = turn(x[:, None] * np.array([-np.sin(a), np.cos(a), 0.0])) @ b.base_turn


def camera_scale(s: Seeing, x: Array) -> None:
    """Lengths are read (1 + x) times too long."""

    def law(path: SeenPath) -> SeenPath:
        return replace(path, tip=path.tip * (1 + x[:, None]), markers=path.markers * (1 + x[:, None, None]))

    s.views.append(law)


def levelling_off(u: Array) -> Array:
    """Quickly at first, slower and slower over the campaign u (0..1)."""
    return np.asarray(np.log1p(20 * u) / np.log(21))


def up_and_back(u: Array) -> Array:
    """Largest half way."""
    return np.asarray(np.sin(np.pi * u) ** 2)


def steadily(u: Array) -> Array:
    """In proportion to what has passed of the campaign."""
    return u


OUTSIDE = {
    c.id: c
    for c in (
        Cause("chamber_crosstalk", "actuation", 0.15, chamber_crosstalk, "chambers"),
        Cause("weak_chamber", "actuation", 0.25, weak_chamber, "chambers"),
        Cause("eccentric_spine", "structure", 0.007, eccentric_spine, "body"),
        Cause("granules_settle", "structure", 0.25, granules_settle, "body", levelling_off),
        Cause("graded_modulus", "material", 0.25, graded_modulus, "body", one_way=False),
        Cause("warm_room", "material", 0.10, warm_room, "body", up_and_back, one_way=False),
        Cause("cable_drag", "load", 0.7, cable_drag, "body"),
        Cause("mount_turns", "boundary", np.radians(2.0), mount_turns, "body", steadily, one_way=False),
        Cause("camera_scale", "measurement", 0.02, camera_scale, "seen", one_way=False),
    )
}
"""By id."""
