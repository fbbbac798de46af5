"""`lab campaign`: plan, run and resume a campaign.

On the rig: run after run, safe in between, until all are done, or a stop rule or a person ends it.
"""

from __future__ import annotations

import argparse
import contextlib
import secrets
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table as Sheet

from drivers.errors import InstrumentError
from protocols.errors import Stopped
from protocols.experiment import Plan
from protocols.planned import cycles, setups
from recordings.own_files import folder_in
from recordings.trials import Table

from ..console import Screen, clock, out, warn
from ..files.campaign_file import OWN_LABELS, Stop
from ..files.config import ConfigError
from ..files.resume import Broken
from ..files.units import shown
from ..guard.messages import RigLanded
from ..live.beside import Page, page_where
from ..options import JSON, LABELS, YES, Result, Verb, given_labels, option, path_option, rig
from ..plain import typed
from ..rig.actuators import ActuatorsLost
from ..rig.assembly import Rig
from ..rig.limits import Margin, margins
from ..rig.operator import NotPrepared, RememberingOperator, preparations
from ..verbs.run import Job, Outcome, connect, execute, job_again, note_unverified
from .design import SHOWN, CampaignDesign, CampaignRun, campaign_of, planned_table
from .journal import FILE, CampaignJournal, CampaignProgress, demand_same, fill, found_of, mend


class Stops:
    """The stop rules of a campaign, judged between two runs: why it ends, or nothing."""

    def __init__(self, rules: Stop, chambers: int) -> None:
        self.rules = rules
        self.failed = 0
        """Failures since this process began: a person has seen earlier ones."""
        self._chambers = chambers
        self._cycles = np.zeros(chambers, np.int64)
        self._tips: dict[tuple[tuple[int, int], int, int], list[np.ndarray]] = {}
        """By protocol and condition, trial in the run, step: a state that each block has once."""

    def count(self, plan: Plan, times: int = 1) -> None:
        """Count how often a plan was begun, each time with all of its cycles."""
        self._cycles = self._cycles + times * cycles(plan, self._chambers)[0]

    def before(self, plan: Plan, done: CampaignProgress) -> str:
        """Why a plan must not begin: its duration or cycles would exceed a stop rule; empty where it may."""
        longest, most = self.rules.max_duration, self.rules.max_cycles
        if longest is not None and done.seconds + plan.seconds > longest:
            return (
                f"stop.max_duration = {longest:g} s: runs have taken {clock(done.seconds)} of rig time, the next needs "
                f"{clock(plan.seconds)}"
            )
        after = self._cycles + cycles(plan, self._chambers)[0]
        if most is not None and after.max() > most:
            chamber = int(after.argmax())
            return (
                f"stop.max_cycles = {most}: chamber {chamber + 1} was inflated {self._cycles[chamber]} times, the next run "
                f"would make it {after[chamber]}"
            )
        return ""

    def take(self, cell: tuple[int, int], table: Table) -> None:
        """The states of a run that was completed."""
        states = table.take(~np.isnan(table.get("x")))
        for trial, step, tip in zip(states.trial.tolist(), states.get("step").tolist(), states.tip, strict=True):
            self._tips.setdefault((cell, trial, step), []).append(tip)

    def after(self, done: CampaignProgress) -> str:
        """Why the campaign must not go on after a run: lost samples, failures, or scatter of the tip; empty where it may."""
        if self.rules.max_lost is not None and done.lost > self.rules.max_lost:
            return f"stop.max_lost = {self.rules.max_lost}: {done.lost} samples were lost"
        if self.failed >= self.rules.max_failed:
            return f"stop.max_failed = {self.rules.max_failed}: {self.failed} run{'s' if self.failed > 1 else ''} failed"
        most = self.rules.max_scatter
        if most is None:
            return ""
        scatters = {key: float(np.sqrt(np.var(tips, axis=0).sum())) for key, tips in self._tips.items()}
        (cell, trial, step), worst = max(scatters.items(), key=lambda found: found[1], default=(((0, 0), 0, 0), 0.0))
        if worst <= most:
            return ""
        return (
            f"stop.max_scatter = {most * 1e3:g} mm: the tip of protocol {cell[0] + 1}, condition {cell[1] + 1}, trial {trial} "
            f"step {step} scatters by {worst * 1e3:.2f} mm (rms) between blocks; check mount, spine and hoses"
        )


