"""What may be wrong with an arm, as named parameters that are 0 for the nominal one, and the arm with all of it.

    model = ArmModel(arm)
    model({"zero_2": 0.001}, inputs)         # inputs: columns q1, q2 .. in rad -> (n, 3) x, y, z in m

Joint angle k with its errors, q the commanded one, q' the one before the move, tau_k gravity's torque and T_k its bound:

    theta_k = q + offset_k + zero_k + sag_k tau_k / T_k + lost_k sign(q - q')
              + sum_h (gear<h>_sin_k sin h q + gear<h>_cos_k cos h q)

The point in the world, with R_x a turn about x, B and b the base's nominal rotation and position, p_0 the point in frame 0:

    p = (1 + tracker_scale) [b + base + R_z(base_rz) R_y(base_ry + tilt_y) R_x(base_rx + tilt_x) B p_0]
    tilt = mount_compliance_(x, y) M + mount_play M / |M|     M: moment of the weight about x and y of the world, over T_1

Geometry after Hayati and Mirmirani (1985); sag, lost motion and gear errors as in Whitney, Lozinski and Rourke (1986).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from model.arm.description import Arm
from model.arm.kinematics import Motion, base_rotation, carried, gravity_torques, greatest_torques, links, nominal, slopes
from model.cause import Cause
from model.errors import BadCondition, BadEffect, nearest
from model.robot import Array

STAND = tuple(Motion(f"base_{kind}{axis}", i, bool(kind)) for kind in ("r", "") for i, axis in enumerate("xyz"))
"""From the frame at the nominal base, turned as the world, to the world."""
MAIN_SAG = 0.1
"""Joints with at least this share of the greatest torque of gravity (rms over poses) carry the arm."""
LARGEST_ANGLE = 4 * np.pi
"""rad, two turns: beyond it columns are in degrees."""
HARMONICS = 32
"""Most periods a turn of an error of a joint's gear or encoder."""
GEAR = 3e-4
"""rad: plausible size of such an error with one period a turn; with h periods 1 / h of it. An arc minute, as makers of strain
wave gears state; the decrease was chosen on one measured arm."""
REMEMBERED = 4
"""Tables of poses whose torques and harmonics are kept, as fits ask for the same ones again."""
POSES = 256
"""Poses over which gravity's torques are compared."""


