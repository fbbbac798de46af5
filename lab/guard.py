"""The guard: a small process that owns the actuators and lands the rig when the program that commands it cannot.

It lands by itself when the program ends (its pipe breaks), freezes (no heartbeat), hangs (the experiment does not move
on), shouts (a signal, a force beyond the limit), or when a reading shows that something has failed. After that it takes
no command until a person has confirmed. The latch is on disk from the first command that energises anything until the
safe state is read back. Run by `python -m lab.guard COMMANDS PULSE SAMPLES` with three file descriptors.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from drivers.errors import DeviceFault, InstrumentError
from drivers.interfaces import Identity

from .clock import RigClock
from .force_limit import overload
from .guard_messages import Event, RigLanded, Start
from .hosted import Hosted
from .instruments import COMMANDS, CONFIGS, ENERGISING, POLLED, make
from .judge import Judge
from .landing import Landing, SafeReport
from .latch import Latch, RigLocked
from .pulse import BEAT, FRESH, SIGNAL, Listener
from .rig_file import RigFile
from .under_force import UnderForce

BEAT_BACK = 0.2
"""Host seconds between two signs of life to the program."""
CLIPPED = 1e3
"""Pa by which a set-point must be clipped to be worth a line in the log."""
JUST_TRIED = 5.0
"""Host seconds in which a landing that was not confirmed is not repeated; the drivers stop once more as they close."""
LOG_EVERY = 1.0
"""Host seconds between two such lines."""


@dataclass
class Owned:
    """The actuator drivers."""

    drivers: dict[str, Any] = field(default_factory=dict)
    opened: list[str] = field(default_factory=list)
    locks: dict[str, threading.Lock] = field(default_factory=dict)
    busy: set[str] = field(default_factory=set)
    """Those to which a command that energises is on its way."""


class Guard:
    """One rig's guard."""

    def __init__(self, start: Start, pulse: Listener, samples: Connection) -> None:
        self.rig = RigFile.model_validate_json(start.rig)
        self.clock = RigClock(self.rig.clock.speed, start.clock_start)
        self.latch = Latch(Path(start.path)) if start.path else None
        self.despite_latch = start.despite_latch
        self.pulse, self.samples = pulse, samples
        self.judge = Judge(self.rig)
        self.own = Owned()
        for name in COMMANDS:
            config = getattr(self.rig.instruments, name)
            if config is not None:
                self.own.drivers[name] = self._make(name, config)
                self.own.locks[name] = threading.Lock()
        self.under_force: UnderForce | None = None
        if "arm" in self.own.drivers:
            arm = self.own.drivers["arm"]
            self.under_force = UnderForce(arm, self.rig.limits, self._go_on, self._say_waiting, self._not_stopped)
            self.own.drivers["arm"] = self.under_force
        self.landing = Landing(self.rig.safe, self.own.drivers, self.rig.clock.speed, self.own.busy.__contains__)
        self.running = True
        self.energised = False
        self.landed = ""
        """Why the guard landed the rig by itself; empty while it takes commands."""
        self._cause: InstrumentError | None = None
        self._landing_lock = threading.RLock()
        self._deciding = threading.Lock()
        self._sending = threading.Lock()
        self._clip_told = 0.0
        self._landed_at = -math.inf
        self._last = SafeReport()
        self._closed = False

    def _make(self, name: str, config: Any) -> Any:
        if config.driver in CONFIGS:
            return Hosted(name, config.driver, config, self.clock)
        if name == "valve" and self.rig.safe.keep_vacuum:
            config = config.model_copy(update={"on_close": "keep"})
        return make(name, config.driver, config, self.clock)

    def take_over(self) -> None:
        """Own the rig; raises RigLocked."""
        if self.latch is not None:
            self.latch.own()
            if not self.despite_latch:
                self.latch.demand_free()

    def start(self) -> None:
        """Poll and watch."""
        for name in POLLED:
            if name in self.own.drivers:
                threading.Thread(target=self._poll, args=(name,), name=f"poll-{name}", daemon=True).start()
        threading.Thread(target=self._watch, name="watch", daemon=True).start()

    # -- commands
    def do(self, name: str, method: str, args: tuple[Any, ...]) -> Any:
        """One command of the program."""
        own: dict[str, Callable[[], Any]] = {
            "safe": lambda: self.safe("asked for by the program", self.rig.safe.keep_vacuum),
            "pause": lambda: self.safe("pause", keep_vacuum=True),
            "resume": self.resume,
            "unlock": self.unlock,
        }
        if not name:
            return own[method]()
        if method == "open":
            return self.open(name)
        if method == "close":
            return self.close_one(name)
        if name not in self.own.drivers or method not in COMMANDS[name]:
            raise ValueError(f"{name}.{method} is not a command of this rig")
        with self.own.locks[name]:
            if (name, method) == ("pressure", "vent"):
                self.judge.told = None
            if (name, method) not in ENERGISING:
                return getattr(self.own.drivers[name], method)(*args)
            self.own.busy.add(name)  # before it is asked whether it may: a landing that begins now waits for it
            try:
                self._energise()
                if name == "pressure":
                    return self._set_pressure(*args)
                return getattr(self.own.drivers[name], method)(*args)
            finally:
                self.own.busy.discard(name)

    def open(self, name: str) -> Identity:
        """Connect one instrument."""
        with self.own.locks[name]:
            identity: Identity = self.own.drivers[name].open()
            self.own.opened.append(name)
        return identity

    def close_one(self, name: str) -> None:
        """Disconnect one instrument."""
        with self.own.locks[name]:
            self.own.opened = [n for n in self.own.opened if n != name]
            self.own.drivers[name].close()

    def _energise(self) -> None:
        if self.landed:
            raise self._cause or RigLanded(f"the guard has landed the rig: {self.landed}")
        if not self.energised:
            if self.latch is not None and not self.despite_latch:
                self.latch.write("a run was cut off before its safe state was confirmed")
            self.energised = True

    def _set_pressure(self, pressures: tuple[float, ...]) -> tuple[float, ...]:
        allowed = self.judge.setpoints(pressures)
        self.judge.told = None
        held: tuple[float, ...] = self.own.drivers["pressure"].set(allowed)
        self.judge.told = held
        now = time.monotonic()
        worst = max((abs(a - b) for a, b in zip(pressures, held, strict=False)), default=0.0)
        if worst > CLIPPED and now - self._clip_told > LOG_EVERY:
            self._clip_told = now
            asked, got = (", ".join(f"{p / 1e3:.1f}" for p in ps) for ps in (pressures, held))
            self.tell(Event("clipped", f"pressure set-points clipped: asked {asked} kPa, set {got} kPa"))
        return held

    # -- landing
    def safe(self, why: str, keep_vacuum: bool) -> SafeReport:
        """Land what is open and read it back; the latch goes when all of it is confirmed. Never raises."""
        with self._landing_lock:
            if self._closed:
                return self._last
            self.judge.told = None
            report = self._last = self.landing.land(list(self.own.opened), keep_vacuum)
            self._landed_at = time.monotonic()
            if self.latch is not None:
                if self.energised or not report.confirmed:
                    self.latch.note(f"landed ({why}): {report}")
                if not report.confirmed:
                    with contextlib.suppress(OSError):
                        self.latch.write(f"safe state not confirmed after: {why}. {report}")
                elif self.energised and not self.despite_latch:
                    self.latch.clear()
            self.energised = self.energised and not report.confirmed
            return report

    def land(self, why: str, error: InstrumentError | None = None) -> None:
        """Land by the guard's own decision, once, in a thread of its own; commands are refused from here on."""

        def go() -> None:
            report = self.safe(why, self.rig.safe.keep_vacuum)
            self.tell(Event("landed", why, error, report), may_wait=True)

        with self._deciding:
            if self.landed:
                return
            self.landed, self._cause = why, error
            threading.Thread(target=go, name="land", daemon=True).start()

    def resume(self) -> None:
        """A person has confirmed: open what has to be opened anew, take commands again.

        Set-points start from what is measured: the regulators are vented, arm and spine stand where they were stopped.
        """
        if "arm" in self.own.opened:
            with self.own.locks["arm"]:
                arm = self.own.drivers["arm"]
                try:
                    arm.moving()
                except InstrumentError:
                    arm.close()
                    arm.open()
        self.landed = ""

    def unlock(self) -> None:
        """A person has seen to the rig: the latch goes."""
        if self.latch is not None:
            self.latch.clear()
            self.latch.note("unlocked by a person")

    # -- threads
    def tell(self, message: Any, may_wait: bool = False) -> None:
        """Send to the program; unless it may wait, a message for a program that does not read is dropped."""
        if not self._sending.acquire(blocking=may_wait):
            return
        try:
            if may_wait or wait_writable(self.samples):
                self.samples.send(message)
        except (OSError, ValueError):
            pass  # the program has gone: the watch sees it
        finally:
            self._sending.release()

    def _poll(self, name: str) -> None:
        """Read one instrument at the rig's rate; a reading that fails is passed on as its error."""
        while self.running:
            due = time.monotonic() + 1 / self.rig.poll
            if name in self.own.opened:
                sample: Any
                try:
                    with self.own.locks[name]:
                        sample = self.own.drivers[name].read()
                except InstrumentError as e:
                    sample = e
                else:
                    sample = self._judge(name, sample)
                self.tell((name, sample), may_wait=True)
            time.sleep(max(0.0, due - time.monotonic()))

    def _judge(self, name: str, sample: Any) -> Any:
        """The reading, or the error that stands for one that is not acceptable."""
        finding = self.judge.judge(name, sample)
        if finding is None:
            return sample
        if finding.act == "pause":
            self.tell(Event("pause", str(finding.error), finding.error))
            return sample
        if self.energised:
            self.land(str(finding.error), finding.error)
        return finding.error

    def _watch(self) -> None:
        """Listen to the program's pulse; land when it ends, falls silent, hangs or shouts."""
        beat_back = 0.0
        while self.running:
            wait([self.pulse.pipe], 0.05)
            for kind, value in self.pulse.take():
                self._heard(kind, value)
            now = time.monotonic()
            if self.pulse.gone:
                self.land("the program ended")
                return
            silent = now - self.pulse.heard
            if self.energised and silent > self.rig.safe.heartbeat:
                self.land(f"no sign of life from the program for {silent:.1f} s")
            if now > beat_back:
                beat_back = now + BEAT_BACK
                self.tell(Event("beat"))

    def _heard(self, kind: bytes, value: float) -> None:
        if kind == SIGNAL:
            self.land(f"stopped by {signal.Signals(int(value)).name}")
        elif kind == FRESH:
            if self.under_force is not None:
                self.under_force.sampled(value)
        elif text := overload(kind, value, self.rig):
            self._overloaded(text)
        elif kind == BEAT and self.energised and value > self.rig.safe.hang:
            self.land(f"the experiment has not moved on for {value:.1f} s (safe.hang)")

    def _overloaded(self, text: str) -> None:
        if self.energised:
            self.land(f"force: {text}", DeviceFault("force", f"{text}; the arm was stopped: free it by hand"))

    # -- the arm under force
    def _go_on(self, motion: Callable[[], Any]) -> Any:
        """A motion that had to wait begins as a command of the program does: not when the rig was landed meanwhile."""
        self.own.busy.add("arm")
        try:
            self._energise()
            return motion()
        finally:
            self.own.busy.discard("arm")

    def _say_waiting(self, text: str) -> None:
        """From a thread of its own: the line must not be dropped, and the arm must not wait for the program to read it."""
        event = Event("waiting", text)
        threading.Thread(target=self.tell, args=(event, True), name="say-waiting", daemon=True).start()

    def _not_stopped(self, error: InstrumentError) -> None:
        self.land(f"no force samples, and the arm does not take its stop: {error}", error)

    def close(self) -> None:
        """Land what may still be energised, disconnect everything, the regulators first."""
        self.landed = self.landed or "the guard is ending"
        with self._landing_lock:
            if self.energised and time.monotonic() - self._landed_at > JUST_TRIED:
                self.safe("the program ended", self.rig.safe.keep_vacuum)
            self._closed = True  # a landing that another thread still wants has been done
        self.running = False
        closing = [
            threading.Thread(target=self._close, args=(name,), name=f"close-{name}", daemon=True)
            for name in self.own.opened
        ]
        for thread in closing:
            thread.start()
        for thread in closing:
            thread.join(8.0)

    def _close(self, name: str) -> None:
        with contextlib.suppress(Exception):
            self.own.drivers[name].close()


