"""Figures of a diagnosis: waterfall, gap map, loops, posterior, confounding."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from diagnosis.answer.result import Diagnosis, Waterfall
from diagnosis.data.levels import levels

from .figures import STYLE, colours, save

Array = NDArray[np.float64]
GREY, BLUE, RED, LIGHT = "#8a8a8a", "#20639b", "#b5382a", "#d5dadd"
MM = 1e3


HATCHES = {
    "calibration": "", "simulator": "\\\\", "cause": "", "tolerances": "//", "regular": "..", "irregular": "xx", "noise": "||",
}  # fmt: skip
"""Steps can be told apart without colours."""


def waterfall(w: Waterfall, names: Sequence[str], length: float, path: Path) -> Path:
    """The gap as given and calibrated (left), and what each step takes of the latter (right); `length` m of the robot.

    Two scales: as given the gap is often ten times what calibration leaves.
    """
    calibrated = w.steps[0].left_mm
    with plt.rc_context(STYLE):
        figure, (whole, steps) = plt.subplots(
            1, 2, figsize=(9.0, 0.9 + 0.42 * len(names)), layout="constrained", width_ratios=(2, 5)
        )
        bars = whole.bar(["as given", "calibrated"], [w.given_mm, calibrated], 0.6, color=[LIGHT, GREY], ec="k", lw=0.6)
        whole.bar_label(
            bars, [f"{v:.2f} mm\n{v / length / 10:.2f} % L" for v in (w.given_mm, calibrated)], fontsize=8, padding=2
        )
        whole.margins(y=0.25)
        whole.set_ylabel("error, mm rms, unseen states")
        whole.grid(False, axis="x")
        for row, step in enumerate(w.steps[1:]):
            colour = BLUE if step.step == "cause" else RED if step.step == "noise" else GREY
            steps.barh(
                row, step.mm, 0.62, left=step.left_mm, color=colour, ec="w" if step.step == "cause" else "k",
                hatch=HATCHES[step.step], lw=0.6, alpha=1.0 if step.step == "cause" else 0.55,
            )  # fmt: skip
            ends = [step.left_mm + step.low95_mm, step.left_mm + step.high95_mm]
            steps.plot(ends, [row, row], "-", color="k", lw=1.4)
            steps.text(
                max(step.left_mm + step.mm, step.left_mm, *ends),
                row,
                f"  {round(step.mm, 2) + 0.0:.2f}",
                va="center",
                fontsize=8,
            )
            steps.plot([step.left_mm] * 2, [row, row + 1], ":", color="0.5", lw=0.8)
        steps.set_yticks(range(len(names) - 1), names[1:], fontsize=8)
        steps.set_ylim(len(names) - 1.4, -0.6)
        steps.set_xlabel(f"mm rms: from {calibrated:.2f} mm calibrated down to nothing")
        steps.margins(x=0.12)
        steps.axvline(0.0, color="k", lw=0.8)
        steps.grid(False, axis="y")
        return save(figure, path)


def gap_map(d: Diagnosis, path: Path) -> Path:
    """Rms gap over spine length and pressure, load and unload, before and after, all on one colour scale."""
    s = _states(d)
    missed = {"calibrated": s["tip"] - s["calibrated"], "with the best hypothesis": s["tip"] - s["explained"]}
    main = s["experiment"] == 0
    branches = [(b, name) for b, name in ((1, "load"), (-1, "unload")) if (main & (s["branch"] == b)).any()]
    lengths, grain = _levels(s["spine_length"][main], 0.01), _grain(s["pressure"])
    # Sweeps read on the fly turn at other pressures up than down, so each branch has levels of its own.
    pressures = {b: _levels(s["pressure"][main & (s["branch"] == b)], grain) for b, _ in branches}
    maps = [
        (f"{word}, {name}", pressures[b], _mapped(s, gap, main & (s["branch"] == b), lengths, pressures[b]))
        for word, gap in missed.items()
        for b, name in branches
    ]
    top = max(float(np.nanmax(m)) for _, _, m in maps)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(
            2, len(branches), figsize=(4.2 * len(branches) + 1, 5.6), layout="constrained", squeeze=False
        )
        for axis, (title, levels_there, values) in zip(axes.ravel(), maps, strict=True):
            image = axis.imshow(values, origin="lower", aspect="auto", vmin=0, vmax=top, cmap="viridis")
            axis.set_xticks(range(len(levels_there)), [f"{p / 1e3:.0f}" for p in levels_there])
            axis.set_yticks(range(len(lengths)), [f"{x * 100:.0f}" for x in lengths])
            axis.set_title(title, loc="left")
            axis.grid(False)
            axis.set_xlabel("pressure, kPa")
            axis.set_ylabel("spine, cm")
        figure.colorbar(image, ax=axes, label="gap, mm rms")
        return save(figure, path)


def loops(d: Diagnosis, path: Path) -> Path:
    """Sideways gap over pressure, up and down, per spine length, with the band of the noise floor."""
    s = _states(d)
    main = s["experiment"] == 0
    lengths = _levels(s["spine_length"][main], 0.01)
    half = d.locate.noise_floor_mm / np.sqrt(3)
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(1, 2, figsize=(9.4, 3.6), layout="constrained", sharey=True)
        for axis, key, title in zip(
            axes, ("calibrated", "explained"), ("calibrated", "with the best hypothesis"), strict=True
        ):
            axis.axhspan(-half, half, color="0.9")
            for length, colour in zip(lengths, colours(len(lengths)), strict=True):
                for branch, style in ((1, "-"), (-1, "--")):
                    own = main & (s["branch"] == branch) & (np.abs(s["spine_length"] - length) < 0.01)
                    _curve(axis, s["pressure"][own], (s["tip"] - s[key])[own, 0] * MM, colour, style)
            axis.set_title(title, loc="left")
            axis.set_xlabel("pressure, kPa")
        for length, colour in zip(lengths, colours(len(lengths)), strict=True):
            axes[1].plot([], [], color=colour, label=f"{length * 100:.0f} cm")
        axes[0].plot([], [], "k-", label="load")
        axes[0].plot([], [], "k--", label="unload")
        axes[0].set_ylabel("measured minus model, x, mm")
        axes[0].legend()
        axes[1].legend(title="spine", ncols=2, fontsize=8)
        return save(figure, path)


MODELS = (
    ("given", ":", "as given"),
    ("calibrated_unseen", "--", "calibrated"),
    ("explained_unseen", "-", "with the cause"),
)


def unseen_tips(d: Diagnosis, path: Path) -> Path:
    """Sideways tip position on the way up over pressure, per spine length: measured, and three models on unseen states.

    Below, by how much the calibrated model and the one with the cause miss the tip there, in any direction.
    """
    s = _states(d)
    own = (s["experiment"] == 0) & (s["branch"] == 1)
    lengths = _levels(s["spine_length"][own], 0.01)
    axis = int(np.nanargmax(np.nanstd(s["tip"][own, :2], axis=0)))
    shown = lengths[np.unique(np.linspace(0, len(lengths) - 1, 4).round().astype(int))]
    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(2, len(shown), figsize=(2.45 * len(shown), 4.6), layout="constrained", squeeze=False,
                                    sharex=True, sharey="row", height_ratios=(3, 2))  # fmt: skip
        for (top, below), length in zip(axes.T, shown, strict=True):
            at = own & (np.abs(s["spine_length"] - length) < 0.01)
            pressure, tip = s["pressure"][at], s["tip"][at, axis] * MM
            for key, style, label in MODELS:
                colour = BLUE if key == "explained_unseen" else "k" if key == "given" else GREY
                there = s[key][at, axis] * MM
                _curve(top, pressure, there, colour, style, label)
                if key != "given":
                    missed = np.linalg.norm(s["tip"][at] - s[key][at], axis=1) * MM
                    _curve(below, pressure, missed, colour, style, label)
            top.plot(pressure / 1e3, tip, "o", color=RED, mfc="none", ms=4, label="measured")
            top.set_title(f"spine {length * 100:.0f} cm", loc="left")
            below.axhspan(0, d.locate.noise_floor_mm, color="0.9")
            below.set_xlabel("pressure, kPa")
        axes[0, 0].set_ylabel(f"tip {'xyz'[axis]}, mm")
        axes[1, 0].set_ylabel("tip missed\nby, mm")
        axes[0, 0].legend(fontsize=7)
        return save(figure, path)


def posterior(d: Diagnosis, path: Path) -> Path:
    """Probability of each hypothesis; those that the data cannot distinguish are marked."""
    ranking = [r for r in d.attribute.ranking if r.probability > 0.002][:10][::-1]
    names = [" + ".join(r.effects) or "none" for r in ranking]
    tied = {e for group in d.attribute.cannot_tell_apart for e in group}
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(7.2, 0.6 + 0.34 * len(ranking)), layout="constrained")
        shades = [RED if r.effects == ("unknown",) else GREY if not r.effects else BLUE for r in ranking]
        bars = axis.barh(names, [r.probability for r in ranking], 0.7, color=shades)
        marks = [f"{r.probability:.2f}" + (" ]" if set(r.effects) & tied else "") for r in ranking]
        axis.bar_label(bars, marks, fontsize=8, padding=3)
        axis.set_xlim(0, 1.1)
        axis.set_xlabel("probability ( ] = these data cannot distinguish it from another)")
        axis.grid(False, axis="y")
        return save(figure, path)


def confounding(d: Diagnosis, path: Path) -> Path:
    """Share of each effect's tip displacement that a calibration takes over."""
    one, per_length = d.detail["confounding"]["one"], d.detail["confounding"]["per_length"]
    names = sorted(one, key=lambda e: one[e])
    at = np.arange(len(names))
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(7.2, 0.8 + 0.26 * len(names)), layout="constrained")
        axis.barh(at + 0.2, [100 * one[n] for n in names], 0.38, color=BLUE, label="one area factor")
        axis.barh(
            at - 0.2,
            [100 * per_length[n] for n in names],
            0.38,
            color=GREY,
            label="an area factor for each spine length",
        )
        axis.set_yticks(at, names, fontsize=8)
        axis.set_xlabel("share of the effect that a calibration absorbs, %")
        axis.grid(False, axis="y")
        axis.legend(loc="lower right")
        return save(figure, path)


