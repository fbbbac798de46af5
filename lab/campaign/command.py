"""`lab campaign`: a campaign planned, run, and gone on with."""

from __future__ import annotations

import argparse
import secrets
import shlex
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table as Sheet

from protocols.experiment import Plan
from protocols.planned import cycles, setups

from ..console import Screen, clock, err, out
from ..files.campaign_file import OWN_LABELS
from ..files.config import ConfigError
from ..files.units import shown
from ..options import JSON, LABELS, Result, Verb, given_labels, option, rig
from ..rig.limits import Margin, margins
from ..rig.operator import preparations
from .design import CampaignDesign, campaign_of
from .journal import FILE, CampaignJournal, CampaignProgress, demand_same, fill, folder_of
from .planned import planned_table
from .session import Ended, Session

MOST_SEED = 2**31


def plan(path: Path, rig_path: Path) -> Result:
    """What a campaign will do; connects to nothing. Raises ConfigError."""
    c = _checked(path, rig_path)
    data = plan_dict(c)
    return Result(data, lambda: _show_plan(c, data))


def _show_plan(c: CampaignDesign, planned: Mapping[str, Any]) -> None:
    sheet = Sheet("run", "block", "protocol", "condition", "about", "hands", box=None, pad_edge=False)
    tasks: list[str] = []
    for run in planned["runs"]:
        before = f"run {run['run']}" if run["run"] else "the warm-up"
        run_tasks = [f"before {before}: {hand['do']}" for hand in run["hands"]]
        numbers = ", ".join(f"task {len(tasks) + i}" for i, _ in enumerate(run_tasks, 1))
        tasks += run_tasks
        run_number, block = (str(run[key] or "") for key in ("run", "block"))
        sheet.add_row(run_number, block, run["protocol"], run["condition"], clock(run["seconds"]), numbers)
    out.print(sheet)
    rig_s, host_s = planned["rig_seconds"], planned["host_seconds"]
    fast = f", {clock(host_s)} on this rig" if host_s != rig_s else ""
    out.print(
        f"{len(c.runs)} runs, {planned['states']} states, about {clock(rig_s)} of rig time{fast}, a person's hands not counted"
    )
    out.print(f"seed {c.file.seed}{'' if planned['seed_given'] else ' (drawn now; write it into the file to keep this order)'}")
    out.print(f"hands are needed {c.hands} times, the first time included")
    for number, task in enumerate(tasks, 1):
        out.print(f"  task {number}, {task}", soft_wrap=True)
    alike: dict[tuple[int, float], list[str]] = {}
    for chamber in planned["chambers"]:
        alike.setdefault((chamber["cycles"], chamber["highest_pa"]), []).append(str(chamber["chamber"]))
    for (count, highest), chambers in alike.items():
        if count:
            named = f"chamber{'s' if len(chambers) > 1 else ''} {', '.join(chambers)}"
            out.print(f"  {named}: {count} pressure cycles, up to {shown(highest, 'Pa')}", soft_wrap=True)
    for margin in _margins(c):
        out.print(f"  {margin}", soft_wrap=True)


def _margins(c: CampaignDesign) -> list[Margin]:
    """Of all runs together."""
    whole = Plan(c.file.campaign, [step for _, j in c.jobs for step in j.plan.steps], {})
    return margins(whole, c.runs[0].job.rig, c.robot)


def _checked(path: Path, rig_path: Path) -> CampaignDesign:
    """The campaign of a file; where that gives no seed, one is drawn."""
    with Screen("checking all runs") as screen:
        return campaign_of(path, rig_path, secrets.randbelow(MOST_SEED), screen.progress)


def plan_dict(c: CampaignDesign) -> dict[str, Any]:
    """The plan as JSON has it."""
    counts, highest = c.cycles()
    runs, stands = [], None
    limits: dict[str, float] = {}
    for run, j in c.jobs:
        hands = []
        for setup in setups(j.plan):
            if setup != stands:
                about = {"mount": setup.mount, "tip_mass_kg": setup.tip_mass, "roll_deg": setup.roll_deg}
                hands.append({"do": preparations(setup, stands), **about, "vacuum_pa": setup.vacuum})
            stands = setup
        for key, value in j.plan.limits.items():
            limits[key] = max(limits.get(key, value), value)
        runs.append(
            {
                "run": run.number if run else None, "block": run.block if run else None, "protocol": j.experiment.name,
                "condition": run.condition if run else "warm-up", "seconds": round(j.plan.seconds, 2),
                "cycles": int(cycles(j.plan, c.chambers)[0].max(initial=0)), "hands": hands,
            }
        )  # fmt: skip
    return {
        "campaign": c.file.campaign, "seed": c.file.seed, "seed_given": c.seed_given, "blocks": c.file.blocks,
        "rig_seconds": c.seconds, "host_seconds": c.seconds / c.runs[0].job.rig.clock.speed,
        "states": len(next(iter(planned_table(c).values()), ())), "hands": c.hands,
        "chambers": [
            {"chamber": i, "cycles": n, "highest_pa": p}
            for i, (n, p) in enumerate(zip(counts.tolist(), highest.tolist(), strict=True), 1)
        ],
        "limits": limits, "largest": [asdict(m) for m in _margins(c)], "runs": runs,
    }  # fmt: skip


