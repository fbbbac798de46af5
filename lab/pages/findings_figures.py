"""The figures of the findings: Table II against forms, needed chamber areas, the integrator's share of the error."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from ..paper.area import AreaFindings
from ..paper.findings import Findings, StepFindings
from ..paper.moduli import ModuliFindings
from .figures import STYLE, save

PAPER, FIRST, SECOND, WEAK = "#8a8a8a", "#b5382a", "#1f5a7a", "#b9b9b9"
SHOWN = {"shear-like": (FIRST, "-", 2.0), "affine": (SECOND, "--", 1.4), "root translation": (WEAK, "-.", 1.2),
         "root rotation": (WEAK, ":", 1.6), "constant": (WEAK, "-", 1.0)}  # fmt: skip


def draw(found: Findings, out: Path) -> tuple[Path, ...]:
    """All of them, as PNG in `out`."""
    return (
        moduli(found.moduli, out / "finding_modulus.png"),
        areas(found.area, out / "finding_area.png"),
        step(found.step, out / "finding_euler.png"),
    )


def moduli(found: ModuliFindings, path: Path) -> Path:
    """Apparent modulus over length with the forms, and each form's error: fitted, and at a length left out."""
    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.9), layout="constrained", width_ratios=[1.15, 1])
        x = np.linspace(0.04, 0.31, 300)
        for f in found.fits:
            if f.law.name in SHOWN:
                colour, dash, width = SHOWN[f.law.name]
                y = f.law.form(np.array(f.values), x)
                left.plot(x[y > 0] * 100, y[y > 0], dash, color=colour, lw=width, label=f"{f.law.name}, {f.log_rms:.0%}")
        left.plot(found.lengths * 100, found.moduli, "s", ms=6, color="0.15", zorder=4, label="Table II")
        left.set_yscale("log")
        left.set_ylim(0.2, 9)
        ticks = [0.3, 0.5, 1, 2, 4, 8]
        left.set_yticks(ticks, [f"{t:g}" for t in ticks])
        left.minorticks_off()
        left.set_xlabel("spine length (cm)")
        left.set_ylabel("apparent modulus (MPa)")
        left.legend(loc="lower right", fontsize=8)
        fits = sorted(found.fits, key=lambda f: f.leave_one_out, reverse=True)
        at = np.arange(len(fits))
        right.barh(at + 0.19, [100 * f.log_rms for f in fits], 0.36, color=WEAK, label="fitted")
        bars = right.barh(at - 0.19, [100 * f.leave_one_out for f in fits], 0.36, color=SECOND, label="at a length left out")
        right.bar_label(bars, fmt="%.0f", fontsize=7, padding=2, color="0.25")
        right.set_yticks(at, [f.law.name for f in fits])
        right.grid(False, axis="y")
        right.set_xlabel("rms error of log E (%)")
        right.legend(loc="upper right", fontsize=8)
        return save(figure, path)


def areas(found: AreaFindings, path: Path) -> Path:
    """A_eff over spine length, published and needed with stiffnesses added; and the bending stiffness behind it."""
    with plt.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.7), layout="constrained", width_ratios=[1.25, 1])
        cm = found.lengths * 100
        left.plot(cm, found.published, "-s", ms=5, lw=1.3, color=PAPER, label="paper: moduli mixed by volume")
        for r, colour, mark in zip(found.readings, (FIRST, SECOND), ("o", "^"), strict=True):
            left.plot(cm, r.needed, f"-{mark}", ms=5, lw=1.3, mfc="white", color=colour, label=f"stiffnesses added;\n{r.name}")
        left.set_ylim(1.3, None)
        left.set_xticks(cm)
        left.set_xlabel("spine length (cm)")
        left.set_ylabel("effective / geometric chamber area needed")
        left.legend(loc="upper left", fontsize=8)
        right.axhline(1, color="0.4", lw=0.8, ls=":")
        right.plot(cm, found.stiffness_ratio, "-D", ms=5, lw=1.3, color="0.15")
        right.set_xticks(cm)
        right.set_xlabel("spine length (cm)")
        right.set_ylabel("bending stiffness, by volume / added")
        dip = (cm[1], found.stiffness_ratio[1])
        line = {"arrowstyle": "-", "color": "0.6"}
        right.annotate("eq. 10 makes the part\nwith spine softer", dip, (9, 0.83), fontsize=8, color="0.3", arrowprops=line)
        return save(figure, path)


def step(found: StepFindings, path: Path) -> Path:
    """The integrator's own error as a share of the published one, by spine length."""
    with plt.rc_context(STYLE):
        figure, axis = plt.subplots(figsize=(5.4, 3.4), layout="constrained")
        at = np.arange(len(found.lengths))
        for k, (name, colour) in enumerate((("X, sideways", FIRST), ("Y, down", SECOND))):
            bars = axis.bar(at + 0.4 * k - 0.2, 100 * found.share[:, k], 0.38, color=colour, label=name)
            axis.bar_label(bars, fmt="%.0f", fontsize=7, padding=1, color="0.25")
        axis.set_xticks(at, [f"{x * 100:g}" for x in found.lengths])
        axis.grid(False, axis="x")
        axis.set_xlabel("spine length (cm)")
        axis.set_ylabel(f"Euler, {found.steps} steps: error as % of Table III's")
        axis.legend()
        return save(figure, path)
