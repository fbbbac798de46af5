"""A map proposed for a file nobody described: what its headings and numbers say, each line with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.robot import Robot
from recordings.trials import unit_of

from ..files.config import ConfigError
from ..files.units import KINDS
from .columns import is_missing
from .headings import (
    BASE_WORDS,
    TIP_WORDS,
    WORDS_OF_BRANCH,
    Heading,
    Triple,
    chamber,
    heading,
    quadruples,
    quantity,
    triples,
    turning,
)
from .map_file import Frame
from .quantities import ATMOSPHERE
from .reading import EPOCH, at_rest, unseen
from .series import Series

Array = NDArray[np.float64]

USUAL_PRESSURES = {"Pa": (4e3, 2e6), "kPa": (4.0, 600.0), "bar": (0.02, 4.0), "mbar": (600.0, 6e3), "psi": (4.0, 90.0)}
"""Highest pressures of soft robots by unit, in the order in which they are considered."""
AT_AMBIENT = 0.05
"""Share of the atmosphere within which a lowest pressure is the atmosphere."""
STEADY = 0.02
"""Of the highest pressure, within which a plateau stands."""
ASIDE = 0.5
"""Robot lengths off the longest axis from which on the resting tip does not tell which way the robot hangs."""
AGREED = 0.5
"""Cosine between pressures and displacements below which the frame remains in doubt."""
FEW = 5
"""Rows of the same pressure, on average, from which on a file is a time series."""


@dataclass
class Guess:
    """A map in the making: its values, and why."""

    values: dict[str, Any] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    """By dotted key."""
    doubts: list[str] = field(default_factory=list)
    """What a person has to look at or to fill in."""

    def say(self, key: str, value: Any, reason: str) -> None:
        """Set a dotted key."""
        *path, last = key.split(".")
        place = self.values
        for step in path:
            place = place.setdefault(step, {})
        place[last] = value
        self.reasons[key] = reason


def guess_map(series: Series, robot: Robot) -> Guess:
    """The most plausible map of a file's columns for a robot; raises ConfigError where no tip or pressure can be made out."""
    g = Guess()
    headings = [heading(n, series.units.get(n, "")) for n in series.names if n in series.numbers or n in series.words]
    turns, angles = quadruples(headings), turning(headings)
    used = {name for four in turns for name in four} | {name for three in angles for name in three.columns}
    pressures = _pressures(g, series, [h for h in headings if h.name not in used], robot)
    used |= set(pressures)
    tip = _tip(g, series, [h for h in headings if h.name not in used and h.name in series.numbers], robot)
    _turns(g, series, turns)
    _angles(g, series, angles)
    used |= set(tip)
    _others(g, series, [h for h in headings if h.name not in used])
    _states(g, series, pressures)
    _missing(g, series)
    return g


def _missing(g: Guess, series: Series) -> None:
    """Words of the columns in use that are no numbers."""
    in_use = repr(g.values)
    words = [w for name, strange in series.strange.items() if repr(name) in in_use for w in strange.words]
    if words:
        said = list(dict.fromkeys(words))
        g.say("source.missing", said, "cells of these columns that are no numbers")
        g.doubts.append(f"source.missing: {', '.join(map(repr, said))} are taken as missing values")


