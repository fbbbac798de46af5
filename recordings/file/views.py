"""What viewers show of a stream: its messages again in published schemas, at most 30 a second of rig time.

They serve the eye only; nothing is computed from them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .. import events

PERIOD = 1 / 30
"""Rig seconds between two messages of a view."""


def _pose(log_time: int, fields: np.void) -> bytes | None:
    if not fields["valid"]:
        return None
    return events.encode_pose(log_time, fields["position"], fields["orientation"])


def _markers(log_time: int, fields: np.void) -> bytes | None:
    seen = [marker for marker in fields["markers"] if all(map(math.isfinite, marker))]
    return events.encode_poses(log_time, seen) if seen else None


def _joints(log_time: int, fields: np.void) -> bytes | None:
    return events.encode_joints(log_time, fields["joints"])


Encoder = Callable[[int, np.void], bytes | None]
"""(log time ns, the stream's message, decoded) -> message, None when there is nothing to see."""

VIEWS: dict[str, tuple[tuple[str, Encoder], ...]] = {
    "/tip": ((events.POSE.topic, _pose), (events.POSES.topic, _markers)),
    "/arm": ((events.JOINTS.topic, _joints),),
}
"""Stream -> the topics that show it."""


@dataclass
class Pace:
    """When the views of one stream are due."""

    next: float = -math.inf

    def due(self, t: float) -> bool:
        """Whether the message of rig time `t` (s) is shown; keeps the pace."""
        if t < self.next:
            return False
        self.next = t + PERIOD
        return True
