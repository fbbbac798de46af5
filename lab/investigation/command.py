"""`lab investigate`: the rig as the place where its experiments are done, by the protocols of `lab run` under the same guard;
what a person reads while it goes on; and the page: how certain it became, what was done, how each prediction came out."""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import yaml

from diagnosis.answer.headline import hypothesis_name
from diagnosis.answer.result import Proposal
from diagnosis.diagnose import Options
from diagnosis.inference.executor import Executor
from diagnosis.inference.posterior import UNKNOWN
from diagnosis.investigate import Investigation, NotDone, Predicted, Round, Tested, investigate
from drivers.errors import InstrumentError
from protocols.errors import ProtocolError, Stopped
from recordings.errors import RecordingError
from recordings.own_files import replaced

from ..console import Screen, note, out, warn
from ..files.config import ConfigError, Source, in_si
from ..files.inputs import Case, read_case, same_robot
from ..files.own_effects import catalogue
from ..files.rig_file import RigFile, load_rig
from ..live.beside import Page, page_where
from ..options import (
    LABELS,
    OWN_EFFECTS,
    READS,
    ROBOT,
    WORKERS,
    YES,
    Result,
    Verb,
    given_labels,
    inputs,
    option,
    path_option,
    repeatable,
    rig,
)
from ..pages import diagnosis_report
from ..pages.figures import GREY, colours, drawing
from ..pages.report import PageSection, Report
from ..plain import typed
from ..processes import for_case
from ..rig.assembly import Rig
from ..rig.operator import RememberingOperator
from ..verbs.run import Job, Outcome, connect, execute, job


def write_page(story: Investigation, path: Path, source: str, answer: str) -> Path:
    """Write one offline page; `answer` is the name of the page of the last diagnosis beside it."""
    report = Report("An investigation", source, _lead(story), ids=story.answer.names.keys())
    with tempfile.TemporaryDirectory() as place:
        section = report.section("How certain it became")
        if len(story.rounds) > 1:
            section.figure(
                _drawn(story, Path(place) / "rounds.svg"),
                "Probability of each hypothesis after each diagnosis, over the minutes spent on experiments",
            )
        section.table(("after", "minutes", "most probable", "p", "bits gained"), _rounds(story))
        for number, r in enumerate(story.rounds, 1):
            if r.predicted is not None:
                _experiment(report.section(f"Experiment {number}: {r.predicted.proposal.do}"), r)
        if story.rounds[-1].refused:
            section = report.section("Experiments not done")
            section.table(("experiment", "why"), [[id, why] for id, why in story.rounds[-1].refused.items()])
        report.section("The answer in full").text(
            f"{story.answer.statement} The full answer with figures is {answer} in the same folder."
        )
        return report.write(path)


def _lead(story: Investigation) -> str:
    """The page's first sentences: how many experiments, the most probable cause before and after, and why it ended."""
    experiments = sum(r.predicted is not None for r in story.rounds)
    number = {0: "no experiment", 1: "one experiment"}.get(experiments, f"{experiments} experiments")
    before, after = story.rounds[0].diagnosis.attribute, story.answer.attribute
    leading_before = _plain(before.ranking[0].effects, story) if before.ranking else "nothing"
    begin = f"After {number} and {story.rounds[-1].minutes:g} min"
    if after.verdict == "unknown":
        head = f"{begin} the cause is outside the catalogue with probability {after.probability:.2f}."
    else:
        head = f"{begin}: {_plain(after.effects, story)} with probability {after.probability:.2f}"
        outside = next((r.probability for r in after.ranking if r.effects == UNKNOWN), 0.0)
        head += f"; outside the catalogue with {outside:.2f}." if outside > after.probability else "."
    first = f" Before: {leading_before}, {before.ranking[0].probability:.2f}." if experiments and before.ranking else ""
    reason = "the answer is settled" if story.ended == "settled" else story.ended
    return f"{head}{first} The investigation ended because {reason}."


def _plain(effects: Sequence[str], story: Investigation) -> str:
    return hypothesis_name(effects, story.answer.names, ids=False)


