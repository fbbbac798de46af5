"""The guard as a process of its own: commands by one pipe, the program's pulse by a second, readings back by a third.

It lands by itself when the program ends (its pipe breaks), freezes (no heartbeat), hangs (the experiment makes no progress) or
raises an alarm (a signal, a force beyond the limit); `lab safe` requests it at the guard's door. Run by `python -m
lab.guard.process COMMANDS PULSE REPORTS` with three file descriptors.
"""

from __future__ import annotations

import contextlib
import os
import signal
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Queue
from typing import Any

import timing
from drivers.errors import DeviceFault, InstrumentError
from timing import RigClock

from ..files.config import ConfigError
from ..files.rig_file import same_rig, within_robot
from .child import begin_child
from .commands import Command, Order
from .guard import LIVES_ON, Guard
from .instruments import of_driver
from .latch import RigLocked
from .messages import Event, RigLanded, Start
from .pulse import BEAT, FRESH, SIGNAL, Awake, Listener, overload

LOOK = 0.05
"""Longest host seconds between two checks of the pulse."""
BEAT_BACK = 0.2
"""Host seconds between two signs of life to the program."""
END = None
"""The last message."""
MOST_WAITING = 100
"""Longest queue of messages for the program; further samples are dropped."""


class Reports:
    """Sends the guard's events and samples to the program, in order, without ever waiting for it; a program that does not read
    loses samples, never an event."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._queue: Queue[Any] = timing.Queue()
        timing.Thread(target=self._send, name="reports", daemon=True).start()

    def __call__(self, message: Any) -> None:
        """See guard.Tell."""
        kept = isinstance(message, Event) and message.kind != "beat"
        if kept or self._queue.qsize() < MOST_WAITING:
            self._queue.put(message)

    def _send(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # the program has gone: the watch sees it
            while (message := self._queue.get()) is not END:
                self._pipe.send(message)

    def close(self) -> None:
        """Nothing follows."""
        self._queue.put(END)


class ProgramWatch(timing.Thread):
    """Monitors the program's pulse; lands when it ends, falls silent, hangs or raises an alarm."""

    def __init__(self, guard: Guard, pulse: Listener) -> None:
        super().__init__(name="watch", daemon=True)
        self._guard, self._pulse = guard, pulse
        self._awake = Awake()
        self._heard_at, self._next_beat = self._awake.now, 0.0
        """Times of the program's last sign of life and of this guard's next one, s awake."""

    def run(self) -> None:
        """Run until the program or the guard ends; land if it was the program."""
        try:
            # to the last: an arm takes its time to disconnect
            self._guard.go_on("the watch on the program", self._look, lambda: self._guard.gone or self._pulse.gone)
            if self._pulse.gone:
                self._guard.ending = True  # the next program may wait for the end of the landing, and then have the rig
                self._guard.land("the program ended")
        finally:
            self._pulse.close()

    def _look(self) -> None:
        """Read the pulse once, and send a sign of life; a program silent for `safe.heartbeat` lands an energised rig."""
        guard = self._guard
        timing.readable([self._pulse.pipe], LOOK)
        records = self._pulse.take()
        now = self._awake.look()
        if any(kind != FRESH for kind, _ in records):  # a sign of life of the program, not only of its force sensor
            self._heard_at = now
        for kind, value in records:
            self._heard(kind, value)
        silent = now - self._heard_at
        if guard.energised and silent > guard.rig.safe.heartbeat:
            guard.land(
                f"no heartbeat from the program for {silent:.1f} s, {guard.rig.safe.heartbeat:g} s allowed by "
                "safe.heartbeat of the rig; " + timing.busy_or("find out what stopped the program")
            )
        if now > self._next_beat:
            self._next_beat = now + BEAT_BACK
            guard.tell(Event("beat"))

    def _heard(self, kind: bytes, value: float) -> None:
        """Act on one record of the pulse; kinds and units of values as in `pulse`."""
        guard = self._guard
        if kind == SIGNAL:
            guard.land(f"stopped by {signal.Signals(int(value)).name}")
        elif kind == FRESH:
            if guard.under_force is not None:
                guard.under_force.sampled(value)
        elif text := overload(kind, value, guard.rig):
            if guard.energised:
                guard.land(f"force: {text}", DeviceFault("force", f"{text}; free the tool, then run again"))
        elif kind == BEAT and guard.energised and value > guard.rig.safe.hang:
            guard.land(f"the experiment has made no progress for {value:.1f} s (safe.hang)")


def _serve(guard: Guard, commands: Connection) -> None:
    """Perform requests and commands and send the answers, until the program sends END or is gone; then land what is energised."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            number, asked = timing.receive(commands)  # a request or a command, answered under its number
            if asked is Order.END:
                going = guard.finish()
                if going:
                    commands.send((number, True, going))  # the program does not wait for results that come late, or never
                    _live_on(guard)
                else:
                    guard.close()
                    commands.send((number, True, ""))
                return
            answer: Any
            try:
                ok, answer = True, guard.obey(asked) if isinstance(asked, Order) else guard.do(asked)
            except Exception as e:  # noqa: BLE001 - every failure is handed to the caller, typed where the type can travel
                if isinstance(asked, Command) and asked.instrument in guard.own.drivers:
                    e = of_driver(asked.instrument, getattr(guard.rig.instruments, asked.instrument), e)
                typed = isinstance(e, (InstrumentError, RigLanded, RigLocked))
                ok, answer = False, e if typed else RuntimeError(f"{type(e).__name__}: {e}")
            commands.send((number, ok, answer))
    guard.landed = guard.landed or "the program ended"
    _live_on(guard)


def _live_on(guard: Guard) -> None:
    """Continue to land without the program; release its terminal and pipes for readers that wait for their end."""
    if not timing.together():  # else they are its program's own
        with contextlib.suppress(OSError):
            nothing = os.open(os.devnull, os.O_RDWR)
            for output in (1, 2):
                os.dup2(nothing, output)
    guard.close(LIVES_ON)


def main(commands: Connection, pulse: Listener, reports: Connection) -> int:
    """Take the rig over and serve the program until it says goodbye or is gone; 0, or 1 where another program has the rig or
    rig.yaml was changed meanwhile.

    Each answer is (number of the command, whether it was done, its result or error); number 0 answers `Start`."""
    try:
        start: Start = timing.receive(commands)
    except (EOFError, OSError):  # the program ended before it said anything
        return 1
    outbox = Reports(reports)
    try:
        rig = within_robot(same_rig(Path(start.path), start.sha256), start.max_pressure)
        guard = Guard(rig, RigClock(rig.clock.speed, start.clock_start), start.despite_latch, outbox, start.about)
        guard.take_over()
    except (ConfigError, RigLocked) as e:
        with contextlib.suppress(OSError):
            commands.send((0, False, e))
        outbox.close()
        pulse.close()  # else its watch closes it
        return 1
    with contextlib.suppress(OSError):  # a program that has ended meanwhile is met by the watch
        commands.send((0, True, None))
    guard.start()
    ProgramWatch(guard, pulse).start()
    _serve(guard, commands)
    outbox.close()
    return 0


def serve(given: list[int]) -> int:
    """Run one guard on the file descriptors that it was given; returns the exit code."""
    commands, pulse, reports = given
    with Connection(commands) as taken, Connection(reports, readable=False) as sent:
        return main(taken, Listener(pulse), sent)


if __name__ == "__main__":
    os._exit(serve(begin_child()))  # threads may be stuck in a driver that does not return
