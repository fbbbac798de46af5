"""The error tree of the diagnosis.

    DiagnosisError                 anything the diagnosis refuses
    |-- BadCase       (ValueError)     the table cannot be used at all: nothing measured, mixed units, not finite
    |-- BadHoldout    (ValueError)     the campaign held out cannot be used, or the fit saw it
    `-- TooLittle     (ValueError)     the table is sound but does not hold what this question needs

Each message says what is there, what would be needed and what to do next.
"""

from __future__ import annotations


class DiagnosisError(Exception):
    """Anything the diagnosis refuses."""


class BadCase(DiagnosisError, ValueError):
    """The table cannot be used at all."""


class BadHoldout(DiagnosisError, ValueError):
    """The campaign held out cannot be used, was measured on another robot, or is among what the fit saw."""


class TooLittle(DiagnosisError, ValueError):
    """The table is sound, but a question needs more than it holds."""
