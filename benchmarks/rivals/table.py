"""Figures of all methods on some sets: a table, the same as JSON, and a picture."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from rich.console import Console
from rich.table import Table

from benchmarks.blind.answers import Answer, read_answer, read_foreign
from benchmarks.blind.folder import SetFolder, open_seal, read_table
from benchmarks.blind.metrics import Interval, JudgedAnswer, counted, judged, share
from benchmarks.blind.score import score, write
from diagnosis.judgement import CAUSE_PROBABILITY
from lab.pages.figures import BLUE, STYLE, save

NAMES = {
    "diagnosis": "diagnosis", "alone": "each alone, BIC", "sparse": "sparse regression", "learned": "learned residual",
}  # fmt: skip
PANELS = {
    "clean": "Right: one cause, a pair or none",
    "clutter": "Right: the same among many small effects",
    "sure_right": f"Right when stated with p > {CAUSE_PROBABILITY}",
}


@dataclass(frozen=True)
class RivalRow:
    """One method. Cases of an outside cause count in `outside` alone."""

    method: str
    cases: dict[str, list[bool]]
    """By column, whether each case counts."""
    seconds: float
    """Median of a case: of processor, of the diagnosis by the clock."""
    closed: float
    """Median share of the gap that is closed on spine lengths that no fit saw, where there is a gap."""
    gaps: int
    """Cases of that median."""

    def interval(self, column: str) -> Interval:
        """Share of a column with its exact interval."""
        return share(np.array(self.cases[column], float))


def row(method: str, cases: Sequence[JudgedAnswer], seconds: Sequence[float]) -> RivalRow:
    """From the judged cases of one method."""
    known = [w for w in cases if not w.stratum.endswith("outside")]
    outside = [w for w in cases if w.stratum.endswith("outside")]

    def sure(w: JudgedAnswer) -> bool:
        return w.answer.verdict in ("effect", "none") and w.answer.probability > CAUSE_PROBABILITY

    groups: dict[str, tuple[Sequence[JudgedAnswer], Callable[[JudgedAnswer], bool]]] = {
        "clean": ([w for w in known if not w.stratum.startswith("cluttered")], lambda w: w.right),
        "clutter": ([w for w in known if w.stratum.startswith("cluttered")], lambda w: w.right),
        "all": (known, lambda w: w.right),
        "sure": (known, sure),
        "sure_right": ([w for w in known if sure(w)], lambda w: w.right),
        "outside": (outside, lambda w: w.named),
    }
    closed = [w.answer.share_closed for w in cases if np.isfinite(w.answer.share_closed)]
    counts = {column: [test(w) for w in own] for column, (own, test) in groups.items()}
    return RivalRow(method, counts, float(np.median(seconds)), float(np.median(closed)) if closed else np.nan, len(closed))


def report(roots: Sequence[Path], out: Path, methods: Sequence[str]) -> list[RivalRow]:
    """Open the seals, print the table, write OUT/figures.json and OUT/figures.svg over all sets; methods that answered all cases
    of a set are scored on it."""
    found: dict[str, tuple[list[JudgedAnswer], list[float]]] = {}

    def count(method: str, truth: Mapping[str, Any], answers: Sequence[Answer], seconds: Sequence[float]) -> None:
        cases, spent = found.setdefault(method, ([], []))
        cases += [judged(truth[a.case], a) for a in answers]
        spent += seconds

    for root in roots:
        folder = SetFolder(root)
        names = folder.names()
        write(score(root), root)
        truth = open_seal(folder)
        own = [read_answer(folder.answers(n) / "rounds.json", n) for n in names]
        count("diagnosis", truth, own, [a.seconds for a in own])
        for method in methods:
            place = out / root.name / method
            at = {n: file for n in names if (file := place / f"{n}.json").exists()}
            answers = [read_foreign(file, n) for n, file in at.items()]
            count(method, truth, answers, [float(read_table(file, "")["seconds"]) for file in at.values()])
            if len(at) == len(names):
                write(score(root, place), root, place)
    rows = [row(method, *found[method]) for method in NAMES if method in found and found[method][0]]
    Console(width=170).print(table(rows))
    (out / "figures.json").write_text(json.dumps([asdict(r) for r in rows], indent=1))
    draw(rows, out / "figures.svg")
    return rows


def table(rows: Sequence[RivalRow]) -> Table:
    """The figures, shares with their exact 95 % intervals."""
    made = Table(title="right by mm (95 %)", title_justify="left")
    titles = ("method", "clean", "among small effects", "both", f"p > {CAUSE_PROBABILITY}", "of these right")
    for title in (*titles, "outside, named so", "s a case", "gap closed (cases)"):
        made.add_column(title)
    for r in rows:
        cells = [counted(r.cases[c]) for c in ("clean", "clutter", "all", "sure", "sure_right", "outside")]
        made.add_row(NAMES[r.method], *cells, f"{r.seconds:.1f}", f"{r.closed:.2f} ({r.gaps})" if r.gaps else "-")
    return made


def draw(rows: Sequence[RivalRow], path: Path) -> Path:
    """Shares right with their intervals: a panel for each group of cases, below each other, for narrow screens too."""
    style = {**STYLE, "font.size": 13, "axes.titlesize": 13, "svg.fonttype": "path", "axes.grid": False}
    with plt.rc_context(style):
        heights = [sum(1 for r in rows if r.cases[column]) for column in PANELS]
        figure, axes = plt.subplots(
            len(PANELS), figsize=(5.6, 0.34 * sum(heights) + 1.8), sharex=True, layout="constrained", height_ratios=heights
        )
        for axis, (column, title) in zip(axes, PANELS.items(), strict=True):
            _panel(axis, [r for r in rows if r.cases[column]], column, title)
            axis.spines["bottom"].set_visible(axis is axes[-1])
            axis.tick_params(axis="x", length=3 if axis is axes[-1] else 0)
        axes[-1].spines["bottom"].set_bounds(0, 1)
        axes[-1].set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "", "0.5", "", "1"])
        axes[-1].set_xlabel("share of cases, 95 % interval")
        return save(figure, path)


def _panel(axis: Axes, rows: Sequence[RivalRow], column: str, title: str) -> None:
    for y, r in enumerate(rows):
        found, ink = r.interval(column), BLUE if r.method == "diagnosis" else "0.45"
        axis.plot([found.low, found.high], [y, y], color=ink, lw=3, alpha=0.45, solid_capstyle="butt")
        axis.plot([found.value], [y], "o", color=ink, ms=8, clip_on=False)
        axis.text(1.04, y, f"{sum(r.cases[column])} of {found.n}", va="center", color=ink)
    axis.set_yticks(range(len(rows)), [NAMES[r.method] for r in rows])
    axis.tick_params(axis="y", length=0, pad=9)
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlim(0, 1.28)
    axis.spines["left"].set_visible(False)
    axis.vlines([0, 0.5, 1], -0.5, len(rows) - 0.5, color="0.9", lw=1, zorder=0)
    axis.set_title(title, loc="left", x=0.0, fontweight="bold")
