"""The table of trials that a campaign will give, before it is measured: what `lab.diagnose` would get, without readings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.planned import planned_rows
from recordings.trials import INTEGERS, TEXTS, column_order

from .design import Campaign

Columns = dict[str, NDArray[np.generic]]


def planned_table(campaign: Campaign, channels: Sequence[str] = ()) -> Columns:
    """Columns of trials.csv (name -> (n,) values), one row for each state that the campaign will read, in order.

    Trials are numbered on from run to run as `lab.files.inputs.read_case` numbers those of the recordings; `t` is s of rig time
    since the campaign's begin as planned; p1 .. pN (Pa gauge), spine_length (m) and vacuum (Pa below ambient) are what is asked
    for. Cells that do not apply are NaN or empty; columns that apply to no row are left out. `channels`: what will be measured
    (x, y, z, qw .., m1x .., force), as columns of zeros (qw of ones), for `model.effects.design.design_from_columns`, which takes
    what is there as observed.
    """
    rows: list[dict[str, Any]] = []
    trials, begun = 0, 0.0
    has_spine = campaign.robot.spine is not None
    of_run = {id(run.job) for run in campaign.runs}
    for job in campaign.jobs:
        if id(job) in of_run:
            own = planned_rows(job.plan, job.parameters, campaign.chambers)
            rows += [{**row, "trial": row["trial"] + trials, "t": row["t"] + begun} for row in own]
            trials = max((row["trial"] for row in rows), default=0)
        begun += job.plan.seconds
    names = sorted({name for row in rows for name in row if name != "vacuum" or has_spine}, key=_place)
    found: Columns = {name: _column(name, rows) for name in names}
    return found | {name: np.full(len(rows), float(name == "qw")) for name in channels}


def _place(name: str) -> tuple[int, int, int]:
    order = column_order(name)
    assert order is not None, name
    return order


def _column(name: str, rows: Sequence[dict[str, Any]]) -> NDArray[np.generic]:
    if name in TEXTS:
        return np.array([row.get(name, "") for row in rows], np.str_)
    if name in INTEGERS:
        return np.array([row[name] for row in rows], np.int64)
    return np.array([row.get(name, np.nan) for row in rows], np.float64)
