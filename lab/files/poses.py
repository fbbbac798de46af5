"""poses.csv: what a run of `arm_accuracy` measured, as `lab diagnose poses.csv --robot arm.yaml` takes it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from drivers.frames import alignment, matrix_from_quaternion, quaternion_from_matrix
from recordings.file.reader import Recording
from recordings.own_files import replacing
from recordings.trials import Table

SAME = 1e-3
"""rad; a pose whose joints differ by less is the same one, visited again."""
FEWEST = 8
"""Poses with which the cameras' frame is aligned: ten numbers are fitted to three of each."""


def write_poses(recording: Recording, table: Table, file: Path) -> dict[str, Any]:
    """Write the states of the arm: q1 .. (rad; visits of one pose have their mean), in its base frame x, y, z (m) and qw .. qz of
    the body, and repeat. Nothing where there are too few.

    Returns `poses`: the file; `tool`: place of the body, m from the TCP; `position_sd` (m): of the arm's error along each axis.
    The cameras' frame is aligned so that the body fits the TCP of the controller's kinematics best."""
    import pandas  # slow to import

    table = table.take(~np.isnan(table.get("joint1")) & ~np.isnan(table.tip).any(axis=1) & ~table.doubtful)
    if len(table) < FEWEST:
        return {}
    arm = recording.stream("/arm")
    tcp = arm["tcp_pose"][np.clip(np.searchsorted(arm["t"], table.get("t")), 0, len(arm) - 1)]
    fit = alignment(tcp, table.tip)
    names = [name for name in table.columns if name.startswith("joint")]
    joints = np.column_stack([table[name] for name in names])
    same = np.abs(joints[:, None] - joints).max(axis=2) < SAME
    turns = [quaternion_from_matrix(fit.rotation.T @ matrix_from_quaternion(tuple(q))) for q in table.orientation.tolist()]
    values = np.column_stack([same / same.sum(axis=1)[:, None] @ joints, fit.back(table.tip), turns])
    frame = pandas.DataFrame(values, columns=[*(f"q{k + 1}" for k in range(len(names))), *"xyz", "qw", "qx", "qy", "qz"]).assign(
        repeat=table["repeat"]
    )
    with replacing(file) as (stream, _):
        frame.to_csv(stream, index=False, lineterminator="\n", mode="wb")
    return {"poses": str(file), "tool": fit.point.tolist(), "position_sd": fit.rmse / math.sqrt(3)}
