"""Compare the tips' motion with the chambers' push: can another order of the chambers be the cause?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from model.effects.laws.actuation import ORDERS, orders
from model.effects.spec import EffectSpec
from model.robot import Robot
from model.stated import Stated

from ..arrays import Array
from ..data.campaign import Campaign

ORDER = "chamber_order"
"""The effect that swaps chambers."""
ELSEWHERE, ENOUGH, SAME = np.cos(np.radians(45.0)), 0.05, 20.0
"""Cosine of the angle between push and tip from which a state contradicts the order, the share of states that do, and deg within
which an actuator acts where one is stated."""
UNEQUAL = 0.01
"""Relative difference of distances from the axis, or of ends, up to which actuators are equal: they are known no better."""


def leave_out(robot: Robot, states: Campaign, catalogue: Mapping[str, EffectSpec]) -> Mapping[str, EffectSpec]:
    """A catalogue without another order of the chambers where the robot has one, or tips go to where the chambers push them."""
    if ORDER not in catalogue or (ORDER not in robot.effects and contradicted(robot, states)):
        return catalogue
    return {id: spec for id, spec in catalogue.items() if id != ORDER}


def contradicted(robot: Robot, states: Campaign) -> bool:
    """Whether tips go to other sides than the order of the chambers says."""
    push = (states.pressure @ robot.bending_directions) * np.exp(1j * states.roll)
    aside, strength = states.tip[:, 0] + 1j * states.tip[:, 1], np.abs(push)
    far = np.abs(aside)
    # tips closer to the axis have no direction
    own = (np.nan_to_num(far) > 0.03 * robot.length) & (strength > 0.2 * states.pressure.max(initial=1.0))
    if not own.any():
        return False
    along = (aside[own] * push[own].conj()).real / (far[own] * strength[own])
    return bool(np.mean(along < ELSEWHERE) > ENOUGH)


def apart(found: Array, given: Array) -> Array:
    """deg between azimuths, of shapes that fit each other."""
    return np.asarray(np.abs(np.mod(found - given + 180.0, 360.0) - 180.0))


def swaps(count: int) -> dict[tuple[int, int], list[int]]:
    """Pair of `count` actuators -> the order in which these two alone change places."""
    return {(i, j): [{i: j, j: i}.get(k, k) for k in range(count)] for i, j in combinations(range(count), 2)}


def order_at(robot: Robot, azimuths_deg: Array) -> list[int]:
    """(actuators,) whose pressures have each act at these azimuths, of the orders that the effect knows and those in which two
    change places; empty where none do, as at those of robot.yaml."""
    given, count = np.array(robot.actuators.azimuths_deg), len(azimuths_deg)
    others = [o for o in (*orders(given.tolist()).tolist(), *swaps(count).values()) if o != [*range(count)]]
    return next((order for order in others if (apart(azimuths_deg[order], given) < SAME).all()), [])


def equal(robot: Robot, order: Sequence[int]) -> bool:
    """Whether each actuator is like the one whose pressure it gets: then azimuths in this order predict the same."""
    drive, count = robot.actuators, len(robot.actuators.azimuths_deg)
    own = np.array([drive.levers, drive.shares, np.broadcast_to(drive.ends or robot.length, count)])
    return bool((np.abs(own[:, order] - own) <= UNEQUAL * own).all())


def with_order(robot: Robot, place: int) -> Robot:
    """The robot with its chambers connected so, as its robot.yaml would state it."""
    values = {"blend": 1.0, "which": float(place - len(ORDERS) // 2)}
    stated = {name: Stated(value=value, sd=0.0, unit="1") for name, value in values.items()}
    return robot.model_copy(update={"effects": {**robot.effects, ORDER: stated}})
