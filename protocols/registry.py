"""All protocols by name: the project's own, those of installed packages, and one in a file of one's own.

A protocol is a module with

    PARAMETERS                            a subclass of `parameters.Parameters`; the keys of a protocol file and of --set
    NEEDS                                 instruments by their key in rig.yaml, `bench.INSTRUMENTS`
    plan(parameters) -> Plan              the steps with their durations; moves nothing
    run(bench, parameters, trials)        does them

A package announces such modules as entry points of the group `softlab.protocols`; their names are the protocols'. A
file's protocol has the file's name. `docs/howto/protocol.md` has an example.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from recordings.states.rules import PROTOCOL, PROTOCOL_IS

from . import bending, elongation, stiffness
from .bench import INSTRUMENTS, Bench
from .errors import BadProtocol
from .experiment import Plan, Trials
from .parameters import Parameters

GROUP = "softlab.protocols"


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


def protocols() -> Mapping[str, Experiment]:
    """The project's own and those of installed packages, by name."""
    return _found()[0]


def broken() -> Mapping[str, str]:
    """What is wrong with those that an installed package announces and that cannot be run, by name."""
    return _found()[1]


def _found() -> tuple[Mapping[str, Experiment], Mapping[str, str]]:
    known = {m.__name__.rpartition(".")[2]: m for m in (stiffness, bending, elongation)}
    good = {name: _checked(name, module, name) for name, module in known.items()}
    bad: dict[str, str] = {}
    for entry in importlib.metadata.entry_points(group=GROUP):
        where = f"entry point {entry.name} = {entry.value} of {GROUP}"
        if entry.name in known:
            bad[entry.name] = f"{where}: the name is taken, choose another"
            continue
        try:
            good[entry.name] = _checked(entry.name, entry.load(), where)
        except BadProtocol as error:
            bad[entry.name] = str(error)
        except Exception as error:  # noqa: BLE001 - what a package of others raises must not keep the other protocols from running
            bad[entry.name] = f"{where}: cannot be loaded: {type(error).__name__}: {error}"
    return MappingProxyType(good), MappingProxyType(bad)


def protocol_from_file(path: Path) -> Experiment:
    """The protocol of a Python file; raises `BadProtocol` when it cannot be run or holds none."""
    found = importlib.util.spec_from_file_location(f"softlab_protocol_{path.stem}", path)
    if found is None or found.loader is None or not path.is_file():
        raise BadProtocol(f"{path}: is not a readable Python file")
    module = importlib.util.module_from_spec(found)
    sys.modules[found.name] = module  # where its annotations are looked up
    try:
        found.loader.exec_module(module)
    except Exception as error:
        del sys.modules[found.name]
        raise BadProtocol(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    return _checked(path.stem, module, str(path), path)


def _checked(name: str, module: ModuleType, where: str, source: Path | None = None) -> Experiment:
    """The protocol that a module is, all its faults told at once; raises `BadProtocol`."""
    parameters, needs = getattr(module, "PARAMETERS", None), getattr(module, "NEEDS", None)
    faults = []
    if not PROTOCOL.fullmatch(name):
        faults.append(f"its name {name[:80]!r} {PROTOCOL_IS}")
    if not (isinstance(parameters, type) and issubclass(parameters, Parameters)):
        faults.append("PARAMETERS must be a subclass of protocols.parameters.Parameters")
    if not isinstance(needs, (tuple, list)) or not set(needs) <= set(INSTRUMENTS):
        faults.append(f"NEEDS = {needs!r} must be a tuple of {', '.join(INSTRUMENTS)}")
    faults += [f"{part} must be a function" for part in ("plan", "run") if not callable(getattr(module, part, None))]
    if faults:
        raise BadProtocol(f"{where}: {'; '.join(faults)}")
    assert parameters is not None and needs is not None
    return Experiment(name, parameters, tuple(needs), module.plan, module.run, source)
