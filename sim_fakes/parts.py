"""What a rig of fakes is made of, for those who switch its parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from .accidents import Accidents
from .instrument import Part
from .motive import MotiveFake
from .plant import Plant
from .pty_fake import PtyFake
from .ur.process import UrProcess


class Parts(Protocol):
    """The fakes of one rig; `rig.FakeRig` has them."""

    parts: dict[str, Part]
    plant: Plant
    accidents: Accidents

    @property
    def lines(self) -> dict[str, PtyFake]: ...

    @property
    def mocap(self) -> MotiveFake | None: ...

    @property
    def ur(self) -> UrProcess | None: ...


class Switch(Protocol):
    """What switches the faults of a rig by name; `faults.FaultSwitch` does."""

    def begin(self, instrument: str, fault: str) -> None:
        """Begin a fault."""

    def drop_out(self, instrument: str, seconds: float) -> None:
        """Pull out a cable, and plug it in again after `seconds` of host time."""

    def end(self) -> None:
        """End all faults."""


class Doors(Parts, Protocol):
    """What the back door of a rig reaches."""

    @property
    def switch(self) -> Switch: ...

    def prepare(self, mount: str, tip_mass: float, roll_deg: float, vacuum: float) -> None:
        """What the person at the rig does before a run."""

    def confirm(self, trouble: str) -> dict[str, Any]:
        """A person is asked to put something right."""

    def state(self) -> dict[str, Any]:
        """What the plant is doing."""

    def set_faults(self, line: str, values: Mapping[str, Any]) -> None:
        """Switch faults of one serial fake."""
