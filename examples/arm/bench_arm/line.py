"""A TCP connection that carries lines of text."""

import contextlib
import socket

from drivers.errors import BadReply, NoReply, NotReady, Unreachable


class Line:
    """One connection; every call is bounded by the time-out (s)."""

    def __init__(self, name: str, host: str, port: int, timeout: float) -> None:
        self.name, self._where, self._timeout = name, (host, port), timeout
        self._socket: socket.socket | None = None
        self._rest = b""

    def open(self) -> None:
        """Connect; raises Unreachable."""
        self.close()
        try:
            self._socket = socket.create_connection(self._where, self._timeout)
        except OSError as error:
            host, port = self._where
            raise Unreachable(self.name, f"nobody at {host} port {port} ({error}); check cable and address") from error

    def close(self) -> None:
        """Disconnect."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
        self._socket, self._rest = None, b""

    @property
    def is_open(self) -> bool:
        return self._socket is not None

    def send(self, text: str) -> None:
        """Raises NotReady, NoReply."""
        try:
            self._opened().sendall(text.encode() + b"\n")
        except OSError as error:
            raise NoReply(self.name, f"the connection has ended ({error}); open it again") from error

    def read(self) -> list[str]:
        """The words of the next line; raises NotReady, NoReply."""
        while b"\n" not in self._rest:
            try:
                piece = self._opened().recv(4096)
            except OSError as error:
                raise NoReply(self.name, f"no answer within {self._timeout:g} s ({error}); check the cable") from error
            if not piece:
                raise NoReply(self.name, "the connection has ended; open it again")
            self._rest += piece
        line, _, self._rest = self._rest.partition(b"\n")
        return line.decode("ascii", "replace").split()

    def ask(self, text: str) -> list[str]:
        """Send a line, read the answer's words."""
        self.send(text)
        return self.read()

    def numbers(self, words: list[str]) -> list[float]:
        """The numbers that the words of an answer are; raises BadReply."""
        try:
            return [float(word) for word in words]
        except ValueError as error:
            raise BadReply(self.name, f"sends {' '.join(words)!r}, needed numbers; check the cable") from error

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise NotReady(self.name, "is not open; call open() first")
        return self._socket