def arm_causes(arm: Arm) -> tuple[Cause, ...]:
    """The causes of an arm; parameters of joint k end in _k, counted from 1.

    Plausible sizes: 10 mm and 10 mrad of the base's place, 2 mm of the tool; 1 mm and 1 mrad of machined and assembled parts;
    1 mrad of sag of the outstretched arm, 0.1 mrad in joints that carry little; 0.1 mrad of lost motion; `GEAR`; 200 ppm of
    cameras calibrated by a wand, or of a tracker in other air.
    """
    count = range(1, len(arm.links) + 1)
    joints = [str(k) for k in count]
    inner = joints[:-1]
    parallel = [k for k, flag in zip(joints, arm.parallel, strict=True) if flag]
    even = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, len(joints)))
    rms = np.sqrt(np.mean(gravity_torques(arm, even)[0] ** 2, axis=0))
    main = [k for k, r in zip(joints, rms, strict=True) if r >= MAIN_SAG * rms.max() > 0]
    minor = [k for k, r in zip(joints, rms, strict=True) if 1e-9 * rms.max() < r < MAIN_SAG * rms.max()]

    def each(*kinds: tuple[str, Sequence[str], float, str]) -> dict[str, tuple[float, float, str]]:
        return {f"{kind}_{k}": (0.0, spread, unit) for kind, suffixes, spread, unit in kinds for k in suffixes}

    def gears(first: int, last: int) -> dict[str, tuple[float, float, str]]:
        """Sines and cosines of every joint."""
        orders = range(first, last + 1)
        return each(*((f"gear{h}_{wave}", joints, GEAR / h, "rad") for h in orders for wave in ("sin", "cos")))

    axes, turns = ("x", "y", "z"), ("rx", "ry", "rz")
    frame = each(("base", axes, 0.01, "m"), ("base", turns, 0.01, "rad"))
    lengths = each(("a", inner, 0.001, "m"), ("d", [k for k in inner if k not in parallel], 0.001, "m"))
    twists = each(("alpha", inner, 0.001, "rad"), ("beta", parallel, 0.001, "rad"))
    mount = each(("mount", ("compliance_x", "compliance_y"), 0.001, "rad"), ("mount", ("play",), 5e-4, "rad"))
    causes = (
        Cause("base_frame", frame, "boundary", "the base stands elsewhere than stated", exact=True),
        Cause(
            "tool", each(("tool", axes, 0.002, "m")), "measurement", "the measured point sits elsewhere on the flange", exact=True
        ),
        Cause("joint_zeros", each(("zero", joints, 0.001, "rad")), "structure", "joints read zero at another angle", exact=True),
        Cause("link_lengths", lengths, "structure", "links have other lengths", exact=True),
        Cause("axis_twists", twists, "structure", "axes of joints are not parallel or perpendicular as drawn", exact=True),
        Cause("gravity_sag", each(("sag", main, 0.001, "rad")), "load", "joints that carry the arm yield under its weight"),
        Cause("minor_sag", each(("sag", minor, 1e-4, "rad")), "load", "joints that carry little yield under their weight"),
        Cause("gear_once", gears(1, 1), "actuation", "gears or encoders err once a turn"),
        Cause("gear_twice", gears(2, 2), "actuation", "gears or encoders err twice a turn"),
        Cause("gear_ripple", gears(3, HARMONICS), "actuation", f"gears or encoders err 3 to {HARMONICS} times a turn"),
        Cause("lost_motion", each(("lost", joints, 1e-4, "rad")), "actuation", "joints stop on either side by their approach"),
        Cause(
            "tracker_scale", each(("tracker", ("scale",), 2e-4, "1")), "measurement", "lengths of the tracker are off", exact=True
        ),
        Cause("loose_mount", mount, "boundary", "the base tilts under the arm's weight or towards the outstretched arm"),
    )
    return tuple(cause for cause in causes if cause.parameters)


