"""Direct driving of a virtual robot: a list of states, walked in order, each read at its end.

A state that changes spine length, mount or roll, or asks for it, is reached as at the rig: vent, un-jam, grow or re-
mount, jam. Then the pressures ramp at the state's rate and are held. With hold 0 the state is read while the pressures
are still ramping.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .robot import Hands, VirtualRobot

Array = NDArray[np.float64]

JAM_TIME = 10.0
"""s of un-jamming, and of jamming."""
FINE_STEP, COARSE_STEP = 8e3, 60e3
"""Pa of pressure change per step of a ramp, with and without effects that depend on the way."""
HOLD_EDGES = (0.02, 0.1, 0.3, 0.6, 1.0)
"""Shares of a hold that are computed one by one with effects that depend on the way."""


@dataclass(frozen=True)
class Condition:
    """One state: lengths m, pressures Pa gauge by chamber, vacuum Pa below ambient, mass kg, roll rad, hold s, rate Pa/s."""

    spine_length: float
    pressures: tuple[float, ...] = (0.0,) * 9
    vacuum: float = 80e3
    tip_mass: float = 0.053
    roll: float = 0.0
    hold: float = 5.0
    rate: float = 20e3
    rejam: bool = False
    """Vent, un-jam and jam again even when the length stays: a new trial."""
    mount: str = "robot"
    deflection: float = 0.0
    """Stiffness stand: travel of the probe after it touched the resting specimen at its tip, m."""

    def __post_init__(self) -> None:
        if not self.pressures or min(self.pressures) < 0:
            raise ValueError(f"pressures {self.pressures} Pa: give one a chamber, none below 0")
        if self.rate <= 0 or self.hold < 0 or self.spine_length < 0 or self.vacuum < 0:
            raise ValueError(
                f"rate {self.rate} Pa/s must be above 0; hold {self.hold} s, spine_length {self.spine_length} m "
                f"and vacuum {self.vacuum} Pa not below 0"
            )


@dataclass(frozen=True)
class VirtualReading:
    """What would be measured in one state, before noise; base frame, SI."""

    t: float
    spine_length: float
    """As the length unit reads it."""
    vacuum: float
    """Below ambient, as the gauge sees it."""
    pressures: tuple[float, ...]
    position: Array
    rotation: Array
    markers: Array
    force: float
    """On the probe, N; 0 when hanging."""
    deflection: float


def walk(robot: VirtualRobot, conditions: Sequence[Condition]) -> list[VirtualReading]:
    """Walk a schedule of states in order, with history, and read each one before sensor noise. Raises `NoEquilibrium`,
    and ValueError for a state that has not one pressure a chamber.
    """
    chambers = len(robot.pneumatics.pressures)
    if any(len(state.pressures) != chambers for state in conditions):
        raise ValueError(f"pressures: give {chambers} in every state, one a chamber")
    readings = []
    touch = 0.0
    for state in conditions:
        if _prepare(robot, state):
            touch = float(robot.specimen.rod.chain.r[-1, 0])
        _ramp(robot, np.array(state.pressures), state.rate)
        if state.mount != "robot":
            _push(robot, touch, state.deflection)
        _hold(robot, state.hold)
        force = robot.stand.sensed(robot.contact(), max(state.hold, 1e-3)) if state.mount != "robot" else 0.0
        view = robot.view()
        readings.append(
            VirtualReading(
                t=robot.time,
                spine_length=robot.spine.length,
                vacuum=robot.spine.vacuum,
                pressures=tuple(float(p) for p in robot.pneumatics.pressures),
                position=view.position,
                rotation=view.rotation,
                markers=view.markers,
                force=force,
                deflection=state.deflection,
            )
        )
    return readings


def _prepare(robot: VirtualRobot, state: Condition) -> bool:
    """Bring spine, mount, roll and mass to the state; True when the specimen was taken down or jammed anew."""
    hands, spine = robot.hands, robot.spine
    remount = state.mount != hands.mount or state.roll != hands.roll
    regrow = abs(state.spine_length - spine.length) > 1e-9
    if not (remount or regrow or state.rejam):
        hands.tip_mass = state.tip_mass
        if state.vacuum and not spine.vacuum:
            spine.place(state.spine_length, state.vacuum)
        else:
            spine.draw(state.vacuum)
        return False
    hands.probe = None
    _ramp(robot, np.zeros_like(robot.pneumatics.pressures), 100e3)  # Pa/s
    if remount:
        robot.remount(Hands(state.mount, state.tip_mass, state.roll))
    hands = robot.hands
    hands.tip_mass = state.tip_mass
    travel = abs(state.spine_length - spine.length)
    spine.place(state.spine_length, 0.0)
    robot.move(travel / 0.02 + JAM_TIME)  # at 0.02 m/s
    spine.place(state.spine_length, state.vacuum)
    robot.move(JAM_TIME)
    return True


def _ramp(robot: VirtualRobot, goal: Array, rate: float) -> None:
    start = robot.pneumatics.pressures.copy()
    change = float(np.abs(goal - start).max())
    if change == 0.0:
        return
    steps = math.ceil(change / (FINE_STEP if robot.laws.spine_slip else COARSE_STEP))
    for i in range(1, steps + 1):
        robot.pneumatics.pressures = start + (goal - start) * (i / steps)
        robot.move(change / rate / steps)


def _push(robot: VirtualRobot, touch: float, deflection: float) -> None:
    length = float(robot.specimen.rod.chain.h.sum())
    start = robot.hands.probe[0] if robot.hands.probe else touch
    level = touch + deflection
    for i in range(1, 5):
        robot.hands.probe = (start + (level - start) * i / 4, length)
        robot.move(0.25)


def _hold(robot: VirtualRobot, hold: float) -> None:
    if hold == 0.0:
        return
    previous = 0.0
    for edge in HOLD_EDGES if robot.laws.spine_slip else (1.0,):
        robot.move(hold * (edge - previous))
        previous = edge
