"""Landing: bring every actuator into the safe state, independently of the others, and read it back.

Each instrument has a thread of its own, started in the order of the policy. There it is opened if necessary, its stop is sent
until it is accepted, and it is read until it is measured safe. The next one starts when the one before has accepted or refused
its stop, and after a short head start in any case: a dead line, or an instrument that cannot be opened, delays nothing else.

A lost line is reopened with every attempt. The report is due after a fixed time, but the attempts continue until the instrument
is confirmed safe, another landing begins, or `end` is called.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import timing
from drivers.errors import InstrumentError, NoReply, NotReady, Unreachable

from ..files.rig_file import Safe
from .messages import SafeReport, SafeStep

HEAD_START = 0.005
"""Host seconds after which the next stop is sent, regardless of the one before: too short to delay anything."""
AGAIN = 0.3
"""Host seconds after which a stop is sent again, after reopening a lost line, until the instrument is read back safe."""
LEAST_TIME = 2.0
"""Least host seconds allowed, however fast the rig's clock runs: wires do not get faster."""
RETRY = 0.02
RELEASED_ABOVE = 80e3
"""Pa absolute; a spine above this is no longer evacuated."""
GAUGE = "gauge"
LOST = (Unreachable, NotReady, NoReply)
"""Errors after which an instrument is reopened before its next stop."""


@dataclass
class Owned:
    """The actuator drivers of one rig, as its guard and a landing share them."""

    drivers: dict[str, Any] = field(default_factory=dict)
    opened: list[str] = field(default_factory=list)
    lost: set[str] = field(default_factory=set)
    """Opened instruments whose line was lost; a landing reopens them."""
    locks: dict[str, threading.Lock] = field(default_factory=dict)
    busy: set[str] = field(default_factory=set)
    """Instruments to which an energising command is on its way, accepted before a landing that begins now."""


@dataclass
class _Attempts:
    """All attempts of one landing at one instrument."""

    name: str
    began: float = field(default_factory=timing.now)
    """Host time, s."""
    sent: threading.Event = field(default_factory=timing.Event)
    """The first stop was accepted or refused."""
    judged: threading.Event = field(default_factory=timing.Event)
    """It is confirmed, or its time is over."""
    ended: threading.Event = field(default_factory=timing.Event)
    """No further attempt: it is confirmed, or another landing has begun."""
    step: SafeStep | None = None
    reported: bool = False


