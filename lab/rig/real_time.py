"""A rig's clock may run faster than the host's for fake instruments only: on hardware every time, age and rate would be wrong.

A fake is recognised by its resolved address, not by its spelling: a pseudo-terminal, or a host of this machine alone. What is not
known to be a fake is real.
"""

from __future__ import annotations

import ipaddress
import os
import socket
import stat

from drivers.configs import PORTS
from timing import RigClock

from ..files.config import ConfigError
from ..files.rig_file import UNIX, ClockConfig, RigFile, addresses
from ..guard.door import listener
from ..plain import typed

FOLDER = "/softlab-"
"""In the paths that `lab fakes` writes: the operator's socket, the serial lines."""
PSEUDO_TERMINALS = range(136, 144)
"""Major device numbers of the slave ends of pseudo-terminals on Linux."""


class FakesEnded(ConfigError):
    """The fakes that wrote a rig.yaml have ended: there is nothing to open, and nothing to make safe."""


def clock_of(rig: RigFile) -> RigClock:
    """The clock of a rig that is about to be opened; raises ConfigError when it is to run fast on something real."""
    demand_fakes(rig)
    return RigClock(rig.clock.speed)


def demand_fakes(rig: RigFile, only: str | None = None) -> None:
    """Raises ConfigError naming what is real on a rig (of one instrument with `only`) whose clock is not the host's."""
    if rig.clock.speed == 1:
        return
    where, rule = rig.path or "rig.yaml", "and only fakes run faster or slower than real time; write speed: 1"
    real: list[str] = []
    for name, key, address in addresses(rig.instruments):
        # a port that is not there is left to opening, which looks again
        if only in (None, name) and not (_fake_line(address) if key in PORTS else _fake_host(address)):
            kind = "not the pseudo-terminal of a fake" if key in PORTS else "not a loopback address"
            at = f"{where}: clock.speed = {rig.clock.speed:g}: instruments.{name}.{key} = {address}"
            real.append(f"{at} is {kind}, {rule}")
    if real:
        raise ConfigError(*real)


def demand_running(rig: RigFile) -> None:
    """Raises FakesEnded when the fakes that wrote a rig.yaml have ended and it reaches nothing but them."""
    theirs = (FOLDER in address if key in PORTS else _fake_host(address) for _, key, address in addresses(rig.instruments))
    if rig.operator.startswith(UNIX) and FOLDER in rig.operator and process_of(rig.operator) is None and all(theirs):
        raise FakesEnded(
            f"{rig.path}: the fakes that wrote this file have ended (no process at operator = {rig.operator}); "
            f"start them again: {typed('lab', 'fakes', '--rig', rig.path)}, with the options that you gave before"
        )


def at_real_speed(rig: RigFile) -> tuple[RigFile, str]:
    """The rig as it can be landed, at speed 1 where something is real, and what to tell of that; a landing is never refused."""
    try:
        demand_fakes(rig)
    except ConfigError as e:
        told = f"{e}\nmaking the rig safe at speed 1 all the same"
        return rig.model_copy(update={"clock": ClockConfig(speed=1.0)}), told
    return rig, ""


def process_of(spec: str) -> int | None:
    """Process that listens at the operator of a rig.yaml, 0 where it may not be asked; None where none does."""
    try:
        return listener(spec.removeprefix(UNIX), within=1.0) if spec.startswith(UNIX) else None
    except OSError:
        return 0


def _fake_line(path: str) -> bool:
    try:
        about = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return path.startswith("/")  # there is nothing to open, unlike behind a terminal server
    except (OSError, ValueError):
        return False
    return stat.S_ISCHR(about.st_mode) and os.major(about.st_rdev) in PSEUDO_TERMINALS


def _fake_host(host: str) -> bool:
    """Whether every address of a host is a loopback address; a name that leads nowhere is none."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    return all(ipaddress.ip_address(str(place[4][0]).partition("%")[0]).is_loopback for place in found)
