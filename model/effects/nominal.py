"""The effects that robot.yaml states, checked against what is known of effects, as values of a parameter table."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from model.arrays import Array
from model.effects.catalogue import CATALOGUE
from model.effects.parameters import ParameterInfo
from model.effects.scales import scales
from model.effects.spec import EffectSpec, Law, Values
from model.effects.tolerance import ALWAYS, JAMMING, as_drawn, as_stated
from model.errors import BadRobot, nearest, unit_text
from model.robot import Robot
from model.stated import Table

ROUNDING = 1e-6
"""Plausible sizes by which a number beyond its bound is at the bound: robot.yaml has seven digits."""


def tolerances(robot: Robot) -> dict[str, EffectSpec]:
    """Tolerances of a whole set-up, by id, with the uncertainty that robot.yaml states or that is usual for such a robot."""
    own, stated = scales(robot), robot.uncertainty.stated
    of_set_up = (*ALWAYS, JAMMING, *as_drawn(len(robot.actuators.azimuths_deg), stated))
    return {source.spec.id: as_stated(source, own, stated).spec for source in of_set_up}


def stated_effects(robot: Robot, catalogue: Mapping[str, EffectSpec] = CATALOGUE) -> dict[str, EffectSpec]:
    """Effects that robot.yaml states, by id, of the project's own catalogue and the given one.

    Raises `BadRobot` for an effect, tolerance, parameter or unit that is not known, and a value out of its bounds.
    """
    known = {**CATALOGUE, **catalogue}
    own = scales(robot)
    problems = [
        *_problems("effects", robot.causes, {id: spec.of(own) if id in robot.causes else spec for id, spec in known.items()}),
        *_problems("tolerances", robot.tolerances, tolerances(robot)),
    ]
    if problems:
        raise BadRobot("\n".join(f"robot {robot.name!r}: {line}" for line in problems))
    return {id: spec for id, spec in known.items() if id in robot.causes}


def _problems(key: str, table: Table, specs: Mapping[str, EffectSpec]) -> Iterable[str]:
    """What is wrong with the values of `table`, the part `key` of robot.yaml: ids and names not in `specs`, units, bounds."""
    for id, stated_values in table.items():
        if id not in specs:
            own_effect = "; if it is an effect of your own, install its package, or give its file to a command that has --effects"
            yield f"{key}.{id}: is not known, {nearest(id, specs)}{own_effect if key == 'effects' else ''}"
            continue
        parameters = {p.name: p for p in specs[id].parameters}
        for name, stated in stated_values.items():
            place = f"{key}.{id}.{name}"
            p = parameters.get(name)
            if p is None:
                yield f"{place}: is no parameter of {id}, {nearest(name, parameters)}"
            elif stated.unit != p.unit:
                yield f"{place}: unit {stated.unit!r}, must be {p.unit!r}: convert value and sd"
            elif not p.low - ROUNDING * p.scale <= stated.value <= p.high + ROUNDING * p.scale:
                unit = unit_text(p.unit)
                yield f"{place} = {stated.value:g}{unit}: must be within {p.low:g} and {p.high:g}{unit}"


def fixed_laws(robot: Robot, catalogue: Mapping[str, EffectSpec]) -> dict[str, tuple[Law, Values]]:
    """Laws and values (1, 1) of the robot's effects that are not in `catalogue`, by id, 0 where none is stated.

    Raises as `stated_effects`.
    """
    fixed = {id: spec for id, spec in stated_effects(robot, catalogue).items() if id not in catalogue}
    zero, values = np.zeros((1, 1)), {name: np.full((1, 1), stated.value) for name, stated in robot.stated.items()}
    return {id: (spec.law, {p.name: values.get(f"{id}.{p.name}", zero) for p in spec.parameters}) for id, spec in fixed.items()}


def beyond(robot: Robot, infos: tuple[ParameterInfo, ...], nominal: Array) -> tuple[ParameterInfo, ...]:
    """Parameters that count from `nominal` (p,), what robot.yaml states: bounds and starts less that.

    An effect that the robot has may be larger or smaller than stated, so it has both signs; and as it has a size, a change of its
    shapes moves the robot too: all its parameters are sizes, which do nothing at zero.
    """
    present = {i.source for i, value in zip(infos, nominal, strict=True) if value and i.role == "size"}
    counted = [
        replace(i, low=i.low - value, high=i.high - value, starts=tuple(start - value for start in i.starts))
        for i, value in zip(infos, nominal.tolist(), strict=True)
    ]
    return tuple(replace(i, sign="both", role="size", starts=(0.0,)) if i.source in present else i for i in counted)


def obstacle_direction(robot: Robot) -> Array | None:
    """(2,) unit vector in the base frame's x, y towards the obstacle that robot.yaml places; None where it does not."""
    if robot.obstacle_azimuth_deg is None:
        return None
    angle = math.radians(robot.obstacle_azimuth_deg)
    return np.array([math.cos(angle), math.sin(angle)])
