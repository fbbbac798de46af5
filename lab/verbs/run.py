"""`lab plan` and `lab run`: an experiment from its parameters to a recording, and the rig safe afterwards whatever happened."""

from __future__ import annotations

import argparse
import contextlib
import copy
import itertools
import json
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from rich.padding import Padding

from model.robot import Robot
from protocols.errors import BadProtocol, NotReached, Stopped
from protocols.experiment import Plan, Step, Trials
from protocols.parameters import Parameters, RobotFacts
from protocols.planned import planned_rows, unlike
from protocols.registry import Experiment
from protocols.steering import Steering
from recordings.campaign.info import beyond_plan
from recordings.campaign.labels import RECORD
from recordings.campaign.replay import metadata as campaign
from recordings.errors import RecordingError
from recordings.events import Request
from recordings.file.journal import Journal
from recordings.file.reader import Recording
from recordings.file.writer import Recorder
from recordings.numbers import NUMBER
from recordings.trials import INTEGERS, TEXTS, Table, column_order, counted

from ..console import Screen, clock, err, note, out, warn
from ..files.all_protocols import file_of, found_protocols, protocol_from_file, protocol_keys
from ..files.checked import announce, last, place
from ..files.config import ConfigError, Source, check, parse_yaml, read_yaml
from ..files.inputs import marked_notes, same_body
from ..files.packages import told_at
from ..files.resume import Broken, find
from ..files.rig_file import RigFile, load_rig
from ..files.units import shown
from ..live.beside import Page, page_where
from ..live.picture import PLAN
from ..options import JSON, LABELS, YES, Result, Verb, given_labels, option, path_option, repeatable, rig
from ..plain import typed
from ..rig.assembly import Rig, newly_lost
from ..rig.interrupts import Interrupts
from ..rig.keeping import settings as settings_within
from ..rig.keys import HELP, Keys, Line
from ..rig.limits import ACTIVE, SLACK, Margin, arm_places, excesses, margins, problems, wiring
from ..rig.operator import NotPrepared
from ..rig.rehearsal import rehearse
from ..version import provenance

Columns = dict[str, NDArray[np.generic]]

LONGEST_PLAN = 30 * 86400.0
"""s of rig time; a plan beyond it is a mistake in its parameters, such as a rate that is far too low."""


@dataclass(frozen=True)
class Job:
    """An experiment with its parameters, checked against the rig."""

    experiment: Experiment
    parameters: Parameters
    plan: Plan
    rig: RigFile
    rig_path: Path
    labels: Mapping[str, str] = field(default_factory=dict)

    @property
    def protocol_yaml(self) -> str:
        """The parameters in full, as a protocol file."""
        values = {"protocol": self.experiment.name, **self.parameters.model_dump(mode="json")}
        return yaml.safe_dump(values, sort_keys=False)


def job(
    protocol: str | Source,
    rig_path: Path,
    settings: Sequence[str] = (),
    of_file: Experiment | None = None,
    rig: RigFile | None = None,
) -> Job:
    """Read and check everything before anything moves; raises ConfigError with all problems.

    `protocol`, `rig`: the protocol file and rig.yaml may have been read already; `of_file`: the protocol of a Python file."""
    rig = load_rig(rig_path) if rig is None else rig
    robot = rig.body
    facts = robot_facts(robot, rig)
    given = source_of(protocol, settings)
    experiment, parameters, plan = protocol_plan(given, facts, of_file)
    if not facts.spine:
        experiment = replace(experiment, needs=tuple(n for n in experiment.needs if n not in OF_SPINE))
    if missing := [n for n in experiment.needs if getattr(rig.instruments, n) is None]:
        blind = "; without cameras use lab run cycles or lab jog, and join tips measured elsewhere (docs/howto/other-data.md)"
        need = f"{experiment.name} needs instruments.{', instruments.'.join(missing)}; add them"
        raise ConfigError(f"{rig_path}: {need}{blind * ('mocap' in missing)}")
    on_rig = (rig, rig_path, robot)
    keeping = partial(settings_within, parameters, given.table, lambda tried: excesses(_planned(experiment, tried), *on_rig))
    if beyond := problems(plan, *on_rig, keeping):
        raise ConfigError(*beyond)
    return Job(experiment, parameters, plan, rig, rig_path)


