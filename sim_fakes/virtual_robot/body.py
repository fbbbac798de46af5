"""The soft body with the spine inside: its material and its loads during one step.

Paper: modulus of the covered part by volume, E = Vc Ec + Vs Es, on the annulus; Kse = (GA, GA, EA), Kbt = (EI, EI, E
2I), weight of the body, mass at the tip. With `area_moment` b the spine's part is (1-b) Vs (A, I of the annulus) + b
(A, I of the spine's disc) and the silicone's share rises from Vc to 1. A spine without vacuum neither stiffens nor
displaces silicone.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .blocks import rotation
from .chain import Loads
from .directions import Directions
from .effects import Laws
from .material import (
    CREEP_SHARES,
    CREEP_TIMES,
    SLIP_CURVATURES,
    SLIP_SHARES,
    SLIP_STRAINS,
    YEOH,
    Sections,
    annulus_fibres,
)
from .pneumatics import Pneumatics
from .rod import Rod, mesh
from .seen import axis_quaternion
from .spine import Spine
from .tendons import Tendons
from .truth import RobotTruth

Array = NDArray[np.float64]

PRESENT_FROM = 0.3
"""Relative jamming at which the spine has fully taken its share of the section."""
SLIP_TAPER = 0.03
"""m before the spine's end over which friction fades."""
SLIP_FORCE_PER_LENGTH = 20.0 / 0.15
"""N/m of friction force per N m of friction moment."""
WEIGHT_AT_BASE, WEIGHT_FALL = 1.3, 0.6
"""Extra weight along the body: 1.3 at the base, 0.7 at the tip, times the effect's size."""
TETHER_REACH = 0.3
"""m of tip motion that takes the tether's force to zero."""
BRACKET = (0.025, 0.03)
"""m from the tip to the payload's centre, aside and onwards; a fifth of its mass is a cable along the last quarter."""
CABLE, CABLE_FROM = 0.2, 0.75
SET_TIME, FOR_GOOD = 900.0, 0.5
"""s in which a set that is not for good recovers, and the share that is."""
OBSTACLE_AT = 0.85
DRIFT_TIME = 7200.0
STEP_DURATION = 60.0


def approach(dt: float, settling_time: float) -> float:
    """Viscosity factor 1 / (exp(dt / settling time) - 1): exact for a linear rod under constant load, any dt."""
    if settling_time <= 0.0 or dt > 40 * settling_time:
        return 0.0
    return 1.0 / math.expm1(max(dt, 1e-6) / settling_time)


