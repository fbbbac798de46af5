"""Numbers of robot.yaml and of the set-up that are far off, calibrated before anything is diagnosed.

Robot files of other laboratories are off by a factor of two, cameras stand turned, the tracked point is not the end of the body.
The diagnosis is local: around such a robot each of its hypotheses is wrong. So a few numbers are fitted first, robustly and
over wide bounds,

    min sum_i rho(|tip_i - rod(theta)_i|^2 / s^2) + sum_k (theta_k / w_k)^2,    rho(z) = 2 (sqrt(1 + z) - 1),

theta: area factor (free), E with G (w = ln 2), azimuth of the chambers, direction of gravity, and where the cameras' frame has
its origin; s is 1 % of the robot's length. What the diagnosis can describe itself stays within `FIRST_USUAL`; only where going
beyond leaves less than 0.3 of the robust rms are the numbers that lie beyond it taken over, and told. Where one
weight more, at the tip or all along, leaves as little, nothing is: the diagnosis can name that weight.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from model.condition import States
from model.errors import ModelError
from model.robot import Robot
from model.rods import FINE, solve
from model.section import body_mass, rods_of
from recordings.trials import TrialRow

from ..judgement import (
    FIRST_AS_GOOD,
    FIRST_AT_BOUND,
    FIRST_CONVERGED,
    FIRST_GAIN,
    FIRST_LOSS_SCALE,
    FIRST_NEAR_BOUND,
    FIRST_PAYLOADS,
    FIRST_SD,
    FIRST_USUAL,
    FIRST_WEIGHTS,
    FIRST_WIDEST,
    UPSIDE_DOWN_GAIN,
)
from .campaign import Campaign, settings, spread_over, tip_masses
from .chamber_sides import can_name_order, exchanged, order_told, with_order

Array = NDArray[np.float64]

NAMES = ("area_factor", "youngs_modulus", "azimuth", "gravity_x", "gravity_y", "origin_x", "origin_y", "origin_z")
ORIGIN, STEP = 5, 1.5e-8
"""The first parameter of the origin, which moves every tip alike, and the step of differences by the others, relative."""
DIRECT = replace(FINE, follow=False)
"""A rod so soft that it has to be loaded in steps, at a thousand times the cost, counts as one that does not stand."""
CALIBRATED_FIRST = "calibrated first"
"""How what a person has to know of it begins."""
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
    at_bound: bool

    def __str__(self) -> str:
        bound = ", and would go beyond: another number beside it is wrong too" if self.at_bound else ""
        return f"{self.name} {self.found:.4g} {self.unit} instead of {self.given:.4g} {self.unit}{bound}"


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
    """m, robust rms of the tip as far as the diagnosis follows by itself, and with the numbers found."""
    order: str = ""
    """Chambers that are connected in another order, in words; empty where they are not."""

    @property
    def changed(self) -> bool:
        """Whether anything was."""
        return bool(self.adjusted or self.order)

    @property
    def _told(self) -> str:
        return "; ".join([*([self.order] if self.order else []), *map(str, self.adjusted)])

    @property
    def concern(self) -> str:
        """What a person has to know and to look at."""
        return (
            f"{CALIBRATED_FIRST}, because robot.yaml is far from these data ({self.before * 1e3:.2f} mm at best, with "
            f"these numbers {self.after * 1e3:.2f} mm; a robust rms, which counts readings far off less): "
            f"{self._told}. Everything below is about the robot with these numbers; check them"
        )

    @property
    def sentence(self) -> str:
        """The same in short."""
        return f"Calibrated first: {self._told}."

    def detail(self) -> dict[str, object]:
        """For the answer's JSON."""
        return {
            "before_mm": self.before * 1e3,
            "after_mm": self.after * 1e3,
            "adjusted": [asdict(a) for a in self.adjusted],
            **({"order": self.order} if self.order else {}),
        }

    def moved(self, states: Campaign) -> Campaign:
        """Other states in the same frame."""
        return _shifted(states, np.array(self.shift)) if any(self.shift) else states


