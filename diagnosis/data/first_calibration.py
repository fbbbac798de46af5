"""Numbers of robot.yaml and of the set-up that are far off, calibrated before anything is diagnosed.

The diagnosis is local: around a robot that is described far off, each of its hypotheses is wrong. So a few numbers are fitted
first, robustly and over wide bounds,

    min sum_i rho(|tip_i - rod(theta)_i|^2 / s^2) + sum_k (theta_k / w_k)^2,    rho(z) = 2 (sqrt(1 + z) - 1),

theta: area factor (free), E with G (w = ln 2), azimuth of the chambers, direction of gravity, and where the cameras' frame has
its origin; s is 1 % of the robot's length. Numbers are taken over only beyond `FIRST_USUAL`, which the diagnosis describes
itself, and only where going beyond leaves less than 0.3 of the robust rms. Where one weight more, at the tip or all along,
leaves as little, nothing is taken over: the diagnosis can name that weight.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from model.condition import States
from model.errors import ModelError
from model.robot import Robot
from model.rods import FINE, solve
from model.section import body_mass, rods_of

from .. import judgement
from ..arrays import Array, Mask
from ..findings import Finding, finding
from .campaign import Campaign, settings, spread_over, tip_masses
from .chamber_sides import can_name_order, exchanged, reordered, with_order

NAMES = ("area_factor", "youngs_modulus", "azimuth", "gravity_x", "gravity_y", "origin_x", "origin_y", "origin_z")
ORIGIN, STEP = 5, 1.5e-8
"""The first parameter of the origin, which moves every tip alike, and the step of differences by the others, relative."""
DIRECT = replace(FINE, follow=False)
"""A rod so soft that it has to be loaded in steps, at a thousand times the cost, counts as one that does not stand."""
STIFFER = (3.0, 9.0)
"""Times the modulus, with the area factor as it is or as many times larger, where the wide fit may begin."""
QUARTERS = (0.0, np.pi / 2, -np.pi / 2, np.pi)
"""Azimuths by which chambers may be counted from another one."""


@dataclass(frozen=True)
class Adjusted:
    """One number that the data ask to be another."""

    name: str
    given: float
    found: float
    unit: str
    at_bound: bool = False
    short: str = ""
    """What a headline calls it; empty: by its name."""
    rather: str = ""
    """Another number that may be wrong by as much."""

    @property
    def finding(self) -> Finding:
        """What a person reads of it."""
        return finding(
            "refitted_to_limit" if self.at_bound else "refitted_or" if self.rather else "refitted",
            name=self.name, found=self.found, given=self.given, unit=self.unit, rather=self.rather,
        )  # fmt: skip


@dataclass(frozen=True)
class FirstCalibration:
    """The robot and the states around which a diagnosis is made."""

    robot: Robot
    states: Campaign
    adjusted: tuple[Adjusted, ...] = ()
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m, taken off every measured position."""
    before: float = 0.0
    after: float = 0.0
    """m, robust rms of the tip within `FIRST_USUAL`, and with the numbers found."""
    order: Finding | None = None
    """Chambers that are connected in another order."""

    @property
    def changes(self) -> list[Finding]:
        """What was changed; empty where nothing was."""
        return [*([self.order] if self.order else ()), *(a.finding for a in self.adjusted)]

    @property
    def named(self) -> str:
        """The number that was taken over, or how many, in a few words; empty where none was."""
        names = [a.short or a.name for a in self.adjusted]
        return f"{len(names)} numbers of robot.yaml" if len(names) > 1 else "".join(names)

    @property
    def concerns(self) -> list[Finding]:
        """What a person has to know and to check; nothing where nothing was changed."""
        before_mm, after_mm = self.before * 1e3, self.after * 1e3
        return [finding("refitted_first", before_mm=before_mm, after_mm=after_mm, changes=self.changes)] if self.changes else []

    def detail(self) -> dict[str, object]:
        """For the answer's JSON."""
        keys = ("name", "given", "found", "unit", "at_bound")
        adjusted = [{key: getattr(a, key) for key in keys} for a in self.adjusted]
        numbers = {"before_mm": self.before * 1e3, "after_mm": self.after * 1e3, "adjusted": adjusted}
        return numbers | ({"order": self.order.text} if self.order else {})

    def moved(self, states: Campaign) -> Campaign:
        """Other states in the same frame."""
        if not any(self.shift):
            return states

        return replace(states, trials=states.trials.moved([-s for s in self.shift]))


