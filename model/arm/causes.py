"""What may be wrong with an arm, as named parameters that are 0 for the nominal one, and the arm with all of it.

    model = ArmModel(arm)
    model.predict({"zero_2": 0.001}, inputs)         # inputs: columns q1, q2 .. in rad -> (n, 3) x, y, z in m

Joint angle k with its errors, q the commanded one, q' the one before the move, tau_k gravity's torque and T_k its bound:

    theta_k = q + offset_k + zero_k + sag_k tau_k / T_k + lost_k sign(q - q')
              + sum_h (gear<h>_sin_k sin h q + gear<h>_cos_k cos h q)

The point in the world, with R_x a turn about x, B and b the base's nominal rotation and position, p_0 the point in frame 0:

    p = (1 + tracker_scale) [b + base + R_z(base_rz) R_y(base_ry + tilt_y) R_x(base_rx + tilt_x) B p_0]
    tilt = mount_compliance_(x, y) M + mount_play M / |M|     M: moment of the weight about x and y of the world, over T_1

Geometry after Hayati and Mirmirani (1985); sag, lost motion and gear errors as in Whitney, Lozinski and Rourke (1986).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from model.arm.description import Arm
from model.arm.kinematics import Point, Values, base_rotation, gravity_torques, greatest_torques, to_frame_0, turn
from model.errors import BadCondition, BadEffect, nearest
from model.robot import Array

STEP = 1e-20
"""Of a derivative by a complex step, in the parameter's unit: so small that its square vanishes."""
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


@dataclass(frozen=True)
class ArmCause:
    """Something that may be wrong: parameter -> (nominal value, plausible size as a standard deviation, unit)."""

    id: str
    parameters: Mapping[str, tuple[float, float, str]]
    stage: str
    says: str
    exact: bool = False
    """Whether its law is geometry."""


def arm_causes(arm: Arm) -> tuple[ArmCause, ...]:
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
        ArmCause("base_frame", frame, "boundary", "the base stands elsewhere than stated", exact=True),
        ArmCause(
            "tool", each(("tool", axes, 0.002, "m")), "measurement", "the measured point sits elsewhere on the flange", exact=True
        ),
        ArmCause(
            "joint_zeros", each(("zero", joints, 0.001, "rad")), "structure", "joints read zero at another angle", exact=True
        ),
        ArmCause("link_lengths", lengths, "structure", "links have other lengths", exact=True),
        ArmCause("axis_twists", twists, "structure", "axes of joints are not parallel or perpendicular as drawn", exact=True),
        ArmCause("gravity_sag", each(("sag", main, 0.001, "rad")), "load", "joints that carry the arm yield under its weight"),
        ArmCause("minor_sag", each(("sag", minor, 1e-4, "rad")), "load", "joints that carry little yield under their weight"),
        ArmCause("gear_once", gears(1, 1), "actuation", "gears or encoders err once a turn"),
        ArmCause("gear_twice", gears(2, 2), "actuation", "gears or encoders err twice a turn"),
        ArmCause("gear_ripple", gears(3, HARMONICS), "actuation", f"gears or encoders err 3 to {HARMONICS} times a turn"),
        ArmCause("lost_motion", each(("lost", joints, 1e-4, "rad")), "actuation", "joints stop on either side by their approach"),
        ArmCause(
            "tracker_scale", each(("tracker", ("scale",), 2e-4, "1")), "measurement", "lengths of the tracker are off", exact=True
        ),
        ArmCause("loose_mount", mount, "boundary", "the base tilts under the arm's weight or towards the outstretched arm"),
    )
    return tuple(cause for cause in causes if cause.parameters)


