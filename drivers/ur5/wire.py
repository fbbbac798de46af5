"""Questions to a Universal Robots controller on throw-away sockets with time-outs of their own.

The constructors of ur_rtde wait for the controller without a time-out and hold the interpreter's lock meanwhile; so who
answers, and whether it streams at all, is found out here first. Its dashboard client also asks no CB3 for its serial
number.
"""

from __future__ import annotations

import re
import socket
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import timing

from ..errors import InstrumentError, Unreachable, WrongDevice
from ..interfaces import Identity, Vector3, Vector6

RTDE_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30004, 30003, 29999
_VERSION, _CONTROLLER, _OUTPUTS, _START, _TEXT, _DATA = b"VvOSMU"
_HEADER = struct.Struct(">HB")
_FORMATS = {"DOUBLE": "d", "INT32": "i", "UINT32": "I", "VECTOR6D": "6d", "VECTOR3D": "3d"}
_ASKED = ("robot_mode", "safety_status_bits", "safety_mode", "target_speed_fraction", "actual_TCP_speed")
_PAYLOAD = ("payload", "payload_cog")
"""Offered since PolyScope 3.11 and 5.5.1."""
LONGEST_LINE = 1024
"""Bytes of an answer of the dashboard that are read."""
E_SERIES, IN_BOTH_SERIES = 5, ("UR3", "UR5", "UR10")
"""First major version of the e-Series, and the models whose name the dashboard gives without the e."""
POLYSCOPE_X = 10
"""First major version without a dashboard server."""


@dataclass(frozen=True)
class Snapshot:
    """What the controller said of itself: PolyScope version, and as RTDE defines them robot mode, safety bits and mode."""

    version: tuple[int, int, int, int]
    robot_mode: int
    safety_bits: int
    safety_mode: int
    speed_slider: float
    """0..1"""
    tcp_speed: Vector6
    """m/s, rad/s"""
    payload: float | None = None
    """kg; None where this version does not tell."""
    centre_of_gravity: Vector3 | None = None
    """Of the payload in the flange frame, m."""

    @property
    def polyscope(self) -> str:
        """The version in words."""
        return f"PolyScope {'X ' if self.version[0] >= POLYSCOPE_X else ''}{'.'.join(map(str, self.version[:3]))}"


class _Rtde:
    """RTDE packets over one socket."""

    def __init__(self, name: str, where: str, line: socket.socket) -> None:
        self.name, self.where, self.line = name, where, line
        self._last_text = ""
        """The last text message of the controller."""

    def ask(self, kind: int, body: bytes, length: int | None = None) -> bytes:
        """Send a request and return the body of its answer, of `length` bytes if given."""
        self.line.sendall(_HEADER.pack(_HEADER.size + len(body), kind) + body)
        answer = self.receive(kind)
        if length is not None and len(answer) != length:
            raise self._wrong(f"an answer of {len(answer)} bytes instead of {length}")
        return answer

    def subscribe(self, names: Sequence[str]) -> list[str]:
        """Ask for output variables; returns their types, `NOT_FOUND` for what is not offered."""
        answer = self.ask(_OUTPUTS, struct.pack(">d", 10.0) + ",".join(names).encode())  # at 10 Hz: one package is awaited
        return answer[1:].decode("ascii", "replace").split(",")

    def receive(self, kind: int) -> bytes:
        """The next packet of a kind; of text messages in between the last one is kept for errors."""
        while True:
            size, got = _HEADER.unpack(self._exactly(_HEADER.size))
            if size < _HEADER.size or got not in (kind, _TEXT):
                raise self._wrong(f"a packet of type {got} and {size} bytes")
            body = self._exactly(size - _HEADER.size)
            if got == kind:
                return body
            self._last_text = " ".join("".join(chr(byte) if 32 <= byte < 127 else " " for byte in body).split())

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            try:
                piece = timing.recv(self.line, count - len(data))
            except TimeoutError as error:
                raise self._ceased(f"sends nothing within {self.line.gettimeout():g} s") from error
            except OSError as error:
                raise self._ceased(f"then breaks it ({error})") from error
            if not piece:
                raise self._ceased("then ends it")
            data += piece
        return data

    def _ceased(self, how: str) -> Unreachable:
        text = f", and says {self._last_text!r}" if self._last_text else ""
        return Unreachable(
            self.name,
            f"{self.where} accepts the connection but {how}{text}; is it the arm's controller, has it finished starting, and is "
            "its safety setup confirmed at the pendant?",
        )

    def _wrong(self, instead: str) -> WrongDevice:
        return WrongDevice(self.name, f"{self.where} is not an RTDE server: it sent {instead}; check the address")


