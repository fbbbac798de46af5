"""What viewers show of a stream: its messages again in published schemas, at most 30 a second of rig time.

They serve the eye only; nothing is computed from them.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from google.protobuf.json_format import ParseDict
from google.protobuf.timestamp_pb2 import Timestamp

from . import events

PERIOD = 1 / 30
"""Rig seconds between two messages of a view."""
BASE_FRAME = "base"
"""Name of the robot's base frame in /tip/pose and /tip/markers."""
JOINTS_OF_ARM = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Names of the arm's joints in /arm/joints, from base to tool."""


class _Template:
    """A message whose numbers are all doubles (each 1.0 in `message`), behind a time stamp: its layout and constant bytes.

    Viewers get many such messages; this way one costs a microsecond instead of twenty.
    """

    def __init__(self, message: Any, fields: dict[str, Any]) -> None:
        self._parts = ParseDict(fields, message).SerializeToString().split(struct.pack("<d", 1.0))
        self._layout = struct.Struct("<" + "d".join(f"{len(part)}s" for part in self._parts))

    def filled(self, log_time: int, numbers: Sequence[float]) -> bytes:
        """The message with these numbers; `log_time` ns since the epoch."""
        stamp = Timestamp(seconds=log_time // 10**9, nanos=log_time % 10**9).SerializeToString()
        values: list[object] = [self._parts[0]]
        for number, part in zip(numbers, self._parts[1:], strict=True):
            values += (number, part)
        return b"\x0a" + bytes([len(stamp)]) + stamp + self._layout.pack(*values)


_ONE = {"x": 1.0, "y": 1.0, "z": 1.0}
_POSE = _Template(PoseInFrame(), {"frame_id": BASE_FRAME, "pose": {"position": _ONE, "orientation": _ONE | {"w": 1.0}}})
_JOINTS = _Template(JointStates(), {"joints": [{"name": name, "position": 1.0} for name in JOINTS_OF_ARM]})


def _pose(log_time: int, tip: np.void) -> bytes | None:
    w, x, y, z = tip["orientation"]
    return _POSE.filled(log_time, (*tip["position"], x, y, z, w)) if tip["valid"] else None


def _markers(log_time: int, tip: np.void) -> bytes | None:
    """Of body markers only the positions: a marker has no orientation of its own."""
    seen = [marker for marker in tip["markers"] if all(map(math.isfinite, marker))]
    if not seen:
        return None
    message = PosesInFrame(frame_id=BASE_FRAME)
    message.timestamp.FromNanoseconds(log_time)
    for place in seen:
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.position.z = place
        pose.orientation.w = 1.0
    return message.SerializeToString()


def _joints(log_time: int, arm: np.void) -> bytes | None:
    return _JOINTS.filled(log_time, arm["joints"])


VIEWS: dict[str, tuple[tuple[str, Callable[[int, np.void], bytes | None]], ...]] = {
    "/tip": ((events.POSE.topic, _pose), (events.POSES.topic, _markers)),
    "/arm": ((events.JOINTS.topic, _joints),),
}
"""Stream -> the topics that show it, each with its encoder: (log time ns, the stream's message) -> message, None when there is
nothing to see."""
