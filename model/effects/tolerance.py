"""What is never quite as drawn: calibration of the chamber area, and tolerances with tight priors.

They enter the forward model like effects, but are no causes to be named.
"""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from model.condition import States
from model.effects.design import TURN
from model.effects.laws.measurement import force_bias, frame_misalignment, marker_offset
from model.effects.laws.surroundings import base_tilt
from model.effects.quantities import Quantities
from model.effects.readings import Readings
from model.effects.scales import Scales, scales
from model.effects.spec import EffectSpec, Law, Parameter, Stage, Values, adding, growing, vector
from model.robot import Robot
from model.rotation import from_vector, multiply

Scope = Literal["all", "trial", "spine_length", "push", "mount", "repeat", "campaign"]
"""push: each stiffness trial, of any specimen; trial: each trial with spine; mount: each roll and sitting but the most usual;
repeat: each repeat of the sweep; campaign: all of it, but another campaign's is another."""
Group = Literal["effect", "calibration", "nuisance"]


@dataclass(frozen=True)
class VariationSource:
    """An effect, tolerance or calibration and how many copies of its parameters there are."""

    spec: EffectSpec
    group: Group
    scope: Scope = "all"


def _beside(quantity: str, number: str, q: Quantities, v: Values) -> None:
    """A share of the robot's `number` beside what an effect adds, not times it: then the two trade along a straight line."""
    setattr(q, quantity, getattr(q, quantity) + getattr(q.robot, number) * v["excess"])


def _drift(q: Quantities, v: Values) -> None:
    """E grows by `slope` from the first state to the last, and by `bend` more at both ends than half way."""
    u = q.design.progress - 0.5
    q.body_modulus = q.body_modulus + q.robot.youngs_modulus * (v["slope"] * u + v["bend"] * 4 * u**2)


def _pressure_zero(q: Quantities, v: Values) -> None:
    q.pressure = q.pressure + vector(*v.values()) * ~q.design.stiffness[:, None]


def _path_radius(q: Quantities, v: Values) -> None:
    q.lever = q.lever + v["excess"] / np.mean(q.robot.actuators.path_radius)


def _frame_shift(r: Readings, v: Values) -> None:
    shift = vector(v["x"], v["y"], v["z"])
    r.tip = r.tip + shift
    r.markers = r.markers + shift[..., None, :]


def _tracked_turn(r: Readings, v: Values) -> None:
    r.orientation = multiply(r.orientation, from_vector(vector(v["x"], v["y"], v["z"])))


def _marker_shift(r: Readings, v: Values) -> None:
    count = r.design.markers
    if r.markers.shape[2] == count:  # else they are other points of the shape
        r.markers = r.markers + np.stack([vector(*(v[f"m{k}{a}"] for a in "xyz")) for k in range(1, count + 1)], axis=-2)


def _spine_length(q: Quantities, v: Values) -> None:
    excess = np.where(q.design.spine_length > 0, v["excess"], 0.0)
    q.spine_length, q.tabulated_length = q.spine_length + excess, q.tabulated_length + excess


def _push_place(q: Quantities, v: Values) -> None:
    along = np.where(q.design.stiffness, v["along"], 0.0)
    q.spine_length = q.spine_length + np.where(q.design.body, 0.0, along)
    q.length = q.length + np.where(q.design.body, along, 0.0)


def _tolerance(
    id: str, stage: Stage, law: Law, *parameters: Parameter, scope: Scope = "all", standard: bool = False
) -> VariationSource:  # fmt: skip
    spec = EffectSpec(id, stage, "", parameters, law, "tolerance", "", standard=standard)
    return VariationSource(spec, "nuisance", scope)


def _each(unit: str, sd: float, *names: str, widest: float = 10.0) -> tuple[Parameter, ...]:
    """Parameters of one standard deviation, of x, y and z where no names are given."""
    return tuple(Parameter(name, unit, sd, -widest * sd, widest * sd) for name in names or "xyz")


