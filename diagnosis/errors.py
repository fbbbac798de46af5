"""What the diagnosis refuses. Each message says what is there, what would be needed and what to do next."""

from __future__ import annotations

FAR_OFF = "check tip_mass, gravity, moduli, area_factor and radii of robot.yaml, the units of the table, and `lab compare`"
"""Remedy where a robot cannot be, or nearly cannot be, what was measured."""


class DiagnosisError(Exception):
    """Anything the diagnosis refuses."""


class BadCase(DiagnosisError, ValueError):
    """The table cannot be used, at all or for what is asked: nothing measured, mixed units, no setting of the other campaign."""


class BadHoldout(DiagnosisError, ValueError):
    """The campaign held out cannot be used, was measured on another robot, or is among what the fit saw."""
