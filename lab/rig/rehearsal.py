"""A run at the desk: a protocol's own `run`, with instruments that answer at once and move nothing.

Set-points are reached as they are set, time jumps where the protocol waits, the tip hangs straight, and the specimen of the
stand pushes back like a spring. So nothing that a protocol does with values measured there is more than an example.
"""

from __future__ import annotations

import math
import tempfile
import time
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.chambers import ChamberMap
from drivers.errors import InstrumentError, NotReady
from drivers.frames import rotation_from_vector
from drivers.interfaces import (
    ArmSample,
    BodySample,
    GaugeSample,
    Identity,
    PressureSample,
    SpineSample,
    ValveSample,
    Vector3,
    Vector6,
    WrenchSample,
)
from protocols.bench import Bench, Setup, StandFrame
from protocols.errors import BadProtocol, NotReached, Stopped
from protocols.experiment import Plan, Trials
from protocols.parameters import Parameters
from protocols.registry import Experiment
from recordings.ambient import AMBIENT
from recordings.file.writer import Recorder
from recordings.messages import MessageType, sensor, streams
from recordings.states.buffer import Buffers
from recordings.trials import TrialRow

from ..console import Screen
from ..files.packages import told_at
from ..files.rig_file import RigFile, drivers, present
from .assembly import TOPICS, recorded
from .limits import bodies, wiring

RATE = 100.0
"""Samples of each stream in a rig second."""
AT_DESK = "; in a rehearsal set-points are reached at once, and the robot never moves"
ZERO: Vector6 = (0.0,) * 6
SPECIMEN_STIFFNESS = 300.0
"""N/m of the stand's specimen: a push is felt in its first steps, and far below any limit in its last."""


def rehearse(experiment: Experiment, parameters: Parameters, plan: Plan, rig: RigFile) -> tuple[list[TrialRow], float]:
    """Do a protocol's `run` at the desk of a rig; returns the states that it read, and its largest set-point, Pa.

    Raises BadProtocol, naming the line, for whatever the protocol raises."""
    markers = len(getattr(rig.instruments.mocap, "markers", ()) or ())
    sensors = [sensor(name, drivers()[c.driver].quantities) for name, c in rig.instruments.sensors.items()]
    desk = Desk(rig, plan, markers, sensors)
    with (
        tempfile.TemporaryDirectory() as folder,
        Recorder(
            Path(folder) / "rehearsal.mcap", start_wall_ns=time.time_ns(), chambers=desk.chambers.count, markers=markers,
            sensors=sensors,
        ) as recorder,
    ):  # fmt: skip
        recorder.buffers = desk.readings
        trials = AsPlanned(desk.bench(recorder, experiment.needs), plan)
        try:
            experiment.run(trials.bench, parameters, trials)
        except (Exception, SystemExit) as error:
            of_run: Any = getattr(getattr(experiment.run, "__code__", None), "co_filename", experiment.name)
            file = experiment.source or of_run  # whose line the error names
            raise BadProtocol(told_at(error, file, AT_DESK if isinstance(error, NotReached) else "")) from error
    return trials.rows, desk.highest_setpoint


class AsPlanned(Trials):
    """Trials that read no more states than the plan lists, where it lists any."""

    def read(self, *args: Any, **kwargs: Any) -> TrialRow:
        """See Trials. Raises BadProtocol beyond the planned states."""
        row = super().read(*args, **kwargs)
        if any(step.reads for step in self.plan.steps) and len(self.rows) > self.plan.states:
            raise BadProtocol(f"reads state {len(self.rows)}, and plan lists {self.plan.states}; add it to the reads of its Step")
        return row


class DeskClock:
    """Rig time that jumps where somebody waits; raises TimeoutError after `longest` s."""

    def __init__(self, longest: float) -> None:
        self._t, self._longest, self.speed = 0.0, longest, 1.0

    def now(self) -> float:
        """Rig time, s."""
        return self._t

    def sleep(self, duration: float) -> None:
        """At least `duration` seconds pass."""
        self._t += max(duration, 0.5)
        if self._t > self._longest:
            raise TimeoutError(f"run has not ended after {self._longest / 3600:.3g} h of rig time; does it wait for ever?")