@dataclass(frozen=True)
class ArmModel:
    """An arm with all its causes."""

    arm: Arm
    _known: dict[bytes, _Poses] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Poses that were asked for last, by their angles."""

    @cached_property
    def causes(self) -> tuple[ArmCause, ...]:
        """See `arm_causes`."""
        return arm_causes(self.arm)

    @cached_property
    def parameters(self) -> dict[str, tuple[float, float, str]]:
        """Nominal value, plausible size and unit of every parameter of every cause."""
        return {name: values for cause in self.causes for name, values in cause.parameters.items()}

    def predict(self, theta: Mapping[str, ArrayLike], inputs: pd.DataFrame) -> Array:
        """Return the tool point in the world, m: (n, 3), or (variants, n, 3) if a value of theta is an array (variants,).

        theta: parameter -> value in its unit, 0 where it is missing. inputs: n rows, columns q1, q2 .. in rad. Optional columns
        q1_before, q2_before .. are the angles before the move to the pose: without them lost motion does nothing.
        Raises `BadEffect` for an unknown parameter, `BadCondition` for missing or non-finite angles.
        """
        values = self._values(theta, np.float64)
        out: Array = self._positions(values, self._poses(inputs))
        return out if any(np.ndim(value) for value in theta.values()) else out[0]

    def derivatives(self, theta: Mapping[str, float], inputs: pd.DataFrame, names: Sequence[str]) -> Array:
        """d position / d parameter at theta, (n, 3, names), m per unit; exact to rounding.

        By a complex step (Squire and Trapp 1998); errors of a joint's angle by the chain rule from the joint's zero.
        """
        poses = self._poses(inputs)
        if not names:
            return np.empty((len(inputs), 3, 0))
        values = self._values(theta, np.complex128)
        self._values(dict.fromkeys(names, 0.0), np.complex128)
        sources = {name: f"zero_{poses.errors[name][0] + 1}" if name in poses.errors else name for name in names}
        varied = sorted(set(sources.values()))
        for i, name in enumerate(varied):
            values[name] = values.get(name, np.zeros((1, 1))) + 1j * STEP * np.eye(len(varied))[i][:, None]
        slopes = dict(zip(varied, np.imag(self._positions(values, poses)) / STEP, strict=True))
        columns = [slopes[sources[n]] * (poses.errors[n][1][:, None] if n in poses.errors else 1.0) for n in names]
        return np.stack(columns, axis=-1)

    def _values(self, theta: Mapping[str, Any], kind: type) -> dict[str, Values]:
        """Parameter -> value (variants, 1) or (1, 1)."""
        if unknown := [name for name in theta if name not in self.parameters]:
            raise BadEffect(f"theta: {unknown[0]!r} is no parameter of {self.arm.name}: {nearest(unknown[0], self.parameters)}")
        return {name: np.asarray(value, kind).reshape(-1, 1) for name, value in theta.items()}

    def _positions(self, values: Mapping[str, Values], poses: _Poses) -> Values:
        """(variants, n, 3) in the world, m."""
        zero = np.zeros((1, 1))

        def value(name: str) -> Values:
            return values.get(name, zero)

        numbers = list(enumerate(self.arm.links, 1))
        angles: list[Values] = [poses.q[None, :, k - 1] + np.radians(link.offset_deg) for k, link in numbers]
        for name, own in values.items():
            if name in poses.errors:
                joint, shape = poses.errors[name]
                angles[joint] = angles[joint] + own * shape
        point: Point = to_frame_0(
            angles,
            [link.a + value(f"a_{k}") for k, link in numbers],
            [link.d + value(f"d_{k}") for k, link in numbers],
            [np.radians(link.alpha_deg) + value(f"alpha_{k}") for k, link in numbers],
            [value(f"beta_{k}") for k, _ in numbers],
            (self.arm.tool[0] + value("tool_x"), self.arm.tool[1] + value("tool_y"), self.arm.tool[2] + value("tool_z")),
        )
        base, at, moment = base_rotation(self.arm), self.arm.base_to_world.position, poses.moment
        x, y, z = (base[i, 0] * point[0] + base[i, 1] * point[1] + base[i, 2] * point[2] for i in range(3))
        play = value("mount_play") / np.maximum(np.hypot(moment[:, 0], moment[:, 1]), 1e-12)
        point = turn(0, value("base_rx") + (value("mount_compliance_x") + play) * moment[:, 0], (x, y, z))
        point = turn(1, value("base_ry") + (value("mount_compliance_y") + play) * moment[:, 1], point)
        point = turn(2, value("base_rz"), point)
        shifted = [at[i] + value(f"base_{axis}") + point[i] for i, axis in enumerate("xyz")]
        return np.stack(np.broadcast_arrays(*((1 + value("tracker_scale")) * part for part in shifted)), axis=-1)

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
        errors: dict[str, tuple[int, Array]] = {}
        for i, (name, angle) in enumerate(zip(self.arm.joints, q.T, strict=True)):
            k = i + 1
            errors |= {f"zero_{k}": (i, np.ones(len(q))), f"sag_{k}": (i, torques[:, i] / bounds[i])}
            errors[f"lost_{k}"] = i, np.nan_to_num(np.sign(angle - before.get(name, angle)))
            for h in range(1, HARMONICS + 1):
                errors |= {f"gear{h}_sin_{k}": (i, np.sin(h * angle)), f"gear{h}_cos_{k}": (i, np.cos(h * angle))}
        return _Poses(q, moment / bounds[0], errors)


@dataclass(frozen=True)
class _Poses:
    """Poses as the causes see them."""

    q: Array
    """(n, joints), rad."""
    moment: Array
    """(n, 3), moment of the weight on the base over its bound."""
    errors: Mapping[str, tuple[int, Array]]
    """Parameter of a joint's angle -> index of the joint, and the error of the angle per unit of it, (n,)."""