WARM_UP = "warm-up"
"""Folder of the recordings of warm-ups, which hold no state."""


@dataclass(frozen=True)
class Ended:
    """How a session of a campaign ended."""

    completed: bool
    why: str = ""
    safe: bool = True
    error: Exception | None = None


class Session:
    """One process's share of a campaign."""

    def __init__(
        self, campaign: CampaignDesign, folder: Path, journal: CampaignJournal, watched: bool = False, prepared: bool = False
    ) -> None:
        self.campaign, self.folder, self.journal = campaign, folder, journal
        self.watched, self.prepared = watched, prepared
        self._page: Page | None = None
        self.hands = RememberingOperator()
        self.stops = Stops(campaign.file.stop, campaign.chambers)
        self.screen = Screen(campaign.file.campaign, campaign.runs[0].job.rig.clock.speed)
        self._rig: Rig | None = None
        self._safe = True
        self.displaced = False
        """A recording or its journal was deleted, renamed, replaced or truncated during its run."""
        self._planned_s = {run.number: run.job.plan.seconds for run in campaign.runs}
        """Of rig time, by run."""

    def go(self) -> Ended:
        """Do the remaining runs. However they end, the rig is safe, and completed runs are in the journal."""
        self._look_back()
        note_unverified(self.campaign.rig_path, self.campaign.runs[0].job.rig)
        try:
            with page_where(self.watched, self.screen.say) as self._page, self.screen:
                ended = self._all()
        except KeyboardInterrupt:
            ended = Ended(False, "stopped by the operator")
        finally:
            self._close()
        return replace(ended, safe=ended.safe and self._safe)

    def _look_back(self) -> None:
        """Count earlier sessions for the stop rules."""
        mend(self.folder / WARM_UP)
        begun = self.journal.done.begun
        for run in self.campaign.runs:
            self.stops.count(run.job.plan, begun[run.number])
        if self.campaign.warm_up is not None:
            self.stops.count(self.campaign.warm_up.plan, begun[0])
        if self.campaign.file.stop.max_scatter is not None:
            for run in self.campaign.runs:
                done = run.number in self.journal.done.completed
                if done and (broken := found_of(self.folder / run.folder).broken) is not None:
                    self.stops.take(run.cell, broken.table)

    def _all(self) -> Ended:
        for run in [run for run in self.campaign.runs if run.number not in self.journal.done.completed]:
            found = found_of(self.folder / run.folder)
            if found.completed and found.broken is not None:  # the crash came before the journal could say so
                self.journal.ended(run.number, "completed", 0.0, len(found.broken.table), found.lost, run.inflates)
                self.stops.take(run.cell, found.broken.table)
                continue
            while (ended := self._attempt(run)) is None:
                pass  # it failed, and may be tried again
            if not ended.completed:
                return ended
        return Ended(True)

    def _attempt(self, run: CampaignRun) -> Ended | None:
        """One attempt at a run, with a warm-up before it where one is due; None: it failed, and may be tried again."""
        needs = run.job.experiment.needs
        if self.campaign.warm_up is not None and run.inflates:  # opened once for both
            needs = tuple(dict.fromkeys((*needs, *self.campaign.warm_up.experiment.needs)))
        since = time.time() - self.journal.done.inflated
        if self.campaign.warm_up is not None and run.inflates and since > self.campaign.file.warm_up.again_after:
            ended = self._one(None, self.campaign.warm_up_for(run), needs, self.folder / WARM_UP, None)
            if ended is None or not ended.completed:
                return ended
        broken = found_of(self.folder / run.folder).broken
        own = run.job.experiment if run.job.experiment.source is not None else None
        job = run.job if broken is None else job_again(broken, self.campaign.rig_path, own, run.job.rig)
        return self._one(run, job, needs, self.folder / run.folder, broken)

    def _one(self, run: CampaignRun | None, job: Job, needs: Sequence[str], folder: Path, broken: Broken | None) -> Ended | None:
        """Make one recording (None: a warm-up); how the session ended; None: it failed and may be tried again."""
        if why := self.stops.before(job.plan, self.journal.done):
            return Ended(False, why)
        number = None if run is None else run.number
        title = f"Run {run.number} of {len(self.campaign.runs)}: {run.text}" if run is not None else "Warm-up"
        self.screen.say(title)
        if self._page is not None:
            self._page.part(f"Campaign {self.campaign.file.campaign}. {title}", more=True)
        try:
            rig = self._opened(job, needs)
            self.stops.count(job.plan)
            self.journal.began(number)
            begun = rig.clock.now()
            folder_in(folder.parent, folder.name)
            planned = self._planned_s if run is not None else {}  # a warm-up is no progress
            with self.screen.part(sum(planned[n] for n in self.journal.done.completed & planned.keys()), sum(planned.values())):
                result = execute(rig, replace(job, labels=self._labels(run)), folder, self.screen, broken, self._page)
        except (InstrumentError, ActuatorsLost, RigLanded, NotPrepared) as e:  # nothing was recorded
            return self._failed(number, e, 0.0, 0)
        seconds, lost = rig.clock.now() - begun, sum(result.lost.values())
        self._safe = result.safe
        self.displaced = self.displaced or bool(result.displaced)
        if result.outcome != "completed":
            if isinstance(result.error, Stopped):
                self.journal.ended(number, result.outcome, seconds, len(result.table), lost, False)
                return Ended(False, str(result.error), result.safe)
            return self._failed(number, result.error, seconds, lost)
        self.journal.ended(number, "completed", seconds, len(result.table), lost, run is None or run.inflates)
        return self._judged(run, result)

    def _judged(self, run: CampaignRun | None, result: Outcome) -> Ended:
        """Whether the campaign goes on after a run that was completed."""
        if run is not None:
            self.stops.take(run.cell, result.table)
        if not result.safe:
            return Ended(False, "the safe state is not confirmed", False)
        if len(self.journal.done.completed) == len(self.campaign.runs):
            return Ended(True)
        why = self.stops.after(self.journal.done) or "stopped by the operator" * result.asked or "; ".join(result.displaced)
        return Ended(not why, why)

    def _failed(self, number: int | None, error: Exception | None, seconds: float, lost: int) -> Ended | None:
        """Report and count a failure, and close the rig: it is reconnected for the next attempt."""
        self.journal.ended(number, "failed", seconds, 0, lost, False)
        self.stops.failed += 1
        self._close()
        why = self.stops.after(self.journal.done)
        if why or not self._safe:
            return Ended(False, why or "the safe state is not confirmed", self._safe, error)
        self.screen.say(f"failed: {error}; it continues with its first unfinished trial")
        return None

    def _opened(self, job: Job, needs: Sequence[str]) -> Rig:
        """A rig with these instruments open: the current one if it has exactly these."""
        if self._rig is not None and self._rig.needed(needs) == [*self._rig.identities]:
            self._rig.actuators.pulse.mark()
            return self._rig
        self._close()
        rig = Rig(job.rig, prepared=self.prepared)
        self._rig = rig
        rig.operator = self.hands.over(rig.operator)
        connect(rig, needs)
        return rig

    def _close(self) -> None:
        if self._rig is not None:
            rig, self._rig = self._rig, None
            warn(rig.notices)
            with contextlib.suppress(KeyboardInterrupt):
                rig.close()

    def _labels(self, run: CampaignRun | None) -> dict[str, str]:
        """Description of a recording."""
        own = {**self.campaign.file.labels, **self.journal.done.labels, "campaign": self.campaign.file.campaign}
        own |= {"warm_up": "yes"} if run is None else {"block": str(run.block), "run": str(run.number)}
        return own if run is None or not run.condition else own | {"condition": run.condition[:SHOWN]}


