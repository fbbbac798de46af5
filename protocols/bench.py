"""What a protocol works with: the rig's instruments, its clock, the recording, and the person at the rig."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, TypeVar

from drivers.chambers import ChamberMap
from drivers.errors import InstrumentError
from drivers.interfaces import (
    Arm,
    ArmState,
    Clock,
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
    """It showed that it is soft, whatever the gauge shows."""


Mount = Literal["robot", "body", "spine"]
INSTRUMENTS = ("pressure", "spine", "valve", "gauge", "arm", "arm_state", "force", "mocap")
"""What a protocol may need, by its key in rig.yaml."""


@dataclass(frozen=True)
class Setup:
    """What a person prepares before a run."""

    mount: Mount
    """"robot": body hanging with the spine inside; "body": the same at the stiffness stand; "spine": the bare spine."""
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
    """Everything a protocol may touch. An instrument that the rig has not is None; ask with `need` first."""

    clock: Clock
    recorder: Recorder
    operator: Operator
    narrator: Narrator
    stopping: Callable[[], bool]
    """True once a person asked to finish the present step and end."""
    recoverable: Callable[[InstrumentError], bool]
    """Whether a person can put right what an instrument complains of, without losing what was measured."""
    recover: Callable[[InstrumentError, bool], None]
    """Vent and stop, have a person put right what is wrong unless the second argument is False, and be ready to go on; raises
    the cause when it stays."""
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
    """Topics of the lab's own sensors; every state is read with them."""
    steering: Steering = field(default_factory=Steering)
    """What people ask of the run."""
    rest: Callable[[], None] = lambda: None
    """The pause that a person asked for: vent and stop until somebody wants to go on. Raises Stopped, or what has failed."""
    repeatable: Callable[[], AbstractContextManager[object]] = nullcontext
    """What is done in it may be begun again: there alone a standstill of this computer raises StoodStill."""
    stood: Callable[[], float] = lambda: 0.0
    """Rig seconds for which this computer has stood still until now; no deadline counts them."""
    patience: float = 5.0
    """s of host time that a condition is given at least: at a high speed of the rig's clock the wires need theirs."""
    clipped: bool = False
    """The last ramp's set-points were clipped on their way by the rig's limits."""
    jammed: Jammed | None = None
    """None while the spine is released or was jammed without vacuum: then no vacuum is judged."""

    bodies: Bodies | None = None
    """Where the robot allows tip and markers to be; None where no cameras see them, or robot.yaml says too little."""

    def has_topic(self, topic: str) -> bool:
        """Whether the instrument behind a topic is there: a robot without a spine has neither /spine nor /vacuum."""
        return {"/spine": self.spine, "/vacuum": self.gauge}.get(topic, self) is not None

    def look_anew(self) -> None:
        """People may have been at the robot: from now on no body may jump."""
        if self.bodies is not None:
            self.bodies = replace(self.bodies, since=self.clock.now())

    def need(self, instrument: T | None, name: str) -> T:
        """The instrument, or MissingInstrument naming what NEEDS or rig.yaml lacks."""
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
        """Wait `duration` seconds of rig time; WriteFailed within a fifth of a second when the recording fails."""
        end = self.clock.now() + duration
        while (left := end - self.clock.now()) > 0:
            self.recorder.check()
            self.clock.sleep(min(left, 0.2))

    def wait(self, what: str, done: Callable[[], T | None], within: float, stood: Callable[[], str] | None = None) -> T:
        """Look until `done` returns something else than None; `stood` says how far it got, when it is too late.

        NotReached after `within` seconds of rig time; WriteFailed when the recording fails meanwhile.
        """
        deadline, patience = self.clock.now() - self.stood() + within, time.monotonic() + min(within, self.patience)
        while True:
            self.recorder.check()
            result = done()
            if result is not None:
                return result
            if self.clock.now() - self.stood() > deadline and time.monotonic() > patience:
                far = f": {stood()}" if stood is not None else ""
                raise NotReached(f"{what}: not reached within {within:g} s{far}")
            self.clock.sleep(min(0.05, within / 20))