def calibrate_first(robot: Robot, states: Campaign, effects: Collection[str] = ()) -> FirstCalibration:
    """Take over what is far off; a robot that is near its data, or has effects of its own, comes back as it is.

    `effects`: those that are weighed afterwards. Where the one that exchanges chambers is among them and they were inflated
    on several sides, a pattern turned or counted so that it is another order is taken for that, as an effect of the robot.
    """
    kept = ~states.pushed
    if robot.effects or robot.tolerances or kept.sum() < 6:
        return FirstCalibration(robot, states)
    with_tip = states.take(kept)
    # the others lie between them
    seen = np.zeros(len(with_tip), bool)
    seen[spread_over(len(with_tip), 60)] = True
    fitted = with_tip.take(seen)
    # one area factor, as the diagnosis has it
    told, robot = robot, robot.with_area_factor(float(np.mean(robot.area_factor_at(fitted.spine_length))))
    near = _fitted(robot, fitted, FIRST_USUAL, _turned(0.0))
    if near is None:
        return FirstCalibration(told, states)
    missed = _rms(robot, fitted, near)
    if missed < FIRST_LOSS_SCALE * robot.length and not (np.abs(near) > FIRST_NEAR_BOUND * FIRST_USUAL)[1:].any():
        return FirstCalibration(told, states)
    far, senses, least = None, (1.0, 1.0), np.inf
    for turn, gravity, counting in dict.fromkeys(((0.0, 1.0, 1.0), _counted(robot, fitted), (0.0, -1.0, 1.0))):
        if least < FIRST_CONVERGED * robot.length:
            break
        there = _sensed(robot, gravity, counting)
        found = _fitted(there, fitted, FIRST_WIDEST, _standing(there, fitted, turn))
        left = np.inf if found is None else _rms(there, fitted, found)
        if left < (least if min(gravity, counting) > 0 else UPSIDE_DOWN_GAIN * least):
            far, senses, least = found, (gravity, counting), left
    if far is None:
        return FirstCalibration(told, states)
    before, after = missed, _rms(_sensed(robot, *senses), fitted, far)
    beyond = np.abs(far) > FIRST_USUAL
    if not (beyond.any() or min(senses) < 0) or after > FIRST_GAIN * before:
        return FirstCalibration(told, states)
    if min(senses) > 0 and _weight_explains(robot, fitted, min(FIRST_AS_GOOD * after, FIRST_GAIN * before)):
        return FirstCalibration(told, states)  # a weight explains it, and the diagnosis names weights
    turned = _with(_sensed(told, *senses), far * (np.array(NAMES) == "azimuth")).actuators.azimuths_deg
    place = exchanged(told, turned) if can_name_order(told, states, effects) else None
    if place is not None:
        beyond[2], senses = False, (senses[0], 1.0)
    # what the diagnosis can describe itself stays for it, but the area factor goes with the others
    theta = np.where(beyond | (np.array(NAMES) == "area_factor"), far, 0.0)
    shift = theta[ORIGIN:] * robot.length
    made = _with(_sensed(told, *senses), theta)
    adjusted = _told(told, made, theta, shift, beyond, senses)
    moved = _shifted(states, shift) if shift.any() else states
    x, y, z = shift.tolist()
    order = "" if place is None else order_told(told, place)
    made = made if place is None else with_order(made, place)
    return FirstCalibration(made, moved, adjusted, (x, y, z), before, after, order)


def _weight_explains(robot: Robot, states: Campaign, most: float) -> bool:
    """Whether one weight more, at the tip or all along the body, leaves less than `most` (m) of robust rms, all other numbers
    within the bounds of the diagnosis' own fit."""
    heavier = [(robot, _with_payload(robot, states, share * body_mass(robot))) for share in FIRST_PAYLOADS]
    heavier += [(robot.model_copy(update={"gravity": tuple(f * g for g in robot.gravity)}), states) for f in FIRST_WEIGHTS]
    fits = ((r, s, _fitted(r, s, FIRST_USUAL, _turned(0.0))) for r, s in heavier)
    return any(theta is not None and _rms(r, s, theta) < most for r, s, theta in fits)


def _with_payload(robot: Robot, states: Campaign, mass: float) -> Campaign:
    """The states with `mass` (kg) added at the tip."""
    hung = (tip_masses(robot, states.rows) + mass).tolist()
    return replace(states, rows=tuple(replace(r, tip_mass=m) for r, m in zip(states.rows, hung, strict=True)))


def _counted(robot: Robot, states: Campaign) -> tuple[float, float, float]:
    """Azimuth (rad), 1 (sense of gravity) and sense of counting of the chambers, 1 or -1, with which the robot is nearest."""
    ways = [(turn, counting) for counting in (1.0, -1.0) for turn in QUARTERS]
    missed = [_rms(_sensed(robot, 1.0, counting), states, _turned(turn)) for turn, counting in ways]
    turn, counting = ways[int(np.argmin(missed))]
    return turn, 1.0, counting


def _turned(turn: float) -> Array:
    """(8,) theta of the robot as it is, but for its chambers, turned by `turn` (rad)."""
    theta = np.zeros(len(NAMES))
    theta[2] = turn
    return theta


def _standing(robot: Robot, states: Campaign, turn: float) -> Array:
    """(8,) the start of a fit: modulus, and perhaps area factor, several times larger where that is nearer to the data; rods that
    do not stand have no derivative to follow."""
    begins = [_turned(turn)]
    for factor, area in itertools.product(STIFFER, (False, True)):
        begins.append(_turned(turn))
        begins[-1][:2] = np.log(factor) * area, np.log(factor)
    return min(begins, key=lambda theta: _rms(robot, states, theta))


def _sensed(robot: Robot, gravity: float, counting: float) -> Robot:
    """The robot, or it upside down, or with its chambers counted the other way round."""
    x, y, z = (np.array(robot.gravity) * gravity).tolist()
    azimuths = tuple(a * counting for a in robot.actuators.azimuths_deg)
    return robot.with_azimuths(azimuths).model_copy(update={"gravity": (x, y, z)})


