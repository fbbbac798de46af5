"""The virtual robot as a bench meets it: tolerances of base and camera frame, and pressure sensors that wander."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sim_fakes.virtual_robot import RobotTruth, VirtualRobot
from sim_fakes.virtual_robot.seen import TipView

from .geometry import GEOMETRIES
from .truth import Truth

Array = NDArray[np.float64]

WANDER = 500.0
"""Pa, standard deviation of what a regulator's sensor reads beside the truth, beyond its fast noise."""
WANDER_TIME = 5.0
"""s over which it forgets."""


class BenchRobot(VirtualRobot):
    """One case's robot, driven directly or behind the instruments."""

    def __init__(self, truth: Truth) -> None:
        self.geometry = GEOMETRIES[truth.geometry]
        self._wander_rng = np.random.default_rng([truth.seed, 3])
        self._wander = self._wander_rng.normal(0, WANDER, len(self.geometry.channels))
        self._wander_at = 0.0
        n = truth.nuisance
        self._frame = Rotation.from_rotvec(n.frame).as_matrix() @ Rotation.from_rotvec(n.tilt).as_matrix()
        self._offset = np.array(n.offset)
        super().__init__(robot_truth(truth), truth.all_effects, truth.seed)

    def published_view(self) -> TipView:
        """The tip in the frame the cameras were calibrated to."""
        view = super().published_view()
        return TipView(
            self._frame @ view.position + self._offset,
            self._frame @ view.rotation,
            view.markers @ self._frame.T + self._offset,
        )

    def published_pressures(self) -> Array:
        """What the sensors read, each channel's own error with it."""
        keep = math.exp(-max(0.0, self.time - self._wander_at) / WANDER_TIME)
        self._wander_at = self.time
        fresh = self._wander_rng.normal(0, WANDER, len(self.geometry.channels))
        self._wander = keep * self._wander + math.sqrt(1 - keep * keep) * fresh
        seen = super().published_pressures().copy()
        for error, chambers in zip(self._wander, self.geometry.channels, strict=True):
            seen[[c - 1 for c in chambers]] += error
        return seen


def robot_truth(truth: Truth) -> RobotTruth:
    """The robot behind a case: the paper's, off by its tolerances, grown and jammed a little differently each time."""
    nominal, n = RobotTruth(), truth.nuisance
    # a tilted base is the same as a gravity turned back in the base's own frame
    gravity = Rotation.from_rotvec(n.tilt).inv().apply(np.array(nominal.gravity))
    return RobotTruth(
        length=nominal.length + n.length,
        youngs_modulus=nominal.youngs_modulus * (1 + n.youngs_modulus),
        density=nominal.density * (1 + n.density),
        gravity=(float(gravity[0]), float(gravity[1]), float(gravity[2])),
        area_factor=truth.area_factor,
        scatter_length=1e-3,
        scatter_stiffness=0.02,
        **GEOMETRIES[truth.geometry].truth,
    )
