"""The verb `lab investigate`: what a person reads while it goes on, and what is kept."""

from __future__ import annotations

import argparse
import json
import os
import shlex
from collections.abc import Sequence
from pathlib import Path

from diagnosis.answer.result import Diagnosis, Ranked
from diagnosis.diagnose import Options
from diagnosis.errors import DiagnosisError
from diagnosis.inference.executor import Executor
from diagnosis.investigate import Foretold, Investigation, Round, investigate
from drivers.errors import InstrumentError
from model.errors import ModelError
from protocols.errors import ProtocolError, Stopped
from recordings.errors import RecordingError
from recordings.own_files import replaced

from ..console import Screen, err, out
from ..files.config import ConfigError
from ..files.inputs import read_case, same_robot
from ..files.own_effects import catalogue
from ..files.rig_file import load_rig
from ..files.units import UnitError, to_si
from ..live.beside import page_where
from ..options import (
    ANY_SIZE,
    JSON,
    LABELS,
    OWN_EFFECTS,
    ROBOT,
    WORKERS,
    Result,
    Verb,
    given_labels,
    inputs,
    option,
    rig,
    settings,
)
from ..pages import diagnosis_report, investigation_page
from ..processes import for_case
from .laboratory import RigLaboratory, Wanted

STORY, ANSWER, PAGE, ANSWER_PAGE = "investigation.json", "diagnosis.json", "investigation.html", "diagnosis.html"


class _Weighing:
    """Progress of one diagnosis after the other; a run in between has its own."""

    _screen: Screen | None = None

    def step(self, name: str, share: float) -> None:
        """See Screen.step."""
        if self._screen is None:
            self._screen = Screen("weighing hypotheses").__enter__()
        self._screen.step(name, share)

    def stop(self) -> None:
        """None is going on."""
        screen, self._screen = self._screen, None
        if screen is not None:
            screen.__exit__(None, None, None)


def run(w: Wanted) -> Result:
    """Investigate; code 0 when it came to its end, 3 when samples were lost on the way, 1 when a run failed or was stopped.

    Raises ConfigError, RecordingError, InstrumentError.
    """
    case = read_case(w.inputs, w.robot)
    rig = load_rig(w.rig)
    if not same_robot(rig.body, case.robot):
        raise ConfigError(f"{w.rig}: its robot.yaml is of another body than the campaign's; give the rig of this robot")
    if (w.folder / STORY).exists():
        raise ConfigError(f"{w.folder}: holds an investigation already; give another folder with --out")
    w.folder.mkdir(parents=True, exist_ok=True)
    weighed, left_out = catalogue(case.robot, w.effects)
    for why in left_out:
        err.print(f"note: not considered: {why}")
    at = RigLaboratory(w, rig, _foretold)
    rounds: list[Round] = []
    weighing = _Weighing()
    say = Screen("").say

    def diagnosed(r: Round) -> None:
        weighing.stop()
        rounds.append(r)
        _show(r)

    ended: BaseException | None = None
    found: Investigation | None = None
    cores = w.workers if w.workers is not None else len(os.sched_getaffinity(0))
    try:
        with for_case(cores) as beside, page_where(w.watched, say) as at.page:
            if at.page is not None:
                say(f"watch it at {at.page.address}")
            there = beside(len(case.table))
            fits = Executor(progress=weighing.step, remote_map=None if there is None else there.in_order)
            found = investigate(case, at, Options(catalogue=weighed, executor=fits), w.minutes, w.experiments, diagnosed)
    except (DiagnosisError, ModelError) as e:
        raise ConfigError(str(e)) from e
    except (ProtocolError, InstrumentError, RecordingError, KeyboardInterrupt) as e:
        ended = e
    finally:
        weighing.stop()
    if found is None:
        if not rounds:
            raise ended or Stopped("stopped by the operator")
        found = Investigation(tuple(rounds), f"broken off: {ended or 'by the operator'}")
    _keep(w, found, at.inputs)
    stopped = isinstance(ended, (Stopped, KeyboardInterrupt))
    unreadable = at.begun if isinstance(ended, (ProtocolError, RecordingError)) and not stopped else ""
    story = found

    def show() -> None:
        out.print(story.answer.statement)
        out.print(f"{story.ended}; all of it: {w.folder / PAGE}", soft_wrap=True)
        if ended is not None:
            out.print(f"go on with: {_again(w, at.inputs, unreadable)}", soft_wrap=True)

    data = {**found.to_dict(), "folder": str(w.folder), "inputs": [str(p) for p in at.inputs], "lost": at.lost}
    return Result(data, show, 1 if ended is not None or not at.safe else 3 if at.lost else 0, None if stopped else ended)


