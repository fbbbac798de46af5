"""The table of trials that a campaign will give, before it is measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from protocols.planned import planned_rows

from ..verbs.run import Columns, planned_columns
from .design import CampaignDesign


def planned_table(campaign: CampaignDesign, channels: Sequence[str] = ()) -> Columns:
    """What `lab.diagnose` will get, without readings: one row for each state that the campaign will read, in order.

    Trials are numbered on from run to run as `lab.files.inputs.read_case` numbers those of the recordings; `t` is s of rig time
    since the campaign's begin as planned. See `planned_columns`, also for `channels`.
    """
    rows: list[dict[str, Any]] = []
    trials, begun = 0, 0.0
    for run, j in campaign.jobs:
        if run is not None:
            run_rows = planned_rows(j.plan, j.parameters, campaign.chambers)
            rows += [{**row, "trial": row["trial"] + trials, "t": row["t"] + begun} for row in run_rows]
            trials = max((row["trial"] for row in rows), default=0)
        begun += j.plan.seconds
    return planned_columns(rows, campaign.robot, channels)
