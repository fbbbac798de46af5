"""A streaming driver in a process of its own: a library that crashes on a damaged stream ends there, not the experiment.

Samples come back through a pipe and go on to the sink; `latest` judges their age here, where they are used. Run by
`python -m lab.rig.hosted_stream FD`.
"""

from __future__ import annotations

import contextlib
import queue
import subprocess
import threading
from multiprocessing.connection import Connection
from typing import Any

import timing
from drivers.configs import ArmConfig
from drivers.errors import BadReply, InstrumentError, NotReady, StaleReading, Unreachable
from drivers.interfaces import ArmSample, Identity, Sink
from timing import RigClock

from ..files.all_drivers import drivers
from ..guard.child import Child, begin_child, how_it_ended, start_served

OPEN_WITHIN, CLOSE_WITHIN = 20.0, 5.0
"""Host seconds. A sound controller sends its state within one or two, and a busy computer may take ten to start a process; the
library itself waits without end."""
LONGEST_BATCH = 50


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
        clock, config = self._clock, self.config
        setup = (self.name, config.driver, config.model_dump_json(), clock.speed, clock.start)
        self._process, self._line = start_served("lab.rig.hosted_stream", setup)
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
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(CLOSE_WITHIN)
            process.kill()
            process.wait()
        if receiver is not None:
            receiver.join(CLOSE_WITHIN)  # the process has ended, and with it the line: nobody reads what is closed now
        if line is not None:
            line.close()

    def latest(self) -> ArmSample:
        """The newest sample. Raises NotReady before `open`, StaleReading when it is older than `max_age` or the stream has ended,
        BadReply when it cannot be true."""
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
def serve(given: list[int]) -> int:
    """Serve a rig on the file descriptor that it gave, until it ends."""
    with Connection(given[0]) as line:
        _serve(line)
    return 0


def _serve(line: Connection) -> None:
    name, driver_name, config, speed, start = timing.receive(line)
    samples: queue.Queue[ArmSample] = timing.Queue()
    of = drivers()[driver_name]
    assert of.make_state is not None
    driver = of.make_state(name, of.config.model_validate_json(config), RigClock(speed, start), samples.put)
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
    """What the driver has against the numbers of its newest sample; its age is judged where it is used."""
    try:
        driver.latest()
    except BadReply as e:
        return e
    except InstrumentError:
        pass
    return None


if __name__ == "__main__":
    serve(begin_child())
