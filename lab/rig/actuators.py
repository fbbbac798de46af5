"""The program's end of the guard: the actuators as the protocols see them, each behind the process boundary.

Commands go through one pipe, one at a time, each answered under its number. Readings and the guard's own messages come
back through a second pipe, the pulse goes out through a third. A guard that ends or falls silent is noticed within two
seconds, by calls under way too, and every later call raises ActuatorsLost.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import Pipe
from typing import Any

import timing
from drivers.interfaces import Identity, Instrument
from timing import RigClock

from ..files.rig_file import RigFile
from ..guard.child import SIGNALS, end_child, processor_time, start_child
from ..guard.commands import Command, Order, R, RemoteArm, RemoteGauge, RemoteLengthUnit, RemoteRegulators, RemoteValve
from ..guard.messages import Event, SafeReport, Start
from ..guard.pulse import Pulse

START_WITHIN = 30.0
"""Host seconds for the guard's process to start and to take the rig over from an earlier one."""
ANSWER_WITHIN = 50.0
"""Host seconds after which a guard that lives and beats but does not answer is given up."""
BEATS_MISSED = 2.0
"""The guard counts as frozen after this many times the rig's `safe.heartbeat` without a sign of life."""
SLICE = 0.05
LIVING_ON: list[subprocess.Popen[bytes]] = []
"""Guards that go on landing their rigs without this program."""


class ActuatorsLost(RuntimeError):
    """The guard is gone or does not answer; this program must land the rig itself."""


