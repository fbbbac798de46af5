"""What a piece of the robot answers to a strain: linear stiffness of silicone and spine, friction, a little viscosity.

Generalised strain of a segment, in its own frame: (shear x, shear y, stretch - 1, curvature x, curvature y, twist).
Generalised stress: (force x, y, z in N, moment x, y, z in N m).

Stiffness    stress = K strain, K diagonal
Friction     sliders: moment K_j (u - x_j), |u - x_j| <= yield curvature of level j; the same for the axial strain
Viscosity    stress += c K (strain - strain before), c = 1 / (exp(dt / settling time) - 1)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .blocks import kernel

Array = NDArray[np.float64]

SLIP_CURVATURES = (0.03, 0.12, 0.35, 0.9)
SLIP_SHARES = (0.3, 0.3, 0.25, 0.15)
"""Yield curvatures (1/m) of the friction levels and their share of the friction moment."""
SLIP_STRAINS = (5e-4, 3e-3)
"""Yield strains of the axial friction levels; they share the friction force equally."""


class Sections(NamedTuple):
    """Material of all segments (first axis) during one step."""

    stiffness: Array
    """(n, 6) Of silicone and spine together: shear, shear, axial (N), bending, bending, torsion (N m^2)."""
    slip_moment: Array
    """(n, 4) Friction moment of each level, N m."""
    slip_force: Array
    """(n, 2) Friction force of each level, N."""
    viscosity: float
    """c of the equation above, a pure number."""
    slips: bool = False
    """False: the sliders are skipped."""
    wall_thrust: float = 0.0
    """N by which the chambers stretch each segment along its own tangent, where the side walls take their thrust."""
    wall_moment: Array = np.zeros((1, 3))
    """(n or 1, 3) N m by which they bend each about its own axes there."""


class SliderHistory(NamedTuple):
    """What the segments remember between steps."""

    strain: Array
    slider: Array
    axial_slider: Array


def fresh_history(segments: int) -> SliderHistory:
    """Memory of a body that has never been loaded."""
    return SliderHistory(
        np.zeros((segments, 6)), np.zeros((segments, len(SLIP_CURVATURES), 2)), np.zeros((segments, len(SLIP_STRAINS)))
    )


def without_friction(stiffness: Array, viscosity: float) -> Sections:
    """Sections of this stiffness (n, 6) on which no slider acts."""
    n = len(stiffness)
    return Sections(stiffness, np.zeros((n, len(SLIP_CURVATURES))), np.zeros((n, len(SLIP_STRAINS))), viscosity)


def approach(dt: float, settling_time: float) -> float:
    """Viscosity factor 1 / (exp(dt / settling time) - 1): exact for a linear rod under constant load, any dt."""
    if settling_time <= 0.0 or dt > 40 * settling_time:
        return 0.0
    return 1.0 / math.expm1(max(dt, 1e-6) / settling_time)


@kernel
def _friction(s: Sections, hist: SliderHistory, k: int, strain: Array, stress: Array, t: Array, commit: bool) -> None:
    """Add the sliders' stress and consistent tangent t (see `respond`), and move them with `commit`; free ones follow."""
    for j in range(len(SLIP_CURVATURES)):
        moment = s.slip_moment[k, j]
        limit = SLIP_CURVATURES[j]
        if moment > 0.0:
            stiff = moment / limit
            ex = strain[3] - hist.slider[k, j, 0]  # curvature of the slider's spring
            ey = strain[4] - hist.slider[k, j, 1]
            size = np.sqrt(ex * ex + ey * ey)
            if size <= limit:
                t[3] += stiff
                t[5] += stiff
            else:
                ratio = limit / size
                ux = ex / size
                uy = ey / size
                ex *= ratio
                ey *= ratio
                t[3] += stiff * ratio * uy * uy
                t[4] -= stiff * ratio * ux * uy
                t[5] += stiff * ratio * ux * ux
            stress[3] += stiff * ex
            stress[4] += stiff * ey
            if commit:
                hist.slider[k, j, 0] = strain[3] - ex
                hist.slider[k, j, 1] = strain[4] - ey
        elif commit:
            hist.slider[k, j, 0] = strain[3]
            hist.slider[k, j, 1] = strain[4]
    for j in range(len(SLIP_STRAINS)):
        force = s.slip_force[k, j]
        if force > 0.0:
            limit = SLIP_STRAINS[j]
            e = strain[2] - hist.axial_slider[k, j]
            if abs(e) <= limit:
                t[2] += force / limit
            else:
                e = limit if e > 0.0 else -limit
            stress[2] += force / limit * e
            if commit:
                hist.axial_slider[k, j] = strain[2] - e
        elif commit:
            hist.axial_slider[k, j] = strain[2]


@kernel
def respond(s: Sections, hist: SliderHistory, k: int, strain: Array, stress: Array, t: Array, commit: bool) -> None:
    """Stress (6) and tangent (7) of segment k: shear, shear, axial, the symmetric bending block xx xy yy, torsion.

    With `commit` the history moves on to this strain: call it once, after equilibrium is found.
    """
    for i in range(6):
        stiff = s.stiffness[k, i]
        stress[i] = stiff * strain[i] + s.viscosity * stiff * (strain[i] - hist.strain[k, i])
        t[i if i < 4 else i + 1] = (1.0 + s.viscosity) * stiff
    stress[2] -= s.wall_thrust
    stress[3:5] -= s.wall_moment[min(k, s.wall_moment.shape[0] - 1), :2]
    t[4] = 0.0  # only friction couples the two bending axes
    if s.slips:
        _friction(s, hist, k, strain, stress, t, commit)
    if commit:
        for i in range(6):
            hist.strain[k, i] = strain[i]
