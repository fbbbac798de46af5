"""Averages whose result depends on the numbers alone: the same to the last bit whenever and wherever they are computed.

Sums are `math.fsum` (correctly rounded, so neither order nor memory layout matters); rotations are averaged in plain
floats.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import NotSettled

Quaternion = tuple[float, float, float, float]
Vector3 = tuple[float, float, float]
Numbers = NDArray[np.float64]
SAME_AXES = (0.0, 0.0, 0.0)
"""Rotation vector of a force sensor whose axes are those of the TCP."""


@dataclass(frozen=True)
class Average:
    """A value and the standard deviation of the samples about it; NaN where there are too few to tell."""

    value: float
    sd: float


Estimator = Callable[[Numbers, Numbers], Average]
"""How one number is made of a quantity's stamps (s) and values, both shape (n,); samples that are NaN do not count."""


def mean(t: Numbers, x: Numbers) -> Average:
    """The mean, for a quantity at rest."""
    values = x[np.isfinite(x)].tolist()
    n = len(values)
    if not n:
        return Average(math.nan, math.nan)
    middle = math.fsum(values) / n
    squares = math.fsum((v - middle) ** 2 for v in values)
    return Average(middle, math.sqrt(squares / (n - 1)) if n > 1 else math.nan)


def line(at: float, t: Numbers, x: Numbers) -> Average:
    """The least-squares line through the samples, taken at time `at` (s), for a quantity that ramps."""
    use = np.isfinite(x)
    values, times = x[use].tolist(), [stamp - at for stamp in t[use].tolist()]
    n = len(values)
    if not n:
        return Average(math.nan, math.nan)
    mean, middle = math.fsum(values) / n, math.fsum(times) / n
    spread = math.fsum((s - middle) ** 2 for s in times)
    slope = 0.0
    if spread > 0:
        slope = math.fsum((s - middle) * (v - mean) for s, v in zip(times, values, strict=True)) / spread
    residual = math.fsum((v - mean - slope * (s - middle)) ** 2 for s, v in zip(times, values, strict=True))
    return Average(mean - slope * middle, math.sqrt(residual / (n - 2)) if n > 2 else math.nan)


def mean_quaternion(quaternions: Sequence[Sequence[float]]) -> Quaternion:
    """Mean rotation of unit quaternions (w, x, y, z), where q and -q are the same; the result has w >= 0.

    The eigenvector of the largest eigenvalue of sum q q^T (F. L. Markley et al., "Averaging quaternions", J. Guid.
    Control Dyn. 30, 2007), by power iteration. Raises ValueError when there is none to average.
    """
    if not quaternions:
        raise ValueError("no quaternion to average")
    matrix = [[math.fsum(q[i] * q[j] for q in quaternions) / len(quaternions) for j in range(4)] for i in range(4)]
    mean = _unit(list(quaternions[0]))
    for _ in range(200):
        after = _unit([math.fsum(matrix[i][j] * mean[j] for j in range(4)) for i in range(4)])
        change = max(abs(a - b) for a, b in zip(after, mean, strict=True))
        mean = after
        if change < 1e-15:
            break
    return _positive(mean)


def line_quaternion(at: float, t: Numbers, quaternions: NDArray[np.float64]) -> Quaternion:
    """The rotation at time `at` (s) of quaternions (n, 4) that turn slowly: a line through each component, made unit.

    Good to the square of the angle turned within the samples, which is small while ramping.
    """
    aligned = np.where((quaternions @ quaternions[0] < 0)[:, None], -quaternions, quaternions)  # q and -q turn alike
    return _positive(_unit([line(at, t, aligned[:, i]).value for i in range(4)]))


def _unit(q: Sequence[float]) -> Quaternion:
    length = math.sqrt(math.fsum(c * c for c in q))
    if not length > 0:
        raise ValueError(f"{tuple(q)} is not a rotation")
    return (q[0] / length, q[1] / length, q[2] / length, q[3] / length)


def _positive(q: Quaternion) -> Quaternion:
    return q if q[0] >= 0 else (-q[0], -q[1], -q[2], -q[3])


def from_rotation_vector(vector: Sequence[float]) -> Quaternion:
    """Quaternion (w, x, y, z) of a rotation vector (rad); ValueError for one that is none or beyond all measure."""
    angle = math.sqrt(math.fsum(c * c for c in vector))
    if not angle < math.inf:
        raise ValueError(f"{tuple(vector)} is not a rotation")
    if angle == 0:
        return (1.0, 0.0, 0.0, 0.0)
    scale = math.sin(angle / 2) / angle
    return (math.cos(angle / 2), vector[0] * scale, vector[1] * scale, vector[2] * scale)


def turned_back(q: Quaternion, v: Sequence[float]) -> Vector3:
    """The vector v of the outer frame, seen in the frame whose orientation is q: R(q)^T v."""
    w, x, y, z = q
    a, b, c = v
    return (
        (1 - 2 * (y * y + z * z)) * a + 2 * (x * y + w * z) * b + 2 * (x * z - w * y) * c,
        2 * (x * y - w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z + w * x) * c,
        2 * (x * z + w * y) * a + 2 * (y * z - w * x) * b + (1 - 2 * (x * x + y * y)) * c,
    )


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
