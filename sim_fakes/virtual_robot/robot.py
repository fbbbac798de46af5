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
from .blocks import kernel, rotation
from .body import VirtualBody
from .chain import Chain
from .effects import Laws, draw_directions, laws
from .rod import NoEquilibrium
from .spine import VirtualSpine
from .stand import NO_CONTACT, BareSpine, VirtualStand
from .truth import RobotTruth

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TipView:
    """Tip as tracked: position (3) m, rotation (3, 3), body markers (k, 3) m; robot base frame."""

    position: Array
    rotation: Array
    markers: Array


def look(chain: Chain, arc_lengths: Array) -> TipView:
    """The tip now, and markers at rising arc lengths (m)."""
    turned = np.empty((3, 3))
    rotation(chain.q[-1], turned)
    return TipView(chain.r[-1].copy(), turned, centre_line(chain, arc_lengths))


@kernel
def centre_line(chain: Chain, arc_lengths: Array) -> Array:
    """Points (k, 3) of the centre line at rising arc lengths (m), cubic (Hermite) between nodes; its end beyond the end."""
    out = np.empty((len(arc_lengths), 3))
    a = np.empty((3, 3))
    b = np.empty((3, 3))
    k = 0
    start = 0.0
    for m in range(len(arc_lengths)):
        while arc_lengths[m] > start + chain.h[k] and k < len(chain.h) - 1:
            start += chain.h[k]
            k += 1
        x = min((arc_lengths[m] - start) / chain.h[k], 1.0)
        rotation(chain.q[k], a)
        rotation(chain.q[k + 1], b)
        chord = 0.0
        for i in range(3):
            chord += (chain.r[k + 1, i] - chain.r[k, i]) ** 2
        chord = np.sqrt(chord)
        for i in range(3):
            along = x * (1 - x) ** 2 * a[i, 2] + x * x * (x - 1) * b[i, 2]
            ends = (1 + 2 * x) * (1 - x) ** 2 * chain.r[k, i] + x * x * (3 - 2 * x) * chain.r[k + 1, i]
            out[m, i] = ends + chord * along
    return out


class Pneumatics:
    """The chambers, from the regulators to force and moment at the tip; pressures in Pa gauge, in the order of their numbers.

    chamber pressure   relaxes exponentially towards its regulator (fill_time), never beyond the supply
    ballooning         A(P) = A (1 + b sign(P) |P / 250 kPa|^1.5)
    tip                force sum_i A P_i e3, moment sum_i r_i x A P_i e3, turning with the tip (the paper's eq. 4)
    twist              chamber i lies at azimuth_i + c s (1 + 0.3 s / L); moments act where they change
    """

    def __init__(self, truth: RobotTruth, laws: Laws) -> None:
        self._truth = truth
        self._laws = laws
        self._azimuths = np.radians(np.array(truth.chamber_azimuths_deg)) + laws.chamber_azimuth
        self.reset()

    def reset(self) -> None:
        """All chambers at ambient."""
        self.pressures = np.zeros(len(self._azimuths))

    def step(self, regulator: Array, dt: float) -> None:
        """Fill or vent for dt seconds towards what the regulators drive to."""
        goal = np.clip(regulator, 0.0, self._truth.supply_pressure)
        self.pressures = goal + (self.pressures - goal) * math.exp(-dt / self._truth.fill_time)
        # a chamber within a hundredth of a pascal has arrived; otherwise nothing would ever be at rest
        self.pressures = np.where(np.abs(self.pressures - goal) < 0.01, goal, self.pressures)

    def forces(self) -> Array:
        """Axial force of each chamber, N."""
        p, area = self.pressures, self._truth.chamber_area
        if self._laws.chamber_ballooning:
            area = area * (1 + self._laws.chamber_ballooning * np.sign(p) * np.abs(p / 250e3) ** 1.5)
        return np.asarray(area * p)

    def wrench(self, roll: float, h: Array) -> tuple[Array, Array]:
        """Force (3) N and moments (n, 3) N m of the gas in segments of lengths h, each in its own frame, for a roll in rad."""
        forces, azimuths = self.forces(), self._azimuths + roll
        turning, s = np.multiply(self._truth.chamber_path_radius, forces), np.cumsum(h) - h / 2
        mx = float(np.sum(turning * np.sin(azimuths)))
        my = -float(np.sum(turning * np.cos(azimuths)))
        turn = self._laws.chamber_twist * s * (1 + 0.3 * s / self._truth.length)
        moments = [mx * np.cos(turn) - my * np.sin(turn), mx * np.sin(turn) + my * np.cos(turn), np.zeros(len(h))]
        return np.array([0.0, 0.0, float(forces.sum())]), np.stack(moments, axis=1)


