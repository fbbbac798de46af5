"""A score for people: a table on the screen and a picture."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from rich.table import Table

from lab.console import styled
from lab.pages.figures import STYLE, save

from .metrics import Interval
from .score import Score

INK = "#33526e"
AGREE = (("outside", "unknown"), ("pair", "several"))
"""Kinds of cases whose right answer has another name; of a pair it may still be the wrong two."""


def sheet(result: Score) -> Table:
    """The figures beside their targets."""
    table = Table(title=heading(result), title_justify="left")
    for column in ("figure", "found", "95 % interval", "cases", "target", ""):
        table.add_column(column, justify="left" if column in ("figure", "") else "right")
    for label, *cells, met in rows(result):
        mark = styled(met, {"met": "green", "missed": "red"}.get(met, ""))
        table.add_row(label, *cells, mark)
    return table


def heading(result: Score) -> str:
    """One line that says which set this is."""
    about = result.about
    world = f"cluttered at {float(about['clutter']):.0%}" if about.get("clutter") else "clean"
    chosen = f", after at most {result.after} experiments of its own choice" if result.after else ""
    data = f"data: {about.get('design')}{chosen}"
    return f"{result.name}: {len(result.cases)} cases, {world}, {data}"


def rows(result: Score) -> list[tuple[str, str, str, str, str, str]]:
    """Label, found, interval, cases, target, met or missed."""
    out = []
    for m in result.figures:
        if not m.found.n:
            continue
        aim = result.aims.get(m.key)
        met = "" if aim is None else ("met" if aim.met(m.found.value) else "missed")
        out.append((m.label, _number(m.found.value), _range(m.found), str(m.found.n), "" if aim is None else str(aim), met))
    return out


def _number(x: float) -> str:
    return f"{x:.2f}" if abs(x) < 100 else f"{x:.0f}"


def _range(i: Interval) -> str:
    return f"{_number(i.low)}..{_number(i.high)}"


def draw(result: Score, path: Path) -> Path:
    """Confusion matrix, and what a stated probability was worth."""
    true, named, counts = result.confusion
    with plt.rc_context(STYLE):
        size = (4.2 + 0.24 * len(named), 2.2 + 0.2 * len(true))
        figure = plt.figure(figsize=(size[0] + 3.4, max(size[1], 4.0)), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=[size[0], 3.4])
        _confusion(left, true, named, counts)
        _reliability(right, result)
        figure.suptitle(heading(result), fontsize=9, x=0.01, ha="left")
        return save(figure, path)


def _confusion(axis: Axes, true: list[str], named: list[str], counts: np.ndarray) -> None:
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    agrees = np.array([[t == n or (t, n) in AGREE for n in named] for t in true])
    for cells, colours in ((agrees, "Blues"), (~agrees, "Reds")):
        axis.imshow(np.ma.masked_where(~cells | (counts == 0), share), cmap=colours, vmin=-0.25, vmax=1.15, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        ink = "white" if share[i, j] > 0.6 else "0.1"
        axis.text(j, i, str(counts[i, j]), ha="center", va="center", fontsize=7, color=ink)
    axis.set_xlim(-0.5, len(named) - 0.5)
    axis.set_ylim(len(true) - 0.5, -0.5)
    axis.hlines(np.arange(len(true)) - 0.5, -0.5, len(named) - 0.5, color="0.92", lw=0.6)
    axis.vlines(np.arange(len(named)) - 0.5, -0.5, len(true) - 0.5, color="0.92", lw=0.6)
    axis.set_xticks(range(len(named)), [n.replace("_", " ") for n in named], rotation=90, fontsize=7)
    axis.set_yticks(
        range(len(true)), [f"{t.replace('_', ' ')} ({n})" for t, n in zip(true, counts.sum(axis=1), strict=True)], fontsize=7
    )
    axis.grid(False)
    axis.set_xlabel("named")
    axis.set_ylabel("truth (cases)")


def _reliability(axis: Axes, result: Score) -> None:
    points = result.reliability
    axis.plot([0, 1], [0, 1], color="0.6", lw=1, ls="--")
    if points:
        stated, right, n = (np.array(v, float) for v in zip(*points, strict=True))
        axis.plot(stated, right, color=INK, lw=1.2)
        axis.scatter(stated, right, s=12 + 160 * n / n.max(), color=INK, zorder=3)
        for x, y, k in points:
            axis.annotate(str(k), (x, y), (5, -9), textcoords="offset points", fontsize=7)
    axis.set_xlim(0, 1.02)
    axis.set_ylim(0, 1.02)
    axis.set_xlabel("stated probability of the verdict")
    axis.set_ylabel("share right")
