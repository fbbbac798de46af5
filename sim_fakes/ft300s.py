"""Fake Robotiq FT 300-S: a Modbus RTU slave that turns into a 100 Hz stream.

Stricter than the instrument: a request must have exactly the right length and CRC, begin after 3.5 characters of
silence and stay inside the registers that exist; while it streams, Modbus is dead, and only 50 bytes FF in a row end
the stream. It keeps 100 Hz of host time at any speed of the rig's clock, as a sensor with its own clock would.

Faults of its own, in `faults.extra`:
    exception   Modbus exception code with which every request is refused
    foreign     three characters given out as firmware and serial letters, such as "GRP"
    no_stream   the command to stream is accepted, no frame ever comes
    endless     bytes FF do not stop the stream
    stuck       the wrench stays as it was when the fault began
    over_range  axis 0..5 that reads beyond its range
    drop        n: every n-th frame of the stream is left out
    drip        s of host time: no frame of the stream comes sooner after the last one
    drift       fx, fy, fz in N/s of rig time by which the zero moves while the fault lasts; what has moved stays
The back door `device` gives the sensor's state: device id, tool load, lever arm, noise, `streaming` (a host that died).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

import timing
from timing import RigClock

from .plant import Plant
from .pty_fake import Device, PtyFake

PERIOD = 0.01
"""s of host time between two frames."""
SILENCE = 0.002
"""s without a byte that end a Modbus request: 3.5 characters."""
READ, WRITE = 3, 16
"""Modbus functions: holding registers."""
COUNTS = np.array([100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0])
"""Counts per N and per N m."""


class Illegal(IntEnum):
    """Modbus exceptions."""

    FUNCTION = 1
    ADDRESS = 2
    VALUE = 3


def crc16(data: bytes) -> bytes:
    """Modbus CRC-16 (polynomial A001 reflected, start FFFF), low byte first as on the wire."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc.to_bytes(2, "little")


@dataclass
class Ft300sDevice(Device):
    """The sensor without its wire."""

    plant: Plant
    rng: np.random.Generator
    lever: NDArray[np.float64]
    """Probe tip in the sensor frame, m."""
    bias: NDArray[np.float64] = field(default_factory=lambda: np.array([1.5, -2.25, 30.0, 0.125, -0.5, 1.0]))
    """Reading of the free-hanging tool: fx, fy, fz (N), mx, my, mz (N m)."""
    noise: NDArray[np.float64] = field(default_factory=lambda: np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.005]))
    """Standard deviations, N and N m."""
    device_id: int = 9
    streaming: bool = False
    letters: str = "FTS"
    version: tuple[int, int, int] = (2, 0, 1)
    number: int = 1234
    year: int = 2021

    def wrench(self) -> NDArray[np.float64]:
        """fx, fy, fz (N), mx, my, mz (N m) in the sensor frame, without noise.

        The specimen's force F on the probe tip, given in the arm's base frame, is R^T F in the sensor's frame (R: TCP
        axes as columns), and its moment about the sensor is lever x R^T F.
        """
        with self.plant.lock:
            force = self.plant.probe_rotation.T @ self.plant.probe_force
        return np.concatenate([force, np.cross(self.lever, force)]) + self.bias

    def counts(self) -> NDArray[np.int16]:
        """A reading as the sensor sends it: noise, then int16 that saturate."""
        counts = (self.wrench() + self.noise * self.rng.standard_normal(6)) * COUNTS
        return np.clip(np.rint(counts), -32768, 32767).astype(np.int16)

    def register(self, address: int, letters: str) -> int | None:
        """One holding register; None where there is none."""
        a, b, c = letters.encode("ascii")
        major, minor, bugfix = self.version
        table = {
            410: 0x0200 if self.streaming else 0,
            500: a << 8 | b,
            501: c << 8 | major,
            502: minor << 8 | bugfix,
            510: a << 8 | b,
            511: c << 8,
            512: self.number & 0xFFFF,
            513: self.number >> 16,
            514: self.year,
        }
        if 180 <= address <= 185:
            return int(self.counts()[address - 180]) & 0xFFFF
        if 190 <= address <= 192:
            return (0, 0, 1000)[address - 190]
        return table.get(address)