def protocol_plan(source: Source, facts: RobotFacts, of_file: Experiment | None = None) -> tuple[Experiment, Parameters, Plan]:
    """The protocol of a file with its parameters, and its plan; raises ConfigError.

    `facts`: what is known of the robot; `of_file`: a protocol of Python."""
    experiment = _experiment(source, of_file)
    values, lines = {k: v for k, v in source.table.items() if k != "protocol"}, dict(source.lines)
    for old, new in experiment.parameters.renamed.items():
        if old in values and new not in values:
            values[new] = values.pop(old)
            lines |= {(new, *loc[1:]): line for loc, line in source.lines.items() if loc[:1] == (old,)}
            note([f"{source.at((old,))}: {old} is called {new} now; write {new}"])
    values = {**_defaults(experiment, facts), **values}
    parameters = check(Source(source.name, values, lines), experiment.parameters)
    plan = _planned(experiment, parameters)
    if not plan.seconds <= LONGEST_PLAN:  # nor is it when it is not a number
        raise ConfigError(
            f"{source.name}: {experiment.name} would take {plan.seconds / 86400:.3g} days of rig time, at most "
            f"{LONGEST_PLAN / 86400:g}; raise its rates and speeds, or shorten its waits",
            placed=True,
        )
    return experiment, parameters, plan


OF_SPINE = ("spine", "valve", "gauge")
"""Instruments that a robot without a spine does not need."""


def robot_facts(robot: Robot, rig: RigFile | None = None) -> RobotFacts:
    """What protocols know of a robot with its rig, or with each chamber by itself. Raises ConfigError if the wiring differs."""
    each = tuple((c,) for c in range(1, len(robot.actuators.azimuths_deg) + 1))
    channels = each if rig is None else wiring(rig, robot).channels
    arm = {} if rig is None else arm_places(rig, robot.length)
    return RobotFacts(len(each), channels, robot.tip_mass, robot.spine is not None, arm)


def planned_columns(rows: Sequence[Mapping[str, Any]], robot: Robot, channels: Sequence[str] = ()) -> Columns:
    """Columns of trials.csv (name -> (n,) values, SI) of planned states; cells that do not apply are NaN or empty.

    `channels`: what will be measured (x, y, z, qw .., m1x .., force), as columns of zeros (qw of ones), for
    `model.effects.design.design_from_columns`, which takes what is there as observed."""
    names = {name for row in rows for name in row if name != "vacuum" or robot.spine is not None}
    columns: Columns = {}
    for name in sorted(names, key=lambda name: column_order(name) or ()):
        kind, none = (np.str_, "") if name in TEXTS else (np.int64, None) if name in INTEGERS else (np.float64, np.nan)
        columns[name] = np.array([row.get(name, none) for row in rows], kind)
    return columns | {name: np.full(len(rows), float(name == "qw")) for name in channels}


def source_of(protocol: str | Source, settings: Sequence[str] = ()) -> Source:
    """What a protocol file says, or a name alone, with `--set key=value` (dotted keys) applied; raises ConfigError."""
    if isinstance(protocol, str):
        is_file = Path(protocol).suffix in (".yaml", ".yml")
        protocol = read_yaml(Path(protocol)) if is_file else Source(protocol, {"protocol": protocol}, {})
    data: Any = copy.deepcopy(protocol.data)
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or not isinstance(data, dict):
            raise ConfigError(f"--set {setting}: write KEY=VALUE, for example --set repeats=3")
        place = data
        *path, last = key.strip().split(".")
        for step in path:
            place = place.setdefault(step, {})
            if not isinstance(place, dict):
                raise ConfigError(f"--set {setting}: {step} is not a table")
        place[last] = parse_yaml(text, f"--set {key}").data
    return Source(protocol.name, data, protocol.lines)


