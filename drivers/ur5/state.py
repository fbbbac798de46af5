"""The state a UR5 streams through RTDE: joints, TCP pose and speed, safety.

The library (ur_rtde) keeps only the newest package, so this driver looks often, emits a sample at every new time stamp
of the controller, and finds out from the stamps what it has missed.
"""

from __future__ import annotations

import math
import threading
from typing import Any

import rtde_receive

import timing
from timing import Clock

from ..errors import BadReply, InstrumentError, NotReady, StaleReading, Unreachable
from ..interfaces import ArmSample, Identity, Sink, Vector6
from .wire import E_SERIES, UrController

VARIABLES = [
    "timestamp",
    "actual_q",
    "actual_TCP_pose",
    "actual_TCP_speed",
    "safety_status_bits",
    "safety_mode",
    "robot_status_bits",
    "target_speed_fraction",
    "speed_scaling",
    "runtime_state",
]
ENDED, PLAYING = (0, 1), 2
"""runtime_state of a program that is there no more, and of one that runs; any other is halted and may go on."""
RETRY_INTERVAL = 0.5
"""s of host time between attempts to get a lost stream back."""
FARTHEST, LARGEST_ANGLE = 3.0, 7.0
"""m and rad; no arm of this family reaches beyond."""
CLOSE_TIMEOUT = 4.0
"""s of host time; the library alone takes 0.5 s, and up to 2.5 s more when the controller is silent."""


CYCLE, CYCLE_E_SERIES = 0.008, 0.002
"""s of the controller's time from one package to the next, CB3 and since the e-Series; the library asks for all of them."""


class CycleCounter:
    """Counts the samples missing between stamps. `cycle`: s of the controller's time from one sample to the next."""

    def __init__(self, cycle: float) -> None:
        self.cycle = cycle
        self._last: float | None = None

    def add(self, stamp: float) -> int:
        """Take the next stamp (s); returns how many samples are missing before it."""
        last, self._last = self._last, stamp
        if last is None or stamp <= last:
            return 0  # the first, or the controller was restarted
        return max(0, round((stamp - last) / self.cycle) - 1)


