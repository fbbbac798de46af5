"""`lab effects`: the catalogue of effects with the signature of each, so that a person knows what to look for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.table import Table

from model.effects import Parameter
from model.effects.spec import STAGES
from model.robot import Robot, load_robot

from ..console import note, styled
from ..console import out as screen
from ..files.config import load
from ..files.output_folder import demand_free, whole
from ..files.own_effects import catalogue
from ..files.robot_file import paper_robot
from ..options import JSON, OWN_EFFECTS, REPLACE, Result, Verb, option
from ..signatures import Signature, signatures

OWN = ("signatures.png",)
"""What is written, and replaced when the command is repeated."""


def run(out: Path, robot: Robot | None = None, more: Path | None = None, replace: bool = False) -> Result:
    """The catalogue; draws signatures.png into `out`; `more` is a file with effects of one's own.

    Raises ConfigError, `BadEffect` when that file declares effects wrongly.
    """
    demand_free(out, OWN, replace)
    shown = robot if robot is not None else load_robot(paper_robot())
    effects, left_out = catalogue(shown, more)
    note(left_out)
    found = signatures(shown.plain, effects)
    from ..pages.effects_figure import draw

    with whole(out, OWN, replace) as place:
        figure = out / draw(found, place / "signatures.png").name

    def show() -> None:
        screen.print(_table(found, shown.name))
        screen.print(f"signatures drawn in {figure}")

    return Result({"schema": "effects/1", "figure": str(figure), "effects": [_as_dict(s) for s in found]}, show)


def _table(found: list[Signature], robot: str) -> Table:
    table = Table(title=f"Effects at their plausible size: how far each moves the tip of {robot}", title_justify="left")
    table.add_column("effect", no_wrap=True)
    table.add_column("plausible size")
    table.add_column("moves", justify="right", no_wrap=True)
    table.add_column("hidden*", justify="right", no_wrap=True)
    table.add_column("best seen in")
    for stage in STAGES:
        for i, s in enumerate([s for s in found if s.effect.stage == stage]):
            if i == 0:
                table.add_section()
                table.add_row(styled(stage, "bold"))
            drawn = s.how != "none"
            moves = f"{s.rms * (1 if s.unit == 'N' else 1e3):.2g} {s.unit}" if drawn else "nothing"
            hidden = f"{100 * s.hidden:.0f} %" if s.unit == "mm" and drawn else ""
            sizes = ", ".join(_size(p) for p in s.effect.parameters if p.role == "size")
            table.add_row(f" {s.effect.id}", sizes, moves, hidden, s.effect.seen_best_in)
    table.caption = "* share of the squared tip change that one common factor on the chamber area would absorb"
    return table


def _size(p: Parameter) -> str:
    """Name and plausible size as a person reads it."""
    factor, unit = {"Pa": (1e-3, "kPa"), "m": (1e3, "mm"), "rad": (180 / np.pi, "deg"), "1": (1.0, "")}.get(p.unit, (1.0, p.unit))
    return f"{p.name} {factor * p.scale:.3g} {unit}".strip()


def _as_dict(s: Signature) -> dict[str, object]:
    return {
        "id": s.effect.id,
        "stage": s.effect.stage,
        "family": s.effect.family_id,
        "equation": s.effect.equation,
        "citation": s.effect.citation,
        "seen_best_in": s.effect.seen_best_in,
        "parameters": [
            {"name": p.name, "unit": p.unit, "scale": p.scale, "low": p.low, "high": p.high, "role": p.role}
            for p in s.effect.parameters
        ],
        "read": s.how,
        "rms": s.rms,
        "hidden_by_area": s.hidden,
    }


VERBS = (
    Verb(
        "effects",
        lambda a: run(a.out, load(a.robot, Robot) if a.robot else None, a.effects, a.replace),
        options=(
            JSON,
            option("--out", type=Path, default=Path("out/effects"), metavar="FOLDER", help="folder for the picture"),
            REPLACE,
            option("--robot", type=Path, metavar="ROBOT.yaml", help="robot.yaml (default: the paper's robot)"),
            OWN_EFFECTS,
        ),
        examples=("lab effects", "lab effects --robot robot.yaml --effects my_effects.py"),
        page="docs/explanations/effects.md",
    ),
)
