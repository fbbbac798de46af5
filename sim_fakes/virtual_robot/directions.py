"""What the size of an effect leaves open and the seed decides: directions, places, moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .truth import RobotTruth


@dataclass(frozen=True)
class Directions:
    """What an effect's size leaves open: where to, which chamber, when. Angles in rad about the robot's axis."""

    tether: float
    tilt: float
    precurvature: float
    marker: float
    eccentric: float
    frame_axis: tuple[float, float, float]
    obstacle: float
    """Distance of the obstacle's face from the axis, m, on the side of -x."""
    chamber: int
    """Index of the weak or leaking chamber, 0..8."""
    step_time: float
    """When the temperature steps, s."""
    bad_jam: int
    """Which jamming comes out soft, counted from 0."""
    cores: tuple[float, float] = (0.0, 1.0)
    """Angles towards which the mould's cores stand off, and of how unlike they are."""
    payload: float = 0.0
    """Angle of the bracket at the tip."""
    hoses: tuple[int, ...] = (0, 2, 1)
    """Whose hose each third of the chambers has."""


def draw_directions(truth: RobotTruth, seed: int) -> Directions:
    """What the seed decides for effects that have a direction; fixed values when `truth.canonical_directions`."""
    if truth.canonical_directions:
        return Directions(
            0.0, 0.0, 0.0, 0.0, 0.0, frame_axis=(0.0, 1.0, 0.0), obstacle=0.06, chamber=0, step_time=600.0, bad_jam=1
        )
    rng = np.random.default_rng([seed, 1])
    angles = rng.uniform(-np.pi, np.pi, 5)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    wrong = ((1, 0, 2), (2, 1, 0), (0, 2, 1), (1, 2, 0), (2, 0, 1))
    later = np.random.default_rng([seed, 2])
    return Directions(
        tether=float(angles[0]),
        tilt=float(angles[1]),
        precurvature=float(angles[2]),
        marker=float(angles[3]),
        eccentric=float(angles[4]),
        frame_axis=(float(axis[0]), float(axis[1]), float(axis[2])),
        obstacle=float(rng.uniform(0.04, 0.10)),
        chamber=int(rng.choice([8, 0, 1])),
        step_time=float(rng.uniform(300.0, 1500.0)),
        bad_jam=int(rng.integers(1, 7)),
        cores=(float(later.uniform(-np.pi, np.pi)), float(later.uniform(-np.pi, np.pi))),
        payload=float(later.uniform(-np.pi, np.pi)),
        hoses=wrong[int(later.integers(len(wrong)))],
    )
