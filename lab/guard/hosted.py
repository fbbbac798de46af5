"""A driver in a process of its own, under the guard: what its library does there, up to a crash, hurts nobody else.

The guard asks through a socket, one call at a time, each bounded; a host that does not come back is killed. The host
hears a ping between the calls: when the guard dies or stands still it stops its instrument and, if the guard is gone,
ends. Run by `python -m lab.guard.hosted FD`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import timing
from drivers.errors import InstrumentError, NoReply, NotReady, Unreachable
from timing import RigClock

from ..files.all_drivers import drivers
from .child import Child, begin_child, end_child, how_it_ended, start_served
from .instruments import make

PING_PERIOD = 0.1
SILENT_AFTER = 0.6
"""Host seconds without a word from the guard after which the instrument is stopped."""
CALL_WITHIN, OPEN_WITHIN = 5.0, 20.0
"""Host seconds; longer than the longest of the driver's own time-outs. Connecting to a sound arm takes two or three."""
OPEN_ATTEMPTS = 2
STOP_WITHIN = 1.5
"""Host seconds for a stop; after that the host is killed and the instrument's own watchdog stops it."""


class Hosted:
    """The guard's end; has the methods of its driver."""

    def __init__(self, name: str, driver: str, config: Any, clock: RigClock) -> None:
        self.name = name
        own = config.model_dump_json()
        self._setup = (name, driver, own, clock.speed, clock.start)
        self._outside = make(name, driver, drivers()[driver].config.model_validate_json(own), clock)
        """Never opened: it looks at the instrument from outside, without the library that may crash."""
        self._lock = timing.Lock()
        self._sending = timing.Lock()
        self._process: Child | None = None
        self._line: Connection | None = None
        self._lost = ""
        """Why the process was given up: every call says it until it is opened anew, whoever heard of it first."""
        self._connected = False

    def open(self) -> Any:
        """Start the process if there is none, connect the driver there, and return the instrument's identity. A driver that is
        connected is closed first, and gets a new process.

        A driver that hangs, crashes or does not answer is tried once more in a new process: connecting moves nothing.
        """
        if self._connected:
            self.close()
        for attempt in range(OPEN_ATTEMPTS):
            self._start()
            try:
                identity = self._ask("open", (), OPEN_WITHIN)
                break
            except NoReply as error:
                self._give_up(error.message)
                if attempt + 1 == OPEN_ATTEMPTS:
                    raise
        self._connected = True
        return identity

    def __getattr__(self, method: str) -> Callable[..., Any]:
        """What the driver can be asked, each call bounded; `stop` kills a host that does not come back."""
        if method.startswith("_") or not hasattr(self._outside, method):
            raise AttributeError(f"{self.name} has no {method}")
        within = STOP_WITHIN if method == "stop" else CALL_WITHIN
        return lambda *args: self._ask(method, args, within)

    def glance(self) -> bool:
        """See ArmDriver.glance; without the process."""
        return bool(self._outside.glance())

    def close(self) -> None:
        """Disconnect and end the process."""
        with contextlib.suppress(InstrumentError):
            self._ask("close", (), CALL_WITHIN)
        self._connected = False
        self._end()

    # -- the process
    def _start(self) -> None:
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                return
            self._process, line = start_served("lab.guard.hosted", self._setup)
            self._line, self._lost = line, ""
            timing.Thread(target=self._ping, args=(line,), name=f"ping-{self.name}", daemon=True).start()

    def _ask(self, method: str, args: tuple[Any, ...], within: float) -> Any:
        """Call a method in the driver's process; one that does not return `within` host seconds, or still waits for an earlier
        call, costs the process its life. Raises what the method raises, NotReady and NoReply."""
        if not self._lock.acquire(timeout=within):
            raise self._give_up(f"{method}: an earlier call has not returned; its process was killed")
        try:
            line = self._line
            if line is None:
                raise NotReady(self.name, self._lost or "not open; call open() first")
            try:
                with self._sending:
                    line.send((method, args))
                if not timing.readable([line], within):
                    raise self._give_up(
                        f"{method} did not return within {within:g} s; its process was killed and the controller's watchdog "
                        "stops the arm: check that it stands still, then open it again"
                    )
                ok, answer = line.recv()
            except (EOFError, OSError) as e:
                if isinstance(e, InstrumentError):
                    raise
                raise self._died(method) from e
        finally:
            self._lock.release()
        if ok:
            return answer
        raise answer

    def _died(self, method: str) -> InstrumentError:
        assert self._process is not None
        how = how_it_ended(self._process, 2.0)
        return self._give_up(
            f"its process ended with {how} during {method}; the controller's watchdog stops the arm: check that it stands "
            "still, then open it again"
        )

    def _give_up(self, why: str) -> InstrumentError:
        """End the process, and say why from now on."""
        self._lost = self._lost or why
        self._end()
        return NoReply(self.name, self._lost)

    def _end(self) -> None:
        """Close the line, and see that the process ends."""
        line, self._line = self._line, None
        if line is not None:
            line.close()
        process = self._process
        if process is None or process.poll() is not None:
            return
        if line is None:
            process.kill()
        end_child(process, 0.1)

    def _ping(self, line: Connection) -> None:
        """Send a ping every PING_PERIOD while `line` is the one to the process, except while a call is being sent, which shows by
        itself that the guard lives."""
        timing.sleep(PING_PERIOD)
        while self._line is line:
            if self._sending.acquire(blocking=False):
                try:
                    line.send(("ping", ()))
                except (OSError, ValueError):
                    pass
                finally:
                    self._sending.release()
            timing.sleep(PING_PERIOD)


def under_guard(name: str, config: Any, clock: RigClock) -> Any:
    """The driver of one instrument, not yet opened; in a process of its own where its library may crash or hang."""
    if drivers()[config.driver].own_process:
        return Hosted(name, config.driver, config, clock)
    return make(name, config.driver, config, clock)


# ------------------------------------------------------------------ the process
def serve(given: list[int]) -> int:
    """Serve a guard on the file descriptor that it gave, until it ends."""
    with Connection(given[0]) as line:
        _serve(line)
    return 0


def _serve(line: Connection) -> None:
    """Answer calls until the line is closed; stop the arm when it is silent for SILENT_AFTER host seconds, and at the end."""
    name, driver_name, config, speed, start = timing.receive(line)
    driver = make(name, driver_name, drivers()[driver_name].config.model_validate_json(config), RigClock(speed, start))
    stopped = True
    with contextlib.suppress(EOFError, OSError):
        while True:
            if not timing.readable([line], SILENT_AFTER):
                if not stopped:
                    stopped = True
                    with contextlib.suppress(InstrumentError):
                        driver.stop()
                continue
            method, args = line.recv()
            if method == "ping":
                continue
            stopped = stopped and method != "move_to"
            line.send(_answer(driver, name, method, args))
    with contextlib.suppress(Exception):
        driver.stop()
    driver.close()


def _answer(driver: Any, name: str, method: str, args: tuple[Any, ...]) -> tuple[bool, Any]:
    try:
        return True, getattr(driver, method)(*args)
    except InstrumentError as e:
        return False, e
    except Exception as e:  # noqa: BLE001 - what a library raises is handed to the guard as this instrument's failure
        return False, Unreachable(name, f"{method} failed: {type(e).__name__}: {e}; see the log on the instrument")


if __name__ == "__main__":
    serve(begin_child())
