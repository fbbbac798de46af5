"""Candidate experiments: what the rig could do next, as protocol parameters, and the states that would give.

Each is a bending or elongation run with one thing changed, short enough to be worth its time: three spine lengths,
three pressures, two repeats. Costs are minutes of the rig plus minutes of a person's hands.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from model.actuators import Words
from model.condition import NOMINAL_VACUUM
from model.robot import Robot

from ..data.campaign import Campaign, tip_masses

Columns = dict[str, NDArray[np.generic]]

PER_TRIAL, PER_STATE = 25.0, 6.0
"""s: release, grow, jam and vent; ramp's end until a reading is settled and averaged."""
TURN, MASS = 90.0, 0.1
"""deg the body is turned, kg hung on in addition."""


@dataclass(frozen=True)
class Experiment:
    """One thing to do."""

    id: str
    do: str
    parameters: Mapping[str, Any]
    """Protocol parameters, SI, with the protocol's name under `protocol`."""
    hands: float
    """Minutes of a person's work before it can run."""
    channels: tuple[str, ...] = ()
    """Channels that are measured in addition to those of the campaign."""

    @property
    def minutes(self) -> float:
        """Cost in minutes."""
        rig = sum(PER_TRIAL for _ in _sweeps(self.parameters)) + sum(s.seconds for s in _states(self.parameters))
        return round(self.hands + rig / 60, 1)


@dataclass(frozen=True)
class _State:
    spine_length: float
    pressure: float
    branch: str
    repeat: int
    vacuum: float
    hold: float
    seconds: float = field(default=PER_STATE)


def candidate_experiments(robot: Robot, s: Campaign) -> list[Experiment]:
    """Experiments that the campaign does not hold yet."""
    lengths, pressures = _three(s.spine_length, 0.005), _three(s.highest[s.highest > s.pressure_gap], s.pressure_gap)
    chambers = _inflated(s)
    count, words = len(robot.actuators.azimuths_deg), robot.actuators.words
    others = _other_chambers(chambers, count, s)
    mass = float(np.median(tip_masses(robot, s.rows)))
    default_vacuum = NOMINAL_VACUUM if robot.spine is not None else 0.0
    vacuum = float(np.median([default_vacuum if r.vacuum is None else r.vacuum for r in s.rows]))
    base: dict[str, Any] = {
        "protocol": "bending", "spine_lengths": lengths, "pressures": pressures, "chambers": chambers, "unload": False,
        "repeats": 2, "rate": 25e3, "tip_mass": mass, "vacuums": [round(vacuum, -3)],
    }  # fmt: skip
    low = [round(0.6 * p, -3) for p in pressures]
    vacuums = [round(share * vacuum, -3) for share in (0.5, 0.75, 1.0)]
    every = list(range(1, count + 1))
    stretch = {**base, "protocol": "elongation", "pressures": low, "chambers": every}
    hold = {**base, "reading": "hold", "hold_times": [2.0, 10.0, 30.0]}
    fast = {**base, "reading": "sweep", "rate": 100e3, "unload": True}
    heavy = {**base, "tip_mass": round(mass + MASS, 4)}
    quaternion = ("qw", "qx", "qy", "qz")
    offered = [
        Experiment("unload", "read the unload branch too", {**base, "unload": True}, 0.0),
        Experiment("orientation", "track the tip's orientation (rigid body in motion capture)", base, 5.0, quaternion),
        Experiment("elongation", "inflate all chambers together", stretch, 0.0),
        Experiment("roll", f"turn the body by {TURN:g} deg in its mount", {**base, "roll_deg": TURN}, 15.0),
        Experiment("tip_mass", f"hang {MASS * 1e3:g} g more on the tip", heavy, 3.0),
        Experiment("hold", "hold each pressure and read again and again", hold, 0.0),
        Experiment("rate", "ramp fast up and down, and read without stopping", fast, 0.0),
    ]
    if others:
        turned = {**base, "chambers": others}
        offered.insert(3, Experiment("other_chambers", f"inflate {words.group(others)} instead", turned, 0.0))
    if robot.spine is not None and (between := _between(s.spine_length, 0.005)):
        shown = ", ".join(f"{x * 100:g}" for x in between)
        offered.append(Experiment("lengths", f"spine lengths in between: {shown} cm", {**base, "spine_lengths": between}, 0.0))
    if between := _between(s.highest[s.highest > s.pressure_gap], s.pressure_gap):
        offered.append(Experiment("pressures", "pressures in between", {**base, "pressures": between}, 0.0))
    if robot.spine is not None:
        offered.insert(-1, Experiment("vacuum", "sweep the vacuum", {**base, "vacuums": vacuums}, 0.0))
    if robot.markers:
        names = tuple(f"m{k}{axis}" for k in range(1, len(robot.markers) + 1) for axis in "xyz")
        offered.append(Experiment("markers", "put markers along the body", base, 20.0, names))
    return [replace(e, do=words.say(e.do)) for e in offered if not _already_recorded(e.id, s)]


def _other_chambers(chambers: list[int], count: int, s: Campaign) -> list[int]:
    """The chambers shifted around the ring of `count` so that the campaign never inflated them together; empty if all were.

    Chambers are numbered from 1. A shift by a third of the ring is tried first.
    """
    third = count // 3
    shifts = sorted(range(1, count), key=lambda shift: (shift != third, shift))
    shifted = (sorted((c - 1 + shift) % count + 1 for c in chambers) for shift in shifts)
    return next((group for group in shifted if tuple(group) not in s.chambers), [])


