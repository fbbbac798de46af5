"""A right driver of the range finder, and drivers that are wrong in one respect each."""

import re
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import serial
from pydantic import Field

import timing
from drivers.configs import SensorConfig
from drivers.errors import BadReply, NoReply, NotReady, StaleReading, Unreachable, WrongDevice
from drivers.interfaces import Identity, Sink
from drivers.registry import Driver
from drivers.serial_line import SerialLine, show
from timing import Clock

from . import BAUD, total

PAUSE = 0.02
"""s, host time, between two requests."""


class Config(SensorConfig):
    """How it is reached."""

    port: str
    timeout: float = Field(1.0, gt=0, le=1, json_schema_extra={"unit": "s"})


@dataclass(frozen=True)
class Sample:
    """Rig time (s) and distance (m)."""

    t: float
    distance: float


class Range:
    """The range finder (see `drivers.interfaces.Stream`)."""

    def __init__(self, name: str, config: Config, clock: Clock, sink: Sink[Sample], notice: Callable[[str], None]) -> None:
        self.name, self.lost, self.config, self.clock, self.sink = name, 0, config, clock, sink
        self.line = SerialLine(name, config.port, BAUD, config.timeout)
        self.newest: tuple[float, Sample] | None = None
        self.stopping = timing.Event()
        self.thread: threading.Thread | None = None

    def open(self) -> Identity:
        self.close()
        self.line.open()
        try:
            self.who(self.ask(b"?I\r"))
            self.take()
        except (NoReply, BadReply, WrongDevice) as e:
            self.line.close()
            raise (Unreachable if isinstance(e, NoReply) else WrongDevice)(self.name, e.message) from e
        self.stopping.clear()
        self.thread = timing.Thread(target=self.run, name=self.name, daemon=True)
        self.thread.start()
        return Identity("Bench", "LRF9")

    def close(self) -> None:
        self.stopping.set()
        if self.thread is not None:
            self.thread.join(2.0)
        self.thread = self.newest = None
        self.release()

    def latest(self) -> Sample:
        if self.newest is None:
            raise NotReady(self.name, "is not open; call open() first")
        at, sample = self.newest
        if self.old(timing.now() - at):
            raise StaleReading(self.name, f"no answer for {self.config.max_age:g} s; check its cable")
        return sample

    def take(self) -> None:
        distance = self.distance(self.ask(b"?D\r"))
        sample = Sample(self.now(), distance)
        self.newest = timing.now(), sample
        self.sink(sample)

    def run(self) -> None:
        while not self.stopping.wait(PAUSE):
            try:
                self.take()
            except BadReply:
                self.lost += 1
            except NoReply:
                continue

    def ask(self, request: bytes) -> bytes:
        return self.line.ask(request, b"\r")

    def who(self, answer: bytes) -> None:
        if not re.fullmatch(rb"LRF9;[0-9]{4}", answer):
            raise WrongDevice(self.name, f"{self.config.port} answers {show(answer)}, not LRF9; check the port")

    def distance(self, answer: bytes) -> float:
        found = re.fullmatch(rb"D;([0-9]{4}\.[0-9]{2});mm", answer)
        if found is None:
            raise BadReply(self.name, f"{self.config.port} answers {show(answer)}, no reading; check the port")
        return float(found[1]) * 1e-3

    def old(self, age: float) -> bool:
        return age > self.config.max_age

    def now(self) -> float:
        return self.clock.now()

    def release(self) -> None:
        self.line.close()


class Sharing(Range):
    """Keeps a port after close that others may open too."""

    held: Any = None

    def open(self) -> Identity:
        identity = super().open()
        self.held = serial.serial_for_url(self.config.port, BAUD)
        return identity


class Checked(Range):
    """The newer one."""

    def ask(self, request: bytes) -> bytes:
        answer = super().ask(request)
        if self.verifies() and answer[-2:] != b"%02X" % total(answer[:-2]):
            raise BadReply(self.name, f"{self.config.port} answers {show(answer)}, whose checksum is wrong; check the cable")
        return answer[:-2]

    def verifies(self) -> bool:
        return True


def _driver(right: type[Range], **wrong: Any) -> Driver:
    """The driver, with some of its methods replaced."""
    return Driver("sensor", Config, type("Wrong", (right,), wrong), quantities={"distance": "m"})


RIGHT, CHECKED, SHARING = map(_driver, (Range, Checked, Sharing))
AGELESS = _driver(Range, old=lambda self, age: False)
TRUSTING = _driver(Range, who=lambda self, answer: None)
GUESSING = _driver(Range, distance=lambda self, answer: float(re.sub(rb"[^0-9.]", b"", answer) or 0) * 1e-3)
CRASHING = _driver(Range, distance=lambda self, answer: float(answer[2:9]) * 1e-3)
HOLDING = _driver(Range, release=lambda self: None)
HOST_TIME = _driver(Range, now=lambda self: time.time())
UNCHECKED = _driver(Checked, verifies=lambda self: self.thread is None)
CREDULOUS = _driver(Checked, verifies=lambda self: self.thread is not None)
UNCOUNTED = _driver(Checked, lost=property(lambda self: 0, lambda self, count: None))
