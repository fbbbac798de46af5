"""Experiments proposed by a diagnosis, and the command that runs one."""

from __future__ import annotations

from pathlib import Path

from diagnosis.answer.result import Diagnosis, Proposal

from .plain import typed

FIRST = 6
"""Experiments shown."""


def nothing_next(d: Diagnosis) -> str:
    """State why nothing is proposed."""
    if d.attribute.verdict == "none":
        return f"Nothing on this rig: robot and model agree within the noise floor of {d.locate.noise_floor_mm:.3g} mm."
    return "No experiment on this rig is expected to distinguish the remaining candidates better."


def command(p: Proposal, protocols: Path | None) -> str:
    """Return the command that runs a proposed experiment, with RIG.yaml for the rig; its file is in `protocols`, by default
    next."""
    return typed("lab", "run", (protocols or Path("next")) / f"{p.id}.yaml", "--rig", "RIG.yaml")
