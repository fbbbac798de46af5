"""A driver in a process of its own, so that even a crash of its library affects nothing else.

The guard calls a driver through a socket, one call at a time with a time-out; a host that does not return is killed. The host
receives pings between the calls: when the guard dies or hangs it stops its instrument and, if the guard is gone, ends. A stream
(an arm's state) sends its samples through the pipe to the sink; `latest` judges their age here, where they are used. Started by
`python -m lab.guard.hosted FD`.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import timing
from drivers.configs import ArmConfig, InstrumentConfig
from drivers.errors import BadReply, InstrumentError, NoReply, NotReady, StaleReading, Unreachable
from drivers.interfaces import Arm, ArmDriver, ArmSample, Identity, Instrument, LengthUnit, Sink
from timing import RigClock

from ..files.rig_file import drivers
from .child import Child, begin_child, end_child, how_it_ended, start_child
from .commands import REMOTES, Command, R, moves
from .instruments import make

PING, PING_PERIOD = "ping", 0.1
SILENT_AFTER = 0.6
"""Host seconds without a word from the guard after which the instrument is stopped."""
CALL_WITHIN, OPEN_WITHIN, AGAIN_WITHIN = 5.0, 20.0, 6.0
"""Host seconds; longer than the longest of the driver's own time-outs. Connecting to a sound arm takes two or three, and a busy
computer may take ten to start a process; the library that reads an arm's state waits without end. The last of them are for
another attempt."""
LONGEST_BATCH = 50
"""Samples of a stream in one message."""
STOP_WITHIN = 1.5
"""Host seconds for a stop; after that the host is killed and the instrument's own watchdog stops it."""


class Hosted:
    """The guard's end."""

    def __init__(self, name: str, config: InstrumentConfig, clock: RigClock) -> None:
        self.name = name
        self._setup = _setup(name, config, clock)
        self._outside = _driver(self._setup)
        """Never opened: it checks the instrument from outside, without the library that may crash."""
        self._lock = timing.Lock()
        self._sending = timing.Lock()
        self._process: Child | None = None
        self._line: Connection | None = None
        self._lost = ""
        """Why the process was given up: every call reports it until the instrument is reopened."""
        self._connected = False

    def ask(self, command: Command[R]) -> R:
        """Have the driver do it, with a time-out after which the host is killed."""
        if command.method is Instrument.open:
            return self._open(command)
        if command.method is ArmDriver.glance:
            return command.perform(self._outside)
        if command.method is Instrument.close:
            self._close()
            return None  # type: ignore[return-value]
        return self._ask(command, STOP_WITHIN if command.method in (LengthUnit.stop, Arm.stop) else CALL_WITHIN)

    def _open(self, command: Command[R]) -> R:
        """Connect the driver in a new process, tried twice where it hangs or crashes, and return the instrument's identity."""
        if self._connected:
            self._close()
        deadline = timing.now() + OPEN_WITHIN
        for kept_for_another in (AGAIN_WITHIN, 0.0):
            self._start()
            try:
                identity = self._ask(command, max(0.0, deadline - kept_for_another - timing.now()))
                break
            except NoReply as error:
                self._give_up(error.message)
                if not kept_for_another:
                    raise
        self._connected = True
        return identity

    def _close(self) -> None:
        """Disconnect and end the process."""
        with contextlib.suppress(InstrumentError):
            self._ask(Command(self.name, Instrument.close), CALL_WITHIN)
        self._connected = False
        self._end()

    # -- the process
    def _start(self) -> None:
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                return
            self._process, line = _started(self._setup)
            self._line, self._lost = line, ""
            timing.Thread(target=self._ping, args=(line,), name=f"ping-{self.name}", daemon=True).start()

    def _ask(self, command: Command[R], within: float) -> R:
        """Return the result of a command there; NoReply, and the process is killed, where none comes `within` host seconds."""
        if not self._lock.acquire(timeout=within):
            raise self._give_up(f"{command}: an earlier call has not returned; its process was killed")
        try:
            line = self._line
            if line is None:
                raise NotReady(self.name, self._lost or "not open; call open() first")
            try:
                with self._sending:
                    line.send(command)
                if not timing.readable([line], within):
                    raise self._give_up(
                        f"{command} did not return within {within:.0f} s; its process was killed and the controller's watchdog "
                        "stops the arm: check that it stands still, then open it again"
                    )
                ok, answer = line.recv()
            except (EOFError, OSError) as e:
                if isinstance(e, InstrumentError):
                    raise
                assert self._process is not None
                how = how_it_ended(self._process, 2.0)
                raise self._give_up(
                    f"its process ended with {how} during {command}; the controller's watchdog stops the arm: check that it "
                    "stands still, then open it again"
                ) from e
        finally:
            self._lock.release()
        if not ok:
            raise answer
        result: R = answer
        return result

    def _give_up(self, why: str) -> InstrumentError:
        """End the process, and report why from then on."""
        self._lost = self._lost or why
        self._end()
        return NoReply(self.name, self._lost)

    def _end(self) -> None:
        """Close the line, and wait for the process to end."""
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
        """Ping every PING_PERIOD while `line` is in use, except during a call, which proves that the guard is alive."""
        timing.sleep(PING_PERIOD)
        while self._line is line:
            if self._sending.acquire(blocking=False):
                try:
                    line.send(PING)
                except (OSError, ValueError):
                    pass
                finally:
                    self._sending.release()
            timing.sleep(PING_PERIOD)