class UR5State:
    """State of the arm (see `ArmState`). A lost stream is taken up again by itself; the gap is counted in `lost`."""

    def __init__(
        self, controller: UrController, clock: Clock, sink: Sink[ArmSample], max_age: float = 0.2, poll_interval: float = 0.001
    ) -> None:
        """`max_age` of the newest sample, and how often to look for a new package; s, host time."""
        self.name = controller.name
        self.controller, self.max_age, self._poll_interval = controller, max_age, poll_interval
        self.lost = 0
        self.interruptions = 0
        """How often the connection was lost since `open`."""
        self._clock = clock
        self._sink = sink
        self._identity: Identity | None = None
        self._counter = CycleCounter(CYCLE)
        self._newest: tuple[float, ArmSample] | None = None
        self.safety_mode = 0
        """As RTDE defines it, of the newest sample; some stops show here only."""
        self.speed_slider = 1.0
        """0..1, of the newest sample."""
        self.speed_scaling = 1.0
        """Share of the programmed speed that the controller allows, in addition to the slider, of the newest sample."""
        self.runtime = PLAYING
        """runtime_state as RTDE defines it, of the newest sample."""
        self._receive: Any = None
        self._thread: threading.Thread | None = None
        self._stopping = timing.Event()
        self._first = timing.Event()

    @property
    def cycle(self) -> float:
        """Cycle of the controller, s of its own time."""
        return self._counter.cycle

    def open(self) -> Identity:
        """Connect and start the stream. Raises Unreachable, WrongDevice, NotReady."""
        if self._thread is not None and self._thread.is_alive():
            if self._identity is not None and not self._stopping.is_set():
                return self._identity
            raise NotReady(self.name, "the library has not released the last connection; restart the program")
        seen = self.controller.snapshot()
        identity = self.controller.identify(seen)
        try:
            self._receive = rtde_receive.RTDEReceiveInterface(self.controller.host, -1.0, VARIABLES)
        except RuntimeError as error:
            raise Unreachable(self.name, f"no state stream from {self.controller.host}: {error}") from error
        self.lost = self.interruptions = 0
        cycle = CYCLE_E_SERIES if seen.version[0] >= E_SERIES else CYCLE
        self._counter, self._newest = CycleCounter(cycle * self._clock.speed), None
        self._stopping.clear()
        self._first.clear()
        self._thread = timing.Thread(target=self._run, name=f"{self.name} state", daemon=True)
        self._thread.start()
        if not self._first.wait(self.controller.timeout):
            self.close()
            raise Unreachable(self.name, f"no state from {self.controller.host} within {self.controller.timeout:g} s")
        self._identity = identity
        return identity

    def close(self) -> None:
        """End the stream; gives up waiting for the library after CLOSE_TIMEOUT."""
        self._stopping.set()
        self._identity = None
        if self._thread is not None:
            self._thread.join(CLOSE_TIMEOUT)

    def latest(self) -> ArmSample:
        """The newest sample. Raises NotReady before `open`, StaleReading when it is older than `max_age`."""
        newest = self._newest
        if self._identity is None or newest is None:
            raise NotReady(self.name, "not open; call open() first")
        age = timing.now() - newest[0]
        if age > self.max_age:
            raise StaleReading(
                self.name,
                f"newest state is {age:.2f} s old, limit {self.max_age:g} s; "
                + timing.busy_or(f"check the cable to {self.controller.host} and the controller"),
            )
        check_plausible(self.name, self.controller.host, newest[1])
        return newest[1]

    # -- the stream's own thread
    def _run(self) -> None:
        last = None
        while not self._stopping.wait(self._poll_interval):
            if not self._receive.isConnected():
                self._recover()
                continue
            stamp = self._receive.getTimestamp()
            if stamp != last:
                last = self._emit()
        # The library's object is closed and forgotten here, as both may block.
        try:
            self._receive.disconnect()
        finally:
            self._receive = None

    def _emit(self) -> float:
        """Read one package whole and deliver it; returns its stamp."""
        receive = self._receive
        while True:
            stamp: float = receive.getTimestamp()
            joints, pose, speed = receive.getActualQ(), receive.getActualTCPPose(), receive.getActualTCPSpeed()
            safety, status = receive.getSafetyStatusBits(), receive.getRobotStatus()
            mode, slider, runtime = receive.getSafetyMode(), receive.getTargetSpeedFraction(), receive.getRuntimeState()
            scaling = receive.getSpeedScaling()
            if receive.getTimestamp() == stamp:
                break  # otherwise the next package came in between
        sample = ArmSample(
            t=self._clock.now(),
            device_time=stamp,
            joints=_six(joints),
            tcp_pose=_six(pose),
            tcp_speed=_six(speed),
            safety_bits=int(safety),
            program_running=bool(status & (1 << 1)),
        )
        self.lost += self._counter.add(stamp)
        self.safety_mode, self.runtime = int(mode), int(runtime)
        self.speed_slider, self.speed_scaling = float(slider), float(scaling)
        self._newest = timing.now(), sample
        self._first.set()
        self._sink(sample)
        return stamp

    def _recover(self) -> None:
        """Try once to get the stream back. The probe comes first because the library would wait without a time-out."""
        self.interruptions += 1
        while not self._stopping.wait(RETRY_INTERVAL):
            try:
                self.controller.snapshot()
                self._receive.reconnect()
                return
            except (InstrumentError, RuntimeError):
                continue


def check_plausible(name: str, host: str, sample: ArmSample) -> None:
    """Raises BadReply for numbers that no arm can have: the protocol has no checksum."""
    numbers = (*sample.joints, *sample.tcp_pose, *sample.tcp_speed)
    angles = (*sample.joints, *sample.tcp_pose[3:])
    far = any(abs(x) > FARTHEST for x in sample.tcp_pose[:3]) or any(abs(q) > LARGEST_ANGLE for q in angles)
    if not all(map(math.isfinite, numbers)) or far or not any(numbers):
        raise BadReply(
            name,
            f"the state reports joints {sample.joints} rad, TCP {sample.tcp_pose} m and rad, which is impossible; check the "
            f"network to {host}, then restart the controller",
        )


def _six(values: list[float]) -> Vector6:
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)
