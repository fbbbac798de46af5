"""The page's server: `GET /TOKEN/...` of a handful of fixed names, `POST /TOKEN/ask`, and nothing else.

What a browser sends fits into a few hundred bytes. A head is read completely, within a time and a size, before it is parsed;
no path ever reaches a file system, since all answers are in memory. Each connection carries one request. What is
posted is a small JSON object that a script of the page itself has sent: the browser says so (Origin). Each viewer has a queue;
slow viewers are disconnected, and get everything when they ask again.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import re
import time
from collections.abc import Callable
from http import HTTPStatus
from importlib.resources import files
from typing import Any

from protocols.errors import BadRequest
from protocols.steering import checked
from recordings.json_text import plain_numbers, read_json

LARGEST_HEAD = 8192
"""Bytes of a request."""
HEAD_WITHIN = 5.0
"""Host seconds within which it must arrive."""
_REQUEST = re.compile(rb"(GET|POST) (/[!-~]{0,200}) HTTP/1\.[01]\r\n((?:[!-9;-~]+:[^\r\n\x00]*\r\n)*)\r\n")
_METHOD = re.compile(rb"[A-Z]{1,20} [!-~]+ HTTP/1\.[01]\r\n")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}
PAGE = {"": ("page.html", "text/html"), "page.css": ("page.css", "text/css"), "page.js": ("page.js", "text/javascript"),
        "draw.js": ("draw.js", "text/javascript")}  # fmt: skip
"""Name after the token -> a file next to this module, and its kind."""
EVENTS, ASK = "events", "ask"


class RefusedRequest(Exception):
    """A request that is answered by this status alone."""

    def __init__(self, status: HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


async def asked(reader: asyncio.StreamReader, token: str, posting: bool = False) -> str | dict[str, Any]:
    """Read a request: a fixed name behind the token, or with `posting` what is posted to ASK. Raises `RefusedRequest`."""
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_WITHIN)
    except asyncio.LimitOverrunError:
        raise RefusedRequest(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE) from None
    except (TimeoutError, asyncio.IncompleteReadError, OSError):
        raise RefusedRequest(HTTPStatus.REQUEST_TIMEOUT) from None
    if len(head) > LARGEST_HEAD:
        raise RefusedRequest(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
    request = _REQUEST.fullmatch(head)
    if request is None:
        other = _METHOD.match(head) and not head.startswith((b"GET ", b"POST "))
        raise RefusedRequest(HTTPStatus.METHOD_NOT_ALLOWED if other else HTTPStatus.BAD_REQUEST)
    if request[1] == b"POST" and not posting:
        raise RefusedRequest(HTTPStatus.METHOD_NOT_ALLOWED)
    token_given, slash, name = request[2].decode("ascii")[1:].partition("/")
    if not hmac.compare_digest(token_given, token):
        raise RefusedRequest(HTTPStatus.FORBIDDEN)
    if request[1] == b"POST":
        if name != ASK:
            raise RefusedRequest(HTTPStatus.METHOD_NOT_ALLOWED)
        return await _posted(reader, request[3])
    if not slash or (name not in PAGE and name != EVENTS):
        raise RefusedRequest(HTTPStatus.NOT_FOUND)
    return name


async def _posted(reader: asyncio.StreamReader, head: bytes) -> dict[str, Any]:
    """The JSON object of a request with this head; raises `RefusedRequest` for one that the page itself did not send."""
    lines = [line.partition(b":") for line in head.split(b"\r\n")[:-1]]
    headers = {name.lower(): value.strip() for name, _, value in lines}
    if len(headers) < len(lines):
        raise RefusedRequest(HTTPStatus.BAD_REQUEST)
    same_origin = headers.get(b"host", b"") and headers.get(b"origin") == b"http://" + headers[b"host"]
    if not same_origin or headers.get(b"sec-fetch-site", b"same-origin") != b"same-origin":
        raise RefusedRequest(HTTPStatus.FORBIDDEN)
    if headers.get(b"content-type", b"").partition(b";")[0].strip().lower() != b"application/json":
        raise RefusedRequest(HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
    length = headers.get(b"content-length", b"")
    if not (length.isascii() and length.isdigit() and len(length) < 10):
        raise RefusedRequest(HTTPStatus.LENGTH_REQUIRED)
    if int(length) > 4096:
        raise RefusedRequest(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
    try:
        posted = read_json(await asyncio.wait_for(reader.readexactly(int(length)), HEAD_WITHIN))
    except (TimeoutError, asyncio.IncompleteReadError, OSError):
        raise RefusedRequest(HTTPStatus.REQUEST_TIMEOUT) from None
    except ValueError:
        raise RefusedRequest(HTTPStatus.BAD_REQUEST) from None
    if not isinstance(posted, dict) or not all(isinstance(value, str) for value in posted.values()):
        raise RefusedRequest(HTTPStatus.BAD_REQUEST)
    return posted


def response(status: HTTPStatus, kind: str = "", data: bytes | None = b"") -> bytes:
    """A whole answer; without `data`, the head of one that goes on."""
    further = {"Content-Type": f"{kind}; charset=utf-8"} if kind else {}
    if kind and data is not None:
        further["Content-Length"] = str(len(data))
    lines = [f"HTTP/1.1 {status.value} {status.phrase}", *(f"{k}: {v}" for k, v in (HEADERS | further).items())]
    return "\r\n".join(lines).encode("ascii") + b"\r\n\r\n" + (data or b"")


def refusal(status: HTTPStatus) -> bytes:
    """One short line."""
    return response(status, "text/plain", f"{status.value} {status.phrase}\n".encode())


MOST_CONNECTIONS, MOST_VIEWERS = 128, 32
STUCK = 10.0
"""Host seconds for which a viewer may take nothing while something waits."""
RATE, BURST = 2.0, 10.0
"""Requests to the run a host second from all viewers together, and how many may come at once."""
LINGER, LINGERED = 1.0, 2**18
"""Host seconds and bytes of a refused request that are still taken, so that the refusal arrives."""


def event(name: str, data: dict[str, Any]) -> bytes:
    """One event of the stream; the JSON has no line end in it, and null for a number that is none."""
    return f"event: {name}\ndata: {json.dumps(plain_numbers(data), separators=(',', ':'))}\n\n".encode()


Steer = Callable[[str, str], bool]
"""Passes kind and text of a request to the run; False if it accepts no more at the moment."""


class Viewers:
    """Serves the page and hands out updates. `steer`: where viewers may ask something of the run."""

    def __init__(self, token: str, whole: Callable[[], dict[str, Any]], steer: Steer | None = None) -> None:
        self._token, self._whole, self._steer = token, whole, steer
        self._allowed, self._counted = BURST, time.monotonic()
        self._files = {name: (kind, (files(__package__) / "page" / file).read_bytes()) for name, (file, kind) in PAGE.items()}
        self._queues: set[asyncio.Queue[bytes | None]] = set()
        self._tasks: set[asyncio.Task[Any]] = set()

    @property
    def count(self) -> int:
        """How many look now."""
        return len(self._queues)

    def tell(self, name: str, data: dict[str, Any]) -> None:
        """Send an update to all viewers."""
        if not self._queues:
            return
        text = event(name, data)
        for queue in tuple(self._queues):
            try:
                queue.put_nowait(text)
            except asyncio.QueueFull:
                self._queues.discard(queue)  # its task ends when it notices

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection, from its request to its end."""
        task = asyncio.current_task()
        assert task is not None
        if len(self._tasks) >= MOST_CONNECTIONS:
            writer.transport.abort()
            return
        self._tasks.add(task)
        try:
            await self._answer(reader, writer)
        except (OSError, TimeoutError, asyncio.CancelledError):
            pass
        finally:
            self._tasks.discard(task)
            await _close(writer)

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer one request: refuse it, hand it on to the run, stream the events, or send a file of the page."""
        writer.transport.set_write_buffer_limits(high=0)  # `drain` returns when all is on its way
        try:
            request = await asked(reader, self._token, self._steer is not None)
            if isinstance(request, dict):
                self._ask(request)
                writer.write(response(HTTPStatus.NO_CONTENT))
                await asyncio.wait_for(writer.drain(), STUCK)
                return
        except RefusedRequest as e:
            writer.write(refusal(e.status))
            await asyncio.wait_for(_linger(reader, writer), LINGER)
            return
        if request == EVENTS:
            await self._stream(writer)
            return
        writer.write(response(HTTPStatus.OK, *self._files[request]))
        await asyncio.wait_for(writer.drain(), STUCK)

    def _ask(self, posted: dict[str, Any]) -> None:
        """Pass a posted request on to the run; raises `RefusedRequest`, also beyond `RATE` and `BURST`."""
        assert self._steer is not None
        now = time.monotonic()
        self._allowed = min(BURST, self._allowed + RATE * (now - self._counted))  # requests that may come at once
        self._counted = now
        if self._allowed < 1:
            raise RefusedRequest(HTTPStatus.TOO_MANY_REQUESTS)
        self._allowed -= 1
        try:
            kind = posted["kind"]
            text = checked(kind, posted.get("text", ""))
        except (KeyError, BadRequest):
            raise RefusedRequest(HTTPStatus.BAD_REQUEST) from None
        if not self._steer(kind, text):
            raise RefusedRequest(HTTPStatus.SERVICE_UNAVAILABLE)

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        """Send one viewer the whole state, then each update, until the end or until it is too slow."""
        if self.count >= MOST_VIEWERS:
            writer.write(refusal(HTTPStatus.SERVICE_UNAVAILABLE))
            return
        queue: asyncio.Queue[bytes | None] = asyncio.Queue(100)  # ten seconds of updates
        # the browser asks again after a second when it breaks
        writer.write(response(HTTPStatus.OK, "text/event-stream", None) + b"retry: 1000\n\n" + event("whole", self._whole()))
        self._queues.add(queue)
        try:
            while queue in self._queues or not queue.empty():
                await asyncio.wait_for(writer.drain(), STUCK)
                try:
                    text = await asyncio.wait_for(queue.get(), 5.0)
                except TimeoutError:
                    text = b":\n\n"  # a comment, which shows that the stream is alive
                if text is None:
                    break
                writer.write(text)
            await asyncio.wait_for(writer.drain(), STUCK)
        finally:
            self._queues.discard(queue)

    async def end(self) -> None:
        """Disconnect all viewers once their queues are sent, or after a moment."""
        for queue in self._queues:
            with contextlib.suppress(asyncio.QueueFull):
                queue.put_nowait(None)
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=1.0)
        for task in tuple(self._tasks):
            task.cancel()


async def _linger(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await writer.drain()
    writer.write_eof()
    left = LINGERED
    while left > 0 and (data := await reader.read(4096)):
        left -= len(data)


async def _close(writer: asyncio.StreamWriter) -> None:
    """Close a connection; one that takes nothing is cut off."""
    transport = writer.transport
    if transport.get_write_buffer_size():
        transport.abort()
    writer.close()
    with contextlib.suppress(OSError, TimeoutError, asyncio.CancelledError):
        await asyncio.wait_for(writer.wait_closed(), 1.0)
