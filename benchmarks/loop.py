"""Does the loop closed help? Sealed robots diagnosed after the sweep alone, and after up to three experiments: those that the
diagnosis asks for, any of the menu, or the sweep again.

    python -m benchmarks.blind make --world drawn:SEED --seed SEED --n 20 --kind clean --kind cluttered SET
    python -m benchmarks.loop SET.. --workers 2                  # answers every robot by each way; goes on where it stopped
    python -m benchmarks.loop SET.. --score --png loop.png       # opens the seals

Every way begins with the same diagnosis of the sweep and ends as `lab investigate` does: where the answer is settled, where
nothing is expected to tell more, or after three experiments. Its cost is counted in minutes of the rig and of hands.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.blind.answers import answer_from
from benchmarks.blind.folder import SetFolder, open_seal
from benchmarks.blind.metrics import Judged, counted, judged
from benchmarks.blind.run import MENU_OF, Choice, Further, propose_folder, read_rounds, rounds, write_rounds
from benchmarks.blind.sweeps import AGAIN
from benchmarks.blind.workers import spread
from recordings.table_file import read_csv

WAYS: tuple[Choice, ...] = ("information", "random", "repeat")
NAMES = {"information": "what the diagnosis asks for", "random": "any of the menu", "repeat": "the sweep again"}
MOST = 3
COLOURS = {"information": "#1b6ca8", "random": "#d98c21", "repeat": "#7a7a7a"}


def file_of(folder: SetFolder, name: str, way: Choice) -> Path:
    """Where the rounds of a case are kept."""
    return folder.answers(name) / ("rounds.json" if way == "information" else f"{way}.json")


def answer(task: tuple[Path, str, Choice]) -> None:
    """Diagnose one case by one way, from its first diagnosis on where that is known."""
    root, name, way = task
    folder = SetFolder(root)
    target = file_of(folder, name, way)
    if target.exists():
        return
    first = file_of(folder, name, WAYS[0])
    begun = read_rounds(first)[:1] if way != WAYS[0] and first.exists() else []
    target.parent.mkdir(parents=True, exist_ok=True)
    write_rounds(target, rounds(folder.case(name), propose_folder, Further(MOST, way), begun))


@dataclass(frozen=True)
class Case:
    """One robot by one way."""

    kind: str
    way: Choice
    minutes: tuple[float, ...]
    """Spent before each round."""
    judged: tuple[Judged, ...]
    """Each round beside the truth."""

    @property
    def settled(self) -> tuple[bool, ...]:
        """By round: an answer after which nothing more is asked, and right."""
        return tuple(w.right and w.answer.settled for w in self.judged)

    @property
    def minutes_to_settle(self) -> float:
        """Until the first right and settled answer; infinite where there is none."""
        return next((m for m, done in zip(self.minutes, self.settled, strict=True) if done), np.inf)


def case_of(root: Path, truth: dict[str, Any], name: str, way: Choice) -> Case | None:
    """A case beside its truth; None where it has no answer by this way."""
    folder = SetFolder(root)
    path = file_of(folder, name, way)
    if not path.exists():
        return None
    found = read_rounds(path)
    minutes = [0.0]
    for before, after in zip(found, found[1:], strict=False):
        minutes.append(minutes[-1] + cost(folder.case(name), before.diagnosis, after.asked[-1]))
    beside = (judged(truth[name], answer_from(name, r.diagnosis, r.seconds, r.asked)) for r in found)
    return Case(str(truth[name]["stratum"]), way, tuple(minutes), tuple(beside))


def cost(case: Path, diagnosis: dict[str, Any], wish: str) -> float:
    """Minutes of an experiment as the diagnosis tells them; of the sweep, as long as it took."""
    if wish == AGAIN:
        t = [r.t for r in read_csv(case / "menu" / f"{AGAIN}.csv")]
        return (max(t) - min(t)) / 60
    known = {MENU_OF.get(p["id"]): float(p["cost_min"]) for p in diagnosis.get("next_experiment", ())}
    return known.get(wish, float(np.mean(list(known.values()))) if known else 0.0)


def sheet(cases: Sequence[Case]) -> Table:
    """Right before and after, by kind and way."""
    shown = Table(title="The same robots before and after up to three experiments", title_justify="left")
    columns = ("kind", "way", "robots", "right before", "right after", "right, p >= .95 before", "after", "wrong, p >= .95 after",
               "worse", "experiments", "minutes")  # fmt: skip
    for column in columns:
        shown.add_column(column)
    for kind in sorted({c.kind for c in cases}):
        for way in WAYS:
            own = [c for c in cases if (c.kind, c.way) == (kind, way)]
            if not own:
                continue
            first, last = [c.judged[0] for c in own], [c.judged[-1] for c in own]
            sure_wrong = sum(w.answer.settled and not w.right for w in last)
            shown.add_row(
                kind, NAMES[way], str(len(own)), counted([w.right for w in first]), counted([w.right for w in last]),
                counted([c.settled[0] for c in own]), counted([c.settled[-1] for c in own]), str(sure_wrong),
                counted([a.right and not b.right for a, b in zip(first, last, strict=True)]),
                f"{np.mean([len(c.judged) - 1 for c in own]):.1f}", f"{np.mean([c.minutes[-1] for c in own]):.0f}",
            )  # fmt: skip
    return shown


def draw(cases: Sequence[Case], path: Path) -> None:
    """Share of robots told right with p of at least .95 against minutes of experiments, by kind."""
    kinds = sorted({c.kind for c in cases})
    figure, axes = plt.subplots(1, len(kinds), figsize=(4.6 * len(kinds), 3.6), sharey=True, squeeze=False)
    for axis, kind in zip(axes[0], kinds, strict=True):
        at = np.linspace(0, 1.05 * max(c.minutes[-1] for c in cases if c.kind == kind), 400)
        for way in WAYS:
            own = [c for c in cases if (c.kind, c.way) == (kind, way)]
            if not own:
                continue
            reached = np.mean([[c.minutes_to_settle <= m for m in at] for c in own], axis=0)
            axis.step(at, reached, color=COLOURS[way], label=f"{NAMES[way]} (n = {len(own)})", where="post")
        axis.set_title(kind, loc="left", fontsize=10)
        axis.set_xlabel("minutes of experiments after the sweep")
        axis.set_ylim(0, 1)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, fontsize=8, loc="lower right")
    axes[0][0].set_ylabel("share of robots told right with p >= 0.95")
    figure.tight_layout()
    figure.savefig(path, dpi=150)


def main() -> int:
    """Answer, or score."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("sets", nargs="+", type=Path, metavar="SET")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--way", action="append", choices=WAYS, help="repeatable; default: all, one after another")
    parser.add_argument("--score", action="store_true", help="open the seals")
    parser.add_argument("--png", type=Path)
    a = parser.parse_args()
    if not a.score:
        tasks = [(s, name, way) for way in a.way or WAYS for s in a.sets for name in SetFolder(s).names()]
        for _ in spread(answer, tasks, a.workers, "robots"):
            pass
        return 0
    cases: list[Case] = []
    for s in a.sets:
        truth = open_seal(SetFolder(s))
        every = (case_of(s, truth, name, way) for name in SetFolder(s).names() for way in WAYS)
        cases += [c for c in every if c is not None]
    Console(highlight=False, width=200).print(sheet(cases))
    if a.png is not None:
        draw(cases, a.png)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
