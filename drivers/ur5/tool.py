"""What the controller takes to be at the flange, which the pendant can change after `open`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import WrongDevice
from .motion import distance_between, turn_between

PAYLOAD_TOLERANCE, CENTRE_TOLERANCE = 0.01, 1e-3
"""kg and m: the pendant shows no finer."""
TCP_TOLERANCE = 1e-6
"""m and rad: what the controller's own arithmetic changes."""


@dataclass(frozen=True)
class Tool:
    """Payload (kg), its centre of gravity (m), TCP (m, rotation vector rad), in the flange frame; None: not told."""

    payload: float | None
    centre: Sequence[float] | None
    tcp: Sequence[float]

    def check(self, name: str, at_open: Tool, wanted: float | None) -> None:
        """Raise WrongDevice when the payload is not the one wanted (kg), or anything not as it was at `open`."""
        if wanted is not None and self.payload is not None and abs(self.payload - wanted) > PAYLOAD_TOLERANCE:
            raise WrongDevice(
                name,
                f"the payload is set to {self.payload:.3f} kg, needed {wanted:.3f} kg; set it in the installation at the "
                "pendant, or correct payload in rig.yaml",
            )
        if self.payload is not None and at_open.payload is not None:
            same = abs(self.payload - at_open.payload) <= PAYLOAD_TOLERANCE
            self._demand(same, name, "payload", f"{self.payload:.3f} kg", f"{at_open.payload:.3f} kg")
        if self.centre is not None and at_open.centre is not None:
            same = distance_between(self.centre, at_open.centre) <= CENTRE_TOLERANCE
            now, then = millimetres(self.centre), millimetres(at_open.centre)
            self._demand(same, name, "payload's centre of gravity", now, then)
        self._demand(same_pose(self.tcp, at_open.tcp), name, "TCP", _words(self.tcp), _words(at_open.tcp))

    @staticmethod
    def _demand(same: bool, name: str, what: str, now: str, then: str) -> None:
        if not same:
            raise WrongDevice(
                name,
                f"the {what} is now {now}, needed as at open {then}; set it back at the pendant, or close and open the arm",
            )


def same_pose(a: Sequence[float], b: Sequence[float]) -> bool:
    """Whether two poses agree within the controller's arithmetic."""
    return distance_between(a, b) <= TCP_TOLERANCE and turn_between(a, b) <= TCP_TOLERANCE


def millimetres(pose: Sequence[float]) -> str:
    """The position of a pose (m) in words."""
    return "(" + ", ".join(f"{x * 1e3:.1f}" for x in pose[:3]) + ") mm"


def _words(pose: Sequence[float]) -> str:
    return f"{millimetres(pose)} turned by ({', '.join(f'{x:.4f}' for x in pose[3:])}) rad"
