"""A campaign's runs in order, each an experiment that is checked against the rig."""

from __future__ import annotations

import hashlib
import itertools
import json
import random
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_origin

import numpy as np
import yaml

from drivers.pressure_limits import VENTED
from model.plain_yaml import MOST_PROBLEMS
from model.robot import Robot
from protocols.bench import Setup
from protocols.planned import cycles, planned_rows, setups

from ..files.all_protocols import found_protocols, protocol_from_file
from ..files.campaign_file import CampaignFile, CampaignProtocol, load_campaign
from ..files.config import ConfigError, Loc, Source, in_units
from ..files.rig_file import RigFile, load_rig
from ..verbs.run import Columns, Job, job, planned_columns


def ordered(hands: Sequence[Sequence[Hashable]], blocks: int, seed: int, grouped: bool) -> list[tuple[int, tuple[int, int]]]:
    """All runs in order, (block, (protocol of the file, condition)), conditions of a block shuffled by `seed`.

    `hands`: of each protocol the set-up of each condition; `grouped`: a set-up is kept for all blocks before the next, so that a
    person changes it as seldom as possible.

    >>> ordered([["light", "light", "heavy"]], 2, 1, True)
    [(1, (0, 1)), (1, (0, 0)), (2, (0, 1)), (2, (0, 0)), (1, (0, 2)), (2, (0, 2))]
    """
    rng = random.Random(seed)
    cells = [[(part, k) for k in range(len(conditions))] for part, conditions in enumerate(hands)]
    if not grouped:
        return [(block, cell) for part in cells for block in range(1, blocks + 1) for cell in rng.sample(part, len(part))]
    cells_by_setup = [
        {setup: [(part, k) for k, s in enumerate(conditions) if s == setup] for setup in dict.fromkeys(conditions)}
        for part, conditions in enumerate(hands)
    ]
    return [
        (block, cell)
        for conditions, order in zip(cells_by_setup, fewest_changes([list(p) for p in cells_by_setup], rng), strict=True)
        for setup in order
        for block in range(1, blocks + 1)
        for cell in rng.sample(conditions[setup], len(conditions[setup]))
    ]


def fewest_changes(parts: Sequence[Sequence[Hashable]], rng: random.Random) -> list[list[Hashable]]:
    """The set-ups of each part in random order, with as many parts as possible that begin as the one before ended."""
    # dynamic programming over the parts: last set-up -> (changes saved, the best orders that end with it)
    best: Mapping[Hashable, tuple[int, list[list[Hashable]]]] = {None: (0, [])}
    for part in parts:
        shuffled = rng.sample(list(part), len(part))
        by_last: dict[Hashable, tuple[int, list[list[Hashable]]]] = {}
        for first in shuffled:
            for last in shuffled if len(shuffled) == 1 else [s for s in shuffled if s != first]:
                order = [first, *(s for s in shuffled if s not in (first, last)), *([last] if last != first else [])]
                for last_before, (saved, orders) in best.items():
                    score = saved + (last_before == first and bool(orders))  # no orders: the first part
                    if last not in by_last or score > by_last[last][0]:
                        by_last[last] = (score, [*orders, order])
        best = by_last
    return max(best.values(), key=lambda scored: scored[0])[1]


def changes(runs: Sequence[Sequence[Hashable]]) -> int:
    """How often a person's hands are needed for the set-ups of these runs in order, the first included."""
    return len(list(itertools.groupby(itertools.chain.from_iterable(runs))))


SHOWN = 180
"""Characters of a condition in a label."""


@dataclass(frozen=True)
class CampaignRun:
    """One run of the campaign."""

    number: int
    """From 1 on, in the order in which they are done."""
    block: int
    cell: tuple[int, int]
    """Number of its protocol in the file and of its condition: the same in each block."""
    condition: str
    """As people read it."""
    job: Job

    @property
    def folder(self) -> str:
        """Name of the folder of its recordings: by name is by order."""
        return f"{self.number:04d}-{self.job.experiment.name}"

    @property
    def inflates(self) -> bool:
        """Whether it bends the robot."""
        return any(max(step.ask.pressures, default=0.0) > VENTED for step in self.job.plan.steps)

    @property
    def text(self) -> str:
        """What it is, for people."""
        name = self.job.experiment.name
        return f"{name}, {self.condition}, block {self.block}" if self.condition else f"{name}, block {self.block}"


