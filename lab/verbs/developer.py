"""`lab schema` and `lab completion`: let editors and shells complete files, verbs and options."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from typing import Any

import shtab
from pydantic import BaseModel

from model.arm import Arm
from model.effects import CATALOGUE
from model.robot import Robot

from ..files.all_protocols import found_protocols
from ..files.campaign_file import CampaignFile
from ..files.config import ConfigError
from ..files.map_file import Map
from ..files.rig_file import RigFile
from ..options import Result, Verb, option
from .fakes import list_effects


def schema(name: str) -> Result:
    """The JSON schema of rig.yaml, robot.yaml, arm.yaml, map.yaml, a campaign, or the file of a protocol; raises ConfigError."""
    protocols = found_protocols()
    models: dict[str, type[BaseModel]] = {
        "rig": RigFile,
        "robot": Robot,
        "arm": Arm,
        "map": Map,
        "campaign": CampaignFile,
        **{n: p.parameters for n, p in protocols.usable.items()},
    }
    if name in protocols.broken:
        raise ConfigError(f"schema {name}: {protocols.broken[name]}")
    if name not in models:
        raise ConfigError(f"schema {name}: must be one of {', '.join(models)}")
    document = _with_units(models[name].model_json_schema())
    if name in protocols.usable:
        document["properties"] = {"protocol": {"const": name}, **document.get("properties", {})}
    return Result({"$schema": "https://json-schema.org/draft/2020-12/schema", **document})


def _with_units(node: Any) -> Any:
    """The same, where each number that has a unit may also be text, such as 250 kPa."""
    if isinstance(node, list):
        return [_with_units(item) for item in node]
    if not isinstance(node, Mapping):
        return node
    inner = {key: _with_units(value) for key, value in node.items()}
    return _or_text(inner) if inner.get("unit") else inner


NUMBERS = ("type", "minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum")


def _or_text(field: dict[str, Any]) -> dict[str, Any]:
    """A field with a unit: each number in it may be text."""
    if field.get("type") == "number":
        number = {key: field.pop(key) for key in NUMBERS if key in field}
        return {**field, "anyOf": [number, {"type": "string"}]}
    for key in ("items", "additionalProperties"):
        if isinstance(field.get(key), dict):
            field[key] = _or_text(field[key])
    for key in ("anyOf", "oneOf", "prefixItems"):
        if isinstance(field.get(key), list):
            field[key] = [_or_text(item) if isinstance(item, dict) else item for item in field[key]]
    return field


def completion(shell: str, top: argparse.ArgumentParser) -> Result:
    """Print the script with which a shell completes the arguments of `top`, files and effects included."""
    words = {"with_effects": list(CATALOGUE), "effect": [e.id for e in list_effects()]}
    (verbs,) = (action for action in top._actions if isinstance(action, argparse._SubParsersAction))  # noqa: SLF001 - the only list
    for action in (action for verb in verbs.choices.values() for action in verb._actions):  # noqa: SLF001
        if action.dest in words:
            action.choices = words[action.dest]
        elif action.dest == "protocol" or (action.type is not None and getattr(action.type, "__name__", "") == "Path"):
            action.complete = shtab.DIRECTORY if action.dest == "folder" else shtab.FILE  # type: ignore[attr-defined]
    sys.stdout.write(shtab.complete(top, shell) + "\n")
    return Result()


VERBS = (
    Verb(
        "schema",
        lambda a: schema(a.file),
        options=(option("file", metavar="rig|robot|arm|map|campaign|PROTOCOL"),),
        examples=("lab schema rig > rig.schema.json", "lab schema bending"),
        page="docs/howto/command.md",
    ),
    Verb(
        "completion",
        lambda a: completion(a.shell, a.parser()),
        options=(option("shell", choices=("bash", "zsh")),),
        examples=("lab completion bash > completions/lab", "lab completion zsh > completions/_lab"),
        page="docs/howto/command.md",
    ),
)