# ------------------------------------------------------------------ pressures
def _pressures(g: Guess, series: Series, headings: Sequence[Heading], robot: Robot) -> list[str]:
    found = {h.name: n for h in headings if (n := chamber(h)) is not None and h.name in series.numbers}
    by = {h.name: h for h in headings}
    read = {name: n for name, n in found.items() if not by[name].asked_for}
    chosen = read or found
    names = sorted(chosen, key=lambda name: chosen[name])
    wanted = len(robot.actuators.azimuths_deg)
    if not names:
        if wanted == 1:
            g.say("constants", {"p1": 0}, "no column of pressures")
            return []
        raise ConfigError(
            f"{series.path}: no heading names a pressure (p1, P2 [kPa], pressure_3 ..); there are "
            f"{', '.join(map(repr, series.names[:12]))}. Write map.yaml by hand (docs: data from elsewhere)"
        )
    values = np.column_stack([series.numbers[n] for n in names])
    unit, why, absolute = _pressure_unit(values, by[names[0]], series)
    for k in range(wanted):
        # fewer regulators than chambers: groups of neighbours
        own = names[k * len(names) // wanted] if len(names) <= wanted else names[k]
        entry: dict[str, Any] = {"column": own, "unit": unit}
        if absolute:
            entry["zero"] = "absolute"
        g.say(f"columns.p{k + 1}", entry, f"{why}{'; starts at the atmosphere' if absolute else ''}")
    if len(names) != wanted:
        g.doubts.append(
            f"{len(names)} columns of pressure for {wanted} chambers of robot.yaml: check which feeds which"
        )
    if set(found) - set(chosen):
        g.doubts.append(f"set-points are left out: {', '.join(sorted(set(found) - set(chosen)))}")
    return names


def _pressure_unit(values: Array, h: Heading, series: Series) -> tuple[str, str, bool]:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))

    def absolute(unit: str) -> bool:
        return abs(low * KINDS["Pa"][unit] - ATMOSPHERE) < AT_AMBIENT * ATMOSPHERE

    if said := h.unit if h.kind == "Pa" else series.unit_of(h.name, "Pa"):
        return said, f"the file says {said} of {h.name!r}", absolute(said)
    for unit in ("kPa", "bar", "mbar", "psi", "Pa"):
        if absolute(unit) and high > 1.02 * low:
            return unit, f"the lowest reading, {low:.4g}, is the atmosphere in {unit}", True
    for unit, (least, most) in USUAL_PRESSURES.items():
        if least <= high <= most:
            return unit, f"up to {high:.4g}: usual for soft robots in {unit}", False
    return "Pa", f"up to {high:.4g}: no usual unit", False


# ------------------------------------------------------------------ tip
def _tip(g: Guess, series: Series, headings: Sequence[Heading], robot: Robot) -> list[str]:
    found = [t for t in triples(headings) if all(c in series.numbers for c in t.columns)]
    found = [t for t in found if t.unit in ("", *KINDS["m"])]
    if not found:
        raise ConfigError(
            f"{series.path}: no three columns x, y, z of a tip are found; there are "
            f"{', '.join(map(repr, series.names[:12]))}. Write map.yaml by hand (docs: data from elsewhere)"
        )
    tips, bases = [t for t in found if t.words & TIP_WORDS], [t for t in found if t.words & BASE_WORDS]
    tips = tips or [max((t for t in found if t not in bases), key=lambda t: _spread(series, t))]
    rest = _at_rest(g, series)
    tip = np.mean([_xyz(series, t, rest) for t in tips], axis=0)
    base = np.mean([_xyz(series, t, rest) for t in bases], axis=0) if bases else np.zeros(3)
    between = tip - base
    rest = rest & np.isfinite(between).all(axis=1)
    if not rest.any():
        raise ConfigError(
            f"{series.path}: {' / '.join(tips[0].columns)}: no position is known while the pressures are lowest; "
            "write map.yaml by hand (docs: data from elsewhere)"
        )
    unit, why = _length_unit(series, tips[0], between[rest], robot.length)
    names = [c for t in tips for c in t.columns]
    if bases or len(tips) > 1:
        g.say(
            "points.tip.of", [list(t.columns) for t in tips], f"{len(tips)} group(s) of columns that move with the tip"
        )
        if bases:
            g.say("points.tip.against", [list(t.columns) for t in bases], "they are named after the base")
            names += [c for t in bases for c in t.columns]
        g.say("points.tip.unit", unit, why)
    else:
        for axis, column in zip("xyz", tips[0].columns, strict=True):
            g.say(f"columns.{axis}", {"column": column, "unit": unit}, why)
    _frame(g, series, between * KINDS["m"][unit], rest, robot)
    others = [t for t in found if t not in tips and t not in bases]
    if others:
        g.doubts.append(
            f"not used: {', '.join('/'.join(t.columns) for t in others)}; markers along the body go under points.m1 .."
        )
    return names