class UrController:
    """A controller at an address. Each method raises Unreachable and WrongDevice; `timeout` (s, host time) is for each answer."""

    def __init__(self, name: str, host: str, timeout: float) -> None:
        self.name, self.host, self.timeout = name, host, timeout

    def connect(self, port: int) -> socket.socket:
        """A connected socket."""
        try:
            return socket.create_connection((self.host, port), timeout=self.timeout)
        except OSError as error:
            raise Unreachable(
                self.name,
                f"nothing listens at {self.host}:{port} ({error}); is the arm on, its cable plugged in, the address right, and "
                "this port's service enabled at the pendant (Settings, Security)?",
            ) from error

    def snapshot(self) -> Snapshot:
        """Go through the whole RTDE start until the first data package has come."""
        name, where = self.name, f"{self.host}:{RTDE_PORT}"
        with self.connect(RTDE_PORT) as line:
            rtde = _Rtde(name, where, line)
            if rtde.ask(_VERSION, struct.pack(">H", 2), 1) != b"\x01":
                raise WrongDevice(name, f"{where} refuses RTDE version 2; PolyScope 3.4 or newer is needed")
            version = struct.unpack(">4I", rtde.ask(_CONTROLLER, b"", 16))
            names: tuple[str, ...] = _ASKED + _PAYLOAD
            kinds = rtde.subscribe(names)
            if len(kinds) == len(names) and "NOT_FOUND" in kinds[len(_ASKED) :]:
                names = _ASKED
                kinds = rtde.subscribe(names)
            if len(kinds) != len(names) or not set(kinds) <= set(_FORMATS):
                raise WrongDevice(name, f"{where} does not offer {', '.join(names)} (it says {','.join(kinds)!r})")
            if rtde.ask(_START, b"", 1) != b"\x01":
                raise WrongDevice(name, f"{where} does not start its stream; restart the controller")
            layout, data = struct.Struct(">B" + "".join(_FORMATS[kind] for kind in kinds)), rtde.receive(_DATA)
            if len(data) != layout.size:
                raise WrongDevice(name, f"{where} sends {len(data)} bytes of data instead of {layout.size}; check the line")
            values = layout.unpack(data)
        snapshot = Snapshot(
            (version[0], version[1], version[2], version[3]),
            robot_mode=int(values[1]),
            safety_bits=int(values[2]),
            safety_mode=int(values[3]),
            speed_slider=values[4],
            tcp_speed=(values[5], values[6], values[7], values[8], values[9], values[10]),
        )
        if len(values) == 11:
            return snapshot
        return replace(snapshot, payload=values[11], centre_of_gravity=(values[12], values[13], values[14]))

    def identify(self, seen: Snapshot) -> Identity:
        """Ask the dashboard for model, serial number and PolyScope version; what this version cannot tell stays empty."""
        with self._dashboard(seen) as ask:
            version = re.search(r"\d+\.\d+\.\d+(\.\d+)?", ask("PolyscopeVersion"))
            model, serial = ask("get robot model"), ask("get serial number")
        if seen.version[0] >= E_SERIES and model in IN_BOTH_SERIES:
            model += "e"
        return Identity("Universal Robots", model, serial, version[0] if version else "")

    def in_remote_control(self, seen: Snapshot) -> bool:
        """Whether the pendant lets other computers command the arm; also True where it has no such switch (CB3)."""
        with self._dashboard(seen) as ask:
            return ask("is in remote control").lower() in ("true", "")

    def stop_program(self, seen: Snapshot) -> str:
        """End the program on the controller, also one that is paused; returns the dashboard's answer."""
        with self._dashboard(seen) as ask:
            return ask("stop")

    @contextmanager
    def _dashboard(self, seen: Snapshot) -> Iterator[Callable[[str], str]]:
        """How to ask the dashboard server one question; the answer is empty where it does not understand."""
        name, where = self.name, f"{self.host}:{DASHBOARD_PORT}"
        try:
            line = self.connect(DASHBOARD_PORT)
        except Unreachable as error:
            raise _without_dashboard(name, where, seen) from error
        with line:
            received = b""

            def hear() -> str:
                nonlocal received
                try:
                    while b"\n" not in received and len(received) < LONGEST_LINE and (piece := timing.recv(line, LONGEST_LINE)):
                        received += piece
                except TimeoutError as error:
                    silence = f"dashboard {where} is silent for {self.timeout:g} s; restart the controller"
                    raise Unreachable(name, silence) from error
                except OSError as error:
                    raise Unreachable(name, f"dashboard {where} closed the connection ({error})") from error
                text, _, received = received.partition(b"\n")
                return text.decode("utf-8", "replace").strip()

            def ask(question: str) -> str:
                line.sendall(question.encode() + b"\n")
                answer = hear()
                return "" if answer.lower().startswith("could not understand") else answer

            banner = hear()
            if "universal robots" not in banner.lower():
                raise WrongDevice(name, f"{where} greets with {banner!r} and not as a Universal Robots dashboard")
            yield ask


def _without_dashboard(name: str, where: str, seen: Snapshot) -> InstrumentError:
    """A controller that is on, and streams, but has no dashboard server or has it switched off."""
    if seen.version[0] >= POLYSCOPE_X:
        return WrongDevice(
            name,
            f"the arm is on, but runs {seen.polyscope}, which has no dashboard server at {where}: model and remote control "
            "cannot be checked there; use an arm with PolyScope 3 or 5",
        )
    return Unreachable(
        name,
        f"the arm is on ({seen.polyscope}), but its dashboard server at {where} does not answer; enable it at the pendant "
        "(Settings, Security, Services), and let the network pass that port",
    )
