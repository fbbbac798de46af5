"""What things cost, as figures: `python -m benchmarks.cost [--measured out] [--out docs/images]`.

It draws what `benchmarks.peers`, `benchmarks.rod_growth` and `benchmarks.diagnosis_growth` wrote (their JSON in `--measured`);
what has not been measured is named and not drawn.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import EngFormatter

from benchmarks.diagnosis_growth import STATES, USUAL, Grown
from benchmarks.peers import Row
from benchmarks.rod_growth import Taken
from lab.pages.figures import BLUE, STYLE, colours, save

MARKS = "osD^vPX*<"
SECONDS = EngFormatter(unit="s")


def peers(rows: Sequence[Row], path: Path) -> Path:
    """Error of the tip over the time of a solve, each method a line through its settings."""
    methods = list(dict.fromkeys(row.method for row in rows if not row.absent))
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
        for method, mark, colour in zip(methods, cycle(MARKS), colours(len(methods)), strict=False):
            found = [row for row in rows if row.method == method and not row.absent]
            times = [row.solve_s for row in found]
            off = [row.own_mm is not None for row in found]
            name = f"{method}, from the rod's tips" if all(off) else method
            axis.loglog(times, [row.error_mm for row in found], mark, ls="-", ms=5, lw=1.2, color=colour, label=name)
            if all(off):
                own = [row.off_mm for row in found]
                name = f"{method}, from its own converged tips"
                axis.loglog(times, own, mark, ls="--", ms=5, lw=1.2, color=colour, mfc="none", label=name)
        axis.set_xlabel("processor time of a solve")
        axis.set_ylabel("worst error of the tip, mm")
        axis.xaxis.set_major_formatter(SECONDS)
        axis.yaxis.set_major_formatter("{x:g}")
        figure.legend(fontsize=8, loc="outside right upper")
        return save(figure, path)


def rods(batches: Sequence[Taken], path: Path) -> Path:
    """Time of a batch over its rods, and of a rod over its elements."""
    sizes = [t for t in batches if t.elements == 2]
    most = max(t.rods for t in batches if t.elements > 2)
    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
        for start, colour, mark in (("cold", BLUE, "o"), ("warm", "black", "s")):
            for threads, style, face in ((1, "-", colour), (2, "--", "none")):
                own = [t for t in sizes if (t.start, t.threads) == (start, threads) and t.rods != most]
                name = f"{start}, {'2 threads, on the clock' if threads == 2 else '1 thread'}"
                seconds = [t.seconds for t in own]
                left.loglog(
                    [t.rods for t in own], seconds, mark, ls=style, ms=4, lw=1.2, color=colour, mfc=face, label=name
                )
            own = [t for t in batches if t.rods == most and t.start == start and t.threads == 1]
            each = [t.seconds / t.rods for t in own]
            right.loglog([t.elements for t in own], each, mark, ls="-", ms=4, lw=1.2, color=colour, label=start)
        left.set_xlabel("rods in a batch, of two elements")
        left.set_ylabel("time of the batch")
        left.xaxis.set_major_formatter("{x:,.0f}")
        left.yaxis.set_major_formatter(SECONDS)
        left.legend(fontsize=8)
        right.set_xlabel(f"elements of a rod, in batches of {most:,}")
        right.set_ylabel("time of a rod")
        right.set_xticks(sorted({t.elements for t in batches}))
        right.xaxis.set_major_formatter("{x:g}")
        right.yaxis.set_major_formatter(SECONDS)
        right.minorticks_off()
        right.legend(fontsize=8)
        return save(figure, path)


def diagnoses(found: Sequence[Grown], path: Path) -> Path:
    """Time and memory of a diagnosis over rows, time over effects and over workers."""
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, 2, figsize=(9, 6.6), layout=ConstrainedLayoutEngine(h_pad=0.12, w_pad=0.12))
        by_rows, memory, by_effects, by_workers = axes.flat
        times(by_rows, [g for g in found if g.by == "rows"])
        times(by_effects, [g for g in found if g.by == "effects"])
        times(by_workers, [g for g in found if g.by == "workers"])
        own = sorted((g for g in found if g.by == "rows"), key=lambda g: g.count)
        memory.plot([g.count for g in own], [g.memory_mib / 1024 for g in own], "D-", ms=4, lw=1.2, color=BLUE)
        memory.set_ylabel("most memory of one process, GiB")
        usual = f"{USUAL * STATES} rows"
        labels = ("rows", "rows", f"effects considered, {usual}", f"worker processes, {usual}")
        for axis, label in zip(axes.flat, labels, strict=True):
            axis.set_xlabel(label)
            axis.set_xlim(0, 1.05 * axis.dataLim.x1)
            axis.set_ylim(0, 1.08 * axis.dataLim.y1)
        by_workers.set_xlim(0.5, 2.5)
        return save(figure, path)


def times(axis: Axes, own: list[Grown]) -> None:
    """Seconds on the clock and of processors over the count."""
    own.sort(key=lambda g: g.count)
    counts = [g.count for g in own]
    axis.plot(counts, [g.seconds for g in own], "o-", ms=4, lw=1.2, color=BLUE, label="on the clock")
    axis.plot(counts, [g.processor_s for g in own], "s--", ms=4, lw=1.2, color="black", label="of processors")
    axis.set_ylabel("time of a diagnosis, s")
    axis.set_xticks(counts)
    axis.legend(fontsize=8)


FIGURES: dict[str, tuple[str, type[Any], Callable[[Any, Path], Path]]] = {
    "peers": ("rows", Row, peers),
    "rod_growth": ("batches", Taken, rods),
    "diagnosis_growth": ("diagnoses", Grown, diagnoses),
}
"""By the name of the file in `--measured`: what it lists, and what draws it."""


def draw(measured: Path, out: Path) -> list[Path]:
    """Draw `cost-NAME.png` of each file that is there, and say which are not."""
    out.mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, (key, kind, figure) in FIGURES.items():
        file = measured / f"{name}.json"
        if not file.is_file():
            print(f"{file}: not there, not drawn; python -m benchmarks.{name} measures it")
            continue
        listed = [kind(**each) for each in json.loads(file.read_text(encoding="utf-8"))[key]]
        drawn.append(figure(listed, out / f"cost-{name.replace('_', '-')}.png"))
        print(drawn[-1])
    return drawn


def main() -> int:
    """Draw all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--measured", type=Path, default=Path("out"), help="folder of the JSON files")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the pictures")
    options = parser.parse_args()
    draw(options.measured, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
