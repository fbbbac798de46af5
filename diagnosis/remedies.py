"""What to write where a table is in another frame or unit: the finished line of map.yaml, or the argument of lab.case."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from model.robot import Robot
from model.rotation import multiply
from recordings.trials import AXES, Mapped, Table, pressure_columns

from .arrays import Array
from .data.levels import REST
from .data.plausible import misread

MIRRORS = {
    **{f"change the sign of column {a} (`scale: -1`)": np.array(AXES[a]) for a in "xyz"},
    **{f"swap columns {a} and {b}": np.subtract(AXES[a], AXES[b]) for a, b in combinations("xyz", 2)},
}
"""Ways to mirror the columns of a file -> the normal of the mirror."""
NEAR = 1 - 1e-6
"""Cosine from which a direction is along an axis."""


def listed(vector: Any, decimals: int = 2) -> str:
    """Numbers as robot.yaml has them."""
    return f"[{', '.join(f'{x + 0.0:.3g}' for x in np.round(vector, decimals))}]"


def named(axes: Array, quote: str = "") -> list[str]:
    """Name the axes along which the rows of a rotation (3, 3) point; list the directions of those along none."""
    names = [next((name for name, axis in AXES.items() if np.dot(row, axis) > NEAR), "") for row in axes]
    return [f"{quote}{name}{quote}" if name else listed(row, 4) for name, row in zip(names, axes, strict=True)]


def of_frame(axes: Array, mapped: Mapped | None) -> str:
    """Say what makes the tips those along the base's axes, which are the rows of `axes` (3, 3) in the table."""
    if mapped is None:
        return f"let columns x, y, z hold what is now {', '.join(named(axes))}"
    present = mapped.axes
    found, ways = axes @ present, []
    if np.linalg.det(axes) < 0:  # which no frame can be
        mirrored = {way: found @ (np.eye(3) - 2 * np.outer(n, n) / (n @ n)) for way, n in MIRRORS.items()}
        ways = [min(mirrored, key=lambda way: not np.array_equal(mirrored[way], present))]
        found = mirrored[ways[0]]
    if not np.array_equal(found, present):
        quote = '"' if mapped.call else ""
        pairs = (f"{quote}{axis}{quote}: {name}" for axis, name in zip("xyz", named(found, quote), strict=True))
        ways.append(_write("frame", "{" + ", ".join(pairs) + "}", mapped))
    return ", and ".join(ways)


def of_mount(turn: Array, mapped: Mapped | None) -> str:
    """Say what turns each attitude from the right by a quaternion [w, x, y, z] along the base's axes."""
    if mapped is None:
        return f"multiply each quaternion from the right by {listed(turn, 3)}"
    where = f"under orientation in {'lab.case' if mapped.call else 'map.yaml'}"
    if mapped.mount is None:
        return f"multiply each `mount` {where} from the right by {listed(turn, 3)}"
    made = multiply(np.array(mapped.mount), turn)
    return f"write `mount: {listed(made / np.linalg.norm(made), 3)}` {where}"


def of_order(order: str, mapped: Mapped | None) -> str:
    """Say what makes quaternions those whose columns hold this order; without a map they are named w, x, y, z."""
    if mapped is None:
        return f"they hold {', '.join(order if order == 'xyzw' else 'zwxy')}: exchange the columns"
    return _write("orientation", f'{{"order": "{order}", ..}}' if mapped.call else f"{{order: {order}, ..}}", mapped)