def _fitted(robot: Robot, states: Campaign, bounds: Array, start: Array) -> Array | None:
    """(8,) theta in the order of `NAMES` at the minimum stated above, within -bounds .. bounds (8,), searched from `start` (8,);
    None where a rod cannot be computed.
    """
    start = np.clip(start, -0.99 * bounds, 0.99 * bounds)  # least_squares begins inside
    try:
        misfit = _Misfit(robot, states)
        found = least_squares(
            misfit.residual, start, misfit.slope, bounds=(-bounds, bounds), x_scale=np.minimum(FIRST_SD, 0.3), loss="soft_l1",
            max_nfev=25, ftol=1e-4, xtol=1e-4,
        )  # fmt: skip
    except (ModelError, ValueError):
        return None
    return np.asarray(found.x)


class _Misfit:
    """Residuals of a robot with numbers theta (8,), and their derivatives: forward differences by those that move the rod."""

    def __init__(self, robot: Robot, states: Campaign) -> None:
        self._robot, self._states, self._asked = robot, states, settings(robot, states.rows)
        self._last: tuple[Array, Array] = (np.full(len(NAMES), np.nan), np.zeros(0))

    def residual(self, theta: Array) -> Array:
        """(3 n + 7,) tip errors over s, and all parameters but the first over their prior's width w."""
        return np.concatenate([self._missed(theta).ravel() / self._unit, theta[1:] / FIRST_SD[1:]])

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
        out[missed.size :, 1:] = np.diag(1 / FIRST_SD[1:])
        return out

    @property
    def _unit(self) -> float:
        return FIRST_LOSS_SCALE * self._robot.length

    def _missed(self, theta: Array) -> Array:
        if not np.array_equal(theta, self._last[0]):
            self._last = theta.copy(), _missed(self._robot, self._states, theta, self._asked)
        return self._last[1]


def _missed(robot: Robot, states: Campaign, theta: Array, asked: States | None = None) -> Array:
    """(n, 3) m, tip predicted minus measured; a robot length in each axis where the rod has no equilibrium. `asked`: settings of
    the states, where they are known."""
    found = solve(rods_of(_with(robot, theta), asked or settings(robot, states.rows), full=True), DIRECT)
    tip = states.tip - theta[ORIGIN:] * robot.length
    return np.where(found.converged[:, None], np.nan_to_num(found.tip - tip), robot.length)


def _rms(robot: Robot, states: Campaign, theta: Array) -> float:
    """m, s sqrt(mean rho(d^2 / s^2)) over the states: the rms of distances d that are small, while large ones count less."""
    scale = FIRST_LOSS_SCALE * robot.length
    squared = (_missed(robot, states, theta) ** 2).sum(axis=1) / scale**2
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


def _told(
    robot: Robot, made: Robot, theta: Array, shift: Array, beyond: NDArray[np.bool_], senses: tuple[float, float]
) -> tuple[Adjusted, ...]:
    at_bound = np.abs(theta) > FIRST_AT_BOUND * FIRST_WIDEST
    out = []
    if senses[0] < 0:
        k = int(np.argmax(np.abs(robot.gravity)))
        out.append(Adjusted(f"gravity {'xyz'[k]}", robot.gravity[k], made.gravity[k], "m/s^2", False))
    if senses[1] < 0:
        second = min(1, len(made.actuators.azimuths_deg) - 1)
        given, now = robot.actuators.azimuths_deg[second], made.actuators.azimuths_deg[second]
        out.append(Adjusted("chambers counted the other way round, azimuth of the second", given, now, "deg", False))
    if beyond[1]:
        out.append(Adjusted("youngs_modulus", robot.youngs_modulus / 1e3, made.youngs_modulus / 1e3, "kPa", bool(at_bound[1])))
    if beyond[2]:
        first, now = robot.actuators.azimuths_deg[0], made.actuators.azimuths_deg[0]
        out.append(Adjusted("azimuth of the first chamber", first, now, "deg", False))
    if beyond[3] or beyond[4]:
        tilt = float(np.degrees(np.linalg.norm(theta[3:5])))
        out.append(Adjusted("gravity, turned from the one stated by", 0.0, tilt, "deg", bool(at_bound[3:5].any())))
    for k, axis in enumerate("xyz"):
        if beyond[ORIGIN + k]:
            out.append(Adjusted(f"origin of the tip's {axis}", 0.0, float(shift[k]) * 1e3, "mm", bool(at_bound[ORIGIN + k])))
    return tuple(out)


def _shifted(states: Campaign, shift: Array) -> Campaign:
    return replace(states, rows=tuple(_row(r, shift) for r in states.rows))


def _row(row: TrialRow, shift: Array) -> TrialRow:
    if row.tip is None:
        return row
    x, y, z = (np.array(row.tip) - shift).tolist()
    markers = tuple((m[0] - shift[0], m[1] - shift[1], m[2] - shift[2]) for m in row.markers)
    return replace(row, tip=(x, y, z), markers=markers)