class Ft300sFake(PtyFake):
    """The sensor on one pty."""

    own_faults: ClassVar[Mapping[str, tuple[str, Any]]] = {
        "wrong_id": ("foreign", "GRP"),
        "nak": ("exception", 4),
        "stuck": ("stuck", True),
        "over_range": ("over_range", 2),
    }
    checked: ClassVar[slice | None] = slice(0, -2)

    def __init__(self, plant: Plant, clock: RigClock, seed: int = 0, lever: tuple[float, float, float] = (0.0, 0.0, 0.1)) -> None:
        """`lever`: probe tip in the sensor frame, m."""
        super().__init__("ft300s", clock, 19200, seed)
        self.device = Ft300sDevice(plant, np.random.default_rng(seed), np.array(lever))
        self._heard_at = 0.0
        self._stop_bytes = 0
        self._due = timing.now()
        self._frames = 0
        self._sent_at = 0.0
        self.sent = 0
        """Frames of the stream that left, for tests."""
        self._held: NDArray[np.int16] | None = None

    def process(self, dt: float) -> None:
        drift = self.faults.extra.get("drift")
        if isinstance(drift, (list, tuple)):
            self.device.bias[:3] += np.array(drift, float) * dt

    def restart(self) -> None:
        """It wakes up in Modbus mode."""
        self.device.streaming = False

    def feed(self) -> bool:
        """Bytes only note their time here: silence, not content, ends a request."""
        self._heard_at = timing.now()
        if self.device.streaming and self.buffer:
            self._listen_for_stop(self.buffer)
            self.buffer = b""
        return False

    def idle(self) -> float | None:
        """Send the frames that are due, or take a request that silence has ended."""
        now = timing.now()
        if self.device.streaming:
            while self._due <= now:
                self._due += PERIOD
                self._send_frame()
            return self._due - now
        self._due = now
        if not self.buffer:
            return None
        if now - self._heard_at < SILENCE:
            return SILENCE
        request, self.buffer = self.buffer, b""
        self.requests.append(request)
        self._serve(request)
        return 0.0

    # -- stream
    def _listen_for_stop(self, data: bytes) -> None:
        for byte in data:
            self._stop_bytes = self._stop_bytes + 1 if byte == 0xFF else 0
            if self._stop_bytes >= 50 and not self.faults.extra.get("endless"):
                self.device.streaming = False
                self._stop_bytes = 0
                return

    def _send_frame(self) -> None:
        self._frames += 1
        drop = self.faults.extra.get("drop")
        if self.faults.extra.get("no_stream") or (isinstance(drop, int) and self._frames % drop == 0):
            return
        drip = self.faults.extra.get("drip")
        if isinstance(drip, (int, float)) and timing.now() - self._sent_at < drip:
            return
        self._sent_at = timing.now()
        self.sent += 1
        body = b"\x20\x4e" + struct.pack("<6h", *self._counts())
        self.send(body + crc16(body), line_time=False)

    def _counts(self) -> NDArray[np.int16]:
        counts = self.device.counts()
        if self.faults.extra.get("stuck") or self.faults.freeze:
            counts = self._held = counts if self._held is None else self._held
        else:
            self._held = None
        axis = self.faults.extra.get("over_range")
        if isinstance(axis, int):
            counts[axis] = 32767
        return counts

    # -- Modbus
    def _serve(self, request: bytes) -> None:
        """Answer one request; what is damaged or meant for another device gets no answer."""
        if len(request) < 4 or request[0] != self.device.device_id or crc16(request[:-2]) != request[-2:]:
            return
        function, data = request[1], request[2:-2]
        refusal = self.faults.extra.get("exception")
        if isinstance(refusal, int):
            self._refuse(function, refusal)
        elif function == READ:
            self._read(data)
        elif function == WRITE:
            self._write(data)
        else:
            self._refuse(function, Illegal.FUNCTION)

    def _read(self, data: bytes) -> None:
        """Answer a read of holding registers."""
        if len(data) != 4:
            return
        first, count = struct.unpack(">HH", data)
        if not 1 <= count <= 125:
            self._refuse(READ, Illegal.VALUE)
            return
        letters = str(self.faults.extra.get("foreign", self.device.letters))
        registers = [self.device.register(first + i, letters) for i in range(count)]
        values = [value for value in registers if value is not None]
        if len(values) < count:
            self._refuse(READ, Illegal.ADDRESS)
            return
        self._answer(bytes((READ, 2 * count)) + struct.pack(f">{count}H", *values))

    def _write(self, data: bytes) -> None:
        """Answer a write of registers: the one that starts and ends the stream."""
        if len(data) < 5 or len(data) != 5 + data[4]:
            return
        first, count, size = struct.unpack(">HHB", data[:5])
        if size != 2 * count or count < 1:
            self._refuse(WRITE, Illegal.VALUE)
        elif (first, count) != (410, 1):
            self._refuse(WRITE, Illegal.ADDRESS)
        elif data[5:] not in (b"\x02\x00", b"\x00\x00"):
            self._refuse(WRITE, Illegal.VALUE)
        else:
            self._answer(bytes((WRITE,)) + data[:4])
            self.device.streaming = data[5:] == b"\x02\x00"
            self._due = timing.now() + PERIOD

    def _refuse(self, function: int, code: int) -> None:
        self._answer(bytes((function | 0x80, code)))

    def _answer(self, body: bytes) -> None:
        whole = bytes((self.device.device_id,)) + body
        self.send(whole + crc16(whole))
