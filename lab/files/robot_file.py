"""Writing a robot.yaml that a person can read: one line a parameter, one line a row of correlations."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from model.robot import Robot
from recordings.own_files import replaced

LATER = ("effects", "tolerances", "obstacle_azimuth_deg", "posterior", "residual")
"""Keys that are left out where there is nothing to say."""


class _Line(list[Any]):
    """A list on one line."""


class _Entry(dict[str, Any]):
    """A table on one line."""


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(
    _Line, lambda dumper, value: dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=True)
)
_Dumper.add_representer(
    _Entry, lambda dumper, value: dumper.represent_mapping("tag:yaml.org,2002:map", value, flow_style=True)
)


def robot_yaml(robot: Robot) -> str:
    """The text of its robot.yaml; it reads back as the same robot."""
    data = robot.model_dump()
    plain = {key: _plain(value) for key, value in data.items() if key not in LATER or value}
    if stated := robot.uncertainty.stated:
        plain["uncertainty"] = stated
    else:
        plain.pop("uncertainty", None)
    for key in ("effects", "tolerances"):
        if key in plain:
            plain[key] = {id: {n: _Entry(p) for n, p in own.items()} for id, own in plain[key].items()}
    if robot.posterior is not None:
        plain["posterior"]["noise"] = _Entry(plain["posterior"]["noise"])
        plain["posterior"]["correlation"] = [_Line(row) for row in plain["posterior"]["correlation"]]
    return yaml.dump(plain, Dumper=_Dumper, sort_keys=False, width=10_000)


def write_robot(robot: Robot, path: Path) -> Path:
    """Write it, and return where."""
    replaced(path, robot_yaml(robot))
    return path


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        items = [_plain(inner) for inner in value]
        return _Line(items) if all(isinstance(i, (int, float)) for i in items) else items
    return value
