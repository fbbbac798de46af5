"""What the UR5 tests share: the arm under test, which is a real one when LAB_TEST_UR5_HOST gives its address.

Motion on a real arm (a few centimetres up and back from where it stands) also needs LAB_TEST_ALLOW_MOTION=1.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

import timing
from drivers.interfaces import ArmSample
from sim_fakes.ur.process import UrProcess
from timing import RigClock

HOST = os.environ.get("LAB_TEST_UR5_HOST")
MOTION_ALLOWED = HOST is None or os.environ.get("LAB_TEST_ALLOW_MOTION") == "1"
moves_the_arm = pytest.mark.skipif(not MOTION_ALLOWED, reason="moves the real arm; set LAB_TEST_ALLOW_MOTION=1")
needs_the_fake = pytest.mark.skipif(HOST is not None, reason="needs the fake's back door")


@dataclass
class Rig:
    """Where the arm is, the rig's clock, and the fake behind it unless it is real."""

    host: str
    clock: RigClock = field(default_factory=RigClock)
    process: UrProcess | None = None

    @property
    def fake(self) -> UrProcess:
        """The fake; only in tests marked `needs_the_fake`."""
        if self.process is None:
            raise RuntimeError("this test needs the fake")
        return self.process


@contextmanager
def a_rig(speed: float = 1.0, version: str = "3.15.8.106339", dashboard: bool = True) -> Iterator[Rig]:
    """The real arm, or a fresh fake."""
    if HOST is not None:
        yield Rig(HOST)
        return
    process = timing.made(UrProcess, speed=speed, version=version, dashboard=dashboard)
    try:
        yield Rig(process.host, RigClock(speed), process)
    finally:
        process.stop()


def wait_until(true: Callable[[], bool], timeout: float = 60.0) -> None:
    """Poll; fails the test after `timeout` (s of host time)."""
    deadline = timing.now() + timeout
    while not true():
        if timing.now() > deadline:
            pytest.fail(f"not so after {timeout:g} s")
        timing.sleep(0.005)


def raised(pose: tuple[float, ...], by: float) -> tuple[float, ...]:
    """A pose moved up by so many m."""
    return (pose[0], pose[1], pose[2] + by, *pose[3:])


def discard(sample: ArmSample) -> None:
    """A sink for those who only look at the latest sample."""
