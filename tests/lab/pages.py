"""What a page says without its markup, and what the page of `lab watch` is told."""

import json
import re
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import timing
from lab.live.show import Show


def read_as_text(page: str) -> str:
    """The page without links, small print and classes."""
    return re.sub(r"</?a\b[^>]*>|</?small[^>]*>|<wbr>| class=\"\w+\"", "", page)


@contextmanager
def running(show: Show, stay: bool) -> Iterator[None]:
    """The page of a show, told in a thread of its own until the block ends."""
    thread = timing.Thread(target=show.run, args=(stay,))
    thread.start()
    try:
        yield
    finally:
        show.over()
        thread.join(120.0)
        assert not thread.is_alive()


def events(page: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """What the page is told, until whoever tells it ends."""
    where = urlsplit(page)
    with socket.create_connection((where.hostname, where.port), timeout=120) as wire:
        wire.sendall(f"GET {where.path}events HTTP/1.1\r\nHost: test\r\n\r\n".encode())
        yield from told(wire.makefile("rb"))


def told(lines: Iterable[bytes]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The events of a stream's lines."""
    name = ""
    for line in lines:
        if line.startswith(b"event: "):
            name = line[7:].strip().decode()
        elif line.startswith(b"data: "):
            yield name, json.loads(line[6:])