def calibrate_first(robot: Robot, states: Campaign, effects: Collection[str] = ()) -> FirstCalibration:
    """Take over what is far off; a robot that is near its data, or has effects of its own, comes back as it is.

    `effects`: those that are weighed afterwards. Where the one that exchanges chambers is among them and they were inflated
    on several sides, a pattern turned or counted so that it is another order is taken for that, as an effect of the robot.
    """
    unchanged, with_tip = FirstCalibration(robot, states), states.take(~states.pushed)
    if robot.effects or robot.tolerances or len(with_tip) < 6:
        return unchanged
    # the others lie between them
    seen = with_tip.take(np.isin(np.arange(len(with_tip)), spread_over(len(with_tip), 60)))
    # one area factor, as the diagnosis has it
    one = robot.with_area_factor(float(np.mean(robot.area_factor_at(seen.spine_length))))
    near = _fitted(one, seen, judgement.FIRST_USUAL, _turned(0.0))
    if near is None:
        return unchanged
    before = _rms(one, seen, near)
    if (
        before < judgement.FIRST_LOSS_SCALE * robot.length
        and not (np.abs(near) > judgement.FIRST_NEAR_BOUND * judgement.FIRST_USUAL)[1:].any()
    ):
        return unchanged
    far, (gravity, counting), after = _widely_fitted(one, seen)
    beyond = np.abs(far) > judgement.FIRST_USUAL
    upright = min(gravity, counting) > 0
    if not (beyond.any() or not upright) or after > judgement.FIRST_GAIN * before:
        return unchanged
    if upright and _weight_explains(one, seen, min(judgement.FIRST_AS_GOOD * after, judgement.FIRST_GAIN * before)):
        return unchanged  # the diagnosis names weights
    named = np.array(NAMES)
    turned = _with(_sensed(robot, gravity, counting), far * (named == "azimuth")).actuators.azimuths_deg
    place = exchanged(robot, turned) if can_name_order(robot, states, effects) else None
    if place is not None:
        beyond[2], counting = False, 1.0
    # what the diagnosis can describe itself stays for it, but the area factor goes with the others
    theta = np.where(beyond | (named == "area_factor"), far, 0.0)
    made = _with(_sensed(robot, gravity, counting), theta)
    x, y, z = (theta[ORIGIN:] * robot.length).tolist()
    adjusted = tuple(_adjusted(robot, made, theta, beyond, gravity < 0, counting < 0))
    order = None if place is None else reordered(robot, place)
    made = made if place is None else with_order(made, place)
    found = FirstCalibration(made, states, adjusted, (x, y, z), before, after, order)
    return replace(found, states=found.moved(states))


def _widely_fitted(robot: Robot, states: Campaign) -> tuple[Array, tuple[float, float], float]:
    """Theta (8,) of the wide fit, senses of gravity and of counting (1 or -1), robust rms (m), infinite if no rod stands."""
    theta, senses, least = np.zeros(len(NAMES)), (1.0, 1.0), np.inf
    for turn, gravity, counting in dict.fromkeys(((0.0, 1.0, 1.0), _counted(robot, states), (0.0, -1.0, 1.0))):
        if least < judgement.FIRST_CONVERGED * robot.length:
            break
        there = _sensed(robot, gravity, counting)
        found = _fitted(there, states, judgement.FIRST_WIDEST, _standing(there, states, turn))
        left = np.inf if found is None else _rms(there, states, found)
        if found is not None and left < (least if min(gravity, counting) > 0 else judgement.UPSIDE_DOWN_GAIN * least):
            theta, senses, least = found, (gravity, counting), left
    return theta, senses, least


