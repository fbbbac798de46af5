"""The virtual robot: reads what the actuators do, moves, and says what the sensors would see.

`advance` serves a plant that fake instruments share; `schedule.walk` walks a list of states without any wire. Both use the
same parts and the same clock of their own, so a robot should be driven one way or the other between two `reset`s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..plant import AMBIENT, Plant
from .body import Body
from .effects import draw_directions, laws
from .pneumatics import Pneumatics
from .rod import NoEquilibrium
from .seen import TipView, look
from .spine import Spine
from .stand import NO_CONTACT, BareSpine, Stand
from .truth import RobotTruth

Array = NDArray[np.float64]

MOUNTS = ("robot", "body", "spine")
INPUT_STEPS = np.array([1e-7, 1e-6, 1e-6, 1e-6, 1e-7, 1e-4])
"""Changes that count: chamber forces (N); spine length (m), jamming, tip mass (kg), roll (rad), probe level and
place (m)."""


@dataclass
class Hands:
    """What is set by hand or by the arm, beside chambers and spine."""

    mount: str = "robot"
    tip_mass: float = 0.053
    roll: float = 0.0
    probe: tuple[float, float] | None = None
    """Level (m, specimen x of the axis where the probe would hold it) and arc length (m) of the contact."""


class VirtualRobot:
    """One robot with its truth, its effects and its memory.

    `effects`: sizes by id (see `list_effects`). `seed` decides directions of effects and trial-to-trial scatter.
    """

    def __init__(
        self, truth: RobotTruth | None = None, effects: Mapping[str, float] = MappingProxyType({}), seed: int = 0
    ) -> None:
        self.truth = truth or RobotTruth()
        self.laws = laws(effects)
        self.directions = draw_directions(self.truth, seed)
        self.pneumatics = Pneumatics(self.truth, self.laws)
        self.spine = Spine(self.truth, self.laws, seed)
        self.stand = Stand(self.truth, self.laws)
        self._markers = np.array(self.truth.markers, dtype=np.float64)
        self._steps = np.concatenate([np.full(len(self.truth.chamber_azimuths_deg), 1e-4), INPUT_STEPS])
        self.reset()

    def reset(self) -> None:
        """Vented, no spine, hanging at rest, time zero."""
        self.time = 0.0
        self.solves = 0
        self.failures = 0
        """Steps that found no equilibrium and left the shape as it was."""
        self.pneumatics.reset()
        self.spine.reset()
        self.stand.reset()
        self.hands = Hands()
        self.remount(self.hands)

    def remount(self, hands: Hands) -> None:
        """Put up a fresh specimen and let it come to rest. Raises ValueError for an unknown mount."""
        if hands.mount not in MOUNTS:
            raise ValueError(f"virtual robot: mount {hands.mount!r} is none of {', '.join(MOUNTS)}")
        self.hands = hands
        self.specimen: Body | BareSpine = (
            BareSpine(self.truth, self.laws)
            if hands.mount == "spine"
            else Body(self.truth, self.laws, self.directions, hanging=hands.mount == "robot")
        )
        self._pending = 0.0
        self._speed = 0.0
        self._contacts = NO_CONTACT
        # a step in which everything comes to rest
        self._solve(1e9)
        self._inputs = self._input_vector()

    # -- one step
    def move(self, dt: float) -> None:
        """Let the rod follow its inputs for dt seconds; nothing is computed while neither they nor the rod move.
        Raises `NoEquilibrium`."""
        self.time += dt
        self._pending += dt
        inputs = self._input_vector()
        still = bool(np.all(np.abs(inputs - self._inputs) <= self._steps))
        # a shape that is expected to move by less, m, is computed anew after half a second only
        if still and self._speed * self._pending < 2e-6 and self._pending < 0.5:
            return
        step, self._pending, self._inputs = self._pending, 0.0, inputs
        self._solve(step)

    def _input_vector(self) -> Array:
        near = float(self.specimen.rod.chain.r[:, 0].min()) - 0.002
        # a probe that stays clear of the specimen is no input
        level, at = self.hands.probe if self.hands.probe and self.hands.probe[0] > near else (-1.0, 0.0)
        rest = (self.spine.true_length, self.spine.jamming, self.hands.tip_mass, self.hands.roll, level, at)
        return np.concatenate([self.pneumatics.forces(), rest])

    def _solve(self, dt: float) -> None:
        hands, body = self.hands, self.specimen
        body.fit(self.spine)
        chain = body.rod.chain
        self._contacts = NO_CONTACT
        if hands.probe and hands.mount != "robot" and not (isinstance(body, BareSpine) and not body.present):
            self._contacts = self.stand.contacts(chain, *hands.probe)
        if isinstance(body, Body):
            force, moment = self.pneumatics.wrench(hands.roll, chain.h)
            loads = body.loads(force, moment, hands.tip_mass, self._contacts)
        else:
            loads = body.loads(self._contacts)
        self.solves += 1
        self._speed = math.inf  # until it is known; a step that fails is tried again
        self._speed = body.rod.relax(body.sections(self.spine, dt), loads, dt) / dt
        self._force = self.stand.force(chain, self._contacts)

    # -- what can be seen
    def view(self) -> TipView:
        """The tip as the cameras see it."""
        return look(self.specimen.rod.chain, self._markers)

    def contact(self) -> float:
        """Force between probe and specimen in the last equilibrium, N."""
        return self._force

    # -- two ways to drive it
    def advance(self, plant: Plant, dt: float) -> None:
        """Read the plant's inputs, move for dt seconds of rig time, write its outputs.

        `tip_visible` is left to whoever hides the tip. Without equilibrium the shape stays and `failures` counts.
        Raises ValueError for an unknown mount.
        """
        if dt <= 0:
            return
        with plant.lock:
            regulator, drive, valve = plant.regulator.copy(), plant.spine_drive, plant.valve_on
            supply = plant.vacuum_supply
            probe = plant.probe_position.copy()
            hands = Hands(plant.mount, plant.tip_mass, plant.roll)
        self.pneumatics.step(regulator, dt)
        self.spine.step(drive, valve, supply, dt)
        if hands.mount != self.hands.mount or hands.roll != self.hands.roll:
            self.remount(hands)
        radius = self.truth.spine_radius if hands.mount == "spine" else self.truth.outer_radius
        if hands.mount != "robot":
            hands.probe = self.stand.reaches(self.specimen.rod.chain, radius, probe)
        self.hands = hands
        try:
            self.move(dt)
        except NoEquilibrium:
            self.failures += 1
        view = self.view()
        force = self.stand.on_probe(self.stand.sensed(self.contact(), dt))
        with plant.lock:
            plant.time = self.time
            plant.chamber_pressure = self.pneumatics.pressures.copy()
            plant.spine_length = self.spine.length
            plant.spine_blocked = self.spine.blocked
            plant.vacuum_absolute = AMBIENT - self.spine.vacuum
            plant.probe_force = force
            plant.tip_position = view.position
            plant.tip_rotation = view.rotation
            plant.markers = view.markers
