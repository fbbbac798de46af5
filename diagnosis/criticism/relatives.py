"""Causes outside the catalogue that a person would think of: relatives of its effects.

They follow the chain from pressure to reading: how each part and instrument may deviate (leak, drift, creep, lie off the axis,
be longer, be wrongly scaled) where the catalogue has no effect for it. They were not taken from the robots on which a diagnosis
is scored. They have laws in the catalogue's language, but nothing searches for them: to
first order, in the linear problems of what was found, each is put in the place of an effect (`outside`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from model.effects.catalogue import CATALOGUE
from model.effects.quantities import Quantities
from model.effects.readings import Readings
from model.effects.shows import by_chambers, with_spine
from model.effects.spec import EffectSpec, Law, Parameter, Stage, Values, vector

from ..arrays import Array

ASIDE = 0.5
"""Robot lengths aside at which sizes that grow away from the axis are counted."""


def _highest(q: Quantities) -> Array:
    """(1, n) highest pressure of each state, shares of the robot's."""
    return np.asarray(np.maximum(q.design.pressure.max(axis=1), 0.0)[None] / q.scales.pressure)


def _shared_pressure(q: Quantities, v: Values) -> None:
    ring = np.argsort(np.mod(q.robot.actuators.azimuths_deg, 360.0), kind="stable")
    back = np.argsort(ring)
    p = q.pressure[..., ring]
    mean = 0.5 * (np.roll(p, 1, axis=-1) + np.roll(p, -1, axis=-1))
    q.pressure = q.pressure + v["share"][..., None] * (mean - p)[..., back]


def _gauge_drift(q: Quantities, v: Values) -> None:
    q.pressure = q.pressure * (1 + v["gain"] * q.design.progress)[..., None]


def _body_ages(q: Quantities, v: Values) -> None:
    u = q.design.progress
    q.body_modulus = q.body_modulus * (1 + v["slope"] * u + v["bend"] * 4 * u * (1 - u))


def _spine_ages(q: Quantities, v: Values) -> None:
    q.spine_stiffness = q.spine_stiffness * (1 + v["slope"] * q.design.progress)


def _spine_pressed(q: Quantities, v: Values) -> None:
    q.spine_stiffness = q.spine_stiffness * (1 + v["gain"] * _highest(q))


def _spine_off_axis(q: Quantities, v: Values) -> None:
    covered = q.design.spine_length / q.robot.length
    q.rest_curvature = q.rest_curvature + (_highest(q) * covered)[..., None] * vector(v["x"], v["y"])


def _mount_creeps(q: Quantities, v: Values) -> None:
    q.base_turn = q.base_turn + q.design.progress[None, :, None] * vector(v["x"], v["y"])


def _body_length(q: Quantities, v: Values) -> None:
    q.length = q.length + v["excess"]


def _camera_scale(r: Readings, v: Values) -> None:
    _stretched(r, lambda place: _along(v["excess"], place))


def _lens(r: Readings, v: Values) -> None:
    _stretched(
        r, lambda place: _along(v["bend"], place) * (place[..., :2] ** 2).sum(axis=-1, keepdims=True) / (ASIDE * r.length) ** 2
    )


def _along(value: Array, place: Array) -> Array:
    """(v, n, 1) or (v, n, 1, 1) beside places (v, n, 3) or (v, n, k, 3)."""
    return value[(..., *(None,) * (place.ndim - 2))]


def _stretched(r: Readings, by: Callable[[Array], Array]) -> None:
    r.tip = r.tip * (1 + by(r.tip))
    if r.markers.shape[2]:
        r.markers = r.markers * (1 + by(r.markers))


def _cameras_creep(r: Readings, v: Values) -> None:
    r.turn(r.design.progress[None, : r.tip.shape[1], None] * vector(v["x"], v["y"], v["z"]))


ANGLE = math.radians(1.5)


def _relative(id: str, stage: Stage, label: str, told_by: str, law: Law, *parameters: Parameter) -> EffectSpec:
    shown = {"structure": with_spine, "actuation": by_chambers}.get(stage)
    return EffectSpec(id, stage, "", parameters, law, "mechanics", told_by, label, tolerated=False, shown=shown, standard=True)


AGAIN = "repeat the first trial at the end of the campaign"
RELATIVES: Mapping[str, EffectSpec] = MappingProxyType({
    s.id: s
    for s in (
        replace(CATALOGUE["chamber_gain"], tolerated=False, shown=by_chambers, seen_best_in="inflate other chambers"),
        _relative(
            "shared_pressure", "actuation", "leaks between neighbouring chambers",
            "measure the pressure in a vented chamber while its neighbour is inflated",
            Law(before=_shared_pressure), Parameter("share", "1", 0.15, -0.5, 0.5)),
        _relative(
            "gauge_drift", "actuation", "drift of the pressure gauges", AGAIN,
            Law(before=_gauge_drift), Parameter("gain", "1", 0.05, -0.5, 0.5)),
        _relative(
            "body_ages", "material", "a body that softens or warms during the campaign", AGAIN,
            Law(before=_body_ages), Parameter("slope", "1", 0.1, -0.5, 0.5), Parameter("bend", "1", 0.1, -0.5, 0.5)),
        _relative(
            "spine_ages", "structure", "a spine that packs or wears during the campaign", AGAIN,
            Law(before=_spine_ages), Parameter("slope", "1", 0.2, -0.5, 1.0)),
        _relative(
            "spine_pressed", "structure", "{actuators} that press on the spine",
            "measure the stiffness of the body with {inflated} {actuators}",
            Law(before=_spine_pressed), Parameter("gain", "1", 0.2, -0.5, 1.0)),
        _relative(
            "spine_off_axis", "structure", "a spine beside the axis", "{inflate} all {actuators} at once",
            Law(before=_spine_off_axis), Parameter("x", "1/m", 0.1, -1.0, 1.0), Parameter("y", "1/m", 0.1, -1.0, 1.0)),
        _relative(
            "mount_creeps", "boundary", "a mount that turns during the campaign", AGAIN,
            Law(before=_mount_creeps), Parameter("x", "rad", ANGLE, -0.2, 0.2), Parameter("y", "rad", ANGLE, -0.2, 0.2)),
        _relative(
            "body_length", "boundary", "a different length of the body", "measure the body",
            Law(before=_body_length), Parameter("excess", "m", 5e-3, -0.05, 0.05)),
        _relative(
            "camera_scale", "measurement", "the scale of the cameras", "let the cameras read a rod of known length",
            Law(after=_camera_scale), Parameter("excess", "1", 0.02, -0.2, 0.2)),
        _relative(
            "lens", "measurement", "distortion of the cameras", "let the cameras read a rod of known length where the tip was",
            Law(after=_lens), Parameter("bend", "1", 0.02, -0.2, 0.2)),
        _relative(
            "cameras_creep", "measurement", "cameras that turn during the campaign",
            "let the cameras read a fixed marker before and after", Law(after=_cameras_creep),
            *(Parameter(a, "rad", ANGLE / math.sqrt(3), -0.3, 0.3) for a in "xyz")),
    )
})  # fmt: skip
"""By id; `seen_best_in` distinguishes it from others. Unequal chambers are a relative if they are not in the catalogue, because
these states cannot show them."""
