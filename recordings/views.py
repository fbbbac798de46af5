"""What viewers show of a stream: its messages again in published schemas, at most 30 a second of rig time.

They serve the eye only; nothing is computed from them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

from . import events

PERIOD = 1 / 30
"""Rig seconds between two messages of a view."""
BASE_FRAME = "base"
"""Name of the robot's base frame in /tip/pose and /tip/markers."""
JOINTS_OF_ARM = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
"""Names of the arm's joints in /arm/joints, from base to tool."""


def _stamped(message: Any, log_time: int) -> bytes:
    message.timestamp.FromNanoseconds(log_time)
    return bytes(message.SerializeToString())


def _placed(position: Sequence[float], orientation: Sequence[float]) -> Pose:
    (x, y, z), (qw, qx, qy, qz) = position, orientation
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=qw, x=qx, y=qy, z=qz))


def _pose(log_time: int, tip: np.void) -> bytes | None:
    if not tip["valid"]:
        return None
    return _stamped(
        PoseInFrame(frame_id=BASE_FRAME, pose=_placed(tip["position"].tolist(), tip["orientation"].tolist())), log_time
    )


def _markers(log_time: int, tip: np.void) -> bytes | None:
    """Of body markers only the positions: a marker has no orientation of its own."""
    seen = [_placed(marker, (1.0, 0.0, 0.0, 0.0)) for marker in tip["markers"].tolist() if all(map(math.isfinite, marker))]
    return _stamped(PosesInFrame(frame_id=BASE_FRAME, poses=seen), log_time) if seen else None


def _joints(log_time: int, arm: np.void) -> bytes | None:
    pairs = zip(JOINTS_OF_ARM, arm["joints"].tolist(), strict=True)
    return _stamped(JointStates(joints=[JointState(name=name, position=angle) for name, angle in pairs]), log_time)


VIEWS: dict[str, tuple[tuple[str, Callable[[int, np.void], bytes | None]], ...]] = {
    "/tip": ((events.POSE.topic, _pose), (events.POSES.topic, _markers)),
    "/arm": ((events.JOINTS.topic, _joints),),
}
"""Stream -> the topics that show it, each with its encoder: (log time ns, the stream's message) -> message, None when there is
nothing to see."""