AREA = _tolerance("area", "actuation", Law(before=growing(area_factor="excess")), Parameter("excess", "1", 0.5, -0.9, 8.0)).spec
ANGLE = math.radians(0.1)
ALWAYS = (
    _tolerance(
        "youngs_modulus", "material", Law(before=partial(_beside, "body_modulus", "youngs_modulus")), *_each("1", 0.02, "excess")
    ),
    _tolerance("density", "load", Law(before=partial(_beside, "density", "density")), *_each("1", 0.01, "excess")),
    _tolerance("tilt", "boundary", Law(before=base_tilt), *_each("rad", ANGLE, "x", "y")),
    _tolerance("frame_turn", "measurement", Law(after=frame_misalignment), *_each("rad", ANGLE)),
    _tolerance("frame_shift", "measurement", Law(after=_frame_shift), *_each("m", 1.6e-3, widest=30.0), standard=True),
    _tolerance("length", "boundary", Law(before=adding(length="excess")), *_each("m", 1.6e-3, "excess"), standard=True),
)
"""Where a soft body begins at its clamp, and the cameras' origin beside it, is known to 0.4 % of its length."""
BY_TRIAL = (
    _tolerance("spine_length", "structure", Law(before=_spine_length), *_each("m", 1e-3, "excess"), scope="trial"),
    _tolerance(
        "spine_stiffness", "structure", Law(before=growing(spine_stiffness="excess")), *_each("1", 0.02, "excess"), scope="trial"
    ),
)
BY_PUSH = (
    _tolerance("touch", "measurement", Law(before=adding(contact_offset="late")), *_each("m", 0.3e-3, "late"), scope="push"),
    _tolerance("zero", "measurement", Law(after=force_bias), Parameter("force", "N", 0.05, -1.0, 1.0), scope="push"),
)
"""Where a stiffness trial's deflection is counted from, and its force: contact is found anew, the sensor zeroed anew."""
PUSH_PLACE = _tolerance("push_place", "measurement", Law(before=_push_place), *_each("m", 1e-3, "along"))
"""The same of all pushes, where robot.yaml states its standard deviation: the arm's error at the stand."""
TRACKED_TURN = _tolerance("tracked_turn", "measurement", Law(after=_tracked_turn), *_each("rad", 30 * ANGLE))
"""How the body of markers sits on the tip, where its orientation was measured."""


def as_drawn(actuators: int, names: Container[str]) -> tuple[VariationSource, ...]:
    """Tolerances of a robot's drawing, those of `names`: nothing is usual for them, so that robot.yaml states each."""
    each = tuple(f"p{k}" for k in range(1, actuators + 1))
    found = (
        _tolerance("axial_stiffness", "material", Law(before=growing(stretching="excess")), *_each("1", 0.02, "excess")),
        _tolerance("azimuths", "actuation", Law(before=adding(azimuth=each)), *_each("rad", ANGLE, *each)),
        _tolerance("pressure_gain", "actuation", Law(before=growing(pressure=each)), *_each("1", 0.01, *each)),
        _tolerance("pressure_zero", "actuation", Law(before=_pressure_zero), *_each("Pa", 300.0, *each)),
        _tolerance("path_radius", "actuation", Law(before=_path_radius), *_each("m", 0.1e-3, "excess")),
        _tolerance("tip_mass", "load", Law(before=adding(payload="excess")), *_each("kg", 1e-3, "excess")),
        _tolerance("tracked_shift", "measurement", Law(after=marker_offset), *_each("m", 0.5e-3)),
    )
    return tuple(source for source in found if source.spec.id in names)


TURNED = Law(before=adding(base_turn=("x", "y"), azimuth="z"))
MOUNT = (
    _tolerance("mount_turn", "boundary", TURNED, *_each("rad", ANGLE), scope="mount"),
    _tolerance("mount_shift", "boundary", Law(after=_frame_shift), *_each("m", 0.5e-3), scope="mount"),
)
"""A robot that is mounted anew, rolled or on another day, stands a little differently."""
REPEATS = (
    _tolerance("repeat_turn", "boundary", TURNED, *_each("rad", ANGLE / 2), scope="repeat"),
    _tolerance("repeat_shift", "boundary", Law(after=_frame_shift), *_each("m", 0.2e-3), scope="repeat"),
)
"""So does one that may have been mounted anew before a repeat of the sweep; how much, its repeats show."""
DRIFT = _tolerance(
    "drift", "material", Law(before=_drift), *_each("1", 0.015, "slope"), *_each("1", 0.005, "bend"), scope="campaign"
)
"""Silicone softens as it is worked, and is as warm as the room."""
VACUUM_SWEEP = 0.05
"""Spread of the vacuum, in nominal vacuums, above which its exponent shows."""
JAMMING = _tolerance(
    "jamming", "structure", Law(before=adding(jamming_exponent="exponent")), Parameter("exponent", "1", 0.15, -0.4, 0.5)
)


