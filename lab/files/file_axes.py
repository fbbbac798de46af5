"""The way back from a map.yaml: the robot's points as the file that it maps has them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from model.arrays import Array
from model.errors import BadCondition
from model.prediction import Prediction
from model.robot import Robot
from model.stated import Stated

from .map_file import Map

OFFSET = "marker_offset"


@dataclass(frozen=True)
class FileAxes:
    """A point p (m, base frame) is s (M^T p + b) in the file: M turns recorded axes into the base's, b is the base's place and
    s are the signs of the scales of x, y and z. Orientations R are M^T R mount^-1 M, as signs do not count in them."""

    turn: Array
    """(3, 3) M."""
    signs: Array
    """(3,) s."""
    base: Array | None
    """(3,) m; None where the file's origin cannot be told: with `straight`, `zero: first` or several bases. Then b is 0."""
    mount: tuple[float, ...]
    """w, x, y, z."""
    point: tuple[float, ...]
    """(3,) m: the tracked point from the end of the straight body."""

    @classmethod
    def of(cls, wanted: Map) -> FileAxes:
        stated, columns = wanted.mapped(None), [wanted.columns.get(axis) for axis in "xyz"]
        moved = wanted.straight != "as recorded" or any(c is not None and c.zero in ("first", "absolute") for c in columns)
        base = None if moved or stated.base is None else np.array(stated.base)
        signs = np.array([1.0 if c is None else np.sign(c.scale) for c in columns])
        return cls(wanted.frame.matrix, signs, base, stated.mount or (1.0, 0.0, 0.0, 0.0), wanted.sensor)

    def seen(self, robot: Robot) -> Robot:
        """The robot whose tip is the tracked point; its law is exact, so that it adds to no interval but by its turn."""
        if not any(self.point):
            return robot
        stated = robot.effects.get(OFFSET, {})
        own = {k: stated.get(k, Stated(value=0.0, unit="m")) for k in "xyz"}
        moved = {k: s.model_copy(update={"value": s.value + d}) for (k, s), d in zip(own.items(), self.point, strict=True)}
        return robot.model_copy(update={"effects": {**robot.effects, OFFSET: moved}})

    @property
    def says(self) -> str:
        """Which point is predicted, in which axes, from where."""
        point = f"{1e3 * np.linalg.norm(self.point):.3g} mm from the end of the rod" if any(self.point) else "end of the rod"
        return f"{point}, along the file's axes, from {'the base' if self.base is None else 'its origin'}"

    def to_file(self, prediction: Prediction) -> Prediction:
        """The same in the file. Standard deviations along oblique axes are those of coordinates that err independently."""
        onto, back = Rotation.from_matrix(self.turn), self.signs[:, None] * self.turn.T
        origin = self.signs * (0.0 if self.base is None else self.base)
        turned = onto.inv() * Rotation.from_quat(prediction.orientation, scalar_first=True)
        turned = turned * Rotation.from_quat(self.mount, scalar_first=True).inv() * onto
        sd = {k: None if (v := getattr(prediction, k)) is None else np.sqrt(v**2 @ self.turn**2)
              for k in ("model_sd", "sd", "orientation_sd", "shape_sd")}  # fmt: skip
        return replace(prediction, tip=prediction.tip @ back.T + origin, shape=prediction.shape @ back.T + origin,
                       orientation=turned.as_quat(canonical=True, scalar_first=True), **sd)  # fmt: skip

    def from_file(self, targets: Array, weights: Array) -> tuple[Array, Array]:
        """Targets and their weights, (m, 3), from a file to the base; raises BadCondition for what oblique axes cannot state."""
        shifted = self.signs * targets - (0.0 if self.base is None else self.base)
        if np.isin(self.turn, (-1.0, 0.0, 1.0)).all():
            axis = np.abs(self.turn).argmax(axis=1)
            return shifted[:, axis] * self.turn[range(3), axis], weights[:, axis]
        if not np.isfinite(targets).all() or np.ptp(weights, axis=1).any():
            raise BadCondition("along oblique axes all of x, y and z must be given, with equal weights")
        return shifted @ self.turn.T, weights
