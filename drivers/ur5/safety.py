"""What the safety system of a UR controller reports, by name, and what a person must do about it."""

from __future__ import annotations

THREE_POSITION = 11
_POWER_ON = "power on, then close and open the arm again"
_RELEASE = f"make the rig safe, release the button, {_POWER_ON}"
_STOPS: tuple[tuple[int, str, str], ...] = (
    (6, "robot emergency stop", _RELEASE),
    (5, "system emergency stop", f"a button or input outside the robot; {_RELEASE}"),
    (7, "emergency stop", _RELEASE),
    (9, "safety fault", "see the log on the pendant, restart the controller"),
    (8, "safety violation", "see the log on the pendant, restart the safety system"),
    (2, "protective stop", "clear what was hit, enable the robot at the pendant, close and open the arm"),
    (THREE_POSITION, "three-position stop", "hold the enabling device half pressed or switch to automatic mode, then close and "
     "open the arm"),
    (4, "safeguard stop", "close the guard and reset it, then close and open the arm"),
    (3, "recovery mode", "move the joints back into their limits at the pendant, then close and open the arm"),
    (10, "stop by the safety system", f"see the log on the pendant, {_POWER_ON}"),
)  # fmt: skip
"""Bit of safety_status_bits, its name and the remedy, the gravest first."""
_BIT_OF_MODE = {3: 2, 4: 3, 5: 4, 6: 5, 7: 6, 8: 8, 9: 9, 12: 4, 13: THREE_POSITION, 14: THREE_POSITION}
"""safety_mode -> the bit of the same meaning; some stops show in one of the two only."""


def stop_text(bits: int, mode: int) -> str:
    """Return the name of the stop that safety_status_bits and safety_mode report, and its remedy; empty when there is none."""
    # normal mode, reduced mode
    runs = bool(bits & (1 << 0 | 1 << 1))
    if runs:  # an enabling device that nobody holds stops nothing while the controller says that the arm may move
        bits &= ~(1 << THREE_POSITION)
    bits |= 1 << _BIT_OF_MODE[mode] if mode in _BIT_OF_MODE else 0
    for bit, name, remedy in _STOPS:
        if bits >> bit & 1:
            return f"{name}; {remedy}"
    return "" if runs else f"safety bits {bits:#x}, neither normal nor reduced mode; see the log on the pendant"
