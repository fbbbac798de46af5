"""Draw robots of a world, measure them, weigh their effects in mm, seal the truth, publish its digest."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from lab.files.baseline import from_simulator, simulator
from lab.files.config import ConfigError, check, parse_yaml
from lab.files.inputs import read_case
from lab.files.robot_file import paper_robot
from model.effects.catalogue import CATALOGUE
from model.robot import Robot
from recordings.table_file import write_csv
from recordings.trials import Table, TrialRow

from .folder import SetFolder, new_set, seal
from .sweeps import BASE, MENU, Design, MenuSweep, PlannedState, design
from .truth import KINDS, THRUST, Recipe, Stratum, Truth, another_cause, draw, draw_robot
from .workers import spread
from .worlds.campaign import Jamming, Response, SweptReadings, WalkedSweep, WorldRobot, courses, read, respond
from .worlds.carried import TRIED, Carried, carried, nearest
from .worlds.equilibrium import NoWorldEquilibrium
from .worlds.forms import EFFECTS
from .worlds.table import world
from .worlds.walk import Leg

PREDICTED = "predicted.csv"
"""In a case folder: what another simulator predicts of its states."""
ATTEMPTS = 20
"""Draws of sizes for one case until the robot keeps its equilibrium through all experiments."""
SMALLEST_PAIR, LARGEST_PAIR = 0.25, 2.0
"""Plausible scales between which a pair's partners are made comparable."""


@dataclass(frozen=True)
class CaseOrder:
    """What one worker makes."""

    place: int
    stratum: Stratum
    causes: tuple[str, ...]
    recipe: Recipe
    design: Design
    folder: SetFolder
    menu: bool
    simulator: str | None = None


def make(
    root: Path, recipe: Recipe, design_name: str = "full", *, menu: bool = True, simulator: str | None = None, workers: int = 1
) -> str:
    """Make a set in an empty folder; returns the digest of its truth. Raises ConfigError.

    `menu`: measure the experiments that a diagnosis may ask for. `simulator`: its predictions are
    written into each case, as the baseline of its diagnosis in place of the rod.
    """
    try:
        world(recipe.world)
    except ValueError as e:
        raise ConfigError(f"--world: {e}") from e
    shown = design(design_name)
    folder = new_set(root)
    orders = [
        CaseOrder(place, stratum, causes, recipe, shown, folder, menu or shown.extras, simulator)
        for place, (stratum, causes) in enumerate(draw(recipe))
    ]
    truths = sorted(spread(make_case, orders, workers, "cases made"), key=lambda t: t.case)
    clutter = world(recipe.world).clutter if recipe.clutter is None else recipe.clutter
    about = {
        "design": shown.name, "world": recipe.world, "clutter": clutter, "sizes": list(recipe.sizes),
        "kinds": sorted({KINDS[o.stratum] for o in orders}), "held_out": recipe.held_out,
        **({"simulator": simulator} if simulator else {}),
    }  # fmt: skip
    return seal(folder, truths, recipe.seed, about)


def make_case(order: CaseOrder) -> Truth:
    """Measure one case and write its folder; returns its truth. Sizes are drawn again until the robot keeps its equilibrium, and
    where none does, another cause as well."""
    for attempt in range(2 * ATTEMPTS):
        if attempt >= ATTEMPTS:
            causes = another_cause(order.recipe, order.place, order.stratum, attempt) or order.causes
            order = replace(order, causes=causes)
        try:
            truth, tables = _measured(order, attempt)
        except (NoWorldEquilibrium, Unequal):
            continue
        case = order.folder.case(truth.case)
        robot = robot_yaml(markers=order.design.markers)
        write_case(case, tables, order.design, robot, menu=order.menu)
        if order.simulator is not None:
            write_predictions(case, order.simulator)
        return truth
    raise ConfigError(
        f"case {order.place + 1:04d} of world {order.recipe.world}: {2 * ATTEMPTS} draws of its sizes and causes gave no "
        "equilibrium or no comparable pair; use smaller --sizes"
    )


class Unequal(RuntimeError):
    """A pair whose partners cannot be made comparable."""


@dataclass(frozen=True)
class Drawn:
    """A robot in front of its campaign, before cameras read it."""

    robot: WorldRobot
    effects: dict[str, float]
    walked: WalkedSweep
    response: Response
    weight: Carried