class Actuators:
    """The guard of one rig, as a process, and the way to it.

    `on_sample(name, sample)` is called from a thread of its own with every polled reading, or with the InstrumentError
    that took its place; `on_event` with what the guard tells by itself.
    """

    def __init__(
        self,
        rig: RigFile,
        clock: RigClock,
        on_sample: Callable[[str, Any], None],
        on_event: Callable[[Event], None] = lambda event: None,
        despite_latch: bool = False,
    ) -> None:
        """Start the guard as a process of its own, have it take the rig over, and listen to it.

        Raises RigLocked when a person has to see to the rig first, or another program owns it; ConfigError when rig.yaml was
        changed since `rig` was read."""
        self._on_sample, self._on_event = on_sample, on_event
        self._longest_silence = BEATS_MISSED * rig.safe.heartbeat
        self._lock = timing.RLock()
        self._numbers = itertools.count(1)
        pressure = rig.instruments.pressure
        self.pressure = RemoteRegulators(self, "pressure", 0 if pressure is None else len(pressure.chambers))
        self.spine, self.valve = RemoteLengthUnit(self, "spine"), RemoteValve(self, "valve")
        self.gauge, self.arm = RemoteGauge(self, "gauge"), RemoteArm(self, "arm")
        self.last_command: dict[str, float] = {}
        """Host time at which the last command to each instrument ended: no reading comes while it works."""
        self._commands, guard_commands = Pipe()
        self._samples, guard_samples = Pipe(duplex=False)
        guard_pulse, pulse = os.pipe()
        guard_files = (guard_commands.fileno(), guard_pulse, guard_samples.fileno())
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # the guard inherits that: Ctrl-C is not for it
        try:
            with guard_commands, guard_samples, os.fdopen(guard_pulse):
                self._process = start_child("lab.guard.process", guard_files)
        except BaseException:
            self._commands.close()
            self._samples.close()
            os.close(pulse)
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self.pulse = Pulse(pulse)
        self._last_sign = self.pulse.awake.now
        """When the guard last gave a sign of life, on the clock of this process's being awake."""
        self.lost = ""
        """Why the guard is lost; empty while it lives."""
        try:
            command = shlex.join([os.path.basename(sys.argv[0]), *sys.argv[1:]])[:200]
            about = f"{command} (process {os.getpid()}, since {time.strftime('%H:%M')})"  # for others who want the rig
            self._commands.send(Start(str(rig.path), rig.sha256, rig.body.max_pressure, clock.start, despite_latch, about))
            self._answer(0, "start", START_WITHIN)
            self._last_sign = self.pulse.awake.now
        except BaseException:
            self._end()
            self._samples.close()
            raise
        self._reader = timing.Thread(target=self._forward, name="guard-messages", daemon=True)
        self._reader.start()

    def ask(self, command: Command[R]) -> R:
        """Send one command and wait for its result; raises what the driver raised, RigLanded, or ActuatorsLost."""
        result: R = self._sent(command)
        return result

    def _sent(self, asked: Command[Any] | Order) -> Any:
        """Send a command or order and return its answer; one at a time. Raises what it raised there, or ActuatorsLost."""
        with self._lock:
            self.pulse.mark()
            if self.lost:
                raise self._lost(asked)
            number = next(self._numbers)
            try:
                self._commands.send((number, asked))
            except OSError as e:
                self._give_up("it has ended")
                raise self._lost(asked) from e
            try:
                return self._answer(number, asked, ANSWER_WITHIN)
            finally:
                self.pulse.mark()
                if isinstance(asked, Command):
                    self.last_command[asked.instrument] = timing.now()

    def _answer(self, number: int, what: object, within: float) -> Any:
        """The answer to command `number`; answers to commands whose callers were interrupted are dropped."""
        deadline = timing.now() + within
        while True:
            try:
                if timing.readable([self._commands], SLICE):
                    answered, ok, answer = self._commands.recv()
                    if answered != number:
                        continue
                    if ok:
                        return answer
                    raise answer
            except (EOFError, BrokenPipeError, ConnectionResetError) as e:
                self._give_up("it has ended")
                raise self._lost(what) from e
            now = timing.now()
            self.pulse.mark()
            if number:  # 0 answers the start: no sign of life comes before it
                self._listen()
            if now > deadline:
                self._give_up(f"no answer within {within:g} s; {self._pace()}")
            if self.lost:
                raise self._lost(what)

    def _forward(self) -> None:
        """Take what the guard sends until its end."""
        with self._samples, contextlib.suppress(EOFError, OSError):
            while True:
                message = timing.receive(self._samples)
                self._last_sign = self.pulse.awake.now
                if isinstance(message, Event):
                    if message.kind != "beat":
                        self._on_event(message)
                else:
                    self._on_sample(*message)
        self.lost = self.lost or "it has ended"

    def look(self) -> None:
        """Raises ActuatorsLost when the guard is gone or silent."""
        self._listen()
        if self.lost:
            raise self._lost("the experiment")

    def _listen(self) -> None:
        """Give up a guard that was silent for too long while this process was awake to hear it."""
        silent = self.pulse.awake.now - self._last_sign
        if not self.lost and silent > self._longest_silence:
            self._give_up(f"no heartbeat for {silent:.1f} s; {self._pace()}")

    def _pace(self) -> str:
        """How far the guard may have come on this computer, and what to do."""
        had = f"the guard has had {processor_time(self._process):.1f} s of processor time"
        return f"{had}; " + timing.busy_or("run again, and report this if it recurs")

    def _give_up(self, why: str) -> None:
        """The guard is lost for good: a frozen one must not wake up and command behind a successor's back."""
        self.lost = self.lost or why
        with contextlib.suppress(OSError):
            self._process.kill()

    def _lost(self, during: object) -> ActuatorsLost:
        return ActuatorsLost(f"the guard of the actuators was lost during {during}: {self.lost}")

    def open(self, name: str) -> Identity:
        """Connect one instrument."""
        return self.ask(Command(name, Instrument.open))

    def make_safe(self) -> SafeReport:
        """Bring all actuators into the safe state and read it back."""
        report: SafeReport = self._sent(Order.MAKE_SAFE)
        return report

    def pause(self) -> SafeReport:
        """Vent and stop, keep the spine jammed."""
        report: SafeReport = self._sent(Order.PAUSE)
        return report

    def resume(self) -> None:
        """A person has confirmed: reconnect what has to be, take commands again."""
        self._sent(Order.RESUME)

    def close(self) -> str:
        """Land safe and end the process; kills it when it does not end by itself, and raises ActuatorsLost then.

        Returns what is not confirmed safe; the process then lives on for a while and goes on landing it."""
        going = ""
        try:
            going = self._sent(Order.END)
        finally:
            self._end(lives_on=bool(going))
        return going

    def _end(self, lives_on: bool = False) -> None:
        """Close the lines to the guard and wait for its end, unless it lives on to land what is not confirmed safe."""
        self.pulse.close()
        self._commands.close()
        if lives_on:
            LIVING_ON.append(self._process)
            return
        end_child(self._process, 5.0)
