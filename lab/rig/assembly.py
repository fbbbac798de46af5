"""The rig assembled: drivers made from rig.yaml, opened, joined to a recording, and always left safe."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import timing
from drivers.chambers import ChamberMap
from drivers.configs import InstrumentConfig
from drivers.errors import InstrumentError
from drivers.interfaces import Identity, PressureSample
from protocols.bench import Bench, Narrator, Operator, StandFrame
from protocols.steering import Steering
from recordings.errors import RecordingError
from recordings.file.writer import Recorder
from recordings.messages import MessageType, sensor

from ..files.rig_file import SENSORS, RigFile, drivers, found_drivers, present, table_of, within_robot
from ..guard.commands import REMOTES
from ..guard.door import demand_free
from ..guard.guard import LIVES_ON
from ..guard.hosted import HostedArmState
from ..guard.instruments import ACTUATORS, of_driver, owned_names
from ..guard.messages import Event, SafeReport
from ..guard.new_guard import make_safe_after_loss
from ..guard.pulse import ForceLimit
from . import actuators as act
from . import operator as op
from .interrupts import Shielded
from .limits import bodies, wiring
from .real_time import clock_of, demand_fakes, demand_running
from .watch import PatientOperator, RigRecovery, Vital, Watch, WatchedClock

TOPICS = {
    "pressure": "/pressure", "spine": "/spine", "valve": "/valve", "gauge": "/vacuum", "force": "/force", "mocap": "/tip",
    "arm_state": "/arm",
}  # fmt: skip
"""The topic of each instrument's samples, whose attributes have the names of its fields; the lab's own sensors have theirs beside
it."""


def recorded(sample: Any, chambers: ChamberMap) -> Any:
    """The sample as it is recorded: pressures by chamber (1..9) instead of by channel."""
    if isinstance(sample, PressureSample):
        return replace(sample, setpoint=chambers.by_chamber(sample.setpoint), measured=chambers.by_chamber(sample.measured))
    return sample


ORDER = ("gauge", "valve", "pressure", "spine", "force", "mocap", "arm_state", "arm")
"""The order of connecting: what only reads or holds nothing first, what moves last; the lab's own sensors follow the first."""


