"""What all ports of the controller share: connections to drop or freeze, and a list of clients' breaches."""

from __future__ import annotations

import asyncio
import random
import socket

from .controller import FakeController


class Hub:
    """The controller and everybody who is connected to it."""

    def __init__(self, controller: FakeController) -> None:
        self.controller = controller
        self.connections: set[Connection] = set()
        self.frozen = False
        self._frozen_until = 0.0
        self.dashboard_silent = False
        self.lag = 0.0
        """s of host time by which every RTDE packet is late."""
        self.random = random.Random(1)
        self.mangle = ""
        """What happens to data packages: "half", "split", "garbage", "flip" or "replay"; empty: nothing."""
        self.violations: list[str] = []
        """Requests that a real client must not send."""
        self.owner: dict[str, Connection] = {}
        """RTDE inputs and the client that may write them."""
        self.heard = 0
        """Bytes received from all clients together."""

    def violation(self, text: str) -> None:
        """Note a breach of the protocol."""
        self.violations.append(text)

    def drop(self) -> None:
        """Cut all connections."""
        for connection in list(self.connections):
            connection.transport.abort()

    def freeze(self, seconds: float) -> None:
        """For `seconds` of host time nothing is sent and nothing that arrives is read; the arm goes on."""
        self.frozen = True
        self._frozen_until = asyncio.get_running_loop().time() + seconds
        asyncio.get_running_loop().call_later(seconds, self._thaw)

    def _thaw(self) -> None:
        if not self.frozen or asyncio.get_running_loop().time() < self._frozen_until - 1e-3:
            return
        self.frozen = False
        for connection in list(self.connections):
            connection.drain()


class Connection(asyncio.Protocol):
    """One client on one port."""

    transport: asyncio.Transport

    def __init__(self, hub: Hub) -> None:
        self.hub = hub
        self.buffer = b""
        self._waiting: list[bytes] = []
        self._due = 0.0
        self.last = b""
        """The package that is replayed."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a stream transport is needed")
        self.transport = transport
        line = transport.get_extra_info("socket")
        if line.family == socket.AF_INET:
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.hub.connections.add(self)
        if not self.hub.frozen:
            self.greet()

    def connection_lost(self, exc: Exception | None) -> None:
        self.hub.connections.discard(self)

    def data_received(self, data: bytes) -> None:
        self.hub.heard += len(data)
        self.buffer += data
        if not self.hub.frozen:
            self.drain()

    def drain(self) -> None:
        """Work off everything that has arrived complete."""
        while self.take():
            pass

    def write_late(self, data: bytes, wait: float) -> None:
        """Send after `wait` seconds, never before what was to be sent earlier."""
        loop = asyncio.get_running_loop()
        if wait <= 0 and not self._waiting:
            self.transport.write(data)
            return
        self._waiting.append(data)
        due = max(self._due, loop.time() + wait)
        self._due = due
        loop.call_at(due, self._write_next)

    def _write_next(self) -> None:
        data = self._waiting.pop(0)
        if not self.transport.is_closing():
            self.transport.write(data)

    def greet(self) -> None:
        """Say something at connect."""

    def take(self) -> bool:
        """Take one complete request off `buffer` and answer it; False when none is complete."""
        raise NotImplementedError
