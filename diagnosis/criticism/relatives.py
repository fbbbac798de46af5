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
from model.effects.spec import EffectSpec, Law, Parameter, Stage, Values, adding, growing, vector
from model.robot import Robot

from ..arrays import Array

ASIDE = 0.5
"""Robot lengths aside at which sizes that grow away from the axis are counted."""


def _highest(q: Quantities) -> Array:
    """(1, n) highest pressure of each state, shares of the robot's."""
    return np.asarray(np.maximum(q.design.pressure.max(axis=1), 0.0)[None] / q.scales.pressure)


def walls(robot: Robot) -> list[tuple[int, ...]]:
    """The two neighbours about the axis, numbered from 1, that each wall parts."""
    ring = (np.argsort(np.mod(robot.actuators.azimuths_deg, 360.0), kind="stable") + 1).tolist()
    return sorted({(min(pair), max(pair)) for pair in zip(ring, [*ring[1:], ring[0]], strict=True) if pair[0] != pair[1]})


PLACES: Mapping[str, tuple[Callable[[Robot], list[tuple[int, ...]]], str]] = {
    "shared_pressure": (walls, "neighbouring {actuators}"),
    "regulator_offset": (lambda robot: [(k,) for k, _ in enumerate(robot.actuators.azimuths_deg, 1)], "one {actuator}"),
}
"""Relatives with a size at each place of the cross-section -> the numbers of the actuators there, and words for any of them."""


def _shared_pressure(q: Quantities, v: Values) -> None:
    """P_i + sum w_ik (P_k - P_i) over both neighbours k: a share of each difference passes the wall."""
    first, second = np.array(walls(q.robot)).T - 1
    passed, one = vector(*v.values()) * (q.pressure[..., second] - q.pressure[..., first]), np.eye(q.pressure.shape[-1])
    q.pressure = q.pressure + passed @ (one[first] - one[second])


def _over(law: Callable[[Quantities, Values], None], factor: Callable[[Quantities], Array] = lambda q: q.design.progress) -> Law:
    """Of sizes in proportion to a factor, (n,) or (1, n): the share of the campaign that has passed, unless another is given."""
    return Law(before=lambda q, v: law(q, {name: size * factor(q) for name, size in v.items()}))


def _stretched(r: Readings, share: Array, power: int) -> None:
    """Places grow by a share, times a power of how far aside they are."""
    for name, each in (("tip", share[..., None]), ("markers", share[..., None, None])):
        place = getattr(r, name)
        aside = np.linalg.norm(place[..., :2], axis=-1, keepdims=True) / (ASIDE * r.length)
        setattr(r, name, place * (1 + each * aside**power))


ANGLE = math.radians(1.5)


def _relative(id: str, stage: Stage, label: str, told_by: str, law: Law, *parameters: Parameter) -> EffectSpec:
    """`label` and `told_by` have {} for the place of a relative of `PLACES`."""
    shown = {"structure": with_spine, "actuation": by_chambers}.get(stage)
    anywhere, says = (label.format(PLACES[id][1]), label) if id in PLACES else (label, "")
    spec = EffectSpec(id, stage, "", parameters, law, "mechanics", told_by, anywhere, says)
    return replace(spec, tolerated=False, shown=shown, standard=True)