def _already_recorded(id: str, s: Campaign) -> bool:
    """Whether the campaign holds such states already."""
    rows = s.rows
    has = {
        "unload": any(r.branch == "unload" for r in rows),
        "orientation": any(r.orientation is not None for r in rows),
        "markers": any(r.markers for r in rows),
        "elongation": any(min(r.pressures) > s.pressure_gap for r in rows),
        "roll": len({round(r.roll_deg or 0.0) for r in rows}) > 1,
        "tip_mass": len({round(r.tip_mass or 0.0, 3) for r in rows}) > 1,
        "vacuum": len({round((r.vacuum or 0.0) / 10e3) for r in rows if r.spine_length > 0.01}) > 2,
        "rate": any(r.hold is not None and r.hold <= 0 for r in rows),
    }
    return has.get(id, False)


def columns(p: Mapping[str, Any], chambers: int, channels: tuple[str, ...]) -> Columns:
    """The table of trials that protocol parameters would give; measured channels hold zeros (orientation: no turn)."""
    states = list(_states(p))
    n = len(states)
    trial = {key: i + 1 for i, key in enumerate(dict.fromkeys((s.repeat, s.vacuum, s.spine_length) for s in states))}
    out: Columns = {
        "trial": np.array([trial[s.repeat, s.vacuum, s.spine_length] for s in states]),
        "repeat": np.array([s.repeat for s in states]),
        "protocol": np.array([p["protocol"]] * n),
        "branch": np.array([s.branch for s in states]),
        "t": np.cumsum([s.seconds for s in states]),
        "rate": np.full(n, p["rate"]),
        "hold": np.array([s.hold for s in states]),
        "spine_length": np.array([s.spine_length for s in states]),
        "vacuum": np.array([s.vacuum for s in states]),
        "tip_mass": np.full(n, p["tip_mass"]),
        "roll_deg": np.full(n, p.get("roll_deg", 0.0)),
    }
    for c in range(1, chambers + 1):
        out[f"p{c}"] = np.array([s.pressure if c in p["chambers"] else 0.0 for s in states])
    for name in channels:
        out[name] = np.full(n, 1.0 if name == "qw" else 0.0)
    return out


def to_apply(p: Mapping[str, Any], words: Words) -> str:
    """The states that protocol parameters ask for in one line, for a robot that no rig drives.

    >>> from model.actuators import Tendons
    >>> sweep = {"pressures": [20e3, 45e3], "chambers": [2], "unload": True, "repeats": 2, "rate": 25e3}
    >>> to_apply(sweep, Tendons.words)
    'tendon 2: 0, 2, 4.5 N and back, 2 times, at 2.5 N/s'
    """
    levels = ", ".join(f"{x / words.pascal:.3g}" for x in (0.0, *p["pressures"]))
    parts = [f"{words.group(p['chambers'])}: {levels} {words.unit}{' and back' if p['unload'] else ''}"]
    parts += [f"{p['repeats']} times", f"at {p['rate'] / words.pascal:.3g} {words.unit}/s"]
    if p.get("hold_times"):
        parts.append(f"read after {', '.join(f'{x:g}' for x in p['hold_times'])} s")
    if any(p.get("spine_lengths", ())):
        parts.append(f"spine {', '.join(f'{100 * x:g}' for x in p['spine_lengths'])} cm")
    return ", ".join(parts)


def _sweeps(p: Mapping[str, Any]) -> Iterator[tuple[int, float, float]]:
    return itertools.product(range(1, p["repeats"] + 1), p["vacuums"], p["spine_lengths"])


def _states(p: Mapping[str, Any]) -> Iterator[_State]:
    """The states in the order in which the protocol visits them."""
    up = [(x, "load") for x in [0.0, *p["pressures"]]]
    down = [(x, "unload") for x in [*p["pressures"][-2::-1], 0.0]] if p["unload"] else []
    reading = p.get("reading", "settled")
    # s from the ramp's end to the middle of a settled reading
    holds = {"settled": [3.0], "sweep": [0.0], "hold": p.get("hold_times", [])}[reading]
    for repeat, vacuum, length in _sweeps(p):
        before = 0.0
        for pressure, branch in up + down:
            climb, before, waited = abs(pressure - before) / p["rate"], pressure, 0.0
            for hold in holds:
                yield _State(length, pressure, branch, repeat, vacuum, hold, climb + max(hold - waited, 0.0) + 1.0)
                climb, waited = 0.0, hold


def _three(values: NDArray[np.float64], gap: float) -> list[float]:
    """Lowest, middle and highest of the settings used, rounded to the setting's grain."""
    known = np.unique(np.round(values / gap) * gap)
    picked = np.unique(known[[0, len(known) // 2, -1]]) if known.size else known
    return [float(np.round(x, 6)) for x in picked]


def _between(values: NDArray[np.float64], gap: float) -> list[float]:
    """Settings half-way between those used, where these are few."""
    known = np.unique(np.round(values / gap) * gap)
    return [float(np.round(x, 6)) for x in (known[:-1] + known[1:]) / 2] if len(known) <= 4 else []


def _inflated(s: Campaign) -> list[int]:
    """Numbers of the chambers inflated in the state with the highest pressure of the main sweep."""
    main = np.flatnonzero(s.kind == 0)
    row = s.pressure[main[np.argmax(s.highest[main])]]
    return [int(i) + 1 for i in np.flatnonzero(row > 0.5 * row.max())]
