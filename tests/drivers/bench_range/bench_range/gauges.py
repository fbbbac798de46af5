"""A right driver of the vacuum gauge, and one that does not verify the checksum of a reading."""

from pydantic import Field

from drivers.configs import GaugeConfig
from drivers.errors import BadReply, InstrumentError, NoReply, Unreachable, WrongDevice
from drivers.interfaces import GaugeSample, Identity
from drivers.registry import Driver
from drivers.serial_line import SerialLine, show
from timing import Clock

from . import BAUD, total


class Config(GaugeConfig):
    """How it is reached."""

    port: str
    timeout: float = Field(1.0, ge=0.5, le=1, json_schema_extra={"unit": "s"})


class Gauge:
    """The gauge (see `drivers.interfaces.VacuumGauge`)."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name, self.clock, self.number = name, clock, 0
        self.line = SerialLine(name, config.port, BAUD, config.timeout)

    def open(self) -> Identity:
        self.line.open()
        try:
            if (answer := self.verified(self.ask(b"I"))) != b"IVG1\0":
                raise WrongDevice(self.name, f"{self.line.port} answers {show(answer)}, not VG1; check the port")
        except InstrumentError as e:
            self.line.close()
            raise (Unreachable if isinstance(e, NoReply) else WrongDevice)(self.name, e.message) from e
        return Identity("Bench", "VG1")

    def close(self) -> None:
        self.line.close()

    def read(self) -> GaugeSample:
        answer = self.line.twice(lambda: self.reading(self.ask(b"P")))
        if answer[:1] != b"P":
            raise BadReply(self.name, f"{self.line.port} answers {show(answer)}, no reading; check the port")
        return GaugeSample(self.clock.now(), int.from_bytes(answer[1:], "big") / 10)

    def ask(self, letter: bytes) -> bytes:
        with self.line.lock:
            self.line.flush()
            self.number = (self.number + 1) % 256
            self.line.write(letter + bytes([self.number]))
            return self.line.read_exactly(6)

    def verified(self, answer: bytes) -> bytes:
        if total(answer[:-1]) != answer[-1]:
            raise BadReply(self.name, f"{self.line.port} answers {show(answer)}, whose checksum is wrong; check the cable")
        return answer[:-1]

    def reading(self, answer: bytes) -> bytes:
        return self.verified(answer)


class Unchecked(Gauge):
    """Believes each reading."""

    def reading(self, answer: bytes) -> bytes:
        return answer[:-1]


RIGHT, UNCHECKED = Driver("gauge", Config, Gauge), Driver("gauge", Config, Unchecked)
