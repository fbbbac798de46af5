"""What a simulator of the lab's own looks like to the diagnosis: ten lines around whatever it is.

    class Mine:
        parameters = ("youngs_modulus.excess",)             # what it can vary; may be empty

        def __init__(self, robot):                          # the robot of robot.yaml
            self.robot = robot

        def predict(self, states, parameters):
            modulus = self.robot.youngs_modulus * (1 + parameters.get("youngs_modulus.excess", 0.0))
            return Readings(tip=np.array([my_solver(p, modulus) for p in states.pressure]))

    SIMULATOR = Mine

A package announces it as an entry point of the group `softlab.simulators`; `lab diagnose --simulator` takes its name, or the
Python file in which it stands as SIMULATOR.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from model.arrays import Array
from model.condition import States
from model.robot import Robot

if TYPE_CHECKING:
    from model.rods import Rods


GROUP = "softlab.simulators"
OWN: Mapping[str, tuple[str, str]] = MappingProxyType(
    {"pyelastica": ("model.simulators.pyelastica", "PyElastica"), "soromox": ("model.simulators.soromox", "SoRoMoX")}
)
"""The project's own, by name: module and class. The name is also that of the extra that it needs."""


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
    """A simulator of one robot."""

    parameters: tuple[str, ...]
    """What it can vary, by the names of `lab effects --json` (`spine_slip.moment`) and of calibration and tolerances
    (`area.excess`, `youngs_modulus.excess`): its own response to these is used (differenced), the rod's to all others."""

    def predict(self, states: States, parameters: Mapping[str, float]) -> Readings:
        """Readings of the states; `parameters`: name -> distance from the robot as described, in its unit, 0 if missing."""


def rods_at(robot: Robot, states: States, parameters: Mapping[str, float]) -> Rods:
    """The rod of each state with its loads, the area factor 1 + `area.excess` times robot.yaml's: for simulators of rods.

    Raises `BadCondition`.
    """
    from model.section import rods_of  # the compiler comes with it

    factor, excess = robot.area_factor, 1.0 + parameters.get("area.excess", 0.0)
    larger = {k: v * excess for k, v in factor.items()} if isinstance(factor, Mapping) else factor * excess
    return rods_of(robot.model_copy(update={"area_factor": larger}), states)