@dataclass(frozen=True)
class CampaignDesign:
    """All runs in order."""

    file: CampaignFile
    runs: tuple[CampaignRun, ...]
    warm_up: Job | None
    """Cycles before the first run that inflates the robot; None: there is no such run, or none are wanted."""
    rig_path: Path
    robot: Robot
    seed_given: bool

    @property
    def chambers(self) -> int:
        """How many it has."""
        return len(self.robot.actuators.azimuths_deg)

    @property
    def jobs(self) -> Iterator[tuple[CampaignRun | None, Job]]:
        """All plans in order, with their runs; None: the warm-up, where it is planned."""
        first_inflating = next((run for run in self.runs if run.inflates), None)
        for run in self.runs:
            if self.warm_up is not None and run is first_inflating:
                yield None, self.warm_up_for(run)
            yield run, run.job

    def warm_up_for(self, run: CampaignRun) -> Job:
        """The warm-up with the set-up of the run that follows, so that nobody's hands are needed for it."""
        assert self.warm_up is not None
        told = [s for s in setups(run.job.plan) if s.mount == "robot"]
        if not told:
            return self.warm_up
        values = {"tip_mass": told[0].tip_mass, "roll_deg": told[0].roll_deg, "vacuum": told[0].vacuum}
        parameters = self.warm_up.parameters.model_copy(update=values)
        return replace(self.warm_up, parameters=parameters, plan=self.warm_up.experiment.plan(parameters))

    @property
    def seconds(self) -> float:
        """Planned, s of rig time, without a person's hands."""
        return sum(j.plan.seconds for _, j in self.jobs)

    @property
    def hands(self) -> int:
        """How often a person is asked to set the rig up."""
        return changes([setups(j.plan) for _, j in self.jobs])

    def cycles(self) -> tuple[np.ndarray, np.ndarray]:
        """(chambers,) pressure cycles of each chamber, and its highest pressure, Pa gauge; the warm-up included."""
        counts = [cycles(j.plan, self.chambers) for _, j in self.jobs]
        return np.sum([c for c, _ in counts], axis=0), np.max([p for _, p in counts], axis=0)

    @property
    def digest(self) -> str:
        """Digest of what must not change when the campaign is resumed: the runs and their order."""
        jobs = {run.cell: run.job for run in self.runs}
        code = {cell: hashlib.sha256(own).hexdigest() if (own := job.experiment.code) else "" for cell, job in jobs.items()}
        cells = {cell: [job.protocol_yaml, code[cell]] for cell, job in jobs.items()}
        order = [[run.block, *run.cell] for run in self.runs]
        return hashlib.sha256(json.dumps([sorted(cells.items()), order]).encode()).hexdigest()

    @property
    def yaml(self) -> str:
        """The campaign's file in full, with its seed."""
        return yaml.safe_dump(in_units(self.file.model_dump(mode="json"), CampaignFile), sort_keys=False)


def campaign_of(
    path: Path, rig_path: Path, seed: int, progress: Callable[[float, float], None] = lambda done, total: None
) -> CampaignDesign:
    """Read and check a whole campaign before anything moves; `seed` is used if the file gives none.

    `progress` receives the number of checked conditions and their total.

    Raises ConfigError with the problems of all runs, each with the place in the file or the run it comes from."""
    file, source = load_campaign(path)
    seed_given = file.seed is not None
    file = file if seed_given else file.model_copy(update={"seed": seed})
    problems: dict[str, str] = {}
    jobs: list[list[tuple[str, Job]]] = [[] for _ in file.protocols]
    total = sum(part.cells for part in file.protocols)
    rig = load_rig(rig_path)
    for number, part in enumerate(file.protocols):
        for checked in _jobs(part, ("protocols", number), source, rig_path, rig, problems):
            jobs[number].append(checked)
            progress(sum(map(len, jobs)), total)
    if problems:
        texts = list(problems.values())
        more = [f"{path}: and {len(texts) - MOST_PROBLEMS} more problems"] if len(texts) > MOST_PROBLEMS else []
        raise ConfigError(*texts[:MOST_PROBLEMS], *more)
    hands: list[list[tuple[Setup, ...]]] = [[setups(j.plan) for _, j in part_jobs] for part_jobs in jobs]
    assert file.seed is not None
    slots = ordered(hands, file.blocks, file.seed, file.hands == "grouped")
    runs = tuple(CampaignRun(n, block, (part, k), *jobs[part][k]) for n, (block, (part, k)) in enumerate(slots, 1))
    return CampaignDesign(file, runs, _warm_up(file, runs, rig_path, rig), rig_path, rig.body, seed_given)


