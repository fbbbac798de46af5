"""A campaign on one robot of a world: every distinct state solved once, trials apart by small changes to first order.

Readings of trial j: those of its state, plus what its own spine (length, stiffness), the drift of E, its mounting and the
course of outside causes change; then camera and sensors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .body import WorldBody
from .forms import Physics, physics
from .frames import rotation_vector, transposed, turn
from .outside import Cause
from .robot import Lanes, Places, lanes
from .table import World
from .walk import Leg, walk

Array = NDArray[np.float64]


def _softer(b: WorldBody, x: Array) -> None:
    b.stiff_silicone *= (1 - x)[:, None, None]


DRIFT = Cause("modulus_drift", "material", 0.02, _softer, "body")
"""What E loses over a campaign; not an effect but a tolerance."""
STEPS = {"area": 0.01, "grown": 1e-3, "jammed": 0.02, DRIFT.id: 1.0, "tilt_x": 2e-3, "tilt_y": 2e-3}
"""Changes by which the response of each state is taken: relative, m, relative, 2 %, rad, rad."""
GROWN, JAMMED = 1e-3, 0.02
CHANNELS = ((9, 1, 2), (3, 4, 5), (6, 7, 8))
"""Chambers that share a regulator."""
MEMORY = 60.0
"""s over which the camera's slow error is forgotten."""


@dataclass(frozen=True)
class WorldRobot:
    """One robot of a world. Sizes in plausible scales, tolerances of the effects included."""

    world: World
    sizes: Mapping[str, float]
    outside: Mapping[str, float]
    causes: Mapping[str, Cause]
    """Those outside the catalogue, by id."""
    places: Places
    area_factor: float
    length: float
    offset: tuple[float, float, float]
    """m, of the camera frame's origin."""
    drift: float
    """Share of E that is lost at the end of the campaign."""

    @property
    def present(self) -> dict[str, float]:
        """Everything that is on, by id."""
        return {k: v for k, v in {**self.sizes, **self.outside}.items() if v}

    def physics(self) -> Physics:
        """Its laws."""
        return physics(self.world.forms, {**self.causes, DRIFT.id: DRIFT})


@dataclass(frozen=True)
class Jamming:
    """One jamming of a sweep."""

    spine: float
    vacuum: float
    repeat: int
    start: float
    """s since the campaign began."""


@dataclass(frozen=True)
class WalkedSweep:
    """What is done in each of its trials; SI units."""

    trials: tuple[Jamming, ...]
    legs: tuple[Leg, ...]
    tip_mass: float
    roll: float
    span: float
    """s of the campaign by which courses count."""

    @property
    def passed(self) -> Array:
        """Share of the campaign that is over when each trial begins."""
        return np.clip(np.array([t.start for t in self.trials]) / self.span, 0, 1)


@dataclass(frozen=True)
class Response:
    """Distinct states (by spine length and vacuum) and how they change: tips (R, u, 3) m, rotations, markers."""

    keys: tuple[tuple[float, float], ...]
    tip: Array
    turns: Array
    markers: Array
    by: Mapping[str, tuple[Array, Array, Array]]
    """Change of tip, rotation vector (body) and markers: for a step of `STEPS`, or what an effect does as it is."""

    def of(self, sweep: WalkedSweep) -> NDArray[np.intp]:
        """The distinct state of each trial."""
        return np.array([self.keys.index((t.spine, t.vacuum)) for t in sweep.trials])


def respond(
    robot: WorldRobot, sweep: WalkedSweep, without: Sequence[str] = (), extra: Mapping[str, float] | None = None
) -> Response:
    """Solve the sweep with all its changes. Raises `NoWorldEquilibrium`.

    `without`: present effects whose share is wanted (what the tip loses without them); `extra`: sizes (plausible scales) of
    effects that are added on top, one at a time.
    """
    keys = tuple(sorted({(t.spine, t.vacuum) for t in sweep.trials}))
    u = len(keys)
    small = {k: v for k, v in STEPS.items() if k != "jammed" or any(key[0] for key in keys)}
    names = ["", *small, *(f"without {e}" for e in without), *(f"with {e}" for e in extra or {})]
    n = u * len(names)
    lane = {name: slice(i * u, (i + 1) * u) for i, name in enumerate(names)}
    everything = {*robot.present, *(extra or {})}
    sizes = {e: np.full(n, robot.present.get(e, 0.0)) for e in everything}
    sizes[DRIFT.id] = np.zeros(n)
    sizes[DRIFT.id][lane[DRIFT.id]] = STEPS[DRIFT.id]
    for e in without:
        sizes[e][lane[f"without {e}"]] = 0.0
    for e, size in (extra or {}).items():
        sizes[e][lane[f"with {e}"]] += size
    made: Lanes = lanes(
        np.tile([k[0] for k in keys], len(names)), sizes, robot.places, area_factor=robot.area_factor,
        vacuum=np.tile([k[1] for k in keys], len(names)), tip_mass=sweep.tip_mass, roll=sweep.roll, length=robot.length,
    )  # fmt: skip
    made.area_factor[lane["area"]] *= 1 + STEPS["area"]
    made.grown[lane["grown"]] = STEPS["grown"]
    if "jammed" in lane:
        made.jammed[lane["jammed"]] = 1 + STEPS["jammed"]
    made.tilt[lane["tilt_x"], 0] = STEPS["tilt_x"]
    made.tilt[lane["tilt_y"], 1] = STEPS["tilt_y"]
    path = walk(made, robot.physics(), sweep.legs)
    tip, turns, markers = path.tip[:, :u], path.turns[:, :u], path.markers[:, :u]
    by = {}
    for name in names[1:]:
        own = lane[name]
        sign = -1.0 if name.startswith("without ") else 1.0
        by[name.removeprefix("without ").removeprefix("with ")] = (
            sign * (path.tip[:, own] - tip),
            sign * rotation_vector(transposed(turns) @ path.turns[:, own]),
            sign * (path.markers[:, own] - markers),
        )
    return Response(keys, tip, turns, markers, by)