def _states(d: Diagnosis) -> dict[str, Array]:
    """Columns of the states; cells without a value are NaN."""
    found: dict[str, Any] = d.detail["states"]
    return {name: np.array(values, float) for name, values in found.items()}


def _levels(values: Array, grain: float) -> Array:
    """Settings meant, from readings that scatter by less than `grain`."""
    number = levels(values, grain / 2)
    return np.array([values[number == k].mean() for k in np.unique(number)])


def _grain(pressure: Array) -> float:
    """Pa; readings that scatter by less were meant to be one setting."""
    return min(10e3, max(0.04 * float(np.nanmax(pressure)), 1.0))


def _mapped(s: dict[str, Array], gap: Array, own: NDArray[np.bool_], lengths: Array, pressures: Array) -> Array:
    out = np.full((len(lengths), len(pressures)), np.nan)
    row = np.abs(s["spine_length"][:, None] - lengths).argmin(axis=1)
    column = np.abs(s["pressure"][:, None] - pressures).argmin(axis=1)
    for i, j in {(int(a), int(b)) for a, b in zip(row[own], column[own], strict=True)}:
        cell = own & (row == i) & (column == j)
        out[i, j] = np.sqrt(np.nanmean((gap[cell] ** 2).sum(axis=1))) * MM
    return out


def _curve(
    axis: Axes, pressure: Array, gap: Array, colour: tuple[float, ...] | str, style: str, label: str | None = None
) -> None:
    if not pressure.size:
        return
    levels = _levels(pressure, 0.6 * _grain(pressure))
    nearest = np.abs(pressure[:, None] - levels).argmin(axis=1)
    axis.plot(
        levels / 1e3,
        [np.nanmean(gap[nearest == i]) for i in range(len(levels))],
        f".{style}",
        color=colour,
        lw=1.2,
        ms=4,
        label=label,
    )
