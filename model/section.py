"""A robot's cross-section, and its rods without any effect.

Equation numbers are those of the paper. Choices where it leaves room (see docs/explanations/model.md): area and second moments
are those of the annulus unless robot.yaml gives the stiffness, chambers not subtracted, with and without spine; the weight is the
body's alone; the shear modulus of the part with spine keeps the ratio to Young's modulus that the body has.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from model.arrays import Array
from model.body import body_of
from model.condition import States
from model.robot import Robot

if TYPE_CHECKING:
    from model.rods import Rods


def body_mass(robot: Robot) -> float:
    """Mass of the body, kg: no spine, no tip."""
    body = body_of(robot)
    return robot.density * float(body.mean(body.weight_area)) * robot.length


def rods_of(robot: Robot, states: States, variants: Mapping[str, Array] | None = None) -> Rods:
    """The rods of all states without any effect but what `thrust` states; raises `BadCondition` for states that do not fit.

    `variants`: fields of `model.effects.quantities`, (v, n or 1, ..), in place of the robot's own; the n rods of one variant come
    behind those of the one before. Elements are those of `model.effects.layout`, their values those of `model.effects.compose`.
    """
    # the compiler comes with these: who asks for a section alone does not wait for it
    from model.effects.compose import rod_columns
    from model.effects.layout import layout_of
    from model.effects.quantities import baseline
    from model.effects.solver import rods_from
    from model.effects.spine import ShearSpine

    states.check(robot)
    body = body_of(robot)
    layout = layout_of(body, robot.spine is not None)
    q = baseline(robot, body, layout, states, robot.area_factor_at(states.spine_length), np.array([1.0, 0.0]))
    q.thrust_on_walls = np.full((1, 1), float(robot.thrust == "walls"))
    for name, values in (variants or {}).items():
        setattr(q, name, values)
    count = max(map(len, (variants or {}).values()), default=1)
    return rods_from(layout, rod_columns(q, ShearSpine(1.0, 1.0, 1.0)).rows(len(states), count), plain=True).check()