def _xyz(series: Series, t: Triple, rest: NDArray[np.bool_] | None = None) -> Array:
    """(n, 3) of the file's numbers, without rows in which nothing was seen."""
    found = np.column_stack([series.numbers[c] for c in t.columns])
    return np.where(unseen(found, rest)[:, None], np.nan, found)


def _spread(series: Series, t: Triple) -> float:
    found = _xyz(series, t)
    seen = found[np.isfinite(found).all(axis=1)]
    return float(seen.std(axis=0).sum()) if len(seen) else 0.0


def _at_rest(g: Guess, series: Series) -> NDArray[np.bool_]:
    """(n,) rows with the lowest pressures."""
    columns = [c["column"] for k, c in g.values.get("columns", {}).items() if k.startswith("p") and "column" in c]
    if not columns:
        return np.ones(len(series), bool)
    return at_rest(np.column_stack([series.numbers[c] for c in dict.fromkeys(columns)]))


def _length_unit(series: Series, t: Triple, rest: Array, length: float) -> tuple[str, str]:
    if said := t.unit or series.unit_of(t.columns[0], "m"):
        return said, f"the file says {said} of {t.columns[0]!r}"
    far = float(np.nanmedian(np.linalg.norm(rest, axis=1)))
    best = min(("m", "cm", "mm"), key=lambda u: abs(np.log(max(far, 1e-9) * KINDS["m"][u] / length)))
    return best, f"at rest the tip is {far:.4g} from the origin, the robot is {length:g} m long"


def _frame(g: Guess, series: Series, tip: Array, rest: NDArray[np.bool_], robot: Robot) -> None:
    """z along the axis on which the resting tip is far from its base; x and y as the chambers bend, right-handed. `tip`: m.

    Where markers stand elsewhere, all three axes as the chambers bend.
    """
    at_rest = np.nanmean(tip[rest], axis=0)
    along = int(np.argmax(np.abs(at_rest)))
    away = float(np.linalg.norm(at_rest))
    aside = float(np.linalg.norm(np.delete(at_rest, along)))
    elsewhere = abs(away - robot.length) > 0.02 * robot.length or aside > 0.05 * robot.length
    told = aside <= ASIDE * robot.length
    lies = "-" * bool(at_rest[along] < 0) + "xyz"[along]
    frames = [
        Frame(x=x, y=y, z=z) for z in ([lies] if told else ["z", "-z", "x", "-x", "y", "-y"]) for x, y in _turned(z)
    ]
    agreement = [_agreement(g, series, tip - at_rest, frame, robot) for frame in frames]
    best = int(np.argmax(agreement))
    if agreement[best] < AGREED:
        best = 0
        g.doubts.append(
            f"frame: no turn about z lets the tip bend away from the chambers inflated (best: {max(agreement):.2f} of 1)"
        )
    found = frames[best]
    if not told:
        others = [x for x, frame in zip(agreement, frames, strict=True) if frame.z != found.z]
        g.doubts.append(
            f"frame: where the tip rests does not tell which axis points from base to tip; taken as {found.z}, as the chambers "
            f"bend it ({agreement[best]:.2f} of 1, with another axis up to {max(others):.2f})"
        )
    if (found.x, found.y, found.z) != ("x", "y", "z"):
        why = (
            f"at rest the tip lies along {found.z} of the file"
            if told
            else f"the tip bends across {found.z} of the file"
        )
        why += f"; with these x and y it bends away from the chambers inflated ({agreement[best]:.2f} of 1)"
        g.say("frame", {"x": found.x, "y": found.y, "z": found.z}, why)
    if elsewhere:
        text = f"at rest the tip is {away * 1e3:.1f} mm from the origin and {aside * 1e3:.1f} mm off the axis"
        g.say(
            "straight", "first state", f"{text} of a robot of {robot.length * 1e3:g} mm: markers were placed elsewhere"
        )


def _turned(z: str) -> list[tuple[str, str]]:
    """x and y of the four right-handed frames with this z."""
    along = "xyz".index(z[-1])
    first, second = "xyz"[(along + 1) % 3], "xyz"[(along + 2) % 3]
    one, two = (second, first) if z.startswith("-") else (first, second)
    return [(one, two), (two, f"-{one}"), (f"-{one}", f"-{two}"), (f"-{two}", one)]


