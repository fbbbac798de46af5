"""Vital signs: what must hold at every moment of an experiment, looked at whenever it waits.

A reading that is too old, damaged or out of range ends the experiment with the error of its instrument. Some things a
person can put right while the experiment waits: the tip hidden from the cameras, a low supply, an open cell. Those are
raised as Suspended.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import timing
from drivers.errors import BadReply, DeviceFault, InstrumentError, StaleReading
from drivers.interfaces import ArmSample, BodySample, SafetyBit, WrenchSample
from protocols.errors import StoodStill, Suspended
from timing import RigClock

from ..files.rig_file import Limits
from ..guard.instruments import POLLED
from ..guard.messages import Event, RigLanded
from .actuators import Actuators
from .repeats import Repeats

GRACE = 0.5
"""Host seconds for which a stream may be late, less those for which it was not: a loaded computer must not end a run."""
OWN_SLEEP, CATCH_UP = 0.5, 0.2
"""Host seconds that this program may have stood still between two looks; time to make up for more."""
STANDSTILL = 5.0
"""Host seconds that this program stood still after which the state that it reads is read anew: it has not seen its history."""
STUCK = 1.0
"""Host seconds for which all values of a force sensor, of a tracked body or of a noisy gauge may stay the same to the last
digit."""
HELD = (
    SafetyBit.PROTECTIVE_STOP
    | SafetyBit.SAFEGUARD_STOP
    | SafetyBit.SYSTEM_EMERGENCY_STOP
    | SafetyBit.ROBOT_EMERGENCY_STOP
    | SafetyBit.EMERGENCY_STOP
)
"""Of an arm that stands by a protective, safeguard or emergency stop until a person sets it free."""
SLICE = 0.02
"""Longest host seconds between two looks while the experiment sleeps."""


@dataclass
class Vital:
    """What is known of the rig's health; written by the threads that receive it, read by the watch."""

    heard: dict[str, float] = field(default_factory=dict)
    """Host time of the newest good reading of each polled instrument."""
    errors: dict[str, InstrumentError] = field(default_factory=dict)
    """The error that took the place of the newest reading."""
    repeats: Repeats = field(default_factory=Repeats)
    """Of the gauge's readings."""
    landed: Event | None = None
    pause: Event | None = None


@dataclass
class Shown:
    """What a stream showed: its values, the stamp of the newest sample that had them, and when that was looked at."""

    values: tuple[float, ...]
    t: float
    at: float
    took: float = 0.0
    """Host seconds over which samples have come with these values."""


