"""Motion capture by Motive (NatNet)."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from pydantic import BaseModel, Field, field_validator, model_validator

from ..configs import MocapConfig
from ..interfaces import Quaternion, Vector3
from .packets import Definitions, RigidBody


class NotOne(ValueError):
    """A name that no body has, or a name or number that several have; the message says what to do."""


def body_numbers(names: Sequence[str], definitions: Definitions) -> dict[str, int]:
    """Numbers of the bodies with these names; raises NotOne. Bodies of other names may be as they like."""
    ids: dict[str, int] = {}
    for name in names:
        numbers = [number for body, number in definitions.bodies if body == name]
        if not numbers:
            near = difflib.get_close_matches(name, [body for body, _ in definitions.bodies], n=1, cutoff=0.0)
            hint = f"the nearest name is {near[0]!r}" if near else "there are no rigid bodies at all"
            unread = f" ({'; '.join(definitions.unread)})" if definitions.unread else ""
            raise NotOne(f"no rigid body {name!r}; {hint}{unread}. Correct the name in rig.yaml or in Motive")
        if len(numbers) > 1:
            listed = " and ".join(map(str, numbers))
            raise NotOne(f"several rigid bodies are named {name!r}: numbers {listed}. Rename all but one in Motive")
        sharing = [body for body, number in definitions.bodies if number == numbers[0]]
        if len(sharing) > 1:
            listed = " and ".join(map(repr, sharing))
            raise NotOne(f"rigid bodies {listed} have the same streaming ID {numbers[0]}. Give each an ID of its own in Motive")
        ids[name] = numbers[0]
    return ids


FARTHEST = 20.0
"""m; no camera volume is larger."""
NOWHERE: Vector3 = (math.nan, math.nan, math.nan)


class Transform(BaseModel):
    """A rigid transform: p_base = R(quaternion) p_mocap + position."""

    position: Vector3 = Field(json_schema_extra={"unit": "m"})
    quaternion: Quaternion = Field(json_schema_extra={"unit": ""})
    """w, x, y, z"""

    @field_validator("quaternion")
    @classmethod
    def _unit_length(cls, q: Quaternion) -> Quaternion:
        length = math.hypot(*q)
        if abs(length - 1) > 1e-3:
            raise ValueError(f"a quaternion w, x, y, z must have length 1; this one has {length:.4g}")
        return (q[0] / length, q[1] / length, q[2] / length, q[3] / length)

    @cached_property
    def _rotation(self) -> Any:
        from ..frames import matrix_from_quaternion  # here, as below: who only reads rig.yaml does without numpy

        return matrix_from_quaternion(self.quaternion)

    def place(self, body: RigidBody | None) -> Vector3:
        """Position in the base frame, m, as received; NaN where there is no body."""
        from ..frames import apply

        return NOWHERE if body is None else apply(self.position, self._rotation, body.position)

    def turn(self, body: RigidBody | None) -> Quaternion:
        """Orientation in the base frame, w, x, y, z with w >= 0; NatNet has x, y, z, w. Identity where there is none."""
        from ..frames import compose

        if body is None or not _unit(body.rotation):
            return (1.0, 0.0, 0.0, 0.0)
        x, y, z, w = (part / math.hypot(*body.rotation) for part in body.rotation)
        q = compose(self.quaternion, (w, x, y, z))
        return q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])


class Config(MocapConfig):
    """Motion capture by NatNet."""

    server: str
    """Address of the computer that runs Motive."""
    local: str = ""
    """Address of this computer in Motive's network; by default the one that leads there."""
    command_port: int = Field(default=1510, ge=1, le=65535, json_schema_extra={"unit": ""})
    data_port: int = Field(default=1511, ge=1, le=65535, json_schema_extra={"unit": ""})
    body: str
    """Name of the tip's rigid body in Motive."""
    mocap_to_base: Transform
    """Takes Motive's world to the robot's base frame."""
    rate: float = Field(default=100.0, ge=1, le=1000, json_schema_extra={"unit": "Hz"})
    """Frame rate set in Motive."""
    timeout: float = Field(default=2.0, gt=0, le=30, json_schema_extra={"unit": "s"})

    @model_validator(mode="after")
    def _age_spans_frames(self) -> Config:
        if self.max_age < 2 / self.rate:
            raise ValueError(f"max_age {self.max_age} s is less than two frames at {self.rate} Hz; raise one of them")
        return self

    @model_validator(mode="after")
    def _each_once(self) -> Config:
        names = (self.body, *self.markers)
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"body and markers name {', '.join(map(repr, twice))} more than once; each is a body of its own")
        return self


def usable(body: RigidBody | None) -> bool:
    """Tracked, and with values that can be true."""
    return not remedy(body)


def remedy(body: RigidBody | None) -> str:
    """What to do about a body that cannot be used; empty for one that can."""
    if body is None:
        return "no frame holds it: let Motive stream rigid bodies, and check that it is active there"
    if not body.tracked:
        return "clear the cameras' view of it"
    if all(abs(part) < FARTHEST for part in body.position) and _unit(body.rotation):
        return ""
    place, turn = (", ".join(f"{part:g}" for part in parts) for parts in (body.position, body.rotation))
    return f"its place ({place}) m or rotation ({turn}) cannot be true: check its definition and units in Motive"


def _unit(rotation: tuple[float, ...]) -> bool:
    """Whether this is a rotation: NaN and zeros are not."""
    return abs(math.hypot(*rotation) - 1) < 0.05