def _agreement(g: Guess, series: Series, moved: Array, frame: Frame, robot: Robot) -> float:
    """Cosine between where the tip moves across and where the chambers' pressures bend it, over all rows."""
    azimuth = np.radians(robot.actuators.azimuths_deg)
    columns = [g.values.get("columns", {}).get(f"p{k + 1}") for k in range(len(azimuth))]
    if any(c is None for c in columns):
        return 1.0
    pressure = np.column_stack([series.numbers[c["column"]] for c in columns])
    pressure = pressure - np.nanmin(pressure, axis=0)  # columns hold a number each
    pushed = -pressure @ np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    across = (moved @ frame.matrix.T)[:, :2]
    seen = np.isfinite(pushed).all(axis=1) & np.isfinite(across).all(axis=1)
    pushed, across = pushed[seen], across[seen]
    size = float(np.linalg.norm(pushed) * np.linalg.norm(across))
    return float((pushed * across).sum() / size) if size > 0 else 0.0


def _turns(g: Guess, series: Series, found: Sequence[tuple[str, str, str, str]]) -> None:
    for four in found:
        if not all(c in series.numbers for c in four):
            continue
        norm = np.linalg.norm(np.column_stack([series.numbers[c] for c in four]), axis=1)
        if abs(float(np.nanmedian(norm)) - 1) < 0.02:
            g.say("orientation", {"columns": list(four), "order": "wxyz"}, "four columns w, x, y, z of norm 1")
            return


def _angles(g: Guess, series: Series, found: Sequence[Triple]) -> None:
    """Three angles as the tip's orientation; their order and axes are asked about."""
    there = [t for t in found if all(c in series.numbers for c in t.columns)]
    there = [t for t in there if t.words & TIP_WORDS] or [t for t in there if not t.words & BASE_WORDS]
    if not there or "orientation" in g.reasons:
        return
    three = there[0]
    largest = float(np.nanmax(np.abs([series.numbers[c] for c in three.columns])))
    unit = three.unit or series.unit_of(three.columns[0], "deg") or ("deg" if largest > 2 * np.pi else "rad")
    order = "rotation vector" if three.words & {"rotvec", "vector", "axis"} else "euler xyz"
    g.say(
        "orientation",
        {"columns": list(three.columns), "order": order, "unit": unit},
        f"three angles, up to {largest:.4g} {unit}",
    )
    g.doubts.append(
        f"orientation: {' / '.join(three.columns)} are taken as {order} in {unit}; check the order (small letters: about "
        "fixed axes, capital letters: about turned ones; robots of Universal Robots write a rotation vector)"
    )


# ------------------------------------------------------------------ the rest
def _others(g: Guess, series: Series, headings: Sequence[Heading]) -> None:
    ignored = []
    for h in headings:
        column = quantity(h)
        if column is None or f"columns.{column}" in g.reasons or (h.name in series.words and column != "branch"):
            ignored.append(h.name)
            continue
        if column == "roll_deg" and _varies(series.numbers[h.name]):
            g.doubts.append(
                f"{h.name!r} changes from row to row: it is not how the body is mounted (roll_deg) and is not used"
            )
            continue
        entry: dict[str, Any] = {"column": h.name}
        why = f"the heading {h.name!r}"
        if said := h.unit if h.unit in KINDS.get(unit_of(column), ()) else series.unit_of(h.name, unit_of(column)):
            entry["unit"], why = said, f"the file says {said} of {h.name!r}"
        elif column == "t" and h.name in series.numbers:
            times = series.numbers[h.name]
            times = times[np.isfinite(times)]
            step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0
            if step >= 5 and len(series) > 200 and float(times[0]) < EPOCH[0]:
                entry["unit"], why = "ms", f"{why}, and steps of {step:g}"
        elif column in ("tip_mass", "spine_length") and float(np.nanmax(series.numbers[h.name])) > 3:
            entry["unit"] = {"tip_mass": "g", "spine_length": "mm"}[column]
            why = f"{why}, and values up to {float(np.nanmax(series.numbers[h.name])):g}"
        if column == "branch":
            values = _branches(series, h.name)
            if values is None:
                ignored.append(h.name)
                continue
            entry["values"] = values
        g.say(f"columns.{column}", entry, why)
    if "columns.spine_length" not in g.reasons:
        g.say("constants.spine_length", "0 mm", "no column names the spine")
    if ignored:
        g.doubts.append(f"not used: {', '.join(ignored[:20])}")


