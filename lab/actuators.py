"""The actuator process: regulators, length unit, valve, gauge and arm motion live behind one process boundary.

The parent sends one command at a time through a pipe and gets one answer. Readings polled in the child come back
through a second pipe. When the parent is gone the child lands the rig safe and ends; when the child is gone every call
raises ActuatorsLost.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing as mp
import signal
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

from drivers import alicat, dynamixel, numato, pfeiffer, smc_itv, tmcl, ur5
from drivers.errors import InstrumentError
from drivers.interfaces import (
    GaugeSample,
    Identity,
    PressureSample,
    SpineSample,
    ValveSample,
)

from .clock import RigClock
from .rig_file import RigFile

log = logging.getLogger(__name__)

COMMANDS: dict[str, tuple[str, ...]] = {
    "pressure": ("set", "read", "vent"),
    "spine": ("home", "move_to", "stop", "read"),
    "valve": ("set", "read"),
    "gauge": ("read",),
    "arm": ("move_to", "moving", "stop"),
}
"""What may be asked of each instrument."""
POLLED = ("pressure", "spine", "valve", "gauge")
ANSWER_WITHIN = 15.0
"""Host seconds after which a silent child is taken for dead; longer than any driver's own time-outs together."""
DRIVERS: dict[str, Any] = {
    "alicat": alicat.Alicat, "smc_itv": smc_itv.SmcItv, "dynamixel": dynamixel.DynamixelSpine, "tmcl": tmcl.TmclSpine,
    "numato": numato.NumatoValve, "pfeiffer": pfeiffer.PfeifferGauge, "ur5": ur5.UR5,
}  # fmt: skip


class ActuatorsLost(RuntimeError):
    """The actuator process is gone or does not answer; the rig must be made safe by hand (vent valve, emergency stop)."""


@dataclass(frozen=True)
class SafeStep:
    """One instrument brought into the safe state: confirmed by reading back, or what went wrong."""

    instrument: str
    confirmed: bool
    text: str


@dataclass(frozen=True)
class SafeReport:
    """What was reached; `confirmed` only when every instrument was read back safe."""

    steps: tuple[SafeStep, ...] = field(default_factory=tuple)

    @property
    def confirmed(self) -> bool:
        """True when every instrument is confirmed safe."""
        return all(s.confirmed for s in self.steps)


