"""The actuators' side of a rig: which driver serves which instrument, what may be asked of it, and what is polled."""

from __future__ import annotations

import os
import statistics
from collections import deque
from collections.abc import Callable
from typing import Any

import timing
from drivers.configs import HOSTS, PORTS
from timing import Clock

from ..files.all_drivers import drivers
from ..files.rig_file import RigFile, present, table_of
from .door import names_of_path

COMMANDS: dict[str, tuple[str, ...]] = {
    "pressure": ("set", "read", "vent"),
    "spine": ("home", "move_to", "stop", "read"),
    "valve": ("set", "read"),
    "gauge": ("read",),
    "arm": ("move_to", "moving", "stop", "standing"),
}
"""What may be asked of each instrument."""
ENERGISING = {("pressure", "set"), ("spine", "home"), ("spine", "move_to"), ("valve", "set"), ("arm", "move_to")}
"""Commands after which the rig is no longer in its safe state."""
POLLED = ("pressure", "spine", "valve", "gauge")
ACTUATORS = ("arm", "pressure", "spine", "valve")
"""What can move, push or hold something."""


TIMED = 20
"""Readings whose median time is compared with `poll`."""


class PollRate:
    """Whether readings of one instrument are quick enough for `poll` of rig.yaml."""

    def __init__(self, name: str, config: Any, poll: float) -> None:
        """`poll`: readings a second; a driver that waits between readings has `poll_interval` (s) in its table."""
        self._name, self._poll = name, poll
        self._longest = 2 * max(1 / poll, getattr(config, "poll_interval", 0.0))
        self._times: deque[float] = deque(maxlen=TIMED)
        self._reported = False

    def timed(self, read: Callable[[], Any]) -> Any:
        """Return what `read` does, and note how long it took."""
        began = timing.now()
        sample = read()
        self._times.append(timing.now() - began)
        return sample

    def notices(self) -> list[str]:
        """Return a warning, once, when fewer than half of the readings can be made."""
        if self._reported or len(self._times) < TIMED or (taken := statistics.median(self._times)) <= self._longest:
            return []
        self._reported = True
        return [
            f"{self._name}: a reading takes {taken * 1e3:.0f} ms, fewer than half of `poll: {self._poll:g}` Hz in rig.yaml are "
            "made; raise its baud rate, set the latency timer of its adapter to 1 ms, or lower `poll`"
        ]


def make(name: str, driver: str, config: Any, clock: Clock) -> Any:
    """The driver of one instrument, not yet opened."""
    return drivers()[driver].make(name, config, clock)


def exclusive(rig: RigFile) -> dict[str, frozenset[str]]:
    """What only one program may use, by instrument: serial lines, as written and with links followed, and the computers of
    actuators. Cameras and the lab's own sensors on a network may be shared."""
    found = {}
    for name in present(rig.instruments):
        config = table_of(rig.instruments, name)
        lines = [v for key in PORTS for v in _texts(getattr(config, key, None))]
        paths = {p for line in lines for p in (os.path.abspath(line), os.path.realpath(line))}
        hosts = [v for key in HOSTS for v in _texts(getattr(config, key, None))] if name in ACTUATORS else []
        found[name] = frozenset({f"line:{p}" for p in paths} | {f"host:{h}" for h in hosts})
    return found


def owned_names(rig: RigFile) -> frozenset[str]:
    """All names of a rig's guard, see `door`."""
    path = names_of_path(rig.path) if rig.path is not None else frozenset()
    return path.union(*exclusive(rig).values())


def _texts(value: object) -> tuple[str, ...]:
    """TMCL has a `host` that is a number on its bus: no address."""
    values = value if isinstance(value, tuple) else (value,)
    return tuple(v for v in values if isinstance(v, str) and v)