class Body:
    """The silicone body as a rod; `hanging` False is the stiffness stand (no tilt, no tether, no obstacle)."""

    def __init__(self, truth: RobotTruth, laws: Laws, directions: Directions, hanging: bool) -> None:
        self._truth = truth
        self._laws = laws
        self._directions = directions
        self._hanging = hanging
        self._fibres = annulus_fibres(truth.outer_radius, truth.inner_radius)
        self._inertia = math.pi / 4 * (truth.outer_radius**4 - truth.inner_radius**4)
        h, self._cover = mesh(truth.length, truth.segments, 0.0)
        self.rod = Rod(h)
        self._memory = np.zeros((truth.segments, 6))
        self._tendons = Tendons(truth.segments, len(truth.chamber_azimuths_deg), laws.tendon_friction)
        self._largest = np.zeros((truth.segments, len(self._fibres), 2))
        self._known_jams = 0

    def fit(self, spine: Spine) -> None:
        """Take over the spine's length and note the shape at a new jamming."""
        h, self._cover = mesh(self._truth.length, self._truth.segments, min(spine.true_length, self._truth.length))
        self.rod.remesh(h)
        if spine.jams != self._known_jams:
            self._known_jams = spine.jams
            if self._laws.jam_shape_memory:
                self._memory = self._laws.jam_shape_memory * self.rod.strains()

    def scale(self) -> Array:
        """(n) Radii of the segments over those at the base."""
        h = self.rod.chain.h
        return np.asarray(1 + (self._truth.taper - 1) * (np.cumsum(h) - h / 2) / self._truth.length)

    def sections(self, spine: Spine, gas: Pneumatics, roll: float, t: float, dt: float) -> Sections:
        """Material now: chambers or tendons, roll (rad), time since the start (s), step (s)."""
        truth, laws, n = self._truth, self._laws, self._truth.segments
        pressure = float(np.mean(gas.pressures))
        h = self.rod.chain.h
        s = np.cumsum(h) - h / 2
        scale = self.scale()
        jamming = spine.jamming(pressure)
        x = min(jamming / PRESENT_FROM, 1.0)
        blend = laws.area_moment
        volume_share = truth.spine_area / (truth.area * scale**2 + truth.spine_area)
        taken = (1 - blend) * volume_share * x * x * (3 - 2 * x)
        silicone = self._modulus(t) * (1 + laws.graded_modulus * (2 * s / truth.length - 1)) * (1 - taken * self._cover)
        rest = np.zeros((n, 6))
        if laws.precurvature:
            bend = laws.precurvature * (0.6 + 0.8 * s / truth.length)
            rest[:, 3] = -bend * math.sin(self._directions.precurvature + roll)
            rest[:, 4] = bend * math.cos(self._directions.precurvature + roll)
        if laws.rest_shape:
            rest = rest + self._set(dt)
        slip_moment = np.zeros((n, len(SLIP_CURVATURES)))
        slip_force = np.zeros((n, len(SLIP_STRAINS)))
        if laws.spine_slip and spine.jammed:
            room = np.maximum(spine.true_length - s, 0.0)
            slip_moment = np.outer(
                np.minimum(room / SLIP_TAPER, 1.0), laws.spine_slip * jamming * np.array(SLIP_SHARES)
            )
            slip_force += (SLIP_FORCE_PER_LENGTH * laws.spine_slip * jamming / len(SLIP_STRAINS) * room)[:, None]
        decay = [math.exp(-dt / tau) for tau in CREEP_TIMES]
        creep = np.array([[d, laws.viscoelastic * share] for d, share in zip(decay, CREEP_SHARES, strict=True)])
        return Sections(
            silicone=silicone,
            annulus=np.array([truth.area, truth.area * truth.shear_ratio, self._inertia, 2 * self._inertia])
            * scale[:, None] ** [2, 2, 4, 4],
            fibres=self._fibres,
            scale=scale,
            tendons=self._pulled(gas, roll, scale),
            law=np.array([laws.hyperelastic, *YEOH]),
            rest=rest,
            spine=self._cover[:, None] * self._spine_stiffness(spine, jamming, volume_share, scale),
            spine_rest=rest + self._memory,
            slips=laws.spine_slip > 0.0,
            slip_moment=slip_moment,
            slip_force=slip_force,
            creep=creep,
            viscosity=approach(dt, truth.settling_time),
        )

    def _set(self, dt: float) -> Array:
        """(n, 6) strain without load after what each fibre has been stretched by so far: for good, and for a while."""
        x, y, weight = self._fibres.T
        strain = self.rod.strains()
        stretch = strain[:, 2:3] + strain[:, 3:4] * y - strain[:, 4:5] * x
        kept = np.array([1.0, math.exp(-dt / SET_TIME)])
        self._largest = np.maximum(self._largest * kept, np.maximum(stretch, 0.0)[..., None])
        stays = self._laws.rest_shape * (self._largest @ np.array([FOR_GOOD, 1 - FOR_GOOD])) * weight
        out = np.zeros((len(strain), 6))
        out[:, 2] = stays.sum(axis=1) / self._truth.area
        out[:, 3], out[:, 4] = stays @ y / self._inertia, -(stays @ x) / self._inertia
        return out

    def loads(
        self, follower_force: Array, follower_moment: Array, tip_mass: float, roll: float, contacts: Array
    ) -> Loads:
        """Loads now: chamber wrench (N, N m), mass at the tip (kg), roll (rad), contacts of the stand."""
        truth, laws = self._truth, self._laws
        h = self.rod.chain.h
        gravity = np.array(truth.gravity if self._hanging else truth.stand_gravity)
        s = np.cumsum(h) - h / 2
        line = truth.density * truth.area * self.scale() ** 2 * h
        line = line * (1 + laws.self_weight * (WEIGHT_AT_BASE - WEIGHT_FALL * s / truth.length))
        mass = np.zeros(len(h) + 1)
        mass[1:] += line / 2
        mass[:-1] += line / 2
        mass[-1] += tip_mass
        if laws.tip_payload and self._hanging:
            mass[-1] += (1 - CABLE) * laws.tip_payload
            carries = np.concatenate([[0.0], np.cumsum(h)]) > CABLE_FROM * truth.length
            mass[carries] += CABLE * laws.tip_payload / carries.sum()
            follower_moment = follower_moment.copy()
            follower_moment[-1] += self._bracket(gravity, roll)
        force = mass[:, None] * gravity
        spring = np.array([0.0, 0.0, 0.0, truth.length])
        base = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
        if self._hanging:
            contacts = self._obstacle()
            if laws.tether_load:
                a = self._directions.tether
                force[-1, :2] += laws.tether_load * np.array([math.cos(a), math.sin(a)])
                spring[0] = abs(laws.tether_load) / TETHER_REACH
            a = self._directions.tilt
            base[:4] = axis_quaternion((-math.sin(a), math.cos(a), 0.0), laws.base_tilt)
            base[4] = max(laws.base_compliance, 0.0)
        return Loads(force, follower_force, follower_moment, spring, contacts, base)

    def _bracket(self, gravity: Array, roll: float) -> Array:
        """N m in the tip's frame, as the tip stood in the step before."""
        aside, onwards = BRACKET
        a = self._directions.payload + roll
        frame = np.empty((3, 3))
        rotation(self.rod.chain.q[-1], frame)
        lever = np.array([aside * math.cos(a), aside * math.sin(a), onwards])
        return np.cross(lever, frame.T @ ((1 - CABLE) * self._laws.tip_payload * gravity))

    def _modulus(self, t: float) -> float:
        """Modulus of the silicone at time t, Pa."""
        laws = self._laws
        e = self._truth.youngs_modulus * (1 + laws.body_modulus)
        if laws.drift:
            e *= 1 - laws.drift * DRIFT_TIME / 3600 * (1 - math.exp(-t / DRIFT_TIME))
        if laws.temperature_step:
            e *= 1 - laws.temperature_step * 0.5 * (1 + math.tanh((t - self._directions.step_time) / STEP_DURATION))
        return e

    def _pulled(self, gas: Pneumatics, roll: float, scale: Array) -> Array:
        """(n, 6) stress of the tendons; none on the stand, nor in a robot with chambers."""
        if not (self._truth.tendons and self._hanging):
            return np.zeros((len(scale), 6))
        path = self._truth.chamber_path_radius * scale
        return self._tendons.stress(gas.forces(), gas.azimuths(roll), path, self.rod.chain, self.rod.strains())

    def _spine_stiffness(self, spine: Spine, jamming: float, volume_share: Array, scale: Array) -> Array:
        """(n, 9) stiffness of fully covered segments, laid out as `Sections.spine`."""
        truth, b = self._truth, self._laws.area_moment
        e, g = jamming * spine.modulus, jamming * spine.shear_modulus
        area = (1 - b) * volume_share * truth.area * scale**2 + b * truth.spine_area
        inertia = (1 - b) * volume_share * self._inertia * scale**4 + b * math.pi / 4 * truth.spine_radius**4
        a = self._directions.eccentric
        x, y = self._laws.eccentric_spine * math.cos(a), self._laws.eccentric_spine * math.sin(a)
        return np.array(
            [
                g * area,
                g * area,
                e * area,
                e * area * y,
                -e * area * x,
                e * (inertia + area * y * y),
                -e * area * x * y,
                e * (inertia + area * x * x),
                2 * e * inertia,
            ]
        ).T

    def _obstacle(self) -> Array:
        """The obstacle beside the body as a contact that stays soft, or no contact."""
        if self._laws.contact <= 0.0:
            return np.zeros((0, 9))
        h = self.rod.chain.h
        s = np.concatenate([[0.0], np.cumsum(h)])
        at = OBSTACLE_AT * self._truth.length
        k = min(int(np.searchsorted(s, at)) - 1, len(h) - 1)
        weight = (at - s[k]) / h[k]
        return np.array([[k, weight, 1.0, 0.0, 0.0, -self._directions.obstacle, 1e3, self._laws.contact, 0.0]])