# ------------------------------------------------------------------ the child
class _Child:
    """Owns the actuator drivers; runs in the child process only."""

    def __init__(self, rig: RigFile, clock: RigClock) -> None:
        self.rig, self.clock = rig, clock
        self.drivers: dict[str, Any] = {}
        for name in COMMANDS:
            config = getattr(rig.instruments, name)
            if config is not None:
                self.drivers[name] = DRIVERS[config.driver](name, config, clock)
        self.opened: list[str] = []
        self.locks = {name: threading.Lock() for name in self.drivers}
        self.sending = threading.Lock()
        self.running = True

    def open(self, name: str) -> Identity:
        identity: Identity = self.drivers[name].open()
        self.opened.append(name)
        return identity

    def call(self, name: str, method: str, args: tuple[Any, ...]) -> Any:
        if name not in self.drivers or method not in COMMANDS[name]:
            raise ValueError(f"{name}.{method} is not a command of this rig")
        with self.locks[name]:
            return getattr(self.drivers[name], method)(*args)

    def poll(self, name: str, samples: Connection) -> None:
        """Read one instrument at the rig's rate; a reading that fails is passed on as its error."""
        while self.running:
            due = time.monotonic() + 1 / self.rig.poll
            if name in self.opened:
                try:
                    sample = self.call(name, "read", ())
                except InstrumentError as e:
                    sample = e
                try:
                    with self.sending:
                        samples.send((name, sample))
                except OSError:
                    return
            time.sleep(max(0.0, due - time.monotonic()))

    def safe(self) -> SafeReport:
        """Stop, vent, release, each whatever happens to the others, and read back."""
        first: list[tuple[str, Callable[[], Any]]] = []
        if "arm" in self.opened:
            first.append(("arm", self.drivers["arm"].stop))
        if "pressure" in self.opened:
            first.append(("pressure", self.drivers["pressure"].vent))
        if "spine" in self.opened:
            first.append(("spine", self.drivers["spine"].stop))
        if "valve" in self.opened and not self.rig.safe.keep_vacuum:
            first.append(("valve", lambda: self.drivers["valve"].set(False)))
        failed: dict[str, str] = {}
        for name, action in first:
            try:
                action()
            except Exception as e:  # noqa: BLE001 - whatever one driver does must not keep the others from stopping
                failed[name] = str(e)
        return SafeReport(tuple(self._confirm(name, failed.get(name)) for name, _ in first))

    def _confirm(self, name: str, failure: str | None) -> SafeStep:
        if failure is not None:
            return SafeStep(name, False, f"did not take the stop: {failure}")
        deadline = self.clock.now() + self.rig.safe.within
        text = "no reading"
        while True:
            try:
                ok, text = self._is_safe(name)
            except Exception as e:  # noqa: BLE001
                ok, text = False, str(e)
            if ok or self.clock.now() > deadline:
                return SafeStep(name, ok, text)
            time.sleep(0.02)

    def _is_safe(self, name: str) -> tuple[bool, str]:
        driver = self.drivers[name]
        if name == "pressure":
            highest = max(driver.read().measured)
            return highest < self.rig.safe.vented_below, f"highest pressure {highest / 1e3:.1f} kPa"
        if name == "spine":
            sample = driver.read()
            return not sample.moving, f"length {sample.length * 1e3:.1f} mm, {'moving' if sample.moving else 'at rest'}"
        if name == "valve":
            on = driver.read().on
            return not on, f"vacuum {'on' if on else 'off'}"
        moving = driver.moving()
        return not moving, "moving" if moving else "at rest"

    def close_one(self, name: str) -> None:
        with self.locks[name]:
            self.opened = [n for n in self.opened if n != name]
            self.drivers[name].close()

    def close(self) -> None:
        self.running = False
        for name in reversed(self.opened):
            with contextlib.suppress(Exception):
                self.drivers[name].close()


def _serve(rig_json: str, start: float, commands: Connection, samples: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    rig = RigFile.model_validate_json(rig_json)
    child = _Child(rig, RigClock(rig.clock.speed, start))
    for name in POLLED:
        threading.Thread(target=child.poll, args=(name, samples), name=f"poll-{name}", daemon=True).start()
    try:
        while True:
            name, method, args = commands.recv()
            if method == "end":
                break
            try:
                answer: Any
                if method == "open":
                    answer = child.open(name)
                elif method == "close":
                    child.close_one(name)
                    answer = None
                elif method == "safe":
                    answer = child.safe()
                else:
                    answer = child.call(name, method, args)
                commands.send((True, answer))
            except Exception as e:  # noqa: BLE001 - every failure is handed to the caller, typed where the type can travel
                commands.send(
                    (False, e if isinstance(e, InstrumentError) else RuntimeError(f"{type(e).__name__}: {e}"))
                )
    except (EOFError, OSError):
        child.safe()
    finally:
        child.close()
        with contextlib.suppress(OSError):
            commands.send((True, None))


# ------------------------------------------------------------------ the parent
class Actuators:
    """The parent's end of the actuator process.

    `on_sample(name, sample)` is called from a thread of its own with every polled reading, or with the InstrumentError
    that took its place.
    """

    def __init__(self, rig: RigFile, clock: RigClock, on_sample: Callable[[str, Any], None]) -> None:
        context = mp.get_context("spawn")
        self._commands, theirs = context.Pipe()
        self._samples, their_samples = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_serve,
            args=(rig.model_dump_json(), clock.start, theirs, their_samples),
            name="actuators",
            daemon=True,
        )
        self._process.start()
        theirs.close()
        their_samples.close()
        self._lock = threading.Lock()
        self._on_sample = on_sample
        self._reader = threading.Thread(target=self._forward, name="actuator-samples", daemon=True)
        self._reader.start()

    def _forward(self) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                name, sample = self._samples.recv()
                self._on_sample(name, sample)

    def call(self, name: str, method: str, *args: Any) -> Any:
        """Send one command and wait for its answer; raises what the driver raised, or ActuatorsLost."""
        with self._lock:
            try:
                self._commands.send((name, method, args))
                if not self._commands.poll(ANSWER_WITHIN):
                    raise ActuatorsLost(
                        f"no answer to {name}.{method} within {ANSWER_WITHIN:g} s; vent and stop by hand"
                    )
                ok, answer = self._commands.recv()
            except (EOFError, OSError) as e:
                raise ActuatorsLost(f"the actuator process ended during {name}.{method}; vent and stop by hand") from e
        if ok:
            return answer
        raise answer

    def open(self, name: str) -> Identity:
        """Connect one instrument."""
        identity: Identity = self.call(name, "open")
        return identity

    def safe(self) -> SafeReport:
        """Bring all actuators into the safe state and read it back."""
        report: SafeReport = self.call("", "safe")
        return report

    def close(self) -> None:
        """Land safe and end the process; kills it when it does not end by itself."""
        with contextlib.suppress(ActuatorsLost):
            if self._process.is_alive():
                self.call("", "end")
        self._process.join(ANSWER_WITHIN)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(2.0)
        self._commands.close()


