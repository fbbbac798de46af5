"""The experiments by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from . import bending, elongation, stiffness
from .bench import Bench
from .experiment import Plan, Trials
from .parameters import Parameters


@dataclass(frozen=True)
class Experiment:
    """One protocol: its parameters, what it needs, its plan, and how it is run."""

    name: str
    parameters: type[Parameters]
    needs: tuple[str, ...]
    """Instruments by their key in rig.yaml."""
    plan: Callable[[Any], Plan]
    run: Callable[[Bench, Any, Trials], None]


EXPERIMENTS = {
    e.name: e
    for e in (
        Experiment("stiffness", stiffness.Stiffness, stiffness.NEEDS, stiffness.plan, stiffness.run),
        Experiment("bending", bending.Bending, bending.NEEDS, bending.plan, bending.run),
        Experiment("elongation", elongation.Elongation, elongation.NEEDS, elongation.plan, elongation.run),
    )
}
