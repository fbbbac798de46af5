"""How one rod of the forward model is laid out as a row of numbers: which column holds what.

A row holds what acts at the ends, then three springs at the tip, then two elements: base to the spine's end, and from
there to the tip. A change of parameters is a row of the same layout.
"""

from __future__ import annotations

TIP_FORCE, TIP_MOMENT = 0, 3
"""Follower force (N) and moment (N m) at the tip, tip frame."""
DEAD_FORCE = 6
"""N, at the tip, fixed in the base frame."""
BASE_TURN = 9
"""Rotation vector (rad) that turns the base out of the base frame's axes."""
BASE_COMPLIANCE = 12
"""rad/(N m): how far the base turns with the moment on it, about each axis of the base frame."""
BASE_RELIEF = 15
"""Share of the moment of the follower loads that the base does not feel."""
SPRINGS, SPRING_WIDTH, SPRING_COUNT = 16, 6, 3
SPRING_DIRECTION, SPRING_STIFFNESS, SPRING_ORIGIN, SPRING_SOFTNESS = 0, 3, 4, 5
"""Offsets in a spring: unit direction (base frame), N/m, where along it the spring begins to be stretched (m), and the
width (m) over which a spring that acts one way sets in; 0 for one that acts both ways."""
ELEMENTS, ELEMENT_WIDTH, ELEMENT_COUNT = SPRINGS + SPRING_WIDTH * SPRING_COUNT, 28, 2
LENGTH, BEND, STRETCH, REST_CURVATURE, REST_STRAIN, LOAD, SERIES, RISE = 0, 1, 4, 7, 10, 13, 16, 19
"""Offsets in an element: m; K_bt (N m^2); K_se (N); u* (1/m) and v* (1), section frame; N/m, base frame; hyperelastic
terms a (m^2), b (1), c (1); u* = REST_CURVATURE + x RISE[0] + x^2 RISE[1] + x^3 RISE[2] over x = 0..1 of the element."""
WIDTH = ELEMENTS + ELEMENT_WIDTH * ELEMENT_COUNT

TIP, ORIENTATION, JOINT, BASE, STRAIN, MARKERS = 0, 3, 7, 11, 15, 17
"""Columns of a result: tip (m), quaternions of the tip, of the spine's end and of the base, mean axial strain of the
two elements, then positions (m) at the arc lengths asked for. All in the base frame."""
