"""Where the point on the tool of a serial arm is, and the torques of gravity on its joints.

p_{k-1} = Rz(theta_k) [(a_k, 0, d_k) + Rx(alpha_k) Ry(beta_k) p_k] carries a point from frame k to frame k-1, from the tool to
the base (Denavit and Hartenberg 1955; beta, for axes that are nearly parallel, Hayati and Mirmirani 1985).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from model.arm.description import Arm
from model.robot import Array
from model.rotation import to_base, unit

GRAVITY = 9.81
"""m/s^2."""


class Motion(NamedTuple):
    """A turn (rad) about axis 0 (x), 1 (y) or 2 (z), or a shift (m) along it, by the amount of its name."""

    name: str
    axis: int
    turns: bool


def carried(motions: Sequence[Motion], amounts: Mapping[str, Array], point: Array) -> list[Array]:
    """Points (3, n) before the first motion and after each; amounts (n,) or (1,)."""
    out = [point]
    for name, axis, turns in motions:
        point, i, j = point.copy(), (axis + 1) % 3, (axis + 2) % 3
        if turns:
            c, s = np.cos(amounts[name]), np.sin(amounts[name])
            point[i], point[j] = c * out[-1][i] - s * out[-1][j], s * out[-1][i] + c * out[-1][j]
        else:
            point[axis] += amounts[name]
        out.append(point)
    return out


def slopes(
    motions: Sequence[Motion], amounts: Mapping[str, Array], points: Sequence[Array], axes: Array
) -> tuple[dict[str, Array], Array]:
    """Motion -> derivative (3, n) by its amount; and the axes of the frame before all motions. `points`: of `carried`; `axes`
    (axis, 3, n): of the frame after all."""
    out = {}
    for (name, axis, turns), point in reversed(list(zip(motions, points[1:], strict=True))):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[name] = axes[j] * point[i] - axes[i] * point[j] if turns else axes[axis]
        if turns:
            c, s, old = np.cos(amounts[name]), np.sin(amounts[name]), axes
            axes = axes.copy()
            axes[i], axes[j] = c * old[i] + s * old[j], c * old[j] - s * old[i]
    return out, axes


def base_rotation(arm: Arm) -> Array:
    """(3, 3) rotation from frame 0 to the world."""
    return to_base(unit(np.array(arm.base_to_world.orientation)), np.eye(3)).T


def links(arm: Arm) -> list[Motion]:
    """Five motions for each joint, from the frame of the flange to frame 0."""
    kinds = (("beta", 1, True), ("alpha", 0, True), ("a", 0, False), ("d", 2, False), ("zero", 2, True))
    return [Motion(f"{name}_{k}", axis, turns) for k in range(len(arm.links), 0, -1) for name, axis, turns in kinds]


def nominal(arm: Arm, q: Array) -> dict[str, Any]:
    """Motion of a joint or link -> its amount at angles q (n, joints), rad."""
    out: dict[str, Any] = {}
    for k, (link, angle) in enumerate(zip(arm.links, q.T, strict=True), 1):
        out |= {f"a_{k}": link.a, f"d_{k}": link.d, f"alpha_{k}": np.radians(link.alpha_deg), f"beta_{k}": 0.0}
        out[f"zero_{k}"] = angle + np.radians(link.offset_deg)
    return out


def gravity_torques(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return torques (n, joints) of gravity about the joints' axes, and its moment (n, 3) on the base in the world, N m.

    Of the nominal arm at angles q (n, joints), rad: what weights do along the motion of their centres with each joint. Without
    stated masses for an arm of 1 kg, so that only their shape counts.
    """
    every, amounts, (masses, centres) = links(arm), nominal(arm, q), arm.masses
    gravity = GRAVITY * np.array(arm.down) / np.linalg.norm(arm.down) @ base_rotation(arm)  # in frame 0
    torques, moment = np.zeros(q.shape), np.zeros((len(q), 3))
    weights = [*zip(range(1, len(masses) + 1), masses, centres, strict=True), (len(masses), arm.tool_mass, np.array(arm.tool))]
    for k, mass, centre in weights:
        motions = every[5 * (len(masses) - k) :]
        points = carried(motions, amounts, np.tile(centre[:, None], len(q)))
        of_motion, _ = slopes(motions, amounts, points, np.tile(np.eye(3)[:, :, None], len(q)))
        for joint in range(1, k + 1):
            torques[:, joint - 1] += mass * gravity @ of_motion[f"zero_{joint}"]
        moment += mass * np.cross(points[-1].T, gravity)
    return torques, moment @ base_rotation(arm).T


def greatest_torques(arm: Arm) -> Array:
    """Return (joints,) torques, N m, of all weight behind a joint at the end of the outstretched arm: the scale of sag."""
    lengths = [abs(link.a) + abs(link.d) for link in arm.links]
    lengths[-1] += float(np.linalg.norm(arm.tool))
    masses = arm.masses[0]
    masses[-1] += arm.tool_mass
    return np.asarray(GRAVITY * np.cumsum(masses[::-1])[::-1] * np.cumsum(lengths[::-1])[::-1])
