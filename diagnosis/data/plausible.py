"""Values that are impossible for this robot, whatever its material: refused with column, value, limit and remedy.

    pressures      one for each actuator, at most 20 bar
    tips           within one and a half lengths of the base
    attitudes      unit quaternions
    spine, mass    no longer than the robot; not a thousand times the mass stated, nor one that doubles its length

Other mistakes are judged by the list of edits, see `edits.reading`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import permutations, product

import numpy as np

from model.actuators import Words
from model.body import body_of
from model.condition import HIGHEST_PRESSURE
from model.robot import Robot
from recordings.trials import Mapped, Table

from ..arrays import Array, Mask
from ..errors import BadCase

FARTHEST = 1.5
"""Robot lengths; no tip of a rod that stretches by less than half is further from its base."""
MOST_DEFLECTION = 0.3
"""Largest deflection of beam theory, as a share of the cantilever's length."""
SHORTEST = 0.01
"""m; a shorter spine offers nothing to push on."""
LOWEST_USUAL = 1e3
"""Pa, below which the highest pressure of a soft robot is in another unit."""
USUAL_PRESSURE = 60e3
"""Pa, the highest pressure of most soft robots."""
CHECK_FRAME = "check the unit and the frame (base of the robot)"
ROUNDED = 0.05
"""Difference of a quaternion's norm from one: rounding to two digits makes less."""
METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inches": 0.0254}
PASCALS = {"Pa": 1.0, "mbar": 1e2, "kPa": 1e3, "psi": 6895.0, "bar": 1e5, "MPa": 1e6}
NEWTONS = {"N": 1.0, "lbf": 4.44822, "kgf": 9.80665, "mN": 1e-3, "gram-force": 9.80665e-3}
"""Unit -> its size in SI, of positions, pressures, and forces or tensions."""
SAME_RATIO = 1.25
"""Factor by which a found ratio may differ from that of two units which explain it: as well as a modulus is known."""


def implausible_values(robot: Robot, table: Table) -> tuple[tuple[str, ...], Table, str]:
    """One message for each impossible value: column, value, what it looks like, what to write; the states that can be compared
    with a rod, tips in m where their unit is known; and which of the messages, if any, says `CHECK_FRAME`."""
    tips = table.take(table.with_tip & np.isfinite(table.spine_length))
    of_table = (_spines(robot, table), _masses(robot, table)) if len(table) else ()
    if not len(tips):
        return tuple(filter(None, of_table)), tips, ""
    (far, in_m), counts = _distances(robot, tips), _counts(robot, tips)
    wrong = (*of_table, counts, far, _highest(robot, tips), _norms(tips))
    fit = (in_m.spine_length <= robot.length) & (not counts)
    return tuple(filter(None, wrong)), in_m.take(fit), far if in_m is tips else ""


def _counts(robot: Robot, tips: Table) -> str:
    numbers = np.where(np.isnan(tips.pressures), 0, np.arange(1, tips.pressures.shape[1] + 1))
    given, expected = np.unique(numbers.max(axis=1, initial=0)).tolist(), len(robot.actuators.azimuths_deg)
    if given == [expected]:
        return ""
    odd = [f"p{k}" for k in range(min(expected, *given) + 1, max(expected, *given) + 1)]
    wrong = f"{', '.join(odd)} {'is' if len(odd) == 1 else 'are'} {'missing' if given[-1] < expected else 'too many'}"
    return robot.actuators.words.fill(
        "rows with {} {pressures} for a robot with {} {actuators}: {}; write one column for each of robot.yaml's azimuths_deg",
        ", ".join(map(str, given)), str(expected), "tables of different robots cannot be used together" if given[1:] else wrong,
    )  # fmt: skip


