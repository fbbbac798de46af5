"""The door of the page: fixed names behind a token. Whoever asks for anything else, or asks badly, gets a line and is let go."""

import asyncio
import contextlib
import json
import re
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from http.client import HTTPConnection
from typing import Any

import pytest
from pages import told

import timing
from lab.live import viewers
from lab.live.show import PageAddress, place
from lab.live.viewers import Viewers

HELLO = {"hello": "<script>alert(1)</script>"}
ANSWER_WITHIN = 30.0


@dataclass
class Door:
    """A server in a thread of its own."""

    at: PageAddress
    hall: Viewers
    loop: asyncio.AbstractEventLoop

    @property
    def port(self) -> int:
        port: int = self.at.listening.getsockname()[1]
        return port

    def wire(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=ANSWER_WITHIN)

    def answer(self, request: bytes) -> bytes:
        """All that comes back until the other side closes."""
        with self.wire() as wire:
            wire.sendall(request)
            return all_of(wire)

    def get(self, path: str) -> bytes:
        return self.answer(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode())

    def tell(self, data: dict[str, Any]) -> None:
        """An update to all, done when this returns."""
        done = timing.Event()
        self.loop.call_soon_threadsafe(lambda: (self.hall.tell("new", data), done.set()))
        assert done.wait(ANSWER_WITHIN)


def all_of(wire: socket.socket) -> bytes:
    found = b""
    with contextlib.suppress(ConnectionResetError):
        while data := wire.recv(65536):
            found += data
    return found


@pytest.fixture
def door() -> Iterator[Door]:
    with served(None) as found:
        yield found


@contextlib.contextmanager
def served(steer: viewers.Steer | None) -> Iterator[Door]:
    at, loop, ready = place(), asyncio.new_event_loop(), timing.Event()
    hall = Viewers(at.token, lambda: HELLO, steer)

    async def serve() -> None:
        server = await asyncio.start_server(hall.serve, sock=at.listening, limit=viewers.LARGEST_HEAD)
        ready.set()
        with contextlib.suppress(asyncio.CancelledError):
            async with server:
                await server.serve_forever()
        await hall.end()

    task = loop.create_task(serve())
    thread = timing.Thread(target=loop.run_until_complete, args=(task,))
    thread.start()
    assert ready.wait(ANSWER_WITHIN)
    yield Door(at, hall, loop)
    loop.call_soon_threadsafe(task.cancel)
    thread.join(ANSWER_WITHIN)
    loop.close()


