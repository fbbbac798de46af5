"""Robotiq FT 300-S force-torque sensor: identity by Modbus RTU, then its 100 Hz data stream.

The sensor speaks Modbus or streams, so opening listens first and stops a stream. Raw readings hold the tool's weight; the zero
is kept here and travels with every sample. Force and moment are in the sensor's frame (+z to the tool, +x away from the
connector).
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable

from pydantic import Field
from pymodbus import FramerType, ModbusException
from pymodbus.client import ModbusSerialClient
from pymodbus.pdu import ExceptionResponse

import timing
from timing import Clock

from ..configs import ForceConfig
from ..errors import DeviceFault, InstrumentError, LimitExceeded, NotReady, StaleReading, Unreachable, WrongDevice
from ..interfaces import Identity, Sink, Vector6, WrenchSample
from ..registry import Driver
from ..serial_line import SerialLine, show
from .stream import AXES, PERIOD, FrameParser, GapCounter, unrest

BAUD = 19200
DEVICE_ID = 9
NO_SUCH_REGISTER = 2
"""Modbus exception of a device that has none at this address."""
REG_FIRMWARE, REG_SERIAL, REG_OUTPUT = 500, 510, 410
STREAM_ON = 0x0200
STOP = b"\xff" * 50
"""Bytes that stop the stream; sent again and again until the line is silent."""
STOP_ROUNDS = 20
SILENT_AFTER = 0.1
"""s without a byte that mean: the stream has stopped. A frame comes every 10 ms, adapters hold bytes for 16 ms."""
FIRST_FRAME_WITHIN = 1.0
"""s from the start of the stream to its first frame."""
# pymodbus logs each failure that it also raises; without a handler of its own that would end on the console
logging.getLogger("pymodbus").addHandler(logging.NullHandler())


class Config(ForceConfig):
    """How to reach the sensor and what it can bear."""

    port: str
    """Serial port of the sensor's adapter."""
    max_age: float = Field(0.1, ge=0.02, le=5, json_schema_extra={"unit": "s"})
    """Of a reading, host time."""
    timeout: float = Field(0.3, ge=0.05, le=2, json_schema_extra={"unit": "s"})
    """Of a Modbus answer, host time; a failed request is repeated once."""


