"""RTDE, port 30004: packets of u16 length (header included), u8 type and a body, big-endian.

Protocol versions 1 (outputs at the full rate, no recipe numbers for them) and 2. Stricter than the device: lengths,
recipe numbers, register ownership, the order of requests and the frequency are all checked, and every breach is noted.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

from . import variables
from .wire import Connection, Hub

PORT = 30004
VERSION, CONTROLLER_VERSION, OUTPUTS, INPUTS, START, PAUSE, DATA, TEXT = b"VvOISPUM"
LONGEST_NAMES = 2048
"""Bytes of a list of names; a longer one is refused."""
SLOWEST = 1.0
"""Hz"""
V1, V2 = 1, 2
SPLIT_PAUSE = 0.003
"""s between the pieces of a package."""


@dataclass
class Subscription:
    """What one client is sent: names, package layout, and each how many cycles; `head` goes in front of the values."""

    names: list[str]
    layout: str
    every: int
    head: tuple[int, ...]
    cycle: int = 0


def publish(hub: Hub) -> None:
    """Send one cycle's values to all clients that have started."""
    values: dict[str, list[float]] = {}
    for connection in list(hub.connections):
        if isinstance(connection, RtdeConnection):
            connection.publish(values)


class RtdeConnection(Connection):
    """One RTDE client."""

    def __init__(self, hub: Hub) -> None:
        super().__init__(hub)
        self.recipes: list[list[tuple[str, str]] | None] = []
        """Inputs in the order in which they were set up; None for one that was rejected, which keeps its number."""
        self.subscription: Subscription | None = None
        self.started = False
        self.version = 0
        """Of the protocol; 0 until it is agreed."""

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self.hub.owner = {name: owner for name, owner in self.hub.owner.items() if owner is not self}

    def take(self) -> bool:
        if len(self.buffer) < 3:
            return False
        size, kind = struct.unpack(">HB", self.buffer[:3])
        if not 3 <= size <= 4096:
            self._reject(f"packet length {size}")
            return False
        if len(self.buffer) < size:
            return False
        body, self.buffer = self.buffer[3:size], self.buffer[size:]
        if not self.version and kind != VERSION:
            self._reject(f"packet {chr(kind)!r} before the protocol version was agreed")
            return False
        return self._answer(kind, body)

    def _reject(self, text: str) -> None:
        """Note the breach and hang up."""
        self.hub.violation(f"rtde: {text}")
        self.buffer = b""
        self.transport.abort()

    def _send(self, kind: int, body: bytes) -> None:
        packet = struct.pack(">HB", len(body) + 3, kind) + body
        pieces = self._mangled(packet) if self.hub.mangle and kind == DATA else [packet]
        for i, piece in enumerate(pieces):
            self.write_late(piece, self.hub.lag + SPLIT_PAUSE * i)

    def _mangled(self, packet: bytes) -> list[bytes]:
        """The pieces in which a data package goes out while a fault is on."""
        how, half = self.hub.mangle, len(packet) // 2
        if how == "half":
            return [packet[:half]]
        if how == "split":
            return [packet[:half], packet[half:]]
        if how == "garbage":
            return [b"\x00\x07\x55\xaa\xff\x00\x13" + packet]
        if how == "flip":
            at = 3 + self.hub.random.randrange(len(packet) - 3)
            return [packet[:at] + bytes([packet[at] ^ 1 << self.hub.random.randrange(8)]) + packet[at + 1 :]]
        self.last = self.last or packet
        return [self.last]

    def _answer(self, kind: int, body: bytes) -> bool:
        """Answer one packet; False after a breach, which ends the connection."""
        if kind == VERSION and len(body) == 2:
            asked = struct.unpack(">H", body)[0]
            self.version = asked if asked in (V1, V2) else self.version
            if message := self.hub.controller.starting:
                self._send(TEXT, b"\0" + message.encode())
            self._send(kind, bytes([asked in (V1, V2)]))
        elif kind == CONTROLLER_VERSION and not body:
            self._send(kind, struct.pack(">4I", *self.hub.controller.version))
        elif kind == OUTPUTS and self.version == V1 and body:
            self._set_outputs(1 / self.hub.controller.period, body)
        elif kind == OUTPUTS and len(body) > 8:
            self._set_outputs(struct.unpack(">d", body[:8])[0], body[8:])
        elif kind == INPUTS and body:
            self._set_inputs(body)
        elif kind == START and not body:
            self.started = bool(self.subscription or self.recipes)
            self._send(kind, bytes([self.started]))
        elif kind == PAUSE and not body:
            self.started = False
            self._send(kind, b"\x01")
        elif kind == DATA and body:
            self._write(body[0], body[1:])
        else:
            self._reject(f"packet {chr(kind)!r} with {len(body)} bytes")
            return False
        return True

    def _set_outputs(self, frequency: float, names: bytes) -> None:
        """Subscribe to variables (names with commas) at `frequency` Hz, and answer with their types."""
        controller = self.hub.controller
        wanted = [name for name in names.decode("ascii", "replace").split(",") if name]
        types = [controller.outputs.get(name, "NOT_FOUND") for name in wanted]
        fastest = 1 / controller.period
        # 1e-9: a division of rounded numbers may come out below a whole one
        every = math.floor(fastest / frequency + 1e-9) if SLOWEST <= frequency <= fastest else 0
        if not every:
            self.hub.violation(f"rtde: frequency {frequency:g} Hz, possible are {SLOWEST:g} to {fastest:g} Hz")
        if len(names) > LONGEST_NAMES:
            self.hub.violation(f"rtde: {len(names)} bytes of names, at most {LONGEST_NAMES}")
            every, types = 0, []
        accepted = every > 0 and "NOT_FOUND" not in types
        head = (1,) if self.version == V2 else ()
        if accepted:
            layout = ">" + "B" * len(head) + "".join(variables.FORMAT[kind] for kind in types)
            self.subscription = Subscription(wanted, layout, every, head)
        self._send(OUTPUTS, bytes([accepted] * len(head)) + ",".join(types).encode())

    def _set_inputs(self, names: bytes) -> None:
        """Reserve input variables (names with commas) for this client, and answer with the recipe's number and their types."""
        offered = variables.inputs()
        wanted = [name for name in names.decode("ascii", "replace").split(",") if name]
        types = [offered.get(name, "NOT_FOUND") for name in wanted]
        types = [
            "IN_USE" if self.hub.owner.get(name, self) is not self else kind for name, kind in zip(wanted, types, strict=True)
        ]
        if len(names) > LONGEST_NAMES:
            self.hub.violation(f"rtde: {len(names)} bytes of names, at most {LONGEST_NAMES}")
            types = []
        if not types or {"NOT_FOUND", "IN_USE"} & set(types):
            self.recipes.append(None)
            self._send(INPUTS, b"\x00" + ",".join(types).encode())
            return
        self.hub.owner |= dict.fromkeys(wanted, self)
        self.recipes.append(list(zip(wanted, types, strict=True)))
        self._send(INPUTS, bytes([len(self.recipes)]) + ",".join(types).encode())

    def _write(self, number: int, body: bytes) -> None:
        """A data package: recipe number and values. A bad one is noted and ignored, as RTDE has no error reply."""
        recipe = self.recipes[number - 1] if 1 <= number <= len(self.recipes) else None
        if recipe is None:
            self.hub.violation(f"rtde: data for recipe {number} of {len(self.recipes)}")
            return
        layout = ">" + "".join(variables.FORMAT[kind] for _, kind in recipe)
        if struct.calcsize(layout) != len(body):
            self.hub.violation(f"rtde: recipe {number} with {len(body)} bytes instead of {struct.calcsize(layout)}")
            return
        values = list(struct.unpack(layout, body))
        for name, kind in recipe:
            count = variables.COUNT.get(kind, 1)
            numbers, values = values[:count], values[count:]
            self.hub.controller.write(name, numbers if count > 1 else numbers[0])

    def publish(self, values: dict[str, list[float]]) -> None:
        """Send this cycle's package when it is due; `values` is shared by all clients of the cycle."""
        subscription = self.subscription
        if subscription is None or not self.started or self.hub.controller.starting:
            return
        subscription.cycle += 1
        if subscription.cycle % subscription.every or self.transport.get_write_buffer_size() > 200_000:
            return  # not due, or the client leaves too much unread
        package: list[float] = []
        for name in subscription.names:
            if name not in values:
                value = self.hub.controller.value(name)
                values[name] = value if isinstance(value, list) else [value]
            package += values[name]
        self._send(DATA, struct.pack(subscription.layout, *subscription.head, *package))
