"""The protocol's heartbeat and urgent messages: fixed records on a pipe that nothing else uses.

A thread sends a beat every 0.1 s with the time since the experiment's last progress. A frozen process sends none; a hung
experiment shows in that time. A stop is one record too, so that a signal handler or a sensor's thread can send it
without waiting for anything: records are written whole and never mix.

The force sensor's thread sends one with each sample, and one when the load is too much. Before the sensor is zeroed the
tool's weight cannot be distinguished from a load, so the change since the stream began is checked, and the raw reading against
the sensor's range; afterwards the load beyond the zero, and the range.
"""

from __future__ import annotations

import contextlib
import math
import os
import struct
from collections.abc import Callable, Iterator
from statistics import median

import timing
from drivers.configs import ForceConfig
from drivers.interfaces import WrenchSample

from ..files.rig_file import Limits, RigFile

LONGEST_LOOK = 0.3
"""Longest host seconds between two calls of `look` that count in full."""


class Awake:
    """Time that this process was awake to see; advanced by `look`, from one thread, and read from any.

    A process that was stopped (SIGSTOP, a paused virtual machine, a computer without a free core) finds a silence when it
    wakes that says nothing about its partner: it was itself away. Silence is therefore measured on a clock that advances with
    each look, and by no more than a look may take.
    """

    def __init__(self, host: Callable[[], float] = timing.now) -> None:
        """`host`: the host's time, s."""
        self._host = host
        self._now = 0.0
        self._looked = host()

    def look(self) -> float:
        """The process is awake; returns the time awake, s."""
        now = self._host()
        self._now += min(LONGEST_LOOK, now - self._looked)
        self._looked = now
        return self._now

    @property
    def now(self) -> float:
        """Seconds awake, as of the last look."""
        return self._now


RECORD = struct.Struct("<cd")
BEAT, SIGNAL, FORCE, MOMENT = b"B", b"S", b"F", b"M"
"""Kinds: age of the last step (s), signal number, force (N) or moment (N m) beyond the limit."""
FORCE_RANGE, MOMENT_RANGE, FRESH = b"f", b"m", b"W"
"""More kinds: raw force (N) or moment (N m) beyond the sensor's range; a sample of it has come (host time, s)."""
PERIOD = 0.1


class Pulse:
    """The sending end; owns the pipe."""

    def __init__(self, pipe: int) -> None:
        os.set_blocking(pipe, False)
        self._pipe = pipe
        self.awake = Awake()
        """Clock that runs only while this process is awake; silences and long steps are measured on it."""
        self._last_step = self.awake.now
        """Time of the experiment's last progress, s of `awake`."""
        self._waits = 0
        """Depth of nested `waiting_for_person`."""
        self._ended = timing.Event()
        self._thread = timing.Thread(target=self._beat, name="pulse", daemon=True)
        self._thread.start()

    def mark(self) -> None:
        """The experiment has made progress."""
        self._last_step = self.awake.now

    @property
    def waiting(self) -> bool:
        """True while the protocol waits for a person."""
        return self._waits > 0

    @contextlib.contextmanager
    def waiting_for_person(self) -> Iterator[None]:
        """While this is entered the guard does not count the time as a hang."""
        self._waits += 1
        try:
            yield
        finally:
            self._waits -= 1
            self.mark()

    def send(self, kind: bytes, value: float) -> None:
        """Send one record now; never waits, never raises. If the pipe breaks or falls silent the guard lands the rig anyway."""
        with contextlib.suppress(OSError):
            os.write(self._pipe, RECORD.pack(kind, value))

    def close(self) -> None:
        """End; the guard treats it as the program's death unless it was told to end before."""
        self._ended.set()
        self._thread.join(1.0)
        os.close(self._pipe)

    def _beat(self) -> None:
        while not self._ended.wait(PERIOD):
            now = self.awake.look()
            self.send(BEAT, 0.0 if self._waits else now - self._last_step)


class Listener:
    """The receiving end, in the guard."""

    def __init__(self, pipe: int) -> None:
        os.set_blocking(pipe, False)
        self.pipe = pipe
        self.gone = False
        """True once the other end is closed: the program has ended."""
        self._rest = b""

    def close(self) -> None:
        """Hear no more."""
        os.close(self.pipe)

    def take(self) -> list[tuple[bytes, float]]:
        """All whole records since the last call: kind (see BEAT ..) and value. Never waits; notes when the sender is `gone`."""
        try:
            data = os.read(self.pipe, 65536)
        except BlockingIOError:  # nothing has come
            return []
        except OSError:
            data = b""
        if not data:  # the other end is closed
            self.gone = True
            return []
        self._rest += data
        whole = len(self._rest) // RECORD.size * RECORD.size
        records, self._rest = list(RECORD.iter_unpack(self._rest[:whole])), self._rest[whole:]
        return records


NO_ZERO = (0.0,) * 6
AGREE = 2
"""Samples in a row that must be beyond the limit: one may be a knock."""
UNLOADED = 5
"""Samples at the stream's beginning whose median is the unloaded tool; fewer until they have come."""


class ForceLimit:
    """Judges each sample where it arrives; the guard stops the arm and lands."""

    def __init__(self, limits: Limits, sensor: ForceConfig, pulse: Pulse) -> None:
        self._limits, self._sensor, self._pulse = limits, sensor, pulse
        self._over = 0
        self._first: list[tuple[float, ...]] = []

    def begin(self) -> None:
        """A new stream begins: its first samples are the tool's weight."""
        self._over = 0
        self._first = []

    def judge(self, sample: WrenchSample) -> None:
        """Take one sample."""
        self._pulse.send(FRESH, timing.now())
        found = self._beyond(sample)
        self._over = self._over + 1 if found else 0
        if found and self._over >= AGREE:  # as long as it lasts: what the guard lets pass at rest must not move later
            self._pulse.send(*found)

    def _beyond(self, sample: WrenchSample) -> tuple[bytes, float] | None:
        """Kind of record, and the force or moment (N or N m) beyond its limit: of raw readings, or of the load; else None."""
        force, moment = (max(map(abs, half)) for half in (sample.raw[:3], sample.raw[3:]))
        if force > self._sensor.max_force:
            return FORCE_RANGE, force
        if moment > self._sensor.max_moment:
            return MOMENT_RANGE, moment
        if len(self._first) < UNLOADED:
            self._first.append(sample.raw)
        unloaded = [median(axis) for axis in zip(*self._first, strict=True)]
        load = sample.wrench if sample.zero != NO_ZERO else [a - b for a, b in zip(sample.raw, unloaded, strict=True)]
        force, moment = math.hypot(*load[:3]), math.hypot(*load[3:])
        if force > self._limits.max_force:
            return FORCE, force
        return (MOMENT, moment) if moment > self._limits.max_moment else None


def overload(kind: bytes, value: float, rig: RigFile) -> str:
    """Text of a record about the load (N or N m); empty for other records."""
    sensor, limits = rig.instruments.force, rig.limits
    if kind == FORCE:
        return f"force {value:.1f} N, limits.max_force is {limits.max_force:g} N"
    if kind == MOMENT:
        return f"moment {value:.2f} N m, limits.max_moment is {limits.max_moment:g} N m"
    if kind == FORCE_RANGE and sensor is not None:
        return f"raw force {value:.1f} N, the sensor's range (max_force) is {sensor.max_force:g} N"
    if kind == MOMENT_RANGE and sensor is not None:
        return f"raw moment {value:.2f} N m, the sensor's range (max_moment) is {sensor.max_moment:g} N m"
    return ""
