"""What the UR5 tests share: the arm under test."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

import timing
from drivers.interfaces import ArmSample
from drivers.ur5.driver import UR5, Config
from sim_fakes.ur.process import UrProcess
from timing import RigClock


@dataclass
class Rig:
    """The fake controller and its rig's clock."""

    process: UrProcess
    clock: RigClock

    @property
    def host(self) -> str:
        return self.process.host


@contextmanager
def a_rig(speed: float = 1.0, version: str = "3.15.8.106339", dashboard: bool = True) -> Iterator[Rig]:
    """A fresh one."""
    process = timing.made(UrProcess, speed=speed, version=version, dashboard=dashboard)
    try:
        yield Rig(process, RigClock(speed))
    finally:
        process.stop()


@contextmanager
def an_arm(rig: Rig, **settings: Any) -> Iterator[UR5]:
    """The driver with these settings in rig.yaml, open."""
    with closing(UR5("arm", Config(host=rig.host, **settings), rig.clock)) as arm:
        arm.open()
        yield arm


def raised(pose: tuple[float, ...], by: float) -> tuple[float, ...]:
    """A pose moved up by this many m."""
    return (pose[0], pose[1], pose[2] + by, *pose[3:])


def discard(sample: ArmSample) -> None:
    """A sink for those who only look at the latest sample."""