class Rig(contextlib.AbstractContextManager["Rig"]):
    """All instruments of one rig.yaml. Use as a context: leaving it lands the rig safe and disconnects."""

    def __init__(self, file: RigFile, despite_latch: bool = False, prepared: bool = False) -> None:
        """`prepared`: nobody at the console is asked to prepare it. Raises RigLocked when the rig is in use, or when a person
        has to see to it first unless `despite_latch`; ConfigError when its clock is for fakes and an instrument is none."""
        robot = file.body
        self.read = file
        self.file = file = within_robot(file, robot.max_pressure)
        self.clock = clock_of(file)
        demand_free(owned_names(file), file.path)
        self.identities: dict[str, Identity] = {}
        self.counts: dict[str, int] = {}
        self.notices: list[str] = []
        """What drivers noticed beside their samples; each stands in the recording as a warning."""
        self.vital = Vital()
        self.stop_now: Callable[[], bool] = lambda: False
        """True once a person wants everything to stop at once."""
        doubts = found_drivers().doubts
        used = {name: table_of(file.instruments, name).driver for name in present(file.instruments)}
        self.notices += [f"{name}: {doubts[driver]}" for name, driver in used.items() if driver in doubts]
        self.operator: Operator = op.operator(file.operator, prepared)
        self._after_loss: SafeReport | None = None
        """The landing by this program after its guard was lost."""
        self._recorder: Recorder | None = None
        self._sinks: dict[str, Callable[[Any], None]] = {}
        self._lock = timing.Lock()
        instruments = file.instruments
        self.chambers = wiring(file, robot)
        self.actuators = act.Actuators(file, self.clock, self._polled, self._guard_event, despite_latch)
        self.streams: dict[str, Any] = {}
        self.sensors: dict[str, MessageType] = {}
        """The messages of the lab's own sensors, by instrument."""
        self.watch = Watch(self.actuators, self.vital, self.streams, file.limits, lambda: self.stop_now())
        self._force = ForceLimit(file.limits, instruments.force, self.actuators.pulse) if instruments.force else None
        for name in present(instruments):
            if name not in REMOTES:
                self._stream(name, table_of(instruments, name))
        if instruments.arm:
            self.streams["arm_state"] = HostedArmState(
                "arm_state", instruments.arm, self.clock, functools.partial(self._take, "arm_state")
            )

    def _stream(self, name: str, config: InstrumentConfig) -> None:
        """Make the driver of an instrument that sends by itself."""
        driver = drivers()[config.driver]
        if name.startswith(SENSORS):
            self.sensors[name] = sensor(name.removeprefix(SENSORS), driver.quantities)
        self.streams[name] = driver.make(name, config, self.clock, functools.partial(self._take, name), self._driver_notice)

    @property
    def names(self) -> list[str]:
        """The instruments that rig.yaml has, in the order of connecting."""
        there = {*present(self.file.instruments), *self.streams}
        return [n for n in (ORDER[0], *self.sensors, *ORDER[1:]) if n in there]

    def open(self, name: str) -> Identity:
        """Connect one instrument; raises InstrumentError, and ConfigError where only a fake may be."""
        key = "arm" if name == "arm_state" else name
        demand_fakes(self.file, key)
        if name == "force" and self._force is not None:
            self._force.begin()
        try:
            identity: Identity = self.streams[name].open() if name in self.streams else self.actuators.open(name)
        except Exception as e:
            raise of_driver(name, table_of(self.file.instruments, key), e) from e
        self.identities[name] = identity
        return identity

    def needed(self, needs: Sequence[str]) -> list[str]:
        """Of what the rig has, what a protocol with these needs opens: the lab's sensors and (to be vented) regulators, too."""
        wanted = {*needs, "pressure", *self.sensors, *(("arm_state",) if "arm" in needs else ())}
        return [name for name in self.names if name in wanted]

    def open_all(self, say: Callable[[str], object], names: Sequence[str] | None = None) -> dict[str, InstrumentError]:
        """Connect everything, or `names`, saying what each is; returns what failed, by name. Raises ConfigError where fakes
        ended."""
        demand_running(self.file)
        failures: dict[str, InstrumentError] = {}
        for name in self.names if names is None else names:
            try:
                identity = self.open(name)
                say(f"  {name}: {identity.maker} {identity.model} {identity.serial}".rstrip())
            except InstrumentError as e:
                failures[name] = e
        return failures

    # -- samples
    def recorder(self, file: Path, **about: Any) -> Recorder:
        """A recording of this rig that begins now; `about`: the other arguments of `Recorder`."""
        begun = self.clock.now()
        return Recorder(
            file, start_wall_ns=time.time_ns() - round(begun * 1e9), start=begun, chambers=self.chambers.count,
            markers=len(getattr(self.file.instruments.mocap, "markers", ()) or ()), sensors=tuple(self.sensors.values()), **about,
        )  # fmt: skip

    def record_to(self, recorder: Recorder | None) -> None:
        """From now on every sample goes to this recording (None: to none)."""
        topics = (*TOPICS.values(), *(message.topic for message in self.sensors.values()))
        sinks = {topic: recorder.sink(topic) for topic in topics} if recorder is not None else {}
        with self._lock:
            self._sinks = sinks
            self._recorder = recorder
            known = tuple(self.notices)
        for text in known:
            _warn(recorder, text)

    def _take(self, name: str, sample: Any) -> None:
        """Judge, count and record a sample of an instrument."""
        if name == "force" and self._force is not None:
            self._force.judge(sample)
        topic = self.topic(name)
        with self._lock:
            self.counts[topic] = self.counts.get(topic, 0) + 1
            sink = self._sinks.get(topic)
            if sink is not None:
                sink(recorded(sample, self.chambers))

    def _polled(self, name: str, sample: Any) -> None:
        if isinstance(sample, InstrumentError):
            self.vital.errors[name] = sample
            return
        self.vital.errors.pop(name, None)
        self.vital.heard[name] = timing.now()
        if name == "gauge":
            self.vital.repeats.take(sample.absolute, self.vital.heard[name])
        self._take(name, sample)

    def _guard_event(self, event: Event) -> None:
        """Act on a message that the guard sends by itself, see `Event`: leave it for the watch, and record a warning."""
        if event.kind == "landed":
            self.vital.landed = event
        elif event.kind == "pause":
            self.vital.pause = event
        if event.kind in ("landed", "confirmed", "clipped", "waiting"):
            _warn(self._recorder, f"{event.text}: {event.report.said}" if event.report is not None else event.text)
        elif event.kind == "notice":
            self._driver_notice(event.text)

    def _driver_notice(self, text: str) -> None:
        with self._lock:
            self.notices.append(text)
            recorder = self._recorder
        _warn(recorder, text)

    def lost(self) -> dict[str, int]:
        """Samples that the streaming drivers know to be lost, by topic."""
        return {self.topic(name): driver.lost for name, driver in self.streams.items() if name in self.identities}

    def topic(self, name: str) -> str:
        """Where an instrument's samples are recorded; empty for one that has none."""
        return self.sensors[name].topic if name in self.sensors else TOPICS.get(name, "")

    # -- protocols
    def bench(
        self,
        recorder: Recorder,
        narrator: Narrator,
        stopping: Callable[[], bool],
        needs: Sequence[str] = (),
        steering: Steering | None = None,
        asked: Callable[[], AbstractContextManager[object]] = contextlib.nullcontext,
    ) -> Bench:
        """What a protocol gets: the opened instruments only. Those that it `needs` are watched while it waits.

        `stopping`: whether the run shall end; `steering`: what people ask of it; `asked`: entered while the operator is asked."""
        steering = Steering() if steering is None else steering
        has = self.identities.__contains__  # whether an instrument was opened
        stand = self.file.stand
        operator = PatientOperator(self.operator, self.actuators.pulse, asked)

        def say(text: str) -> None:
            narrator.say(text)
            recorder.log("warning", text, self.clock.now())

        recovery = RigRecovery(self.actuators, self.watch, operator, self.file.limits, say)

        def rest() -> None:
            with steering.rest():
                recovery.rest(lambda: steering.wants("go on"), stopping)

        self.vital.landed = None
        sensors = [n for n in self.sensors if has(n)]
        self.watch.over([*(n for n in needs if has(n)), *sensors])
        opened = {name: self.streams.get(name) or getattr(self.actuators, name) for name in ORDER if has(name)}
        return Bench(
            clock=WatchedClock(self.clock, self.actuators, self.watch),
            recorder=recorder,
            operator=operator,
            narrator=narrator,
            stopping=stopping,
            recoverable=self.watch.recoverable,
            recover=recovery,
            repeatable=self.watch.repeatable,
            stood=lambda: self.watch.stood * self.clock.speed,
            steering=steering,
            rest=rest,
            chambers=self.chambers,
            stand=None if stand is None else StandFrame(**stand.model_dump(exclude={"position_sd"})),
            sensors=tuple(self.sensors[n].topic for n in sensors),
            bodies=bodies(self.file, self.file.body) if has("mocap") else None,
            **opened,
        )

    def __repr__(self) -> str:
        opened = ", ".join(f"{name} ({i.model})" for name, i in self.identities.items())
        return f"<Rig of {self.file.path or 'no file'}: {opened or 'not connected'}>"

    # -- the end
    def make_safe(self) -> SafeReport:
        """Bring the actuators into the safe state, confirmed by reading back; by a new guard when the first is lost."""
        try:
            return self.actuators.make_safe()
        except act.ActuatorsLost:
            self._after_loss = make_safe_after_loss(self.file, self.clock, [n for n in ACTUATORS if n in self.identities])
            return self._after_loss

    def close(self) -> None:
        """Land safe and disconnect everything; never raises."""
        self.record_to(None)
        with Shielded():
            with contextlib.suppress(Exception):
                self._close_actuators()
            for driver in self.streams.values():
                with contextlib.suppress(Exception):
                    driver.close()

    def _close_actuators(self) -> None:
        """By the guard; by this program when the guard was lost and nobody has landed the rig since."""
        try:
            going = self.actuators.close()
        except act.ActuatorsLost:
            if self._after_loss is None:
                self.make_safe()
            return
        if going:
            self.notices.append(
                f"not confirmed safe: {going}. The guard tries again for another {LIVES_ON:g} s and logs the result in "
                f"{self.file.path and self.file.path.with_suffix('.guard.log')}"
            )

    def __exit__(self, *_: object) -> None:
        self.close()


def _warn(recorder: Recorder | None, text: str) -> None:
    if recorder is not None:
        with contextlib.suppress(RecordingError):
            recorder.log("warning", text)


def newly_lost(before: int, now: int) -> int:
    """Samples lost since a driver had counted `before` of them: one that was opened again counts from zero."""
    return now - before if now >= before else now
