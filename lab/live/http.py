"""Requests and answers of the page: `GET /TOKEN/...` of a handful of fixed names, `POST /TOKEN/ask`, and nothing else.

What a browser sends fits into a few hundred bytes. A head is read whole, within a time and a size, before anything of it is
looked at; no path ever reaches a file system, since all answers lie in memory. Each connection carries one request.
What is posted is a small JSON object that a script of the page itself has sent: the browser says so (Origin).
"""

from __future__ import annotations

import asyncio
import hmac
import re
from dataclasses import dataclass
from http import HTTPStatus
from importlib.resources import files
from typing import Any

from recordings.json_text import read_json

LARGEST_HEAD = 8192
"""Bytes of a request."""
HEAD_WITHIN = 5.0
"""Host seconds in which it must be here."""
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
"""What is asked for behind the token: a file beside this module, and its kind."""
EVENTS, ASK = "events", "ask"


class Refused(Exception):
    """A request that gets nothing but this status."""

    def __init__(self, status: HTTPStatus) -> None:
        super().__init__(status.phrase)
        self.status = status


@dataclass(frozen=True)
class Body:
    """An answer."""

    kind: str
    data: bytes


def page_files() -> dict[str, Body]:
    """The page, from the package, by the name that is asked for."""
    folder = files(__package__) / "page"
    return {name: Body(f"{kind}; charset=utf-8", (folder / file).read_bytes()) for name, (file, kind) in PAGE.items()}


@dataclass(frozen=True)
class Asked:
    """A request: the name behind the token, and what is posted there."""

    name: str
    posted: dict[str, Any] | None = None


async def asked(reader: asyncio.StreamReader, token: str, posting: bool = False) -> Asked:
    """What a request asks for; `posting`: something may be posted. Raises `Refused`."""
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_WITHIN)
    except asyncio.LimitOverrunError:
        raise Refused(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE) from None
    except (TimeoutError, asyncio.IncompleteReadError, OSError):
        raise Refused(HTTPStatus.REQUEST_TIMEOUT) from None
    if len(head) > LARGEST_HEAD:
        raise Refused(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
    request = _REQUEST.fullmatch(head)
    if request is None:
        other = _METHOD.match(head) and not head.startswith((b"GET ", b"POST "))
        raise Refused(HTTPStatus.METHOD_NOT_ALLOWED if other else HTTPStatus.BAD_REQUEST)
    if request[1] == b"POST" and not posting:
        raise Refused(HTTPStatus.METHOD_NOT_ALLOWED)
    given, slash, name = request[2].decode("ascii")[1:].partition("/")
    if not hmac.compare_digest(given, token):
        raise Refused(HTTPStatus.FORBIDDEN)
    if request[1] == b"POST":
        if name != ASK:
            raise Refused(HTTPStatus.METHOD_NOT_ALLOWED)
        return Asked(name, await _posted(reader, request[3]))
    if not slash or (name not in PAGE and name != EVENTS):
        raise Refused(HTTPStatus.NOT_FOUND)
    return Asked(name)


async def _posted(reader: asyncio.StreamReader, head: bytes) -> dict[str, Any]:
    """The JSON object of a request with this head; raises `Refused` for one that the page itself did not send."""
    lines = [line.partition(b":") for line in head.split(b"\r\n")[:-1]]
    said = {name.lower(): value.strip() for name, _, value in lines}
    if len(said) < len(lines):
        raise Refused(HTTPStatus.BAD_REQUEST)
    own = said.get(b"host", b"") and said.get(b"origin") == b"http://" + said[b"host"]
    if not own or said.get(b"sec-fetch-site", b"same-origin") != b"same-origin":
        raise Refused(HTTPStatus.FORBIDDEN)
    if said.get(b"content-type", b"").partition(b";")[0].strip().lower() != b"application/json":
        raise Refused(HTTPStatus.UNSUPPORTED_MEDIA_TYPE)
    length = said.get(b"content-length", b"")
    if not (length.isascii() and length.isdigit() and len(length) < 10):
        raise Refused(HTTPStatus.LENGTH_REQUIRED)
    if int(length) > 4096:
        raise Refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
    try:
        found = read_json(await asyncio.wait_for(reader.readexactly(int(length)), HEAD_WITHIN))
    except (TimeoutError, asyncio.IncompleteReadError, OSError):
        raise Refused(HTTPStatus.REQUEST_TIMEOUT) from None
    except ValueError:
        raise Refused(HTTPStatus.BAD_REQUEST) from None
    if not isinstance(found, dict) or not all(isinstance(value, str) for value in found.values()):
        raise Refused(HTTPStatus.BAD_REQUEST)
    return found


def answer(body: Body) -> bytes:
    """A whole answer with its head."""
    return _head(HTTPStatus.OK, {"Content-Type": body.kind, "Content-Length": str(len(body.data))}) + body.data


def refusal(status: HTTPStatus) -> bytes:
    """One short line."""
    data = f"{status.value} {status.phrase}\n".encode()
    return _head(status, {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(data))}) + data


def taken() -> bytes:
    """What was posted is on its way."""
    return _head(HTTPStatus.NO_CONTENT, {})


def event_stream() -> bytes:
    """The head of a stream of events; the browser asks again after a second when it breaks."""
    return _head(HTTPStatus.OK, {"Content-Type": "text/event-stream; charset=utf-8"}) + b"retry: 1000\n\n"


def _head(status: HTTPStatus, further: dict[str, str]) -> bytes:
    lines = [f"HTTP/1.1 {status.value} {status.phrase}", *(f"{k}: {v}" for k, v in (HEADERS | further).items())]
    return "\r\n".join(lines).encode("ascii") + b"\r\n\r\n"
