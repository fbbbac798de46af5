"""poses.csv: what a run of `arm_accuracy` measured, as `lab diagnose poses.csv --robot arm.yaml` takes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.frames import Alignment, alignment, matrix_from_quaternion, quaternion_from_matrix
from recordings.file.reader import Recording
from recordings.own_files import replacing
from recordings.trials import Table

from .config import ConfigError

SAME = 1e-3
"""rad; a pose whose joints differ by less is the same one, visited again."""


@dataclass(frozen=True)
class ArmPoses:
    """The file that was written, and how the cameras' frame and the body on the flange were aligned with the arm."""

    file: Path
    fit: Alignment

    @property
    def position_sd(self) -> float:
        """Standard deviation of the arm's error along each axis, m."""
        return self.fit.rmse / math.sqrt(3)

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; m."""
        return {"poses": str(self.file), "tool": self.fit.point.tolist(), "position_sd": self.position_sd}


def write_poses(recording: Recording, table: Table, file: Path) -> ArmPoses:
    """Write the states of the arm: joints q1 .. (rad; visits of one pose have their mean), the body's place x, y, z (m) and
    orientation qw .. qz in the arm's base frame, and repeat. Raises ConfigError for fewer than 8 states.

    The frame is that in which the body fits the TCP of the controller's nominal kinematics best."""
    import pandas  # slow to import

    table = table.take(~np.isnan(table.get("q1")) & ~np.isnan(table.tip).any(axis=1) & ~table.doubtful)
    if len(table) < 8:
        raise ConfigError(
            f"{recording.path}: has {len(table)} poses of the arm, needed are 8 to align the cameras' frame with its base"
        )
    arm = recording.stream("/arm")
    tcp = arm["tcp_pose"][np.clip(np.searchsorted(arm["t"], table.get("t")), 0, len(arm) - 1)]
    fit = alignment(tcp, table.tip)
    names = [name for name in table.columns if name in {f"q{k}" for k in range(1, 10)}]
    joints = np.column_stack([table[name] for name in names])
    same = np.abs(joints[:, None] - joints).max(axis=2) < SAME
    turns = [quaternion_from_matrix(fit.rotation.T @ matrix_from_quaternion(tuple(q))) for q in table.orientation.tolist()]
    columns = dict(zip(names, ((same / same.sum(axis=1)[:, None]) @ joints).T, strict=True))
    columns |= dict(zip(("x", "y", "z"), fit.back(table.tip).T, strict=True))
    columns |= dict(zip(("qw", "qx", "qy", "qz"), np.array(turns).T, strict=True))
    with replacing(file) as (stream, _):
        pandas.DataFrame({**columns, "repeat": table["repeat"]}).to_csv(stream, index=False, lineterminator="\n", mode="wb")
    return ArmPoses(file, fit)
