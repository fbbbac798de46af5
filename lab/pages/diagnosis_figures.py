"""Figures of a diagnosis: waterfall, gap map, loops, posterior, confounding."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from diagnosis.answer.result import Diagnosis
from diagnosis.data.levels import levels

from .figures import STYLE, colours, save

Array = NDArray[np.float64]
GREY, BLUE, RED = "#8a8a8a", "#20639b", "#b5382a"
MM = 1e3


def waterfall(d: Diagnosis, length: float, path: Path) -> Path:
    """Rms error of the model as given, calibrated, explained, and on unseen data; `length` m of the robot."""
    steps = dict(d.detail["waterfall_mm"])
    floor = steps.pop("noise floor")
    if d.shrink is not None:
        steps |= {"unseen: calibrated": d.shrink.before_mm, "unseen: explained": d.shrink.after_mm}
    if "holdout" in d.detail:
        held = d.detail["holdout"]
        steps |= {"held out: calibrated": held["before_mm"], "held out: explained": held["after_mm"]}
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(7.2, 3.4), layout="constrained")
        shades = [BLUE if "explained" in name or "hypothesis" in name else GREY for name in steps]
        names = [name.replace(": ", ":\n").replace("best ", "best\n") for name in steps]
        bars = axis.bar(names, list(steps.values()), 0.6, color=shades)
        labels = [f"{v:.2f} mm\n{v / length / 10:.2f} % L" for v in steps.values()]
        axis.bar_label(bars, labels, fontsize=8, padding=2)
        axis.axhline(floor, color=RED, lw=1.2, ls="--", label=f"noise floor {floor:.2f} mm")
        axis.margins(y=0.2)
        axis.set_ylabel(f"error of the {d.locate.of}, mm rms")
        axis.grid(False, axis="x")
        axis.tick_params(axis="x", labelsize=8)
        axis.legend()
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
    one, per_length = d.detail["masking"]["one"], d.detail["masking"]["per_length"]
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
        axis.set_xlabel("share of the effect that a calibration takes over, %")
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


def _curve(axis: Axes, pressure: Array, gap: Array, colour: tuple[float, ...], style: str) -> None:
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
    )
