"""Where the base, its axes and the chambers are, as the cameras see the tip move when each channel is inflated a little.

Inflating a channel bends the body away from its chambers and lengthens it. So the displacements of all channels, less their mean,
lie in a plane across the base's z; their mean shows which way z points, and the first channel shows x.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.frames import quaternion_from_matrix
from model.arrays import Array

FLATTEST = 0.2
"""Least ratio of the displacements' extents in the plane: with less, no plane is determined."""
NOISE = 0.03e-3
"""m, standard deviation of a displacement of averaged frames."""
FAR_OFF = 25.0
"""deg by which a channel may differ from robot.yaml before its hose is doubted."""


class NotDetermined(ValueError):
    """The displacements do not show the base's axes."""


@dataclass(frozen=True)
class BaseSeen:
    """What the displacements show."""

    axes: Array
    """(3, 3) the base's x, y, z as columns, in the frame of the displacements."""
    base: Array
    """(3,) m in that frame."""
    base_sd: float
    """m, across z."""
    turned_deg: tuple[float, ...]
    """By channel: how far its direction differs from robot.yaml about z; 0 for the first, which shows x."""
    turned_sd_deg: float
    lengthened: float
    """m along z, mean of the channels."""


def base_seen(rest: Array, moved: Array, expected: Array, expected_rest: Array) -> BaseSeen:
    """The base from the resting tip `rest` (3,) and the displacements (n, 3) m, in the cameras' frame.

    `expected` (n, 3) and `expected_rest` (3,): the same of the model, in the base's frame. Raises NotDetermined."""
    if len(moved) < 3:
        raise NotDetermined(f"{len(moved)} channels: the axes are determined by three or more; measure them by hand")
    mean = moved.mean(axis=0)
    _, extent, directions = np.linalg.svd(moved - mean)
    if extent[1] < FLATTEST * extent[0] or extent[0] < 10 * NOISE:
        raise NotDetermined("the tip moves too little, or along one line alone; check the hoses, or inflate more")
    lengthened = float(mean @ directions[2])
    if abs(lengthened) < 2 * NOISE / math.sqrt(len(moved)):
        raise NotDetermined(f"the body lengthens by {1e3 * lengthened:.2f} mm only, so which way z points is not seen")
    z = directions[2] * math.copysign(1.0, lengthened)
    first = moved[0] - (moved[0] @ z) * z
    u = first / np.linalg.norm(first)
    w = np.cross(z, u)
    seen, model = (moved @ u) + 1j * (moved @ w), expected[:, 0] + 1j * expected[:, 1]
    start = np.angle(model[0])  # of the first channel's displacement in the base's frame
    x, y = u * np.cos(start) - w * np.sin(start), u * np.sin(start) + w * np.cos(start)
    turned = np.degrees(np.angle(seen * np.exp(1j * start) / model))
    axes = np.stack([x, y, z], axis=1)
    tilt_sd = NOISE / (extent[1] / math.sqrt(len(moved)))
    angle_sd = math.degrees(NOISE / np.abs(seen).min())
    base_sd = tilt_sd * float(np.linalg.norm(expected_rest))
    return BaseSeen(axes, rest - axes @ expected_rest, base_sd, tuple(turned.tolist()), angle_sd, abs(lengthened))


def lines(found: BaseSeen, channels: Sequence[Sequence[int]], azimuths_deg: Sequence[float]) -> Iterator[str]:
    """Lines for robot.yaml, rig.yaml and map.yaml, each file under its name."""
    turned = {chamber: t for group, t in zip(channels, found.turned_deg, strict=True) for chamber in group}
    azimuths = [round(round(a + turned.get(i, 0.0), 1) % 360, 1) for i, a in enumerate(azimuths_deg, 1)]
    far = [", ".join(map(str, channels[k])) for k, t in enumerate(found.turned_deg) if abs(t) > FAR_OFF]
    yield "robot.yaml:"
    yield f"  azimuths_deg: {azimuths}    # ± {found.turned_sd_deg:.1f} deg; the first is taken from robot.yaml and shows x"
    if far:
        yield f"  # chambers {'; '.join(far)} are not where robot.yaml has them: exchanged hoses? check them first"
    rotation = found.axes.T
    position = [round(value, 4) for value in (-rotation @ found.base).tolist()]
    yield f"rig.yaml, instruments.mocap:    # z as the body lengthens by {1e3 * found.lengthened:.2f} mm"
    yield f"  mocap_to_base: {{position: {position}, quaternion: {[round(q, 4) for q in quaternion_from_matrix(rotation)]}}}"
    names = [f"{'-' if found.axes[k, i] < 0 else ''}{'xyz'[k]}" for i, k in enumerate(np.abs(found.axes).argmax(axis=0))]
    off = math.degrees(math.acos(min(1.0, float(np.abs(found.axes).max(axis=0).min()))))
    zero = ", ".join(f"{a} {1e3 * b:.1f}" for a, b in zip("xyz", found.base, strict=True))
    yield "map.yaml, for tables of these cameras:"
    yield f"  frame: {{x: {names[0]}, y: {names[1]}, z: {names[2]}}}    # the nearest axes, up to {off:.0f} deg off"
    yield f"  # zero of columns x, y, z, in mm: {zero}; ± {1e3 * found.base_sd:.1f} mm"