def under_guard(name: str, config: Any, clock: RigClock) -> Any:
    """The driver of one instrument, not yet opened; in a process of its own where its library may crash or hang."""
    if drivers()[config.driver].own_process:
        return REMOTES[name](Hosted(name, config, clock), name, len(getattr(config, "chambers", ())))
    return make(name, config.driver, config, clock)


class HostedArmState:
    """ArmState, by way of a process of its own."""

    def __init__(self, name: str, config: ArmConfig, clock: RigClock, sink: Sink[ArmSample]) -> None:
        self.name, self.config = name, config
        self.lost = 0
        self._clock, self._sink = clock, sink
        self._process: Child | None = None
        self._line: Connection | None = None
        self._receiver: threading.Thread | None = None
        self._opened: queue.Queue[Identity | InstrumentError] = timing.Queue()
        self._newest: tuple[float, ArmSample] | None = None
        self._doubt: InstrumentError | None = None
        """What is wrong with the newest sample."""
        self._error: InstrumentError | None = None
        """Why the stream has ended."""

    def open(self) -> Identity:
        """Start the process and the stream. Raises what UR5State.open raises."""
        self.close()
        self._process, self._line = _started(_setup(self.name, self.config, self._clock), stream=True)
        self._opened = timing.Queue()
        self._newest = self._doubt = self._error = None
        self.lost = 0
        self._receiver = timing.Thread(
            target=self._receive, args=(self._line, self._process, self._opened), name=self.name, daemon=True
        )
        self._receiver.start()
        try:
            outcome = self._opened.get(timeout=OPEN_WITHIN)
        except queue.Empty:
            outcome = Unreachable(
                self.name,
                f"no state of the arm within {OPEN_WITHIN:g} s; " + timing.busy_or("check the network to its controller"),
            )
        if isinstance(outcome, InstrumentError):
            self.close()
            raise outcome
        return outcome

    def close(self) -> None:
        """End the stream and its process."""
        line, self._line = self._line, None
        process, self._process = self._process, None
        receiver, self._receiver = self._receiver, None
        if line is not None:
            with contextlib.suppress(OSError):
                line.send("close")
        if process is not None:
            end_child(process, CALL_WITHIN)
        if receiver is not None:
            receiver.join(CALL_WITHIN)  # the process has ended, and with it the line: nobody reads what is closed now
        if line is not None:
            line.close()

    def latest(self) -> ArmSample:
        """The newest sample. Raises NotReady before `open`, StaleReading beyond `max_age` or at the end, BadReply if untrue."""
        newest = self._newest
        if self._line is None or newest is None:
            raise NotReady(self.name, "not open; call open() first")
        if self._error is not None:
            raise self._error
        age = timing.now() - newest[0]
        if age > self.config.max_age:
            raise StaleReading(
                self.name,
                f"newest state is {age:.2f} s old, limit {self.config.max_age:g} s; "
                + timing.busy_or("check the cable to the arm's controller, and the controller"),
            )
        if self._doubt is not None:
            raise self._doubt
        return newest[1]

    def _receive(self, line: Connection, process: Child, opened: queue.Queue[Identity | InstrumentError]) -> None:
        """Thread of one stream: pass the outcome of opening to `opened`, then samples to the sink, until the process ends."""
        with contextlib.suppress(EOFError, OSError):
            while True:
                message = timing.receive(line)
                if isinstance(message, (Identity, InstrumentError)):
                    opened.put(message)
                    continue
                self.lost, arrived, samples, doubt = message
                for sample in samples:
                    self._sink(sample)
                self._newest, self._doubt = (arrived, samples[-1]), doubt
        if self._line is not line:
            return  # closed by us
        self._error = StaleReading(
            self.name,
            f"the process that reads the state ended with {how_it_ended(process)}: the stream was damaged or the "
            "controller disconnected; check the network to the arm, then open it again",
        )
        opened.put(self._error)