def status(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


def test_the_page_is_whole_and_asks_for_nothing_beyond_itself(door: Door) -> None:
    for name in viewers.PAGE:
        connection = HTTPConnection("127.0.0.1", door.port, timeout=ANSWER_WITHIN)
        connection.request("GET", f"/{door.at.token}/{name}")
        found = connection.getresponse()
        body = found.read().decode()
        assert found.status == 200 and int(found.headers["Content-Length"]) == len(body.encode())
        assert "default-src 'none'" in found.headers["Content-Security-Policy"]
        assert "unsafe" not in found.headers["Content-Security-Policy"]
        assert (found.headers["X-Content-Type-Options"], found.headers["Referrer-Policy"]) == ("nosniff", "no-referrer")
        assert not re.search(r"https?://|//[a-z]+\.[a-z]", body), name
        assert not re.search(r"innerHTML|outerHTML|insertAdjacent|document\.write|\beval\b|\bFunction\(| style=|\son\w+=\"", body)


def test_the_address_has_the_token_and_every_start_another_one() -> None:
    one, other = place(), place()
    with one.listening, other.listening:
        assert one.address.startswith("http://127.0.0.1:") and one.address.endswith(f"/{one.token}/")
        assert one.token != other.token and len(one.token) >= 20


@pytest.mark.parametrize(
    ("request_", "expected"),
    [
        ("GET / HTTP/1.1\r\n\r\n", 403),
        ("GET /{token} HTTP/1.1\r\n\r\n", 404),
        ("GET /{token}x/ HTTP/1.1\r\n\r\n", 403),
        ("GET /wrong/events HTTP/1.1\r\n\r\n", 403),
        ("GET /{token}/../../etc/passwd HTTP/1.1\r\n\r\n", 404),
        ("GET /{token}/%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\n\r\n", 404),
        ("GET /{token}/page.html HTTP/1.1\r\n\r\n", 404),
        ("GET /{token}//page.js HTTP/1.1\r\n\r\n", 404),
        ("GET http://127.0.0.1/{token}/ HTTP/1.1\r\n\r\n", 400),
        ("POST /{token}/ HTTP/1.1\r\nContent-Length: 5\r\n\r\nhello", 405),
        ("PUT /{token}/page.js HTTP/1.1\r\n\r\n", 405),
        ("GET /{token}/ HTTP/9.9\r\n\r\n", 400),
        ("GET /{token}/ HTTP/1.1\r\nno colon\r\n\r\n", 400),
        ("GET /{token}/ HTTP/1.1\r\nA: b\x00c\r\n\r\n", 400),
        ("GET  /{token}/ HTTP/1.1\r\n\r\n", 400),
        ("\x16\x03\x01\x02\r\n\r\n", 400),
        ("GET /{token}/ HTTP/1.1\r\nA: " + "a" * 20_000 + "\r\n\r\n", 431),
        ("GET /" + "a" * 20_000, 431),
        ("A: b\r\n" * 5000, 431),
    ],
)  # fmt: skip
def test_a_bad_request_gets_one_short_line(door: Door, request_: str, expected: int) -> None:
    found = door.answer(request_.replace("{token}", door.at.token).encode("latin-1"))
    head, _, body = found.partition(b"\r\n\r\n")
    assert status(found) == expected and len(body) < 60 and body.count(b"\n") == 1
    assert b"Server" not in head and door.at.token.encode() not in found
    assert status(door.get(f"/{door.at.token}/")) == 200  # the next one is served


def test_who_sends_slowly_or_nothing_is_let_go(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewers, "HEAD_WITHIN", 0.2)
    with door.wire() as silent, door.wire() as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nA: ")
        assert status(all_of(silent)) == 408 and status(all_of(slow)) == 408


def test_of_too_many_at_once_the_last_are_cut_off_and_the_first_are_served(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewers, "MOST_CONNECTIONS", 3)
    with contextlib.ExitStack() as stack:
        first = [stack.enter_context(events(door)) for _ in range(3)]
        assert door.get(f"/{door.at.token}/") == b""
        door.tell({"n": 1})
        assert all(next(told(lines)) == ("new", {"n": 1}) for lines in first)


@contextlib.contextmanager
def events(door: Door) -> Iterator[Iterator[bytes]]:
    """The lines of a stream of events, behind its head and the first event."""
    with door.wire() as wire:
        wire.sendall(f"GET /{door.at.token}/events HTTP/1.1\r\n\r\n".encode())
        lines = iter(wire.makefile("rb"))
        assert b"200" in next(lines)
        while next(lines) != b"\r\n":
            pass
        assert next(told(lines)) == ("whole", HELLO)
        yield lines


def test_every_viewer_gets_every_update_in_order(door: Door) -> None:
    with contextlib.ExitStack() as stack:
        streams = [stack.enter_context(events(door)) for _ in range(10)]
        for n in range(20):
            door.tell({"n": n, "text": "\n\nevent: whole\ndata: {}"})
        for lines in streams:
            assert [next(told(lines))[1]["n"] for _ in range(20)] == list(range(20))


def test_a_viewer_who_takes_nothing_is_let_go_and_the_others_notice_nothing(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewers, "STUCK", 0.5)
    with events(door) as lines, door.wire() as stuck:
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stuck.sendall(f"GET /{door.at.token}/events HTTP/1.1\r\n\r\n".encode())
        while door.hall.count < 2:
            door.tell({"n": -1})
            next(told(lines))
        n = 0
        while door.hall.count == 2:  # what waits for the stuck one is bounded
            n += 1
            door.tell({"n": n, "filling": "x" * 50_000})
            assert next(told(lines))[1]["n"] == n
            assert n < 5000
        assert door.hall.count == 1


# -- what is asked of a run
HERE = {"Host": "h:1", "Origin": "http://h:1", "Content-Type": "application/json"}


def post(door: Door, body: bytes, name: str = "ask", **heads: str | None) -> bytes:
    said = {**HERE, "Content-Length": str(len(body)), **{k.replace("_", "-"): v for k, v in heads.items()}}
    lines = "".join(f"{k}: {v}\r\n" for k, v in said.items() if v is not None)
    return door.answer(f"POST /{door.at.token}/{name} HTTP/1.1\r\n{lines}\r\n".encode() + body)


PAUSE = b'{"kind": "pause"}'


@pytest.fixture
def run() -> Iterator[tuple[Door, list[tuple[str, str]]]]:
    """The door of a run, and what it was asked."""
    asked: list[tuple[str, str]] = []
    with served(lambda kind, text: asked.append((kind, text)) is None) as door:
        yield door, asked


def test_what_the_page_asks_is_handed_on_once(run: tuple[Door, list[tuple[str, str]]]) -> None:
    door, asked = run
    assert status(post(door, PAUSE, Sec_Fetch_Site="same-origin")) == 204
    assert status(post(door, json.dumps({"kind": "note", "text": " <b>a\nb</b>"}).encode())) == 204
    assert asked == [("pause", ""), ("note", "<b>a b</b>")]
    assert status(door.get(f"/{door.at.token}/ask")) == 404


@pytest.mark.parametrize(
    ("body", "heads", "expected"),
    [
        (PAUSE, {"Origin": None}, 403),
        (PAUSE, {"Origin": "http://evil"}, 403),
        (PAUSE, {"Origin": "null"}, 403),
        (PAUSE, {"Host": None}, 403),
        (PAUSE, {"Sec_Fetch_Site": "cross-site"}, 403),
        (PAUSE, {"host": "evil"}, 400),
        (PAUSE, {"content-length": "3"}, 400),
        (PAUSE, {"Content_Type": "text/plain"}, 415),
        (PAUSE, {"Content_Type": None}, 415),
        (PAUSE, {"Content_Length": None}, 411),
        (PAUSE, {"Content_Length": "-1"}, 411),
        (PAUSE, {"Content_Length": "99999"}, 413),
        (PAUSE, {"name": "page.js"}, 405),
        (PAUSE, {"name": ""}, 405),
        (b"", {}, 400),
        (b"[]", {}, 400),
        (b"{", {}, 400),
        (b"[" * 4000, {}, 400),
        (b'{"kind": "dance"}', {}, 400),
        (b'{"kind": ["pause"]}', {}, 400),
        (b'{"text": "x"}', {}, 400),
        (b'{"kind": "note", "text": ""}', {}, 400),
        (json.dumps({"kind": "note", "text": "x" * 501}).encode(), {}, 400),
    ],
)  # fmt: skip
def test_what_anybody_else_asks_is_refused(
    body: bytes, heads: dict[str, str | None], expected: int, run: tuple[Door, list[tuple[str, str]]]
) -> None:
    door, asked = run
    answer = post(door, body, **heads)  # type: ignore[arg-type]
    assert status(answer) == expected and door.at.token.encode() not in answer
    wrong = door.answer(b"POST /wrong/ask HTTP/1.1\r\nHost: h:1\r\nOrigin: http://h:1\r\n\r\n")
    assert status(wrong) == 403 and asked == []
    assert status(door.get(f"/{door.at.token}/")) == 200


def test_too_many_requests_and_a_run_that_takes_none_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewers, "RATE", 0.0)
    with served(lambda kind, text: False) as door:
        assert [status(post(door, PAUSE)) for _ in range(12)] == [503] * 10 + [429] * 2


def test_a_page_without_a_run_takes_nothing(door: Door) -> None:
    assert status(post(door, PAUSE)) == 405
