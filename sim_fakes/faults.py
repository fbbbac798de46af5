"""Fifteen faults for every instrument of a fake rig, and accidents of the robot itself, by name: what a test, or a person through
the back door, switches on.

    silence delay half split garbage bad_crc wrong_id nak stuck over_range disconnect freeze reset skew replay

A fault that an instrument cannot have becomes the nearest that it can: a point-to-point line has no ids, a datagram is
never half. `reset` is an event; the others last until `end`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

import timing

from .instrument import FakePart
from .motive import MotiveFake
from .plant import Plant
from .pty_fake import Faults, PtyFake
from .ur.process import UrFake, UrProcess

if TYPE_CHECKING:
    from .virtual_robot import VirtualRobot

ACCIDENTS = ("leak", "burst", "supply_low", "valve_stuck", "jam_slip", "contact_lost", "marker_lost")
LEAK_SHARE, LOW_SUPPLY, SLIP = 0.7, 60e3, 8e-3
"""Share of the set-point that a leak leaves; Pa that a low supply reaches; m by which a jammed spine slips."""


class Accidents:
    """What may happen to the robot itself: put between the actuators and the virtual robot, begun and ended while it runs.

    leak          the regulator of a chamber holds 30 % less than its set-point
    burst         a chamber, and all on the same channel, hold nothing
    supply_low    no regulator gets beyond 60 kPa
    valve_stuck   the jamming valve does not follow its relay
    jam_slip      the jammed spine slips back by 8 mm, once
    contact_lost  the specimen breaks off: nothing pushes on the probe any more
    marker_lost   the tip's marker has come off
    """

    def __init__(self, wiring: Sequence[Sequence[int]]) -> None:
        self._wiring = wiring
        self._now: set[str] = set()
        self._valve: bool | None = None

    def begin(self, accident: str) -> None:
        """Let it happen. Raises ValueError for an unknown name."""
        if accident not in ACCIDENTS:
            raise ValueError(f"{accident}: one of {', '.join(ACCIDENTS)}")
        self._now.add(accident)

    def end(self) -> None:
        """Everything repaired."""
        self._now.clear()
        self._valve = None

    def advance(self, robot: VirtualRobot, plant: Plant, dt: float) -> None:
        """One step of the robot with what has happened to it; call with the plant's lock held."""
        if not self._now:
            robot.advance(plant, dt)
            return
        regulator, valve = plant.regulator.copy(), plant.valve_on
        damaged = [c - 1 for c in self._wiring[0]]
        if "supply_low" in self._now:
            plant.regulator = np.minimum(plant.regulator, LOW_SUPPLY)
        if {"leak", "burst"} & self._now:
            plant.regulator[damaged] *= 0.0 if "burst" in self._now else LEAK_SHARE
        if "valve_stuck" in self._now:
            self._valve = valve if self._valve is None else self._valve
            plant.valve_on = self._valve
        if "jam_slip" in self._now:
            self._now.discard("jam_slip")
            robot.spine.length = max(0.0, robot.spine.length - SLIP)
        robot.advance(plant, dt)
        plant.regulator, plant.valve_on = regulator, valve
        if "contact_lost" in self._now:
            plant.probe_force = np.zeros(3)
        if "marker_lost" in self._now:
            plant.tip_visible = False


FAULTS = (
    "silence", "delay", "half", "split", "garbage", "bad_crc", "wrong_id", "nak", "stuck", "over_range", "disconnect",
    "freeze", "reset", "skew", "replay",
)  # fmt: skip
INSTRUMENTS = ("arm", "force", "pressure", "spine", "valve", "gauge", "mocap")
LATE = 1.0
"""Host seconds of a delay: longer than any answer may take."""
NOISE = b"\x00#\x7f!"
SKEW = 1.2
COMMON: dict[str, tuple[str, Any]] = {
    "silence": ("silent", True), "delay": ("delay", LATE), "half": ("truncate", True), "split": ("split", True),
    "garbage": ("garbage", NOISE), "bad_crc": ("corrupt", True), "freeze": ("freeze", True), "skew": ("skew", SKEW),
    "replay": ("replay", True),
}  # fmt: skip
NEAREST = {"wrong_id": "bad_crc", "nak": "garbage", "stuck": "freeze", "over_range": "bad_crc"}
"""What stands for a fault of which an instrument's fake has no way of its own."""