def plan(path: Path, rig_path: Path) -> Result:
    """What a campaign will do; connects to nothing. Raises ConfigError."""
    c = _checked(path, rig_path)
    data = plan_dict(c)
    return Result(data, lambda: _show_plan(c, data))


def _show_plan(c: CampaignDesign, planned: Mapping[str, Any]) -> None:
    """Print runs, durations, what a person has to do before which run, cycles by chamber, and margins to the limits."""
    sheet = Sheet("run", "block", "protocol", "condition", "about", "hands", box=None, pad_edge=False)
    tasks: list[str] = []
    for run in planned["runs"]:
        which_run = f"run {run['run']}" if run["run"] else "the warm-up"
        run_tasks = [f"before {which_run}: {hand['do']}" for hand in run["hands"]]
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
    out.print(f"hands are needed {'once' if c.hands == 1 else f'{c.hands} times'}, the first time before the first run")
    for number, task in enumerate(tasks, 1):
        out.print(f"  task {number}, {task}", soft_wrap=True)
    chambers_by_load: dict[tuple[int, float], list[str]] = {}
    for chamber in planned["chambers"]:
        chambers_by_load.setdefault((chamber["cycles"], chamber["highest_pa"]), []).append(str(chamber["chamber"]))
    for (count, highest), chambers in chambers_by_load.items():
        if count:
            named = f"chamber{'s' if len(chambers) > 1 else ''} {', '.join(chambers)}"
            out.print(f"  {named}: {count} pressure cycles, up to {shown(highest, 'Pa')}", soft_wrap=True)
    for margin in _margins(c):
        out.print(f"  {margin}", soft_wrap=True)