class Watch:
    """Looks at the instruments that the experiment needs: polled ones by the age of their newest reading in `vital`, `streams`
    (name -> driver) by their newest sample. `stop_now` is True once a person wants everything to stop at once."""

    def __init__(
        self,
        actuators: Actuators,
        vital: Vital,
        streams: Mapping[str, Any],
        limits: Limits,
        stop_now: Callable[[], bool],
    ) -> None:
        self._actuators, self._vital, self._streams, self._limits = actuators, vital, streams, limits
        self._stop_now = stop_now
        self._needed: tuple[str, ...] = ()
        """Names of the instruments that are watched."""
        self._hidden_since = math.inf
        """Host time since which the cameras have not seen the tip; inf while they see it."""
        self._late: dict[str, tuple[float, float]] = {}
        """Of each stream, host seconds for which it was late, less those for which it was not; host time of that count."""
        self._excused: dict[str, float] = {}
        """Of each polled instrument, host time at which the first command since its newest reading ended: it cannot be read while
        it works. Later commands excuse nothing, or an instrument that takes commands would never have to be read."""
        self._values: dict[str, Shown] = {}
        """What each stream showed last."""
        self._began = timing.now()
        """Host time from which silences count."""
        self._looked = self._began, actuators.pulse.awake.now
        """Host time, and seconds awake, at the last look."""
        self.stood = 0.0
        """Host seconds for which this program has stood still until now."""
        self._repeatable = False
        """Whether what is being done can be begun again."""
        self._standstill: StoodStill | None = None
        """Raised by the next look: a standstill that makes it necessary to begin again."""

    def over(self, needed: Sequence[str]) -> None:
        """Watch these instruments, instead of those before."""
        self._needed = (*needed, "arm_state") if "arm" in needed else tuple(needed)
        self.forget()

    def forget(self) -> None:
        """Count silences, lateness and repeated values from now on."""
        self._excuse()
        self._values.clear()
        self._vital.repeats.forget()
        self._vital.pause = None
        self._began = timing.now()

    def look(self, strict: bool = False, resting: bool = False) -> None:
        """Raises what is wrong: KeyboardInterrupt, ActuatorsLost, RigLanded, Suspended or an InstrumentError.

        `strict` does not forgive a hidden body, not even for a moment; in a pause (`resting`) what a person can put right
        may be wrong.
        """
        if self._stop_now():
            raise KeyboardInterrupt
        if (stood := self._stood_still()) > OWN_SLEEP:
            self.stood += stood
            if stood > STANDSTILL and self._repeatable:
                self._standstill = StoodStill(StaleReading("computer", f"stood still for {stood:.0f} s; the state is read anew"))
            timing.sleep(CATCH_UP)  # let the threads of this program read what has come meanwhile
            self._excuse()
            self._began = timing.now()
        self._looked = timing.now(), self._actuators.pulse.awake.now
        self._actuators.look()
        vital = self._vital
        if vital.landed is not None:
            raise vital.landed.error or RigLanded(f"the guard has made the rig safe: {vital.landed.text}")
        if vital.pause is not None and vital.pause.error is not None and not resting:
            raise Suspended(vital.pause.error)
        if self._standstill is not None and not resting:
            raise self._standstill
        now = timing.now()
        for name in self._needed:
            try:
                if name in POLLED:
                    self._polled(name, now)
                elif name in self._streams:
                    self._stream(name, now, strict)
            except Suspended:
                if not resting:
                    raise

    @contextlib.contextmanager
    def repeatable(self) -> Iterator[None]:
        """What is done in the block can be begun again: a standstill in it raises StoodStill."""
        self._repeatable, self._standstill = True, None
        try:
            yield
        finally:
            self._repeatable, self._standstill = False, None

    def _stood_still(self) -> float:
        """Host seconds since the last look for which this program was not awake; a command that takes long is no sleep."""
        looked, awake = self._looked
        return (timing.now() - looked) - (self._actuators.pulse.awake.now - awake)

    def recoverable(self, error: InstrumentError) -> bool:
        """Whether a person can put right what an instrument complains of: an arm that its own safety system holds, a
        pressure that is not held."""
        if error.instrument == "pressure":
            return self._vital.pause is not None
        state = self._streams.get("arm_state")
        if error.instrument != "arm" or state is None:
            return False
        timing.sleep(CATCH_UP)  # the state comes over a connection of its own
        try:
            return bool(state.latest().safety_bits & HELD)
        except InstrumentError:
            return False

    def _polled(self, name: str, now: float) -> None:
        """Raise what is wrong with a polled instrument: its fault, a gauge that repeats itself, no reading for `max_age`."""
        error = self._vital.errors.get(name)
        if isinstance(error, DeviceFault):
            raise error
        if name == "gauge" and (stuck := self._vital.repeats.stuck) > STUCK:
            raise StaleReading(
                name, f"its reading has been the same to the last digit for {stuck:.1f} s, though it scattered before; "
                "restart the gauge"
            )  # fmt: skip
        heard = self._vital.heard.get(name, 0.0)
        if self._excused.get(name, 0.0) <= heard:
            self._excused[name] = self._actuators.last_command.get(name, 0.0)
        age = now - max(self._began, heard, self._excused[name])
        if age > self._limits.max_age:
            raise error or StaleReading(
                name,
                f"no reading for {age:.1f} s, limits.max_age is {self._limits.max_age:g} s; " + timing.busy_or("check its cable"),
            )

    def _stream(self, name: str, now: float, strict: bool) -> None:
        """Raise what is wrong with a stream: Suspended for a tip hidden longer than `max_hidden` (`strict`: at all) and an open
        cell, StaleReading or BadReply once lateness exceeds GRACE, DeviceFault at once."""
        try:
            sample = self._streams[name].latest()
        except (StaleReading, DeviceFault, BadReply) as e:
            if name == "mocap":
                self._hidden_since = min(self._hidden_since, now)
                if strict or now - self._hidden_since > self._limits.max_hidden:
                    raise Suspended(e) from e
            elif self._lateness(name, now, late=True) > GRACE or isinstance(e, DeviceFault):
                raise
        else:
            if name == "mocap":
                self._hidden_since = math.inf
            self._lateness(name, now, late=False)
            self._moves_on(name, sample, now)
            if isinstance(sample, ArmSample) and sample.safety_bits & SafetyBit.SAFEGUARD_STOP:  # somebody is in the cell
                raise Suspended(DeviceFault("arm", "safeguard stop: somebody has opened the cell; close it and reset it"))

    def _lateness(self, name: str, now: float, late: bool) -> float:
        """Host seconds for which a stream was late, less those for which it was not, never below 0. A stream that drips is late
        most of the time, though never for long."""
        before, at = self._late.get(name, (0.0, now))
        took = min(now - at, OWN_SLEEP)  # of a command that took long nothing is known but its end
        count = before + took if late else max(0.0, before - took)
        self._late[name] = count, now
        return count

    def _excuse(self) -> None:
        """Forget lateness, commands and hiding that were counted up to here."""
        self._late.clear()
        self._excused.clear()
        self._hidden_since = math.inf

    def _moves_on(self, name: str, sample: Any, now: float) -> None:
        """Raises StaleReading when a noisy sensor repeats itself: samples come, but nothing is measured any more."""
        if not isinstance(sample, (WrenchSample, BodySample)):
            return
        values = sample.raw if isinstance(sample, WrenchSample) else (*sample.position, *sample.orientation)
        before = self._values.get(name)
        if before is None or values != before.values:
            self._values[name] = Shown(values, sample.t, now)
            return
        before.took += now - before.at if sample.t != before.t else 0.0  # one that is late repeats nothing
        before.t, before.at = sample.t, now
        if before.took > STUCK:
            stuck = StaleReading(name, f"every value has been the same for {before.took:.1f} s; restart the sensor")
            raise Suspended(stuck) if name == "mocap" else stuck


class WatchedClock:
    """The rig's clock as protocols get it: while they sleep, the pulse goes on and the vital signs are looked at."""

    def __init__(self, clock: RigClock, actuators: Actuators, watch: Watch) -> None:
        self._clock, self._actuators, self._watch = clock, actuators, watch

    def now(self) -> float:
        """Rig time, s."""
        return self._clock.now()

    def sleep(self, duration: float) -> None:
        """Wait `duration` seconds of rig time; raises what the watch finds."""
        end = timing.now() + max(0.0, duration) / self._clock.speed
        while True:
            self._actuators.pulse.mark()
            self._watch.look()
            left = end - timing.now()
            if left <= 0:
                return
            timing.sleep(min(SLICE, left))
