"""Force and way of the arm's probe along its push, from samples of /force and /arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import NotSettled
from .averaging import from_rotation_vector, mean_quaternion, turned_back

Numbers = NDArray[np.float64]
SAME_AXES = (0.0, 0.0, 0.0)
"""Rotation vector of a force sensor whose axes are those of the TCP."""


def along_push(
    direction: Sequence[float], wrench: Numbers, poses: Numbers, sensor_rotation: Sequence[float] = SAME_AXES
) -> Numbers:
    """(n,) N: force on the specimen along the push, from what the sensor measures.

    `direction`: unit vector, arm base frame. `wrench`: (n, 6) N and N m, sensor frame. `poses`: (k, 6) of the TCP at about
    that time; their mean orientation counts. `sensor_rotation`: rotation vector (rad) from the sensor's frame to the TCP's.
    Raises NotSettled for poses without orientation.
    """
    try:
        tcp = mean_quaternion([from_rotation_vector(pose) for pose in poses[:, 3:].tolist()])
    except ValueError as error:
        raise NotSettled(f"orientation on /arm: {error}; check the network to the arm's controller") from error
    x, y, z = turned_back(from_rotation_vector(sensor_rotation), turned_back(tcp, direction))
    return np.asarray(-(wrench[:, 0] * x + wrench[:, 1] * y + wrench[:, 2] * z))
