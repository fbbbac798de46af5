"""What the tests of motion capture share."""

import random
import socket
from collections.abc import Callable

import timing
from drivers.errors import DeviceFault, InstrumentError, StaleReading
from drivers.interfaces import BodySample
from drivers.natnet.driver import NatNetMocap

IDENTITY = {"position": (0.0, 0.0, 0.0), "quaternion": (1.0, 0.0, 0.0, 0.0)}
Make = Callable[..., NatNetMocap]


def free_host() -> str:
    """A loopback address whose NatNet ports nobody uses."""
    while True:
        host = f"127.{random.randint(1, 254)}.{random.randint(1, 254)}.{random.randint(2, 254)}"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((host, 1510))
            except OSError:
                continue
        return host


def wait(condition: Callable[[], bool], within: float = 60.0) -> None:
    deadline = timing.now() + within
    while not condition():
        assert timing.now() < deadline, "never happened"
        timing.sleep(0.005)


def refused(mocap: NatNetMocap, kind: type[InstrumentError], text: str = "") -> None:
    """Wait until the newest reading is refused for this reason; late for want of processors, it may first be for another."""

    def so() -> bool:
        try:
            mocap.latest()
        except kind as e:
            return text in str(e)
        except InstrumentError:
            pass
        return False

    wait(so)


def first(mocap: NatNetMocap) -> BodySample:
    """The first valid sample after opening."""
    found: list[BodySample] = []

    def look() -> bool:
        try:
            found.append(mocap.latest())
        except (StaleReading, DeviceFault):
            return False
        return True

    wait(look)
    return found[0]
