"""What may be wrong with an arm, as named parameters that are 0 for the nominal one, and the arm with all of it.

    model = ArmModel(arm)
    model.predict({"zero_2": 0.001}, inputs)         # inputs: columns q1, q2 .. in rad -> (n, 3) x, y, z in m

Joint angle k with its errors, tau_k the share of `gravity_torques`, q the commanded angle:

    theta_k = q + offset_k + zero_k + sag_k tau_k + sum_{h=1,2} (gear<h>_sin_k sin h q + gear<h>_cos_k cos h q)

The world's point, with R_x the turn about x and so on, B and b the base's nominal rotation and position, p_0 the point in frame 0:

    p = (1 + tracker_scale) [b + base + R_z(base_rz) R_y(base_ry + tilt_y) R_x(base_rx + tilt_x) B p_0]
    tilt = mount_compliance_(x, y) M + mount_play M / |M|                 M: the moment's share along x and y of the world

Geometry after Hayati and Mirmirani (1985); sag and gear errors as in Whitney, Lozinski and Rourke (1986).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from model.arm.description import Arm
from model.arm.kinematics import Values, base_rotation, gravity_torques, to_frame_0, turn
from model.errors import BadCondition, BadEffect, nearest
from model.robot import Array

STEP = 1e-20
"""Of a derivative by a complex step, in the parameter's unit: so small that its square vanishes."""
MAIN_SAG = 0.1
"""Joints whose gravity torque (rms over poses) is at least this share of the greatest one's sag first."""
LARGEST_ANGLE = 100.0
"""rad; beyond it columns are in degrees."""
POSES = 256
"""Poses over which gravity's torques are compared."""


@dataclass(frozen=True)
class ArmCause:
    """Something that may be wrong: parameter -> (nominal value, plausible size as a standard deviation, unit)."""

    id: str
    parameters: Mapping[str, tuple[float, float, str]]
    stage: str
    says: str


def arm_causes(arm: Arm) -> tuple[ArmCause, ...]:
    """The causes of an arm; parameters of joint k end in _k, counted from 1.

    Plausible sizes: 10 mm and 10 mrad of the base's place, 2 mm of the tool; 1 mm and 1 mrad of machined and assembled parts;
    1 mrad of sag; 0.1 mrad of a strain wave gear (its makers state 1 arc minute at most); 20 ppm of a tracker.
    """
    count = range(1, len(arm.links) + 1)
    joints = [str(k) for k in count]
    inner = joints[:-1]
    parallel = [k for k, flag in zip(joints, arm.parallel, strict=True) if flag]
    even = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, len(joints)))
    rms = np.sqrt(np.mean(gravity_torques(arm, even)[0] ** 2, axis=0))
    main = [k for k, r in zip(joints, rms, strict=True) if r >= MAIN_SAG * rms.max() > 0]
    minor = [k for k, r in zip(joints, rms, strict=True) if 1e-9 < r < MAIN_SAG * rms.max()]

    def each(*kinds: tuple[str, Sequence[str], float, str]) -> dict[str, tuple[float, float, str]]:
        return {f"{kind}_{k}": (0.0, spread, unit) for kind, suffixes, spread, unit in kinds for k in suffixes}

    axes, turns = ("x", "y", "z"), ("rx", "ry", "rz")
    causes = (
        ArmCause("base_frame", each(("base", axes, 0.01, "m"), ("base", turns, 0.01, "rad")), "boundary",
                 "the base stands elsewhere than stated"),
        ArmCause("tool", each(("tool", axes, 0.002, "m")), "measurement", "the measured point sits elsewhere on the flange"),
        ArmCause("joint_zeros", each(("zero", joints, 0.001, "rad")), "structure", "joints read zero at another angle"),
        ArmCause("link_lengths", each(("a", inner, 0.001, "m"), ("d", [k for k in inner if k not in parallel], 0.001, "m")),
                 "structure", "links have other lengths"),
        ArmCause("axis_twists", each(("alpha", inner, 0.001, "rad"), ("beta", parallel, 0.001, "rad")), "structure",
                 "axes of joints are not parallel or perpendicular as drawn"),
        ArmCause("gravity_sag", each(("sag", main, 0.001, "rad")), "load", "joints that carry the arm yield under its weight"),
        ArmCause("minor_sag", each(("sag", minor, 0.001, "rad")), "load", "joints that carry little yield under their weight"),
        ArmCause("gear_once", each(("gear1_sin", joints, 1e-4, "rad"), ("gear1_cos", joints, 1e-4, "rad")), "actuation",
                 "gears run out once a turn"),
        ArmCause("gear_twice", each(("gear2_sin", joints, 1e-4, "rad"), ("gear2_cos", joints, 1e-4, "rad")), "actuation",
                 "gears run out twice a turn"),
        ArmCause("tracker_scale", each(("tracker", ("scale",), 2e-5, "1")), "measurement", "the tracker's lengths are off by a factor"),
        ArmCause("loose_mount", each(("mount", ("compliance_x", "compliance_y"), 0.001, "rad"), ("mount", ("play",), 1e-4, "rad")),
                 "boundary", "the base tilts under the arm's weight or towards the outstretched arm"),
    )  # fmt: skip
    return tuple(cause for cause in causes if cause.parameters)