def wait_writable(connection: Connection) -> bool:
    """True when a message can be sent without waiting for the reader."""
    return bool(select.select([], [connection], [], 0)[1])


def _serve(guard: Guard, commands: Connection) -> None:
    """Take commands until the program says goodbye or is gone."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            number, name, method, args = commands.recv()
            if method == "end":
                guard.close()
                commands.send((number, True, None))
                return
            answer: Any
            try:
                ok, answer = True, guard.do(name, method, args)
            except Exception as e:  # noqa: BLE001 - every failure is handed to the caller, typed where the type can travel
                known = isinstance(e, (InstrumentError, RigLanded, RigLocked))
                ok, answer = False, e if known else RuntimeError(f"{type(e).__name__}: {e}")
            commands.send((number, ok, answer))
    guard.landed = guard.landed or "the program ended"
    guard.close()


def main(commands: Connection, pulse: Listener, samples: Connection) -> int:
    """Run one guard."""
    start = commands.recv()
    guard = Guard(start, pulse, samples)
    try:
        guard.take_over()
    except (RigLocked, OSError) as e:
        commands.send(
            (0, False, e if isinstance(e, RigLocked) else RigLocked(f"latch and journal cannot be kept: {e}"))
        )
        return 1
    commands.send((0, True, None))
    guard.start()
    _serve(guard, commands)
    return 0


if __name__ == "__main__":
    for ignored in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(ignored, signal.SIG_IGN)
    code = main(Connection(int(sys.argv[1])), Listener(int(sys.argv[2])), Connection(int(sys.argv[3]), readable=False))
    os._exit(code)  # threads may be stuck in a driver that does not come back
