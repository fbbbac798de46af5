"""Vital signs: what must hold at every moment of an experiment, looked at whenever it waits; and the pause when it does not.

A reading that is too old, damaged or out of range ends the experiment with the error of its instrument. Some things a person can
put right while the experiment waits: the tip hidden from the cameras, a low supply, an open cell. Those are raised as Suspended.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import fmean, stdev
from typing import Any

import timing
from drivers.errors import BadReply, DeviceFault, InstrumentError, StaleReading
from drivers.interfaces import ArmSample, BodySample, SafetyBit, WrenchSample
from protocols.bench import Operator, Setup
from protocols.errors import StoodStill, Stopped, Suspended
from timing import RigClock

from ..files.rig_file import Limits
from ..guard.instruments import POLLED
from ..guard.messages import Event, RigLanded
from ..guard.pulse import Pulse
from .actuators import Actuators

LEARNED = 40
"""Latest readings before a run of equal ones that tell how noisy the gauge is there; half of them are enough."""


class Repeats:
    """Counts the equal readings in a row of one gauge."""

    def __init__(self) -> None:
        self._before: deque[float] = deque(maxlen=LEARNED)
        """Latest readings before the run of equal ones that is under way."""
        self._value, self._count = 0.0, 0
        """Of that run."""
        self._since = self._at = 0.0
        """Host times of its first and newest reading, s."""

    def take(self, value: float, at: float) -> None:
        """One reading, at host time `at` (s)."""
        if self._count and value == self._value:
            self._count += 1
        else:
            self._before.extend([self._value] * min(self._count, LEARNED))
            self._value, self._count, self._since = value, 1, at
        self._at = at

    def forget(self) -> None:
        """Start anew."""
        self._before.clear()
        self._count = 0

    @property
    def stuck(self) -> float:
        """Host seconds for which a gauge has repeated itself that scattered before; 0 for one that may be at rest."""
        # with a quarter of equal neighbours, such a run comes in one series of 10^12
        if self._count < 20 or len(self._before) < LEARNED / 2:
            return 0.0
        steps = [b - a for a, b in pairwise(self._before)]
        equal = sum(step == 0 for step in steps) / len(steps)
        turns = sum(a * b < 0 for a, b in pairwise(steps)) / (len(steps) - 1)
        near = abs(self._value - fmean(self._before)) <= 5.0 * stdev(self._before)
        # Where more than a quarter of neighbours are equal, for a noise of one digit or less, equal readings tell nothing.
        # Noise turns two thirds of the readings, a changing pressure none.
        return self._at - self._since if near and equal <= 0.25 and turns >= 1 / 3 else 0.0


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
        self, actuators: Actuators, vital: Vital, streams: Mapping[str, Any], limits: Limits, stop_now: Callable[[], bool]
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
        """Check the rig once; raises KeyboardInterrupt, ActuatorsLost, RigLanded, Suspended, StoodStill or InstrumentError.

        `strict` does not forgive a hidden body, not even for a moment; in a pause (`resting`) what a person can put right
        may be wrong."""
        if self._stop_now():
            raise KeyboardInterrupt
        looked, awake = self._looked
        # host s for which this program was not awake; a command that takes long is no sleep
        stood = (timing.now() - looked) - (self._actuators.pulse.awake.now - awake)
        if stood > OWN_SLEEP:
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

    def recoverable(self, error: InstrumentError) -> bool:
        """Whether a person can put it right: an arm that its own safety system holds, a pressure that is not held."""
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
                name, f"its reading has been frozen to the last digit for {stuck:.1f} s; "
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
        """Raise what is wrong with a stream: Suspended for a tip hidden too long (`strict`: at all) and an open cell."""
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
        """Host seconds for which a stream was late, less those for which it was not, never below 0: one that drips is late."""
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
        last = self._values.get(name)
        if last is None or values != last.values:
            self._values[name] = Shown(values, sample.t, now)
            return
        last.took += now - last.at if sample.t != last.t else 0.0  # without a new sample nothing is repeated
        last.t, last.at = sample.t, now
        if last.took > STUCK:
            stuck = StaleReading(name, f"every value has been frozen for {last.took:.1f} s; restart the sensor")
            raise Suspended(stuck) if name == "mocap" else stuck


class WatchedClock:
    """The rig's clock as protocols get it: while they sleep, the pulse goes on and the vital signs are looked at."""

    def __init__(self, clock: RigClock, actuators: Actuators, watch: Watch) -> None:
        self._clock, self._actuators, self._watch = clock, actuators, watch
        self.speed = clock.speed

    def now(self) -> float:
        """Rig time, s."""
        return self._clock.now()

    def sleep(self, duration: float) -> None:
        """Wait `duration` seconds of rig time; raises what the watch finds."""
        end = timing.now() + max(0.0, duration) / self.speed
        while True:
            self._actuators.pulse.mark()
            self._watch.look()
            left = end - timing.now()
            if left <= 0:
                return
            timing.sleep(min(SLICE, left))


