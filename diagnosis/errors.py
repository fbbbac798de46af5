"""What the diagnosis refuses. Each message says what is there, what would be needed and what to do next."""

from __future__ import annotations


class DiagnosisError(Exception):
    """Anything the diagnosis refuses."""


class BadCase(DiagnosisError, ValueError):
    """The table cannot be used at all: nothing measured, mixed units, not finite."""


class BadHoldout(DiagnosisError, ValueError):
    """The campaign held out cannot be used, was measured on another robot, or is among what the fit saw."""


class TooLittle(DiagnosisError, ValueError):
    """The table is sound, but a question needs more than it holds."""