def _experiment(source: Source, of_file: Experiment | None = None) -> Experiment:
    """The protocol that a file, a run or a person names; `of_file` comes before those that are installed."""
    name, where = source.table.get("protocol", source.name), source.name
    if of_file is not None:
        if of_file.name != name:
            raise ConfigError(f"{of_file.source}: defines the protocol {of_file.name}, but {where} needs {name}")
        return of_file
    if isinstance(name, str) and name.endswith(".py"):
        return protocol_from_file(Path(name))
    protocols = found_protocols()
    if isinstance(name, str) and name in protocols.broken:
        raise ConfigError(f"{where}: protocol = {name}: {protocols.broken[name]}", placed=True)
    if not isinstance(name, str) or name not in protocols.usable:
        raise ConfigError(
            f"{where}: protocol = {name!r}: must be one of {', '.join(protocols.usable)}, or a protocol file (.yaml, .py)",
            placed=True,
        )
    if name in protocols.doubts:
        note([protocols.doubts[name]])
    return protocols.usable[name]


@contextlib.contextmanager
def _by_protocol(file: str | Path | None) -> Iterator[None]:
    """Report a mistake in the file of a lab's own protocol at its line."""
    try:
        yield
    except Exception as error:
        if file is None:
            raise
        raise BadProtocol(told_at(error, file)) from error


def _defaults(experiment: Experiment, facts: RobotFacts) -> dict[str, Any]:
    with _by_protocol(file_of(experiment)):
        return experiment.parameters.defaults_for(facts)


def _planned(experiment: Experiment, parameters: Parameters) -> Plan:
    """Return the plan. A file's plan gets the file's name, because the file may be a copy."""
    file = file_of(experiment)
    with _by_protocol(file):
        plan = experiment.plan(parameters)
    if not isinstance(plan, Plan):
        raise BadProtocol(f"{experiment.source or experiment.name}: plan returned {plan!r:.80}, not a Plan")
    if experiment.source is not None:
        return replace(plan, protocol=experiment.name)
    if plan.protocol != experiment.name:
        raise BadProtocol(f"{experiment.name}: plan names {plan.protocol!r}; write Plan({experiment.name!r}, ..) in {file}")
    return plan


def plan(protocol: str, rig_path: Path, settings: list[str], whole: bool, rehearsing: bool = False) -> Result:
    """Limits, duration and steps, without connecting. `whole`: each repeat; `rehearsing`: do the protocol's `run` at the desk."""
    j = job(protocol, rig_path, settings)
    p, speed = j.plan, j.rig.clock.speed
    margins_asked = margins(p, j.rig, j.rig.body)
    if not any(m.name in ACTIVE for m in margins_asked):
        keys_of = "check its parameters, such as chambers: `lab plan PROTOCOL --keys` lists them"
        note([f"{p.protocol}: no step asks for a pressure, a spine length or a push; {keys_of}"])
    done = _rehearsed(j) if rehearsing else None
    if {reading.repeat for step in p.steps for reading in step.reads} == {1}:
        more = "add --set repeats=3" if "repeats" in type(j.parameters).model_fields else "plan each state several times"
        note([f"{p.protocol}: each state is read once, so that repeatability (the noise floor) cannot be estimated; {more}"])
    largest = [asdict(m) for m in margins_asked]
    data = {**plan_dict(p), "largest": largest, "clock_speed": speed, "host_seconds": p.seconds / speed}
    return Result(data | ({} if done is None else {"rehearsal": done}), lambda: _show_plan(p, speed, margins_asked, whole, done))


