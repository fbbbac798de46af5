"""Which topic of the recording a driver's sample belongs to: the one place where the two rooms meet."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivers.chambers import ChamberMap
from drivers.interfaces import (
    ArmSample,
    BodySample,
    GaugeSample,
    PressureSample,
    SpineSample,
    ValveSample,
    WrenchSample,
)

TOPICS: dict[type, str] = {
    PressureSample: "/pressure", SpineSample: "/spine", ValveSample: "/valve", GaugeSample: "/vacuum",
    WrenchSample: "/force", ArmSample: "/arm", BodySample: "/tip",
}  # fmt: skip
"""A sample's attributes have the names of its topic's fields."""
OF_INSTRUMENT = {
    "pressure": "/pressure", "spine": "/spine", "valve": "/valve", "gauge": "/vacuum", "force": "/force", "mocap": "/tip",
    "arm_state": "/arm",
}  # fmt: skip
"""The topic of each instrument's samples; the lab's own sensors have theirs beside it."""


def recorded(sample: Any, chambers: ChamberMap) -> Any:
    """The sample as it is recorded: pressures by chamber (1..9) instead of by channel."""
    if isinstance(sample, PressureSample):
        return replace(
            sample, setpoint=chambers.by_chamber(sample.setpoint), measured=chambers.by_chamber(sample.measured)
        )
    return sample