def of_origin(mapped: Mapped | None, by: Array | None = None, near: float = 0.0) -> str:
    """Say what brings the origin of the positions to the base, which, where it is known, lies at `by` (3,) +- `near` m."""
    if mapped is None:
        return f"subtract {'the place of the base' if by is None else _in_mm(by)} from the positions"
    at_rest = _write("straight", '"at rest"' if mapped.call else "at rest", mapped)
    remedy = f"{at_rest}, or give the base's place as `zero` of columns x, y, z"
    if by is None or mapped.base is None or mapped.straight != Mapped.straight:
        return remedy
    stated, base = np.array(mapped.base), mapped.base + by @ mapped.axes
    same, opposite = (np.abs(base - sign * stated) < near for sign in (1, -1))
    wrong = ", ".join(f"columns.{axis}" for axis in np.array(["x", "y", "z"])[opposite & ~same])
    of_sign = f"change the sign of `zero` of {wrong} in {'lab.case' if mapped.call else 'map.yaml'}"
    return of_sign if wrong and (same | opposite).all() else f"{remedy}, about {_in_mm(base)}"


def of_trials(trials: Table) -> str:
    """Say what makes the repeats in one trial several: it begins where the robot rests, if it rests in between, else anywhere."""
    if (mapped := trials.mapped) is None:
        return "number the repeats in column `trial`"
    away = np.abs(trials.pressures).max(axis=1) > REST
    begin = "rest" if np.count_nonzero(away[1:] & ~away[:-1]) > 1 else "state"
    wins = "leave out columns.trial, and " * ("trial" in dict(mapped.headings))  # it says where trials begin, whatever `begin` is
    return wins + _write("trials", f'{{"begin": "{begin}"}}' if mapped.call else f"{{begin: {begin}}}", mapped)


def of_unit(mapped: Mapped | None, robot: Robot, unit: str) -> str:
    """Say what to write so that all pressures are read in a unit; `unit` may say more, as "Pa read as kPa" does."""
    return of_columns(pressure_columns(len(robot.actuators.azimuths_deg)), unit.partition(" ")[0], mapped)


def misread_by(ratio: float, robot: Robot, mapped: Mapped | None) -> tuple[str, str]:
    """Name the units where all pressures must be `ratio` times as large, and say what to write."""
    names = misread(robot, mapped)[ratio]
    return " or ".join(names), of_unit(mapped, robot, names[0] if len(names) == 1 else "")


def of_columns(names: Sequence[str], unit: str, mapped: Mapped | None) -> str:
    """The same of columns of the table; more than one word, or none: no unit that a map may state."""
    headings = {} if mapped is None else dict(mapped.headings)
    if mapped is None and len(unit.split()) == 1:
        return f"correct their unit in the table, or write `unit: {unit}` (or a `scale`) in columns.{names[0]} .. of map.yaml"
    if mapped is None or len(unit.split()) != 1 or not headings.keys() >= {*names}:
        place = "the table or its map.yaml" if mapped is None else "lab.case" if mapped.call else "map.yaml"
        return f"correct unit or scale of {', '.join(names)} in {place}"
    if mapped.call:
        columns = (f'"{name}": "{headings[name]} [{unit}]"' for name in names)
        return f"write columns={{{', '.join(columns)}}} in lab.case"
    return f"write `unit: {unit}` for {', '.join(f'columns.{name}' for name in names)} in map.yaml"


def heading(name: str, mapped: Mapped | None) -> str:
    """The heading of a column in the file; its name where that is not known."""
    return dict(() if mapped is None else mapped.headings).get(name, name)


def _write(key: str, value: str, mapped: Mapped) -> str:
    """A key of the map, as it is written in a call or a file."""
    return f"write {key}={value} in lab.case" if mapped.call else f"write `{key}: {value}` in map.yaml"


def marker_entry(place: Array) -> str:
    """The entry of `markers` of robot.yaml of a marker at x, y and arc length (m) of the straight robot."""
    x, y, along = (f"{value:.4g} mm" for value in 1e3 * place)
    return f"{{arc_length: {along}, offset: [{x}, {y}]}}" if place[:2].any() else along


def _in_mm(place: Array) -> str:
    """A place (3,) m."""
    return f"[{', '.join(f'{1e3 * x + 0.0:.4g}' for x in np.round(place, 4))}] mm"
