"""`lab effects`: the catalogue of effects with the signature of each.

A signature is how far an effect of plausible size moves the tip over pressure and spine length, up and down, against the model
without it; effects of stiffness trials are shown as force over deflection. The part that calibration would hide is also stated:
the share of the signature that one common factor on the chamber area could take over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from rich.table import Column, Table

from diagnosis.answer.headline import for_people
from model.actuators import Words
from model.arrays import Array
from model.effects import CATALOGUE, EffectSpec, ForwardModel, design_from_columns
from model.effects.design import Columns
from model.effects.scales import scales
from model.effects.spec import STAGES
from model.robot import Robot, load_robot
from recordings.trials import highest, pressure_columns

from ..console import note, styled
from ..console import out as screen
from ..files.config import load
from ..files.output_folder import demand_free, whole
from ..files.own_effects import catalogue
from ..files.robot_file import paper_robot
from ..options import JSON, OWN_EFFECTS, REPLACE, Result, Verb, path_option
from ..pages.figures import colours, drawing

OWN = ("signatures.png",)
"""What is written, and replaced when the command is repeated."""
LEVELS = np.linspace(0.0, 1.0, 11)
"""Shares of the largest pressure, up and down again."""
RATE, HOLD = 25e3, 2.0
"""Pa/s and s of the ramps in between."""
DEFLECTIONS = np.linspace(0.0, 0.02, 9)
"""Of the specimen's length."""

LEAST_CHANGE = 1e-5
"""m or N; smaller changes are no signature."""


@dataclass(frozen=True)
class Signature:
    """How one effect of plausible size changes the readings."""

    effect: EffectSpec
    how: str
    """How the states were read: settled, while ramping, stiffness, with one chamber alone, or none if none of these shows it."""
    spine_length: Array
    """(l,) m."""
    x: Array
    """(l, k) Pa of the group, or m of deflection, in the order of time."""
    change: Array
    """(l, k, 3) m, base frame; for stiffness rows (l, k, 1) N."""
    axis: int
    hidden: float
    """Share (0..1) of the squared change that one factor on the chamber area could take over."""

    @property
    def rms(self) -> float:
        """Root mean square of the change, m or N."""
        return float(np.sqrt((self.change**2).sum(axis=-1).mean())) if self.change.size else 0.0


def signatures(robot: Robot, effects: Mapping[str, EffectSpec] = CATALOGUE) -> list[Signature]:
    """The signature of every effect, on the first kind of experiment that shows it."""
    spines = robot.length * np.array([0.0, 0.375, 0.75]) if robot.spine is not None else np.zeros(1)
    sized = scales(robot)
    alone = {f"{robot.actuators.words.group([c + 1])} alone": {c} for c in range(len(robot.actuators.azimuths_deg))}
    tried = [(how, _columns(robot, spines, how, alone.get(how))) for how in ("settled", "while ramping", "stiffness", *alone)]
    models = [
        (how, columns, ForwardModel(robot, design_from_columns(robot, columns), "per_length", effects, sized=sized))
        for how, columns in tried
        if how != "stiffness" or robot.spine is not None
    ]
    return [_signature(spec.of(sized), models) for spec in effects.values()]