def drawn(recipe: Recipe, place: int, stratum: Stratum, causes: Sequence[str], attempt: int) -> Drawn:
    """A robot and what its effects do; a pair's partners carry alike. Raises NoWorldEquilibrium and Unequal."""
    robot, effects = draw_robot(recipe, place, stratum, causes, attempt)
    walked = walk_of(BASE)
    pair = KINDS[stratum] == "pair"
    if pair:
        robot, effects = _comparable(robot, effects, walked)
    others = [e for e in EFFECTS if e not in robot.present and e != THRUST] if robot.outside else []
    response = respond(robot, walked, tuple(robot.present), dict.fromkeys(others, TRIED))
    weight = carried(robot, walked, response)
    if pair and _ratio(weight, [e for e in effects if e != THRUST]) < 0.5:
        raise Unequal
    return Drawn(robot, effects, walked, response, weight)


def _measured(order: CaseOrder, attempt: int) -> tuple[Truth, dict[str, Table]]:
    recipe = order.recipe
    d = drawn(recipe, order.place, order.stratum, order.causes, attempt)
    robot, walked, response = d.robot, d.walked, d.response
    rng = np.random.default_rng([recipe.seed, 7, order.place, attempt])
    readings = read(robot, walked, response, rng)
    tables = {BASE.name: table_of(BASE, readings)}
    for sweep in MENU if order.menu else ():
        # experiments of the menu are done when the campaign of the base sweep is over
        later = walk_of(sweep, late=1e6)
        changing = respond(robot, later, tuple(courses(robot, later)))
        tables[sweep.name] = table_of(sweep, read(robot, later, changing, rng))
    closest = None
    for outside in robot.outside:
        effect, left = nearest(robot, walked, response, outside, [e for e in EFFECTS if e != THRUST])
        closest = {"effect": effect, "leaves_mm": round(left, 3)}
    truth = Truth(
        f"{order.place + 1:04d}", order.stratum, robot, d.effects, d.weight.moves, d.weight.calibrated, closest,
        floor_mm=noise_floor(robot, walked, response, recipe.seed, order.place),
    )  # fmt: skip
    return truth, tables


def _comparable(robot: WorldRobot, effects: dict[str, float], walked: WalkedSweep) -> tuple[WorldRobot, dict[str, float]]:
    """Sizes of a pair at which both carry alike, within what is plausible. Raises `Unequal`."""
    one, two = (e for e in effects if e != THRUST)
    weight = carried(robot, walked, respond(robot, walked, (one, two)))
    ratio = weight.calibrated[one] / max(weight.calibrated[two], 1e-6)
    if ratio == 0:
        raise Unequal  # one that moves nothing
    sizes, made = dict(robot.sizes), dict(effects)
    # half of the way by the one that is too small, half by the other
    for effect, factor in ((one, ratio**-0.5), (two, ratio**0.5)):
        most = 1.0 if EFFECTS[effect].sign == "blend" else LARGEST_PAIR
        size = float(np.sign(made[effect]) * np.clip(abs(made[effect]) * factor, SMALLEST_PAIR, most))
        sizes[effect] += size - made[effect]
        made[effect] = size
    return replace(robot, sizes=sizes), made


def _ratio(weight: Carried, pair: Sequence[str]) -> float:
    carry = [weight.calibrated[e] for e in pair]
    return min(carry) / max(max(carry), 1e-9)


def noise_floor(robot: WorldRobot, walked: WalkedSweep, response: Response, seed: int, place: int) -> float:
    """mm, scatter of repeats without causes outside the catalogue: one that comes and goes must not raise the floor that it is
    judged by."""
    return scatter(walked, read(replace(robot, outside={}), walked, response, np.random.default_rng([seed, 8, place])))


def scatter(walked: WalkedSweep, readings: SweptReadings) -> float:
    """mm, rms distance of a reading from the mean of its repeats, degrees of freedom counted."""
    groups: dict[tuple[float, float], list[int]] = {}
    for i, t in enumerate(walked.trials):
        groups.setdefault((t.spine, t.vacuum), []).append(i)
    total, freedom = 0.0, 0
    for rows in groups.values():
        tips = readings.tip[rows]
        total += float(np.sum((tips - tips.mean(axis=0)) ** 2))
        freedom += (len(rows) - 1) * tips.shape[1]
    return float(np.sqrt(total / max(freedom, 1)) * 1e3)


