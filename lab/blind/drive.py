"""A blind case measured without wires: the robot is walked through the states and read with the instruments' noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from recordings.trials import Table, TrialRow
from sim_fakes.virtual_robot import Condition, Reading, walk

from .bench_robot import BenchRobot
from .geometry import Geometry
from .sweeps import State, Sweep


@dataclass(frozen=True)
class Noise:
    """One sigma per sample, and how many samples a reading averages: settled, and while ramping."""

    mocap: float = 0.3e-3
    angle: float = math.radians(0.2)
    pressure: float = 100.0
    pressure_spread: float = 300.0
    """Pa of spread within a reading, the sensor's wander included."""
    vacuum: float = 0.005
    """Share of the absolute pressure."""
    frames: tuple[int, int] = (50, 15)
    """Camera frames in a reading; those of a rig that runs at twenty times real speed."""
    polls: tuple[int, int] = (10, 3)


NOISE = Noise()
AMBIENT = 101_325.0


def measure(robot: BenchRobot, sweep: Sweep, rng: np.random.Generator, noise: Noise = NOISE) -> Table:
    """Do a sweep on the robot. Raises `NoEquilibrium` when it snaps away."""
    states = list(sweep.states())
    steps: list[tuple[Condition, State | None]] = []
    for i, state in enumerate(states):
        condition = _condition(sweep, robot.geometry, states, i)
        steps.append((condition, state))
        turns = state.branch == "load" and state.pressure == sweep.pressures[-1] - sweep.band
        if sweep.reading == "fly" and turns:
            # the ramp goes on to its end before it turns
            end = _pressures(sweep, robot.geometry, sweep.pressures[-1])
            steps.append((replace(condition, pressures=end, rejam=False), None))
    readings = walk(robot, [condition for condition, _ in steps])
    pairs = [(s, r) for (_, s), r in zip(steps, readings, strict=True) if s is not None]
    return Table(tuple(_row(sweep, robot.geometry, s, r, rng, noise) for s, r in pairs))


def _pressures(sweep: Sweep, geometry: Geometry, pressure: float) -> tuple[float, ...]:
    return tuple(pressure if c in sweep.chambers else 0.0 for c in range(1, geometry.chambers + 1))


def _condition(sweep: Sweep, geometry: Geometry, states: list[State], i: int) -> Condition:
    s = states[i]
    first = s.step == 1
    waited = 0.0 if first or sweep.reading != "hold" or states[i - 1].pressure != s.pressure else states[i - 1].hold
    return Condition(
        spine_length=s.spine_length,
        pressures=_pressures(sweep, geometry, s.pressure),
        vacuum=s.vacuum,
        tip_mass=sweep.tip_mass,
        roll=math.radians(sweep.roll_deg),
        hold=s.hold - waited,
        rate=sweep.rate,
        rejam=first,
    )


def _row(sweep: Sweep, geometry: Geometry, s: State, r: Reading, rng: np.random.Generator, noise: Noise) -> TrialRow:
    ramping = s.hold == 0
    frames, polls = noise.frames[ramping], noise.polls[ramping]
    lost = 2 if ramping else 1  # a line through the samples takes one more degree of freedom than their mean
    sd = {"spine_length": 0.0}

    def averaged(name: str, value: float, sigma: float, n: int) -> float:
        sd[name] = sigma * math.sqrt(float(rng.chisquare(n - lost)) / (n - lost))
        return value + sigma / math.sqrt(n) * float(rng.normal())

    pressures = np.array(r.pressures)
    for channel in geometry.channels:
        value = averaged(f"p{channel[0]}", float(pressures[channel[0] - 1]), noise.pressure, polls)
        pressures[[c - 1 for c in channel]] = value
        spread = sd[f"p{channel[0]}"] * noise.pressure_spread / noise.pressure
        sd |= {f"p{c}": spread for c in channel}
    x, y, z = (averaged(n, float(v), noise.mocap, frames) for n, v in zip("xyz", r.position, strict=True))
    turn = Rotation.from_rotvec(rng.normal(0, noise.angle / math.sqrt(frames), 3))
    q = (Rotation.from_matrix(r.rotation) * turn).as_quat(canonical=True, scalar_first=True)
    markers = r.markers + rng.normal(0, noise.mocap / math.sqrt(frames), r.markers.shape)
    vacuum = averaged("vacuum", r.vacuum, noise.vacuum * (AMBIENT - r.vacuum), polls)
    return TrialRow(
        trial=s.trial, step=s.step, protocol=sweep.protocol, repeat=s.repeat, branch=s.branch, t=r.t,
        spine_length=r.spine_length, pressures=tuple(float(p) for p in pressures), rate=s.rate, hold=s.hold,
        vacuum=vacuum, tip_mass=sweep.tip_mass, roll_deg=sweep.roll_deg, tip=(x, y, z),
        orientation=(float(q[0]), float(q[1]), float(q[2]), float(q[3])),
        markers=tuple((float(m[0]), float(m[1]), float(m[2])) for m in markers), sd=sd,
    )  # fmt: skip