def _signature(spec: EffectSpec, models: list[tuple[str, Columns, ForwardModel]]) -> Signature:
    """The change by an effect of plausible size in the first of `models` (kind, columns of states, model) that shows it."""
    for how, columns, forward in models:  # noqa: B007 (used after the loop)
        theta = np.zeros(len(forward.parameters))
        without = forward.predict(theta)
        for k in forward.index(spec.id):
            p = forward.parameters[k]  # counted from what robot.yaml states: of what is whole there, less remains
            theta[k] = (min(p.sd, p.high) or max(-p.sd, p.low)) if p.role == "size" else p.starts[0]
        change = forward.predict(theta) - without
        if np.nanmax(np.abs(change)) > LEAST_CHANGE:
            break
    else:
        none = np.zeros((0, 0))
        return Signature(spec, "none", np.zeros(0), none, none[..., None], 0, 0.0)
    components = 1 if how == "stiffness" else 3  # of a force along its axis, or of the tip
    rows = change.reshape(-1, components)
    spine = np.unique(np.asarray(columns["spine_length"], float))
    of_x = pressure_columns(highest(columns)[0]) or ("deflection",)  # of the chambers one group is inflated
    x = np.max([np.asarray(columns[name], float) for name in of_x], axis=0).reshape(len(spine), -1)
    axis = int(np.nanargmax(np.nansum(rows**2, axis=0)))
    hidden = 0.0
    if components == 3:
        # A common factor on all areas moves the tips by the sum of what those of the single lengths do.
        area = forward.linearise(np.zeros(len(forward.parameters)))[1][:, forward.index("area")].sum(axis=1)
        ok = np.isfinite(change) & np.isfinite(area)
        total = float(change[ok] @ change[ok]) * float(area[ok] @ area[ok])
        hidden = float(change[ok] @ area[ok]) ** 2 / total if total > 0 else 0.0
    return Signature(spec, how, spine, x, rows.reshape(len(spine), -1, components), axis, hidden)


def _columns(robot: Robot, spines: Array, how: str, group: set[int] | None = None) -> Columns:
    """Columns of trials.csv of a campaign: chambers `group` (default: the first, of many with its neighbours) up and down at each
    spine length (m), or pushes."""
    if how == "stiffness":
        spines = robot.length * np.array([0.25, 0.5, 0.75])
        n = DEFLECTIONS.size
        spine = np.repeat(spines, n)
        return {
            "trial": np.repeat(np.arange(3), n),
            "protocol": np.full(3 * n, "stiffness"),
            "specimen": np.full(3 * n, "spine"),
            "spine_length": spine,
            "deflection": np.tile(DEFLECTIONS, 3) * spine,
            "force": np.zeros(3 * n),
        }
    pressure = scales(robot).pressure * np.concatenate([LEVELS, LEVELS[-2::-1]])
    branch = np.repeat(["load", "unload"], [LEVELS.size, LEVELS.size - 1])
    hold = 0.0 if how == "while ramping" else HOLD
    time = np.cumsum(np.abs(np.diff(pressure, prepend=0.0)) / RATE + hold)
    n, count = pressure.size, len(spines)
    chambers = len(robot.actuators.azimuths_deg)
    group = group or ({0, 1, chambers - 1} if chambers >= 6 else {0})
    pressures = {f"p{c + 1}": np.tile(pressure if c in group else 0 * pressure, count) for c in range(chambers)}
    return {
        "trial": np.repeat(np.arange(count), n),
        "branch": np.tile(branch, count),
        "t": np.tile(time, count),
        "rate": np.full(n * count, RATE),
        "hold": np.full(n * count, hold),
        "spine_length": np.repeat(spines, n),
        **pressures,
        **dict.fromkeys("xyz", np.zeros(n * count)),
    }


PANELS = 5
"""In a row of the figure."""


