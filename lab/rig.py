"""The rig assembled: drivers made from rig.yaml, opened, joined to a recording, and always left safe."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

from drivers import ft300s, natnet_mocap, ur5_state
from drivers.chambers import ChamberMap
from drivers.errors import InstrumentError
from drivers.interfaces import Identity
from protocols.bench import Bench, Narrator, StandFrame
from recordings.writer import Recorder

from . import actuators as act
from . import operator as op
from .clock import RigClock
from .rig_file import RigFile
from .streams import TOPICS, recorded

ORDER = ("gauge", "valve", "pressure", "spine", "force", "mocap", "arm_state", "arm")
"""The order of connecting: what only reads or holds nothing first, what moves last."""


class Rig:
    """All instruments of one rig.yaml. Use as a context: leaving it lands the rig safe and disconnects."""

    def __init__(self, file: RigFile) -> None:
        self.file = file
        self.clock = RigClock(file.clock.speed)
        self.identities: dict[str, Identity] = {}
        self.counts: dict[str, int] = {}
        self.poll_errors: dict[str, InstrumentError] = {}
        self._sinks: dict[str, Callable[[Any], None]] = {}
        self._lock = threading.Lock()
        instruments = file.instruments
        self.chambers = ChamberMap(instruments.pressure.chambers if instruments.pressure else ())
        self.actuators = act.Actuators(file, self.clock, self._polled)
        self.streams: dict[str, Any] = {}
        if instruments.force:
            self.streams["force"] = ft300s.FT300S("force", instruments.force, self.clock, self._sink)
        if instruments.mocap:
            self.streams["mocap"] = natnet_mocap.NatNetMocap("mocap", instruments.mocap, self.clock, self._sink)
        if instruments.arm:
            state = ur5_state.Config(host=instruments.arm.host, max_age=instruments.arm.max_age)
            self.streams["arm_state"] = ur5_state.UR5State("arm_state", state, self.clock, self._sink)

    @property
    def names(self) -> list[str]:
        """The instruments that rig.yaml has, in the order of connecting."""
        present = [n for n in act.COMMANDS if getattr(self.file.instruments, n) is not None]
        return [n for n in ORDER if n in present or n in self.streams]

    def open(self, name: str) -> Identity:
        """Connect one instrument; raises InstrumentError."""
        identity: Identity = self.streams[name].open() if name in self.streams else self.actuators.open(name)
        self.identities[name] = identity
        return identity

    def open_all(self, announce: Callable[[str, Identity | InstrumentError], None]) -> list[InstrumentError]:
        """Connect everything, telling each outcome; returns what failed."""
        failures: list[InstrumentError] = []
        for name in self.names:
            try:
                announce(name, self.open(name))
            except InstrumentError as e:
                failures.append(e)
                announce(name, e)
        return failures

    # -- samples
    def record_to(self, recorder: Recorder | None) -> None:
        """From now on every sample goes to this recording (None: to none)."""
        sinks = {topic: recorder.sink(topic) for topic in TOPICS.values()} if recorder is not None else {}
        with self._lock:
            self._sinks = sinks

    def _sink(self, sample: Any) -> None:
        topic = TOPICS[type(sample)]
        with self._lock:
            self.counts[topic] = self.counts.get(topic, 0) + 1
            sink = self._sinks.get(topic)
            if sink is not None:
                sink(recorded(sample, self.chambers))

    def _polled(self, name: str, sample: Any) -> None:
        if isinstance(sample, InstrumentError):
            self.poll_errors[name] = sample
            return
        self.poll_errors.pop(name, None)
        self._sink(sample)

    def lost(self) -> dict[str, int]:
        """Samples that the streaming drivers know to be lost, by topic."""
        topics = {"force": "/force", "mocap": "/tip", "arm_state": "/arm"}
        return {topics[name]: driver.lost for name, driver in self.streams.items() if name in self.identities}

    # -- protocols
    def bench(self, recorder: Recorder, narrator: Narrator, stopping: Callable[[], bool]) -> Bench:
        """What a protocol gets: the opened instruments only."""
        has = self.identities.__contains__
        stand = self.file.stand
        return Bench(
            clock=self.clock,
            recorder=recorder,
            operator=op.operator(self.file.operator),
            narrator=narrator,
            stopping=stopping,
            chambers=self.chambers,
            stand=StandFrame(stand.origin, stand.axis, stand.push, stand.tool_rotation, stand.standoff)
            if stand
            else None,
            pressure=act.Pressure(self.actuators, len(self.chambers.channels)) if has("pressure") else None,
            spine=act.Spine(self.actuators) if has("spine") else None,
            valve=act.Valve(self.actuators) if has("valve") else None,
            gauge=act.Gauge(self.actuators) if has("gauge") else None,
            arm=act.ArmMotion(self.actuators) if has("arm") else None,
            arm_state=self.streams["arm_state"] if has("arm_state") else None,
            force=self.streams["force"] if has("force") else None,
            mocap=self.streams["mocap"] if has("mocap") else None,
        )

    # -- the end
    def safe(self) -> act.SafeReport:
        """Bring the actuators into the safe state, confirmed by reading back."""
        return self.actuators.safe()

    def close(self) -> None:
        """Land safe and disconnect everything; never raises."""
        self.record_to(None)
        with contextlib.suppress(Exception):
            self.actuators.close()
        for driver in self.streams.values():
            with contextlib.suppress(Exception):
                driver.close()

    def __enter__(self) -> Rig:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