LOOK = 0.05
STEADY = 1.0
"""Host seconds for which everything must be well before work goes on: longer than a stream may be late unnoticed."""


class PatientOperator:
    """An operator who may take as long as it takes: the guard does not mistake waiting for a person for a hang.

    `asked`: entered while the person answers, so that the keys typed are the answer and nothing else.
    """

    def __init__(
        self, operator: Operator, pulse: Pulse, asked: Callable[[], AbstractContextManager[object]] = contextlib.nullcontext
    ) -> None:
        self._operator, self._pulse, self._asked = operator, pulse, asked

    def prepare(self, setup: Setup) -> None:
        """See Operator.prepare."""
        with self._asked(), self._pulse.waiting_for_person():
            self._operator.prepare(setup)

    def confirm(self, trouble: str) -> None:
        """See Operator.confirm."""
        with self._asked(), self._pulse.waiting_for_person():
            self._operator.confirm(trouble)


class RigRecovery:
    """What `Bench.recover` does."""

    def __init__(
        self, actuators: Actuators, watch: Watch, operator: Operator, limits: Limits, say: Callable[[str], None]
    ) -> None:
        self._actuators, self._watch, self._operator, self._limits, self._say = actuators, watch, operator, limits, say

    def __call__(self, cause: InstrumentError, ask: bool = True) -> None:
        """Pause for `cause` until readings are good again, with `ask` confirmed by a person; else raises `cause` and why."""
        self._say(f"Paused: {cause}")
        report = self._actuators.pause()
        if not report.confirmed:
            raise _with(cause, f"the pause is not confirmed safe: {report}")
        if ask:
            self._operator.confirm(str(cause))
        self._go_on(cause)

    def rest(self, over: Callable[[], bool], stopping: Callable[[], bool]) -> None:
        """The pause that a person asked for, until it is `over`, under watch. Raises Stopped, or what fails or stays wrong."""
        for step in self._actuators.pause().steps:
            if not step.confirmed:
                raise DeviceFault(step.instrument, f"the pause is not confirmed safe: {step.text}")
        self._say("Paused: vented and stopped; the spine is left as it is")
        while not over():
            if stopping():
                raise Stopped("stopped by the operator during a pause; the steps finished so far are in the recording")
            self._actuators.pulse.mark()
            self._watch.look(resting=True)
            timing.sleep(LOOK)
        self._go_on(None)

    def _go_on(self, cause: InstrumentError | None) -> None:
        """Resume, and see nothing wrong for `STEADY`; raises `cause`, or what is still wrong, after `limits.resume_within`."""
        try:
            self._actuators.resume()
        except InstrumentError as e:
            raise e from cause
        give_up = timing.now() + self._limits.resume_within
        well_since = timing.now()
        self._watch.forget()
        while timing.now() - well_since < STEADY:
            self._actuators.pulse.mark()
            try:
                self._watch.look(strict=True)
            except (InstrumentError, Suspended) as e:
                if timing.now() > give_up:
                    still = f"{self._limits.resume_within:g} s (limits.resume_within) after it was confirmed as fixed"
                    raise _with(cause or (e.cause if isinstance(e, Suspended) else e), f"{still}, still {e}") from e
                self._watch.forget()
                well_since = timing.now()
            except RigLanded as e:
                if cause is None:
                    raise
                raise _with(cause, str(e)) from e
            timing.sleep(LOOK)
        self._say("Resuming")


def _with(cause: InstrumentError, more: str) -> InstrumentError:
    """The cause of a pause, and what then went wrong."""
    return type(cause)(cause.instrument, f"{cause.message}; {more}")