def _show_plan(p: Plan, speed: float, asked: Sequence[Margin], whole: bool, done: Mapping[str, Any] | None) -> None:
    """Print duration, margins to the limits (`asked`), steps and the rehearsal (`done`, see `_rehearsed`)."""
    out.print(f"{p.protocol}: {counted(len(p.steps), 'step')}, about {clock(p.seconds)} of rig time", soft_wrap=True)
    if speed != 1:
        real = f"At clock speed {speed:g} this takes {clock(p.seconds / speed)} of real time; a slow computer takes longer."
        out.print(real, soft_wrap=True)
    for m in asked:
        out.print(f"  {m}", soft_wrap=True)
    steps, repeats = (p.steps, 1) if whole else folded(p.steps)
    rows = [(clock(step.seconds), REPEAT.sub("", step.label) if repeats > 1 else step.label) for step in steps]
    number = 1
    for (duration, label), alike in itertools.groupby(rows):
        times = len(list(alike))
        out.print(f"{number:4d}  {duration:>8}  {label}{f' ({times} times)' if times > 1 else ''}", soft_wrap=True)
        number += times
    if repeats > 1:
        out.print(f"x {repeats} repeats (--all lists every step)")
    if done is not None:
        out.print(f"rehearsal: run ends; states read: {done['states']}, trials: {done['trials']}", soft_wrap=True)
        note(done["differs"])


def _rehearsed(j: Job) -> dict[str, Any]:
    """Execute a protocol's `run` without instruments: states and trials read, differences from its plan. Raises BadProtocol."""
    rows, highest = rehearse(j.experiment, j.parameters, j.plan, j.rig)
    differs = ["the plan's steps do not state what they read: give each Step its `reads`"] if rows else []
    if any(step.reads for step in j.plan.steps):
        differs = [unlike(planned_rows(j.plan, j.parameters, wiring(j.rig, j.rig.body).count), rows)]
    planned = max((p for step in j.plan.steps for p in step.ask.pressures), default=0.0)
    if highest > planned * SLACK:
        differs.append(
            f"run asks for {highest / 1e3:.4g} kPa, its plan for at most {planned / 1e3:.4g} kPa; only the plan is checked "
            "against the limits"
        )
    differs = [f"{j.experiment.name}: {text}" for text in differs if text]
    return {"states": len(rows), "trials": len({row.trial for row in rows}), "differs": differs}


REPEAT = re.compile(r",? (?:repeat|cycle) \d+(?: of \d+)?")
"""The number of a repeat in the label of a step."""


