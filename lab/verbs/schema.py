"""`lab schema`: the JSON schema of a file that people write, for their editor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from model.robot import Robot

from ..files.all_protocols import found_protocols
from ..files.campaign_file import CampaignFile
from ..files.config import ConfigError
from ..files.rig_file import RigFile
from ..imports.map_file import Map
from ..options import Result, Verb, option

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def schema(name: str) -> Result:
    """The schema of a file, or of a protocol's file; raises ConfigError for another name."""
    protocols = found_protocols()
    known: dict[str, type[BaseModel]] = {
        "rig": RigFile,
        "robot": Robot,
        "map": Map,
        "campaign": CampaignFile,
        **{n: p.parameters for n, p in protocols.usable.items()},
    }
    if name in protocols.broken:
        raise ConfigError(f"schema {name}: {protocols.broken[name]}")
    if name not in known:
        raise ConfigError(f"schema {name}: must be one of {', '.join(known)}")
    found = _with_units(known[name].model_json_schema())
    if name in protocols.usable:
        found["properties"] = {"protocol": {"const": name}, **found.get("properties", {})}
    return Result({"$schema": DRAFT, **found})


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


VERBS = (
    Verb(
        "schema",
        lambda a: schema(a.file),
        options=(option("file", metavar="rig|robot|map|campaign|PROTOCOL"),),
        examples=("lab schema rig > rig.schema.json", "lab schema bending"),
        page="docs/howto/command.md",
    ),
)
