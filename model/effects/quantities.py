"""The physical quantities of all states that effects may change, before they become rods.

Every array has a leading axis of variants (one a set of parameter values) and then the states; axes of size 1
broadcast. Laws replace attributes, never change arrays in place: `q.pressure = q.pressure + p0`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from model.arrays import Array
from model.body import Body
from model.condition import States
from model.effects.layout import Layout
from model.effects.scales import STANDARD, Scales
from model.robot import Robot


def constant(value: float, *axes: int) -> Any:
    """Declare a quantity that the baseline takes as `value` in all states, along further `axes` of these lengths."""
    return field(default_factory=lambda: np.full((1, 1, *axes), value))


@dataclass(slots=True, kw_only=True)
class Quantities:
    """What effects may change; shapes (v, n) unless stated. Defaults are the paper's model. v may be 1:
    assign new arrays (`q.pressure = q.pressure * (1 + v["gain"][..., None])`), change none in place."""

    robot: Robot
    body: Body
    """The robot's body, its pieces as drawn."""
    layout: Layout
    """Of its rods."""
    design: States
    scales: Scales = STANDARD
    """Which sizes are multiples of."""
    pressure: Array
    """(v, n, chambers) Pa gauge in the chambers."""
    area_factor: Array
    """(v, n, chambers) A_effect / A_norm."""
    azimuth: Array
    """(v, n, chambers) rad at the base, roll included."""
    thrust_on_walls: Array = constant(0.0)
    """Share 0..1 of the chambers' thrust that their side walls balance along the arc; the rest follows the tip."""
    thrust_borne: Array = constant(0.0)
    """Share of that without stretch."""
    thrust_growth: Array = constant(0.0)
    """g: moment times 1 + g (3 s^2/L^2 - 1)."""
    lever: Array = constant(1.0)
    """Distance of the actuators from the axis over that drawn."""
    twist: Array = constant(0.0)
    """rad/m, the chambers wind about the axis."""
    twist_growth: Array = constant(0.0)
    """1; the azimuth grows by c s (1 + g s / L)."""
    body_modulus: Array
    """Pa; the shear modulus keeps its ratio to it."""
    bending: Array = constant(1.0)
    """Factor on bending stiffness alone."""
    stretching: Array = constant(1.0)
    """Factor on axial stiffness alone."""
    density: Array
    """kg/m^3 of the body."""
    gravity: Array
    """(v, n, 3) m/s^2, base frame."""
    length: Array
    """m, of the robot."""
    spine_length: Array
    """m, true."""
    tabulated_length: Array
    """m, at which the spine's table is read."""
    spine_stiffness: Array = constant(1.0)
    """Factor on every modulus of the spine."""
    vacuum_loss: Array = constant(0.0)
    """Pa of vacuum that does not reach the granules."""
    jamming_exponent: Array = constant(0.5)
    """Moduli of the spine follow (vacuum / nominal)^this."""
    area_moments: Array = constant(0.0)
    """Blend 0..1 from moduli mixed by volume to E_c I_c + E_s I_s."""
    spine_sliding: Array = constant(0.0)
    """Share 0..1 of its stretch that a sliding spine leaves to the body."""
    shear_blend: Array = constant(0.0)
    """Blend 0..1 from the spine's table to one modulus with low shear stiffness."""
    shear_lag: Array = constant(0.0)
    """0: sections of that spine turn with the wall; 1: they lag."""
    shear_mix: Array = constant(0.0)
    """Power, plus one, of the mean of both: 0 compliances in series, 2 stiffnesses in parallel."""
    bend_softening: Array = constant(0.0)
    """Factor a of hyperelastic D = 1 + g(a (k r)^2) + h(b e), k r curvature times outer radius."""
    strain_softening: Array = constant(0.0)
    """Factor b of the same."""
    spine_softening: Array = constant(0.0)
    """Share 0..1 of the spine's part of a section that does as the silicone does."""
    tip_force: Array = constant(0.0, 3)
    """(v, n, 3) N at the tip, base frame, besides the tip mass."""
    tip_moment: Array = constant(0.0, 3)
    """(v, n, 3) N m, likewise, besides the known moment."""
    payload: Array = constant(0.0)
    """kg at the tip besides the tip mass that is known."""
    payload_place: Array = constant(0.0, 3)
    """(v, n, 3) m from the tip to its centre, tip frame."""
    tether: Array = constant(0.0)
    """N/m, holds the tip sideways to where it hangs unloaded."""
    plane_stiffness: Array = constant(0.0)
    """N/m of an obstacle that the tip meets."""
    plane_distance: Array = constant(1.0)
    """m from the robot's axis to the obstacle."""
    plane_lever: Array = constant(0.0)
    """m from the tip back to where the body meets the obstacle."""
    plane_direction: Array
    """(2,), or (2, v, n): unit vector in the base frame's x, y towards the obstacle."""
    base_turn: Array = constant(0.0, 3)
    """(v, n, 3) rad."""
    base_compliance: Array = constant(0.0)
    """rad/(N m) about x and y."""
    base_stiffening: Array = constant(0.0)
    """1 / rad^2 with which it stiffens."""
    base_relief: Array = constant(0.0)
    """Share 0..1 of the chambers' moment that the mount does not feel."""
    rest_curvature: Array = constant(0.0, 3)
    """(v, n, 3) 1/m at mid-length, section frame."""
    rest_growth: Array = constant(0.0)
    """Rest curvature at the tip over that at mid-length, less one."""
    clamp_root: Array = constant(0.0)
    """Stiffness rows: rad/(N m) of the specimen's root (body only)."""
    arm_compliance: Array = constant(0.0)
    """Stiffness rows: m/N of arm and mount."""
    contact_offset: Array = constant(0.0)
    """Stiffness rows: m of deflection read before the arm touches."""
    contact_layer: Array = constant(0.0)
    """Stiffness rows: N/m of what is squeezed over that way; 0: nothing is."""


def baseline(
    robot: Robot, body: Body, layout: Layout, design: States, area_factor: Array, direction: Array, scales: Scales = STANDARD
) -> Quantities:
    """The paper's model: nothing is changed. `area_factor` (n,); `direction` (2,) of an obstacle, should there be one."""
    n = len(design)
    chambers = np.deg2rad(robot.actuators.azimuths_deg)
    return Quantities(
        robot=robot,
        body=body,
        layout=layout,
        design=design,
        scales=scales,
        pressure=design.pressure[None],
        area_factor=np.broadcast_to(area_factor[None, :, None], (1, n, chambers.size)),
        azimuth=(chambers[None, :] + design.roll[:, None])[None],
        body_modulus=np.full((1, 1), robot.youngs_modulus),
        density=np.full((1, 1), robot.density),
        gravity=np.array(robot.gravity)[None, None],
        length=np.full((1, 1), robot.length),
        spine_length=design.spine_length[None],
        tabulated_length=design.spine_length[None],
        plane_direction=direction,
    )
