"""The physical quantities of all states that effects may change, before they become rods.

Every array has a leading axis of variants (one a set of parameter values) and then the states; axes of size 1
broadcast. Laws replace attributes, never change arrays in place: `q.pressure = q.pressure + p0`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from model.body import Body, body_of
from model.effects.design import Design
from model.effects.layout import Layout, layout_of
from model.robot import Robot

Array = NDArray[np.float64]


@dataclass(slots=True)
class Quantities:
    """What the baseline takes as given; shapes (v, n) unless said otherwise, v and n possibly 1."""

    robot: Robot
    body: Body
    """The robot's body, its pieces as drawn."""
    layout: Layout
    """Of its rods."""
    design: Design
    pressure: Array
    """(v, n, chambers) Pa gauge in the chambers."""
    area_factor: Array
    """(v, n, chambers) A_effect / A_norm."""
    azimuth: Array
    """(v, n, chambers) rad at the base, roll included."""
    thrust_on_walls: Array
    """Share 0..1 of the chambers' thrust that their side walls balance along the arc; the rest follows the tip."""
    twist: Array
    """rad/m, the chambers wind about the axis."""
    twist_growth: Array
    """1; the azimuth grows by c s (1 + g s / L)."""
    body_modulus: Array
    """Pa; the shear modulus keeps its ratio to it."""
    density: Array
    """kg/m^3 of the body."""
    length: Array
    """m, of the robot."""
    spine_length: Array
    """m, true."""
    tabulated_length: Array
    """m, length at which the spine's table of moduli is read."""
    spine_stiffness: Array
    """Factor on every modulus of the spine."""
    vacuum_loss: Array
    """Pa of vacuum that does not reach the granules."""
    jamming_exponent: Array
    """Moduli of the spine follow (vacuum / nominal)^this."""
    area_moments: Array
    """Blend 0..1 from moduli mixed by volume to E_c I_c + E_s I_s."""
    spine_sliding: Array
    """Share of its stretch that a composite's spine leaves to the body, because it slides along its channel: 0 none, 1 all."""
    shear_blend: Array
    """Blend 0..1 from the spine's table of moduli to one modulus with low shear stiffness."""
    shear_lag: Array
    """0: sections of that spine turn with the wall; 1: they are free to lag."""
    shear_mix: Array
    """Power, plus one, of the mean that blends the two: 0 compliances in series, 2 stiffnesses side by side."""
    bend_softening: Array
    """Factor a of hyperelastic D = 1 + g(a (k r)^2) + h(b e), k r curvature times outer radius."""
    strain_softening: Array
    """Factor b of the same."""
    spine_softening: Array
    """Share 0..1 of the spine's part of a section that does as the silicone does."""
    tip_force: Array
    """(v, n, 3) N at the tip, base frame, besides the tip mass."""
    payload: Array
    """kg at the tip besides the tip mass that is known."""
    payload_place: Array
    """(v, n, 3) m from the tip to its centre, tip frame."""
    tether: Array
    """N/m, holds the tip sideways to where it hangs unloaded."""
    plane_stiffness: Array
    """N/m of an obstacle that the tip meets."""
    plane_distance: Array
    """m from the robot's axis to the obstacle."""
    plane_turn: Array
    """rad by which the obstacle faces away from there."""
    plane_lever: Array
    """m along the body from the tip back to where it meets the obstacle."""
    plane_direction: Array
    """(2,) unit vector in the base frame's x, y towards the obstacle."""
    base_turn: Array
    """(v, n, 3) rad."""
    base_compliance: Array
    """rad/(N m) about x and y."""
    base_stiffening: Array
    """1 / rad^2 with which it stiffens."""
    base_relief: Array
    """Share 0..1 of the chambers' moment that the mount does not feel."""
    rest_curvature: Array
    """(v, n, 3) 1/m at mid-length, section frame."""
    rest_growth: Array
    """Rest curvature at the tip over that at mid-length, less one."""
    clamp_root: Array
    """Stiffness rows: rad/(N m) of the specimen's root (body only)."""
    arm_compliance: Array
    """Stiffness rows: m/N of arm and mount."""
    contact_offset: Array
    """Stiffness rows: m of deflection read before the arm touches."""
    contact_layer: Array
    """Stiffness rows: N/m of what is squeezed over that way; 0: nothing is."""


def baseline(robot: Robot, design: Design, area_factor: Array, direction: Array) -> Quantities:
    """The paper's model: nothing is changed. `area_factor` (n,); `direction` (2,) of an obstacle, should there be one."""
    n = len(design)

    def each(value: float) -> Array:
        return np.full((1, 1), value)

    chambers, body = np.deg2rad(robot.actuators.azimuths_deg), body_of(robot)
    return Quantities(
        robot=robot,
        body=body,
        layout=layout_of(body, robot.spine is not None),
        design=design,
        pressure=design.pressure[None],
        area_factor=np.broadcast_to(area_factor[None, :, None], (1, n, chambers.size)),
        azimuth=(chambers[None, :] + design.roll[:, None])[None],
        thrust_on_walls=each(0.0),
        twist=each(0.0),
        twist_growth=each(0.0),
        body_modulus=each(robot.youngs_modulus),
        density=each(robot.density),
        length=each(robot.length),
        spine_length=design.spine_length[None],
        tabulated_length=design.spine_length[None],
        spine_stiffness=each(1.0),
        vacuum_loss=each(0.0),
        jamming_exponent=each(0.5),
        area_moments=each(0.0),
        spine_sliding=each(0.0),
        shear_blend=each(0.0),
        shear_lag=each(0.0),
        shear_mix=each(0.0),
        bend_softening=each(0.0),
        strain_softening=each(0.0),
        spine_softening=each(0.0),
        tip_force=np.zeros((1, 1, 3)),
        payload=each(0.0),
        payload_place=np.zeros((1, 1, 3)),
        tether=each(0.0),
        plane_stiffness=each(0.0),
        plane_distance=each(1.0),
        plane_turn=each(0.0),
        plane_lever=each(0.0),
        plane_direction=direction,
        base_turn=np.zeros((1, 1, 3)),
        base_compliance=each(0.0),
        base_relief=each(0.0),
        base_stiffening=each(0.0),
        rest_curvature=np.zeros((1, 1, 3)),
        rest_growth=each(0.0),
        clamp_root=each(0.0),
        arm_compliance=each(0.0),
        contact_offset=each(0.0),
        contact_layer=each(0.0),
    )
