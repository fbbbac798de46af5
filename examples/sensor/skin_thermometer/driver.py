"""Driver of the thermometer: a stream whose samples go to the recording, the table of trials and the check."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass

from pydantic import Field

import timing
from drivers.configs import SensorConfig
from drivers.errors import BadReply, InstrumentError, NoReply, NotReady, StaleReading, Unreachable, WrongDevice
from drivers.interfaces import Identity, Sink
from drivers.registry import Driver
from drivers.serial_line import SerialLine, show
from timing import Clock

from . import BAUD

LINE = re.compile(rb"T=([0-9]{3}\.[0-9]{2}) H=([01]\.[0-9]{2})")


class Config(SensorConfig):
    """How it is reached."""

    port: str
    timeout: float = Field(1.0, ge=0.2, le=10, json_schema_extra={"unit": "s"})


@dataclass(frozen=True)
class Sample:
    """One line: rig time (s), temperature (K), relative humidity (1)."""

    t: float
    temperature: float
    humidity: float


class SkinThermometer:
    """The thermometer (see `drivers.interfaces.Stream`)."""

    def __init__(self, name: str, config: Config, clock: Clock, sink: Sink[Sample], notice: Callable[[str], None]) -> None:
        self.name, self.lost = name, 0
        self._config, self._clock, self._sink = config, clock, sink
        self._line = SerialLine(name, config.port, BAUD, config.timeout)
        self._newest: tuple[float, Sample] | None = None
        self._broken: InstrumentError | None = None
        self._stopping = timing.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> Identity:
        """Listen for a line, then start the stream."""
        self.close()
        self._line.open()
        try:
            self._line.flush()
            self._line.read_until(b"\n")  # the rest of a line
            self._take()
        except (NoReply, BadReply) as e:
            self._line.close()
            kind = Unreachable if isinstance(e, NoReply) else WrongDevice
            raise kind(self.name, e.message) from e
        self._stopping.clear()
        self._broken = None
        self._thread = timing.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        return Identity("Bench", "skin thermometer")

    def close(self) -> None:
        """End the stream."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2 * self._config.timeout)
        self._thread = self._newest = None
        self._line.close()

    def latest(self) -> Sample:
        """The newest sample; raises StaleReading when it is too old."""
        if self._thread is None or self._newest is None:
            raise NotReady(self.name, "not open; call open() first")
        if self._broken is not None:
            raise self._broken
        at, sample = self._newest
        if timing.now() - at > self._config.max_age:
            raise StaleReading(self.name, f"no line for more than {self._config.max_age:g} s; check its cable")
        return sample

    def _take(self) -> None:
        line = self._line.read_until(b"\n")
        found = LINE.fullmatch(line)
        if found is None:
            raise BadReply(self.name, f"{self._config.port} sends {show(line)}, no reading; check the port")
        sample = Sample(self._clock.now(), float(found[1]), float(found[2]))
        self._newest = timing.now(), sample
        self._sink(sample)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._take()
            except BadReply:
                self.lost += 1
            except NoReply:
                continue  # `latest` tells
            except InstrumentError as e:
                self._broken = e
                return


DRIVER = Driver("sensor", Config, SkinThermometer, quantities={"temperature": "K", "humidity": "1"})
