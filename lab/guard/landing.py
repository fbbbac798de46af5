"""Landing: every actuator brought into the safe state, each whatever happens to the others, and read back.

Each instrument has a thread of its own, started in the order of the policy. There it is opened if it has to be, its stop is
sent, and again until it is taken; then it is read until it is measured safe. The next one starts when the one before has taken or
refused its stop, and after a short head start in any case: a line that is dead, or an instrument that does not let itself be
opened, holds up nobody but itself.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.errors import InstrumentError, NotReady

from ..files.rig_file import Safe
from .report import SafeReport, SafeStep

HEAD_START = 0.005
"""Host seconds after which the next stop is sent, whatever became of the one before: too little to delay anything."""
AGAIN = 0.3
"""Host seconds after which a stop is sent again as long as the instrument is not read back safe."""
LEAST_TIME = 2.0
"""Host seconds allowed at least, however fast the rig's clock runs: wires do not get faster."""
RETRY = 0.02
RELEASED_ABOVE = 80e3
"""Pa absolute; a spine above this is no longer evacuated."""
GAUGE = "gauge"


@dataclass(frozen=True)
class Instruments:
    """The drivers of one rig, as a landing uses them."""

    drivers: Mapping[str, Any]
    opened: Collection[str]
    """Those that are open now."""
    open: Callable[[str], Any]
    """Opens one; raises InstrumentError."""
    busy: Callable[[str], bool] = lambda name: False
    """Whether a command that was let through before the landing is still on its way to an instrument."""


class Landing:
    """Lands the actuators of one rig by its policy."""

    def __init__(self, policy: Safe, instruments: Instruments, speed: float) -> None:
        """`speed` of the rig's clock: `policy.within` is rig time."""
        self._policy = policy
        self._rig = instruments
        self._within = max(LEAST_TIME, policy.within / speed)
        self._gauge_until = 0.0
        """Host time until which the valve waits for a gauge that is being opened."""

    def make_safe(self, names: Sequence[str], keep_vacuum: bool, reach: float = 0.0) -> SafeReport:
        """Stop these instruments; returns when each is confirmed or its time is over. Never raises.

        Those that are not open are opened, trying for `reach` host seconds.
        """
        began = time.monotonic()
        order = [n for n in self._policy.order if n in names and not (n == "valve" and keep_vacuum)]
        if "valve" in order:
            self._open_gauge()
        results: dict[str, SafeStep] = {}
        threads: list[threading.Thread] = []
        for name in order:
            sent = threading.Event()
            thread = threading.Thread(
                target=self._one, args=(name, reach, sent, results), name=f"land-{name}", daemon=True
            )
            thread.start()
            threads.append(thread)
            sent.wait(HEAD_START)
        give_up = time.monotonic() + reach + self._within + LEAST_TIME
        for thread in threads:
            thread.join(max(0.0, give_up - time.monotonic()))
        hung = "its driver does not respond; stop it by hand"
        steps = tuple(results.get(name, SafeStep(name, False, hung)) for name in order)
        return SafeReport(steps, time.monotonic() - began)

    def _open_gauge(self) -> None:
        """The gauge confirms that the spine is released; one that does not open delays nobody."""
        if GAUGE not in self._rig.drivers or GAUGE in self._rig.opened:
            return

        def go() -> None:
            try:
                self._rig.open(GAUGE)
            except Exception:  # noqa: BLE001 - without it the relay's word must do
                self._gauge_until = 0.0

        self._gauge_until = time.monotonic() + LEAST_TIME
        threading.Thread(target=go, name="open-gauge", daemon=True).start()

    def _one(self, name: str, reach: float, sent: threading.Event, results: dict[str, SafeStep]) -> None:
        """Stop one instrument, then read it until it is safe.

        A stop that overtook a command on its way proves nothing: it is sent again until none was.
        """
        stop, is_safe = self._ways(name)
        closed = not self._is_open(name)
        deadline = time.monotonic() + (reach if closed else self._within)
        taken, overtook, again_at = False, True, 0.0
        while True:
            confirmed = False
            try:
                if overtook or time.monotonic() >= again_at:
                    before, again_at = self._rig.busy(name), time.monotonic() + AGAIN
                    try:
                        stop()
                    finally:
                        sent.set()
                    taken, overtook = True, before
                if closed and self._is_open(name):
                    closed, deadline = False, time.monotonic() + self._within
                confirmed, text = is_safe()
            except Exception as e:  # noqa: BLE001 - whatever one driver does must not keep the others from stopping
                failed = "cannot be reached" if not self._is_open(name) else "did not accept the stop"
                text = str(e) if taken else f"{failed}: {e}"
            if overtook and confirmed:
                confirmed, text = False, f"{text}, but an earlier command has not returned"
            if confirmed or time.monotonic() > deadline:
                results[name] = SafeStep(name, confirmed, text)
                return
            time.sleep(RETRY)

    def _is_open(self, name: str) -> bool:
        return name in self._rig.opened

    def _reached(self, name: str) -> Any:
        """The driver, open. Raises InstrumentError."""
        if not self._is_open(name):
            self._rig.open(name)
        return self._rig.drivers[name]

    def _ways(self, name: str) -> tuple[Callable[[], Any], Callable[[], tuple[bool, str]]]:
        """How an instrument is stopped, opened first where it has to be, and how that is read back."""
        driver = self._rig.drivers[name]
        if name == "pressure":
            return lambda: self._vent(driver), lambda: self._vented(driver)
        if name == "spine":
            return lambda: self._reached(name).stop(), lambda: _held(driver)
        if name == "valve":
            return lambda: self._reached(name).set(False), lambda: self._released(driver)
        return lambda: self._stop_arm(driver), lambda: _standing(driver)

    def _vent(self, driver: Any) -> None:
        """Told before it is asked who it is: one dead regulator must not keep the others inflated."""
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
        if not self._is_open(GAUGE) and time.monotonic() < self._gauge_until:
            return False, "vacuum off according to its relay; the gauge is being opened"
        gauge = self._rig.drivers.get(GAUGE)
        try:
            absolute = gauge.read().absolute if gauge is not None else None
        except InstrumentError:
            absolute = None
        if absolute is None:
            return True, "vacuum off according to its relay; no gauge to confirm it"
        return absolute > RELEASED_ABOVE, f"vacuum off, {absolute / 1e3:.0f} kPa absolute in the spine"

    def _stop_arm(self, driver: Any) -> None:
        """An arm whose state shows it standing needs no stop; one that does not take it is judged by its state alone."""
        try:
            self._reached("arm").stop()
        except Exception:
            if not _at_rest(driver):
                raise


def _held(driver: Any) -> tuple[bool, str]:
    sample = driver.read()
    return not sample.moving, f"length {sample.length * 1e3:.1f} mm, {'moving' if sample.moving else 'at rest'}"


def _at_rest(driver: Any) -> bool:
    """By the state that the driver receives; by a look from outside when its connection has ended: after a stop by the
    arm's own safety system it cannot be opened again before a person has cleared that."""
    try:
        return bool(driver.standing())
    except NotReady:
        return bool(driver.glance())


def _standing(driver: Any) -> tuple[bool, str]:
    standing = _at_rest(driver)
    return standing, "at rest" if standing else "moving"