def as_stated(source: VariationSource, sized: Scales, uncertainty: Mapping[str, float]) -> VariationSource:
    """A tolerance with the sd that robot.yaml states (`uncertainty`: id -> sd), bounds 10 sd, a relative one above -80 %, else
    the usual one of a robot with these scales."""
    sd = uncertainty.get("area_factor" if source.spec is AREA else source.spec.id)
    if sd is None:
        return replace(source, spec=source.spec.of(sized))
    made = tuple(
        replace(p, scale=sd, low=max(-10 * sd, -0.8) if p.unit == "1" else -10 * sd, high=10 * sd) for p in source.spec.parameters
    )
    return replace(source, spec=replace(source.spec, parameters=made))


def mounts(design: States) -> list[tuple[float, int]]:
    """Roll (deg) and sitting of each mounting, that of most states first."""
    of_robot = ~design.stiffness
    roll_and_sitting = np.column_stack([np.round(np.degrees(design.roll[of_robot])), design.sitting[of_robot]])
    mountings, count = np.unique(roll_and_sitting, axis=0, return_counts=True)
    return [(float(roll), int(sitting)) for roll, sitting in mountings[np.argsort(-count, kind="stable")]]


def single_sources(robot: Robot, effects: tuple[EffectSpec, ...]) -> tuple[VariationSource, ...]:
    """What has parameters of states that are each reached from rest: one copy of each."""
    own, stated = scales(robot), robot.uncertainty.stated
    chosen = [VariationSource(spec, "effect") for spec in effects]
    known = (*ALWAYS, *as_drawn(len(robot.actuators.azimuths_deg), stated))
    chosen += [*(as_stated(source, own, stated) for source in known), VariationSource(AREA, "calibration")]
    if robot.spine is not None:
        chosen += [replace(source, scope="all") for source in BY_TRIAL]
    return (*chosen, JAMMING) if JAMMING.spec.id in robot.tolerances else tuple(chosen)


def sources(
    design: States,
    catalogue: tuple[EffectSpec, ...],
    area: Literal["one", "per_length"],
    sized: Scales,
    uncertainty: Mapping[str, float],
) -> tuple[VariationSource, ...]:
    """Everything that has parameters, in the order of the parameter table: effects, tolerances, calibration, then what the design
    has several of (mountings, repeats, trials). `sized`: the robot's scales; `uncertainty`: tolerance -> standard deviation,
    where it is not the usual one."""
    of_robot = bool((~design.stiffness).any())
    chosen = list(ALWAYS if of_robot else ALWAYS[:2])
    if of_robot:
        chosen.append(VariationSource(AREA, "calibration", "all" if area == "one" else "spine_length"))
        chosen += as_drawn(design.pressure.shape[1], uncertainty)
        if np.ptp(design.progress[~design.stiffness]) > 0:
            chosen.append(DRIFT)
    if TURN[0] in design.channels:
        chosen.append(TRACKED_TURN)
    if design.markers and "marker_shift" in uncertainty:
        by_marker = _each("m", uncertainty["marker_shift"], *(f"m{k}{a}" for k in range(1, design.markers + 1) for a in "xyz"))
        chosen.append(_tolerance("marker_shift", "measurement", Law(after=_marker_shift), *by_marker))
    if len(mounts(design)) > 1:
        chosen += MOUNT
    if len(np.unique(design.repeat[~design.stiffness])) > 1:
        chosen += REPEATS
    if (design.spine_length > 0).any():
        chosen += BY_TRIAL
        with_spine = design.vacuum[design.spine_length > 0]
        if np.ptp(with_spine) > VACUUM_SWEEP * design.nominal_vacuum:
            chosen.append(JAMMING)
    if design.stiffness.any():
        chosen += [*BY_PUSH, *([PUSH_PLACE] if PUSH_PLACE.spec.id in uncertainty else [])]
    effects = (VariationSource(spec, "effect") for spec in catalogue)
    return (*effects, *(as_stated(source, sized, uncertainty) for source in chosen))