class FaultSwitch:
    """Switches the faults of one rig of fakes."""

    def __init__(self, parts: Mapping[str, FakePart], plant: Plant, accidents: Accidents) -> None:
        self._parts, self._plant, self._accidents = parts, plant, accidents
        self._undo: list[Callable[[], None]] = []

    def begin(self, instrument: str, fault: str) -> None:
        """Switch a fault on. Raises ValueError for a name that is not known."""
        if fault not in FAULTS or instrument not in INSTRUMENTS:
            raise ValueError(f"{instrument} {fault}: one of {', '.join(INSTRUMENTS)} and one of {', '.join(FAULTS)}")
        part = self._parts.get(instrument) or self._parts.get(f"{instrument}1")
        if isinstance(part, PtyFake):
            self._serial(part, fault)
        elif isinstance(part, MotiveFake):
            self._mocap(part, fault)
        elif isinstance(part, UrFake) and part.process is not None:
            self._arm(part.process, fault)
        else:
            raise ValueError(f"{instrument}: this rig has none, or a fake of an installed package that supports no faults")

    def drop_out(self, instrument: str, seconds: float) -> None:
        """Pull out the cable of an instrument, or of one of its serial lines ("pressure2"), for `seconds` of host time; what
        is on a network is not heard meanwhile, and its connections end. Raises ValueError for a name that is not known."""
        parts = [part for name, part in self._parts.items() if instrument in (name, name.rstrip("0123456789"))]
        if not parts:
            raise ValueError(f"{instrument}: one of {', '.join(self._parts)}")
        for part in parts:
            if isinstance(part, PtyFake):
                part.unplug()
                timing.Thread(target=_afterwards, args=(seconds, part.plug)).start()
            elif isinstance(part, MotiveFake):
                part.faults.silent = True
                timing.Thread(target=_afterwards, args=(seconds, partial(setattr, part.faults, "silent", False))).start()
            elif isinstance(part, UrFake) and part.process is not None:
                part.process.backdoor("freeze", seconds=seconds)
                part.process.backdoor("drop")

    def end(self) -> None:
        """All faults off, all cables in, all power on."""
        while self._undo:
            self._undo.pop()()
        for part in self._parts.values():
            if isinstance(part, PtyFake | MotiveFake):
                part.faults = Faults()
            if isinstance(part, PtyFake):
                part.plug()
            elif isinstance(part, UrFake) and part.process is not None:
                for request in CALM:
                    part.process.backdoor(**request)
        self._accidents.end()
        with self._plant.lock:
            self._plant.tip_visible = True

    def _serial(self, line: PtyFake, fault: str) -> None:
        """Switch a fault of a serial fake on: the fake's own way if it has one, else the common one."""
        if fault == "disconnect":
            line.unplug()
        elif fault == "reset":
            line.reset()
        elif (undo := line.begin(fault)) is not None:
            self._undo.append(undo)
        elif fault in line.own_faults:
            name, value = line.own_faults[fault]
            line.faults.extra[name] = value
        else:
            name, value = COMMON[NEAREST.get(fault, fault)]
            setattr(line.faults, name, value)

    def _mocap(self, fake: MotiveFake, fault: str) -> None:
        """Switch a fault of the cameras on."""
        faults, own_faults = fake.faults, MotiveFake.own_faults
        if fault == "reset":
            faults.extra["restart"] = True
        elif fault in ("disconnect", "freeze"):
            faults.silent = True
        elif fault == "stuck":
            faults.freeze = True
        elif fault in own_faults:
            name, value = own_faults[fault]
            faults.extra[name] = value
            if fault == "wrong_id":
                faults.extra["no_body"] = True
        else:
            name, value = COMMON[fault]
            setattr(faults, name, value)

    def _arm(self, ur: UrProcess, fault: str) -> None:
        """Switch a fault of the arm on, by its controller's back door."""
        actions: dict[str, Callable[[], Any]] = {
            "silence": lambda: ur.backdoor("freeze", seconds=1e6),
            "delay": lambda: ur.backdoor("lag", seconds=LATE),
            "half": lambda: ur.backdoor("mangle", how="half"),
            "split": lambda: ur.backdoor("mangle", how="split"),
            "garbage": lambda: ur.backdoor("mangle", how="garbage"),
            "bad_crc": lambda: ur.backdoor("mangle", how="flip"),
            "wrong_id": lambda: ur.backdoor("serial", text="20999999999"),
            "nak": lambda: ur.backdoor("protective_stop"),
            "stuck": lambda: ur.backdoor("stuck", variables=["actual_TCP_pose", "actual_q", "actual_TCP_speed"]),
            "over_range": lambda: ur.backdoor("stuck", variables={"actual_TCP_pose": [math.nan] * 6}),
            "disconnect": lambda: ur.backdoor("drop"),
            "freeze": lambda: ur.backdoor("halt", on=True),
            "reset": lambda: [ur.backdoor("power", on=False), ur.backdoor("drop")],
            "skew": lambda: ur.backdoor("skew", factor=SKEW),
            "replay": lambda: ur.backdoor("mangle", how="replay"),
        }
        actions[fault]()


def _afterwards(seconds: float, change: Callable[[], None]) -> None:
    timing.sleep(seconds)
    change()


CALM: tuple[dict[str, Any], ...] = (
    {"do": "freeze", "seconds": 0}, {"do": "lag", "seconds": 0}, {"do": "mangle", "how": ""},
    {"do": "serial", "text": "20183500000"}, {"do": "stuck", "variables": []}, {"do": "halt", "on": False},
    {"do": "skew", "factor": 1.0}, {"do": "dashboard", "silent": False}, {"do": "power", "on": True}, {"do": "clear"},
)  # fmt: skip
"""What makes the arm's controller sound again."""
