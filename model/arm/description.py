"""A serial arm as arm.yaml describes it.

    name: UR5
    links:                                               # from the base to the flange, one for each joint
      - {a: 0, d: 0.089159, alpha_deg: 90}
      - {a: -0.425, d: 0, alpha_deg: 0, mass: 8.393, centre: [0.2125, 0, 0.11336]}
    tool: [0, 0, 0.031]                                  # the point that is measured, in the frame of the flange
    base_to_world: {position: [0, 0, 0], orientation: [0, 0, 0, 1]}

Frames after Denavit and Hartenberg (1955), distal: joint k turns about z of frame k-1, and
T_k = Rz(q_k + offset_k) Tz(d_k) Tx(a_k) Rx(alpha_k) leads from frame k-1 to frame k. Lengths in m, masses in kg.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from model.errors import BadArm
from model.plain_yaml import FileTable, checked, loaded
from model.robot import Array, Pose, Vector3

PARALLEL = math.radians(10)
"""Two axes within this angle count as parallel: their common normal jumps along them when one of them tilts a little."""
MOST_LINKS = 20
LONGEST = 10.0
"""Largest length of a description, m: beyond it a number is in mm."""


class Link(FileTable):
    """A joint and the link behind it: one row of the table of Denavit and Hartenberg."""

    a: FiniteFloat = Field(ge=-LONGEST, le=LONGEST, json_schema_extra={"unit": "m"})
    """Along x of the new frame, from axis to axis."""
    d: FiniteFloat = Field(ge=-LONGEST, le=LONGEST, json_schema_extra={"unit": "m"})
    """Along the joint's axis."""
    alpha_deg: FiniteFloat = Field(ge=-180, le=180, json_schema_extra={"unit": "deg"})
    """From the joint's axis to the next one, about x of the new frame."""
    offset_deg: FiniteFloat = Field(default=0.0, ge=-360, le=360, json_schema_extra={"unit": "deg"})
    """Added to the joint's angle."""
    mass: FiniteFloat | None = Field(default=None, ge=0, le=1e4, json_schema_extra={"unit": "kg"})
    centre: Vector3 | None = Field(default=None, json_schema_extra={"unit": "m"})
    """Centre of mass in the link's own frame; half way along the link unless given."""
    limits_deg: tuple[FiniteFloat, FiniteFloat] | None = Field(default=None, json_schema_extra={"unit": "deg"})
    """Least and greatest angle q of the joint, between which poses are proposed."""

    @model_validator(mode="after")
    def _is_in_degrees(self) -> Link:
        if self.limits_deg is not None and not -720 <= self.limits_deg[0] < self.limits_deg[1] <= 720:
            raise ValueError(f"limits_deg: {list(self.limits_deg)} deg, must be [least, greatest] within -720 .. 720 deg")
        if 0 < abs(self.alpha_deg) <= math.pi and round(math.degrees(self.alpha_deg), 1) % 90 == 0:
            raise ValueError(f"alpha_deg: {self.alpha_deg:g} looks like rad, must be in degrees: multiply by 57.2958")
        return self


class Arm(FileTable):
    """A serial arm of revolute joints with a point on its tool that is measured."""

    name: str = Field(min_length=1, max_length=100)
    links: tuple[Link, ...]
    tool: Vector3 = Field(default=(0.0, 0.0, 0.0), json_schema_extra={"unit": "m"})
    """The measured point in the frame of the flange, which is the last link's."""
    tool_mass: FiniteFloat = Field(default=0.0, ge=0, le=1e4, json_schema_extra={"unit": "kg"})
    base_to_world: Pose = Pose(position=(0.0, 0.0, 0.0))
    """Frame 0 in the frame in which positions are measured."""
    down: Vector3 = Field(default=(0.0, 0.0, -1.0), json_schema_extra={"unit": "1"})
    """Direction of gravity in the world."""

    @model_validator(mode="after")
    def _is_whole(self) -> Arm:
        """Refuse no links, masses of some links only, an arm without extent, and no direction of gravity."""
        if not 1 <= len(self.links) <= MOST_LINKS:
            raise ValueError(f"links: {len(self.links)}, must be 1 to {MOST_LINKS}, one for each joint")
        missing = [f"links.{k}" for k, link in enumerate(self.links) if link.mass is None]
        if missing and len(missing) < len(self.links):
            raise ValueError(f"mass: {', '.join(missing)} state none, the others do: state all of them or none")
        if not missing and not sum(link.mass or 0.0 for link in self.links) > 0:
            raise ValueError("mass: all are 0 kg, one must be above 0: state them or leave all out")
        if missing and self.tool_mass:
            raise ValueError(f"tool_mass: {self.tool_mass:g} kg says nothing without the mass of every link: state them")
        if not any(link.a or link.d for link in self.links):
            raise ValueError("links: every a and d is 0 m, one must be a length")
        if not math.hypot(*self.down) > 0:
            raise ValueError("down: (0, 0, 0) is no direction: give gravity's, (0, 0, -1) for an arm on the floor")
        return self

    @property
    def joints(self) -> tuple[str, ...]:
        """Columns of the joints' angles, rad: q1, q2 .."""
        return tuple(f"q{k}" for k in range(1, len(self.links) + 1))

    @property
    def parallel(self) -> tuple[bool, ...]:
        """(joints,) whether the next joint's axis is nearly parallel to this one's."""
        inner = [abs(math.sin(math.radians(link.alpha_deg))) < math.sin(PARALLEL) for link in self.links[:-1]]
        return (*inner, False)

    @property
    def masses(self) -> tuple[Array, Array]:
        """(links,) masses in kg and (links, 3) centres in the links' frames, m.

        Where no masses are stated, each link's is its share of the arm's length: torques are then a shape without size.
        """
        turned = [(link, math.radians(link.alpha_deg)) for link in self.links]
        # between a link's two frames, in its own frame
        half = -0.5 * np.array([[link.a, link.d * math.sin(alpha), link.d * math.cos(alpha)] for link, alpha in turned])
        length = np.array([math.hypot(link.a, link.d) for link in self.links])
        masses = [
            share if link.mass is None else link.mass for link, share in zip(self.links, length / length.sum(), strict=True)
        ]
        centres = [middle if link.centre is None else link.centre for link, middle in zip(self.links, half, strict=True)]
        return np.array(masses, float), np.array(centres, float)


def arm_from_dict(data: Mapping[str, Any]) -> Arm:
    """An arm from plain numbers; raises `BadArm` naming every field that is wrong."""
    return checked(Arm, data, {"links": Link, "base_to_world": Pose}, BadArm)


def load_arm(path: Path) -> Arm:
    """Read an arm.yaml; raises `BadArm` naming the file and every field that is wrong.

    >>> load_arm(Path("arm.yaml")).joints
    ('q1', 'q2', 'q3', 'q4', 'q5', 'q6')
    """
    return loaded(path, "an arm.yaml", "`name:` and `links:`", arm_from_dict, BadArm)
