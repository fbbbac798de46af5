"""The page of a diagnosis: the verdict in a sentence first, then pictures, and every figure's numbers behind it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis.answer.result import Diagnosis
from diagnosis.compare_campaigns import Change
from recordings.trials import Table

from . import diagnosis_figures as draw
from .diagnosis_attribution import distinguishability as draw_distinguishability
from .diagnosis_attribution import sizes as draw_sizes
from .diagnosis_shapes import shapes as draw_shapes
from .pushes_figure import pushes as draw_pushes
from .report import Report, Section
from .sensors_figure import numbers as sensor_numbers
from .sensors_figure import quantities
from .sensors_figure import sensors as draw_sensors

LITTLE = 0.05
"""Bits: an experiment with a smaller expected information only serves to test the answer."""
MISFIT_LABELS = {
    "discrepancy_gain": "log evidence gained by a large discrepancy",
    "discrepancy_size": "size of the discrepancy, in noise floors",
    "lack_of_fit": "chi-square per degree of freedom",
    "strain": "prior tension, standard deviations",
    "strained": "parameter furthest from its prior",
    "transport": "cross-prediction, chi-square per value",
    "named": "effects named",
    "odd_spine": "spine outlier, standard deviations",
    "beyond": "excess scatter of repeats, factor",
    "outlier_trial": "trial that the others predict worst",
    "outlier_surprise": "its chi-square per value",
    "trend": "trend over time, p-value",
}
"""Keys of `signs` in diagnosis.json -> labels on the page."""


def write(
    d: Diagnosis, length: float, path: Path, source: str, change: Change | None = None, table: Table | None = None
) -> Path:
    """Write one offline page; `length` m of the robot, `source` what was diagnosed, `table` its states, for sensors of the lab's
    own."""
    report = Report("The gap between model and robot", f"{time.strftime('%Y-%m-%d %H:%M')}, {source}", d.statement)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        if d.concerns:
            section = report.section("What these data cannot answer")
            for concern in d.concerns:
                section.text(concern)
        if change is not None:
            report.section("What changed since the reference").text(change.statement)
        _how_much(report.section("How large, and how far it shrinks"), d, length, folder)
        if "holdout" in d.detail:
            _held_out(report.section("On a campaign that was not fitted"), d.detail["holdout"])
        _where(report.section("Where"), d, folder)
        if "stiffness" in d.detail:
            _pushed(report.section("Stiffness trials"), d, folder)
        tips = d.locate.of == "tip"
        if tips:
            _shapes(report.section("The robot's shape"), d, folder)
        _which(report.section("Which cause"), d, folder)
        if tips:
            _distinguishability(report.section("Which effects these data can distinguish"), d, folder)
        if d.detail["masking"]:
            _confounding(report.section("Confounding: what a calibration takes over"), d, folder)
        _next(report.section("What to do next"), d)
        if table is not None and quantities(table):
            _sensors(report.section("What the lab's own sensors measured"), table, folder)
    return report.write(path)


def _how_much(s: Section, d: Diagnosis, length: float, folder: Path) -> None:
    s.figure(
        draw.waterfall(d, length, folder / "waterfall.png"),
        f"{'Tip error' if d.locate.of == 'tip' else 'Error of the deflections'} step by step; unseen: each predicted without "
        "its own data; held out: a campaign of its own (--holdout)",
    )
    if d.shrink is None:
        s.text(
            "A single trial: nothing can be left out of the fit, so how far the gap shrinks on unseen data is unknown."
        )
        return
    closed = "nothing can be closed" if d.shrink.share_closed is None else f"{_percent(d.shrink.share_closed)} %"
    ends = d.shrink.ci95
    interval = "" if ends is None else f" (95 %: {_percent(ends[0])} .. {_percent(ends[1])} %)"
    s.text(f"{d.shrink.how}: share of the reducible gap closed: {closed}{interval}")
    rows = [
        [f"{100 * x.value:.0f} cm", str(x.n), f"{x.before_mm:.2f}", f"{x.after_mm:.2f}"]
        for x in d.shrink.by_spine_length
    ]
    s.table(("spine", "n", "before, mm", "after, mm"), rows)


def _percent(share: float) -> str:
    return f"{round(100 * share) + 0}"


def _sensors(s: Section, table: Table, folder: Path) -> None:
    s.figure(
        draw_sensors(table, folder / "sensors.png"),
        "Each state's mean; bars: one standard deviation of the samples averaged. The model knows nothing of these.",
    )
    s.table(*sensor_numbers(table))


def _held_out(s: Section, found: Mapping[str, Any]) -> None:
    s.text(found["statement"])
    s.text(
        "Both models were fitted to the diagnosed campaign alone; re-growing, re-jamming and whatever else differs from trial to "
        "trial is at its expectation. The interval is a bootstrap over the trials of this campaign, within each spine length."
    )
    rows = [
        [f"{100 * x['value']:.0f} cm", str(x["n"]), f"{x['before_mm']:.2f}", f"{x['after_mm']:.2f}"]
        for x in found["by_spine_length"]
    ]
    rows.append(["all", str(found["states"]), f"{found['before_mm']:.2f}", f"{found['after_mm']:.2f}"])
    s.table(("spine", "n", "before, mm", "after, mm"), rows)


def _where(s: Section, d: Diagnosis, folder: Path) -> None:
    tips = d.locate.of == "tip"
    if tips:
        s.figure(
            draw.gap_map(d, folder / "map.png"),
            "Gap by spine length and pressure, before and after, on one colour scale",
        )
        s.figure(draw.loops(d, folder / "loops.png"), "Sideways gap up and down; grey: noise floor")
    rows = [
        [
            name,
            _at(name, c.value),
            str(c.n),
            f"{c.rmse_mm:.2f}",
            f"{c.low95_mm:.2f} .. {c.high95_mm:.2f}",
            "yes" if c.significant else "",
        ]
        for name, cells in d.locate.by.items()
        for c in cells
    ]
    s.table(("factor", "at", "n", "rms, mm", "95 %", "above the floor"), rows)
    if not tips:
        return
    s.text(
        f"The paper's Euler integration alone would add {d.locate.numerical_error_mm:.2f} mm rms; it is not part of this gap."
    )


def _pushed(s: Section, d: Diagnosis, folder: Path) -> None:
    found = d.detail["stiffness"]
    s.figure(
        draw_pushes(found, folder / "pushes.png"),
        "Force error over the specimen's stiffness, as a deflection; grey: noise floor",
    )
    rows = [[name, f"{value:.3f}"] for name, value in found["waterfall_mm"].items()]
    s.table(("model", "deflection error, mm rms"), [*rows, ["noise floor", f"{found['floor_mm']:.3f}"]])


def _at(factor: str, value: float | str) -> str:
    """A level of a factor as a person reads it."""
    unit, scale, digits = {
        "spine_length": ("cm", 100.0, 0), "pressure": ("kPa", 1e-3, 0), "time": ("s", 1.0, 0), "arc_length": ("cm", 100.0, 0),
    }.get(factor, ("", 1.0, 0))  # fmt: skip
    return value if isinstance(value, str) else f"{scale * value:.{digits}f} {unit}"


def _which(s: Section, d: Diagnosis, folder: Path) -> None:
    s.figure(draw.posterior(d, folder / "posterior.png"), f"Probability of each hypothesis ({d.detail['bench']})")
    if d.budget:
        words = {"named": "named", "present": "also present", "unseen": "could not be seen in these data"}
        rows = [[c.effect, f"{c.mm:.2f}", f"{c.low95_mm:.2f} .. {c.high95_mm:.2f}", words[c.role]] for c in d.budget]
        s.table(("effect", "carries of the gap, mm rms", "95 %", ""), rows)
    if d.detail["sizes"]:
        _sizes(s, d.detail["sizes"], folder)
    for group in d.attribute.cannot_tell_apart:
        s.text(f"These data cannot distinguish {', '.join(group)}.")
    rows = [
        [" + ".join(r.effects) or "none", f"{r.probability:.3f}", f"{r.log_evidence:.1f}",
         "" if r.heldout_rmse_mm is None else f"{r.heldout_rmse_mm:.2f}"]
        for r in d.attribute.ranking
    ]  # fmt: skip
    s.table(("hypothesis", "probability", "log evidence", "held out, mm"), rows)
    stages = sorted(d.locate.stage.items(), key=lambda x: -x[1])
    s.table(("stage of the chain", "probability of a cause there"), [[name, f"{p:.2f}"] for name, p in stages])
    found = d.detail["signs"]
    s.table(
        ("misfit diagnostic", "value"),
        [[MISFIT_LABELS.get(k, k.replace("_", " ")), _diagnostic(v)] for k, v in found.items()],
    )


def _diagnostic(value: float | str | None) -> str:
    if isinstance(value, str):
        return value or "none"
    return "none" if value is None else f"{value:.3g}"


def _sizes(s: Section, sizes: Sequence[Mapping[str, Any]], folder: Path) -> None:
    s.figure(
        draw_sizes(sizes, folder / "sizes.png"),
        "Size of the leading hypothesis: normal posterior of the problem linearised at the fit, widened as calibrated "
        "(dashed), cut at the physical bounds (red). Left: the physically possible range; right: close up, 90 % shaded",
    )
    rows = [
        [x["name"], x["unit"], f"{x['fitted']:.3g}", f"{x['sd']:.2g}", f"{x['low90']:.3g} .. {x['high90']:.3g}",
         f"{_bound(x['low'])} .. {_bound(x['high'])}"]
        for x in sizes
    ]  # fmt: skip
    s.table(("size", "unit", "fitted", "sd", "90 %", "physically possible"), rows)
    for x in sizes:
        if x["impossible"]:
            s.text(
                f"The data ask for {x['name']} = {x['mean']:.3g} {x['unit']}, beyond what is physically possible: "
                "this speaks against the effect itself."
            )


def _bound(value: float | None) -> str:
    return "unbounded" if value is None else f"{value:g}"


def _shapes(s: Section, d: Diagnosis, folder: Path) -> None:
    states = d.detail["shapes"]
    if not states:
        s.text("The model has no equilibrium in the measured states, so there is no shape to show.")
        return
    s.figure(
        draw_shapes(states, folder / "shapes.png"),
        "The state that is missed most at a spine length, at most four; equal axes, mm, base frame",
    )
    rows = [
        [f"{100 * x['spine_length']:.0f} cm", f"{x['pressure'] / 1e3:.0f}", x["branch"], str(x["trial"]),
         _point(x["measured_tip"]), _miss(x, "calibrated"), _miss(x, "explained")]
        for x in states
    ]  # fmt: skip
    head = ("spine", "kPa", "branch", "trial", "measured tip, mm", "baseline off by, mm", "best hypothesis off by, mm")
    s.table(head, rows)


def _point(metres: Sequence[float]) -> str:
    return "(" + ", ".join(f"{round(1e3 * x, 1) + 0.0:.1f}" for x in metres) + ")"


def _miss(state: Mapping[str, Any], model: str) -> str:
    missed = np.subtract(state["measured_tip"], state[model]["tip"])
    return f"{1e3 * float(np.linalg.norm(missed)):.2f} {_point(missed)}"


def _distinguishability(s: Section, d: Diagnosis, folder: Path) -> None:
    found = d.detail["apart"]
    effects, tied = found["effects"], found["tied_below"]
    s.figure(
        draw_distinguishability(found, folder / "apart.png"),
        "T: chi-square lost when the column's effect is fitted in place of the row's, the discrepancy integrated out. Below "
        f"{tied:g} (red frames) they are tied; probable effects come first, in bold. Sizes: as fitted where an effect is "
        "probable, else its plausible scale",
    )
    rows = []
    for i, (effect, weight) in enumerate(zip(effects, found["weight"], strict=True)):
        others = sorted((t, effects[j]) for j, t in enumerate(found["separation"][i]) if j != i)
        seen = found["separation"][i][i] >= tied
        alike = ", ".join(e for t, e in others if t < tied) if seen else "not detectable"
        nearest = f"{others[0][1]} ({others[0][0]:.1f})" if others else ""
        rows.append([effect, f"{weight:.3f}", f"{found['separation'][i][i]:.1f}", nearest, alike])
    s.table(("effect", "probability", "T against none", "nearest rival (T)", "tied with"), rows)


def _confounding(s: Section, d: Diagnosis, folder: Path) -> None:
    s.figure(
        draw.confounding(d, folder / "masking.png"),
        "Share of each effect's tip displacement that a calibration takes over",
    )


def _next(s: Section, d: Diagnosis) -> None:
    if not d.next_experiment:
        s.text("No experiment on this rig is expected to distinguish the remaining candidates better.")
        return
    if d.next_experiment[0].expected_bits < LITTLE:
        s.text(
            "The leading hypothesis is so far ahead that no experiment is expected to add much; any of these can test it."
        )
    rows = [
        [p.do, f"{p.expected_bits:.2f}", f"{p.cost_min:.0f}", "; ".join(" | ".join(x) for x in p.separates[:3])]
        for p in d.next_experiment
    ]
    s.table(("experiment", "bits", "minutes", "separates"), rows)
