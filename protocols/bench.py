"""What a protocol works with: the rig's instruments, its clock, the recording, and the person at the rig."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, TypeVar

import timing
from drivers.chambers import ChamberMap
from drivers.errors import InstrumentError
from drivers.interfaces import (
    Arm,
    ArmState,
    ForceSensor,
    JammingValve,
    LengthUnit,
    MotionCapture,
    PressureRegulators,
    VacuumGauge,
    Vector3,
)
from recordings.file.writer import Recorder
from recordings.states.demands import Bodies, VacuumBand
from timing import Clock

from .errors import MissingInstrument, NotReached, Stopped
from .steering import Steering

T = TypeVar("T")


@dataclass(frozen=True)
class Jammed:
    """How the spine was jammed last."""

    ambient: float
    """Pa absolute."""
    vacuum: VacuumBand
    """What it must keep."""
    soft: bool = False
    """Its shape or its resistance showed that it is soft, even if the gauge shows its vacuum."""


Mount = Literal["robot", "body", "spine"]
INSTRUMENTS = ("pressure", "spine", "valve", "gauge", "arm", "arm_state", "force", "mocap")
"""What a protocol may need, by its key in rig.yaml."""


@dataclass(frozen=True)
class Setup:
    """What a person prepares before a run."""

    mount: Mount
    """"robot": body with the spine inside; "body": the same at the stiffness stand; "spine": the bare spine."""
    tip_mass: float
    """Mass hung at the tip, kg."""
    roll_deg: float
    """The chamber pattern turned about the robot's axis, deg."""
    vacuum: float
    """Level set at the vacuum supply, Pa below ambient."""


class Operator(Protocol):
    """The person (or program) who mounts and prepares."""

    def prepare(self, setup: Setup) -> None:
        """Returns when the rig is set up so; raises Stopped when it will not be."""

    def confirm(self, trouble: str) -> None:
        """Returns when a person has put the trouble right and is out of the way; raises Stopped when it will not be."""


@dataclass(frozen=True)
class StandFrame:
    """Where the specimen of a stiffness trial is clamped, in the arm's base frame (m, unit vectors, rotation vector rad)."""

    origin: Vector3
    axis: Vector3
    push: Vector3
    tool_rotation: Vector3
    standoff: float


class Narrator(Protocol):
    """Tells the person what happens."""

    def say(self, text: str) -> None:
        """One line of what is being done."""

    def progress(self, done: float, total: float) -> None:
        """Seconds of rig time done, of the total planned."""


@dataclass
class Bench:
    """Everything a protocol may touch. A missing instrument is None: use `need`."""

    clock: Clock
    recorder: Recorder
    operator: Operator
    narrator: Narrator
    stopping: Callable[[], bool]
    """True once a person asked to end after this step."""
    recoverable: Callable[[InstrumentError], bool]
    """Whether a person can put right an instrument's error without losing data."""
    recover: Callable[[InstrumentError, bool], None]
    """Vent and stop, have a person put it right unless the second argument is False; raises a cause that stays."""
    chambers: ChamberMap
    stand: StandFrame | None = None
    pressure: PressureRegulators | None = None
    spine: LengthUnit | None = None
    valve: JammingValve | None = None
    gauge: VacuumGauge | None = None
    arm: Arm | None = None
    arm_state: ArmState | None = None
    force: ForceSensor | None = None
    mocap: MotionCapture | None = None
    sensors: tuple[str, ...] = ()
    """Topics of the lab's own sensors."""
    steering: Steering = field(default_factory=Steering)
    """What people ask of the run."""
    rest: Callable[[], None] = lambda: None
    """The pause that a person asked for. Raises Stopped, or what has failed."""
    repeatable: Callable[[], AbstractContextManager[object]] = nullcontext
    """Context that may be begun again: a standstill of this computer raises StoodStill there."""
    stood: Callable[[], float] = lambda: 0.0
    """Rig s for which this computer has stood still; no deadline counts them."""
    patience: float = 5.0
    """Least host time for a condition, s."""
    clipped: bool = False
    """The rig's limits clipped the last ramp."""
    jammed: Jammed | None = None
    """None while no vacuum is judged."""
    bodies: Bodies | None = None
    """Where tip and markers can be; None without cameras or where robot.yaml says too little."""

    def has_topic(self, topic: str) -> bool:
        """Whether the instrument behind a topic is there."""
        return {"/spine": self.spine, "/vacuum": self.gauge}.get(topic, self) is not None

    def look_anew(self) -> None:
        """People may have been at the robot: judge jumps from now on."""
        if self.bodies is not None:
            self.bodies = replace(self.bodies, since=self.clock.now())

    def need(self, instrument: T | None, name: str) -> T:
        """The instrument, or MissingInstrument."""
        if instrument is None:
            raise MissingInstrument(
                f"{name}: this protocol uses it, and it is not open; name it in NEEDS, and describe it in rig.yaml"
            )
        return instrument

    def check_stop(self) -> None:
        """Raise Stopped between two steps when a person asked for it."""
        if self.stopping():
            raise Stopped("stopped by the operator; the steps finished so far are in the recording")

    def say(self, text: str) -> None:
        """Tell the person, and write it to the recording's log."""
        self.narrator.say(text)
        self.recorder.log("info", text, self.clock.now())

    def pause(self, duration: float) -> None:
        """Wait `duration` s of rig time; WriteFailed when the recording fails."""
        end = self.clock.now() + duration
        while (left := end - self.clock.now()) > 0:
            self.recorder.check()
            self.clock.sleep(min(left, 0.2))

    def wait(self, what: str, done: Callable[[], T | None], within: float, describe: Callable[[], str] | None = None) -> T:
        """Wait until `done` returns something; NotReached after `within` s of rig time, with the text of `describe`."""
        deadline, patience = self.clock.now() - self.stood() + within, timing.now() + min(within, self.patience)
        while True:
            self.recorder.check()
            result = done()
            if result is not None:
                return result
            if self.clock.now() - self.stood() > deadline and timing.now() > patience:
                reached = f": {describe()}" if describe is not None else ""
                raise NotReached(f"{what}: not reached within {within:g} s{reached}")
            self.clock.sleep(min(0.05, within / 20))
