"""The project's own protocols by name, and what makes a module one.

A protocol is a module with

    PARAMETERS                            a subclass of `parameters.Parameters`; the keys of a protocol file and of --set
    NEEDS                                 instruments by their key in rig.yaml, `bench.INSTRUMENTS`
    plan(parameters) -> Plan              the steps with their durations; moves nothing
    run(bench, parameters, trials)        does them

A package announces such modules as entry points of the group `softlab.protocols`; their names are the protocols'. A
file's protocol has the file's name. `docs/howto/protocol.md` has an example.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from recordings.states.rules import PROTOCOL, PROTOCOL_IS

from . import arm_accuracy, bending, cycles, elongation, stiffness
from .bench import INSTRUMENTS, Bench
from .experiment import Plan, Trials
from .parameters import Parameters

GROUP = "softlab.protocols"
OWN: Mapping[str, ModuleType] = MappingProxyType(
    {"stiffness": stiffness, "bending": bending, "elongation": elongation, "cycles": cycles, "arm_accuracy": arm_accuracy}
)


@dataclass(frozen=True)
class Experiment:
    """One protocol: its parameters, what it needs, its plan, and how it is run."""

    name: str
    parameters: type[Parameters]
    needs: tuple[str, ...]
    """Instruments by their key in rig.yaml."""
    plan: Callable[[Any], Plan]
    run: Callable[[Bench, Any, Trials], None]
    source: Path | None = None
    """The file of one's own that it comes from."""
    code: bytes = b""
    """That file as it was run."""


def experiment(name: str, module: ModuleType, source: Path | None = None, code: bytes = b"") -> Experiment:
    """The protocol that a module without `faults` is."""
    return Experiment(name, module.PARAMETERS, tuple(module.NEEDS), module.plan, module.run, source, code)


def faults(name: str, module: object) -> str:
    """All that keeps a module from being the protocol of this name; empty when it is one."""
    parameters, needs = getattr(module, "PARAMETERS", None), getattr(module, "NEEDS", None)
    faults = []
    if not isinstance(module, ModuleType):
        faults.append(f"is of type {type(module).__name__}, not a module; give the module's name without an attribute")
    if not PROTOCOL.fullmatch(name):
        faults.append(f"its name {name[:80]!r} {PROTOCOL_IS}")
    if not (isinstance(parameters, type) and issubclass(parameters, Parameters)):
        faults.append("PARAMETERS must be a subclass of protocols.parameters.Parameters")
    if not isinstance(needs, (tuple, list)) or not set(needs) <= set(INSTRUMENTS):
        faults.append(f"NEEDS = {needs!r} must be a tuple of {', '.join(INSTRUMENTS)}")
    faults += [f"{part} must be a function" for part in ("plan", "run") if not callable(getattr(module, part, None))]
    return "; ".join(faults)
