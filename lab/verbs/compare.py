"""`lab compare`: measured against model, as the paper's Table III and Fig. 5 do it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table as Sheet

from diagnosis.errors import DiagnosisError
from model.compare import ErrorTable

from ..comparison import comparison
from ..console import note, out
from ..files.config import ConfigError
from ..files.inputs import marked_notes, read_case
from ..files.own_effects import stated_by
from ..pages.figures import tip_curves
from ..pages.sensors_figure import quantities, sensors


def compare(inputs: Sequence[Path], robot: Path | None, folder: Path | None, as_json: bool) -> int:
    """Print the error table; with a folder also draw the curves."""
    case = read_case(inputs, robot)
    note(case.table.warnings)
    try:
        c = comparison(case, stated_by(case.robot))
    except DiagnosisError as e:
        raise ConfigError(str(e)) from e
    figure = measured = None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        figure = tip_curves(c, folder / "compare.png")
        measured = sensors(case.table, folder / "sensors.png") if quantities(case.table) else None
    if as_json:
        data: dict[str, Any] = {**c.table.as_dict(), "unsolved": c.unsolved, "clipped": len(case.table.clipped)}
        data["figure"] = str(figure) if figure else None
        data["sensors"] = str(measured) if measured else None
        print(json.dumps(data, indent=1))
        return 0
    out.print(sheet(c.table))
    note(marked_notes(case.table))
    if c.unsolved:
        out.print(f"{c.unsolved} states have no trusted equilibrium in the model and are left out")
    for path in (figure, measured):
        if path:
            out.print(f"figure: {path}")
    return 0


def sheet(table: ErrorTable) -> Sheet:
    """The error table as the paper prints it, in mm and in % of the robot's length."""
    t = Sheet(title="Measured against model: mean absolute error of the tip", title_justify="left")
    for column in ("spine", "n", "x (paper: X)", "z (paper: Y)", "y (out of plane)", "rms", "worst"):
        t.add_column(column, justify="right")
    for r in table.rows:
        t.add_row(
            f"{r.spine_length * 100:.1f} cm", str(r.n),
            *(f"{v * 1e3:.2f} mm" for v in (r.mean_abs_x, r.mean_abs_z, r.mean_abs_y, r.rmse, r.worst)),
        )  # fmt: skip
    t.caption = (
        f"largest mean error: {table.worst_percent_x:.2f} % of the length in X, {table.worst_percent_z:.2f} % in Y; "
        f"rms {table.rmse * 1e3:.2f} mm"
    )
    return t
