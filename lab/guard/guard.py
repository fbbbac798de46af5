"""The guard: owner of the actuators, which lands the rig when the program that commands it cannot, or when a reading shows
that something has failed.

Losing a line while the rig is energised is such a failure: everything is landed, and the line is reopened until its instrument
is confirmed safe. After a landing of its own the guard takes no command until a person has confirmed. The latch is on
disk from the first command that energises anything until the safe state is read back. In a run the guard is a process of its
own (`process.py`); a program that lands a rig whose guard was lost, and `lab safe`, are the guard themselves, since there is no
time to start one. Any program can request a landing at the guard's door (`door.py`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import timing
from drivers.errors import InstrumentError, Unreachable, WrongDevice
from drivers.interfaces import Identity, Instrument, PressureRegulators
from timing import RigClock

from ..files.checked import Adapters
from ..files.rig_file import RigFile
from .commands import REMOTES, Command, Order, energises
from .door import TAKE_WITHIN, Door
from .hosted import under_guard
from .instruments import ACTUATORS, POLLED, PollRate, of_driver, owned_names
from .landing import Landing, Owned
from .last_used import forget, remember
from .latch import Latch, RigLocked
from .limit_monitor import DriverSettings, LimitMonitor, NotHeld
from .messages import Event, RigLanded, SafeReport, SafeStep
from .under_force import UnderForce

CLIPPED = 1e3
"""Pa by which a set-point must be clipped to be logged."""
LIVES_ON = 60.0
"""Host seconds for which a guard whose program has ended keeps trying to land instruments that are not confirmed safe: enough for
a person to reconnect a plug, and for an adapter to reset."""
LOOK = 0.05
"""Host seconds between two checks whether everything is confirmed."""
REACH_WITHIN = 8.0
"""Host seconds within which an actuator must open; an earlier connection to the arm takes some of them to end."""
LOG_EVERY = 1.0
"""Host seconds between two such lines."""


Tell = Callable[[Any], None]
"""The way to the program: an Event, or the name of an instrument with its sample. Returns at once."""


def nobody(message: Any) -> None:
    """No program listens."""


class Guard:
    """One rig's guard."""

    def __init__(self, rig: RigFile, clock: RigClock, despite_latch: bool = False, tell: Tell = nobody, about: str = "") -> None:
        """`despite_latch`: a locked rig may be commanded too, by a person who attends to it. `about`: the command served."""
        self.rig, self.clock, self.tell = rig, clock, tell
        self.latch = Latch(rig.path) if rig.path is not None else None
        self._about = about
        self._door = Door(owned_names(rig), self, str(rig.path or ""), about)
        self.despite_latch = despite_latch
        self.monitor = LimitMonitor(self.rig)
        self.own = Owned()
        for name in REMOTES:
            config = getattr(self.rig.instruments, name)
            if config is not None:
                if name == "valve" and rig.safe.keep_vacuum:
                    config = config.model_copy(update={"on_close": "keep"})
                self.own.drivers[name] = under_guard(name, config, self.clock)
                self.own.locks[name] = timing.Lock()
        self.under_force: UnderForce | None = None
        if "arm" in self.own.drivers:
            arm = self.own.drivers["arm"]
            self.under_force = UnderForce(
                arm, self.rig.limits, self._begin_motion, lambda text: self.tell(Event("waiting", text)), self.land
            )
            self.own.drivers["arm"] = self.under_force
        self.settings = DriverSettings(self.own.drivers)
        self.adapters = Adapters(rig)
        self.landing = Landing(self.rig.safe, self.own, self.open, self.rig.clock.speed, self._confirmed_late)
        self.running = True
        """It polls its instruments."""
        self.gone = False
        """Everything is disconnected, and the rig given back."""
        self.energised = False
        """Something may not be in its safe state."""
        self.landed = ""
        """Why the guard landed the rig on its own; empty while it takes commands."""
        self.handed_over = ""
        """The rig's new owner; empty while this guard owns it."""
        self.ending = False
        """Its program has ended: it lands the rig and gives it back."""
        self._cause: InstrumentError | None = None
        self._landing_lock = timing.RLock()
        self._deciding = timing.Lock()
        self._why = ""
        """Why the rig was landed last."""
        self._clip_logged = 0.0  # host time, s
        self._last = SafeReport()  # of the last landing
        self._closed = False  # everything was landed for good

    def take_over(self, within: float = TAKE_WITHIN) -> None:
        """Own the rig; raises RigLocked at once when it is in use, and after `within` host seconds when it is being landed."""
        self._door.open(within)
        if self.latch is not None and not self.despite_latch:
            try:
                self.latch.demand_free()
                with _on_disk(self.latch.journal):
                    self.latch.begin(f"owns the rig for {self._about or 'a program'}")
            except RigLocked:
                self._door.close()
                raise
            remember(self.rig)

    def start(self) -> None:
        """Poll the instruments as soon as they are open."""
        for name in POLLED:
            if name in self.own.drivers:
                timing.Thread(target=self._poll, args=(name,), name=f"poll-{name}", daemon=True).start()

    def go_on(self, what: str, look: Callable[[], None], over: Callable[[], bool]) -> None:
        """Check until it is `over`. A check that fails unexpectedly lands an energised rig, whose safety depends on it."""
        while not over():
            try:
                look()
            except Exception as e:  # noqa: BLE001
                if self.energised:
                    self.land(f"{what} failed: {type(e).__name__}: {e}; run again, and report this if it recurs")
                timing.sleep(LOOK)

    # -- commands
    def obey(self, order: Order) -> SafeReport | None:
        """Handle one request of the program, except the last."""
        if order is Order.MAKE_SAFE:
            return self.make_safe("requested by the program", self.rig.safe.keep_vacuum)
        if order is Order.PAUSE:
            return self.make_safe("pause", keep_vacuum=True)
        if order is Order.RESUME:
            self.resume()
        return None

    def do(self, command: Command[Any]) -> Any:
        """Perform one command of the program at an instrument; returns the driver's result.

        A command that energises is refused after and during a landing, and waits for settings to be read when a trial begins.
        A lost line, or another device than expected, lands the rig. Raises what the driver raises, RigLanded, RigLocked."""
        name = command.instrument
        if name not in self.own.drivers:
            raise ValueError(f"{command}: this rig has no such instrument")
        method = command.method
        if method is Instrument.open:
            self.adapters.check(name)  # here and not in `open`: a landing vents and stops every instrument present
            identity = self.open(name)
            self.adapters.learn(name, identity)
            return identity
        if method is Instrument.close:
            return self.close_one(name)
        with self.own.locks[name]:
            if method is PressureRegulators.vent:
                self.monitor.vented()
                self.settings.vented()
            if not energises(command):
                try:
                    return command.perform(self.own.drivers[name])
                except Unreachable as e:
                    self._lose(name, e)
                    raise
            self.own.busy.add(name)  # before permission is checked: a landing that begins now waits for it
            try:
                self._energise()
                if method is not PressureRegulators.set:
                    self.settings.confirm(name, trial=True)
                    return command.perform(self.own.drivers[name])
                (pressures,) = command.values
                if any(p > 0 for p in pressures):
                    self.settings.confirm(name, trial=True)
                return self._set_pressure(pressures)
            except WrongDevice as e:
                self.land(str(e), e)
                raise
            except InstrumentError as e:
                if e is self._cause:  # refused; an error that is its own cause cannot be told to another process
                    raise
                if self.landed:  # the command gave way to the landing's stop
                    raise self._refusal() from e
                if isinstance(e, Unreachable):
                    self._lose(name, e)
                raise
            finally:
                self.own.busy.discard(name)

    def open(self, name: str) -> Identity:
        """Connect one instrument."""
        with self.own.locks[name]:
            identity: Identity = self.own.drivers[name].open()
            if name not in self.own.opened:
                self.own.opened.append(name)
            self.own.lost.discard(name)
        return identity

    def close_one(self, name: str) -> None:
        """Disconnect one instrument."""
        with self.own.locks[name]:
            if name in self.own.opened:
                self.own.opened.remove(name)
            self.own.drivers[name].close()

    def _lose(self, name: str, error: InstrumentError) -> None:
        """The line to an instrument is lost: its state is unknown, so everything is landed."""
        if name in POLLED:
            self.own.lost.add(name)
        if self.energised:
            self.land(str(error), error)

    def _energise(self) -> None:
        """Before an energising command: refuse it during and after a landing, and write the latch before the first one."""
        if self.landed:
            raise self._refusal()
        if self.landing.going:
            raise RigLanded(f"the guard is still making the rig safe: {self._last}")
        if not self.energised:
            if self.latch is not None and not self.despite_latch:
                with _on_disk(self.latch.path):
                    self.latch.write("a run was interrupted before its safe state was confirmed")
            self.energised = True

    def _refusal(self) -> Exception:
        return self._cause or RigLanded(f"the guard has made the rig safe: {self.landed}")

    def _set_pressure(self, pressures: tuple[float, ...]) -> tuple[float, ...]:
        """Set the pressures (Pa gauge, one a channel), clipped to the limits; returns what the regulators confirmed."""
        allowed = self.monitor.setpoints(pressures)
        self.monitor.setpoints_confirmed = None
        try:
            held: tuple[float, ...] = self.own.drivers["pressure"].set(allowed)
        except InstrumentError:
            if len(allowed) == self.own.drivers["pressure"].channels:
                self.monitor.may_have_taken(allowed)
            raise
        with self._deciding:
            if not self.landed:  # what a landing has vented meanwhile is not missed
                self.monitor.confirmed(held)
        now = timing.now()
        worst = max((abs(a - b) for a, b in zip(pressures, held, strict=False)), default=0.0)
        if worst > CLIPPED and now - self._clip_logged > LOG_EVERY:
            self._clip_logged = now
            requested, confirmed = (", ".join(f"{p / 1e3:.1f}" for p in ps) for ps in (pressures, held))
            self.tell(Event("clipped", f"pressure set-points clipped: asked {requested} kPa, set {confirmed} kPa"))
        return held

    # -- landing
    def make_safe(self, why: str, keep_vacuum: bool, names: Sequence[str] | None = None, reach: float = 0.0) -> SafeReport:
        """Land what is open, or `names` (opened for `reach` host s), and read back; confirmed, the latch goes. Never raises."""
        with self._landing_lock:
            if self._closed:
                return self._last
            self.monitor.vented()
            self.settings.vented()
            names = list(self.own.opened) if names is None else names
            self._why = why
            return self._reached(self.landing.make_safe(names, keep_vacuum, reach), f"landed ({why})")

    def _reached(self, report: SafeReport, what: str) -> SafeReport:
        """Note in journal and latch what a landing (`what`) has reached; the latch goes when everything is confirmed."""
        self._last = report
        if self.latch is not None:
            if self.energised or not report.confirmed:
                self.latch.note(f"{what}: {report}")
            if not report.confirmed:
                with contextlib.suppress(OSError):
                    self.latch.write(f"safe state not confirmed after: {self._why}. {report}")
            elif self.energised and not self.despite_latch:
                with contextlib.suppress(OSError):  # the remaining file locks the rig, and says so
                    self.latch.clear()
        self.energised = not report.confirmed
        return report

    def _confirmed_late(self, step: SafeStep, seconds: float) -> None:
        """Report an instrument safe `seconds` after a landing began, too late for its report; after the last the latch goes."""
        late = SafeReport((step,), seconds)
        with self._landing_lock:
            if self._closed:
                return
            steps = (step if s.instrument == step.instrument else s for s in self._last.steps)
            self._reached(SafeReport(tuple(steps), seconds), late.said)
        self.tell(Event("confirmed", self._why, None, late))

    def land(self, why: str, error: InstrumentError | None = None) -> None:
        """Land by the guard's own decision, once, in a thread of its own; commands are refused from here on."""

        def go() -> None:
            self.tell(Event("landed", why, error, self.make_safe(why, self.rig.safe.keep_vacuum)))

        with self._deciding:
            if self.landed:
                return
            self.landed, self._cause = why, error
            try:
                timing.Thread(target=go, name="land", daemon=True).start()
                return
            except RuntimeError:  # the computer has no room for one more thread: land in this one
                pass
        go()

    def hand_over(self, by: str) -> SafeReport:
        """Land for good on another's request: no further command is accepted. Instruments that are not open are opened first."""
        why = f"requested by {by}"
        with self._deciding:
            self.handed_over = by
            self.landed = self.landed or why
        names = None if self.own.opened else [n for n in ACTUATORS if n in self.own.drivers]
        report = self.make_safe(why, self.rig.safe.keep_vacuum, names, REACH_WITHIN)
        self.tell(Event("landed", why, None, report))
        return report

    def locked(self) -> str:
        """Why the rig is locked; empty when it is free."""
        return (self.latch.read() if self.latch is not None else None) or ""

    def resume(self) -> None:
        """A person has confirmed: reopen what has to be, and take commands again. Raises RigLanded after `hand_over`.

        Set-points start from what is measured: the regulators are vented, arm and spine stand where they were stopped."""
        if self.handed_over:
            raise self._refusal()
        for name in self.own.opened:
            self.adapters.check(name)
        self.landing.end()
        for name in tuple(self.own.lost):
            self.open(name)
        if "arm" in self.own.opened:
            with self.own.locks["arm"]:
                arm = self.own.drivers["arm"]
                try:
                    arm.moving()
                except InstrumentError:  # after a protective or emergency stop it must be connected anew
                    arm.close()
                    arm.open()
        self.landed = ""

    def unlock(self) -> None:
        """A person has attended to the rig: remove the latch. Raises RigLocked where its folder cannot be written."""
        if self.latch is not None:
            with _on_disk(self.latch.path):
                self.latch.clear()
            self.latch.note("unlocked by a person")

    # -- threads
    def _poll(self, name: str) -> None:
        """Read one instrument `poll` times a second and tell the program the sample, or the error in its place."""
        rate = PollRate(name, getattr(self.rig.instruments, name), self.rig.poll)
        self.go_on(f"the polling of {name}", lambda: self._read(name, rate), lambda: not self.running)

    def _read(self, name: str, rate: PollRate) -> None:
        """Read an open instrument and hand its sample or error on; a strange device and a lost line land an energised rig."""
        due = timing.now() + 1 / self.rig.poll
        if name in self.own.opened:
            sample: Any
            try:
                with self.own.locks[name]:
                    sample = self._checked(name, rate.timed(self.own.drivers[name].read))  # before the next set-point is told
            except InstrumentError as e:
                sample = e
                if isinstance(e, WrongDevice) and self.energised:
                    self.land(str(e), e)
                if isinstance(e, Unreachable):
                    self._lose(name, e)
            except Exception as e:
                raise of_driver(name, getattr(self.rig.instruments, name), e) from e
            self.tell((name, sample))
            for text in (*getattr(self.own.drivers[name], "take_notices", list)(), *rate.notices()):
                self.tell(Event("notice", text))
        timing.sleep(max(0.0, due - timing.now()))

    def _checked(self, name: str, sample: Any) -> Any:
        """The reading, or the error in its place; an error lands an energised rig, or is reported where a pause is enough."""
        if self.settings.may_have_changed(name, sample):  # its unit of measure was changed at the instrument's panel
            self.settings.confirm(name, trial=False)
        fault = self.monitor.check(name, sample)
        if isinstance(fault, NotHeld):
            self.tell(Event("pause", str(fault), fault))
        if fault is None or isinstance(fault, NotHeld):
            return sample
        if self.energised:
            self.land(str(fault), fault)
        return fault

    # -- the arm under force
    def _begin_motion(self, motion: Callable[[], Any]) -> Any:
        """Begin a motion of the arm that had waited for force samples; as a command, it is refused when the rig was landed."""
        self.own.busy.add("arm")
        try:
            self._energise()
            return motion()
        finally:
            self.own.busy.discard("arm")

    # -- the end
    def finish(self) -> str:
        """Land what may still be energised, for good; returns the instruments not confirmed yet and still being tried."""
        self.ending = True
        self.landed = self.landed or "the guard is ending"
        with self._landing_lock:
            if self.energised and not self.landing.going:
                self.make_safe("the program ended", self.rig.safe.keep_vacuum)
            going = self.landing.going
            return "; ".join(f"{s.instrument}: {s.text}" for s in self._last.steps if s.instrument in going)

    def close(self, lives_on: float = 0.0) -> None:
        """Land what may still be energised, disconnect everything, let another guard have the rig.

        What is not confirmed safe is tried for `lives_on` host seconds more; the rest but the gauge is disconnected before."""
        self.finish()
        until = timing.now() + lives_on
        if going := self.landing.going:  # the gauge shows whether the spine is released
            self._disconnect([n for n in self.own.drivers if n not in (*going, "gauge")])
        while self.landing.going and timing.now() < until:
            timing.sleep(LOOK)
        with self._landing_lock:
            # from here on `land` does nothing: everything has been tried
            self._closed = True
            self.landing.end()
        self.running = False
        self._disconnect(list(self.own.drivers))
        if self.under_force is not None:  # its thread checks the force sensor's samples as long as an arm may move
            self.under_force.finish()
        if self._last.confirmed and not self.energised and (self.latch is None or self.latch.read() is None):
            forget(self.rig)  # `lab safe` needs to land it no more
        self._door.close()
        self.gone = True

    def _disconnect(self, names: Sequence[str]) -> None:
        closing = [timing.Thread(target=self._close, args=(n,), name=f"close-{n}", daemon=True) for n in names]
        for thread in closing:
            thread.start()
        for thread in closing:
            thread.join(8.0)

    def _close(self, name: str) -> None:
        if name in self.own.opened:
            self.own.opened.remove(name)
        with contextlib.suppress(Exception):
            self.own.drivers[name].close()


@contextlib.contextmanager
def _on_disk(path: Path) -> Iterator[None]:
    """What must be on disk before anything is energised; raises RigLocked when it cannot be written."""
    try:
        yield
    except OSError as e:
        raise RigLocked(
            f"{path} cannot be written ({e.strerror or e}). A rig is used only if its lock file can be written: free space on "
            "its disk, or make its folder writable"
        ) from e
