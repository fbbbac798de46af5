"""How one rod of the forward model is laid out as a row of numbers, and what comes back as columns of a result.

A row is one of `model.rods` with two elements (base to the spine's end, and from there to the tip), three springs at
the tip and every kind of term; only its rest strain is counted from an unstretched section. A change of parameters is a
row of the same layout.
"""

from __future__ import annotations

from model.rods import Form
from model.rods.columns import (
    BASE_COMPLIANCE,
    BASE_RELIEF,
    BASE_STIFFENING,
    BASE_TURN,
    BEND,
    DEAD_FORCE,
    HEAD,
    LENGTH,
    LOAD,
    REST_CURVATURE,
    REST_STRAIN,
    RISE,
    SERIES,
    SPRING,
    SPRING_ARM,
    SPRING_DIRECTION,
    SPRING_ORIGIN,
    SPRING_SOFTNESS,
    SPRING_STIFFNESS,
    STRETCH,
    TIP_FORCE,
    TIP_MOMENT,
)

FORM = Form(elements=2, springs=3, full=True)
SPRINGS, SPRING_WIDTH = HEAD, SPRING
ELEMENTS, ELEMENT_WIDTH, WIDTH = FORM.head, FORM.block, FORM.width

TIP, ORIENTATION, JOINT, BASE, STRAIN, MARKERS = 0, 3, 7, 11, 15, 17
"""Columns of a result: tip (m), quaternions of the tip, of the spine's end and of the base, mean axial strain of the
two elements, then positions (m) at the arc lengths asked for. All in the base frame."""

__all__ = [
    "BASE",
    "BASE_COMPLIANCE",
    "BASE_RELIEF",
    "BASE_STIFFENING",
    "BASE_TURN",
    "BEND",
    "DEAD_FORCE",
    "ELEMENTS",
    "ELEMENT_WIDTH",
    "FORM",
    "JOINT",
    "LENGTH",
    "LOAD",
    "MARKERS",
    "ORIENTATION",
    "REST_CURVATURE",
    "REST_STRAIN",
    "RISE",
    "SERIES",
    "SPRINGS",
    "SPRING_ARM",
    "SPRING_DIRECTION",
    "SPRING_ORIGIN",
    "SPRING_SOFTNESS",
    "SPRING_STIFFNESS",
    "SPRING_WIDTH",
    "STRAIN",
    "STRETCH",
    "TIP",
    "TIP_FORCE",
    "TIP_MOMENT",
    "WIDTH",
]
