"""Those who look: each has a queue of its own. Who does not keep up is let go, and gets everything when it asks again."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from protocols.errors import BadRequest
from protocols.steering import checked
from recordings.file.player import plain_numbers

from . import http

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
"""Hands kind and text of a request on to the run; False when it does not take any more at the moment."""


class Viewers:
    """Serves the page and hands out updates. `steer`: where viewers may ask something of the run."""

    def __init__(self, token: str, whole: Callable[[], dict[str, Any]], steer: Steer | None = None) -> None:
        self._token, self._whole, self._steer = token, whole, steer
        self._allowed, self._counted = BURST, time.monotonic()
        self._files = http.page_files()
        self._queues: set[asyncio.Queue[bytes | None]] = set()
        self._tasks: set[asyncio.Task[Any]] = set()

    @property
    def count(self) -> int:
        """How many look now."""
        return len(self._queues)

    def tell(self, name: str, data: dict[str, Any]) -> None:
        """Hand an update to all who look."""
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
        writer.transport.set_write_buffer_limits(high=0)  # `drain` returns when all is on its way
        try:
            asked = await http.asked(reader, self._token, self._steer is not None)
            if asked.posted is not None:
                self._ask(asked.posted)
                writer.write(http.taken())
                await asyncio.wait_for(writer.drain(), STUCK)
                return
        except http.Refused as e:
            writer.write(http.refusal(e.status))
            await asyncio.wait_for(_linger(reader, writer), LINGER)
            return
        if asked.name == http.EVENTS:
            await self._stream(writer)
            return
        writer.write(http.answer(self._files[asked.name]))
        await asyncio.wait_for(writer.drain(), STUCK)

    def _ask(self, posted: dict[str, Any]) -> None:
        """Hand a request on; raises `Refused`."""
        assert self._steer is not None
        now = time.monotonic()
        self._allowed = min(BURST, self._allowed + RATE * (now - self._counted))
        self._counted = now
        if self._allowed < 1:
            raise http.Refused(HTTPStatus.TOO_MANY_REQUESTS)
        self._allowed -= 1
        try:
            kind = posted["kind"]
            text = checked(kind, posted.get("text", ""))
        except (KeyError, BadRequest):
            raise http.Refused(HTTPStatus.BAD_REQUEST) from None
        if not self._steer(kind, text):
            raise http.Refused(HTTPStatus.SERVICE_UNAVAILABLE)

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        if self.count >= MOST_VIEWERS:
            writer.write(http.refusal(HTTPStatus.SERVICE_UNAVAILABLE))
            return
        queue: asyncio.Queue[bytes | None] = asyncio.Queue(100)  # ten seconds of updates
        writer.write(http.event_stream() + event("whole", self._whole()))
        self._queues.add(queue)
        try:
            while queue in self._queues or not queue.empty():
                await asyncio.wait_for(writer.drain(), STUCK)
                try:
                    # then an empty line tells that the stream is alive
                    text = await asyncio.wait_for(queue.get(), 5.0)
                except TimeoutError:
                    text = b":\n\n"
                if text is None:
                    break
                writer.write(text)
            await asyncio.wait_for(writer.drain(), STUCK)
        finally:
            self._queues.discard(queue)

    async def end(self) -> None:
        """Let everybody go, once what waits is sent, or after a moment."""
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
