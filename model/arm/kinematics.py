"""Where the point on the tool of a serial arm is, and the torques of gravity on its joints.

p_{k-1} = Rz(theta_k) [(a_k, 0, d_k) + Rx(alpha_k) Ry(beta_k) p_k] carries a point from frame k to frame k-1, from the tool to
the base (Denavit and Hartenberg 1955; beta, for axes that are nearly parallel, Hayati and Mirmirani 1985).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

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


def link_frames(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return rotations (joints + 1, n, 3, 3) and origins (joints + 1, n, 3), m, of the nominal frames 0, 1 .. in the world.

    q (n, joints): angles, rad.
    """
    rotation = np.broadcast_to(base_rotation(arm), (len(q), 3, 3))
    origin = np.broadcast_to(np.array(arm.base_to_world.position), (len(q), 3))
    rotations, origins = [rotation], [origin]
    for k, link in enumerate(arm.links):
        theta, alpha = q[:, k] + np.radians(link.offset_deg), np.radians(link.alpha_deg)
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        step = np.moveaxis(np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0 * c, 0 * c + sa, 0 * c + ca]]), 2, 0)
        origin = origin + np.einsum("nij,nj->ni", rotation, np.column_stack([link.a * c, link.a * s, link.d + 0 * c]))
        rotation = rotation @ step
        rotations.append(rotation)
        origins.append(origin)
    return np.array(rotations), np.array(origins)


def gravity_torques(arm: Arm, q: Array) -> tuple[Array, Array]:
    """Return torques (n, joints) of gravity about the joints' axes, and its moment (n, 3) on the base in the world, N m.

    Of the nominal arm at angles q (n, joints), rad: tau_j = z_j . sum_{k >= j} m_k (c_k - o_j) x g, with axis z_j and origin o_j
    of joint j and the links' centres of mass c_k. Without stated masses for an arm of 1 kg, so that only their shape counts.
    """
    rotations, origins = link_frames(arm, q)
    masses, centres = arm.masses
    at = origins[1:] + np.einsum("knij,kj->kni", rotations[1:], centres)
    masses, at = np.append(masses, arm.tool_mass), np.concatenate([at, (origins[-1] + rotations[-1] @ np.array(arm.tool))[None]])
    gravity = GRAVITY * np.array(arm.down) / np.linalg.norm(arm.down)
    torques, moment = np.empty(q.shape), np.empty((len(q), 3))
    for j in reversed(range(q.shape[1])):
        moment = np.cross(np.einsum("k,kni->ni", masses[j:], at[j:] - origins[j]), gravity)
        torques[:, j] = np.einsum("ni,ni->n", rotations[j][:, :, 2], moment)
    return torques, moment


def greatest_torques(arm: Arm) -> Array:
    """Return (joints,) torques, N m, of all weight behind a joint at the end of the outstretched arm: the scale of sag."""
    lengths = [abs(link.a) + abs(link.d) for link in arm.links]
    lengths[-1] += float(np.linalg.norm(arm.tool))
    masses = arm.masses[0]
    masses[-1] += arm.tool_mass
    bounds: Array = GRAVITY * np.cumsum(masses[::-1])[::-1] * np.cumsum(lengths[::-1])[::-1]
    return bounds
