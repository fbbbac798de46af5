"""What a simulator of the lab's own looks like to the diagnosis: ten lines around whatever it is.

    class Mine:
        parameters = ("youngs_modulus.excess",)             # what it can vary; may be empty

        def predict(self, states, parameters):
            softer = 1 + parameters.get("youngs_modulus.excess", 0.0)
            tips = [my_solver(p, modulus=505e3 * softer) for p in states.pressure]
            return Readings(tip=np.array(tips))

    SIMULATOR = Mine()

A package announces it as an entry point of the group `softlab.simulators`; `lab diagnose --simulator` takes its name, or the
file it stands in.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GROUP = "softlab.simulators"


@dataclass(frozen=True)
class States:
    """n settings of the robot, each reached from rest; SI."""

    spine_length: Array
    """(n,) m."""
    pressure: Array
    """(n, chambers) Pa gauge."""
    tip_mass: Array
    """(n,) kg."""
    roll: Array
    """(n,) rad, of the whole robot about its axis."""

    def __len__(self) -> int:
        return len(self.spine_length)


@dataclass(frozen=True)
class Readings:
    """What motion capture would read; base frame, NaN where the simulator finds no equilibrium."""

    tip: Array
    """(n, 3) m."""
    orientation: Array | None = None
    """(n, 4) unit quaternion w, x, y, z of the tip."""
    markers: Array | None = None
    """(n, k, 3) m, in the order of robot.yaml."""


@runtime_checkable
class Forward(Protocol):
    """A simulator."""

    parameters: tuple[str, ...]
    """What it can vary, by the names of `lab effects --json` (`spine_slip.moment`) and of calibration and tolerances
    (`area.excess`, `youngs_modulus.excess`): its own response to these is used, the rod's to all others. They are
    differenced unless it has a method `sensitivities`."""

    def predict(self, states: States, parameters: Mapping[str, float]) -> Readings:
        """Readings of the states; `parameters` name -> how far from the robot as it is described, in the name's unit, 0 for
        a name that is missing."""