class DeskStreams(Buffers):
    """The streams of instruments, made when somebody reads them: each goes on with what it showed last."""

    def __init__(self, messages: dict[str, MessageType], clock: DeskClock) -> None:
        super().__init__(messages)
        self._clock = clock
        self._shown: dict[str, tuple[list[float], list[NDArray[np.void]]]] = {}
        """By topic, since when (s) which sample was shown."""

    def show(self, topic: str, sample: object) -> None:
        """From now on a stream shows this sample."""
        message = self[topic].message
        row = np.zeros((), message.dtype)
        for name in message.value_names:
            row[name] = np.reshape(getattr(sample, name), row[name].shape)
        since, rows = self._shown.setdefault(topic, ([], []))
        since.append(self._clock.now())
        rows.append(row)

    def newest(self, topic: str) -> float:
        """See Buffers."""
        return math.floor(self._clock.now() * RATE) / RATE if topic in self._shown else -math.inf

    def window(self, topic: str, t0: float, t1: float) -> NDArray[np.void]:
        """See Buffers."""
        first, end = math.ceil(max(t0, 0.0) * RATE - 1e-6), math.floor(min(t1, self.newest(topic)) * RATE + 1e-6) + 1
        message = self[topic].message
        if end <= first:
            return np.zeros(0, message.dtype)
        t = np.arange(first, end) / RATE
        since, rows = self._shown[topic]
        some = slice(max(bisect_right(since, t[0]) - 1, 0), bisect_right(since, t[-1]))
        found = np.array(rows[some], message.dtype)[np.searchsorted(since[some], t, side="right") - 1]
        found["t"] = t
        return found


