"""What may happen to the robot itself, apart from its instruments: put between the actuators and the virtual robot.

leak          the regulator of a chamber holds 30 % less than its set-point
burst         a chamber, and all on the same channel, hold nothing
supply_low    no regulator gets beyond 60 kPa
valve_stuck   the jamming valve does not follow its relay
jam_slip      the jammed spine slips back by 8 mm, once
contact_lost  the specimen breaks off: nothing pushes on the probe any more
marker_lost   the tip's marker has come off
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .plant import Plant

if TYPE_CHECKING:
    from .virtual_robot import VirtualRobot

ACCIDENTS = ("leak", "burst", "supply_low", "valve_stuck", "jam_slip", "contact_lost", "marker_lost")
LEFT, LOW_SUPPLY, SLIP = 0.7, 60e3, 8e-3
"""Share of the set-point that a leak leaves; Pa; m."""


class Accidents:
    """Accidents of one rig; `begin` and `end` may be called while it runs."""

    def __init__(self, wiring: Sequence[Sequence[int]]) -> None:
        self._wiring = wiring
        self._now: set[str] = set()
        self._valve: bool | None = None

    def begin(self, accident: str) -> None:
        """Let it happen. Raises ValueError for an unknown name."""
        if accident not in ACCIDENTS:
            raise ValueError(f"{accident}: one of {', '.join(ACCIDENTS)}")
        self._now.add(accident)

    def end(self) -> None:
        """Everything repaired."""
        self._now.clear()
        self._valve = None

    def advance(self, robot: VirtualRobot, plant: Plant, dt: float) -> None:
        """One step of the robot with what has happened to it; call with the plant's lock held."""
        if not self._now:
            robot.advance(plant, dt)
            return
        regulator, valve = plant.regulator.copy(), plant.valve_on
        hurt = [c - 1 for c in self._wiring[0]]
        if "supply_low" in self._now:
            plant.regulator = np.minimum(plant.regulator, LOW_SUPPLY)
        if {"leak", "burst"} & self._now:
            plant.regulator[hurt] *= 0.0 if "burst" in self._now else LEFT
        if "valve_stuck" in self._now:
            self._valve = valve if self._valve is None else self._valve
            plant.valve_on = self._valve
        if "jam_slip" in self._now:
            self._now.discard("jam_slip")
            robot.spine.length = max(0.0, robot.spine.length - SLIP)
        robot.advance(plant, dt)
        plant.regulator, plant.valve_on = regulator, valve
        if "contact_lost" in self._now:
            plant.probe_force = np.zeros(3)
        if "marker_lost" in self._now:
            plant.tip_visible = False