class Landing:
    """Lands the actuators of one rig by its policy."""

    def __init__(
        self,
        policy: Safe,
        owned: Owned,
        reopen: Callable[[str], Any],
        speed: float,
        late: Callable[[SafeStep, float], None] = lambda step, seconds: None,
    ) -> None:
        """`reopen` connects a driver again; `speed` of the rig's clock; `late` gets what is confirmed after the report, and host
        seconds since the begin."""
        self._policy, self._late = policy, late
        self._going: dict[str, _Attempts] = {}
        self._lock = timing.Lock()
        self._rig, self._reopen = owned, reopen
        self._within = max(LEAST_TIME, policy.within / speed)
        self._gauge_until = 0.0
        """Host time until which the valve waits for a gauge that is being opened."""

    def make_safe(self, names: Sequence[str], keep_vacuum: bool, reach: float = 0.0) -> SafeReport:
        """Stop these instruments, opened for `reach` host seconds, until each is confirmed or its time is over. Never raises."""
        began = timing.now()
        order = [n for n in self._policy.order if n in names and not (n == "valve" and keep_vacuum)]
        self.end(order)
        if "valve" in order:
            self._open_gauge()
        landing: list[_Attempts] = []
        for name in order:
            attempts = _Attempts(name)
            with self._lock:
                self._going[name] = attempts
            timing.Thread(target=self._one, args=(attempts, reach), name=f"land-{name}", daemon=True).start()
            landing.append(attempts)
            attempts.sent.wait(HEAD_START)
        give_up = timing.now() + reach + self._within + LEAST_TIME
        for attempts in landing:
            attempts.judged.wait(max(0.0, give_up - timing.now()))
        hung = "its driver does not respond; stop it by hand"
        with self._lock:
            for attempts in landing:
                attempts.reported = True
            steps = tuple(a.step or SafeStep(a.name, False, hung) for a in landing)
        return SafeReport(steps, timing.now() - began)

    @property
    def going(self) -> tuple[str, ...]:
        """The instruments that are not confirmed safe and are still being tried."""
        with self._lock:
            return tuple(self._going)

    def end(self, names: Sequence[str] | None = None) -> None:
        """Make no further attempts at these instruments, or at any."""
        with self._lock:
            for name in tuple(self._going) if names is None else names:
                if (attempts := self._going.pop(name, None)) is not None:
                    attempts.ended.set()

    def _open_gauge(self) -> None:
        """The gauge confirms that the spine is released; one that does not open delays nothing."""
        if GAUGE not in self._rig.drivers or self._is_open(GAUGE):
            return

        def go() -> None:
            try:
                self._reopen(GAUGE)
            except Exception:  # noqa: BLE001 - without it the relay's word must do
                self._gauge_until = 0.0

        self._gauge_until = timing.now() + LEAST_TIME
        timing.Thread(target=go, name="open-gauge", daemon=True).start()

    def _one(self, attempts: _Attempts, reach: float) -> None:
        """Stop one instrument, again every `AGAIN`, and read it until it is confirmed safe or `end` is called, in a thread."""
        name = attempts.name
        stop, is_safe = self._ways(name)
        closed = name not in self._rig.opened
        deadline = timing.now() + (reach if closed else self._within)
        accepted, overtook, again_at = False, True, 0.0
        while not attempts.ended.is_set():
            confirmed = False
            try:
                if overtook or timing.now() >= again_at:
                    busy, again_at = name in self._rig.busy, timing.now() + AGAIN
                    try:
                        stop()
                    finally:
                        attempts.sent.set()
                    accepted, overtook = True, busy
                if closed and self._is_open(name):
                    closed, deadline = False, timing.now() + self._within
                confirmed, text = is_safe()
            except Exception as e:  # noqa: BLE001 - whatever one driver does must not keep the others from stopping
                failure = "cannot be reached" if not self._is_open(name) else "did not accept the stop"
                text = str(e) if accepted else f"{failure}: {e}"
                if isinstance(e, LOST) and name != "arm":
                    self._rig.lost.add(name)
            if overtook and confirmed:
                confirmed, text = False, f"{text}, but an earlier command has not returned"
            if confirmed or timing.now() > deadline:
                self._judge(attempts, SafeStep(name, confirmed, text))
            attempts.ended.wait(AGAIN if attempts.judged.is_set() else RETRY)

    def _judge(self, attempts: _Attempts, step: SafeStep) -> None:
        """Report where an instrument stands; the attempts end when it is confirmed."""
        with self._lock:
            if attempts.ended.is_set():
                return
            attempts.step = step
            attempts.judged.set()
            if step.confirmed:
                attempts.ended.set()
                del self._going[attempts.name]
        if step.confirmed and attempts.reported:
            self._late(step, timing.now() - attempts.began)

    def _is_open(self, name: str) -> bool:
        return name in self._rig.opened and name not in self._rig.lost

    def _reached(self, name: str) -> Any:
        """The driver, open. Raises InstrumentError."""
        if not self._is_open(name):
            self._reopen(name)
        return self._rig.drivers[name]

    def _ways(self, name: str) -> tuple[Callable[[], Any], Callable[[], tuple[bool, str]]]:
        """How an instrument is stopped, opened first if necessary, and how that is read back."""
        driver = self._rig.drivers[name]
        if name == "pressure":
            return lambda: self._vent(driver), lambda: self._vented(driver)
        if name == "spine":
            return lambda: self._reached(name).stop(), lambda: _held(driver)
        if name == "valve":
            return lambda: self._reached(name).set(False), lambda: self._released(driver)
        return lambda: self._stop_arm(driver), lambda: _standing(driver)

    def _vent(self, driver: Any) -> None:
        """Vented before it is identified: one dead regulator must not keep the others inflated."""
        driver.connect()
        driver.vent()
        self._reached("pressure")

    def _vented(self, driver: Any) -> tuple[bool, str]:
        sample = driver.read()
        highest = max(sample.measured)
        vented = highest < self._policy.vented_below and max(sample.setpoint) < self._policy.vented_below
        return vented, f"highest pressure {highest / 1e3:.1f} kPa"

    def _released(self, valve: Any) -> tuple[bool, str]:
        """By the relay's coil, and by the gauge where it answers: a welded contact shows there alone."""
        if valve.read().on:
            return False, "vacuum on"
        if not self._is_open(GAUGE) and timing.now() < self._gauge_until:
            return False, "vacuum off by its relay; the gauge is being opened"
        gauge = self._rig.drivers.get(GAUGE)
        try:
            absolute = gauge.read().absolute if gauge is not None else None
        except InstrumentError:
            absolute = None
        if absolute is None:
            return True, "vacuum off by its relay; no gauge to confirm it"
        return absolute > RELEASED_ABOVE, f"vacuum off, {absolute / 1e3:.0f} kPa absolute in the spine"

    def _stop_arm(self, driver: Any) -> None:
        """An arm at rest needs no stop; one that accepts none is judged by its state, and reconnected if it moves."""
        try:
            self._reached("arm").stop()
        except Exception:
            if not _at_rest(driver):
                self._rig.lost.add("arm")
                raise


def _held(driver: Any) -> tuple[bool, str]:
    sample = driver.read()
    return not sample.moving, f"length {sample.length * 1e3:.1f} mm, {'moving' if sample.moving else 'at rest'}"


def _at_rest(driver: Any) -> bool:
    """By the state that the driver receives, or by a check from outside: after a protective stop no driver can be opened."""
    try:
        return bool(driver.standing())
    except (NotReady, NoReply):
        return bool(driver.glance())


def _standing(driver: Any) -> tuple[bool, str]:
    standing = _at_rest(driver)
    return standing, "at rest" if standing else "moving"
