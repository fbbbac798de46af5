"""`lab compare`: compare measurements with the model, as in the paper's Table III and Fig. 5."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.table import Table as Sheet

from model.body import body_of
from model.compare import ErrorTable
from model.robot import Robot

from ..comparison import comparison
from ..console import note, out, titled
from ..files.inputs import read_case
from ..files.output_folder import demand_free, whole
from ..options import JSON, OF_CASE, OWN_EFFECTS, REPLACE, Result, Verb, path_option

OWN = ("compare.png", "sensors.png")
"""Files that the command writes, and replaces when it is repeated."""


def compare(inputs: Sequence[Path], robot: Path | None, folder: Path | None, replace: bool, effects: Path | None) -> Result:
    """The error table; with a folder also draw the curves. `effects`: file of effects of one's own."""
    demand_free(folder, OWN, replace, inputs)
    case = read_case(inputs, robot)
    words = case.robot.actuators.words
    c = comparison(case, effects)
    note(c.notes)
    pictures: dict[str, str | None] = {"figure": None, "sensors": None}
    if folder is not None:
        from ..pages.figures import in_a_row, quantities, sensors, tip_curves

        with whole(folder, OWN, replace, inputs) as (place, _):
            pictures["figure"] = str(folder / in_a_row(tip_curves(c, words), place / "compare.png").name)
            if quantities(case.table):
                pictures["sensors"] = str(folder / in_a_row(sensors(case.table, words), place / "sensors.png").name)

    def show() -> None:
        out.print(sheet(c.table, case.robot))
        if c.markers:
            out.print(f"rms of markers: {', '.join(f'{name} {1e3 * off:.2f} mm' for name, off in c.markers.items())}")
        if c.elongation:
            lowest = f"Elongation from the lowest {words.pressure}"
            rows = (
                (f"{100 * length:.1f} cm", f"{words.number(pressure)} {words.unit}", *(f"{1e3 * x:.2f} mm" for x in longer))
                for length, pressure, *longer in c.elongation
            )
            out.print(titled(lowest, ("spine", words.pressure, "measured", "model"), rows))
        if c.unsolved:
            out.print(f"{c.unsolved} states have no trusted equilibrium in the model and are left out")
        for path in filter(None, pictures.values()):
            out.print(f"figure: {path}")

    more = {"notes": c.notes, "unsolved": c.unsolved, "clipped": int(case.table.clipped.sum()), **pictures}
    return Result({**c.table.as_dict(), "markers": c.markers, "elongation": c.elongation, **more}, show)


def sheet(table: ErrorTable, robot: Robot) -> Sheet:
    """The error table in mm, and in % of the robot's length."""
    spine = robot.spine is not None
    columns = (*(("spine",) if spine else ()), "states", "x", "y", "z", "rms", "worst")
    t = titled(f"Measured against model: mean absolute error of the tip{thrust_taken(robot)}", (), (), columns)
    for r in table.rows:
        length = (f"{r.spine_length * 100:.1f} cm",) if spine else ()
        errors = (r.mean_abs_x, r.mean_abs_y, r.mean_abs_z, r.rmse, r.worst)
        t.add_row(*length, str(r.n), *(f"{v * 1e3:.2f} mm" for v in errors))
    percentages = ", ".join(f"{table.worst_percent(axis):.2f} % in {axis}" for axis in "xyz")
    t.caption = f"largest mean error in % of the length: {percentages}; rms {table.rmse * 1e3:.2f} mm"
    return t


def thrust_taken(robot: Robot) -> str:
    """The law of thrust by which a chambers' robot was solved, for a title; "" of tendons."""
    if robot.chambers is None:
        return ""
    early = body_of(robot).uncapped if robot.thrust != "walls" else []
    taken = robot.thrust or "cap (not stated: lab diagnose settles it)"
    return f", thrust: {taken}" + f", walls of {robot.actuators.words.group(early)}" * bool(early)


VERBS = (
    Verb(
        "compare",
        lambda a: compare(a.inputs, a.robot, a.out, a.replace, a.effects),
        options=(
            JSON,
            *OF_CASE,
            path_option("--out", "FOLDER", "folder for the figures"),
            REPLACE,
            OWN_EFFECTS,
        ),
        examples=("lab compare runs/*.mcap", "lab compare case --robot robot.yaml --out figures"),
        page="docs/tutorials/first-day.md",
    ),
)