def _margins(c: CampaignDesign) -> list[Margin]:
    """Of all runs together."""
    return margins(Plan(c.file.campaign, [step for _, j in c.jobs for step in j.plan.steps], {}), c.runs[0].job.rig, c.robot)


def _checked(path: Path, rig_path: Path, prepared: bool = False) -> CampaignDesign:
    """The campaign of a file; where that gives no seed, one is drawn. Raises ConfigError also where all is said to be `prepared`
    although a person has to change the set-up in between."""
    with Screen("checking all runs") as screen:
        c = campaign_of(path, rig_path, secrets.randbelow(2**31), screen.progress)
    if prepared and c.hands > 1 and c.runs[0].job.rig.operator == "console":
        raise ConfigError(
            f"--yes: {path} needs hands {c.hands} times (--plan lists them), but only its first set-up can be prepared now; "
            "leave out --yes, or have a program answer (operator: unix:/PATH in rig.yaml)"
        )
    return c


def plan_dict(c: CampaignDesign) -> dict[str, Any]:
    """The plan as JSON has it: runs with what a person has to do before each, cycles by chamber, limits and margins."""
    counts, highest = c.cycles()
    runs, stands = [], None  # the set-up that stands
    limits: dict[str, float] = {}
    for run, j in c.jobs:
        hands = []
        for setup in setups(j.plan):
            if setup != stands:
                mounted = {"mount": setup.mount, "tip_mass_kg": setup.tip_mass, "roll_deg": setup.roll_deg}
                hands.append({"do": preparations(setup, stands), **mounted, "vacuum_pa": setup.vacuum})
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