def _weight_explains(robot: Robot, states: Campaign, most: float) -> bool:
    """Whether one weight more, at the tip or along the body, leaves less than `most` (m) of robust rms within `FIRST_USUAL`."""
    heavier = [(robot, _with_payload(robot, states, share * body_mass(robot))) for share in judgement.FIRST_PAYLOADS]
    heavier += [
        (robot.model_copy(update={"gravity": tuple(f * g for g in robot.gravity)}), states) for f in judgement.FIRST_WEIGHTS
    ]
    fits = ((r, s, _fitted(r, s, judgement.FIRST_USUAL, _turned(0.0))) for r, s in heavier)
    return any(theta is not None and _rms(r, s, theta) < most for r, s, theta in fits)


def _with_payload(robot: Robot, states: Campaign, mass: float) -> Campaign:
    """The states with `mass` (kg) added at the tip."""
    return replace(states, trials=states.trials.replaced({"tip_mass": tip_masses(robot, states.trials) + mass}))


def _counted(robot: Robot, states: Campaign) -> tuple[float, float, float]:
    """Azimuth (rad), 1 (sense of gravity) and sense of counting of the chambers, 1 or -1, with which the robot is nearest."""
    ways = [(turn, counting) for counting in (1.0, -1.0) for turn in QUARTERS]
    missed = [_rms(_sensed(robot, 1.0, counting), states, _turned(turn)) for turn, counting in ways]
    turn, counting = ways[int(np.argmin(missed))]
    return turn, 1.0, counting


def _turned(turn: float, area: float = 0.0, modulus: float = 0.0) -> Array:
    """(8,) theta of the robot as it is, but for its chambers, turned by `turn` (rad), and the logarithms of two factors."""
    theta = np.zeros(len(NAMES))
    theta[:3] = area, modulus, turn
    return theta


def _standing(robot: Robot, states: Campaign, turn: float) -> Array:
    """(8,) the start of a fit, stiffer where that is nearer to the data: rods that do not stand have no derivative to follow."""
    stiffer = itertools.product(np.log(STIFFER), (0.0, 1.0))
    starts = [_turned(turn), *(_turned(turn, area * factor, factor) for factor, area in stiffer)]
    return min(starts, key=lambda theta: _rms(robot, states, theta))


def _sensed(robot: Robot, gravity: float, counting: float) -> Robot:
    """The robot, or it upside down, or with its chambers counted the other way round."""
    x, y, z = (np.array(robot.gravity) * gravity).tolist()
    azimuths = tuple(a * counting for a in robot.actuators.azimuths_deg)
    return robot.with_azimuths(azimuths).model_copy(update={"gravity": (x, y, z)})


def _fitted(robot: Robot, states: Campaign, bounds: Array, start: Array) -> Array | None:
    """(8,) theta at the minimum stated above, within -bounds .. bounds; None where a rod cannot be computed."""
    start = np.clip(start, -0.99 * bounds, 0.99 * bounds)  # least_squares begins inside
    try:
        misfit = _Misfit(robot, states)
        found = least_squares(
            misfit.residual, start, misfit.slope, bounds=(-bounds, bounds), x_scale=np.minimum(judgement.FIRST_SD, 0.3),
            loss="soft_l1", max_nfev=25, ftol=1e-4, xtol=1e-4,
        )  # fmt: skip
    except (ModelError, ValueError):
        return None
    return np.asarray(found.x)


class _Misfit:
    """Residuals of a robot with numbers theta (8,), and their derivatives: forward differences by those that move the rod."""

    def __init__(self, robot: Robot, states: Campaign) -> None:
        self._robot, self._states, self._asked = robot, states, settings(robot, states.trials)
        self._unit = judgement.FIRST_LOSS_SCALE * robot.length
        self._last: tuple[Array, Array] = (np.full(len(NAMES), np.nan), np.zeros(0))

    def residual(self, theta: Array) -> Array:
        """(3 n + 7,) tip errors over s, and all parameters but the first over their prior's width w."""
        return np.concatenate([self._missed(theta).ravel() / self._unit, theta[1:] / judgement.FIRST_SD[1:]])

    def slope(self, theta: Array) -> Array:
        """(3 n + 7, 8) its derivatives."""
        missed = self._missed(theta)
        out = np.zeros((missed.size + len(theta) - 1, len(theta)))
        tip = out[: missed.size].reshape(-1, 3, len(theta))
        for k in range(ORIGIN):
            moved = theta.copy()
            moved[k] += np.copysign(STEP * max(1.0, abs(theta[k])), theta[k])
            tip[..., k] = (_missed(self._robot, self._states, moved, self._asked) - missed) / (moved[k] - theta[k])
        stands = (missed != self._robot.length).any(axis=1)
        tip[..., ORIGIN:] = self._robot.length * stands[:, None, None] * np.eye(3)
        tip /= self._unit
        out[missed.size :, 1:] = np.diag(1 / judgement.FIRST_SD[1:])
        return out

    def _missed(self, theta: Array) -> Array:
        if not np.array_equal(theta, self._last[0]):
            self._last = theta.copy(), _missed(self._robot, self._states, theta, self._asked)
        return self._last[1]