def draw(effect_signatures: list[Signature], path: Path, words: Words) -> Path:
    """Draw all signatures into one picture, without effects that move nothing."""
    effect_signatures = [s for s in effect_signatures if s.how != "none"]
    rows = -(-len(effect_signatures) // PANELS)
    small = {"font.size": 7.5, "axes.titlesize": 8.5, "axes.labelpad": 1}
    with drawing(path, (13, 2.1 * rows + 0.4), rows, PANELS, small, squeeze=False) as (figure, axes):
        for axis, signature in zip(axes.flat, effect_signatures, strict=False):
            _panel(axis, signature, words)
        for axis in axes.flat[len(effect_signatures) :]:
            axis.set_axis_off()
        longest = max(effect_signatures, key=lambda s: (s.how != "stiffness", len(s.spine_length)))
        lengths = zip(longest.spine_length, colours(len(longest.spine_length)), strict=True) if any(longest.spine_length) else ()
        handles = [Line2D([], [], color=colour, label=f"{length * 100:g} cm spine") for length, colour in lengths]
        ways = [Line2D([], [], color="0.3", ls=style, label=way) for way, style in (("load", "-"), ("unload", (0, (3, 2))))]
        figure.legend(handles=[*handles, *ways], loc="outside upper left", ncols=8)
    return path


def _panel(axis: Axes, s: Signature, words: Words) -> None:
    """Draw one signature: a curve for each spine length, dashed on the way down."""
    stiffness = s.how == "stiffness"
    changes = s.change[..., s.axis] * (1.0 if stiffness else 1e3)  # of the component that moves most, mm or N
    for x, y, colour in zip(s.x, changes, colours(len(s.x)), strict=True):
        top = int(np.argmax(x))
        scaled = x * 1e3 if stiffness else x / words.pascal
        axis.plot(scaled[: top + 1], y[: top + 1], color=colour, lw=1.2)
        axis.plot(scaled[top:], y[top:], color=colour, lw=1.0, ls=(0, (3, 2)))
    axis.axhline(0.0, color="0.6", lw=0.6, zorder=0)
    over, changed = ("deflection, mm", "force, N") if stiffness else (words.axis, f"tip {'xyz'[s.axis]}, mm")
    axis.set(title=s.effect.id if s.how == "settled" else f"{s.effect.id} ({s.how})", xlabel=over, ylabel=changed)


def run(out: Path, robot: Robot | None = None, more: Path | None = None, replace: bool = False) -> Result:
    """The catalogue, drawn into `out` as signatures.png; `more`: a file of one's own effects. Raises ConfigError, `BadEffect`."""
    demand_free(out, OWN, replace)
    shown = robot if robot is not None else load_robot(paper_robot())
    effects, left_out = catalogue(shown, more)
    note(left_out)
    effect_signatures = signatures(shown.plain, effects)
    with whole(out, OWN, replace) as (place, _):
        figure = out / draw(effect_signatures, place / "signatures.png", shown.actuators.words).name

    def show() -> None:
        screen.print(_table(effect_signatures, shown))
        screen.print(f"signatures drawn in {figure}")

    return Result({"schema": "effects/1", "figure": str(figure), "effects": [_as_dict(s) for s in effect_signatures]}, show)


def _table(effect_signatures: list[Signature], robot: Robot) -> Table:
    """Effects by stage, with plausible size, how far each moves the tip, and what calibration would hide of it."""
    words = robot.actuators.words
    numbers = (Column(name, justify="right", no_wrap=True) for name in ("moves", "hidden*"))
    table = Table(Column("effect", no_wrap=True), "plausible size", *numbers, "best seen in", title_justify="left")
    table.title = f"Effects at their plausible size: how far each moves the tip of {robot.name}"
    for stage in STAGES:
        for i, s in enumerate([s for s in effect_signatures if s.effect.stage == stage]):
            if i == 0:
                table.add_section()
                table.add_row(styled(stage, "bold"))
            visible = s.how != "none"
            factor, unit = (1, "N") if s.how == "stiffness" else (1e3, "mm")
            moves = f"{s.rms * factor:.2g} {unit}" if visible else "nothing"
            hidden = f"{100 * s.hidden:.0f} %" if unit == "mm" and visible else ""
            of_size = ((p.name, *for_people(p.scale, p.unit, words)) for p in s.effect.parameters if p.role == "size")
            sizes = ", ".join("{} {:.3g} {}".format(*size).strip() for size in of_size)
            table.add_row(f" {s.effect.id}", sizes, moves, hidden, s.effect.seen_best_in)
    table.caption = "* share of the squared tip change that one common factor on the chamber area would absorb"
    return table


def _as_dict(s: Signature) -> dict[str, object]:
    """An effect and its signature as JSON has them; `rms` in m or N."""
    return {
        **{key: getattr(s.effect, key) for key in ("id", "stage", "equation", "citation", "seen_best_in")},
        "family": s.effect.family_id,
        "parameters": [
            {key: getattr(p, key) for key in ("name", "unit", "scale", "low", "high", "role")} for p in s.effect.parameters
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
            path_option("--out", "FOLDER", "folder for the picture", default=Path("out/effects")),
            REPLACE,
            path_option("--robot", "ROBOT.yaml", "robot.yaml (default: the paper's robot)"),
            OWN_EFFECTS,
        ),
        examples=("lab effects", "lab effects --robot robot.yaml --effects my_effects.py"),
        page="docs/explanations/effects.md",
    ),
)