@dataclass(frozen=True)
class ArmModel:
    """An arm with all its causes."""

    arm: Arm
    _known: dict[bytes, _Poses] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Poses that were asked for last, by their angles."""

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """See `arm_causes`."""
        return arm_causes(self.arm)

    @cached_property
    def parameters(self) -> dict[str, Sequence[Any]]:
        """Nominal value, plausible size and unit of every parameter of every cause."""
        return {name: values for cause in self.causes for name, values in cause.parameters.items()}

    @cached_property
    def _links(self) -> list[Motion]:
        """From the tool to frame 0."""
        return [*(Motion(f"tool_{axis}", i, False) for i, axis in enumerate("xyz")), *links(self.arm)]

    def __call__(self, theta: Mapping[str, float], inputs: pd.DataFrame) -> Array:
        """Return the tool point in the world, m: (n, 3).

        theta: parameter -> value in its unit, 0 where it is missing. inputs: n rows, columns q1, q2 .. in rad. Optional columns
        q1_before, q2_before .. are the angles before the move to the pose: without them lost motion does nothing.
        Raises `BadEffect` for an unknown parameter, `BadCondition` for missing or non-finite angles.
        """
        poses = self._poses(inputs)
        amounts = self._amounts(theta, poses)
        return np.asarray(((1 + amounts["tracker_scale"]) * self._carried(amounts, poses)[1][-1]).T)

    def derivatives(
        self, theta: Mapping[str, float], inputs: pd.DataFrame, names: Iterable[str] | None = None
    ) -> dict[str, Array]:
        """Parameter, one of theta unless `names` are given -> d position / d parameter at theta (n, 3), m per unit."""
        poses, names = self._poses(inputs), [*(theta if names is None else names)]
        amounts = self._amounts(dict.fromkeys(names, 0.0) | dict(theta), poses)
        in_links, in_stand = self._carried(amounts, poses)
        scaled = np.broadcast_to((1 + amounts["tracker_scale"]) * np.eye(3)[:, :, None], (3, 3, len(inputs)))
        of_stand, axes = slopes(STAND, amounts, in_stand, scaled)
        of_links, _ = slopes(self._links, amounts, in_links, np.tensordot(base_rotation(self.arm).T, axes, 1))
        known = of_links | of_stand | {"tracker_scale": in_stand[-1]}
        moves = {name: poses.moves.get(name, ((name, 1.0),)) for name in names}
        return {name: np.sum([known[moved] * factor for moved, factor in own], axis=0).T for name, own in moves.items()}

    def _carried(self, amounts: Mapping[str, Array], poses: _Poses) -> tuple[list[Array], list[Array]]:
        """The point (3, n) between tool and frame 0, and between there and the world; see `carried`."""
        in_links = carried(self._links, amounts, np.zeros((3, len(poses.q))))
        return in_links, carried(STAND, amounts, base_rotation(self.arm) @ in_links[-1])

    def _amounts(self, theta: Mapping[str, float], poses: _Poses) -> dict[str, Array]:
        """Motion -> amount (n,) or (1,); and the tracker's scale."""
        if unknown := [name for name in theta if name not in self.parameters]:
            raise BadEffect(f"theta: {unknown[0]!r} is no parameter of {self.arm.name}: {nearest(unknown[0], self.parameters)}")
        out = nominal(self.arm, poses.q) | {"tracker_scale": 0.0}
        for axis, base, tool in zip("xyz", self.arm.base_to_world.position, self.arm.tool, strict=True):
            out |= {f"base_r{axis}": 0.0, f"base_{axis}": base, f"tool_{axis}": tool}
        for name, value in theta.items():
            for moved, factor in poses.moves.get(name, ((name, 1.0),)):
                out[moved] = out[moved] + value * factor
        return out

    def _poses(self, inputs: pd.DataFrame) -> _Poses:
        """What the causes need to know of the poses."""
        names = self.arm.joints
        if missing := [name for name in names if name not in inputs]:
            raise BadCondition(f"inputs: no column {missing[0]}; there must be {', '.join(names)} in rad")
        q = inputs[list(names)].to_numpy(float)
        bad = np.argwhere(~(np.abs(q) <= LARGEST_ANGLE))
        if len(bad):
            row, joint = bad[0]
            raise BadCondition(
                f"inputs: row {row}, {names[joint]} = {q[row, joint]:g} rad: must be finite and at most {LARGEST_ANGLE:g} rad; "
                "leave the row out, or give rad in place of deg"
            )
        before = {name: inputs[f"{name}_before"].to_numpy(float) for name in names if f"{name}_before" in inputs}
        key = b"".join(values.tobytes() for values in (q, *before.values()))
        if key not in self._known:
            if len(self._known) == REMEMBERED:
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._seen(q, before)
        return self._known[key]

    def _seen(self, q: Array, before: Mapping[str, Array]) -> _Poses:
        """Poses of angles q (n, joints) after those of some joints before the move, rad."""
        torques, moment = gravity_torques(self.arm, q)
        bounds = np.maximum(greatest_torques(self.arm), 1e-12)
        x, y = moment.T[:2] / bounds[0]
        size = np.maximum(np.hypot(x, y), 1e-12)
        moves: dict[str, tuple[tuple[str, Array], ...]] = {
            "mount_compliance_x": (("base_rx", x),), "mount_compliance_y": (("base_ry", y),),
            "mount_play": (("base_rx", x / size), ("base_ry", y / size)),
        }  # fmt: skip
        for i, (joint, angle) in enumerate(zip(self.arm.joints, q.T, strict=True)):
            k, lost = i + 1, np.nan_to_num(np.sign(angle - before.get(joint, angle)))
            errors = {f"sag_{k}": torques[:, i] / bounds[i], f"lost_{k}": lost}
            for h in range(1, HARMONICS + 1):
                errors |= {f"gear{h}_sin_{k}": np.sin(h * angle), f"gear{h}_cos_{k}": np.cos(h * angle)}
            moves |= {name: ((f"zero_{k}", error),) for name, error in errors.items()}
        return _Poses(q, moves)


@dataclass(frozen=True)
class _Poses:
    """Poses as the causes see them."""

    q: Array
    """(n, joints), rad."""
    moves: Mapping[str, tuple[tuple[str, Array], ...]]
    """Parameter -> the motions that it adds to, and by how much per unit of it, (n,); one without adds to its own."""
