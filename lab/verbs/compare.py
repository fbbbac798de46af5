"""`lab compare`: measured against model, as the paper's Table III and Fig. 5 do it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table as Sheet

from diagnosis.errors import DiagnosisError
from model.compare import ErrorTable
from model.robot import Robot

from ..comparison import comparison
from ..console import note, out
from ..files.config import ConfigError, load
from ..files.inputs import marked_notes, read_case
from ..files.output_folder import demand_free, whole
from ..files.own_effects import stated_by
from ..files.robot_file import paper_robot
from ..options import ANY_SIZE, INPUTS, JSON, REPLACE, ROBOT, Result, Verb, option
from ..pages.figures import in_a_row, quantities, sensors, tip_curves

OWN = ("compare.png", "sensors.png")
"""What is written, and replaced when the command is repeated."""


def compare(inputs: Sequence[Path], robot: Path | None, folder: Path | None, replace: bool = False) -> Result:
    """The error table; with a folder also draw the curves."""
    if folder is not None:
        demand_free(folder, OWN, replace, inputs)
    case = read_case(inputs, robot)
    note(case.table.warnings)
    try:
        c = comparison(case, stated_by(case.robot))
    except DiagnosisError as e:
        raise ConfigError(str(e)) from e
    figure = measured = None
    if folder is not None:
        words = case.robot.actuators.words
        with whole(folder, OWN, replace, inputs) as place:
            figure = folder / in_a_row(tip_curves(c, words), place / "compare.png").name
            if quantities(case.table):
                measured = folder / in_a_row(sensors(case.table, words), place / "sensors.png").name

    def show() -> None:
        out.print(sheet(c.table, case.robot))
        note(marked_notes(case.table))
        if c.unsolved:
            out.print(f"{c.unsolved} states have no trusted equilibrium in the model and are left out")
        for path in (figure, measured):
            if path:
                out.print(f"figure: {path}")

    pictures = {"figure": str(figure) if figure else None, "sensors": str(measured) if measured else None}
    data = {**c.table.as_dict(), "unsolved": c.unsolved, "clipped": int(case.table.clipped.sum()), **pictures}
    return Result(data, show)


def sheet(table: ErrorTable, robot: Robot) -> Sheet:
    """The error table in mm; of the paper's robot with the paper's names of the axes, and in % of the robot's length."""
    paper = _of_the_paper(robot)
    named = ("x (paper: X)", "z (paper: Y)", "y (out of plane)") if paper else ("x", "y", "z")
    with_spine = robot.spine is not None
    t = Sheet(title="Measured against model: mean absolute error of the tip", title_justify="left")
    for column in (*(("spine",) if with_spine else ()), "states", *named, "rms", "worst"):
        t.add_column(column, justify="right")
    for r in table.rows:
        along = (r.mean_abs_x, r.mean_abs_z, r.mean_abs_y) if paper else (r.mean_abs_x, r.mean_abs_y, r.mean_abs_z)
        length = (f"{r.spine_length * 100:.1f} cm",) if with_spine else ()
        t.add_row(*length, str(r.n), *(f"{v * 1e3:.2f} mm" for v in (*along, r.rmse, r.worst)))
    worst = {"X": table.worst_percent_x, "Y": table.worst_percent_z} if paper else {
        axis: 100 * max(getattr(r, f"mean_abs_{axis}") for r in table.rows) / table.length for axis in "xyz"
    }  # fmt: skip
    percentages = ", ".join(f"{percent:.2f} % in {axis}" for axis, percent in worst.items())
    t.caption = f"largest mean error in % of the length: {percentages}; rms {table.rmse * 1e3:.2f} mm"
    return t


def _of_the_paper(robot: Robot) -> bool:
    """Whether a robot has the length and the chambers of the paper's, which bends in the plane of its tables."""
    paper = load(paper_robot(), Robot)
    return (robot.length, robot.chambers) == (paper.length, paper.chambers)


VERBS = (
    Verb(
        "compare",
        lambda a: compare(a.inputs, a.robot, a.out, a.replace),
        options=(
            JSON,
            ANY_SIZE,
            INPUTS,
            ROBOT,
            option("--out", type=Path, metavar="FOLDER", help="folder for the figures"),
            REPLACE,
        ),
        examples=("lab compare runs/*.mcap", "lab compare case --robot robot.yaml --out figures"),
        page="docs/tutorials/first-day.md",
    ),
)
