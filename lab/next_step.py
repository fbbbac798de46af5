"""Experiments proposed by a diagnosis, and the command that runs one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from diagnosis.answer.result import Diagnosis, Proposal

from .plain import typed

FIRST = 6
"""Experiments shown."""
NOTHING = "No experiment on this rig is expected to distinguish the remaining candidates better."
SETTLED = "Nothing: robot and model agree, and no experiment on this rig is expected to reveal a gap."


def worth_doing(d: Diagnosis) -> Diagnosis:
    """Return the answer without uninformative experiments."""
    return replace(d, next_experiment=tuple(p for p in d.next_experiment if p.worth_doing))


def nothing_next(d: Diagnosis) -> str:
    """State why nothing is proposed."""
    return SETTLED if d.attribute.verdict == "none" else NOTHING


def command(p: Proposal, protocols: Path | None) -> str:
    """Return the command that runs a proposed experiment, with RIG.yaml for the rig; its file is in `protocols`, by default
    next."""
    return typed("lab", "run", (protocols or Path("next")) / f"{p.id}.yaml", "--rig", "RIG.yaml")
