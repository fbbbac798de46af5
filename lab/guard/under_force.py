"""The arm as the guard uses it: it moves only while the force sensor sends, and otherwise waits in place.

A late sample is no fault yet: a busy computer delays one now and then. So a motion is stopped when the newest
sample is older than `limits.max_age_in_motion`, and begun again towards its goal when the program next asks whether the
arm has arrived and the samples flow. This also works when the program hangs: samples then stop arriving here.
Time a motion stands still is counted, time it moves is subtracted; past `limits.max_age` the run ends.

A rig whose force sensor was not opened has nothing to wait for.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import timing
from drivers.errors import InstrumentError, StaleReading

from ..files.rig_file import Limits

LOOK = 0.005
"""Host seconds between two checks of the newest sample's age while the arm moves."""
FLOW = 4
"""Samples that must have arrived in quick succession before a motion continues."""
STOP_WAITS = 0.3
"""Host seconds that a stop waits for an earlier call to the arm; then it overtakes it."""
STOPS = 3
"""Tries to stop the arm that may fail in a row before the guard lands the rig."""


class UnderForce:
    """The arm's driver, moving only with force samples; has the driver's methods that the guard uses."""

    def __init__(
        self,
        arm: Any,
        limits: Limits,
        begin: Callable[[Callable[[], Any]], Any],
        tell: Callable[[str], None],
        fail: Callable[[str, InstrumentError | None], None],
    ) -> None:
        """`begin` does what starts a motion, unless the rig was landed; `tell` logs; `fail` lands: the arm does not stop."""
        self._arm, self._limits = arm, limits
        self._begin, self._log, self._fail = begin, tell, fail
        self._arrivals: deque[float] = deque(maxlen=FLOW)
        self._turn = timing.Lock()
        """Held by a call to the arm's motion."""
        self._goal: tuple[Any, ...] | None = None
        """The motion under way, its arguments of move_to; None at rest."""
        self._waits = self._reported = False
        """Whether that motion stands still until samples flow; whether that was logged."""
        self._stood = 0.0
        """Host seconds that motions stood still for, less those they moved for."""
        self._under_way = timing.Event()
        """Set while there is a motion."""
        self._finished = False
        timing.Thread(target=self._watch, name="under-force", daemon=True).start()

    def sampled(self, at: float) -> None:
        """A force sample has come, at this host time."""
        self._arrivals.append(at)

    # -- the arm
    def move_to(self, *motion: Any) -> None:
        """See Arm.move_to; while no force is measured the motion waits until `moving` is called when samples flow again."""
        with self._turn:
            self._goal, self._waits, self._reported = motion, not self._flows(), False
            self._under_way.set()
            if self._waits:
                self._say(self._longest())
            else:
                self._drive(lambda: self._arm.move_to(*motion))

    def moving(self) -> bool:
        """See Arm.moving; True also while a motion waits. Raises StaleReading when it has waited longer than `limits.max_age`."""
        with self._turn:
            motion = self._goal
            if motion is None or not self._waits:
                on = bool(self._drive(self._arm.moving))
                if on or self._waits:  # a stop that did not wait for its turn ended the motion: it has not arrived
                    return True
                self._end()
                return False
            if self._stood > self._limits.max_age:
                self._end()
                raise StaleReading(
                    "force",
                    f"the arm was held for {self._stood:.1f} s during a motion, because samples came later than "
                    f"limits.max_age_in_motion = {self._limits.max_age_in_motion:g} s; "
                    + timing.busy_or("check the sensor's cable and adapter"),
                )
            if self._flows():
                self._waits = False
                self._drive(lambda: self._begin(lambda: self._arm.move_to(*motion)))
            return True

    def stop(self) -> None:
        """See Arm.stop; a motion that waits is given up."""
        self._end()
        self._arm.stop()

    def __getattr__(self, name: str) -> Any:
        """What moves nothing goes to the arm as it is."""
        return getattr(self._arm, name)

    def close(self) -> None:
        """Disconnect."""
        self._end()
        self._arm.close()

    def finish(self) -> None:
        """Watch no more, for good."""
        self._finished = True
        self._under_way.set()

    def _drive(self, call: Callable[[], Any]) -> Any:
        """A call to the arm; if it fails there is no motion to continue."""
        try:
            return call()
        except BaseException:
            self._end()
            raise

    def _end(self) -> None:
        self._goal, self._waits = None, False
        self._under_way.clear()

    # -- the samples
    def _age(self) -> float:
        """Of the newest sample, host s; 0 where none ever came: the sensor is not in use."""
        return timing.now() - self._arrivals[-1] if self._arrivals else 0.0

    def _flows(self) -> bool:
        """Whether samples come one shortly after the other."""
        return self._longest() <= self._limits.max_age_in_motion

    def _longest(self) -> float:
        """Time without a sample among the newest ones and since, host s."""
        return max([self._age(), *(b - a for a, b in pairwise(list(self._arrivals)))])

    def _watch(self) -> None:
        """Stop a motion without samples; in a thread of its own, since a stop takes time."""
        failed = 0  # tries in a row
        while not self._finished:
            self._under_way.wait()
            began = timing.now()
            try:
                if not self._waits and self._age() > self._limits.max_age_in_motion:
                    failed = failed + 1 if not self._hold(last=failed + 1 == STOPS) else 0
            except Exception as e:  # noqa: BLE001 - see Guard.go_on
                self._fail(f"no force samples, and the arm was not stopped: {type(e).__name__}: {e}", None)
            timing.sleep(LOOK)
            elapsed = timing.now() - began
            self._stood = self._stood + elapsed if self._waits else max(0.0, self._stood - elapsed)

    def _hold(self, last: bool) -> bool:
        """Stop the arm until samples come, unless it arrived or one came; False when it refuses, a failure at the `last` try."""
        locked = self._turn.acquire(timeout=STOP_WAITS)  # then the stop overtakes an earlier call, without the lock
        try:
            age = self._age()
            if self._goal is None or age <= self._limits.max_age_in_motion:
                return True
            self._waits = True  # before the stop: `moving` must not take the arm's standing still for its arrival
            try:
                self._arm.stop()
            except InstrumentError as e:
                self._waits = False
                if last:
                    self._fail(f"no force samples, and the arm does not accept the stop: {e}", e)
                return False
            self._say(age)
            return True
        finally:
            if locked:
                self._turn.release()

    def _say(self, late: float) -> None:
        """Log that the arm waits, once a motion, however often it waits; `late`: age of the newest sample, host s."""
        if not self._reported:
            self._reported = True
            self._log(
                f"force: no sample for {late * 1e3:.0f} ms, limits.max_age_in_motion is "
                f"{self._limits.max_age_in_motion * 1e3:.0f} ms: the arm waits until samples arrive again"
            )
