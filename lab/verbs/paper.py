"""`lab paper`: the paper's tables in, its model curves out, and how much of its error is the integrator's own.

Table I and II and the calibrated area factors are in examples/paper/robot.yaml; Table III (the error of the paper's
model against its measurements) is quoted here, because the measured tips themselves were not published.

Axes: the robot bends in the x-z plane of the base frame, away from the chambers at azimuth 0. The paper's X is that
direction, so its curves show -x; its Y runs along the hanging rod and is z.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from model.calibration import fit_area_factor_by_length
from model.compare import ErrorTable, error_table
from model.condition import States, conditions
from model.robot import Robot, load_robot
from model.rods import FINE, PAPER, Paper, solve
from model.section import combined_modulus, rods_of
from recordings.own_files import replaced

from ..console import PlainConsole
from ..console import out as screen
from ..files.example import paper_robot
from ..files.output_folder import demand_free, whole
from ..options import JSON, REPLACE, Verb, option
from ..pages import findings_figures, paper_figures
from ..paper.findings import Findings, find

Array = NDArray[np.float64]

OWN = (
    "model_curves.png", "backbones.png", "integrator_error.png", "area_factors.png", "finding_modulus.png", "finding_area.png",
    "finding_euler.png", "paper.json",
)  # fmt: skip
"""What is written, and replaced when the command is repeated."""
SPINE_LENGTHS = (0.0, 0.05, 0.10, 0.15, 0.20, 0.25, 0.30)
"""m, as in Fig. 5."""
PRESSURES = (50e3, 100e3, 150e3, 200e3, 250e3)
"""Pa gauge, as in Fig. 5."""
PRESSURISED = (8, 0, 1)
"""Columns of the three chambers inflated for bending: azimuths -40, 0, 40 deg."""
PUBLISHED_ERROR_X = (0.0127, 0.0078, 0.0090, 0.0096, 0.0132, 0.011, 0.00999)
"""m, Table III, by spine length."""
PUBLISHED_ERROR_Y = (0.0034, 0.0037, 0.0032, 0.0037, 0.0035, 0.0042, 0.0044)
"""m, Table III, by spine length."""
FINE_STEPS = 1000
SHAPE_ARCS = np.linspace(0.0, 1.0, 41)
"""Shares of the length at which the backbone is drawn."""


@dataclass(frozen=True)
class PaperReport:
    """The paper reproduced; all in SI, base frame, states in the order spine length (rows) by pressure (columns)."""

    robot: Robot
    steps: int
    """Euler steps of the paper's method."""
    spine_lengths: Array
    """(l,) m."""
    pressures: Array
    """(p,) Pa."""
    combined_modulus: Array
    """(l,) Pa, eq. 10."""
    converged: Array
    """(l, p, 3) m, tips of the converged rod."""
    euler: Array
    """(l, p, 3) m, tips of the paper's method."""
    shapes: Array
    """(l, k, 3) m, converged backbones at the highest pressure."""
    integrator: ErrorTable
    """Paper's method against the converged rod: the error of the integrator alone."""
    integrator_fine: ErrorTable
    """Same with `FINE_STEPS` steps."""
    published_error: Array
    """(l, 2) m, Table III: mean error in X and Y."""
    published_factor: Array
    """(l,) A_effect / A_norm as published."""
    converged_factor: Array
    """(l,) the factor with which the converged rod comes closest to the paper's own curves."""
    findings: Findings
    """What the published numbers say beyond themselves."""
    figures: tuple[Path, ...] = ()

    def as_dict(self) -> dict[str, object]:
        """JSON-able; lengths in m, pressures and moduli in Pa."""
        return {
            "schema": "paper/1",
            "robot": self.robot.name,
            "euler_steps": self.steps,
            "spine_lengths": self.spine_lengths.tolist(),
            "pressures": self.pressures.tolist(),
            "combined_modulus": self.combined_modulus.tolist(),
            "tips_converged": self.converged.tolist(),
            "tips_euler": self.euler.tolist(),
            "integrator_error": self.integrator.as_dict(),
            f"integrator_error_{FINE_STEPS}_steps": self.integrator_fine.as_dict(),
            "published_error_xy": self.published_error.tolist(),
            "area_factor_published": self.published_factor.tolist(),
            "area_factor_converged": self.converged_factor.tolist(),
            "findings": self.findings.as_dict(),
            "figures": [str(path) for path in self.figures],
        }

    def print(self, console: PlainConsole) -> None:
        """Show the tables."""
        console.print(self._tip_table())
        console.print(self._error_table())
        fine = max(row.worst for row in self.integrator_fine.rows)
        console.print(f"{FINE_STEPS} Euler steps instead of {self.steps} leave {fine * 1e3:.2f} mm of the integrator's error.\n")
        self.findings.print(console)

    def _tip_table(self) -> Table:
        table = Table(title="Model tips of Fig. 5, converged: sideways, down (mm)", title_justify="left")
        table.add_column("spine (cm)", justify="right")
        table.add_column("E_eq (MPa)", justify="right")
        for pressure in self.pressures:
            table.add_column(f"{pressure / 1e3:g} kPa", justify="right")
        for i, length in enumerate(self.spine_lengths):
            tips = [f"{-tip[0] * 1e3:.1f}, {tip[2] * 1e3:.1f}" for tip in self.converged[i]]
            table.add_row(f"{length * 100:g}", f"{self.combined_modulus[i] / 1e6:.3f}", *tips)
        return table

    def _error_table(self) -> Table:
        table = Table(title="Table III beside the integrator's own error (mm)", title_justify="left")
        for title in (
            "spine (cm)",
            "paper X",
            "integrator X",
            "paper Y",
            "integrator Y",
            "integrator worst",
            "A_eff/A_norm paper",
            "A_eff/A_norm converged",
        ):
            table.add_column(title, justify="right")
        for i, row in enumerate(self.integrator.rows):
            x, y = self.published_error[i] * 1e3
            table.add_row(
                f"{row.spine_length * 100:g}",
                f"{x:.1f}",
                f"{row.mean_abs_x * 1e3:.2f}",
                f"{y:.1f}",
                f"{row.mean_abs_z * 1e3:.2f}",
                f"{row.worst * 1e3:.2f}",
                f"{self.published_factor[i]:.2f}",
                f"{self.converged_factor[i]:.3f}",
            )
        return table


