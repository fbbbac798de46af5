"""Which topic of the recording a driver's sample belongs to: the one place where the two rooms meet."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivers.chambers import ChamberMap
from drivers.interfaces import PressureSample

TOPICS = {
    "pressure": "/pressure", "spine": "/spine", "valve": "/valve", "gauge": "/vacuum", "force": "/force", "mocap": "/tip",
    "arm_state": "/arm",
}  # fmt: skip
"""The topic of each instrument's samples, whose attributes have the names of its fields; the lab's own sensors have theirs beside
it."""


def recorded(sample: Any, chambers: ChamberMap) -> Any:
    """The sample as it is recorded: pressures by chamber (1..9) instead of by channel."""
    if isinstance(sample, PressureSample):
        return replace(sample, setpoint=chambers.by_chamber(sample.setpoint), measured=chambers.by_chamber(sample.measured))
    return sample