class Desk:
    """Instruments, clock and person of a rehearsal."""

    def __init__(self, rig: RigFile, plan: Plan, markers: int, sensors: Sequence[MessageType]) -> None:
        self.rig, self.sensors = rig, sensors
        # a rehearsal that takes ten times as long as planned, an hour at least, is given up
        self.clock = DeskClock(max(10.0 * plan.seconds, 3600.0))
        self.chambers: ChamberMap = wiring(rig, rig.body)
        self.readings = DeskStreams(streams(self.chambers.count, markers, sensors), self.clock)
        # Pa below ambient, where neither plan nor set-up names a vacuum
        self.vacuum = max((step.ask.vacuum or 0.0 for step in plan.steps), default=0.0) or 80e3
        self.highest_setpoint = 0.0
        self.on_flange = any(step.ask.poses for step in plan.steps)
        self.stand = None if rig.stand is None else StandFrame(**rig.stand.model_dump(exclude={"position_sd"}))
        self.places = bodies(rig, rig.body)
        channels = (0.0,) * len(self.chambers.channels)
        along = [(0.0, 0.0, rig.body.length * (i + 1) / (markers + 1)) for i in range(markers)]
        marker_positions = tuple(along if len(self.places.arcs) == 1 else map(tuple, rig.body.marker_places().tolist()))
        self.pressure = DeskInstrument(
            self, "pressure", PressureSample(0.0, channels, channels), set=self._inflate, vent=lambda: self._inflate(channels)
        )
        self.spine = DeskInstrument(
            self, "spine", SpineSample(0.0, 0.0, 0.0, 0.0, False, False), move_to=self._grow, stop=lambda: None,
            home=lambda: self.spine.show(length=0.0, goal=0.0, homed=True),
        )  # fmt: skip
        self.valve = DeskInstrument(self, "valve", ValveSample(0.0, False), set=self._switch)
        self.gauge = DeskInstrument(self, "gauge", GaugeSample(0.0, AMBIENT))
        self.force = DeskInstrument(self, "force", WrenchSample(0.0, ZERO, ZERO), zero=self._zero)
        self.arm_state = DeskInstrument(self, "arm_state", ArmSample(0.0, 0.0, ZERO, ZERO, ZERO, 0, True))
        self.arm = DeskInstrument(self, "arm", None, move_to=self._reach, moving=lambda: False, stop=lambda: None)
        tip: Vector3 = (0.0, 0.0, rig.body.length)
        sample = BodySample(0.0, 0.0, 0, tip, (1.0, 0.0, 0.0, 0.0), 0.0, True, marker_positions)
        self.mocap = DeskInstrument(self, "mocap", sample)

    def bench(self, recorder: Recorder, needs: Sequence[str]) -> Bench:
        """What a protocol with these needs gets on the rig: the regulators in any case."""
        has = {*needs, "pressure", *(("arm_state",) if "arm" in needs else ())}
        there = present(self.rig.instruments)
        opened = {name: getattr(self, name) for name in has if name.removesuffix("_state") in there}
        for instrument in opened.values():
            instrument.open()
        for message in self.sensors:
            self.readings.show(message.topic, SimpleNamespace(**dict.fromkeys(message.value_names, 0.0)))
        return Bench(
            clock=self.clock, recorder=recorder, operator=self, narrator=Screen("rehearsal", quiet=True),
            stopping=lambda: False, recoverable=lambda error: False, recover=_fail, chambers=self.chambers, stand=self.stand,
            sensors=tuple(message.topic for message in self.sensors), patience=0.0,
            bodies=self.places if "mocap" in opened else None, **opened,
        )  # fmt: skip

    def prepare(self, setup: Setup) -> None:
        """See Operator."""
        self.vacuum = setup.vacuum

    def confirm(self, trouble: str) -> None:
        """See Operator."""
        raise Stopped(trouble)

    def _inflate(self, pressures: Sequence[float]) -> tuple[float, ...]:
        """Each channel has its pressure (Pa) at once."""
        confirmed = tuple(map(float, pressures))
        self.pressure.show(setpoint=confirmed, measured=confirmed)
        self.highest_setpoint = max(self.highest_setpoint, *confirmed)
        return confirmed

    def _grow(self, length: float, speed: float) -> float:
        """The spine has its length (m) at once."""
        if not self.spine.sample.homed:
            raise NotReady("spine", "is not homed; call home(bench) first")
        self.spine.show(length=float(length), goal=float(length))
        return float(length)

    def _switch(self, on: bool) -> bool:
        """The gauge follows the valve at once."""
        self.valve.show(on=on)
        self.gauge.show(absolute=AMBIENT - self.vacuum * on)
        return on

    def _zero(self, samples: int) -> Vector6:
        """What the force sensor shows now counts as nothing."""
        self.force.show(zero=self.force.sample.raw)
        zero: Vector6 = self.force.sample.zero
        return zero

    def _reach(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        """The arm has its pose (m, rad) at once; the force is -k h d at a depth h past the stand's origin along the push d."""
        x, y, z, *turn = map(float, pose)
        self.arm_state.show(tcp_pose=(x, y, z, *turn))
        if self.on_flange:
            self.mocap.show(position=(x, y, z))
        if self.stand is not None:
            direction, tool = np.array(self.stand.push), rotation_from_vector(turn)
            depth = sum((a - o) * d for a, o, d in zip((x, y, z), self.stand.origin, self.stand.push, strict=True))
            self.force.show(raw=(*(-SPECIMEN_STIFFNESS * max(0.0, depth) * direction @ tool).tolist(), 0.0, 0.0, 0.0))


def _fail(error: InstrumentError, _: bool) -> None:
    raise error


class DeskInstrument:
    """One that answers at once, with its last sample; `actions`: what else its interface in `drivers.interfaces` asks for."""

    lost = 0

    def __init__(self, desk: Desk, name: str, sample: Any, **actions: Callable[..., object]) -> None:
        self.desk, self.name, self.sample = desk, name, sample
        self.channels = len(desk.chambers.channels)
        self._open = False
        vars(self).update(actions)

    def open(self) -> Identity:
        """From now on it streams."""
        self._open = True
        self.show()
        return Identity("", "")

    def close(self) -> None:
        """Nothing is to be landed."""

    def show(self, **changes: object) -> None:
        """From now on its sample has these values."""
        self.sample = self.sample and replace(self.sample, **changes)
        if self._open and self.name in TOPICS:
            self.desk.readings.show(TOPICS[self.name], recorded(self.sample, self.desk.chambers))

    def read(self) -> Any:
        """The sample of now."""
        return replace(self.sample, t=self.desk.clock.now())

    latest = read