def _rounds(story: Investigation) -> list[list[str]]:
    out, after, gained = [], "the campaign", ""
    for r in story.rounds:
        first = r.diagnosis.attribute.ranking[0]
        named = hypothesis_name(first.effects, story.answer.names)
        out.append([after, f"{r.minutes:g}", named, f"{first.probability:.2f}", gained])
        if r.predicted is not None:
            after, gained = r.predicted.proposal.do, f"{r.bits:.2f}"
    return out


def _experiment(section: PageSection, r: Round) -> None:
    """Write the expected and the gained information of an experiment, and how well each hypothesis predicted its readings."""
    assert r.predicted is not None
    p = r.predicted.proposal
    section.text(
        f"It was expected to gain {p.expected_bits:.2f} bits and gained {r.bits:.2f}, in about {p.cost_min:g} min. "
        "The predictions were saved before it ran."
    )
    if not r.judged:
        return
    if r.unforeseen:
        section.text(
            "No candidate predicted these readings: a cause that none of them includes is at work, or the robot has changed."
        )
    section.table(("hypothesis", "probability before", "error, mm rms", "p-value of the error", "bits against the best"),
                  [_judged(j, r) for j in r.judged])  # fmt: skip


def _judged(j: Tested, r: Round) -> list[str]:
    before = next((x.probability for x in r.diagnosis.attribute.ranking if x.effects == j.effects), 0.0)
    chance = f"{j.p_value:.2g}{' (failed)' if j.failed else ''}"
    return [hypothesis_name(j.effects, r.diagnosis.names), f"{before:.2f}", f"{j.rms_mm:.2f}", chance, f"{j.bits:z.1f}"]


def _drawn(story: Investigation, path: Path) -> Path:
    """Draw the probability of the six most probable hypotheses over the minutes, with the experiments in between."""
    probability = [{x.effects: x.probability for x in r.diagnosis.attribute.ranking} for r in story.rounds]
    highest = {h: max(p.get(h, 0.0) for p in probability) for h in {h for p in probability for h in p}}
    shown = sorted((h for h in highest if highest[h] > 0.01), key=lambda h: -highest[h])[:6]
    minutes = [r.minutes for r in story.rounds]
    with drawing(path, (5.2, 3.4 + 0.2 * len(shown))) as (_, axis):
        for h, colour, mark in zip(shown, colours(len(shown)), "os^Dv*", strict=False):
            axis.plot(minutes, [p.get(h, 0.0) for p in probability], marker=mark, color=colour, label=_plain(h, story))
        for r, minutes_after in zip(story.rounds, minutes[1:], strict=False):
            if r.predicted is not None:
                middle = (r.minutes + minutes_after) / 2
                axis.annotate(r.predicted.proposal.id, (middle, 1.03), ha="center", fontsize=8, annotation_clip=False)
                axis.axvspan(r.minutes, minutes_after, color=GREY, alpha=0.12, lw=0)
        axis.axhline(0.95, color="0.4", lw=0.8, ls="--")
        axis.set(ylim=(0, 1), yticks=np.linspace(0, 1, 6), xlabel="minutes of experiments", ylabel="probability")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=8)
    return path


PREDICTED, PROTOCOL = "predicted.json", "protocol.yaml"
MARKERS = "markers"
"""Id of the experiment that takes more than instruments: markers on the body."""