AGAIN = "repeat the first trial at the end of the campaign"
RELATIVES: Mapping[str, EffectSpec] = MappingProxyType({
    s.id: s
    for s in (
        replace(CATALOGUE["chamber_gain"], tolerated=False, shown=by_chambers, seen_best_in="inflate other chambers"),
        _relative(
            "shared_pressure", "actuation", "leaks between {}",
            "hold one of {} at pressure with the other vented, and read the pressure in the vented one and the tip",
            Law(before=_shared_pressure), Parameter("share", "1", 0.13, 0.0, 0.5)),
        _relative(
            "regulator_offset", "actuation", "a regulator's offset at {}",
            "read the pressure gauges with all {actuators} open to the air",
            Law(before=lambda q, v: setattr(q, "pressure", q.pressure + vector(*v.values()))),
            Parameter("zero", "Pa", 2.5e3, -25e3, 25e3)),
        _relative(
            "gauge_drift", "actuation", "drift of the pressure gauges", AGAIN,
            _over(growing(pressure="gain")), Parameter("gain", "1", 0.05, -0.5, 0.5)),
        _relative(
            "body_ages", "material", "a body that softens or warms during the campaign", AGAIN,
            _over(lambda q, v: growing(body_modulus="by")(q, {"by": v["slope"] + v["bend"] * 4 * (1 - q.design.progress)})),
            Parameter("slope", "1", 0.1, -0.5, 0.5), Parameter("bend", "1", 0.1, -0.5, 0.5)),
        _relative(
            "spine_ages", "structure", "a spine that packs or wears during the campaign", AGAIN,
            _over(growing(spine_stiffness="slope")), Parameter("slope", "1", 0.2, -0.5, 1.0)),
        _relative(
            "spine_pressed", "structure", "{actuators} that press on the spine",
            "measure the stiffness of the body with {inflated} {actuators}",
            _over(growing(spine_stiffness="gain"), _highest), Parameter("gain", "1", 0.2, -0.5, 1.0)),
        _relative(
            "spine_off_axis", "structure", "a spine beside the axis", "{inflate} all {actuators} at once",
            _over(adding(rest_curvature=("x", "y")), lambda q: _highest(q) * q.design.spine_length / q.robot.length),
            Parameter("x", "1/m", 0.1, -1.0, 1.0), Parameter("y", "1/m", 0.1, -1.0, 1.0)),
        _relative(
            "mount_creeps", "boundary", "a mount that turns during the campaign", AGAIN,
            _over(adding(base_turn=("x", "y"))), *(Parameter(a, "rad", ANGLE, -0.2, 0.2) for a in "xy")),
        _relative(
            "body_length", "boundary", "a different length of the body", "measure the body",
            Law(before=adding(length="excess")), Parameter("excess", "m", 5e-3, -0.05, 0.05)),
        _relative(
            "camera_scale", "measurement", "the scale of the cameras", "let the cameras read a rod of known length",
            Law(after=lambda r, v: _stretched(r, v["excess"], 0)), Parameter("excess", "1", 0.02, -0.2, 0.2)),
        _relative(
            "lens", "measurement", "distortion of the cameras", "let the cameras read a rod of known length where the tip was",
            Law(after=lambda r, v: _stretched(r, v["bend"], 2)), Parameter("bend", "1", 0.02, -0.2, 0.2)),
        _relative(
            "cameras_creep", "measurement", "cameras that turn during the campaign",
            "let the cameras read a fixed marker before and after",
            Law(after=lambda r, v: r.turn(r.design.progress[None, : r.tip.shape[1], None] * vector(v["x"], v["y"], v["z"]))),
            *(Parameter(a, "rad", ANGLE / math.sqrt(3), -0.3, 0.3) for a in "xyz")),
    )
})  # fmt: skip
"""By id; `seen_best_in` distinguishes it from others. Unequal chambers are a relative if they are not in the catalogue, because
these states cannot show them."""


def relatives(robot: Robot) -> dict[str, EffectSpec]:
    """The relatives of a robot: those of `PLACES` with one size at each place."""
    out = dict(RELATIVES)
    for id, (places, _) in PLACES.items():
        (size,), spec = RELATIVES[id].parameters, out.pop(id)
        each = tuple(replace(size, name="_".join([size.name, *map(str, numbers)])) for numbers in places(robot))
        out |= {id: replace(spec, parameters=each)} if each else {}
    return out


def named_places(id: str, robot: Robot) -> list[str]:
    """Names of the places of a relative of `PLACES`, in the order of its sizes."""
    return [robot.actuators.words.group(numbers).replace(", ", " and ") for numbers in PLACES[id][0](robot)]