@dataclass(frozen=True)
class ArmModel:
    """An arm with all its causes."""

    arm: Arm

    @cached_property
    def causes(self) -> tuple[ArmCause, ...]:
        """See `arm_causes`."""
        return arm_causes(self.arm)

    @cached_property
    def parameters(self) -> dict[str, tuple[float, float, str]]:
        """Nominal value, plausible size and unit of every parameter of every cause."""
        return {name: values for cause in self.causes for name, values in cause.parameters.items()}

    def predict(self, theta: Mapping[str, ArrayLike], inputs: pd.DataFrame) -> Array:
        """Positions of the point on the tool in the world, m: (n, 3); (variants, n, 3) where a value of theta is an array (variants,).

        theta: parameter -> value in its unit, 0 where it is missing. inputs: columns q1, q2 .. in rad, n rows; others are ignored.
        Raises `BadEffect` for an unknown parameter, `BadCondition` for missing or non-finite angles.
        """
        return self._positions(theta, inputs, np.float64)

    def derivatives(self, theta: Mapping[str, float], inputs: pd.DataFrame, names: Sequence[str]) -> Array:
        """d position / d parameter at theta, (n, 3, names), m per unit; exact to rounding (complex step, Squire and Trapp 1998)."""
        steps = 1j * STEP * np.eye(len(names))
        varied = {name: theta.get(name, 0.0) + steps[i] for i, name in enumerate(names)}
        complex_positions = self._positions({**theta, **varied}, inputs, np.complex128)
        return np.moveaxis(np.imag(complex_positions), 0, -1) / STEP

    def _positions(self, theta: Mapping[str, Any], inputs: pd.DataFrame, kind: type) -> Any:
        q = self._angles(inputs)
        if unknown := [name for name in theta if name not in self.parameters]:
            raise BadEffect(f"theta: {unknown[0]!r} is no parameter of {self.arm.name}: {nearest(unknown[0], self.parameters)}")
        values = {name: np.asarray(value, kind) for name, value in theta.items()}
        zero = np.zeros((1, 1), kind)

        def value(name: str) -> Values:
            """(variants, 1) or (1, 1)."""
            return values[name].reshape(-1, 1) if name in values else zero

        torques, moment = gravity_torques(self.arm, q)
        size = np.maximum(np.hypot(moment[:, 0], moment[:, 1]), 1e-12)
        numbers = list(enumerate(self.arm.links, 1))
        angles = [
            q[None, :, k - 1] + np.radians(link.offset_deg) + value(f"zero_{k}") + value(f"sag_{k}") * torques[:, k - 1]
            + sum(value(f"gear{h}_sin_{k}") * np.sin(h * q[:, k - 1]) + value(f"gear{h}_cos_{k}") * np.cos(h * q[:, k - 1])
                  for h in (1, 2) if f"gear{h}_sin_{k}" in values or f"gear{h}_cos_{k}" in values)
            for k, link in numbers
        ]  # fmt: skip
        point = to_frame_0(
            angles,
            [link.a + value(f"a_{k}") for k, link in numbers],
            [link.d + value(f"d_{k}") for k, link in numbers],
            [np.radians(link.alpha_deg) + value(f"alpha_{k}") for k, link in numbers],
            [value(f"beta_{k}") for k, _ in numbers],
            tuple(self.arm.tool[i] + value(f"tool_{axis}") for i, axis in enumerate("xyz")),  # type: ignore[arg-type]
        )
        rows = base_rotation(self.arm)
        point = tuple(sum(rows[i, j] * point[j] for j in range(3)) for i in range(3))
        play = value("mount_play") / size
        for i, axis in enumerate("xyz"):
            tilt = (value(f"mount_compliance_{axis}") + play) * moment[:, i] if axis != "z" else zero
            point = turn(i, value(f"base_r{axis}") + tilt, point)
        at = self.arm.base_to_world.position
        out = np.stack([(1 + value("tracker_scale")) * (at[i] + value(f"base_{axis}") + point[i]) for i, axis in enumerate("xyz")], axis=-1)
        return out if any(v.ndim for v in values.values()) else out[0]

    def _angles(self, inputs: pd.DataFrame) -> Array:
        """(n, joints) angles in rad."""
        if missing := [name for name in self.arm.joints if name not in inputs]:
            raise BadCondition(f"inputs: no column {missing[0]}; there must be {', '.join(self.arm.joints)} in rad")
        q = inputs[list(self.arm.joints)].to_numpy(float)
        row, joint = np.nonzero(~np.isfinite(q))[0], np.nonzero(~np.isfinite(q))[1]
        if len(row):
            raise BadCondition(f"inputs: row {row[0]}, {self.arm.joints[joint[0]]} = {q[row[0], joint[0]]} rad: must be finite; leave the row out")
        if q.size and np.abs(q).max() > LARGEST_ANGLE:
            raise BadCondition(f"inputs: an angle of {np.abs(q).max():g} rad exceeds {LARGEST_ANGLE:g} rad: columns q1 .. must be in rad, not deg")
        return q
