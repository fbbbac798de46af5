"""`lab paper`, diagnosed: three things that the paper's published numbers say, with what they do not settle.

1. Table II's modulus grows 14-fold with length: in which form, and what that rules out (paper_moduli.py).
2. The calibrated chamber area grows from 1.5 to 2.4: how much of it eq. 10 makes (paper_area.py).
3. Table III's error: how much of it the explicit Euler step alone can make.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from model.compare import ErrorTable
from model.condition import States
from model.robot import Robot

from ..console import PlainConsole
from .area import AreaFindings, area_findings
from .moduli import ModuliFindings, modulus_forms

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StepFindings:
    """The integrator's own error beside the one that was published; m, by spine length, axes X and Y of the paper."""

    steps: int
    lengths: Array
    published: Array
    """(l, 2) Table III."""
    integrator: Array
    """(l, 2) mean absolute error of the integrator alone, same parameters."""
    worst: float
    """m, any state."""
    after_calibration: Array
    """(l,) rms tip error that is left when the area factor is fitted anew: calibration hides the rest."""

    @property
    def share(self) -> Array:
        """(l, 2) integrator / published."""
        out: Array = self.integrator / self.published
        return out

    def sentences(self) -> tuple[str, ...]:
        """What may be said."""
        low, high = self.share[:, 0].min(), self.share[:, 0].max()
        longest = self.lengths[self.share[:, 0].argmax()] * 100
        return (
            f"The Euler step with N = {self.steps} moves the tip by up to {self.worst * 1e3:.1f} mm. Against Table III that is "
            f"{low:.0%} to {high:.0%} of the mean error in X (most at {longest:g} cm) and {self.share[:, 1].min():.0%} to "
            f"{self.share[:, 1].max():.0%} in Y.",
            "This is what the step can cause, not a part to subtract: the paper does not give its N, and an A_eff fitted "
            "with the "
            f"same integrator absorbs all but {self.after_calibration.max() * 1e3:.2f} mm rms of it.",
        )

    def as_dict(self) -> dict[str, object]:
        """JSON-able; m."""
        return {
            "steps": self.steps,
            "worst": self.worst,
            "share_of_published_xy": self.share.tolist(),
            "rms_after_calibration": self.after_calibration.tolist(),
            "said": list(self.sentences()),
        }


@dataclass(frozen=True)
class Findings:
    """All three."""

    moduli: ModuliFindings
    area: AreaFindings
    step: StepFindings

    def as_dict(self) -> dict[str, object]:
        """JSON-able."""
        return {"modulus": self.moduli.as_dict(), "area_factor": self.area.as_dict(), "euler_step": self.step.as_dict()}

    def print(self, console: PlainConsole) -> None:
        """Tables and sentences."""
        parts = (
            ("1. Table II: what makes the modulus grow with length", _forms(self.moduli), self.moduli.sentences()),
            ("2. A_eff 1.5 -> 2.4: how eq. 10 mixes the spine in", _factors(self.area), self.area.sentences()),
            ("3. Table III: what the Euler step alone can cause", None, self.step.sentences()),
        )
        for title, table, sentences in parts:
            console.print(title, style="bold")
            if table is not None:
                console.print(table)
            for sentence in sentences:
                console.print(f"- {sentence}")
            console.print()


def find(robot: Robot, states: States, integrator: ErrorTable, published: Array, left: Sequence[float], steps: int) -> Findings:
    """From the paper's robot, its 35 states, and the integrator's error as `lab.verbs.paper` computes them.

    `published` (l, 2) m is Table III, `left` (l,) m the rms error after a new fit of the area factor. Raises ValueError
    for a robot without spine.
    """
    if robot.spine is None:
        raise ValueError(f"{robot.name}: has no spine table, so there is nothing to say about Table II")
    own = np.array([[row.mean_abs_x, row.mean_abs_z] for row in integrator.rows])
    lengths = np.array([row.spine_length for row in integrator.rows])
    worst = max(row.worst for row in integrator.rows)
    return Findings(
        modulus_forms(robot.spine.modulus, robot.spine.radius),
        area_findings(robot, states),
        StepFindings(steps, lengths, published, own, worst, np.array(left)),
    )


def _forms(found: ModuliFindings) -> Table:
    table = Table()
    for title in ("form", "E(L)", "rms of log E", "AICc", "leave one out"):
        table.add_column(title, justify="left" if title in ("form", "E(L)") else "right")
    for f in sorted(found.fits, key=lambda f: f.aicc):
        table.add_row(f.law.name, f.law.formula, f"{f.log_rms:.1%}", f"{f.aicc:.1f}", f"{f.leave_one_out:.1%}")
    return table


def _factors(found: AreaFindings) -> Table:
    table = Table()
    for title in (
        "spine (cm)",
        "EI by volume / added",
        "A_eff/A_norm paper",
        *(f"needed, {r.name}" for r in found.readings),
    ):
        table.add_column(title, justify="right")
    for i, length in enumerate(found.lengths):
        needed = [f"{r.needed[i]:.2f}" for r in found.readings]
        table.add_row(f"{length * 100:g}", f"{found.stiffness_ratio[i]:.2f}", f"{found.published[i]:.2f}", *needed)
    return table