def _missed(robot: Robot, states: Campaign, theta: Array, asked: States) -> Array:
    """(n, 3) m, tip predicted for settings `asked` minus measured; a robot length where the rod has no equilibrium."""
    found = solve(rods_of(_with(robot, theta), asked), DIRECT)
    tip = states.tip - theta[ORIGIN:] * robot.length
    return np.where(found.converged[:, None], np.nan_to_num(found.tip - tip), robot.length)


def _rms(robot: Robot, states: Campaign, theta: Array) -> float:
    """m, s sqrt(mean rho(d^2 / s^2)) over the states: the rms of distances d that are small, while large ones count less."""
    scale = judgement.FIRST_LOSS_SCALE * robot.length
    squared = (_missed(robot, states, theta, settings(robot, states.trials)) ** 2).sum(axis=1) / scale**2
    return scale * float(np.sqrt(np.mean(2 * (np.sqrt(1 + squared) - 1))))


def _with(robot: Robot, theta: Array) -> Robot:
    """The robot with these numbers, unchecked."""
    area, modulus = np.exp(theta[:2]).tolist()
    factor = robot.area_factor
    turned = tuple(a + float(np.degrees(theta[2])) for a in robot.actuators.azimuths_deg)
    gravity = Rotation.from_rotvec([theta[3], theta[4], 0.0]).apply(np.array(robot.gravity))
    x, y, z = gravity.tolist()
    areas = {k: v * area for k, v in factor.items()} if isinstance(factor, dict) else factor * area
    made = robot.with_azimuths(turned).with_modulus(modulus)
    return made.model_copy(update={"area_factor": areas, "gravity": (x, y, z)})


def _adjusted(robot: Robot, made: Robot, theta: Array, beyond: Mask, hanging: bool, counted: bool) -> Iterator[Adjusted]:
    """The numbers of `made` that were taken over; `hanging`: upside down, `counted`: chambers counted the other way round."""
    at_bound = np.abs(theta) > judgement.FIRST_AT_BOUND * judgement.FIRST_WIDEST
    given, now, words = robot.actuators.azimuths_deg, made.actuators.azimuths_deg, robot.actuators.words
    if hanging:
        k = int(np.argmax(np.abs(robot.gravity)))
        yield Adjusted(f"gravity {'xyz'[k]}", robot.gravity[k], made.gravity[k], "m/s^2")
    if counted:
        second = min(1, len(now) - 1)
        short = words.fill("{actuators} counted the other way")
        yield Adjusted(f"{short} round, azimuth of the second", given[second], now[second], "deg", short=short)
    if beyond[1]:
        yield Adjusted("youngs_modulus", robot.youngs_modulus / 1e3, made.youngs_modulus / 1e3, "kPa", bool(at_bound[1]))
    if beyond[2]:
        yield Adjusted(words.fill("azimuth of the first {actuator}"), given[0], now[0], "deg")
    if beyond[3] or beyond[4]:
        tilt = float(np.degrees(np.linalg.norm(theta[3:5])))
        yield Adjusted("gravity, turned from the one stated by", 0.0, tilt, "deg", bool(at_bound[3:5].any()), "gravity")
    for k, axis in enumerate("xyz", ORIGIN):
        if beyond[k]:
            away = 1e3 * float(theta[k] * robot.length)
            rather = "the length" if axis == "z" else ""
            yield Adjusted(f"origin of the tip's {axis}", 0.0, away, "mm", bool(at_bound[k]), rather=rather)
