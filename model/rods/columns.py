"""How one rod is laid out as a row of numbers: which column holds what.

Every rod of a batch is one row; a direction in parameter space (how each number changes with a parameter) is a row of
the same layout. The first columns belong to the whole rod, then every spring at the tip and every element (base to
tip) has a block of its own.
"""

from __future__ import annotations

TIP_FORCE, TIP_MOMENT = 0, 3
"""Follower force (N) and moment (N m) at the tip, in the tip frame."""
DEAD_FORCE, DEAD_MOMENT = 6, 9
"""Force (N) and moment (N m) at the tip, fixed in the mount frame."""
BASE_TURN = 12
"""Rotation vector (rad) that turns the mount frame into the unloaded base."""
BASE_COMPLIANCE = 15
"""rad / (N m): how far the base turns with the moment on it, about each axis of the mount frame."""
BASE_RELIEF = 18
"""Share (1) of the moment of the follower loads that the compliance of the base does not feel."""
BASE_STIFFENING = 19
"""1 / rad^2: h of a base that turns by v / (1 + h |v|^2)^(1/3) where its compliance alone would turn it by v."""
HEAD = 20

SPRING_DIRECTION, SPRING_STIFFNESS, SPRING_ORIGIN, SPRING_SOFTNESS = 0, 3, 4, 5
"""Unit direction e (mount frame), N/m, where along e it starts to pull (m), width of a one-sided start (m)."""
SPRING_ARM = 6
"""From the point it pulls at to the tip (m), tip frame: zero for a spring at the tip itself."""
SPRING = 9

LENGTH = 0
"""m. The following are offsets within an element's block."""
BEND, STRETCH = 1, 4
"""K_bt (N m^2) and K_se (N), three diagonal entries each."""
REST_CURVATURE, REST_STRAIN = 7, 10
"""u* (1/m) and v* (1), section frame."""
LOAD = 13
"""N/m of unstretched length, mount frame."""
SERIES = 16
"""Hyperelastic terms: curvature a (m^2), coupling b (1), strain c (1); see `equations.strains`. Zero: linear."""
RISE = 19
"""u*(z) = u* + z rise1 + z^2 rise2 + z^3 rise3 over z = 0 (element's base end) .. 1, three vectors, 1/m."""
ACTIVE = 28
"""What of u*_x, u*_y (1/m) and v*_z (1) the actuators within the section make by moments and a force, as they would a linear one:
a hyperelastic one answers to their sum with the loads. In z as u*: three numbers, and their three rises."""
BLOCK = 40
