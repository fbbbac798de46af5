"""`lab blind make`: draw the truth, measure every case, seal the truth, publish its digest."""

from __future__ import annotations

import csv
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from model.effects.catalogue import CATALOGUE
from model.robot import Robot
from recordings.table_file import write_csv
from recordings.trials import Table
from sim_fakes.virtual_robot import NoEquilibrium

from ..files.baseline import from_simulator, simulator
from ..files.config import ConfigError, check, parse_yaml
from ..files.example import paper_robot
from ..files.inputs import read_case
from .bench_robot import BenchRobot
from .designs import Design, design, joined
from .drive import measure
from .folder import SetFolder, new_set, seal
from .geometry import GEOMETRIES, Geometry
from .sweeps import BASE, BASE_SETTLED, MENU, Sweep
from .truth import Recipe, Truth, draw, draw_one
from .wire import measure_by_wire
from .workers import Crew, spread

PREDICTED = "predicted.csv"
"""In a case folder: what another simulator predicts of its states."""
ATTEMPTS = 20
"""Draws of sizes for one case until the robot keeps its equilibrium through all experiments."""
NOMINAL_AREA_FACTOR = 1.6
DESCRIBED = {
    "outer_radius": ("outer_radius",), "inner_radius": ("inner_radius",), "spine_radius": ("spine", "radius"),
    "chamber_radius": ("chambers", "radius"), "chamber_path_radius": ("chambers", "path_radius"),
    "chamber_azimuths_deg": ("chambers", "azimuths_deg"),
}  # fmt: skip
"""Where fields of `RobotTruth` stand in robot.yaml."""


@dataclass(frozen=True)
class Order:
    """What one worker makes."""

    truth: Truth
    recipe: Recipe
    design: Design
    folder: SetFolder
    menu: bool
    per_length: bool
    simulator: str | None = None


def make(
    root: Path,
    recipe: Recipe,
    design_name: str = "full",
    *,
    menu: bool = True,
    per_length: bool = False,
    simulator: str | None = None,
    crew: Crew = Crew(),  # noqa: B008 (frozen)
) -> str:
    """Make a set in an empty folder; returns the digest of its truth. Raises ConfigError.

    `menu`: measure the experiments that a diagnosis may ask for. `per_length`: robot.yaml asks for an area factor of
    its own for each spine length, as the paper does, instead of one for all. `simulator`: what it predicts lies in each case,
    and is the baseline of its diagnosis in the rod's place.
    """
    shown = design(design_name)
    folder = new_set(root)
    orders = [Order(t, recipe, shown, folder, menu or shown.extras, per_length, simulator) for t in draw(recipe)]
    # the wired ones take longest and go first
    orders.sort(key=lambda o: o.truth.route != "wire")
    truths = sorted(spread(make_case, orders, crew, "cases made"), key=lambda t: t.case)
    about = {
        "design": shown.name, "clutter": recipe.clutter, "sizes": list(recipe.sizes), "settled": recipe.settled,
        "wired": recipe.wire, "area_factor": "by spine length" if per_length else "one",
        **({"simulator": simulator} if simulator else {}),
        **({"causes": list(recipe.causes)} if recipe.causes else {}),
        **({"geometry": recipe.geometry} if recipe.geometry != "paper" else {}),
    }  # fmt: skip
    return seal(folder, truths, recipe.seed, about)


def make_case(order: Order) -> Truth:
    """Measure one case and write its folder; returns the truth as it was in the end (sizes may be drawn again)."""
    truth, recipe = order.truth, order.recipe
    place = int(truth.case) - 1
    for attempt in range(ATTEMPTS):
        if attempt:
            truth = draw_one(recipe, place, truth.kind, tuple(truth.effects), truth.route, attempt)
        try:
            tables = _measure(order, truth)
        except NoEquilibrium:
            continue
        case = order.folder.case(order.truth.case)
        described = robot_yaml(GEOMETRIES[truth.geometry], markers=order.design.markers, per_length=order.per_length)
        write_case(case, tables, order.design, described, menu=order.menu)
        if order.simulator is not None:
            write_predictions(case, order.simulator)
        return truth
    raise ConfigError(f"case {truth.case}: no equilibrium in {ATTEMPTS} draws of its sizes; use smaller --sizes")


