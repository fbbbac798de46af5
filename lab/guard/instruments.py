"""Drivers of a rig's instruments, which of them are polled, and what only one program may use."""

from __future__ import annotations

import contextlib
import functools
import ipaddress
import os
import socket
import stat
import statistics
import sys
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import timing
from drivers.configs import PORTS, InstrumentConfig
from drivers.errors import InstrumentError
from timing import Clock

from ..files.rig_file import RigFile, addresses, drivers, present
from .door import names_of_path

POLLED = ("pressure", "spine", "valve", "gauge")
ACTUATORS = ("arm", "pressure", "spine", "valve")
"""What can move, push or hold something."""

RESOLVE_WITHIN = 0.5
"""Host seconds in which a computer's name must be resolved; later it counts as written."""


TIMED = 20
"""Readings whose median time is compared with `poll`."""


class PollRate:
    """Whether readings of one instrument are fast enough for `poll` of rig.yaml."""

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


def of_driver(name: str, config: InstrumentConfig, error: Exception) -> Exception:
    """An error of an instrument; a mistake in its driver as an InstrumentError that names the driver's file and line."""
    folder = Path(sys.modules[drivers()[config.driver].config.__module__].__file__ or "").parent
    lines = [at for at in traceback.extract_tb(error.__traceback__) if folder in Path(at.filename).parents]
    if isinstance(error, InstrumentError) or not lines:
        return error
    where = f"{config.driver}, {Path(lines[-1].filename).name} line {lines[-1].lineno}"
    return InstrumentError(name, f"error in the driver {where}: {type(error).__name__}: {error}")


def exclusive(rig: RigFile) -> dict[str, frozenset[str]]:
    """What only one program may use, by instrument: serial lines, and the computers of actuators. Cameras and the lab's own
    sensors on a network may be shared. Both the text and what it resolves to count, since resolving may fail for
    now."""
    found: dict[str, frozenset[str]] = dict.fromkeys(present(rig.instruments), frozenset())
    for name, key, text in addresses(rig.instruments):
        if key in PORTS:
            found[name] |= {f"line:{line}" for line in _line_identities(text)}
        elif name in ACTUATORS:
            found[name] |= {f"host:{host}" for host in _hosts(text)}
    return found


def _line_identities(port: str) -> set[str]:
    """All names of a serial line, to find two spellings of it: paths and number of a device, or addresses and port of a host."""
    port = port.strip()
    if "://" in port:
        try:
            url = urlsplit(port)
            return {f"{address}:{url.port}" for address in _hosts(url.hostname or "")}
        except ValueError:
            return {port}
    identities = {os.path.abspath(port), os.path.realpath(port)}
    with contextlib.suppress(OSError, ValueError):
        status = os.stat(port)
        if stat.S_ISCHR(status.st_mode):
            identities.add(f"device {os.major(status.st_rdev)}:{os.minor(status.st_rdev)}")
    return identities


@functools.lru_cache
def _hosts(host: str) -> frozenset[str]:
    """The name and numeric addresses of a computer; the name alone where no name server answers within `RESOLVE_WITHIN`."""
    host = host.strip().rstrip(".").lower()
    texts: list[str] = []

    def resolve() -> None:
        with contextlib.suppress(OSError, UnicodeError):
            texts.extend(str(answer[4][0]) for answer in socket.getaddrinfo(host, None, type=socket.SOCK_STREAM))

    with contextlib.suppress(OSError, UnicodeError):
        texts += [str(answer[4][0]) for answer in socket.getaddrinfo(host, None, 0, socket.SOCK_STREAM, 0, socket.AI_NUMERICHOST)]
    if not texts and host:
        asking = timing.Thread(target=resolve, name="resolve")
        asking.start()
        asking.join(RESOLVE_WITHIN)
    return frozenset({host, *(_plain_address(text) for text in texts.copy())})


def _plain_address(text: str) -> str:
    """One spelling of a numeric address: IPv4 in IPv6 is IPv4, and no address in particular is this computer."""
    address = ipaddress.ip_address(text.partition("%")[0])
    address = getattr(address, "ipv4_mapped", None) or address
    if address.is_unspecified:
        return "127.0.0.1" if address.version == 4 else "::1"
    return str(address)


def owned_names(rig: RigFile) -> frozenset[str]:
    """All names of a rig's guard, see `door`."""
    path = names_of_path(rig.path) if rig.path is not None else frozenset()
    return path.union(*exclusive(rig).values())
