"""Landing without the guard that owned the rig: a new one opens every actuator and lands it.

Used when the guard was lost, and by `lab safe`. An arm that refuses to be opened because its own safety system holds it,
or because it is without power, is at rest by what its controller says.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence

from drivers.errors import DeviceFault, InstrumentError, NotReady

from .actuators import Actuators
from .clock import RigClock
from .landing import SafeReport, SafeStep
from .latch import RigLocked
from .rig_file import RigFile

REACH_WITHIN = 8.0
"""Host seconds in which an actuator must let itself be opened; an earlier connection to the arm takes some to end."""
PAUSE = 0.3


def land_anew(actuators: Actuators, names: Sequence[str], within: float = 0.0) -> SafeReport:
    """Open these actuators, trying for `within` host seconds, and land them; what cannot be reached is told so."""
    unreached: list[SafeStep] = []
    with contextlib.suppress(InstrumentError, ValueError, RuntimeError):
        actuators.open("gauge")  # confirms that the spine is released; without it the relay's word must do
    for name in names:
        try:
            _reach(actuators, name, within)
        except InstrumentError as e:
            at_rest = name == "arm" and isinstance(e, DeviceFault)
            unreached.append(SafeStep(name, at_rest, e.message if at_rest else f"not reached: {e.message}"))
    return SafeReport((*actuators.safe().steps, *unreached))


def _reach(actuators: Actuators, name: str, within: float) -> None:
    give_up = time.monotonic() + within
    while True:
        try:
            actuators.open(name)
            return
        except DeviceFault:
            raise
        except InstrumentError as e:
            if time.monotonic() > give_up or (isinstance(e, NotReady) and "power" in e.message):
                raise
        time.sleep(PAUSE)


def rescue(file: RigFile, clock: RigClock, names: Sequence[str]) -> SafeReport:
    """Land a rig whose guard was lost; unlocks it when everything is confirmed."""
    try:
        actuators = Actuators(file, clock, lambda name, sample: None, despite_latch=True)
    except RigLocked as e:
        return SafeReport((SafeStep("guard", False, str(e)),))
    try:
        report = land_anew(actuators, names, REACH_WITHIN)
        if report.confirmed:
            actuators.unlock()
        return report
    finally:
        actuators.close()
