"""What the fake length units have in common: a drum that winds the spine's cord between its end stops, and its wire."""

from __future__ import annotations

from timing import RigClock

from .plant import Plant
from .pty_fake import Device, PtyFake
from .punctual import Silence

STEP = 0.005
"""Longest step of the physics, s."""
METRES_PER_TURN, MECHANICAL_LENGTH = 0.1, 0.4
"""m of cord in one turn, and between the end stops."""


class Drum(Device):
    """Cord on a drum; subclasses have the motor."""

    def __init__(self, plant: Plant, counts_per_turn: float, start_length: float) -> None:
        """`counts_per_turn`: below 0 where the motor counts down as the spine grows."""
        self.plant = plant
        self.length = start_length
        """Cord paid out, m; 0 at the retracted end."""
        self.stuck = False
        """The shaft does not turn."""
        self.silence = Silence()
        self._per_metre = counts_per_turn / METRES_PER_TURN
        plant.spine_drive = start_length

    def process(self, dt: float) -> None:
        remaining = dt
        while remaining > 0:
            self._step(min(STEP, remaining))
            remaining -= STEP
        self.plant.spine_drive = self.length

    def _step(self, dt: float) -> None:
        """Advance by dt seconds, at most `STEP`."""
        raise NotImplementedError

    def restart(self) -> None:
        """The supply fails for an instant."""
        raise NotImplementedError

    def _turn(self, counts: float) -> None:
        """Turn the shaft as far as nothing holds it."""
        if not (self.stuck or self.plant.spine_blocked):
            self.length = min(max(self.length + counts / self._per_metre, 0.0), MECHANICAL_LENGTH)


class DrumFake(PtyFake):
    """The wire of a length unit, with the faults "stuck" and "restart"."""

    def __init__(self, name: str, drum: Drum, clock: RigClock, baud: int, seed: int) -> None:
        super().__init__(name, clock, baud, seed)
        self._drum = drum

    def process(self, dt: float) -> None:
        self._drum.stuck = bool(self.faults.extra.get("stuck"))
        if self.faults.extra.pop("restart", False):
            self._drum.restart()
        self._drum.process(dt)

    def restart(self) -> None:
        self._drum.restart()
