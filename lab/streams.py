"""From a driver's sample to the fields of its topic in the recording: the one place where the two rooms meet."""

from __future__ import annotations

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

def fields(sample: Any, chambers: ChamberMap) -> tuple[str, dict[str, Any]]:
    """Topic and fields of one sample; raises TypeError for something that is no sample."""
    match sample:
        case PressureSample():
            return "/pressure", {
                "setpoint": chambers.by_chamber(sample.setpoint),
                "measured": chambers.by_chamber(sample.measured),
            }
        case SpineSample():
            return "/spine", {k: getattr(sample, k) for k in ("length", "speed", "goal", "moving", "homed")}
        case ValveSample():
            return "/valve", {"on": sample.on}
        case GaugeSample():
            return "/vacuum", {"absolute": sample.absolute}
        case WrenchSample():
            return "/force", {"raw": sample.raw, "zero": sample.zero}
        case ArmSample():
            names = ("device_time", "joints", "tcp_pose", "tcp_speed", "safety_bits", "program_running")
            return "/arm", {k: getattr(sample, k) for k in names}
        case BodySample():
            return "/tip", {
                "device_time": sample.device_time,
                "frame": sample.frame,
                "position": sample.position,
                "orientation": sample.orientation,
                "marker_error": sample.marker_error,
                "valid": sample.valid,
                "markers": sample.markers,
            }
    raise TypeError(f"{type(sample).__name__} is not a sample of any driver")
