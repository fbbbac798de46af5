"""The blackboard between the fake instruments and the virtual robot: what actuators set, what sensors can see.

Actuator fakes write inputs, the virtual robot's `advance` turns them into outputs, sensor fakes read outputs and add their own
noise and quantisation. Nothing here computes anything. Hold `lock` while reading or writing more than one field.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

import timing

Array = NDArray[np.float64]
AMBIENT = 101_325.0
"""Pa absolute."""


@dataclass
class Plant:
    """State shared by all fakes of one rig; SI units, robot base frame unless a name says otherwise."""

    chambers: int = 9
    """Of the robot."""

    # inputs, written by actuator fakes and by the person at the rig
    regulator: Array = field(init=False)
    """Pressure each chamber's regulator drives towards, Pa gauge, in the order of the chambers."""
    spine_drive: float = 0.0
    """Length the length unit has paid out, m."""
    valve_on: bool = False
    """Vacuum applied to the spine."""
    vacuum_supply: float = 80e3
    """Level a person has set at the vacuum supply, Pa below ambient."""
    probe_position: Array = field(default_factory=lambda: np.array([1.0, 1.0, 1.0]))
    """Tip of the arm's probe, m, arm base frame."""
    probe_rotation: Array = field(default_factory=lambda: np.eye(3))
    """Orientation of the arm's TCP, columns = TCP axes in the arm base frame."""
    flange: Array | None = None
    """Pose (4, 4) of the arm's flange in the arm base frame; None while there is no arm."""
    arm_errors: float = 0.0
    """Size of the differences between the arm and its nominal kinematics, see `RobotTruth`."""
    mount: str = "robot"
    """What a person has mounted: "robot" (body hanging, spine inside), "body" (robot at the stand), "spine" (bare spine)."""
    tip_mass: float = 0.053
    """Mass hung at the tip, kg."""
    roll: float = 0.0
    """Chamber pattern turned about the axis, rad."""

    # outputs, written by the virtual robot
    time: float = 0.0
    """Rig time of the outputs, s."""
    chamber_pressure: Array = field(init=False)
    """What a pressure sensor at each regulator sees, Pa gauge, before noise."""
    spine_length: float = 0.0
    """Length the unit's encoder corresponds to, m (the true spine may differ by an effect)."""
    spine_blocked: bool = False
    """True when jammed granules keep the spine from moving: the motor stalls."""
    vacuum_absolute: float = AMBIENT
    """Pressure in the spine as the gauge sees it, Pa absolute."""
    probe_force: Array = field(default_factory=lambda: np.zeros(3))
    """Force of the specimen on the probe, N, arm base frame."""
    tip_position: Array = field(default_factory=lambda: np.array([0.0, 0.0, 0.4]))
    """Tracked tip body as motion capture would report it in the base frame (frame and marker effects included), m."""
    tip_rotation: Array = field(default_factory=lambda: np.eye(3))
    """Its orientation, columns = body axes in the base frame."""
    markers: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """Body markers at the robot's marker arc lengths, shape (k, 3), m, base frame."""
    tip_visible: bool = True
    """False when the tip is hidden from the cameras."""

    lock: threading.RLock = field(default_factory=timing.RLock, repr=False)

    def __post_init__(self) -> None:
        self.regulator, self.chamber_pressure = np.zeros(self.chambers), np.zeros(self.chambers)