def _jobs(
    part: CampaignProtocol, place: Loc, source: Source, rig_path: Path, rig: RigFile, problems: dict[str, str]
) -> Iterator[tuple[str, Job]]:
    """Each condition of a protocol as people read it, and its job; what is wrong goes to `problems`, each text once."""
    file = Path(part.protocol) if part.protocol.endswith(".py") else None
    try:
        experiment = protocol_from_file(file) if file is not None else found_protocols().usable.get(part.protocol)
    except ConfigError as e:
        problems[str(e)] = f"{source.at((*place, 'protocol'))}: {e}"
        return
    name = part.protocol if file is None or experiment is None else experiment.name
    fields = {} if experiment is None else experiment.parameters.model_fields
    lists = {key for key, field in fields.items() if get_origin(field.annotation) is list}  # of which one value is a list of one
    for choice in itertools.product(*(range(len(values)) for values in part.conditions.values())):
        picked = dict(zip(part.conditions, choice, strict=True))
        values = {key: part.conditions[key][k] for key, k in picked.items()}
        condition = ", ".join(f"{key} {_short(value)}" for key, value in values.items())
        set_to = {key: [value] if key in lists and not isinstance(value, list) else value for key, value in values.items()}
        run_source = Source(source.name, {"protocol": name, **part.parameters, **set_to}, _lines(source, place, picked))
        try:
            yield condition, job(run_source, rig_path, (), experiment if file is not None else None, rig)
        except ConfigError as e:
            where = "" if e.placed or not condition else f"{condition}: "
            for problem in e.problems:
                problems.setdefault(problem, f"{where}{problem}")


def _lines(source: Source, place: Loc, picked: Mapping[str, int]) -> dict[Loc, int]:
    """Key of a run's parameters -> line of the campaign's file: of `parameters`, or of the value `picked` below `conditions`."""
    line_of: dict[Loc, int] = {}
    same, varied = (*place, "parameters"), (*place, "conditions")
    for loc, line in source.lines.items():
        if loc == (*place, "protocol"):
            line_of[("protocol",)] = line
        elif loc[: len(same)] == same and len(loc) > len(same):
            line_of[loc[len(same) :]] = line
        elif loc[: len(varied)] == varied and len(loc) > len(varied) + 1:
            key, number = loc[len(varied)], loc[len(varied) + 1]
            if picked.get(str(key)) == number:
                line_of[(key, *loc[len(varied) + 2 :])] = line
    return line_of


def _short(value: Any) -> str:
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 2]}.."


def _warm_up(file: CampaignFile, runs: tuple[CampaignRun, ...], rig_path: Path, rig: RigFile) -> Job | None:
    """A job of cycles of each group of chambers that is inflated, to its highest pressure; None where none is wanted."""
    highest: dict[tuple[int, ...], float] = {}
    rate, speed = 0.0, 0.0
    for run in runs:
        for ask in (step.ask for step in run.job.plan.steps):
            group = tuple(c for c, p in enumerate(ask.pressures, 1) if p > VENTED)
            if group:
                highest[group] = max(highest.get(group, 0.0), max(ask.pressures))
            rate, speed = max(rate, ask.pressure_rate or 0.0), max(speed, ask.spine_speed or 0.0)
    if not highest or not file.warm_up.cycles:
        return None
    values: dict[str, Any] = {
        "protocol": "cycles", "cycles": file.warm_up.cycles, "rate": rate,
        "chambers": [list(group) for group in highest], "pressures": list(highest.values()),
    }  # fmt: skip
    if speed:
        values["spine"] = {"speed": speed}
    return job(Source("warm_up", values, {}), rig_path, rig=rig)


def planned_table(campaign: CampaignDesign, channels: Sequence[str] = ()) -> Columns:
    """The table of `lab.diagnose` without readings: one row for each state that the campaign will read, in order.

    Trials are numbered on from run to run as `lab.files.inputs.read_case` numbers those of the recordings; `t` is s of rig time
    since the campaign's begin as planned. See `planned_columns`, also for `channels`."""
    rows: list[dict[str, Any]] = []
    trials, begun = 0, 0.0
    for run, j in campaign.jobs:
        if run is not None:
            run_rows = planned_rows(j.plan, j.parameters, campaign.chambers)
            rows += [{**row, "trial": row["trial"] + trials, "t": row["t"] + begun} for row in run_rows]
            trials = max((row["trial"] for row in rows), default=0)
        begun += j.plan.seconds
    return planned_columns(rows, campaign.robot, channels)
