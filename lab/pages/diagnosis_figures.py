"""Figures of a diagnosis: waterfall, gap map, loops, posterior; shapes and stiffness trials."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from diagnosis.answer.headline import hypothesis_name
from diagnosis.answer.result import Diagnosis, Ranked, Waterfall
from diagnosis.any_model.answer import Ranked as OfAnyModel
from diagnosis.data.levels import levels
from model.actuators import Words
from model.arrays import Array, Mask

from .figures import colours, drawing
from .report import CALIBRATED, GIVEN

SAME_LENGTH = 0.01
"""m within which spine lengths are one setting."""
MOST_GROUPS = 8
"""Panels, one for each group of chambers."""
GREY, BLUE, RED, LIGHT = "#8a8a8a", "#20639b", "#b5382a", "#d5dadd"

HATCHES = {
    "calibration": "", "simulator": "\\\\", "cause": "", "tolerances": "//", "regular": "..", "irregular": "xx", "noise": "||",
}  # fmt: skip
"""Steps can be told apart without colours."""


def waterfall(w: Waterfall, names: Sequence[str], length: float, folder: Path) -> list[Path]:
    """The gap uncalibrated and calibrated, on two scales, and what each step takes of the latter; `length` m of the robot."""
    calibrated, height = w.steps[0].left_mm, 0.9 + 0.42 * len(names)
    paths = [folder / "waterfall-whole.svg", folder / "waterfall-steps.svg"]
    with drawing(paths[0], (2.6, height)) as (_, whole):
        bars = whole.bar([GIVEN, CALIBRATED], [w.given_mm, calibrated], 0.6, color=[LIGHT, GREY], ec="k", lw=0.6)
        whole.bar_label(bars, [f"{v:.2f} mm\n{v / length / 10:.2f} % L" for v in (w.given_mm, calibrated)], fontsize=8, padding=2)
        whole.margins(y=0.25)
        whole.set_ylabel("error, mm rms, unseen states")
        whole.grid(False, axis="x")
    with drawing(paths[1], (3.9, height)) as (_, steps):
        for row, step in enumerate(w.steps[1:]):
            colour = BLUE if step.step == "cause" else RED if step.step == "noise" else GREY
            steps.barh(
                row, step.mm, 0.62, left=step.left_mm, color=colour, ec="w" if step.step == "cause" else "k",
                hatch=HATCHES[step.step], lw=0.6, alpha=1.0 if step.step == "cause" else 0.55,
            )  # fmt: skip
            ends = [step.left_mm + step.low95_mm, step.left_mm + step.high95_mm]
            steps.plot(ends, [row, row], "-", color="k", lw=1.4)
            steps.text(max(step.left_mm + step.mm, step.left_mm, *ends), row, f"  {step.mm:z.2f}", va="center", fontsize=8)
            steps.plot([step.left_mm] * 2, [row, row + 1], ":", color="0.5", lw=0.8)
        steps.set_yticks(range(len(names) - 1), [fill(name, 22) for name in names[1:]], fontsize=8)
        steps.set(ylim=(len(names) - 1.4, -0.6), xlabel=f"mm rms: from {calibrated:.2f} mm calibrated down to nothing")
        steps.margins(x=0.12)
        steps.axvline(0.0, color="k", lw=0.8)
        steps.grid(False, axis="y")
    return paths


@dataclass(frozen=True)
class StateGroup:
    """States with the same actuators driven."""

    name: str
    selected: Mask
    side: Array
    """(3,) unit vector, horizontal: the direction in which these states bend."""
    lengths: Array
    """Spine lengths, m."""
    others: bool = False
    """All settings that have no group of their own."""

    @property
    def order(self) -> tuple[int, ...]:
        """For a list: single actuators by their number first, then pairs; settings that are summed up last."""
        numbers = tuple(map(int, re.findall(r"\d+", self.name)))
        return (len(self.selected) + 1,) if self.others else (len(numbers), *numbers)


def groups(d: Diagnosis) -> list[StateGroup]:
    """All states by the chambers inflated, the largest calibrated gap first; beyond `MOST_GROUPS` the others are one group."""
    s, keys = _states(d), [d.words.group(c) for c in d.detail["states"]["chambers"]]
    missed = np.linalg.norm(s["tip"] - s["calibrated"], axis=1)
    ranked = pd.Series(missed).groupby(keys, sort=False).max().sort_values(ascending=False, kind="stable").index.tolist()
    rest = ""  # name of the group of all others
    if len(ranked) > MOST_GROUPS:
        rest = f"{len(ranked) - MOST_GROUPS + 1} other settings"
        keys = [key if key in ranked[: MOST_GROUPS - 1] else rest for key in keys]
        ranked = [*ranked[: MOST_GROUPS - 1], rest]
    panels = []
    for name in ranked:
        selected = np.array([key == name for key in keys])
        panels.append(
            StateGroup(name, selected, _side(s["tip"][selected]), _levels(s["spine_length"][selected], SAME_LENGTH), name == rest)
        )
    return panels


def _side(tip: Array) -> Array:
    """Horizontal direction (3,) in which tips (n, 3) differ most, away from the axis."""
    side = np.linalg.svd(np.nan_to_num(tip[:, :2] - np.nanmean(tip[:, :2], axis=0)), full_matrices=False)[2][0]
    return np.append(side if float(np.nansum(tip[:, :2] @ side)) >= 0 else -side, 0.0)


def gap_map(d: Diagnosis, name: str, folder: Path) -> list[Path]:
    """Rms gap over chambers, spine length and pressure, load and unload, on one colour scale; `name`: model with the cause."""
    s, by_group = _states(d), groups(d)
    missed = {CALIBRATED: s["tip"] - s["calibrated"], name: s["tip"] - s["explained"]}
    rows = [(g, length) for g in sorted(by_group, key=lambda g: g.order) for length in g.lengths]
    spines = np.ptp(s["spine_length"]) > SAME_LENGTH
    labels = [f"{g.name}{f'; spine {100 * length:.0f} cm' if spines else ''}" for g, length in rows]
    grain = _grain(s["pressure"])
    # sweeps read without stopping turn at other pressures up than down, so each branch has levels of its own
    maps = []
    for model, gap in missed.items():
        for branch, direction in ((1, "load"), (-1, "unload")):
            of_branch = s["branch"] == branch
            if of_branch.any():
                pressures = _levels(s["pressure"][of_branch], grain)
                maps.append((f"{model}, {direction}", pressures, _drawn(s, gap, of_branch, rows, pressures)))
    top = max(float(np.nanmax(m)) for _, _, m in maps)
    pictures = [folder / f"map-{k}.svg" for k in range(len(maps))]
    for path, (title, pressures, values) in zip(pictures, maps, strict=True):
        with drawing(path, (4.3, 1.3 + 0.26 * len(rows))) as (figure, axis):
            image = axis.imshow(values, aspect="auto", vmin=0, vmax=top, cmap="cividis")
            axis.set_xticks(range(len(pressures)), [d.words.number(p) for p in pressures])
            axis.set_yticks(range(len(rows)), labels, fontsize=8)
            if len(pressures) <= 10:
                for (i, j), value in np.ndenumerate(values):
                    if np.isfinite(value):
                        axis.text(j, i, f"{value:.2g}", ha="center", va="center", fontsize=7,
                                  color="k" if value > 0.5 * top else "w")  # fmt: skip
            axis.set(title=title, xlabel=d.words.axis)
            axis.grid(False)
            figure.colorbar(image, ax=axis, label="gap, mm rms")
    return pictures


def loops(d: Diagnosis, name: str, folder: Path) -> list[Path]:
    """Gap along and across the bending direction over pressure by group of chambers: calibrated, and with the cause (`name`)."""
    s, by_group = _states(d), groups(d)
    half = d.locate.noise_floor_mm / np.sqrt(3)  # of the band: the floor along one of three axes
    missed = {model: s["tip"] - s[key] for key, model in (("calibrated", CALIBRATED), ("explained", name))}
    most = max(float(np.nanmax(np.abs(gap[:, :2]))) for gap in missed.values()) * 1e3 * 1.05 + half
    pictures = [folder / f"loops-{k}.svg" for k in range(len(by_group))]
    for path, g in zip(pictures, by_group, strict=True):
        directions = (("along bending", g.side), ("across", np.array([-g.side[1], g.side[0], 0.0])))
        with drawing(path, (4.2, 4.4), 2, 2, {"axes.titlesize": 8}, sharex=True, sharey=True) as (figure, axes):
            for row, (model, gap) in zip(axes, missed.items(), strict=True):
                for axis, (word, direction) in zip(row, directions, strict=True):
                    axis.axhspan(-half, half, color="0.9")
                    for length, colour in zip(g.lengths, colours(len(g.lengths)), strict=True):
                        for branch, style in ((1, "-"), (-1, "--")):
                            selected = g.selected & (s["branch"] == branch) & (np.abs(s["spine_length"] - length) < SAME_LENGTH)
                            _curve(axis, s["pressure"][selected], d.words.pascal, gap[selected] @ direction * 1e3, colour, style)
                    axis.set_title(f"{model},\n{word}")
                row[0].set_ylabel("measured minus\nmodel, mm")
            legend = axes[0, 0]
            if len(g.lengths) > 1:
                for length, colour in zip(g.lengths, colours(len(g.lengths)), strict=True):
                    legend.plot([], [], color=colour, label=f"spine {length * 100:.0f} cm")
            legend.plot([], [], "k-", label="load")
            legend.plot([], [], "k--", label="unload")
            legend.set_ylim(-most, most)
            for axis in axes[1]:
                axis.set_xlabel(d.words.axis)
            figure.suptitle(g.name, fontsize=9)
            figure.legend(*legend.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return pictures


def unseen_tips(d: Diagnosis, name: str, folder: Path) -> list[Path]:
    """Tip along the bending direction on the way up over pressure: measured, and three models on unseen states.

    A panel for each group of chambers and spine length, at most four lengths; below, by how much the calibrated model and the
    one with the cause (`name`) miss the tip there, in any direction."""
    s = _states(d)
    models = (("given", ":", GIVEN, "k"), ("calibrated_unseen", "--", CALIBRATED, GREY), ("explained_unseen", "-", name, BLUE))
    spines = np.ptp(s["spine_length"]) > SAME_LENGTH
    pictures = []
    for k, g in enumerate(groups(d)):
        shown = g.lengths[np.unique(np.linspace(0, len(g.lengths) - 1, 4).round().astype(int))]
        for j, length in enumerate(shown):
            selected = g.selected & (s["branch"] == 1) & (np.abs(s["spine_length"] - length) < SAME_LENGTH)
            if not selected.any():
                continue
            pictures.append(folder / f"unseen-{k}-{j}.svg")
            with drawing(pictures[-1], (3.9, 4.4), 2, sharex=True, height_ratios=(3, 2)) as (figure, (top, below)):
                for key, style, label, colour in models:
                    _curve(top, s["pressure"][selected], d.words.pascal, s[key][selected] @ g.side * 1e3, colour, style, label)
                    if key != "given":
                        missed = np.linalg.norm(s["tip"][selected] - s[key][selected], axis=1) * 1e3
                        _curve(below, s["pressure"][selected], d.words.pascal, missed, colour, style)
                tip = s["tip"][selected] @ g.side * 1e3
                top.plot(s["pressure"][selected] / d.words.pascal, tip, "o", color=RED, mfc="none", ms=4, label="measured")
                top.set(title=f"{g.name}{f', spine {length * 100:.0f} cm' if spines else ''}", ylabel="tip, mm")
                below.axhspan(0, d.locate.noise_floor_mm, color="0.9")
                below.set(xlabel=d.words.axis, ylabel="tip missed\nby, mm")
                figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    return pictures


def posterior(
    hypotheses: Sequence[Ranked] | Sequence[OfAnyModel], alike: Sequence[Sequence[str]], names: Mapping[str, str], path: Path
) -> Path:
    """Probability of each hypothesis, a star where data cannot distinguish it from another; `names` effect -> plain name."""
    ranking = [r for r in hypotheses if r.probability > 0.002][:10][::-1]
    labels = [fill(hypothesis_name(r.effects, names, ids=False), 30) for r in ranking]
    lines = sum(label.count("\n") + 1 for label in labels)
    tied = {e for group in alike for e in group}
    with drawing(path, (5.2, 0.7 + 0.14 * len(labels) + 0.2 * lines)) as (_, axis):
        shades = [RED if r.effects == ("unknown",) else GREY if not r.effects else BLUE for r in ranking]
        bars = axis.barh(range(len(labels)), [r.probability for r in ranking], 0.7, color=shades)
        axis.set_yticks(range(len(labels)), labels, fontsize=8)
        marks = [f"{r.probability:.2f}" + (" *" if set(r.effects) & tied else "") for r in ranking]
        axis.bar_label(bars, marks, fontsize=8, padding=3)
        axis.set(xlim=(0, 1.15), xticks=np.linspace(0, 1, 6), xlabel="probability")
        axis.grid(False, axis="y")
    return path


def _states(d: Diagnosis) -> dict[str, Array]:
    """Columns of the states; cells without a value are NaN."""
    found: dict[str, Any] = d.detail["states"]
    return {name: np.array(values, float) for name, values in found.items() if name != "chambers"}


def _levels(values: Array, grain: float) -> Array:
    """The settings, in order, about which readings (n,) scatter by less than `grain`: the mean of each group of readings."""
    return pd.Series(values).groupby(levels(values, grain / 2)).mean().to_numpy()


def _grain(pressure: Array) -> float:
    """Pa; readings that scatter by less were meant to be one setting."""
    return min(10e3, max(0.04 * float(np.nanmax(pressure)), 1.0))


def _drawn(s: dict[str, Array], gap: Array, of_branch: Mask, rows: Sequence[tuple[StateGroup, float]], pressures: Array) -> Array:
    """(rows, pressures) mm, rms of `gap` (n, 3) m of a branch by group and spine length and nearest pressure (Pa); NaN: none."""
    mapped = np.full((len(rows), len(pressures)), np.nan)
    column = np.abs(s["pressure"][:, None] - pressures).argmin(axis=1)
    squared = pd.Series((gap**2).sum(axis=1))
    for i, (group, length) in enumerate(rows):
        row = of_branch & group.selected & (np.abs(s["spine_length"] - length) < SAME_LENGTH)
        means = squared[row].groupby(column[row]).mean()
        mapped[i, means.index] = np.sqrt(means) * 1e3
    return mapped


def _curve(
    axis: Axes, pressure: Array, pascal: float, gap: Array, colour: tuple[float, ...] | str, style: str, label: str | None = None
) -> None:
    """Draw the mean `gap` (n,) mm at each setting of `pressure` (n,) Pa, in units of `pascal`; NaN interrupts the line."""
    known = np.isfinite(pressure)
    if not known.any():
        return
    curve = pd.DataFrame({"pressure": pressure[known] / pascal, "gap": gap[known]})
    means = curve.groupby(levels(pressure[known], 0.3 * _grain(pressure))).mean()
    axis.plot(means["pressure"], means["gap"], f".{style}", color=colour, lw=1.2, ms=4, label=label)


MODELS = {"calibrated": (GREY, "--", "s"), "explained": (BLUE, "-", "D")}
State = Mapping[str, Any]


def shapes(states: Sequence[State], name: str, folder: Path, words: Words) -> list[Path]:
    """A panel for each state, its backbones x and y over z in mm, the tip hanging down, and close up below; `name`: of the model
    with the cause."""
    names = dict(zip(MODELS, (CALIBRATED, name), strict=True))
    small = {"font.size": 8, "axes.titlesize": 8, "axes.titlelocation": "center"}
    pictures = [folder / f"shape-{k}.svg" for k in range(len(states))]
    for path, state in zip(pictures, states, strict=True):
        tips = np.vstack([_mm(state["measured_tip"]), *(_mm(state[model]["tip"]) for model in MODELS)])
        middle = np.nanmean(tips, axis=0)
        half = max(2.0, 1.25 * float(np.nanmax(np.abs(tips - middle))))  # mm, of the close-up's width: 4 mm at least
        with drawing(path, (4.0, 5.4), 2, 2, small, height_ratios=(3, 2)) as (figure, axes):
            for k, (whole, close) in enumerate(axes.T):
                for axis in (whole, close):
                    _draw(axis, state, k, names)
                    axis.set(xlabel=f"{'xy'[k]}, mm", ylabel="z, mm")
                whole.set_aspect("equal", adjustable="datalim")
                whole.invert_yaxis()
                close.set(xlim=(middle[k] - half, middle[k] + half), ylim=(middle[2] + half, middle[2] - half), aspect="equal")
                close.set_title(f"tip, {2 * half:.0f} mm wide")
            figure.suptitle(state_name(state, words), fontsize=9)
            figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8)
    return pictures


def state_name(state: State, words: Words) -> str:
    """Which state it is, for people."""
    parts = [f"spine {100 * state['spine_length']:.0f} cm"] if state["spine_length"] else []
    if state.get("chambers"):
        parts.append(words.group(state["chambers"]))
    parts += [f"{words.number(state['pressure'])} {words.unit}", state["branch"]]
    return f"{', '.join(parts)}\ntrial {state['trial']}, step {state['step']}"


def _draw(axis: Axes, state: State, k: int, names: Mapping[str, str]) -> None:
    """Coordinate k over z: backbones, their tips, and what was measured."""
    for model, (colour, line, mark) in MODELS.items():
        curve, tip = _mm(state[model]["backbone"]), _mm(state[model]["tip"])
        axis.plot(curve[:, k], curve[:, 2], line, color=colour, lw=1.4, label=names[model])
        axis.plot(tip[k], tip[2], mark, color=colour, ms=4)
    tip = _mm(state["measured_tip"])
    axis.plot(tip[k], tip[2], "o", color=RED, ms=6, mfc="none", mew=1.4, label="measured tip")
    if state["measured_markers"]:
        markers = _mm(state["measured_markers"])
        axis.plot(markers[:, k], markers[:, 2], "^", color=RED, ms=4, mfc="none", label="measured markers")


def _mm(metres: object) -> Array:
    return 1e3 * np.array(metres, float)


def pushes(stiffness: Mapping[str, Any], name: str, path: Path) -> Path:
    """Draw how far the calibrated model, and the one with the cause (`name`), miss the deflection over the deflection, a line a
    trial; `stiffness`: the diagnosis' detail of stiffness trials."""
    models = (("calibrated", CALIBRATED), ("explained", name))
    trial, deflection = np.array(stiffness["trial"]), np.array(stiffness["deflection"])
    pushed = zip(stiffness["specimen"], stiffness["spine_length"], strict=True)
    names = [f"{kind} {100 * length:.3g} cm" for kind, length in pushed]
    specimens = list(dict.fromkeys(names))
    with drawing(path, (4.8, 5.6), 2, sharex=True, sharey=True) as (figure, axes):
        for axis, (key, title) in zip(axes, models, strict=True):
            missed = 1e3 * (np.array(stiffness["force"]) - np.array(stiffness[key])) / np.array(stiffness["stiffness"])
            axis.axhspan(-stiffness["floor_mm"], stiffness["floor_mm"], color="0.9")
            for specimen, colour in zip(specimens, colours(len(specimens)), strict=False):
                for t in np.unique(trial[[n == specimen for n in names]]):
                    selected = trial == t
                    axis.plot(1e3 * deflection[selected], missed[selected], "-o", ms=2.5, lw=0.9, color=colour)
                axis.plot([], [], color=colour, label=specimen)
            axis.set(title=title, ylabel="measured minus model,\nmm of deflection")
        axes[1].set_xlabel("deflection, mm")
        figure.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center", fontsize=8, ncols=3)
    return path
