"""All protocols that can be run: the project's own, those of installed packages, and one in a file."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType

from protocols.registry import GROUP, OWN, Experiment, experiment, faults

from .config import ConfigError
from .packages import Found, Unusable, installed, python_file


def found_protocols() -> Found[Experiment]:
    """By name."""
    return installed(GROUP, {name: experiment(name, module) for name, module in OWN.items()}, _protocol)


def _protocol(name: str, thing: object) -> dict[str, Experiment]:
    if wrong := faults(name, thing):
        raise Unusable(wrong)
    assert isinstance(thing, ModuleType)
    return {name: experiment(name, thing)}


def protocol_from_file(path: Path) -> Experiment:
    """The protocol of a Python file, which has the file's name; raises ConfigError when it cannot be run or holds none."""
    module, text = python_file(path)
    if wrong := faults(path.stem, module):
        raise ConfigError(f"{path}: {wrong}")
    sys.modules[module.__name__] = module  # where annotations that its parameters resolve late are looked up
    return experiment(path.stem, module, path, text)


def file_of(experiment: Experiment) -> str | Path | None:
    """Return the file to name where a protocol fails; None for the project's own."""
    if experiment.source is not None or experiment.name in OWN:
        return experiment.source
    return getattr(getattr(experiment.run, "__code__", None), "co_filename", experiment.name)
