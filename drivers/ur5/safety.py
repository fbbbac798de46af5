"""What the safety system of a UR controller reports, by name, and what a person must do about it."""

from __future__ import annotations

from dataclasses import dataclass

from ..interfaces import SafetyBit

_POWER_ON = "power on, then close and open the arm again"
_RELEASE = f"make the rig safe, release the button, {_POWER_ON}"
_STOPS: tuple[tuple[SafetyBit, str, str], ...] = (
    (SafetyBit.ROBOT_EMERGENCY_STOP, "robot emergency stop", _RELEASE),
    (SafetyBit.SYSTEM_EMERGENCY_STOP, "system emergency stop", f"a button or input outside the robot; {_RELEASE}"),
    (SafetyBit.EMERGENCY_STOP, "emergency stop", _RELEASE),
    (SafetyBit.FAULT, "safety fault", "see the log on the pendant, restart the controller"),
    (SafetyBit.VIOLATION, "safety violation", "see the log on the pendant, restart the safety system"),
    (SafetyBit.PROTECTIVE_STOP, "protective stop", "clear what was hit, enable the robot at the pendant, close and open the arm"),
    (SafetyBit.THREE_POSITION_STOP, "three-position stop",
     "hold the enabling device half pressed or switch to automatic mode, then close and open the arm"),
    (SafetyBit.SAFEGUARD_STOP, "safeguard stop", "close the guard and reset it, then close and open the arm"),
    (SafetyBit.RECOVERY, "recovery mode", "move the joints back into their limits at the pendant, then close and open the arm"),
    (SafetyBit.STOPPED, "stop by the safety system", f"see the log on the pendant, {_POWER_ON}"),
)  # fmt: skip
"""Bit of safety_status_bits, its name and the remedy, the gravest first."""
_BIT_OF_MODE = {
    3: SafetyBit.PROTECTIVE_STOP,
    4: SafetyBit.RECOVERY,
    5: SafetyBit.SAFEGUARD_STOP,
    6: SafetyBit.SYSTEM_EMERGENCY_STOP,
    7: SafetyBit.ROBOT_EMERGENCY_STOP,
    8: SafetyBit.VIOLATION,
    9: SafetyBit.FAULT,
    12: SafetyBit.SAFEGUARD_STOP,
    13: SafetyBit.THREE_POSITION_STOP,
    14: SafetyBit.THREE_POSITION_STOP,
}
"""safety_mode -> the bit of the same meaning; some stops show in one of the two only."""


_REDUCED_MODE = 2
"""Of safety_mode."""
FULL = 0.99
"""Share of a speed above which nothing limits it."""


def is_reduced(bits: int, mode: int) -> bool:
    """Return whether safety_status_bits or safety_mode report reduced mode."""
    return bool(bits & SafetyBit.REDUCED) or mode == _REDUCED_MODE


@dataclass
class SlowMotion:
    """What limited a motion, as the state showed it meanwhile."""

    top_speed: float
    """Highest speed that it should reach, m/s; 0 for one that mostly turns."""
    fastest: float = 0.0
    """Highest speed measured, m/s."""
    reduced: bool = False
    slider: float = 1.0
    """Lowest position of the speed slider, 0..1."""
    scaling: float = 1.0
    """Lowest share of its speed that the controller allowed, 0..1."""

    def seen(self, speed: float, reduced: bool, slider: float, scaling: float) -> None:
        """Note one state: measured speed (m/s), reduced mode, slider and scaling."""
        self.fastest = max(self.fastest, speed)
        self.reduced |= reduced
        self.slider, self.scaling = min(self.slider, slider), min(self.scaling, scaling)

    def text(self) -> str:
        """Return how slow the motion was, what limited it, and the remedies."""
        causes = []
        if self.reduced:
            causes.append(
                "the arm was in reduced mode (a safety input or plane limits its speed): end that where the cell sets it, or "
                "command less speed"
            )
        if self.slider < FULL:
            causes.append(f"the speed slider is at {self.slider:.0%}: set it to 100 % at the pendant")
        if self.scaling < FULL and abs(self.scaling - self.slider) > 1 - FULL:  # else it only repeats the slider
            causes.append(
                f"the controller scaled the speed to {self.scaling:.0%} (speed_scaling): command less speed or acceleration, "
                "and see its safety limits"
            )
        if not causes:
            causes.append("see the log and the safety limits at the pendant for what held it up, or command less speed")
        slow = self.fastest < FULL * self.top_speed
        how = [f"slower than asked ({self.fastest * 1e3:.0f} of {self.top_speed * 1e3:.0f} mm/s)"] if slow else []
        return "; ".join(how + causes)


def stop_text(bits: int, mode: int) -> str:
    """Return the name of the stop that safety_status_bits and safety_mode report, and its remedy; empty when there is none."""
    runs = bool(bits & (SafetyBit.NORMAL | SafetyBit.REDUCED))
    if runs:  # an enabling device that nobody holds stops nothing while the controller says that the arm may move
        bits &= ~int(SafetyBit.THREE_POSITION_STOP)
    bits |= int(_BIT_OF_MODE.get(mode, 0))
    for bit, name, remedy in _STOPS:
        if bits & bit:
            return f"{name}; {remedy}"
    return "" if runs else f"safety bits {bits:#x}, neither normal nor reduced mode; see the log on the pendant"