def bending_states(robot: Robot) -> States:
    """The 35 states of Fig. 5: spine lengths (slow) by pressures (fast), three chambers inflated."""
    length, pressure = (a.ravel() for a in np.meshgrid(SPINE_LENGTHS, PRESSURES, indexing="ij"))
    chambers = np.zeros((length.size, len(robot.actuators.azimuths_deg)))
    chambers[:, PRESSURISED] = pressure[:, None]
    return conditions(robot, length, chambers)


def run(out: Path, robot_file: Path | None = None, steps: int = PAPER.steps, whatever: bool = False) -> PaperReport:
    """Compute everything, write the figures (PNG) and paper.json into `out`, and return the report.

    `robot_file` is the paper's robot when None. Raises `model.errors.BadRobot` for a bad robot file, `SolveFailed`
    when a state of the paper has no trusted equilibrium. `whatever`: `out` is replaced whatever it holds.
    """
    demand_free(out, OWN, whatever)
    report = reproduce(load_robot(robot_file or paper_robot()), steps)
    with whole(out, OWN, whatever) as place:
        report = replace(report, figures=tuple(out / path.name for path in _draw(report, place)))
        replaced(place / "paper.json", json.dumps(report.as_dict(), indent=1) + "\n")
    return report


def reproduce(robot: Robot, steps: int = PAPER.steps) -> PaperReport:
    """The numbers alone."""
    states = bending_states(robot)
    highest = states[states.pressure.max(axis=1) == max(PRESSURES)]
    batch = rods_of(robot, states)
    converged, euler, fine = (solve(batch, m).trusted().tip for m in (FINE, Paper(steps), Paper(FINE_STEPS)))
    refitted = fit_area_factor_by_length(robot, states, euler)
    lengths = np.array(SPINE_LENGTHS)
    published = np.column_stack([PUBLISHED_ERROR_X, PUBLISHED_ERROR_Y])
    integrator = error_table(states, euler, converged, robot.length)
    grid = (len(SPINE_LENGTHS), len(PRESSURES), 3)
    return PaperReport(
        robot=robot,
        steps=steps,
        spine_lengths=lengths,
        pressures=np.array(PRESSURES),
        combined_modulus=combined_modulus(robot, lengths),
        converged=converged.reshape(grid),
        euler=euler.reshape(grid),
        shapes=solve(rods_of(robot, highest), FINE, arc_lengths=SHAPE_ARCS * robot.length).trusted().shape,
        integrator=integrator,
        integrator_fine=error_table(states, fine, converged, robot.length),
        published_error=published,
        published_factor=robot.area_factor_at(lengths),
        converged_factor=np.array([fit.factor.value for fit in refitted.values()]),
        findings=find(robot, states, integrator, published, [fit.rmse for fit in refitted.values()], steps),
    )


def main(out: Path, as_json: bool, whatever: bool = False) -> int:
    """The verb: reproduce into `out`, print tables or JSON."""
    report = run(out, whatever=whatever)
    if as_json:
        print(json.dumps(report.as_dict(), indent=1))
        return 0
    report.print(screen)
    for path in report.figures:
        screen.print(f"figure: {path}")
    return 0


def _draw(r: PaperReport, out: Path) -> tuple[Path, ...]:
    integrator = np.array([[row.mean_abs_x, row.mean_abs_z] for row in r.integrator.rows])
    arcs = SHAPE_ARCS * r.robot.length
    lengths, factors = r.spine_lengths, (r.published_factor, r.converged_factor)
    return (
        paper_figures.curves(lengths, r.pressures, r.converged, r.euler, r.steps, out / "model_curves.png"),
        paper_figures.backbones(lengths, r.shapes, arcs, r.pressures[-1], out / "backbones.png"),
        paper_figures.errors(lengths, r.published_error, integrator, r.steps, out / "integrator_error.png"),
        paper_figures.area_factors(lengths, *factors, r.steps, out / "area_factors.png"),
        *findings_figures.draw(r.findings, out),
    )


VERBS = (
    Verb(
        "paper",
        lambda a: main(a.out, a.json, a.replace),
        options=(
            JSON,
            option("--out", type=Path, default=Path("out/paper"), metavar="FOLDER", help="folder for the figures"),
            REPLACE,
        ),
        examples=("lab paper", "lab paper --out figures --json"),
        page="docs/explanations/model.md",
    ),
)