def run(
    path: Path, rig_path: Path, folder: Path | None, labels: Mapping[str, str], watched: bool = False, prepared: bool = False
) -> Result:
    """Begin a campaign. `labels`: further ones; `prepared`: nobody is asked. Raises ConfigError."""
    c = _checked(path, rig_path, prepared)
    place = folder or Path(c.file.campaign)
    place.mkdir(parents=True, exist_ok=True)
    with CampaignJournal.begin(place, c.file.campaign, c.digest, labels) as journal:
        fill(place, c)
        return _session(Session(c, place, journal, watched, prepared))


def resume(place: Path, rig_path: Path, labels: Mapping[str, str], watched: bool = False, prepared: bool = False) -> Result:
    """Go on with the campaign of a folder, or of a file in it. Raises ConfigError, BadJournal."""
    folder = place if place.is_dir() else place.parent
    with CampaignJournal.reopen(folder) as journal:
        c = _checked(folder / FILE, rig_path, prepared)
        demand_same(folder, c, journal.done.design)
        journal.done.labels |= labels
        return _session(Session(c, folder, journal, watched, prepared))


def _session(session: Session) -> Result:
    """Do the remaining runs of a campaign; code 0: completed, 1: cut short or not safe, 3: samples or a recording were lost."""
    c, folder, done = session.campaign, session.folder, session.journal.done
    go_on = typed("lab", "campaign", "--resume", folder, "--rig", c.rig_path)
    try:
        ended = session.go()
    except Exception:
        out.print(f"go on with: {go_on}", soft_wrap=True)
        raise
    again = None if ended.completed else go_on
    data = {"folder": str(folder), "completed": ended.completed, "why": ended.why, "runs_done": len(done.completed),
            "runs": len(c.runs), "rows": done.rows, "lost": done.lost, "safe": ended.safe, "hands": session.hands.asked,
            "resume": again}  # fmt: skip
    cut_short = not (ended.completed or session.displaced)
    code = 1 if cut_short or not ended.safe else 3 if done.lost or session.displaced else 0

    def show() -> None:
        word = "completed" if ended.completed else f"ended: {ended.why}"
        out.print(f"{word}: {len(done.completed)} of {len(c.runs)} runs, {done.rows} states in {folder}", soft_wrap=True)
        if done.lost:
            out.print(f"  lost: {done.lost} samples ({typed('lab', 'runs', folder)})", soft_wrap=True)

    return Result(data, show, code, ended.error, safe=ended.safe, again=again)


def _campaign(a: argparse.Namespace) -> Result:
    labels = given_labels(a)
    if taken := sorted(set(labels) & set(OWN_LABELS)):
        raise ConfigError(f"--tag {', '.join(taken)}: is given by the campaign itself")
    if (a.file is None) == (a.resume is None):
        raise ConfigError("give a campaign's file, or the folder of one with --resume")
    if a.resume is not None:
        if a.plan or a.out is not None:
            raise ConfigError("--resume goes on with the campaign as it is in its folder: do not give --plan or --out")
        return resume(a.resume, a.rig, labels, a.watch, a.yes)
    return plan(a.file, a.rig) if a.plan else run(a.file, a.rig, a.out, labels, a.watch, a.yes)


VERBS = (
    Verb(
        "campaign",
        _campaign,
        options=(
            JSON,
            option("file", nargs="?", type=Path, help="campaign.yaml"),
            rig(),
            option("--plan", action="store_true", help="what it will do, how long it takes, its limits; nothing moves"),
            path_option("--out", "FOLDER", "folder for all its recordings (default: the campaign's name)"),
            path_option("--resume", "FOLDER", "go on with the campaign of this folder"),
            option("--watch", action="store_true", help="show run after run on a page in the browser"),
            YES,
            *LABELS,
        ),
        examples=("lab campaign campaign.yaml --rig rig/rig.yaml --plan", "lab campaign --resume april --rig rig/rig.yaml"),
        page="docs/howto/campaign.md",
    ),
)
