"""`lab diagnose` of an arm: how far each cause moves its point, which causes look alike, which poses to measure next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from diagnosis.any_model import diagnose_model
from diagnosis.any_model.answer import Answer
from model.arm import Arm, ArmModel, placed, poses_within, weighed
from model.errors import BadCondition

from ..console import Screen, note, out, titled
from ..files.config import ConfigError, Source, check, demand_writable
from ..files.poses import read_poses
from ..options import Result
from ..pages.answer_page import proposals, shares, steps, write, write_json

RANDOM_POSES = 500
"""Within the joints' limits, among which the next are proposed."""


def diagnose_arm(
    inputs: Sequence[Path], robot: Source, candidates: Path | None, holdout: Path | None, json: Path | None, report: Path | None
) -> Result:
    """Diagnose poses of an arm; raises ConfigError, `BadTable`."""
    demand_writable(json, report)
    arm = check(robot, Arm)
    if len(inputs) > 1:
        raise ConfigError(f"{inputs[1]}: poses of an arm are one table; join the tables into one")
    poses, notes, place = read_poses(inputs[0], arm)
    next_, named = None, None
    if candidates is not None:
        next_, left_out, named = read_poses(candidates, arm, measured=False)
        notes += left_out
    elif (next_ := poses_within(arm, RANDOM_POSES)) is None:
        notes += (f"no poses are proposed: give --candidates, or limits_deg of every link in {robot.name}",)
    else:
        notes += ("poses are proposed within the joints' limits alone: check each for collisions before the arm moves",)
    try:
        with Screen("weighing hypotheses"):
            answer, forward = diagnose_poses(arm, poses, next_, place)
    except BadCondition as e:
        raise ConfigError(f"{inputs[0]}: {e}") from e
    answer = replace(answer, notes=(*notes, *answer.notes))
    if named is not None:  # by their lines in the file
        answer = replace(answer, next_experiment=tuple(replace(p, at=named(int(p.at))) for p in answer.next_experiment))
    unseen = "" if holdout is None else _held_out(answer, forward, arm, holdout)
    if json is not None:
        write_json(answer, json)
    show(answer)
    if unseen:
        out.print(unseen)
    if report is not None:
        write(answer, report.resolve(), f"The gap between {arm.name} and its description", f"{inputs[0]}. {unseen}")
        out.print(f"report: {report}")
    return Result()


def diagnose_poses(
    arm: Arm, poses: pd.DataFrame, candidates: pd.DataFrame | None = None, place: Callable[[int], str] = "row {}".format
) -> tuple[Answer, ArmModel]:
    """The causes that move an arm's point, and its model with base and tool where the poses show them.

    `poses`: joint angles q1 .. (rad), measured x, y, z (m), perhaps repeat; `candidates`: angles that could be measured next;
    `place` names a row. Raises `BadCondition` where the poses cannot be the arm's own.
    """
    own, kept, misplaced = placed(arm, poses, poses[[*"xyz"]].to_numpy(), place)
    model = ArmModel(own)
    causes, calibration, left_out = weighed(model, int(kept.sum()))
    if candidates is not None:
        # what was read with the poses, an approach say, is as if each stood where it is
        joints = {f"{joint}_before": joint for joint in arm.joints if f"{joint}_before" in poses}
        candidates = candidates.assign(**{b: candidates[joint] for b, joint in joints.items() if b not in candidates})
    answer = diagnose_model(
        model, poses[kept], dict.fromkeys("xyz", "m"), causes, calibration,
        repeat="repeat" if "repeat" in poses else None, candidates=candidates,
    )  # fmt: skip
    return replace(answer, notes=(*misplaced, *left_out, *answer.notes)), model


def _held_out(answer: Answer, forward: ArmModel, arm: Arm, path: Path) -> str:
    """Error of the description and of the answer on poses that no fit saw."""
    poses, notes, _ = read_poses(path, arm)
    note(notes)
    theta = {key: value for key, (value, _) in answer.calibration.items()} | {s.key: s.value for s in answer.sizes}
    at = poses[[*"xyz"]].to_numpy()
    before, after, whole = (
        1e3 * np.linalg.norm(forward(values, poses) - at, axis=1).mean() for values in ({}, theta, answer.values)
    )
    return (
        f"{len(poses)} poses of {path}, which were not fitted: mean distance {before:.3g} mm as described, {after:.3g} mm with "
        f"what is named, {whole:.3g} mm with all causes as large as the poses make them."
    )


def show(answer: Answer) -> None:
    """Print an answer."""
    out.print(answer.statement)
    note(answer.notes)
    titles = ("How far the gap shrinks", "What the data support", "What to measure next, most informative first")
    for title, (head, rows) in zip(titles, (steps(answer), shares(answer), proposals(answer)), strict=True):
        if rows:
            out.print(titled(title, head, rows))