def _measure(order: Order, truth: Truth) -> dict[str, Table]:
    robot, rng = BenchRobot(truth), np.random.default_rng([truth.seed, 4])
    base = replace(BASE_SETTLED if order.recipe.settled else BASE, chambers=robot.geometry.bend)
    sweeps: tuple[Sweep, ...] = MENU if order.menu else ()
    # walked first also when it is wired: a robot that snaps must not be found out by instruments that time out
    tables = {s.name: measure(robot, s, rng) for s in (base, *sweeps)}
    if truth.route == "wire":
        tables["base"] = _wired(order, truth, base)
    return tables


def _wired(order: Order, truth: Truth, base: Sweep) -> Table:
    # the recording holds more than the design shows, so it does not stay
    work = order.folder.root / "sealed" / f"wire-{truth.case}"
    work.mkdir(parents=True, exist_ok=True)
    try:
        return measure_by_wire(truth, base, robot_yaml(markers=True, per_length=order.per_length), work)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def write_case(folder: Path, tables: dict[str, Table], shown: Design, robot: str, *, menu: bool) -> None:
    """A case folder with what the design shows and robot.yaml; `menu`: the experiments that may be asked for lie beside it."""
    folder.mkdir(parents=True)
    (folder / "robot.yaml").write_text(robot)
    extras = [tables[s.name] for s in MENU] if shown.extras else []
    write_csv(shown.show(joined([tables["base"], *extras])), folder / "trials.csv")
    if menu and not shown.extras:
        (folder / "menu").mkdir()
        for name, table in tables.items():
            write_csv(table, folder / "menu" / f"{name}.csv")


def write_predictions(folder: Path, name: str) -> Path:
    """What a simulator of the robot of a case's robot.yaml predicts of its states, as a table for `--baseline`."""
    case = read_case([folder])
    label, own = simulator(name, case.robot)
    made = from_simulator(label, own, case, CATALOGUE, lambda _done, _of: None, varied=False)
    columns = {k: v for k, v in made.columns().items() if np.isfinite(v).any()}
    path = folder / PREDICTED
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["trial", "step", *columns])
        for i, row in enumerate(case.table):
            cells = (float(c[i]) for c in columns.values())
            writer.writerow([row.trial, row.step, *("" if np.isnan(c) else repr(c) for c in cells)])
    return path


def robot_yaml(geometry: Geometry = GEOMETRIES["paper"], *, markers: bool, per_length: bool) -> str:
    """The robot as a diagnosis is told it; its area factor is a starting value, to be calibrated."""
    robot = yaml.safe_load(paper_robot().read_text(encoding="utf-8"))
    for field, (*table, key) in DESCRIBED.items():
        if field in geometry.truth:
            value = geometry.truth[field]
            (robot[table[0]] if table else robot)[key] = list(value) if isinstance(value, tuple) else value
    taper = geometry.truth.get("taper", 1.0)
    if taper != 1.0:
        radii = {key: robot[key] for key in ("outer_radius", "inner_radius")}
        radii["path_radius"] = robot["chambers"]["path_radius"]
        robot["sections"] = [{"length": robot["length"], **{k: [v, taper * v] for k, v in radii.items()}}]
    if geometry.truth.get("tendons", False):
        robot["tendons"] = {key: robot["chambers"][key] for key in ("path_radius", "azimuths_deg")}
        del robot["chambers"]
    if not per_length:
        robot["area_factor"] = NOMINAL_AREA_FACTOR
    if markers:
        robot["markers"] = [0.1, 0.2, 0.3]
    return yaml.safe_dump(robot, sort_keys=False)


def described() -> Robot:
    """That robot as it is read, without markers and with one area factor."""
    return check(parse_yaml(robot_yaml(markers=False, per_length=False), "robot.yaml"), Robot)