class FT300S:
    """The sensor as a stream of wrenches (see `ForceSensor`).

    `lost` counts, since `open`, damaged frames and frames that never came. How the latter are told from late ones,
    which takes up to half a second to show, stands at `GapCounter`. Both are judged in host time, whatever the rig's
    clock does.
    """

    def __init__(
        self, name: str, config: Config, clock: Clock, sink: Sink[WrenchSample], notice: Callable[[str], None] = lambda text: None
    ) -> None:
        """`notice` is never called: this sensor reports nothing but its samples."""
        self.name = name
        self.config = config
        self._clock = clock
        self._sink = sink
        self.lost = 0
        self._line = SerialLine(name, config.port, BAUD, config.timeout)
        self._news = timing.Condition()
        self._parser = FrameParser()
        self._gaps = GapCounter()
        self._zero: Vector6 = (0.0,) * 6
        self._newest: WrenchSample | None = None
        self._newest_at = 0.0
        self._zeroing: list[list[Vector6]] = []
        """Readings collected for each running call of `zero`."""
        self._broken: InstrumentError | None = None
        self._reader: threading.Thread | None = None
        self._running = False

    def open(self) -> Identity:
        """Stop a stream that is still running, read who answers, start the stream and wait for its first frame."""
        self.close()
        self._line.open()
        try:
            self._quieten()
        finally:
            self._line.close()
        identity = self._identify_and_start()
        self._line.open()
        self._parser, self._gaps = FrameParser(), GapCounter()
        self._newest, self._broken, self.lost = None, None, 0
        self._zero = (0.0,) * 6
        self._running = True
        self._reader = timing.Thread(target=self._read_stream, name=f"{self.name}-stream", daemon=True)
        self._reader.start()
        with self._news:
            self._news.wait_for(lambda: self._newest is not None or not self._alive, FIRST_FRAME_WITHIN)
        if self._newest is None:
            self.close()
            raise Unreachable(
                self.name,
                f"{identity.model} {identity.serial} on {self.config.port} accepted the command to stream, but sent no "
                f"complete frame within {FIRST_FRAME_WITHIN:g} s; power-cycle it and check the cable",
            )
        return identity

    def latest(self) -> WrenchSample:
        """The newest sample.

        Raises `StaleReading` when it is too old, `DeviceFault` when a raw value is beyond the range (a saturated sensor
        shows less than there is), `NotReady` before `open`.
        """
        with self._news:
            self._need_open()
            sample, age = self._newest, timing.now() - self._newest_at
        if sample is None or age > self.config.max_age:
            what = "no frame has arrived" if sample is None else f"the newest frame is {age:.2f} s old"
            raise StaleReading(
                self.name,
                f"{what}, limit {self.config.max_age:g} s; "
                + timing.busy_or("check power and cable, then open the sensor again"),
            )
        self._demand_in_range(sample.raw)
        return sample

    def _demand_in_range(self, raw: Vector6) -> None:
        limits = (self.config.max_force,) * 3 + (self.config.max_moment,) * 3
        for (axis, unit), value, limit in zip(AXES, raw, limits, strict=True):
            if abs(value) > limit:
                raise DeviceFault(
                    self.name, f"{axis} = {value:.2f} {unit} is beyond the range of {limit:g} {unit}; take the load off"
                )

    def zero(self, samples: int) -> Vector6:
        """Average the next `samples` raw readings and subtract them from now on; returns the new zero (N, N m).

        Raises `StaleReading` when they do not come within twice their time plus one second, `NotReady` when force or moment
        changes meanwhile by more than the sensor's noise, `DeviceFault` when nothing changes at all or a value is beyond the
        range; the zero stays as it was then.
        """
        if samples < 1:
            raise LimitExceeded(self.name, f"a zero from {samples} samples; give 1 or more, 100 take one second")
        within = 2 * samples * PERIOD + 1.0
        readings: list[Vector6] = []
        with self._news:
            self._need_open()
            self._zeroing.append(readings)
            try:
                complete = self._news.wait_for(lambda: len(readings) >= samples or not self._alive, within)
            finally:
                self._zeroing.remove(readings)
            self._need_open()
            if not complete:
                raise StaleReading(
                    self.name,
                    f"only {len(readings)} of {samples} frames arrived for the zero within {within:.1f} s; "
                    + timing.busy_or("check power and cable, then open the sensor again"),
                )
            series = readings[:samples]
            if samples > 1 and len(set(series)) == 1:
                raise DeviceFault(
                    self.name,
                    f"no zero taken: {samples} readings are the same to the last digit, so the sensor stands still; "
                    "power-cycle it, then open it again",
                )
            if change := unrest(series):
                raise NotReady(
                    self.name,
                    f"no zero taken, because the load changed meanwhile: {change}, in {samples * PERIOD:g} s; let the tool "
                    "hang free and still, wait until the sensor has warmed up, then take the zero again",
                )
            for reading in series:
                self._demand_in_range(reading)
            mean = [sum(axis) / samples for axis in zip(*series, strict=True)]
            self._zero = (mean[0], mean[1], mean[2], mean[3], mean[4], mean[5])
            return self._zero

    def close(self) -> None:
        """End the reader, stop the stream, see that the line is silent, disconnect."""
        self._running = False
        reader, self._reader = self._reader, None
        if reader is not None and reader is not threading.current_thread():
            reader.join()
        if self._line.is_open:
            with contextlib.suppress(InstrumentError):
                self._quieten()
            self._line.close()
        with self._news:
            self._news.notify_all()

    # -- opening
    def _quieten(self) -> None:
        """Stop a stream, if there is one; raises `WrongDevice` when the line does not fall silent."""
        heard = self._line.listen(SILENT_AFTER)
        for _ in range(STOP_ROUNDS):
            if not heard.strip(STOP):  # an adapter may return them
                return
            self._line.write(STOP)
            self._line.flush()
            heard = self._line.listen(SILENT_AFTER)
        raise WrongDevice(
            self.name,
            f"{self.config.port} keeps sending {show(heard)} and cannot be stopped; check that the FT 300-S is on this "
            "port, and power-cycle it",
        )

    def _identify_and_start(self) -> Identity:
        """Read firmware and serial number by Modbus, then switch the stream on; raises `Unreachable`, `WrongDevice`."""
        client = ModbusSerialClient(
            self.config.port, framer=FramerType.RTU, baudrate=BAUD, timeout=self.config.timeout, retries=1
        )
        try:
            if not client.connect():
                raise Unreachable(self.name, f"cannot open {self.config.port}; check that no other program has it open")
            firmware = self._registers(client, REG_FIRMWARE, 3)
            serial = self._registers(client, REG_SERIAL, 5)
            # three characters at the head of each
            letters = [bytes((a >> 8, a & 255, b >> 8)).decode("ascii", "replace") for a, b, *_ in (firmware, serial)]
            if not letters[0].startswith("F"):
                raise WrongDevice(
                    self.name,
                    f"device {DEVICE_ID} on {self.config.port} reports firmware {letters[0]!r}, but that of an FT 300-S "
                    "begins with F; check the port in rig.yaml",
                )
            if client.write_registers(REG_OUTPUT, [STREAM_ON], device_id=DEVICE_ID).isError():
                raise WrongDevice(
                    self.name,
                    f"device {DEVICE_ID} on {self.config.port} refuses to stream (register {REG_OUTPUT}); check "
                    "that it is an FT 300-S with firmware for the data stream",
                )
        except (ModbusException, OSError) as e:
            if isinstance(e, InstrumentError):
                raise
            raise Unreachable(
                self.name,
                f"no answer from Modbus device {DEVICE_ID} on {self.config.port} at {BAUD} Bd ({e}); check 24 V power, "
                "cable and port of the FT 300-S",
            ) from e
        finally:
            client.close()
        version = f"{letters[0]}-{firmware[1] & 255}.{firmware[2] >> 8}.{firmware[2] & 255}"
        number = serial[3] << 16 | serial[2]
        return Identity("Robotiq", f"FT 300-S ({serial[4]})", f"{letters[1]}-{number:04d}", version)

    def _registers(self, client: ModbusSerialClient, first: int, count: int) -> list[int]:
        answer = client.read_holding_registers(first, count=count, device_id=DEVICE_ID)
        if isinstance(answer, ExceptionResponse) and answer.exception_code != NO_SUCH_REGISTER:
            raise NotReady(
                self.name,
                f"device {DEVICE_ID} on {self.config.port} refuses to tell registers {first} to {first + count - 1} now (Modbus "
                f"exception {answer.exception_code}); power-cycle it, then open it again",
            )
        if answer.isError() or len(answer.registers) != count:
            raise WrongDevice(
                self.name,
                f"device {DEVICE_ID} on {self.config.port} has no registers {first} to {first + count - 1} ({answer}); "
                "it is not an FT 300-S, check the port in rig.yaml",
            )
        return list(answer.registers)

    # -- the stream
    def _read_stream(self) -> None:
        damaged_before = 0
        while self._running:
            try:
                data = self._line.read_some()
            except InstrumentError as e:
                with self._news:
                    self._broken = e
                    self._news.notify_all()
                return
            for wrench in self._parser.feed(data):
                damaged, damaged_before = self._parser.damaged - damaged_before, self._parser.damaged
                self._take(wrench, damaged)
            self.lost = self._parser.damaged + self._gaps.missing

    def _take(self, wrench: Vector6, damaged: int) -> None:
        with self._news:
            self._newest_at = timing.now()
            self._gaps.arrived(self._newest_at, damaged)
            sample = self._newest = WrenchSample(self._clock.now(), wrench, self._zero)
            for readings in self._zeroing:
                readings.append(wrench)
            self._news.notify_all()
        self._sink(sample)

    @property
    def _alive(self) -> bool:
        return self._running and self._broken is None

    def _need_open(self) -> None:
        if self._broken is not None:
            raise self._broken
        if not self._running:
            raise NotReady(self.name, "is not open; call open() first")


DRIVER = Driver("force", Config, FT300S)