# ------------------------------------------------------------------ the process
Setup = tuple[str, str, str, float, float]
"""The first message to a host: name, driver, table of rig.yaml as JSON, and the clock's speed and start."""


def _setup(name: str, config: InstrumentConfig, clock: RigClock) -> Setup:
    return name, config.driver, config.model_dump_json(), clock.speed, clock.start


def _driver(setup: Setup, sink: Sink[ArmSample] | None = None) -> Any:
    """The driver that a host makes, not yet opened; with a sink the stream of an arm's state, whose samples go there."""
    name, driver, table, *clock = setup
    kind = drivers()[driver]
    config = kind.config.model_validate_json(table)
    if sink is None:
        return make(name, driver, config, RigClock(*clock))
    assert kind.make_state is not None
    return kind.make_state(name, config, RigClock(*clock), sink)


def _started(setup: Setup, stream: bool = False) -> tuple[Child, Connection]:
    """A host of a driver, or of the stream of an arm's state, and the line to it."""
    ours, theirs = Pipe()
    process = start_child("lab.guard.hosted", (theirs.fileno(),))
    theirs.close()
    ours.send((setup, stream))
    return process, ours


def serve(given: list[int]) -> int:
    """Serve on the file descriptor that was given until the other end is closed."""
    with Connection(given[0]) as line:
        setup, stream = timing.receive(line)
        (_send if stream else _serve)(line, setup)
    return 0


def _serve(line: Connection, setup: Setup) -> None:
    """Answer calls until the line is closed; stop the arm when it is silent for SILENT_AFTER host seconds, and at the end."""
    driver = _driver(setup)
    stopped = True  # since the last motion: a stop is sent once a silence
    with contextlib.suppress(EOFError, OSError):
        while True:
            if not timing.readable([line], SILENT_AFTER):
                if not stopped:
                    stopped = True
                    with contextlib.suppress(InstrumentError):
                        driver.stop()
                continue
            command = line.recv()
            if command == PING:
                continue
            stopped = stopped and not moves(command)
            line.send(_answer(driver, command))
    with contextlib.suppress(Exception):
        driver.stop()
    driver.close()


def _answer(driver: Any, command: Command[Any]) -> tuple[bool, Any]:
    try:
        return True, command.perform(driver)
    except InstrumentError as e:
        return False, e
    except Exception as e:  # noqa: BLE001 - what a library raises is handed to the guard as this instrument's failure
        return False, Unreachable(command.instrument, f"{command} failed: {type(e).__name__}: {e}; see the log on the instrument")


def _send(line: Connection, setup: Setup) -> None:
    """Send identity or error, then batches (samples lost, host time, samples, doubt about the newest), until told to end."""
    samples: queue.Queue[ArmSample] = timing.Queue()
    driver = _driver(setup, samples.put)
    try:
        line.send(driver.open())
    except InstrumentError as e:
        line.send(e)
        return
    with contextlib.suppress(EOFError, OSError):
        while not timing.readable([line], 0.0):
            batch: list[Any] = []
            with contextlib.suppress(queue.Empty):
                batch.append(samples.get(timeout=0.05))
                while len(batch) < LONGEST_BATCH:
                    batch.append(samples.get_nowait())
            if batch:
                line.send((driver.lost, timing.now(), batch, _doubt(driver)))
    driver.close()


def _doubt(driver: Any) -> InstrumentError | None:
    """The driver's objection to its newest sample; the sample's age is judged where it is used."""
    try:
        driver.latest()
    except BadReply as e:
        return e
    except InstrumentError:
        pass
    return None


if __name__ == "__main__":
    serve(begin_child())