class RigLaboratory:
    """Does experiments on a rig, as the options of the verb say, and keeps everything in a folder, one below it for each."""

    def __init__(self, wanted: argparse.Namespace, rig: RigFile, report: Callable[[Predicted], None]) -> None:
        self._wanted, self._rig, self._report, self._labels = wanted, rig, report, given_labels(wanted)
        self.inputs: list[Path] = list(wanted.inputs)
        """The campaign so far: the given files and the recordings made since."""
        self._prepared = RememberingOperator()
        self._jobs: dict[str, Job | str] = {}
        self.begun = ""
        """Id of the experiment that was begun last."""
        self.lost = 0
        """Samples."""
        self.safe = True
        self.page: Page | None = None

    def refusal(self, proposal: Proposal) -> str:
        """See Laboratory."""
        if proposal.id in self._wanted.without:
            return "left out by --without"
        if proposal.hands_min and (self._wanted.no_hands or self._wanted.yes):
            return f"needs {proposal.hands_min:g} min of work by hand"
        if proposal.id not in self._jobs:
            self._jobs[proposal.id] = self._job(proposal)
        found = self._jobs[proposal.id]
        return found if isinstance(found, str) else ""

    def _job(self, proposal: Proposal) -> Job | str:
        """The job to run, or why it cannot run."""
        try:
            found = job(Source(proposal.id, dict(proposal.protocol), {}), self._wanted.rig, self._wanted.set, rig=self._rig)
        except (ConfigError, ProtocolError) as e:
            return str(e).splitlines()[0]
        if proposal.id == MARKERS and not getattr(found.rig.instruments.mocap, "markers", None):
            return "needs markers on the body, named in rig.yaml under instruments.mocap.markers"
        return replace(found, labels={"investigation": self._wanted.out.name, **self._labels})

    def perform(self, predicted: Predicted) -> Case:
        """See Laboratory. Raises what ended the run, `Stopped` when a person did."""
        proposal = predicted.proposal
        j = self._jobs[proposal.id]
        if isinstance(j, str):
            raise NotDone(j)
        place = self._place(proposal.id)
        place.mkdir(parents=True)
        replaced(place / PROTOCOL, yaml.safe_dump(dict(proposal.protocol), sort_keys=False))
        replaced(place / PREDICTED, json.dumps(asdict(predicted), indent=1) + "\n")
        self._report(predicted)
        self.begun = proposal.id
        result = self._run(j, place)
        self.lost += sum(result.lost.values())
        self.safe = result.safe
        if len(result.table):
            self.inputs.append(result.file)
        if result.error is not None:
            raise result.error
        if not result.safe:
            raise Stopped("the safe state is not confirmed; nothing more is done")
        return read_case(self.inputs, self._wanted.robot)

    def _run(self, j: Job, place: Path) -> Outcome:
        with Rig(j.rig, prepared=self._wanted.yes) as rig:
            rig.operator = self._prepared.over(rig.operator)
            connect(rig, j.experiment.needs, quiet=True)
            screen = Screen(j.experiment.name, j.rig.clock.speed)
            if self.page is not None:
                self.page.part(f"Investigation {self._wanted.out.name}. Experiment {place.name}", more=True)
            result = execute(rig, j, place, screen, page=self.page)
            warn(rig.notices)
        return result

    def _place(self, id: str) -> Path:
        """A folder for the next experiment: those there are numbered."""
        there = [int(p.name[:2]) for p in self._wanted.out.glob("[0-9][0-9]-*") if p.is_dir()]
        return self._wanted.out / f"{max(there, default=0) + 1:02d}-{id}"


STORY, ANSWER, PAGE, ANSWER_PAGE = "investigation.json", "diagnosis.json", "investigation.html", "diagnosis.html"


