"""The natnet client on sockets that hear one server: bound to one interface, deaf to every other sender.

The package's own sockets listen on all interfaces and take a frame from whoever sends one.
"""

from __future__ import annotations

import math
import select
import socket
import time
from collections.abc import Callable
from typing import Any

from natnet import NatNetClient
from natnet.exceptions import NatNetError

KEEP_ALIVE = 0.5
"""Pause between two keep-alive messages, s; the package would send one with every look."""
FOREIGN_AT_ONCE = 100
"""Datagrams from elsewhere that one look may throw away: a flood must not hold the stream's thread."""


class ServerSocket(socket.socket):
    """A datagram socket on one local address that hands out what one server sends, from whichever of its ports."""

    def __init__(self, local: str, server: str, elsewhere: Callable[[str], None]) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_DGRAM)
        self._server, self._elsewhere = server, elsewhere
        try:
            self.bind((local, 0))  # without SO_REUSEADDR: nobody may bind the same port and take the frames away
        except OSError:
            self.close()
            raise
        self.setblocking(False)

    def recvfrom(self, *size: int) -> tuple[bytes, Any]:
        """As of any socket that does not block; datagrams of other senders are told and thrown away."""
        for _ in range(FOREIGN_AT_ONCE):
            data, sender = super().recvfrom(*size)
            if sender[0] == self._server:
                return data, sender
            self._elsewhere(sender[0])
        raise BlockingIOError


class ServerClient(NatNetClient):  # type: ignore[misc]
    """The natnet client, unicast, on such sockets and with fewer keep-alive messages."""

    def __init__(self, server: str, local: str, ports: tuple[int, int], elsewhere: Callable[[str], None]) -> None:
        """`server` by name or address; `local` empty: the interface that leads there; `ports` of commands and data.

        `elsewhere` is called with the address of every other sender. Raises OSError without such a server or way.
        """
        address = socket.gethostbyname(server)
        super().__init__(
            server_ip_address=address,
            local_ip_address=local or _interface_towards(address, ports[0]),
            command_port=ports[0],
            data_port=ports[1],
            use_multicast=False,
        )
        self._elsewhere = elsewhere
        self._kept_alive = -math.inf
        self._sockets: list[ServerSocket] = []

    def _NatNetClient__create_socket(self, addr: str = "", port: int = 0) -> ServerSocket:
        """In the place of the package's own, by the only name under which it can be replaced."""
        self._sockets.append(ServerSocket(self.local_ip_address, self.server_ip_address, self._elsewhere))
        return self._sockets[-1]

    def connect(self, timeout: float = 5.0) -> None:
        """See NatNetClient; NatNetError when the package makes its sockets in a way that is not known here."""
        self._sockets = []
        super().connect(timeout)
        if len(self._sockets) != 2:
            raise NatNetError("this version of the natnet package opens sockets that anybody can send to; use 0.3.0")

    def wait(self, longest: float) -> None:
        """Return when something has come, or after `longest` s. Raises OSError or ValueError when the sockets are closed."""
        select.select(self._sockets, [], [], longest)

    def send_request(self, command: int, command_str: str = "") -> int:
        if command == self.NAT_KEEPALIVE:
            now = time.monotonic()
            if now - self._kept_alive < KEEP_ALIVE:
                return 0
            self._kept_alive = now
        sent: int = super().send_request(command, command_str)
        return sent


def _interface_towards(address: str, port: int) -> str:
    """The local address from which datagrams to `address` leave; sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((address, port))
        return str(probe.getsockname()[0])
