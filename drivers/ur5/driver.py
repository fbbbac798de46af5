"""Motion of a UR5 through ur_rtde.

Every motion runs asynchronously on the controller, within limits and with a deadline computed from its length. The controller's
watchdog stops the arm when this process dies or hangs.

ur_rtde may hang or crash when the controller goes away, so this driver belongs in a process that can be killed.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import timing
from timing import Clock

from ..errors import BadReply, DeviceFault, InstrumentError, NoReply, NotReady, StaleReading, WrongDevice
from ..interfaces import ArmSample, Identity, Sink, Vector6
from ..registry import Driver
from . import motion as ur5_motion
from .config import Config
from .control import ControlThread
from .motion import Deadline, Tool, millimetres, same_pose
from .safety import SlowMotion, is_reduced, stop_text
from .state import ENDED, PLAYING, UR5State
from .wire import SCRIPT_PORT, Snapshot, UrController

STILL_SPEED, STILL_TURNING, STILL_STATES = 2e-3, 1e-2, 3
"""m/s and rad/s: below both the TCP counts as standing, the encoders' noise well below; and states in a row that must show it."""
DEADLINE_FACTOR = 2.0
"""A motion may take this many times as long as computed."""
LEAST_SLIDER = 1 / DEADLINE_FACTOR
"""The speed slider (0..1) at which motions still end in time."""
STOP_ALLOWANCE = 0.2
"""s the arm may take to stop beyond speed/deceleration."""
STATE_LAG = 0.1
"""s of host time by which the state may be behind the command connection; it is one or two cycles."""
LOOK_INTERVAL = 0.002
"""s of host time between two checks of the state while waiting."""
FINISH_TIMEOUT = 3.0
"""s of host time for ending the program and disconnecting; the library sleeps 0.5 s in there, twice."""


@dataclass
class _StartedMotion:
    goal: Vector6
    operation: int
    deadline: Deadline
    slow: SlowMotion
    ended: float | None = None
    """Host time (s) at which the controller called it ended, before the read-back confirmed it."""


