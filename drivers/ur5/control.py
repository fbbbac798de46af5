"""The one thread that owns ur_rtde's control object: one call at a time, each bounded, and watchdog kicks in between.

Two threads in that object would overwrite each other's command registers: a watchdog kick clears a command that the
controller has not read yet, and the caller then waits for 300 s. After a lost connection the library reconnects by
itself, for ever, and uploads its program anew each time; so a lost connection is final here, and its first cause is
raised again by every later call.
"""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import rtde_control

import timing

from ..errors import InstrumentError, NoReply, NotReady, Unreachable

T = TypeVar("T")
FLAGS = rtde_control.RTDEControlInterface.FLAG_UPLOAD_SCRIPT | rtde_control.RTDEControlInterface.FLAG_NO_EXT_FT
"""Send the library's program; leave out the external force input, which not every CB3 offers and nobody here uses."""
CONNECT_TIMEOUT = 15.0
"""s of host time; the library has time-outs of 2.5, 5 and 6 s of its own in there."""
RELEASED_WITHIN = 3.0
"""s of host time in which the controller may yet learn that the program before has ended, and free its RTDE inputs."""


@dataclass(frozen=True)
class Operation:
    """An asynchronous motion as the controller numbers it (0..127)."""

    number: int
    running: bool


class _Pending:
    """What comes of something that another thread does."""

    def __init__(self) -> None:
        self._come = timing.Event()
        self._value: Any = None
        self._error: Exception | None = None

    def set(self, value: Any) -> None:
        """It has succeeded."""
        self._value = value
        self._come.set()

    def fail(self, error: Exception) -> None:
        """It has failed."""
        self._error = error
        self._come.set()

    def result(self, within: float) -> Any:
        """Its value; raises what it raised, TimeoutError after `within` s of host time."""
        if not self._come.wait(within):
            raise TimeoutError
        if self._error is not None:
            raise self._error
        return self._value


@dataclass
class _Call:
    do: Callable[[Any], Any]
    done: _Pending


class ControlThread:
    """Owner of one connection; used once."""

    def __init__(self, name: str, host: str, timeout: float) -> None:
        """`timeout` bounds each call, s of host time."""
        self.name, self.host, self.timeout = name, host, timeout
        self._jobs: queue.Queue[_Call | None] = timing.Queue()
        self._ready = _Pending()
        self._broken: InstrumentError | None = None
        self._kick_interval: float | None = None
        self._thread = timing.Thread(target=self._run, name=f"{name} control", daemon=True)

    def start(self) -> None:
        """Connect and upload the program. Raises Unreachable, NotReady."""
        self._thread.start()
        try:
            self._ready.result(CONNECT_TIMEOUT)
        except TimeoutError as error:
            raise Unreachable(self.name, f"{self.host} did not grant control within {CONNECT_TIMEOUT:g} s") from error
        except RuntimeError as error:
            raise self._explained(str(error)) from error

    def _explained(self, reason: str) -> InstrumentError:
        if "remote control" in reason:
            return NotReady(self.name, "the pendant is in local mode; switch it to remote control")
        if _in_use(reason):
            return NotReady(
                self.name, "another program controls the arm (its RTDE inputs are taken); end it, or turn the fieldbus off"
            )
        return Unreachable(self.name, f"cannot take control of {self.host}: {reason}; see the log on the pendant")

    @property
    def alive(self) -> bool:
        """True while the library may still hold the connection."""
        return self._thread.is_alive()

    def call(self, do: Callable[[Any], T]) -> T:
        """Run `do(control object)` in the owner's thread. Raises NoReply after the time-out or a lost connection."""
        if self._broken is not None:
            raise self._broken
        job = _Call(do, _Pending())
        self._jobs.put(job)
        try:
            result: T = job.done.result(self.timeout)
        except TimeoutError as error:
            raise self.give_up(f"no answer within {self.timeout:g} s") from error
        except RuntimeError as error:  # so the library says that it could not connect anew
            raise self.give_up(str(error)) from error
        return result

    def give_up(self, why: str) -> InstrumentError:
        """Declare the connection lost and return the error; the kicks end, so that the watchdog stops the arm."""
        if self._broken is None:
            self._broken = NoReply(
                self.name,
                f"lost control of {self.host} ({why}); its watchdog stops the arm. Check the arm, then close and open it again",
            )
            self._jobs.put(None)
        return self._broken

    def watch(self, frequency: float) -> bool:
        """Turn the controller's watchdog on: it stops the program when kicks come less often than `frequency` (Hz)."""
        accepted = self.call(lambda control: control.setWatchdog(frequency))
        self._kick_interval = 1.0 / frequency / 5  # five kicks within the time after which the watchdog bites
        return bool(accepted)

    def operation(self) -> Operation:
        """The newest asynchronous motion."""

        def read(control: Any) -> Operation:
            status = control.getAsyncOperationProgressEx()
            return Operation(status.operationId(), status.isAsyncOperationRunning())

        return self.call(read)

    def finish(self, timeout: float) -> bool:
        """End the program and disconnect; False when that takes longer than `timeout` (s of host time)."""
        if self._broken is None:
            self._jobs.put(_Call(lambda control: control.stopScript(), _Pending()))
            self._jobs.put(None)
        self._thread.join(timeout)
        return not self._thread.is_alive()

    # -- the owner's thread
    def _run(self) -> None:
        """Connect, then do one call after another and kick the watchdog in between, until told to end."""
        try:
            control = self._connected()
        except RuntimeError as error:
            self._ready.fail(error)
            return
        self._ready.set(None)
        next_kick = 0.0
        while True:
            now = timing.now()
            try:
                if not control.isConnected():
                    self.give_up("connection lost")
                elif self._kick_interval is not None and self._broken is None and now >= next_kick:
                    control.kickWatchdog()
                    next_kick = now + self._kick_interval
            except RuntimeError as error:
                self.give_up(f"connection lost: {error}")
            try:
                job = self._jobs.get(timeout=self._kick_interval or 0.1)
            except queue.Empty:
                continue
            if job is None:
                break
            try:
                job.done.set(job.do(control))
            except Exception as error:  # the library's errors belong to the caller
                job.done.fail(error)
        control.disconnect()

    def _connected(self) -> Any:
        """A control object. Raises RuntimeError with the library's reason."""
        give_up = timing.now() + RELEASED_WITHIN
        while True:
            try:
                return rtde_control.RTDEControlInterface(self.host, -1.0, FLAGS)
            except RuntimeError as error:
                # a program that was found running had ended by itself before it could be stopped
                ended = "failed to execute: stop" in str(error).lower()
                if not (_in_use(str(error)) or ended) or timing.now() > give_up:
                    raise
            timing.sleep(0.1)


def _in_use(reason: str) -> bool:
    return "in use" in reason.lower()
