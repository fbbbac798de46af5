"""Follow a recording and show it at an address."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import secrets
import socket
import subprocess
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from recordings.errors import RecordingError
from recordings.file.tail import Piece, Tail

from ..guard.child import Child, start_child
from ..priority import BEHIND
from .foxglove_server import Foxglove
from .picture import About, Picture, about, shown, text_of
from .viewers import LARGEST_HEAD, Steer, Viewers


class NoModel(RuntimeError):
    """There is no model of this robot, or it has ended; the text says why."""


class ModelProcess:
    """Asks the process that holds the model (`expected`), one question at a time."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._process: Child | None = None

    async def start(self) -> bool:
        """Start it; returns whether it gives intervals once its kernels are there. Raises `NoModel`."""
        pipe = subprocess.PIPE
        self._process = start_child("lab.live.expected", place=BEHIND, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
        answer = await self.ask({"robot": self._robot})
        if "error" in answer:
            raise NoModel(str(answer["error"]))
        return bool(answer["intervals"])

    async def ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """One answer; raises `NoModel` when the process has ended."""
        return await asyncio.to_thread(self._ask, question)

    def _ask(self, question: dict[str, Any]) -> dict[str, Any]:
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(question).encode() + b"\n")
            process.stdin.flush()
            answer: dict[str, Any] = json.loads(process.stdout.readline())
        except (OSError, ValueError) as e:
            raise NoModel(f"the model's process has ended ({e})") from e
        return answer

    def stop(self) -> None:
        """End it; may be called twice and before start."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()


AT_ONCE = 256
"""Pieces read at once while catching up with a long run."""


async def following(tail: Tail, over: Callable[[], bool]) -> AsyncIterator[list[Piece]]:
    """The content of the file, then what is added until it is finished; or, once `over`, until nothing more arrives."""
    while not tail.contents.finished:
        if tail.grown():
            yield await asyncio.to_thread(tail.read)
        elif over():
            return
        else:
            await asyncio.sleep(0.02)


async def played(tail: Tail, speed: float) -> AsyncIterator[list[Piece]]:
    """The pieces of a recording at `speed` times rig time (inf: at once); ends where nothing more can be read."""
    begin, first = time.monotonic(), None
    due: list[Piece] = []
    while pieces := await asyncio.to_thread(tail.read):
        for piece in pieces:
            first = piece.until if first is None else first
            wait = begin + (piece.until - first) / 1e9 / speed - time.monotonic()
            if wait > 0.05 or (due and math.isfinite(speed) and wait > 0):
                if due:
                    yield due
                    due = []
                await asyncio.sleep(max(wait, 0.0))
            due.append(piece)
            if len(due) >= AT_ONCE:
                yield due
                due = []
    if due:
        yield due


LOOPBACK = "127.0.0.1"
ASK = 0.2
"""Host seconds between two questions to the model."""


@dataclass(frozen=True)
class PageAddress:
    """Where a page is served, and the secret in its address."""

    listening: socket.socket
    token: str

    @property
    def address(self) -> str:
        """What to open in a browser."""
        host, port = self.listening.getsockname()[:2]
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{port}/{self.token}/"


def place(bind: str = LOOPBACK, port: int = 0) -> PageAddress:
    """Listen at an address of this computer; raises OSError when that cannot be."""
    family, both = (socket.AF_INET6, socket.has_dualstack_ipv6()) if ":" in bind else (socket.AF_INET, False)
    listening = socket.create_server((bind, port), family=family, backlog=64, dualstack_ipv6=both)
    return PageAddress(listening, secrets.token_urlsafe(16))


@dataclass(frozen=True)
class ShownRecording:
    """A recording that is shown."""

    path: Path
    text: str = ""
    """Which part of a campaign it is."""
    more: bool = False
    """Others may follow it."""


class Show:
    """Recordings at one place, one at a time. `speed`: how fast a recording is played; None: a run that is going on is
    followed. `steer`: where viewers may ask something of that run. `foxglove`: where it is shown too; a recording is played
    once somebody has subscribed there."""

    def __init__(
        self,
        served: PageAddress,
        part: ShownRecording | None = None,
        speed: float | None = None,
        model: bool = True,
        steer: Steer | None = None,
        foxglove: Foxglove | None = None,
    ) -> None:
        self._at, self._speed = served, speed
        self._parts = deque([] if part is None else [part])
        self._part: ShownRecording | None = None
        self._before: list[dict[str, Any]] = []
        """Of each recording shown before, its part and how it ended: for viewers who come, or come back, later."""
        self.count = 0
        """How many were shown, with the present one."""
        self._over = threading.Event()
        self._with_model = model
        self._foxglove = foxglove
        self._picture: Picture | None = None
        self._steered = steer is not None
        self._viewers = Viewers(served.token, self._whole, steer)
        self._clock: Callable[[], float] = self._newest

    def follow(self, part: ShownRecording) -> None:
        """Show this recording once the present one has ended; from any thread."""
        self._parts.append(part)

    def over(self) -> None:
        """The last run has ended, or no page is wanted any more; from any thread."""
        self._over.set()

    def run(self, stay: bool) -> None:
        """Serve until `over`, and if not `stay` a moment longer. Raises `RecordingError` for a file that is none."""
        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(self._run(stay))

    async def _run(self, stay: bool) -> None:
        """Serve, and show one recording after the other until `over`; see `run`."""
        server = await asyncio.start_server(self._viewers.serve, sock=self._at.listening, limit=LARGEST_HEAD)
        async with server:
            try:
                while (part := await self._next()) is not None:
                    if self._part is not None and self._picture is not None:
                        name, ended = shown(self._part.text or self._part.path.name), self._picture
                        self._before.append({"part": name, "outcome": ended.outcome, "trouble": ended.trouble})
                    self._part, self._picture, self.count = part, None, self.count + 1
                    self._clock = self._newest
                    await self._until(part.path.exists)
                    with Tail(part.path) as tail:
                        await self._show(tail)
                self._part = None if self._part is None else replace(self._part, more=False)
                self._tell(self._of_part())
                # viewers of an active run receive its end
                await asyncio.sleep(0.0 if stay else 2.0)
            finally:
                await self._viewers.end()

    async def _next(self) -> ShownRecording | None:
        """The recording to show next; None at the end."""
        await self._until(lambda: self._parts)
        return self._parts.popleft() if self._parts else None

    async def _until(self, holds: Callable[[], object]) -> None:
        """Wait for this, or until all is over."""
        while not holds() and not self._over.is_set():
            await asyncio.sleep(0.05)

    async def _show(self, tail: Tail) -> None:
        """Show one recording, until it has ended and another one is there, or all is over."""
        tasks = [asyncio.create_task(self._beat())]
        asking: asyncio.Task[None] | None = None
        try:
            if self._foxglove is not None:
                self._foxglove.anew()
                if self._speed is not None:
                    await self._wanted(self._foxglove, tail.path)
            live = following(tail, lambda: self._over.is_set() or bool(self._parts))
            async for pieces in live if self._speed is None else played(tail, self._speed):
                if not pieces:
                    continue
                if self._picture is None:  # by the first chunk all attachments are there
                    self._picture = Picture(self._about(tail))
                    self._tell(self._whole(), "whole")
                    if self._with_model:
                        asking = asyncio.create_task(self._ask(text_of(tail.contents, "robot.yaml")))
                        tasks.append(asking)
                self._keep_time(tail, pieces)
                if self._foxglove is not None:
                    self._foxglove.take(tail.contents, pieces)
                self._tell(self._picture.take(pieces))
            if self._picture is None:
                self._picture = Picture(self._about(tail))
                self._tell(self._whole(), "whole")
            self._end(self._picture.end(tail.contents.metadata, tail.contents.finished))
        except RecordingError as e:
            if self._picture is None:
                raise
            self._end(self._picture.broken(str(e)))
        try:
            await self._until(lambda: self._parts)
            if asking is not None and not self._parts and self._viewers.count:
                # viewers wait for what the model says of the last state
                await asyncio.wait([asking], timeout=60.0)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    async def _wanted(self, foxglove: Foxglove, path: Path) -> None:
        """Wait until somebody has subscribed to topics of the recording."""
        with Tail(path) as beginning:
            await asyncio.to_thread(beginning.read)
            foxglove.offer(beginning.contents)
        await self._until(lambda: foxglove.wanted)

    def _about(self, tail: Tail) -> About:
        found = about(tail.path, tail.contents)
        return found if self._speed is None else replace(found, speed=min(self._speed, 1e6))

    def _keep_time(self, tail: Tail, pieces: list[Piece]) -> None:
        """Of a run: its rig time now, from the wall time of its first line, which was written when it was recorded."""
        assert self._picture is not None
        if self._speed is not None or not pieces[0].events["/log"] or self._picture.first is not None:
            return
        begun, speed = pieces[0].events["/log"][0].log_time, self._picture.about.speed
        t = (begun - self._picture.about.start_wall_ns) / 1e9
        since, looked = time.time() - begun / 1e9, time.monotonic()
        self._clock = lambda: t + speed * (since + time.monotonic() - looked)

    def _newest(self) -> float:
        return self._picture.t if self._picture is not None else 0.0

    def _end(self, said: dict[str, Any]) -> None:
        """Stop the clock, and tell viewers how the recording ended."""
        assert self._picture is not None
        end = self._picture.t
        self._clock = lambda: end
        self._tell(said)

    # -- what is told
    def _whole(self) -> dict[str, Any]:
        if self._picture is None:
            return {"waiting": True, **self._of_part()}
        return self._timed({**self._picture.whole(), "steered": self._steered, **self._of_part()})

    def _of_part(self) -> dict[str, Any]:
        return {} if self._part is None else {"part": shown(self._part.text), "more": self._part.more, "before": self._before}

    def _timed(self, data: dict[str, Any]) -> dict[str, Any]:
        """With the rig time now and the wall time (ms) of this update."""
        return {**data, "clock": self._clock(), "sent": time.time() * 1e3}

    def _tell(self, data: dict[str, Any], name: str = "new") -> None:
        self._viewers.tell(name, self._timed(data))

    async def _beat(self) -> None:
        while True:
            # ages increase while nothing arrives
            await asyncio.sleep(0.5)
            self._tell({})

    # -- the model
    async def _ask(self, robot: str | None) -> None:
        """Keep asking the model about finished states and the tip now; end with the answers to the last of both."""
        picture = self._picture
        assert picture is not None
        if robot is None:
            self._tell(picture.model_says("none", "no robot.yaml in the recording"))
            return
        model = ModelProcess(robot)
        try:
            self._tell(picture.model_says("starting"))
            intervals = await model.start()
            why = "" if intervals else "no interval, because robot.yaml is not fitted"
            self._tell(picture.model_says("ready", why))
            asked_rows, last, due = 0, None, 0.0
            last_round = False
            while not last_round:
                last_round = picture.ended
                if len(picture.rows) > asked_rows and ((began := time.monotonic()) >= due or last_round):
                    asked_rows = len(picture.rows)
                    answer = await model.ask({"rows": [row.to_json() for row in picture.rows]})
                    # the model pauses for four times its computing time
                    due = time.monotonic() + 4.0 * (time.monotonic() - began)
                    self._tell(picture.gaps(answer["gaps"]) if "gaps" in answer else picture.model_says("ready", answer["error"]))
                question = picture.question()
                if question is not None and question[1]["t"] != last:
                    last = question[1]["t"]
                    answer = await model.ask(question[0])
                    self._tell(picture.expected_now({**question[1], **answer}))
                    if self._foxglove is not None:
                        self._foxglove.expected(picture.about.start_wall_ns + round(last * 1e9), answer)
                await asyncio.sleep(ASK)
        except NoModel as e:
            self._tell(picture.model_says("none", str(e)))
        finally:
            model.stop()