class Remote:
    """One instrument behind the process boundary."""

    name = ""

    def __init__(self, actuators: Actuators) -> None:
        self._actuators = actuators

    def _call(self, method: str, *args: Any) -> Any:
        return self._actuators.call(self.name, method, *args)

    def open(self) -> Identity:
        """Connect."""
        return self._actuators.open(self.name)

    def close(self) -> None:
        """Land safe and disconnect."""
        self._call("close")


class Pressure(Remote):
    """PressureRegulators, by way of the actuator process."""

    name = "pressure"

    def __init__(self, actuators: Actuators, channels: int) -> None:
        super().__init__(actuators)
        self.channels = channels

    def set(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """See PressureRegulators.set."""
        answer: tuple[float, ...] = self._call("set", tuple(pressures))
        return answer

    def read(self) -> PressureSample:
        """See PressureRegulators.read."""
        answer: PressureSample = self._call("read")
        return answer

    def vent(self) -> None:
        """See PressureRegulators.vent."""
        self._call("vent")


class Spine(Remote):
    """LengthUnit, by way of the actuator process."""

    name = "spine"

    def home(self) -> None:
        """See LengthUnit.home."""
        self._call("home")

    def move_to(self, length: float, speed: float) -> float:
        """See LengthUnit.move_to."""
        answer: float = self._call("move_to", length, speed)
        return answer

    def stop(self) -> None:
        """See LengthUnit.stop."""
        self._call("stop")

    def read(self) -> SpineSample:
        """See LengthUnit.read."""
        answer: SpineSample = self._call("read")
        return answer


class Valve(Remote):
    """JammingValve, by way of the actuator process."""

    name = "valve"

    def set(self, on: bool) -> bool:
        """See JammingValve.set."""
        answer: bool = self._call("set", on)
        return answer

    def read(self) -> ValveSample:
        """See JammingValve.read."""
        answer: ValveSample = self._call("read")
        return answer


class Gauge(Remote):
    """VacuumGauge, by way of the actuator process."""

    name = "gauge"

    def read(self) -> GaugeSample:
        """See VacuumGauge.read."""
        answer: GaugeSample = self._call("read")
        return answer


class ArmMotion(Remote):
    """Arm, by way of the actuator process."""

    name = "arm"

    def move_to(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        """See Arm.move_to."""
        self._call("move_to", tuple(pose), speed, acceleration)

    def moving(self) -> bool:
        """See Arm.moving."""
        answer: bool = self._call("moving")
        return answer

    def stop(self) -> None:
        """See Arm.stop."""
        self._call("stop")