def _distances(robot: Robot, tips: Table) -> tuple[str, Table]:
    """A message about tips too far from the base, empty where none is; and the states, in m where their unit is known."""
    distance = np.linalg.norm(tips.tip, axis=1)
    marker_off = float(np.linalg.norm([p.value for p in robot.effects.get("marker_offset", {}).values()]))
    far = distance > FARTHEST * robot.length + marker_off
    if not far.any():
        return "", tips
    worst = int(np.argmax(distance))
    head = (
        f"{tips.place(worst)}, columns x, y, z: the tip lies {distance[worst]:.3g} m from the base of a robot that is "
        f"{robot.length:g} m long ({far.sum()} of {len(tips)} states)"
    )
    times = float(np.median(distance)) / robot.length
    units = [unit for unit, read_as in pairs_near(1 / times, METRES, 1.6) if METRES[read_as] == 1.0]
    if not units:
        *others, widest = np.sort(np.ptp(tips.tip, axis=0))
        apart = float(np.hypot(np.linalg.norm(others), widest))
        if apart > 2 * robot.length and 6 * np.linalg.norm(others) > widest:  # along more than one axis, wherever the base is
            pairs = [" read as ".join(pair) for pair in pairs_near(1 / times, METRES, 1.6)]
            looks = "".join(f" and {times:.3g} times its length from the base, as {pair} do" for pair in pairs[:1])
            wrong = f"{head}: tips lie up to {apart:.3g} m apart{looks}: check unit and `scale` of columns x, y, z first"
            return wrong, tips.take(np.arange(0))
        return f"{head}: {_exchanged(robot, tips) or CHECK_FRAME}", tips
    size = METRES[units[0]]
    in_m = tips.replaced({axis: tips.get(axis) * size for axis in "xyz"})
    return f"{head}: looks like {units[0]}; positions are in m: {in_si(size)}", in_m


def _exchanged(robot: Robot, tips: Table) -> str:
    """Name two columns that are exchanged while the base's coordinates, which are subtracted, are not; empty where none are."""
    mapped = tips.mapped
    if mapped is None or mapped.base is None or mapped.straight != "as recorded":
        return ""
    recorded, base, reach = tips.tip @ mapped.axes + mapped.base, np.array(mapped.base), FARTHEST * robot.length
    if any((np.linalg.norm(recorded - base * signs, axis=1) <= reach).all() for signs in product((1, -1), repeat=3)):
        return ""  # `zero` may as well have the wrong sign
    for a, b, order in (("x", "y", [1, 0, 2]), ("x", "z", [2, 1, 0]), ("y", "z", [0, 2, 1])):
        if (np.linalg.norm(recorded[:, order] - base, axis=1) <= reach).all():
            both = f"columns {a} and {b}"
            return f"{both} are exchanged: exchange the headings of both, but not their `zero`, and all tips are within reach"
    return ""


def _highest(robot: Robot, tips: Table) -> str:
    size = np.nan_to_num(np.abs(tips.pressures))
    state, column = divmod(int(np.argmax(size)), size.shape[1])
    if size[state, column] <= HIGHEST_PRESSURE:
        return ""
    unit, pascal, looks = robot.actuators.words.unit, robot.actuators.words.pascal, ""
    if robot.chambers is not None:
        ratio = (robot.highest_limit or USUAL_PRESSURE) / size[state, column]
        times, names = min(misread(robot, tips.mapped).items(), key=lambda of_ratio: abs(math.log(of_ratio[0] / ratio)))
        unit, pascal = "Pa gauge", 1.0
        looks = f", it looks like {' or '.join(names)} ({in_si(times)})"
    return (
        f"{tips.place(state)}, column p{column + 1}: {tips.pressures[state, column] / pascal:g} {unit}, must be at most "
        f"{HIGHEST_PRESSURE / pascal:g} {unit}: check its unit{looks}"
    )


def _norms(tips: Table) -> str:
    norms = np.linalg.norm(tips.orientation, axis=1)
    off = np.nan_to_num(np.abs(norms - 1))
    worst = int(np.argmax(off))
    if off[worst] <= ROUNDED:
        return ""
    return (
        f"{tips.place(worst)}, columns qw, qx, qy, qz: ({', '.join(f'{c:.3g}' for c in tips.orientation[worst])}) has norm "
        f"{norms[worst]:.3g}, must be 1: looks like angles or a rotation vector; write a unit quaternion, w first"
    )


def _spines(robot: Robot, table: Table) -> str:
    lengths = table.spine_length
    if not np.nanmax(lengths) > 1.001 * robot.length:
        return ""
    worst = int(np.nanargmax(lengths))
    head = f"{table.place(worst)}, column spine_length: {lengths[worst]:g} m, longer than the robot ({robot.length:g} m)"
    times = float(lengths[worst]) / robot.length
    # a longer spine is another unit rather than another robot
    if times < 4.0:
        return f"{head}: check the unit (m), or the length in robot.yaml"
    # What fits the robot in cm may be a short spine in mm as well.
    looks, divisor = ("cm or mm", "100 or 1000") if times <= 100 else ("mm", "1000")
    return f"{head}: looks like {looks}; lengths are in m: divide by {divisor}"