def courses(robot: WorldRobot, sweep: WalkedSweep) -> dict[str, Array]:
    """Size of each outside cause with a course, in each trial, relative to its largest."""
    return {e: np.asarray(course(sweep.passed)) for e in robot.outside if (course := robot.causes[e].course) is not None}


def drifted(whole: float, passed: Array) -> Array:
    """What has come of a campaign's drift: fast at first, `whole` at its end."""
    return np.asarray(whole * (1 - np.exp(-3 * passed)) / (1 - np.exp(-3.0)))


def tails(rng: np.random.Generator, heavy: bool, shape: int | tuple[int, ...]) -> Array:
    """Normal numbers, or Student's t of three degrees of freedom cut at four."""
    if not heavy:
        return rng.normal(size=shape)
    return np.clip(rng.standard_t(3, size=shape), -4.0, 4.0)


@dataclass(frozen=True)
class SweptReadings:
    """What a table holds, by trial and reading: pressures (T, R, 9) Pa, tip (T, R, 3) m, rotations, markers, vacuum (T, R)."""

    pressures: Array
    tip: Array
    turns: Array
    markers: Array
    vacuum: Array
    t: Array


def read(robot: WorldRobot, sweep: WalkedSweep, response: Response, rng: np.random.Generator) -> SweptReadings:
    """Every trial with its own spine, mounting and time, seen through camera and sensors."""
    world, count = robot.world, len(sweep.trials)
    where = response.of(sweep)
    amounts = {
        "grown": world.spread * GROWN / STEPS["grown"] * tails(rng, world.heavy, count),
        "jammed": world.spread * JAMMED / STEPS["jammed"] * tails(rng, world.heavy, count),
        DRIFT.id: drifted(robot.drift / DRIFT.scale, sweep.passed),
        **{e: a - 1 for e, a in courses(robot, sweep).items()},
    }
    mounted = np.radians(world.remount) * rng.normal(size=(max(t.repeat for t in sweep.trials), 2))
    own = mounted[[t.repeat - 1 if world.remounts else 0 for t in sweep.trials]]
    amounts["tilt_x"], amounts["tilt_y"] = own[:, 0] / STEPS["tilt_x"], own[:, 1] / STEPS["tilt_y"]
    tip, markers = response.tip[:, where].copy(), response.markers[:, where].copy()
    small = np.zeros_like(tip)
    for name, amount in amounts.items():
        if name in response.by:
            dt, dr, dm = (a[:, where] for a in response.by[name])
            tip += amount[:, None] * dt
            small += amount[:, None] * dr
            markers += amount[:, None, None] * dm
    turns = response.turns[:, where] @ turn(small)
    return _seen(robot, sweep, np.swapaxes(tip, 0, 1), np.swapaxes(turns, 0, 1), np.swapaxes(markers, 0, 1), rng)


def _seen(
    robot: WorldRobot, sweep: WalkedSweep, tip: Array, turns: Array, markers: Array, rng: np.random.Generator
) -> SweptReadings:  # fmt: skip
    world, (count, reads) = robot.world, tip.shape[:2]
    legs = [leg for leg in sweep.legs if leg.read]
    t = np.array([trial.start for trial in sweep.trials])[:, None] + _clock(sweep.legs)[None, :]
    sd, angle = world.camera * 1e-3, np.radians(world.camera)
    slow = _slow(rng, t, 6)
    fast = rng.normal(size=(count, reads, 6))
    error = np.sqrt(1 - world.correlated) * fast + np.sqrt(world.correlated) * slow
    tip = tip + sd * error[..., :3] + np.array(robot.offset)
    markers = markers + sd * rng.normal(size=markers.shape) + np.array(robot.offset)
    turns = turns @ turn(angle * error[..., 3:])
    pressures = np.tile(np.array([leg.pressures for leg in legs]), (count, 1, 1))
    # Pa, a regulator's reading beside the truth: slow error and fast noise
    wander = 500.0 * _slow(rng, t, len(CHANNELS)) + 50.0 * rng.normal(size=(count, reads, len(CHANNELS)))
    for k, channel in enumerate(CHANNELS):
        pressures[..., [c - 1 for c in channel]] += wander[..., k, None]
    vacuum = np.array([trial.vacuum for trial in sweep.trials])[:, None] + 100.0 * rng.normal(size=(count, reads))
    return SweptReadings(pressures, tip, turns, markers, vacuum, t)


def _clock(legs: Sequence[Leg]) -> Array:
    """s from a trial's start to each reading."""
    now, at, out = 20.0, np.zeros(9), []
    for leg in legs:
        target = np.asarray(leg.pressures)
        now += float(np.abs(target - at).max()) / leg.rate + leg.hold
        at = target
        if leg.read:
            out.append(now)
    return np.array(out)


def _slow(rng: np.random.Generator, t: Array, columns: int) -> Array:
    """(T, R, columns) numbers of variance one that forget each other over `MEMORY` seconds."""
    flat = t.reshape(-1)
    order = np.argsort(flat, kind="stable")
    out = np.zeros((len(flat), columns))
    state, before = rng.normal(size=columns), None
    for i in order:
        keep = 1.0 if before is None else float(np.exp(-(flat[i] - before) / MEMORY))
        state = keep * state + np.sqrt(max(1 - keep * keep, 0.0)) * rng.normal(size=columns)
        before = float(flat[i])
        out[i] = state
    return out.reshape(*t.shape, columns)
