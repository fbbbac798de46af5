"""How uncertain a prediction is: parameters to first order, law error, discrepancy, and what repeats differ by.

    variance = sum_ij J_i C_ij J_j  +  sum_e (f d_e)^2  +  g^2  +  sum_k (J_k n_k)^2  (+ n_r^2 for a reading)

with J the slopes and C the covariance of the parameters, f the law error (share) and d_e what effect e does to the reading, g
the discrepancy (m) or, in its place, what a learnt residual leaves open, n_k the standard deviations of pressure, spine length,
spine stiffness and mounting from trial to trial and n_r that of a reading; f, g and n are those of robot.yaml's `posterior`, as
its fit found them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from model.arrays import Array
from model.effects.readings import Readings
from model.robot import Robot
from model.rotation import CONJUGATE, multiply, rotation_vector
from model.stated import Noise

PRESSURE = "pressure"
"""Of all chambers in use together, Pa."""
TRIAL = ("spine_length.excess", "spine_stiffness.excess")
"""Tolerances of a single trial."""


def standard_deviations(
    robot: Robot, covariance: Array, here: Readings, slopes: Array, absent: Sequence[Readings], unexplained: Array | None = None
) -> dict[str, Array]:
    """`model_sd`, `sd`, `orientation_sd` and `shape_sd` of a `Prediction`.

    `slopes` (k, n, `channels`) by what `covariance` (k, k) is of, see `uncertain`; `absent`: the readings without each of the
    robot's effects, where the law error is above 0; `unexplained` (n, 1) m^2: variance of the tip in place of the discrepancy,
    where a residual was learnt.
    """
    posterior = robot.posterior
    share, discrepancy = (posterior.law_error, posterior.discrepancy) if posterior else (0.0, 0.0)
    noise = posterior.noise if posterior else Noise()
    reading = np.square(noise.reading_by_axis or (noise.reading,) * 3)  # (3,) m^2
    spread = (np.einsum("ij,jnc->inc", covariance, slopes) * slopes).sum(axis=0)
    # variances: of the tip, of its turn and of the markers
    tips, turns, shapes = spread[:, :3], spread[:, 3:6], spread[:, 7:].reshape(here.markers.shape[1:])
    for other in absent:
        tips = tips + (share * (here.tip[0] - other.tip[0])) ** 2
        shapes = shapes + (share * (here.markers[0] - other.markers[0])) ** 2
        turn_by_effect = rotation_vector(multiply(here.orientation[0], other.orientation[0] * CONJUGATE))
        turns = turns + (share * turn_by_effect) ** 2
    tips, shapes = (
        variance + rest + noise.shift**2 + noise.turn**2 * ((place**2).sum(axis=-1, keepdims=True) - place**2)
        for variance, rest, place in (
            (tips, discrepancy**2 if unexplained is None else unexplained, here.tip[0]),
            (shapes, discrepancy**2, here.markers[0]),
        )
    )
    return {
        "model_sd": np.sqrt(tips),
        "sd": np.sqrt(tips + reading),
        "orientation_sd": np.sqrt(turns + noise.turn**2),
        "shape_sd": np.sqrt(shapes + reading),
    }


def states_uncertainty(robot: Robot) -> bool:
    """Whether robot.yaml states how well its numbers are known, so that a prediction has an interval."""
    return robot.posterior is not None or bool(uncertain(robot)[0])


def uncertain(robot: Robot) -> tuple[tuple[str, ...], Array]:
    """Names (k) of all that a prediction's interval comes from to first order, and its covariance (k, k): the parameters that
    are not exact, and what differs from trial to trial (`TRIAL`, `PRESSURE`)."""
    names, covariance = robot.joint_uncertainty()
    noise = robot.posterior.noise if robot.posterior is not None else Noise()
    spread = {PRESSURE: noise.pressure}
    if robot.spine is not None:
        spread |= dict(zip(TRIAL, (noise.spine_length, noise.spine_stiffness), strict=True))
    further = {name: sd for name, sd in spread.items() if sd > 0}
    return (*names, *further), block_diag(covariance, np.diag([sd**2 for sd in further.values()]))