def _again(w: Wanted, inputs: Sequence[Path], unreadable: str = "") -> str:
    """What to type to go on with what is measured by now; `unreadable`: an experiment that is left out from now on."""
    words = ["lab", "investigate", *map(str, inputs), "--rig", str(w.rig), "--out", f"{w.folder}-2"]
    for name, place in (("--robot", w.robot), ("--effects", w.effects)):
        words += [name, str(place)] if place is not None else []
    words += [] if w.hands else ["--no-hands"]
    for name, several in (("--without", (*w.without, *filter(None, (unreadable,)))), ("--set", w.settings)):
        words += [word for one in several for word in (name, one)]
    return shlex.join(words)


def _keep(w: Wanted, found: Investigation, inputs: Sequence[Path]) -> None:
    replaced(w.folder / STORY, json.dumps(found.to_dict(), indent=1) + "\n")
    replaced(w.folder / ANSWER, found.answer.to_json() + "\n")
    case = read_case(inputs, w.robot)
    diagnosis_report.write(found.answer, case, inputs, w.folder / ANSWER_PAGE)
    investigation_page.write(found, w.folder / PAGE, str(w.folder), ANSWER_PAGE)


def _named(effects: Sequence[str]) -> str:
    return " + ".join(effects) or "none"


def _leading(d: Diagnosis) -> list[Ranked]:
    return list(d.attribute.ranking[:4])


def _show(r: Round) -> None:
    leading = ", ".join(f"{_named(x.effects)} {x.probability:.2f}" for x in _leading(r.diagnosis))
    out.print(f"After {r.minutes:g} min of experiments: {leading}", soft_wrap=True)


def _foretold(f: Foretold) -> None:
    p = f.proposal
    hands = f", {p.hands_min:g} of them by hand" if p.hands_min else ""
    out.print(f"Next: {p.do}; {p.expected_bits:.2f} bits expected, about {p.cost_min:g} min{hands}", soft_wrap=True)
    state = f.telling
    if state is None:
        return
    for rival in f.rivals:
        x, y, z = rival.tip_mm[state]
        out.print(f"  state {state + 1}, by {_named(rival.effects)}: ({x:.1f}, {y:.1f}, {z:.1f}) mm", soft_wrap=True)


def _minutes(text: str) -> float:
    """A time with its unit, in minutes."""
    try:
        return to_si(text, "s") / 60
    except UnitError as e:
        raise argparse.ArgumentTypeError(str(e)) from e


def _investigate(a: argparse.Namespace) -> Result:
    menu = not a.no_hands, tuple(a.without), tuple(a.set)
    labels = tuple(given_labels(a))
    wanted = Wanted(tuple(a.inputs), a.rig, a.out, a.budget, a.experiments, a.robot, a.effects, *menu, labels, a.workers, a.watch)
    return run(wanted)


VERBS = (
    Verb(
        "investigate",
        _investigate,
        options=(
            JSON,
            ANY_SIZE,
            inputs("recordings (.mcap) or a case folder of the robot on the rig"),
            rig(),
            option("--budget", type=_minutes, default=60.0, metavar="60min", help="time for experiments (default 60min)"),
            option("--experiments", type=int, default=3, metavar="N", help="at most this many (default 3)"),
            option("--without", action="append", default=[], metavar="ID", help="leave out an experiment (repeatable)"),
            settings("change a parameter of every experiment (repeatable)"),
            option("--no-hands", action="store_true", help="nothing to mount, turn or hang on"),
            option(
                "--out",
                type=Path,
                default=Path("investigation"),
                metavar="FOLDER",
                help="folder for recordings, answer and page",
            ),
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