def run(path: Path, rig_path: Path, folder: Path | None, labels: Mapping[str, str], watched: bool = False) -> Result:
    """Begin a campaign. `labels`: further ones. Raises ConfigError."""
    c = _checked(path, rig_path)
    place = folder or Path(c.file.campaign)
    place.mkdir(parents=True, exist_ok=True)
    with CampaignJournal.begin(place, c.file.campaign, c.digest, labels) as journal:
        fill(place, c)
        return _session(c, place, journal, watched)


def resume(place: Path, rig_path: Path, labels: Mapping[str, str], watched: bool = False) -> Result:
    """Go on with the campaign of a folder, or of a file in it. Raises ConfigError, BadJournal."""
    folder = folder_of(place)
    with CampaignJournal.reopen(folder) as journal:
        c = _checked(folder / FILE, rig_path)
        demand_same(folder, c, journal.done.design)
        journal.done.labels |= labels
        return _session(c, folder, journal, watched)


def resume_command(folder: Path, rig_path: Path) -> str:
    """What to type, as the shell takes it, to go on."""
    return shlex.join(["lab", "campaign", "--resume", str(folder), "--rig", str(rig_path)])


def _session(c: CampaignDesign, folder: Path, journal: CampaignJournal, watched: bool) -> Result:
    try:
        ended = Session(c, folder, journal, watched=watched).go()
    except Exception:
        out.print(f"go on with: {resume_command(folder, c.rig_path)}", soft_wrap=True)
        raise
    done = journal.done
    again = None if ended.completed else resume_command(folder, c.rig_path)
    data = {"folder": str(folder), "completed": ended.completed, "why": ended.why, "runs_done": len(done.completed),
            "runs": len(c.runs), "rows": done.rows, "lost": done.lost, "safe": ended.safe, "hands": ended.asked,
            "resume": again}  # fmt: skip
    cut_short = not (ended.completed or ended.displaced)
    code = 1 if cut_short or not ended.safe else 3 if done.lost or ended.displaced else 0
    return Result(data, lambda: _show(c, folder, done, ended, again), code, ended.error)


def _show(c: CampaignDesign, folder: Path, done: CampaignProgress, ended: Ended, again: str | None) -> None:
    word = "completed" if ended.completed else f"ended: {ended.why}"
    out.print(f"{word}: {len(done.completed)} of {len(c.runs)} runs, {done.rows} states in {folder}", soft_wrap=True)
    if done.lost:
        out.print(f"  lost: {done.lost} samples (lab runs {folder})", soft_wrap=True)
    if not ended.safe:
        err.print("The safe state is not confirmed: use the vent valve and the emergency stop.", style="red")
    if again is not None:
        out.print(f"go on with: {again}", soft_wrap=True)


def _campaign(a: argparse.Namespace) -> Result:
    labels = given_labels(a)
    if taken := sorted(set(labels) & set(OWN_LABELS)):
        raise ConfigError(f"--tag {', '.join(taken)}: is given by the campaign itself")
    if (a.file is None) == (a.resume is None):
        raise ConfigError("give a campaign's file, or the folder of one with --resume")
    if a.resume is not None:
        if a.plan or a.out is not None:
            raise ConfigError("--resume goes on with the campaign as it is in its folder: do not give --plan or --out")
        return resume(a.resume, a.rig, labels, a.watch)
    return plan(a.file, a.rig) if a.plan else run(a.file, a.rig, a.out, labels, a.watch)


VERBS = (
    Verb(
        "campaign",
        _campaign,
        options=(
            JSON,
            option("file", nargs="?", type=Path, help="campaign.yaml"),
            rig(),
            option("--plan", action="store_true", help="what it will do, how long it takes, its limits; nothing moves"),
            option("--out", type=Path, metavar="FOLDER", help="folder for all its recordings (default: the campaign's name)"),
            option("--resume", type=Path, metavar="FOLDER", help="go on with the campaign of this folder"),
            option("--watch", action="store_true", help="show run after run on a page in the browser"),
            *LABELS,
        ),
        examples=("lab campaign campaign.yaml --rig rig/rig.yaml --plan", "lab campaign --resume april --rig rig/rig.yaml"),
        page="docs/howto/campaign.md",
    ),
)
