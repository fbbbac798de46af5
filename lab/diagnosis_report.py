"""The page of a diagnosis: the verdict in a sentence first, then pictures, and every figure's numbers behind it."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from diagnosis.compare_campaigns import Change
from diagnosis.result import Diagnosis

from . import diagnosis_figures as draw
from .pushes_figure import pushes as draw_pushes
from .report import Report, Section


def write(d: Diagnosis, length: float, path: Path, source: str, change: Change | None = None) -> Path:
    """Write one offline page; `length` m of the robot, `source` what was diagnosed."""
    report = Report("The gap between model and robot", f"{time.strftime('%Y-%m-%d %H:%M')}, {source}", d.statement)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if d.concerns:
            said = report.section("What this data cannot say")
            for concern in d.concerns:
                said.text(concern)
        if change is not None:
            report.section("What changed since the reference").text(change.statement)
        _how_much(report.section("How large, and how far it shrinks"), d, length, folder)
        _where(report.section("Where"), d, folder)
        if "stiffness" in d.detail:
            _pushed(report.section("Stiffness trials"), d, folder)
        _which(report.section("Which cause"), d, folder)
        if d.detail["masking"]:
            _hidden(report.section("What calibration hides"), d, folder)
        _next(report.section("What to do next"), d)
    return report.write(path)


def _how_much(s: Section, d: Diagnosis, length: float, folder: Path) -> None:
    s.figure(
        draw.waterfall(d, length, folder / "waterfall.png"),
        f"{'Tip error' if d.locate.of == 'tip' else 'Error of the deflections'} step by step; unseen: each predicted without "
        "its own data",
    )
    if d.shrink is None:
        return
    closed = "nothing can be closed" if d.shrink.share_closed is None else f"{100 * d.shrink.share_closed:.0f} %"
    interval = (
        "" if d.shrink.ci95 is None else f" (95 %: {100 * d.shrink.ci95[0]:.0f} .. {100 * d.shrink.ci95[1]:.0f} %)"
    )
    s.text(f"{d.shrink.how}: share of the reducible gap closed: {closed}{interval}")
    rows = [
        [f"{100 * x.value:.0f} cm", str(x.n), f"{x.before_mm:.2f}", f"{x.after_mm:.2f}"]
        for x in d.shrink.by_spine_length
    ]
    s.table(("spine", "n", "before, mm", "after, mm"), rows)


def _where(s: Section, d: Diagnosis, folder: Path) -> None:
    tips = d.locate.of == "tip"
    if tips:
        s.figure(
            draw.gap_map(d, folder / "map.png"), "Gap by spine length and pressure, before and after, one colour scale"
        )
        s.figure(draw.loops(d, folder / "loops.png"), "Sideways gap up and down; grey: noise floor")
    rows = [
        [
            name,
            str(c.value),
            str(c.n),
            f"{c.rmse_mm:.2f}",
            f"{c.low95_mm:.2f} .. {c.high95_mm:.2f}",
            "yes" if c.significant else "",
        ]
        for name, cells in d.locate.by.items()
        for c in cells
    ]
    s.table(("factor", "value (SI)", "n", "rms, mm", "95 %", "above the floor"), rows)
    if not tips:
        return
    s.text(
        f"The paper's Euler integration alone would add {d.locate.numerical_error_mm:.2f} mm rms; it is not part of this gap."
    )


def _pushed(s: Section, d: Diagnosis, folder: Path) -> None:
    found = d.detail["stiffness"]
    s.figure(
        draw_pushes(found, folder / "pushes.png"),
        "Force missed, over the specimen's stiffness: as a deflection; grey: noise floor",
    )
    rows = [[name, f"{value:.3f}"] for name, value in found["waterfall_mm"].items()]
    s.table(("model", "deflection missed, mm rms"), [*rows, ["noise floor", f"{found['floor_mm']:.3f}"]])


def _which(s: Section, d: Diagnosis, folder: Path) -> None:
    s.figure(draw.posterior(d, folder / "posterior.png"), f"Probability of each hypothesis ({d.detail['bench']})")
    size = draw.sizes(d, folder / "sizes.png")
    if size is not None:
        s.figure(size, "Size of the leading hypothesis; shaded: 90 %")
    for group in d.attribute.cannot_tell_apart:
        s.text(f"This data cannot tell apart: {', '.join(group)}.")
    rows = [
        [" + ".join(r.effects) or "none", f"{r.probability:.3f}", f"{r.log_evidence:.1f}",
         "" if r.heldout_rmse_mm is None else f"{r.heldout_rmse_mm:.2f}"]
        for r in d.attribute.ranking
    ]  # fmt: skip
    s.table(("hypothesis", "probability", "log evidence", "held out, mm"), rows)
    signs = d.detail["signs"]
    s.table(
        ("sign of something outside the catalogue", "value"), [[k.replace("_", " "), f"{v}"] for k, v in signs.items()]
    )


def _hidden(s: Section, d: Diagnosis, folder: Path) -> None:
    s.figure(
        draw.masking(d, folder / "masking.png"), "Share of each effect's tip displacement that a calibration absorbs"
    )


def _next(s: Section, d: Diagnosis) -> None:
    if not d.next_experiment:
        s.text("No experiment of the rig is expected to tell the remaining candidates apart better.")
        return
    rows = [
        [p.do, f"{p.expected_bits:.2f}", f"{p.cost_min:.0f}", "; ".join(" | ".join(x) for x in p.separates[:3])]
        for p in d.next_experiment
    ]
    s.table(("experiment", "bits", "minutes", "separates"), rows)