MOUNTS = ("robot", "body", "spine")
INPUT_STEPS = np.array([1e-7, 1e-6, 1e-6, 1e-6, 1e-7, 1e-4])
"""Changes that count: chamber forces (N); spine length (m), jamming, tip mass (kg), roll (rad), probe level and
place (m)."""


@dataclass
class Hands:
    """What is set by hand or by the arm, in addition to chambers and spine."""

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
        self.spine = VirtualSpine(self.truth, self.laws, seed)
        self.stand = VirtualStand(self.truth, self.laws)
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
        self.specimen: VirtualBody | BareSpine = (
            BareSpine(self.truth, self.laws)
            if hands.mount == "spine"
            else VirtualBody(self.truth, self.laws, self.directions, hanging=hands.mount == "robot")
        )
        self._pending = 0.0  # s since the shape was computed
        self._speed = 0.0  # m/s of the last motion
        self._contacts = NO_CONTACT
        self._solve(1e9)  # s: everything comes to rest
        self._inputs = self._input_vector()

    # -- one step
    def move(self, dt: float) -> None:
        """Let the rod follow its inputs for dt seconds; computes nothing while neither moves. Raises `NoEquilibrium`."""
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
        """What the shape depends on, in the order of `INPUT_STEPS`."""
        near = float(self.specimen.rod.chain.r[:, 0].min()) - 0.002
        # a probe that stays clear of the specimen is no input
        level, at = self.hands.probe if self.hands.probe and self.hands.probe[0] > near else (-1.0, 0.0)
        rest = (self.spine.true_length, self.spine.jamming, self.hands.tip_mass, self.hands.roll, level, at)
        return np.concatenate([self.pneumatics.forces(), rest])

    def _solve(self, dt: float) -> None:
        """Bring the specimen to its equilibrium under the present inputs, dt seconds after the last. Raises `NoEquilibrium`."""
        hands, specimen = self.hands, self.specimen
        specimen.fit(self.spine)
        chain = specimen.rod.chain
        self._contacts = NO_CONTACT
        if hands.probe and hands.mount != "robot" and (specimen.present if isinstance(specimen, BareSpine) else True):
            self._contacts = self.stand.contacts(chain, *hands.probe)
        sections = specimen.sections(self.spine, dt)
        if isinstance(specimen, VirtualBody):
            force, moment = self.pneumatics.wrench(hands.roll, chain.h)
            if self.truth.thrust_on_walls:
                sections = sections._replace(wall_thrust=float(force[2]), wall_moment=moment)
                force, moment = np.zeros(3), np.zeros(moment.shape)
            # a node takes the change from one segment to the next
            at_nodes = -np.diff(moment, axis=0, prepend=moment[:1], append=np.zeros((1, 3)))
            loads = specimen.loads(force, at_nodes, hands.tip_mass, self._contacts)
        else:
            loads = specimen.loads(self._contacts)
        self.solves += 1
        self._speed = math.inf  # until it is known; a step that fails is tried again
        self._speed = specimen.rod.relax(sections, loads, dt) / dt
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