def _varies(values: Array) -> bool:
    """Whether an angle (deg) changes between most rows rather than now and then."""
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    return bool(len(steps) and (steps > 0).mean() > 0.5)


def _branches(series: Series, name: str) -> dict[str, str] | None:
    if name not in series.words:
        return None
    known = {w: branch for branch, words in WORDS_OF_BRANCH.items() for w in words.split()}
    said = {
        str(w): known.get(str(w).strip().casefold())
        for w in dict.fromkeys(series.words[name].tolist())
        if not is_missing(str(w))
    }
    return {w: b for w, b in said.items() if b} if all(said.values()) else None


def _states(g: Guess, series: Series, pressures: Sequence[str]) -> None:
    if not pressures:
        return
    values = np.column_stack([series.numbers[n] for n in pressures])
    values = values[np.isfinite(values).all(axis=1)]
    span = float(np.ptp(values)) if len(values) else 0.0
    stays = np.abs(np.diff(values, axis=0)).max(axis=1) < STEADY * span if len(values) > 1 else np.zeros(0, bool)
    stretches = 1 + int((~stays).sum())
    timed = "columns.t" in g.reasons or "time" in series.numbers
    if len(values) >= FEW * stretches or (len(series) > 500 and stays.mean() > 0.5):
        unit = KINDS["Pa"][g.values["columns"]["p1"]["unit"]]
        steady = float(f"{STEADY * span * unit / 1e3:.2g}")
        why = f"{len(series)} rows in which pressures mostly stand still: a recording over time"
        g.say("states.plateaus", {"steady": f"{steady:g} kPa"}, why)
        if not timed:
            g.say("source.rate", "100 Hz", "GUESSED: no column of time")
            g.doubts.append("source.rate: how many rows a second? 100 is a guess")
        if "columns.trial" not in g.reasons:
            g.say("trials", {"begin": "rest"}, "each return to ambient pressure begins a trial")
    elif "columns.trial" not in g.reasons:
        g.say("trials", {"begin": "rest"}, "each return to ambient pressure begins a trial")


def guess_text(g: Guess, robot: Path, files: Sequence[Path], form: str) -> str:
    """The map as a file, with its reasons as comments."""
    import yaml

    lines = [
        f"# Proposed for {', '.join(f.name for f in files[:5])} ({form}). Check each line; reasons stand above it.",
        "",
    ]
    lines += [f"# CHECK: {d}" for d in g.doubts] + ([""] if g.doubts else [])
    lines.append(f"robot: {yaml.safe_dump(str(robot), default_flow_style=True).strip().removesuffix('...').strip()}")
    for key, value in g.values.items():
        own = {k.partition(".")[2]: r for k, r in g.reasons.items() if k == key or k.startswith(f"{key}.")}
        lines.append("")
        if "" in own:
            lines += [f"# {own['']}", f"{key}: {_flow(value)}"]
            continue
        lines.append(f"{key}:")
        said = ""
        nested = any("." in k for k in own)
        for name, inner in value.items():
            if nested and isinstance(inner, dict) and name not in own:
                lines.append(f"  {name}:")
                for k, v in inner.items():
                    lines += [f"    # {own[f'{name}.{k}']}", f"    {k}: {_flow(v)}"]
                continue
            if own.get(name, said) != said:
                said = own[name]
                lines.append(f"  # {said}")
            lines.append(f"  {name}: {_flow(inner)}")
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    import yaml

    return (
        yaml.safe_dump(value, default_flow_style=True, width=10_000, allow_unicode=True, sort_keys=False)
        .strip()
        .removesuffix("...")
        .strip()
    )
