"""What a fake instrument is to a rig of fakes: where it is plugged in, and what rig.yaml then says of it."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from timing import RigClock

from .plant import Plant


@runtime_checkable
class FakePart(Protocol):
    """One running piece of a fake instrument: a serial line (`pty_fake.PtyFake`), a server, a process."""

    def start(self) -> None:
        """Begin to answer; returns when it does, or raises."""

    def stop(self) -> None:
        """End; may be called twice and before `start`."""


@dataclass(frozen=True)
class FakeRegulators:
    """Which pressure regulators a rig has, and what may be odd about them; rig.yaml states all but the last."""

    driver: str = "alicat"
    """A registered fake of the role pressure."""
    full_scale: float | None = None
    """Pa; None: the fake's own."""
    firmware: str = "10v20.0-R24"
    """Of an Alicat; before 6v00 it does not tell its unit of measure."""
    unit: str = "kPa"
    """What an Alicat shows and takes."""
    swapped: tuple[int, int] | None = None
    """Two channels (from 1) whose hoses are exchanged: each inflates the other's chambers."""

    def hoses(self, wiring: Sequence[tuple[int, ...]]) -> tuple[tuple[int, ...], ...]:
        """Chambers that each channel really feeds; ValueError where a swapped one does not exist."""
        groups = dict(enumerate(wiring, 1))
        if self.swapped is not None:
            a, b = self.swapped
            if not {a, b} <= groups.keys():
                raise ValueError(f"swaps channels {a} and {b} of {len(groups)}")
            groups[a], groups[b] = groups[b], groups[a]
        return tuple(groups.values())


@dataclass(frozen=True)
class Site:
    """Where a fake is plugged in."""

    plant: Plant
    clock: RigClock
    seed: int
    hoses: tuple[tuple[int, ...], ...] = ()
    """Of regulators: the chambers that each channel feeds."""
    full_scale: float = 0.0
    """Of regulators: their range, Pa."""
    regulators: FakeRegulators = FakeRegulators()
    host: str = ""
    """A loopback address that this rig has to itself, for what is reached over the network."""
    markers: int = 0
    """Of motion capture: tracked bodies along the robot, in addition to its tip."""


@dataclass(frozen=True)
class Fake:
    """One kind of fake instrument, for the driver of the same name."""

    role: str
    """Key in rig.yaml."""
    plug: Callable[[Site], Sequence[FakePart]]
    """Makes its parts, mostly one, or one serial line a channel; not yet started."""
    table: Callable[[Site, Sequence[Any]], Mapping[str, Any]]
    """Its table in rig.yaml without `driver`, and for regulators without chambers and full_scale."""
    full_scale: float = 500e3
    """Of regulators: Pa, unless asked for otherwise."""


def loopback(host: str) -> str:
    """The address itself when it is one of 127.0.0.0/8; ValueError for any other, and for names."""
    if ipaddress.ip_address(host) not in ipaddress.ip_network("127.0.0.0/8"):
        raise ValueError(f"{host}: fakes listen on loopback addresses only, 127.x.y.z")
    return host


def faults(fake: object) -> str:
    """All that is wrong with what an entry point gives; empty when it is a fake."""
    if not isinstance(fake, Fake):
        return f"is of type {type(fake).__name__}, not sim_fakes.instrument.Fake"
    found = [] if isinstance(fake.role, str) and fake.role else [f"role {fake.role!r} must be a key of rig.yaml"]
    return "; ".join(found + [f"{name} must be callable" for name in ("plug", "table") if not callable(getattr(fake, name))])