def _masses(robot: Robot, table: Table) -> str:
    """Grams: a thousand times robot.yaml's tip mass, or a weight under which the body would be twice as long."""
    masses = table.get("tip_mass", 0.0)
    heaviest = int(np.argmax(masses))
    mass, described, carried = float(masses[heaviest]), robot.tip_mass, robot.youngs_modulus * body_of(robot).mean_area / 9.81
    if not (mass > carried or (described > 0 and abs(mass / described / 1000 - 1) < 0.05)):
        return ""
    beside = f"robot.yaml has {described:g} kg" if described > 0 else f"the body would be twice as long under {carried:.3g} kg"
    of_file = table.mapped is not None and not table.mapped.call
    remedy = "write `unit: g` under columns.tip_mass in map.yaml" if of_file else "masses are in kg: divide by 1000"
    return f"{table.place(heaviest)}, column tip_mass: {mass:g} kg, {beside}: looks like g; {remedy}"


def complete(table: Table) -> Mask:
    """(n,) states of stiffness trials with a force and the deflection it belongs to."""
    return np.asarray(table.pushed & np.isfinite(table.get("force")) & np.isfinite(table.get("deflection")))


def of_body(given: Table) -> Mask:
    return np.asarray(given.get("specimen") == "body")


def cantilevers(robot: Robot, given: Table) -> Array:
    """(n,) m of the cantilevers."""
    return np.where(of_body(given), robot.length, given.spine_length)


def require_plausible_pushes(robot: Robot, pushes: Table) -> None:
    """Raises `BadCase` for states that no stiffness trial of this robot gives."""
    length, deflection = cantilevers(robot, pushes), pushes.get("deflection")
    if robot.spine is None and (of_spine := np.flatnonzero(~of_body(pushes))).size:
        raise BadCase(
            f"{pushes.place(of_spine[0])}: a stiffness trial of a spine, but robot {robot.name!r} has none: add the spine's "
            "moduli to robot.yaml"
        )
    for i in np.flatnonzero(length < SHORTEST)[:1].tolist():
        raise BadCase(
            f"{pushes.place(i)}: a stiffness trial of a spine of {length[i]:g} m: check spine_length (m), or write specimen body"
        )
    for i in np.flatnonzero(np.abs(deflection) > MOST_DEFLECTION * length)[:1].tolist():
        looks = "looks like mm; deflections are in m: divide by 1000" if abs(deflection[i]) > length[i] else "check the unit (m)"
        raise BadCase(
            f"{pushes.place(i)}: deflection {deflection[i]:g} m of a cantilever of {length[i]:g} m; beam theory holds up to "
            f"{MOST_DEFLECTION:g} of its length: {looks}, or leave the row out"
        )


def differ_by(factor: float, words: Words) -> str:
    """Name in brackets the units that differ from that of pressures or tensions by about a factor, nearest first; "" for none."""
    sizes = NEWTONS if words.unit in NEWTONS else PASCALS
    near = (pair for pair in pairs_near(max(factor, 1 / factor), sizes, SAME_RATIO) if words.unit in pair)
    ratios = {a if b == words.unit else b: sizes[a] / sizes[b] for a, b in near}
    found = ", ".join(f"{unit} and {words.unit} differ by {ratio:.4g}" for unit, ratio in ratios.items())
    return f" ({found})" if found else ""


def misread(robot: Robot, mapped: Mapped | None) -> dict[float, list[str]]:
    """Ratio of a unit to that in which pressures or tensions were read -> names of both, as "psi read as kPa"."""
    words = robot.actuators.words
    sizes = PASCALS if robot.chambers is not None else NEWTONS | {"Pa": 1 / words.pascal}
    unit = None if mapped is None else mapped.unit
    known, out = "Pa" if unit == "" else unit, dict[float, list[str]]()
    for own, other in permutations(sizes, 2):
        if known not in sizes or other == known:
            out.setdefault(float(f"{sizes[own] / sizes[other]:.6g}"), []).append(f"{own} read as {other}")
    return {ratio: [n for n in names if known or n.endswith("read as Pa")] or names for ratio, names in out.items()}


def pairs_near(factor: float, sizes: Mapping[str, float], within: float) -> list[tuple[str, str]]:
    """Pairs of units, the first a `factor` times as large as the second, within another factor, the nearest first."""
    away = {(a, b): abs(math.log(sizes[a] / sizes[b] / factor)) for a, b in permutations(sizes, 2)}
    return sorted((pair for pair in away if away[pair] < math.log(within)), key=away.__getitem__)


def in_si(size: float) -> str:
    """What to do with numbers in a unit of this size."""
    return f"divide by {1 / size:g}" if size < 1 else f"multiply by {size:g}"