def walk_of(sweep: MenuSweep, late: float = 0.0) -> WalkedSweep:
    """The sweep as trials and legs, begun `late` seconds into the campaign."""
    states = list(sweep.states())
    first = [s for s in states if s.trial == 1]
    legs: list[Leg] = []
    for before, s in zip([None, *first[:-1]], first, strict=True):
        waited = before.hold if sweep.reading == "hold" and before is not None and before.pressure == s.pressure else 0.0
        legs.append(Leg(_pressures(sweep, s.pressure), sweep.rate, s.hold - waited))
        if s.hold > 0 and sweep.reading != "hold":
            # What is told of a settled state is the middle of what was averaged.
            legs.append(Leg(_pressures(sweep, s.pressure), sweep.rate, 0.5 * sweep.average, read=False))
        if sweep.reading == "fly" and s.branch == "load" and s.pressure == sweep.pressures[-1] - sweep.band:
            # the ramp goes on to its end before it turns
            legs.append(Leg(_pressures(sweep, sweep.pressures[-1]), sweep.rate, 0.0, read=False))
    ramps = sum(leg.hold for leg in legs) + 2 * sweep.pressures[-1] / sweep.rate
    # s between trials: vent, grow, jam
    period = 40.0 + ramps
    count = max(s.trial for s in states)
    trials = tuple(Jamming(s.spine_length, s.vacuum, s.repeat, late + (s.trial - 1) * period) for s in states if s.step == 1)
    return WalkedSweep(trials, tuple(legs), sweep.tip_mass, float(np.radians(sweep.roll_deg)), count * period)


def _pressures(sweep: MenuSweep, pressure: float) -> tuple[float, ...]:
    return tuple(pressure if c in sweep.chambers else 0.0 for c in range(1, 10))


def table_of(sweep: MenuSweep, readings: SweptReadings) -> Table:
    """Rows as the protocol writes them."""
    states: dict[int, list[PlannedState]] = {}
    for s in sweep.states():
        states.setdefault(s.trial, []).append(s)
    rows = []
    for trial, own in states.items():
        for k, s in enumerate(own):
            i = trial - 1
            x, y, z = (float(v) for v in readings.tip[i, k])
            q = Rotation.from_matrix(readings.turns[i, k]).as_quat(canonical=True, scalar_first=True)
            rows.append(
                TrialRow(
                    trial=s.trial,
                    step=s.step,
                    protocol=sweep.protocol,
                    repeat=s.repeat,
                    branch=s.branch,
                    t=float(readings.t[i, k]),
                    spine_length=s.spine_length,
                    pressures=tuple(float(p) for p in readings.pressures[i, k]),
                    rate=s.rate,
                    hold=s.hold,
                    vacuum=float(readings.vacuum[i, k]),
                    tip_mass=sweep.tip_mass,
                    roll_deg=sweep.roll_deg,
                    tip=(x, y, z),
                    orientation=(float(q[0]), float(q[1]), float(q[2]), float(q[3])),
                    markers=tuple((float(m[0]), float(m[1]), float(m[2])) for m in readings.markers[i, k]),
                )  # fmt: skip
            )
    return Table.of(rows)


def write_case(folder: Path, tables: dict[str, Table], shown: Design, robot: str, *, menu: bool) -> None:
    """A case folder with what the design shows and robot.yaml; `menu`: the experiments that may be asked for lie beside it."""
    folder.mkdir(parents=True)
    (folder / "robot.yaml").write_text(robot)
    extras = [tables[s.name] for s in MENU] if shown.extras else []
    write_csv(shown.show(Table.joined([tables["base"], *extras])), folder / "trials.csv")
    if menu and not shown.extras:
        (folder / "menu").mkdir()
        for name, table in tables.items():
            write_csv(table, folder / "menu" / f"{name}.csv")


def write_predictions(folder: Path, name: str) -> Path:
    """What a simulator of the robot of a case's robot.yaml predicts of its states, as a table for `--baseline`."""
    case = read_case([folder])
    label, own = simulator(name, case.robot)
    made = from_simulator(label, own, case, CATALOGUE, lambda _done, _of: None, varied=False)
    columns = {k: v for k, v in made.predicted.values.items() if np.isfinite(v).any()}
    path = folder / PREDICTED
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["trial", "step", *columns])
        for i, row in enumerate(case.table):
            cells = (float(c[i]) for c in columns.values())
            writer.writerow([row.trial, row.step, *("" if np.isnan(c) else repr(c) for c in cells)])
    return path


def robot_yaml(*, markers: bool) -> str:
    """robot.yaml as a diagnosis gets it; its area factor is a starting value, to be calibrated."""
    robot = yaml.safe_load(paper_robot().read_text(encoding="utf-8"))
    robot["area_factor"] = 1.6
    if markers:
        robot["markers"] = [0.1, 0.2, 0.3]
    return yaml.safe_dump(robot, sort_keys=False)


def described() -> Robot:
    """That robot as it is read, without markers and with one area factor."""
    return check(parse_yaml(robot_yaml(markers=False), "robot.yaml"), Robot)