def run(w: argparse.Namespace) -> Result:
    """Investigate; code 0: done, 3: samples lost, 1: failed or stopped. Raises ConfigError, RecordingError, InstrumentError."""
    minutes = in_si("--budget", w.budget, "s") / 60
    case = read_case(w.inputs, w.robot)
    rig = load_rig(w.rig)
    site = RigLaboratory(w, rig, _predicted)
    if not same_robot(rig.body, case.robot):
        raise ConfigError(f"{w.rig}: its robot.yaml describes another body than the campaign's; give the rig of this robot")
    if (w.out / STORY).exists():
        raise ConfigError(f"{w.out}: already holds an investigation; give another folder with --out")
    w.out.mkdir(parents=True, exist_ok=True)
    weighed, left_out = catalogue(case.robot, w.effects)
    note(f"not considered: {why}" for why in left_out)
    rounds: list[Round] = []
    weighing = Screen("weighing hypotheses")  # shown but for the runs, which have their own
    say = Screen("").say

    def diagnosed(r: Round) -> None:
        weighing.stop()
        rounds.append(r)
        leading = ", ".join(f"{' + '.join(x.effects) or 'none'} {x.probability:.2f}" for x in r.diagnosis.attribute.ranking[:4])
        out.print(f"After {r.minutes:g} min of experiments: {leading}", soft_wrap=True)

    ended: BaseException | None = None
    investigation: Investigation | None = None
    try:
        with for_case(w.workers) as processes_for, page_where(w.watch, say) as site.page:
            if site.page is not None:
                say(f"watch it at {site.page.address}")
            fits = Executor(progress=weighing.step, remote_map=processes_for(len(case.table)))
            investigation = investigate(case, site, Options(catalogue=weighed, executor=fits), minutes, w.experiments, diagnosed)
    except (ProtocolError, InstrumentError, RecordingError, KeyboardInterrupt) as e:
        ended = e
    finally:
        weighing.stop()
    if investigation is None:
        if not rounds:
            raise ended or Stopped("stopped by the operator")
        investigation = Investigation(tuple(rounds), f"stopped early: {ended or 'by the operator'}")
    replaced(w.out / STORY, json.dumps(investigation.to_dict(), indent=1) + "\n")
    replaced(w.out / ANSWER, investigation.answer.to_json() + "\n")
    diagnosis_report.write(investigation.answer, read_case(site.inputs, w.robot), site.inputs, w.out / ANSWER_PAGE)
    write_page(investigation, w.out / PAGE, str(w.out), ANSWER_PAGE)
    stopped = isinstance(ended, (Stopped, KeyboardInterrupt))
    unreadable = site.begun if isinstance(ended, (ProtocolError, RecordingError)) and not stopped else ""
    story = investigation

    def show() -> None:
        out.print(story.answer.statement)
        out.print(f"{story.ended}; full report: {w.out / PAGE}", soft_wrap=True)

    data = {**investigation.to_dict(), "folder": str(w.out), "inputs": [str(p) for p in site.inputs], "lost": site.lost}
    code = 1 if ended is not None or not site.safe else 3 if site.lost else 0
    again = None if ended is None else _again(w, site.inputs, unreadable)
    return Result(data, show, code, None if stopped else ended, safe=site.safe, again=again)


def _again(w: argparse.Namespace, inputs: Sequence[Path], unreadable: str = "") -> str:
    """The command that continues with the data measured so far; `unreadable`: an experiment to leave out from now on."""
    several = (
        ("--without", (*w.without, unreadable)),
        ("--set", w.set),
        ("--robot", (w.robot,)),
        ("--effects", (w.effects,)),
    )
    words = [word for name, values in several for value in values if value for word in (name, value)]
    hands = ("--no-hands",) if w.no_hands else ()
    return typed("lab", "investigate", *inputs, "--rig", w.rig, "--out", f"{w.out}-2", *hands, *words)


def _predicted(f: Predicted) -> None:
    p = f.proposal
    hands = f", {p.hands_min:g} of them by hand" if p.hands_min else ""
    out.print(f"Next: {p.do}; {p.expected_bits:.2f} bits expected, about {p.cost_min:g} min{hands}", soft_wrap=True)
    state = f.telling
    if state is None:
        return
    for rival in f.rivals:
        x, y, z = rival.tip_mm[state]
        out.print(
            f"  state {state + 1}, by {' + '.join(rival.effects) or 'none'}: ({x:.1f}, {y:.1f}, {z:.1f}) mm", soft_wrap=True
        )


VERBS = (
    Verb(
        "investigate",
        run,
        options=(
            *READS,
            inputs("recordings (.mcap) or a case folder of the robot on the rig"),
            rig(),
            option("--budget", default="60min", metavar="60min", help="time for experiments (default 60min)"),
            option("--experiments", type=int, default=3, metavar="N", help="at most this many (default 3)"),
            repeatable("--without", "ID", "leave out an experiment (repeatable)"),
            repeatable("--set", "KEY=VALUE", "change a parameter of every experiment (repeatable)"),
            option("--no-hands", action="store_true", help="only experiments that need no work by hand"),
            YES,
            path_option("--out", "FOLDER", "folder for recordings, answer and page", default=Path("investigation")),
            ROBOT,
            WORKERS,
            option("--watch", action="store_true", help="show the experiments on a page in the browser"),
            *LABELS,
            OWN_EFFECTS,
        ),
        examples=(
            "lab investigate runs/sweep.mcap --rig rig/rig.yaml --budget 30min",
            "lab investigate case --rig rig/rig.yaml --no-hands",
        ),
        page="docs/howto/investigate.md",
    ),
)
