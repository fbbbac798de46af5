"""`lab diagnose`: locate the gap, name its cause, state how far it shrinks, propose the next experiment."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from rich.table import Table as Sheet

from diagnosis.answer.experiments import columns, to_apply
from diagnosis.answer.headline import sized, stated
from diagnosis.answer.result import Diagnosis, Proposal, Ranked
from diagnosis.answer.sentences import stands_for
from diagnosis.compare_campaigns import compare_campaigns
from diagnosis.diagnose import Options
from diagnosis.diagnose import diagnose as diagnosed
from diagnosis.errors import FAR_OFF, BadHoldout
from diagnosis.findings import finding
from diagnosis.inference.executor import Executor
from diagnosis.inference.on_baseline import Baseline
from diagnosis.judgement import LEAST_STATED, OVERHEAD_MIN
from model.actuators import Words
from model.effects.spec import EffectSpec
from model.robot import Robot
from recordings.errors import RecordingError
from recordings.own_files import replaced
from recordings.table_file import csv_text

from ..console import Screen, note, out, titled
from ..files.baseline import from_simulator, from_table, simulator
from ..files.config import ConfigError, demand_writable, in_units, read_yaml
from ..files.inputs import Case, marked_notes, read_case, unconfirmed_guesses
from ..files.output_folder import demand_free, whole
from ..files.own_effects import catalogue
from ..next_step import FIRST, command, nothing_next
from ..options import OF_CASE, OWN_EFFECTS, REPLACE, SCHEDULER, WORKERS, Result, Verb, option, path_option
from ..processes import cluster, for_case


def diagnose(inputs: Sequence[Path], robot: Path | None, wanted: argparse.Namespace) -> Result:
    """Diagnose recordings or a case, as the options `wanted` of the verb say. Raises ConfigError, BadEffect, RecordingError."""
    demand_writable(wanted.json, wanted.report)
    demand_free(wanted.protocols, replace=wanted.replace, inputs=inputs)
    with ExitStack() as open_while_diagnosed:
        pool_for = open_while_diagnosed.enter_context(for_case(wanted.workers if wanted.scheduler is None else 1))
        case = read_case(inputs, robot)
        if wanted.baseline is not None or wanted.simulator is not None:
            case = _of_robot(case)
        note(marked_notes(case.table))
        there = None if wanted.scheduler is None else open_while_diagnosed.enter_context(cluster(wanted.scheduler)).in_order
        answer = _answer(case, robot, wanted, Executor(remote_map=there or pool_for(len(case.table))))
    answer = replace(answer, findings=(*unconfirmed_guesses(inputs), *answer.findings))
    if wanted.json is not None:
        wanted.json.write_text(answer.to_json() + "\n", encoding="utf-8")
    written = []
    if wanted.protocols is not None:
        with whole(wanted.protocols, replace=wanted.replace, inputs=inputs) as (place, word):
            paths = write_protocols(answer.next_experiment, place, case.robot)
        written = [wanted.protocols / path.name for path in paths]
    show(answer, wanted.protocols)
    if written:
        out.print(f"{word}: {', '.join(map(str, written))}", soft_wrap=True)
    if wanted.report is not None:
        from ..pages.diagnosis_report import write  # what draws takes a third of the start, and only a page needs it

        write(answer, case, inputs, wanted.report.resolve(), wanted.protocols)
        out.print(f"report: {wanted.report}")
    return Result()


def _answer(case: Case, robot: Path | None, wanted: argparse.Namespace, executor: Executor) -> Diagnosis:
    """Diagnose a case and, if an earlier campaign is given, what has changed since. Raises ConfigError."""
    weighed, left_out = catalogue(case.robot, wanted.effects)
    held = _held_out(wanted.holdout, robot) if wanted.holdout is not None else None
    baseline = _baseline(case, wanted, weighed)
    try:
        with Screen("weighing hypotheses") as screen:
            shown = replace(executor, progress=screen.step)
            answer = diagnosed(case, Options(catalogue=weighed, holdout=held, baseline=baseline, executor=shown))
        answer = replace(answer, findings=(*answer.findings, *(finding("not_considered", why=why) for why in left_out)))
        if wanted.reference is None:
            return answer
        earlier = read_case([wanted.reference], robot)
        with Screen("comparing") as screen:
            change = compare_campaigns(case, earlier, weighed, replace(executor, progress=screen.step))
            return replace(answer, change=change)
    except BadHoldout as e:
        raise ConfigError(f"--holdout {wanted.holdout}: {e}") from e
    except np.linalg.LinAlgError as e:
        raise ConfigError(f"the fit has no unique solution ({str(e).lower()}): {FAR_OFF}") from e


def _of_robot(case: Case) -> Case:
    """Return a case without stiffness trials, which a simulator cannot predict."""
    table = case.table.take(~case.table.pushed)
    if not len(table):
        raise ConfigError("all rows are stiffness trials, which only the rod can predict: leave --baseline and --simulator out")
    if len(table) < len(case.table):
        note([f"{len(case.table) - len(table)} rows of stiffness trials are left out: only the rod can predict them"])
    return replace(case, table=table)


def _baseline(case: Case, wanted: argparse.Namespace, weighed: Mapping[str, EffectSpec]) -> Baseline | None:
    """Predictions of a table or a simulator that replace the rod model's; None: the rod's own. Raises ConfigError."""
    given = [name for name in ("baseline", "simulator") if getattr(wanted, name) is not None]
    if not given:
        return None
    if len(given) > 1:
        raise ConfigError("--baseline and --simulator: give only one; each replaces the rod's predictions")
    for name in ("reference", "holdout"):
        if getattr(wanted, name) is not None:
            raise ConfigError(f"--{given[0]}: predicts the states of one campaign; leave --{name} out")
    if wanted.baseline is not None:
        predicted = from_table(wanted.baseline, case)
    else:
        name, forward = simulator(str(wanted.simulator), case.robot)
        with Screen(f"simulating with {name}") as screen:
            predicted = from_simulator(name, forward, case, weighed, screen.progress)
    lost = int((~np.isnan(case.table.get("x")) & ~np.isfinite(predicted.predicted.tip).all(axis=1)).sum())
    if lost:
        note([f"{predicted.name} predicts no tip for {lost} of {len(case.table)} states; they are left out"])
    return predicted


def _held_out(path: Path, robot: Path | None) -> Case:
    try:
        return read_case([path], robot)
    except (ConfigError, RecordingError, OSError) as e:
        raise ConfigError(f"--holdout {path}: {e}") from e


def write_protocols(proposals: Sequence[Proposal], folder: Path, robot: Robot) -> list[Path]:
    """Write the states of each proposed experiment as a table, and its protocol if a rig drives such robots."""
    from ..files.all_protocols import found_protocols  # brings all drivers' interfaces, which an answer does not need

    folder.mkdir(parents=True, exist_ok=True)
    protocols = found_protocols().usable
    written = []
    for p in proposals:
        written.append(_write_states(p, folder / f"{p.id}.csv", robot))
        if not robot.actuators.words.by_rig:
            continue
        path = folder / f"{p.id}.yaml"
        head = f"# {p.do}; expected information {p.expected_bits:.2f} bits, about {p.cost_min:.0f} min\n"
        experiment = protocols.get(p.protocol.get("protocol", ""))
        values = dict(p.protocol) if experiment is None else in_units(p.protocol, experiment.parameters)
        replaced(path, head + yaml.safe_dump(values, sort_keys=False))
        written.append(path)
    return written


def _write_states(p: Proposal, path: Path, robot: Robot) -> Path:
    """The states of a proposed experiment in their order, tensions in N."""
    words, count = robot.actuators.words, len(robot.actuators.azimuths_deg)
    table = columns(p.protocol, count, ())
    names = ["trial", "repeat", "protocol", "branch", "hold", "tip_mass", "roll_deg"]
    names += ["spine_length", "vacuum"] if robot.spine is not None else []
    shown = {name: table[name] for name in names}
    shown[f"rate [{words.unit}/s]"] = np.where(table["branch"] == "unload", -1, 1) * table["rate"] / words.pascal
    shown |= words.columns(np.column_stack([table[f"p{c}"] for c in range(1, count + 1)]))
    replaced(path, csv_text([shown, *zip(*(v.tolist() for v in shown.values()), strict=True)]))
    return path


def show(d: Diagnosis, protocols: Path | None = None) -> None:
    """Print an answer; `protocols`: the folder of the proposed experiments, if they were written."""
    for line in d.lines:
        out.print(line)
    out.print(ranked(d.attribute.ranking, d.words))
    if origins := stands_for(d.calibration, d.words):
        out.print(f"{origins}.")
    if not d.next_experiment:
        out.print(f"What to do next: {nothing_next(d)}")
        return
    first = d.next_experiment[0]
    out.print(_proposals(d))
    if first.separates:
        pairs = " and ".join(" from ".join(pair) for pair in first.separates[:3])
        out.print(f"{first.id} is expected to distinguish {pairs}.")
    where = f"{protocols}/{first.id}.csv" if protocols else "a file that --protocols FOLDER writes"
    by_hand = f"measure the states in {where}, import the table, and diagnose both cases together"
    run = command(first, protocols)
    later = f"To run the first, repeat this command with --protocols next, which writes its file; then {run}"
    by_rig = f"Run the first: {run}; without a rig, {by_hand}" if protocols else later
    out.print(by_rig if d.words.by_rig else f"M{by_hand[1:]}", soft_wrap=True)


def ranked(ranking: Sequence[Ranked], words: Words) -> Sheet:
    """The hypotheses as a table, most probable first."""
    title = "What the data support (p: by all fits; log evidence: of one fit; ±: standard deviation)"
    t = titled(title, ("hypothesis", "p", "log evidence", "unseen states", "size"))
    for r in (r for r in ranking if r.probability >= LEAST_STATED):
        named = [(*name.partition(".")[::2], sized(v, words)) for name, v in r.parameters.items()]
        own = {e: r.in_words.get(e, ())[:1] or [f"{name} {v}" for of, name, v in named if of == e] for e in r.effects}
        sizes = "; ".join(f"{e}: " * (len(r.effects) > 1) + ", ".join(texts) for e, texts in own.items() if texts)
        evidence = f"{r.log_evidence:.1f}".replace("nan", "")
        held = "" if r.heldout_rmse_mm is None else f"{r.heldout_rmse_mm:.2f} mm"
        t.add_row(" + ".join(r.effects) or "none", stated(r.probability, r.limited), evidence, held, sizes)
    return t


def _proposals(d: Diagnosis) -> Sheet:
    by_rig = d.words.by_rig
    columns = ("name", "experiment", *(() if by_rig else ("states to apply",)), "information", "takes")
    order = f"per minute first, {OVERHEAD_MIN:g} min added to each for setting up" if by_rig else "first"
    t = titled(f"Suggested experiments, most informative {order}", columns)
    for p in d.next_experiment[:FIRST]:
        states = () if by_rig else (to_apply(p.protocol, d.words),)
        t.add_row(p.id if by_rig else f"{p.id}.csv", p.do, *states, f"{p.expected_bits:.2f} bits", f"{p.cost_min:.0f} min")
    return t


def _diagnose_verb(a: argparse.Namespace) -> Result:
    robot = a.robot or next((place / "robot.yaml" for place in a.inputs if (place / "robot.yaml").is_file()), None)
    if robot is not None and "links" in (described := read_yaml(robot)).table:
        if foreign := [name for name in OF_SOFT_ROBOTS if getattr(a, name)]:
            raise ConfigError(f"--{foreign[0]}: is for soft robots, but {robot} describes an arm: leave it out")
        from .diagnose_arm import diagnose_arm  # with pandas

        return diagnose_arm(a.inputs, described, a.candidates, a.holdout, a.json, a.report)
    if a.candidates is not None:
        raise ConfigError(f"--candidates {a.candidates}: is for arms; give the arm's description with --robot")
    return diagnose(a.inputs, a.robot, a)


OF_SOFT_ROBOTS = ("protocols", "replace", "reference", "effects", "baseline", "simulator", "workers", "scheduler")
"""Options that do not apply to an arm."""
VERBS = (
    Verb(
        "diagnose",
        _diagnose_verb,
        options=(
            *OF_CASE,
            path_option("--json", "OUT", "write diagnosis.json here"),
            path_option("--report", "OUT.html", "write the page with all figures here"),
            path_option(
                "--protocols",
                "FOLDER",
                "write the proposed experiments as protocol files; to get them later you must run the whole diagnosis again",
            ),
            REPLACE,
            path_option("--reference", "CASE", "an earlier campaign: report what has changed since"),
            path_option("--holdout", "CASE", "a campaign (case folder or .mcap) to test the answer on"),
            path_option("--candidates", "POSES.csv", "for an arm: poses from which the next ones are chosen"),
            path_option("--baseline", "PREDICTED.csv", "predictions of another simulator: diagnose its gap"),
            option("--simulator", "NAME|FILE.py", "the same, but call the simulator itself"),
            WORKERS,
            SCHEDULER,
            OWN_EFFECTS,
        ),
        examples=(
            "lab diagnose runs/*.mcap --report diagnosis.html",
            "lab diagnose poses.csv --robot arm.yaml --json diagnosis.json",
        ),
        page="docs/explanations/diagnosis.md",
    ),
)