class UR5:
    """The arm (see `Arm`)."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name = name
        self.config = config
        self._clock = clock
        self._controller = UrController(name, config.host, config.timeout)
        self._state = UR5State(self._controller, clock, lambda sample: None, max(0.3, config.timeout / 2), poll_interval=0.002)
        self._control: ControlThread | None = None
        self._seen: Snapshot | None = None
        """What the controller said of itself at `open`."""
        self._move: _StartedMotion | None = None
        self._tool: Tool | None = None
        """What the controller took to be at the flange at `open`."""

    def open(self) -> Identity:
        """Connect, check arm and state, take control, check the pendant's settings, start the watchdog.

        Raises Unreachable, WrongDevice (also for another payload), DeviceFault (stopped), NotReady (powered off, local mode,
        another in control, speed slider too low).
        """
        if self._control is not None and self._control.alive:
            raise NotReady(self.name, "is already open, or its last connection has not ended; close it, or restart its process")
        config = self.config
        snapshot = self._controller.snapshot()
        identity = self._controller.identify(snapshot)
        self._check_identity(identity)
        self._check_ready(snapshot)
        self._controller.connect(SCRIPT_PORT).close()  # the library names no port
        self._seen = snapshot
        try:
            self._state.open()
            self._control = ControlThread(self.name, config.host, config.timeout)
            self._control.start()
            self._set_tcp(self._control)
            self._tool = None
            self.confirm_settings()
            if not self._control.watch(config.watchdog_frequency):
                raise BadReply(self.name, "the controller refused the watchdog; see the log on the pendant")
            self._await_program(self._control)
        except InstrumentError:
            self.close()
            raise
        return identity

    def confirm_settings(self) -> None:
        """Ask the controller what the pendant can change: remote control, speed slider, payload, TCP, safety state.

        Raises WrongDevice when payload or TCP are not as at `open` or as rig.yaml has them, NotReady or DeviceFault for what a
        person sets right without opening the arm again.
        """
        control = self._opened()
        snapshot = self._controller.snapshot()
        self._check_ready(snapshot)
        if paused := self._paused():  # it would answer nothing
            raise DeviceFault(self.name, paused)
        if not self._controller.in_remote_control(snapshot):
            raise NotReady(self.name, "the pendant is in local mode, needed: remote control; switch it there")
        if snapshot.speed_slider < LEAST_SLIDER:
            raise NotReady(
                self.name,
                f"the speed slider is at {snapshot.speed_slider:.0%}, needed at least {LEAST_SLIDER:.0%}: motions would not end "
                "in time; set it to 100 % at the pendant",
            )
        tool = Tool(snapshot.payload, snapshot.centre_of_gravity, control.call(lambda library: list(library.getTCPOffset())))
        self._tool = self._tool or tool
        tool.check(self.name, self._tool, self.config.payload)

    def close(self) -> None:
        """Stop the arm, end the program, disconnect. Bounded in time also when the controller is gone."""
        if self._control is not None:
            if self._move is not None:
                with contextlib.suppress(InstrumentError):
                    self.stop()
            self._move = None
            if self._control.finish(FINISH_TIMEOUT):
                self._control = None
        self._state.close()

    def move_to(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        """Start a straight motion of the TCP to a pose (m, rotation vector rad, base frame) at m/s and m/s^2.

        Raises LimitExceeded and NotReady (still moving, not open) with nothing sent; DeviceFault, NoReply, BadReply.
        """
        goal = ur5_motion.check_request(self.name, self.config, pose, speed, acceleration)
        control = self._opened()
        here = self._healthy(control).tcp_pose
        ur5_motion.check_step(self.name, self.config, here, goal)
        if self._state.speed_slider <= 0:
            raise NotReady(self.name, "the speed slider is at 0 %: the arm would not move; set it to 100 % at the pendant")
        if self._move is not None and self.moving():
            raise NotReady(self.name, "still moving; wait until moving() is False, or call stop()")
        previous = control.operation().number
        if not control.call(lambda library: library.moveL(list(goal), speed, acceleration, True)):
            self._raise_cause(control)
            raise BadReply(self.name, f"the controller refused {millimetres(goal)}; see the log on the pendant")
        allowed = DEADLINE_FACTOR * ur5_motion.duration(here, goal, speed, acceleration)
        deadline = Deadline.after(self._clock, allowed, self.config.timeout)
        slow = SlowMotion(ur5_motion.top_speed(here, goal, speed, acceleration))
        self._move = _StartedMotion(goal, self._started(control, previous), deadline, slow)

    def moving(self) -> bool:
        """True until the last started motion has ended at its goal.

        Raises DeviceFault after a protective or emergency stop, when the program on the controller ended, when it
        came to rest elsewhere or takes too long (it is stopped then); NoReply when the controller is gone.
        """
        control = self._opened()
        operation = control.operation()
        sample = self._healthy(control)
        move = self._move
        if move is None:
            return False
        if operation.number != move.operation:
            self._move = None
            raise DeviceFault(self.name, "the motion was replaced by another one; is a second program in control of the arm?")
        if operation.running:
            state, reduced = self._state, is_reduced(sample.safety_bits, self._state.safety_mode)
            move.slow.seen(math.hypot(*sample.tcp_speed[:3]), reduced, state.speed_slider, state.speed_scaling)
            if move.deadline.expired:
                self._take_too_long(move)
            return True
        distance = ur5_motion.distance_between(sample.tcp_pose, move.goal)
        turn = ur5_motion.turn_between(sample.tcp_pose, move.goal)
        if distance <= self.config.position_tolerance and turn <= self.config.turn_tolerance and _slow(sample.tcp_speed):
            self._move = None
            return False
        # The state comes over a connection of its own and may be some cycles behind.
        move.ended = move.ended or timing.now()
        if timing.now() - move.ended > self.config.timeout:
            self._move = None
            raise DeviceFault(
                self.name,
                f"motion ended {distance * 1e3:.2f} mm and {turn:.4f} rad from its target {millimetres(move.goal)}, "
                f"tolerance {self.config.position_tolerance * 1e3:g} mm and {self.config.turn_tolerance:g} rad; "
                "was the arm stopped or pushed?",
            )
        return True

    def stop(self) -> None:
        """Decelerate now, or end a program that was only halted; returns when the state shows the arm standing.

        Raises DeviceFault when it does not stop or end, NoReply when that cannot be known.
        """
        control = self._opened()
        sample = self._fresh(control)
        self._move = None
        if self._stopped(sample.safety_bits) or self._state.runtime != PLAYING:
            if unended := self._end_program():
                raise DeviceFault(self.name, unended)
        elif sample.program_running:
            # Asynchronous, because only then does the program decelerate along the straight line.
            control.call(lambda library: library.stopL(self.config.stop_deceleration, True))
        travel = self.config.max_speed / self.config.stop_deceleration + STOP_ALLOWANCE
        deadline = Deadline.after(self._clock, travel, self.config.timeout)
        still, last = 0, sample.device_time
        while still < STILL_STATES:  # in a row
            sample = self._fresh(control)
            if sample.device_time != last:
                last = sample.device_time
                still = still + 1 if _slow(sample.tcp_speed) else 0
            if deadline.expired:
                speed = max(abs(v) for v in sample.tcp_speed[:3])
                raise DeviceFault(self.name, f"does not stop: still {speed:.3f} m/s; press the emergency stop")
            timing.sleep(LOOK_INTERVAL)

    def standing(self) -> bool:
        """True when the newest state shows the arm standing, whatever else is wrong. Raises NotReady, NoReply."""
        try:
            return _slow(self._state.latest().tcp_speed)
        except StaleReading as error:
            raise NoReply(self.name, f"{error.message}; check that the arm stands still") from error

    def glance(self) -> bool:
        """True when one look at the state shows the arm standing, without `open` and control. Raises Unreachable, WrongDevice."""
        return _slow(self._controller.snapshot().tcp_speed)

    # -- checks
    def _opened(self) -> ControlThread:
        if self._control is None:
            raise NotReady(self.name, "not open; call open() first")
        return self._control

    def _check_identity(self, identity: Identity) -> None:
        for what, wanted, reported in (
            ("model", self.config.model, identity.model),
            ("serial number", self.config.serial, identity.serial),
        ):
            if wanted and reported and wanted != reported:
                raise WrongDevice(
                    self.name, f"{what} at {self.config.host} is {reported!r}, not {wanted!r}; check address and configuration"
                )

    def _stopped(self, bits: int) -> str:
        """The stop that the newest state shows, and its remedy; empty when there is none."""
        return stop_text(bits, self._state.safety_mode)

    def _paused(self) -> str:
        """That the program is paused, and its remedy; empty when it is not."""
        paused = self._state.runtime not in (*ENDED, PLAYING)
        return "the program on the controller was paused at the pendant; close and open the arm again" if paused else ""

    def _check_ready(self, seen: Snapshot) -> None:
        """Raises DeviceFault for a stop, NotReady for an arm without power or with its brakes on."""
        if stop := stop_text(seen.safety_bits, seen.safety_mode):
            raise DeviceFault(self.name, stop)
        if seen.robot_mode != 7:  # powered, brakes released
            raise NotReady(self.name, f"robot mode {seen.robot_mode}; power the arm on at the pendant and release its brakes")

    def _fresh(self, control: ControlThread) -> ArmSample:
        """The newest state; NoReply when there is none, or when the connection was lost, which no program survives."""
        if self._state.interruptions:
            raise control.give_up("connection interrupted")
        try:
            return self._state.latest()
        except StaleReading as error:
            raise NoReply(self.name, f"{error.message}; the controller's watchdog stops the arm") from error

    def _healthy(self, control: ControlThread) -> ArmSample:
        """The newest state, of an arm that can go on moving."""
        sample = self._fresh(control)
        if stop := self._stopped(sample.safety_bits) or self._paused():
            self._move = None
            unended = self._end_program()
            raise DeviceFault(self.name, f"{stop}; {unended}" if unended else stop)
        if not sample.program_running:
            self._move = None
            raise DeviceFault(
                self.name,
                "the program on the controller has ended (target out of reach, watchdog, or stopped at the pendant); "
                "see the log there, then close and open the arm again",
            )
        return sample

    def _end_program(self) -> str:
        """End a halted program, which would go on once its cause is cleared; return what a person must do if it stays."""
        if self._seen is None or self._state.runtime in ENDED:
            return ""
        try:
            answer = self._controller.stop_program(self._seen)
            give_up = timing.now() + STATE_LAG
            while self._state.runtime not in ENDED and timing.now() < give_up:
                timing.sleep(LOOK_INTERVAL)
            why = f"the dashboard says {answer!r}"
        except InstrumentError as error:
            why = error.message
        ended = self._state.runtime in ENDED
        return "" if ended else f"its program is only halted and would go on ({why}): stop it at the pendant first"

    def _raise_cause(self, control: ControlThread) -> None:
        """Raise what the state shows to be wrong; it may come some cycles after the command's refusal."""
        give_up = timing.now() + STATE_LAG
        while timing.now() < give_up:
            self._healthy(control)
            timing.sleep(LOOK_INTERVAL)

    def _await_program(self, control: ControlThread) -> None:
        """Wait until the state, which comes over its own connection, shows the program running."""
        give_up = timing.now() + self.config.timeout
        while not self._fresh(control).program_running and timing.now() < give_up:
            timing.sleep(LOOK_INTERVAL)
        self._healthy(control)

    def _set_tcp(self, control: ControlThread) -> None:
        tcp = self.config.tcp
        if tcp is None:
            return
        if not control.call(lambda library: library.setTcp(list(tcp))):
            raise BadReply(self.name, f"the controller refused the TCP {tcp}; see the log on the pendant")
        read_back = control.call(lambda library: library.getTCPOffset())
        if not same_pose(read_back, tcp):
            raise BadReply(self.name, f"TCP read back as {read_back} instead of {tcp}; see the log on the pendant")

    def _started(self, control: ControlThread, before: int) -> int:
        """Number of the motion that was just sent, once the controller counts it; a quick one may be over by then."""
        give_up = timing.now() + self.config.timeout
        while (number := control.operation().number) == before:
            self._healthy(control)
            if timing.now() > give_up:
                raise NoReply(self.name, "the controller accepted the motion but did not start it; see the log on the pendant")
            timing.sleep(LOOK_INTERVAL)
        return number

    def _take_too_long(self, move: _StartedMotion) -> None:
        with contextlib.suppress(DeviceFault):
            self.stop()
        raise DeviceFault(
            self.name,
            f"motion to {millimetres(move.goal)} not finished after {move.deadline.rig_allowed:.1f} s and was stopped: "
            f"{move.slow.text()}",
        )


def _slow(speed: Vector6) -> bool:
    """A number that is none is not slow."""
    return all(abs(v) < STILL_SPEED for v in speed[:3]) and all(abs(v) < STILL_TURNING for v in speed[3:])


def _state(name: str, config: Config, clock: Clock, sink: Sink[ArmSample]) -> UR5State:
    """The arm's stream of states."""
    return UR5State(UrController(name, config.host, config.timeout), clock, sink, config.max_age)


DRIVER = Driver("arm", Config, UR5, make_state=_state, own_process=True)
