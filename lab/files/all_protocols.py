"""All protocols that can be run, the project's own, those of installed packages, and one in a file; and their keys."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from protocols.parameters import Parameters
from protocols.registry import GROUP, OWN, Experiment, experiment, faults

from .config import ConfigError
from .packages import Registered, Unusable, installed, python_file
from .units import usual


def found_protocols() -> Registered[Experiment]:
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


REQUIRED = "required"
BOUNDS = {"minimum": "from", "exclusiveMinimum": "above", "maximum": "to", "exclusiveMaximum": "below"}


@dataclass(frozen=True)
class Key:
    """One key; numbers in `unit`."""

    name: str
    """With the tables it is in: `settle.within`."""
    unit: str
    default: str
    limits: str
    meaning: str

    def __str__(self) -> str:
        """The line that a person reads above the meaning."""
        named = f"{self.name} ({self.unit})" if self.unit else self.name
        default = self.default if self.default in ("", REQUIRED) else f"default {self.default}"
        return f"{named}: {'; '.join(filter(None, (default, self.limits)))}".removesuffix(": ")


def protocol_keys(model: type[Parameters], defaults: Mapping[str, Any]) -> list[Key]:
    """Return all keys of a protocol's parameters; `defaults` replace the model's own."""
    schema = model.model_json_schema()
    return list(_keys(schema, schema.get("$defs", {}), "", defaults))


def _keys(node: Mapping[str, Any], defs: Mapping[str, Any], table: str, defaults: Mapping[str, Any]) -> Iterator[Key]:
    for name, field in node.get("properties", {}).items():
        default = defaults.get(name, field.get("default"))
        if "$ref" in field:
            inner = default if isinstance(default, dict) else {}
            yield from _keys(defs[field["$ref"].rpartition("/")[2]], defs, f"{table}{name}.", inner)
            continue
        factor, unit = usual(field.get("unit", ""))
        told = REQUIRED if name in node.get("required", ()) and default is None else _told(default, factor)
        yield Key(f"{table}{name}", unit, told, _limits(field, factor), " ".join(field.get("description", "").split()))


def _told(value: Any, factor: float) -> str:
    """A default as a person writes it, in the usual unit."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value / factor:.6g}"
    if isinstance(value, list):
        return f"[{', '.join(_told(item, factor) for item in value)}]"
    return "" if value is None else str(value)


def _limits(field: Mapping[str, Any], factor: float) -> str:
    """What is allowed: bounds in the usual unit, or the choices."""
    if "enum" in field:
        return " or ".join(map(str, field["enum"]))
    inner = next((one for one in field.get("anyOf", ()) if one.get("type") != "null"), field)
    while "items" in inner:
        inner = inner["items"]
    return " ".join(f"{word} {inner[key] / factor:.6g}" for key, word in BOUNDS.items() if key in inner)