def folded(steps: Sequence[Step]) -> tuple[Sequence[Step], int]:
    """Return the steps of the first repeat, and how many repeats alike the plan consists of."""
    labels = [REPEAT.sub("", step.label) for step in steps]
    n = len(labels)
    period = next((p for p in range(1, n) if n % p == 0 and labels[p:] == labels[:-p]), n)
    return (steps[:period], n // period) if n else (steps, 1)


def keys(protocol: str, rig_path: Path | None) -> Result:
    """What can be set of a protocol: key, unit, default (for the robot of the rig, where one is given), limits."""
    source = source_of(protocol)
    experiment = _experiment(source)
    defaults, allowed = dict[str, Any](), list[str]()
    if rig_path is not None:
        rig = load_rig(rig_path)
        defaults = _defaults(experiment, facts := robot_facts(rig.body, rig))
        with contextlib.suppress(ConfigError, BadProtocol):  # a key has no default
            planned = protocol_plan(source, facts)[2]
            bounds = [f"{m.name} {shown(m.limit, m.unit)}" for m in margins(planned, rig, rig.body) if m.limit is not None]
            allowed = [*bounds, f"chambers 1 to {facts.chambers}"]
    listed = protocol_keys(experiment.parameters, defaults)
    quantity = next((key for key in listed if key.unit and re.fullmatch(NUMBER, key.default)), None)

    def show() -> None:
        out.print(f"Keys of {experiment.name}: unit, default, what the protocol allows, meaning")
        if allowed:
            out.print(f"This rig allows at most: {', '.join(allowed)}", soft_wrap=True)
        for key in listed:
            out.print(str(key), soft_wrap=True)
            if key.meaning:
                out.print(Padding(key.meaning, (0, 0, 0, 4), expand=False))
        example = "" if quantity is None else ": " + typed("--set", f"{quantity.name}={quantity.default} {quantity.unit}")
        out.print(f"Write numbers with their unit{example}. A number without one is in SI units.", soft_wrap=True)

    return Result({"protocol": experiment.name, "keys": [asdict(key) for key in listed], "allowed": allowed}, show)


def plan_dict(p: Plan) -> dict[str, Any]:
    """A plan as JSON has it, printed and in the recording."""
    steps = [{"label": s.label, "seconds": round(s.seconds, 2)} for s in p.steps]
    return {"protocol": p.protocol, "seconds": p.seconds, "states": p.states, "limits": p.limits, "steps": steps}


@dataclass(frozen=True)
class Outcome:
    """How a run ended."""

    file: Path
    outcome: str
    """"completed", "stopped" or "failed"."""
    table: Table
    lost: dict[str, int]
    safe: bool
    error: Exception | None = None
    asked: bool = False
    """A person asked to end, even if the run was over by then."""
    displaced: tuple[str, ...] = ()
    """What happened to the recording or its journal during the run; `file` is the recording's present path."""


def run(
    protocol: str | None,
    rig_path: Path,
    settings: list[str],
    folder: Path | None,
    resume: Path | None,
    watched: bool = False,
    labels: Mapping[str, str] = MappingProxyType({}),
    prepared: bool = False,
) -> Result:
    """Run a protocol, or go on with the broken run `resume`; `labels`: text by name, `watched`: on a page in the browser,
    `prepared`: the person at the console is not asked.

    Code 0: completed; 1: cut short or not safe; 3: done, but samples were lost or states are doubtful. Raises ConfigError."""
    broken = find(resume) if resume is not None else None
    if broken is None and protocol is None:
        raise ConfigError("give a protocol, or a run with --resume")
    given = protocol is not None and protocol.endswith(".py")
    if broken is not None and ((protocol is not None and not given) or settings or folder is not None):
        raise ConfigError("--resume uses the protocol, settings and folder of the run: do not give them again")
    if broken is None:
        j = job(protocol or "", rig_path, settings)
    else:
        j = job_again(broken, rig_path, protocol_from_file(Path(str(protocol))) if given else broken.recorded_protocol())
    j = replace(j, labels={**(broken.labels if broken is not None else {}), **labels})
    folder = broken.journal.parent if broken is not None else folder or Path(".")
    folder.mkdir(parents=True, exist_ok=True)
    with Rig(j.rig, prepared=prepared) as rig:
        connect(rig, j.experiment.needs)
        note_unverified(rig_path, j.rig)
        screen = Screen(j.experiment.name, j.rig.clock.speed)
        with page_where(watched, screen.say) as page:
            result = execute(rig, j, folder, screen, broken, page)
    again = None if result.outcome == "completed" else typed("lab", "run", "--resume", result.file, "--rig", rig_path)
    warn(rig.notices)
    poses: dict[str, Any] = {}
    with contextlib.suppress(RecordingError):  # one that cannot be read has no poses
        if "joint1" in result.table.columns:
            from ..files.poses import write_poses  # slow to import

            poses = write_poses(Recording.open(result.file), result.table, result.file.with_suffix(".poses.csv"))
    data = {"file": str(result.file), "outcome": result.outcome, "rows": len(result.table), "lost": result.lost,
            "safe": result.safe, "resume": again, **poses}  # fmt: skip
    if isinstance(result.error, NotReached) and j.rig.clock.speed > 1:
        note([
            f"the clock of this rig runs at {j.rig.clock.speed:g} times real speed; a computer that cannot keep up reads too "
            f"few samples: start the fakes with a smaller --speed, such as {max(1.0, j.rig.clock.speed // 4):g}"
        ])  # fmt: skip
    cut_short = result.error is not None and (result.asked or not result.displaced)
    lossy = result.lost or result.displaced or result.table.doubtful.any()
    code = 1 if cut_short or not result.safe else 3 if lossy else 0
    error = None if isinstance(result.error, Stopped) else result.error
    return Result(data, lambda: _show_outcome(j, result, poses), code, error, safe=result.safe, again=again)


def _show_outcome(j: Job, result: Outcome, poses: Mapping[str, Any]) -> None:
    streams_only = result.outcome == "completed" and not len(result.table)
    out.print(f"{result.outcome}: {'streams' if streams_only else counted(len(result.table), 'state')} in {result.file}")
    if poses:
        then = typed("lab", "diagnose", poses["poses"], "--robot", "arm.yaml")
        out.print(f"poses: {poses['poses']}; go on with: {then}", soft_wrap=True)
        place, error = ", ".join(f"{x:.4f}" for x in poses["tool"]), poses["position_sd"]
        out.print(f"body on the flange: [{place}] m from the TCP, see tool in arm.yaml", soft_wrap=True)
        out.print(f"error of the arm: {error * 1e3:.2f} mm along each axis, see stand.position_sd in rig.yaml", soft_wrap=True)
    for topic, n in result.lost.items():
        out.print(f"  lost on {topic}: {n} samples")
    note([*marked_notes(result.table), *beyond_plan(len(result.table), j.plan.states)])


def note_unverified(rig_path: Path, rig: RigFile) -> None:
    """Print that the movement check of a rig is missing; fakes, which alone run at another speed, need none."""
    if isinstance(why := last(rig_path, rig), str) and (rig.clock.speed == 1 or place(rig_path).exists()):
        check = typed("lab", "check", "--move", "--rig", rig_path)
        text = f"The units, ranges and hoses of this rig are unverified: {why}. To verify them (fakes do not need it): {check}"
        out.print(text, soft_wrap=True)


def job_again(broken: Broken, rig_path: Path, of_file: Experiment | None = None, rig: RigFile | None = None) -> Job:
    """Return the job of an interrupted run on the present rig. Raises ConfigError if the robot differs.

    `of_file`: the protocol of a Python file, where it came from one; `rig`: rig.yaml, when it was read already."""
    j = job(parse_yaml(broken.protocol, f"{broken.journal}: protocol.yaml"), rig_path, of_file=of_file, rig=rig)
    if not same_body(j.rig.texts["robot.yaml"], broken.robot):
        raise ConfigError(f"{j.rig.robot}: differs from the robot.yaml of the run to resume; start a new run instead")
    return j


def connect(rig: Rig, needs: Sequence[str] | None, quiet: bool = False) -> None:
    """Open the instruments of an experiment with these needs, or all. Raises the first InstrumentError after trying all."""
    quiet = quiet or out.quiet
    failures = rig.open_all(str if quiet else out.print, None if needs is None else rig.needed(needs))
    if failures:
        first, *others = failures.values()
        for failure in () if quiet else others:
            err.print(str(failure))
        raise first


def recording_of(folder: Path, protocol: str, started_ns: int) -> Path:
    """A new file in `folder` for the recording that begins at `started_ns` (Unix time, ns); names sort as the runs began."""
    file = folder / f"{protocol}-{time.strftime('%Y%m%d-%H%M%S', time.localtime(started_ns / 1e9))}.mcap"
    return file.with_stem(f"{file.stem}_{started_ns % 1_000_000_000 // 1_000_000:03d}") if file.exists() else file


def execute(
    rig: Rig,
    j: Job,
    folder: Path,
    screen: Screen,
    broken: Broken | None = None,
    page: Page | None = None,
    steering: Steering | None = None,
) -> Outcome:
    """Run the experiment (or the remainder of a broken one) on an opened rig: record it, and land the rig whatever happens.

    `page`: where it is seen. `steering`: by which a program asks something of the run, as keys at a terminal do. An error of the
    experiment is in the outcome, not raised, but for `NotPrepared`, which leaves no file behind."""
    steering = Steering() if steering is None else steering
    file = recording_of(folder, j.experiment.name, time.time_ns())
    finished = broken.finished if broken is not None else 0
    journal = Journal.begin(file, j.experiment.name) if broken is None else Journal.reopen(broken.journal)
    if broken is not None:
        journal.recording(file, finished + 1)
    checked = last(j.rig_path, j.rig)
    recorder = rig.recorder(
        file,
        attachments={**j.rig.texts, "protocol.yaml": j.protocol_yaml.encode(), PLAN: json.dumps(plan_dict(j.plan)).encode()}
        | ({"protocol.py": j.experiment.code} if j.experiment.source is not None else {}),
        metadata=provenance(rig.identities)
        | campaign(journal.campaign, journal.path.name, finished + 1)
        | {"check": {"moved": "no", "why": checked} if isinstance(checked, str) else checked}
        | ({RECORD: dict(j.labels)} if j.labels else {}),
        journal=journal,
        rescue=[j.rig_path.absolute().parent],
    )
    lost_before = rig.lost()
    error: Exception | None = None
    outcome = "completed"
    announce(j.rig_path, file)
    if page is not None:
        page.show(file, steering.ask)

    def record_request(kind: str, by: str, text: str, done: bool, trial: int, step: int) -> None:
        with contextlib.suppress(RecordingError):  # a file that fails ends the run by itself
            recorder.request(Request(rig.clock.now(), kind, by, text, done, trial, step))

    with (
        journal,
        screen,
        Interrupts(screen.say, rig.actuators.pulse) as interrupts,
        steering.of_run(record_request, interrupts.finish, screen.say),
        _keys(steering, screen) as ask_at_terminal,
    ):
        rig.stop_now = lambda: interrupts.now
        displaced: list[str] = []  # texts on what happened to the recording's file, as said up to here

        def stopping() -> bool:
            displaced.extend(new := recorder.displaced[len(displaced) :])
            for text in new:
                screen.say(text)
            return bool(displaced) or interrupts.stopping()

        bench = rig.bench(recorder, screen, stopping, j.experiment.needs, steering, ask_at_terminal)
        trials = Trials(bench, j.plan, journal, finished)
        rig.record_to(recorder)
        if page is not None:
            screen.watched(page.address)
        try:
            j.experiment.run(bench, j.parameters, trials)
        except Stopped as e:
            error, outcome = e, "stopped"
            if displaced and not interrupts.stopping():
                error = Stopped(f"stopped after this state: {'; '.join(displaced)}")
        except KeyboardInterrupt:
            error, outcome = Stopped("stopped immediately by the operator"), "stopped"
        except Exception as e:  # noqa: BLE001 - the rig must be left safe and the file finished before anything is raised
            code = file_of(j.experiment)  # in which an error of Python is a mistake
            mistake = type(e).__module__ == "builtins" and not isinstance(e, OSError)
            error, outcome = BadProtocol(told_at(e, code)) if mistake and code is not None else e, "failed"
        if interrupts.now:
            error, outcome = Stopped("stopped immediately by the operator"), "stopped"
        safe = _make_safe(rig, screen, outcome == "completed")
        rig.record_to(None)
        for topic, now in rig.lost().items():
            recorder.note_lost(topic, newly_lost(before := lost_before.get(topic, 0), now))
            if now < before:
                with contextlib.suppress(RecordingError):  # `close` tells the same
                    recorder.log("warning", f"{topic}: the stream was reopened; losses are counted from that time on")
        lost = _finish(recorder, outcome, str(error or ""), safe)
    if isinstance(error, NotPrepared):
        for empty in (recorder.path, *([journal.path] if broken is None else [])):
            empty.unlink(missing_ok=True)
        raise error
    rig.notices.extend(recorder.displaced)
    if recorder.path != file:
        announce(j.rig_path, recorder.path)
    table = Table.stacked([*([] if broken is None else [broken.table]), Table.of(trials.rows)])
    return Outcome(recorder.path, outcome, table, lost, safe, error, interrupts.stopping(), recorder.displaced)


@contextlib.contextmanager
def _keys(steering: Steering, screen: Screen) -> Iterator[Callable[[], contextlib.AbstractContextManager[object]]]:
    """Keys at a terminal ask something of the run; yields what lends the terminal to somebody who asks a question there."""
    if screen.quiet or not sys.stdin.isatty():
        yield contextlib.nullcontext
        return
    screen.say(HELP)
    with Keys(sys.stdin.fileno(), Line(steering, screen.say, screen.typed)) as keys:
        yield keys.lent


def _finish(recorder: Recorder, outcome: str, detail: str, safe: bool) -> dict[str, int]:
    """Close the recording and return the lost samples by topic. The writer itself reports a file that cannot be finished."""
    text = f"{'safe state confirmed' if safe else 'safe state NOT confirmed'}; {outcome} {detail}".strip()
    with contextlib.suppress(RecordingError):  # `close` tells the same, and must be reached
        recorder.log("info" if safe else "error", text)
    try:
        counts = recorder.close(outcome, detail, safe)
    except RecordingError as e:
        err.print(str(e))
        counts = recorder.counts()
    return {topic: c.lost + c.dropped for topic, c in counts.items() if c.lost + c.dropped}


def _make_safe(rig: Rig, screen: Screen, as_planned: bool) -> bool:
    """Land the rig; report what was confirmed if something went wrong."""
    try:
        report = rig.make_safe()
    except Exception as e:  # noqa: BLE001
        screen.say(f"safe state: {e}")
        return False
    if not (as_planned and report.confirmed):
        landed = rig.vital.landed.report if rig.vital.landed is not None else None  # the guard was first
        screen.say((landed if landed is not None and report.confirmed else report).said)
    return report.confirmed


def _plan_verb(a: argparse.Namespace) -> Result:
    if a.keys:
        return keys(a.protocol, a.rig)
    if a.rig is None:
        raise ConfigError("--rig: give the rig.yaml of the rig, or --keys to list the protocol's parameters")
    return plan(a.protocol, a.rig, a.set, a.all, a.rehearse)


PROTOCOL = "stiffness, bending, elongation, cycles, arm_accuracy, one of a package, or a file (.yaml, .py)"
SET = repeatable("--set", "KEY=VALUE", "change one parameter; `lab plan PROTOCOL --keys` lists them")

VERBS = (
    Verb(
        "plan",
        _plan_verb,
        options=(
            JSON,
            option("protocol", help=PROTOCOL),
            rig(required=False),
            option("--keys", action="store_true", help="list the keys of --set: unit, default, limits"),
            option("--all", action="store_true", help="list the steps of every repeat"),
            option("--rehearse", action="store_true", help="also execute its `run`, with instruments that move nothing"),
            SET,
        ),
        examples=("lab plan bending --rig rig/rig.yaml", "lab plan bending --keys"),
        page="docs/tutorials/first-day.md",
    ),
    Verb(
        "run",
        lambda a: run(a.protocol, a.rig, a.set, a.out, a.resume, a.watch, given_labels(a), a.yes),
        options=(
            JSON,
            option("protocol", nargs="?", help=PROTOCOL),
            rig(),
            SET,
            path_option("--out", "FOLDER", "folder for the recording (default: this one)"),
            path_option("--resume", "RUN", "continue an interrupted run (.mcap)"),
            option("--watch", action="store_true", help="show the run on a page in the browser"),
            YES,
            *LABELS,
        ),
        examples=(
            "lab run bending --rig rig/rig.yaml --set repeats=3 --out runs",
            "lab run --resume runs/bending-20260102-101500.mcap --rig rig/rig.yaml",
        ),
        page="docs/tutorials/first-day.md",
    ),
)
