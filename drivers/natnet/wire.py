"""Datagrams to and from one NatNet server: sockets bound to one interface and deaf to every other sender."""

from __future__ import annotations

import contextlib
import math
import socket
from collections.abc import Callable

import timing

from .packets import DISCONNECT, HEADER, KEEPALIVE

KEEP_ALIVE = 0.5
"""Pause between two keep-alive messages, s; Motive forgets a client that is silent for 10 s."""


class NatNetServer:
    """One server as a client hears it: frames come to the socket that asked, or to the server's multicast group."""

    def __init__(self, server: str, local: str, ports: tuple[int, int], elsewhere: Callable[[str], None]) -> None:
        """`server` by name or address; `local` empty: the interface that leads there; `ports` of commands and data.

        `elsewhere` is called with the address of every other sender. Raises OSError without such a server or way.
        """
        self._address = socket.gethostbyname(server)
        self._ports, self._elsewhere = ports, elsewhere
        if not local:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:  # sends nothing
                probe.connect((self._address, ports[0]))
                local = str(probe.getsockname()[0])
        self._local = local
        self._kept_alive = -math.inf
        self._group: socket.socket | None = None
        # without SO_REUSEADDR: nobody may bind the same port and take the frames away
        self._socket = _bound((self._local, 0), shared=False)

    def ask(self, kind: int, content: bytes = b"\0") -> None:
        """Send a request. Raises OSError."""
        self._socket.sendto(HEADER.pack(kind, len(content)) + content, (self._address, self._ports[0]))

    def try_asking(self, kind: int, content: bytes = b"\0") -> None:
        """The same where the network may be away; it is asked again."""
        with contextlib.suppress(OSError):
            self.ask(kind, content)

    def join(self, group: str, port: int) -> None:
        """Hear a multicast group too, anew if it was heard before: an interface that was down has forgotten it."""
        self._leave()
        joined = _bound((group, port or self._ports[1]), shared=True)
        try:
            request = socket.inet_aton(group) + socket.inet_aton(self._local)
            joined.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
        except OSError:
            joined.close()
            raise
        self._group = joined

    def hear(self, longest: float) -> list[bytes]:
        """What the server has sent, after `longest` s at most; nothing when there is no network."""
        now = timing.now()
        if now - self._kept_alive >= KEEP_ALIVE:
            self._kept_alive = now
            with contextlib.suppress(OSError):
                self.ask(KEEPALIVE)
        sockets = [s for s in (self._socket, self._group) if s is not None]
        return [data for s in timing.readable(sockets, longest) for data in self._received(s)]

    def close(self) -> None:
        """Tell the server, and close the sockets."""
        with contextlib.suppress(OSError):
            self.ask(DISCONNECT)
        self._leave()
        self._socket.close()

    def _received(self, heard: socket.socket) -> list[bytes]:
        datagrams = []
        with contextlib.suppress(OSError):
            for _ in range(100):  # a flood must not hold the stream's thread
                data, sender = heard.recvfrom(65536)
                if sender[0] == self._address:
                    datagrams.append(data)
                else:
                    self._elsewhere(sender[0])
        return datagrams

    def _leave(self) -> None:
        group, self._group = self._group, None
        if group is not None:
            group.close()


def _bound(place: tuple[str, int], shared: bool) -> socket.socket:
    """A datagram socket that does not block. `shared`: other programs of this computer may hear the same group."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        if shared:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(place)
    except OSError:
        sock.close()
        raise
    sock.setblocking(False)
    return sock
