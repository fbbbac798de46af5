"""The control script of ur_rtde as the controller runs it: a machine that takes commands from input registers.

The URScript text itself is not interpreted. Output int 0 says 1 = ready and 2 = done; the client writes a command code
to input int 0, waits for 2, and clears with code 0. Output int 2 is the state of an asynchronous motion: bit 15
running, bits 16-22 count of writes, bits 24-30 number of the operation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from .kinematics import Array, pose_matrix, pose_vector
from .motion import ArmMotion, JointMove, LinearMove, Motion, ProgramError, stop_joints, stop_linear

READY, DONE = 1, 2

SPEED_RANGE = {"joint": (3.14, 40.0), "tool": (3.0, 150.0)}
"""Largest speed and acceleration the script accepts: rad/s and rad/s^2, m/s and m/s^2."""


class Host(Protocol):
    """What the script needs of the controller it runs on."""

    arm: ArmMotion
    inputs: dict[str, float | list[float]]
    out_int: list[int]
    out_double: list[float]

    def read_int(self, index: int) -> int:
        """Input int register."""
        return int(self.inputs[f"input_int_register_{index}"])  # type: ignore[arg-type]

    def read_double(self, index: int) -> float:
        """Input double register."""
        return float(self.inputs[f"input_double_register_{index}"])  # type: ignore[arg-type]

    def write_int(self, index: int, value: int) -> None:
        """Output int register."""
        self.out_int[index] = value

    def write_double(self, index: int, value: float) -> None:
        """Output double register."""
        self.out_double[index] = value

    def start_watchdog(self, frequency: float) -> None:
        """End the program when input int 0 is written less often than this (Hz)."""

    def protective_stop(self, reason: str) -> None:
        """Stop the arm by the safety system."""

    def note_command(self, name: str, values: list[float]) -> None:
        """Keep a command for the log."""

    def set_payload(self, mass: float, centre: Array) -> None:
        """Take this mass (kg) and its centre (m) to be at the flange."""


class ControlScript:
    """One run of the script, from its upload until it ends."""

    def __init__(self, host: Host, offset: int) -> None:
        self.host, self.arm, self.offset = host, host.arm, offset
        self._executing = False  # the command in the register was taken and is not cleared yet
        self._blocking: Motion | None = None  # no command is taken before its end
        self._move: Motion | None = None  # in the background, as is `_stop`
        self._stop: Motion | None = None
        self._linear_stop = False
        self._writes = self._operation = 0
        self._signal(running=False)
        self._say(READY)

    def cycle(self, dt: float) -> bool:
        """One controller cycle of dt (s); False when the script has ended. Raises ProgramError."""
        self._advance_threads(dt)
        if self._blocking is not None:
            if not self._blocking.step(dt):
                self._blocking = None
                self._say(DONE)
            return True
        code = self.host.read_int(self.offset)
        if code == 0:
            self._executing = False
            self._say(READY)
        elif not self._executing:
            self._executing = True
            if code == 255:  # stop script
                self.host.note_command("stop script", [])
                return False
            self._process(code)
            if self._blocking is None:
                self._say(DONE)
        return True

    # -- registers
    def _say(self, value: int) -> None:
        self.host.write_int(self.offset, value)

    def _double(self, index: int) -> float:
        return self.host.read_double(index + self.offset)

    def _vector(self, first: int = 0, count: int = 6) -> Array:
        return np.array([self._double(first + i) for i in range(count)])

    def _answer(self, values: Array | list[float]) -> None:
        for i, value in enumerate(values):
            self.host.write_double(i + self.offset, float(value))

    def _answer_bool(self, value: bool) -> None:
        self.host.write_int(1 + self.offset, int(value))

    def _signal(self, running: bool, started: bool = False) -> None:
        self._writes = (self._writes + 1) % 128
        if started:
            self._operation = (self._operation + 1) % 128
        status = (self._writes << 16) + (self._operation << 24) + (running << 15)
        self.host.write_int(2 + self.offset, status)

    # -- the threads of the script that move the arm
    def _advance_threads(self, dt: float) -> None:
        if self._move is not None and not self._move.step(dt):
            self._move = None
            self._signal(running=False)
        if self._stop is not None and not self._stop.step(dt):
            self._stop = None
            self._signal(running=False)

    def _kill_move(self) -> None:
        if self._move is not None:
            self._move = None
            self._signal(running=False)

    def _start(self, motion: Motion) -> None:
        if self._stop is not None:
            raise ProgramError("another thread is already controlling the robot")
        if self.host.read_int(1 + self.offset) == 1:
            self._move = motion
            self._signal(running=True, started=True)
        else:
            self._blocking = motion

    # -- commands
    def _process(self, code: int) -> None:
        if code not in self._COMMANDS:
            raise ProgramError(f"command {code} is not implemented by this controller")
        name, command = self._COMMANDS[code]
        command(self, name)

    def _motion(self, name: str) -> None:
        """Start a move to the target in the registers; raises ProgramError."""
        target, speed, acceleration = self._vector(), self._double(6), self._double(7)
        self.host.note_command(name, [*target.tolist(), speed, acceleration, float(self.host.read_int(1 + self.offset))])
        most_speed, most_acceleration = SPEED_RANGE["joint" if name.startswith("movej") else "tool"]
        if not np.all(np.isfinite(target)):
            raise ProgramError(f"{name}: target is not a number")
        if not (0 < speed <= most_speed and 0 < acceleration <= most_acceleration):
            raise ProgramError(f"{name}: speed {speed:g} or acceleration {acceleration:g} out of range")
        self._kill_move()
        if name == "movel_fk":
            present, self.arm.q = self.arm.q, target
            target, self.arm.q = self.arm.pose_vector(), present
        if name == "movej_ik":
            target = self._solve(target, name)
        make = JointMove if name.startswith("movej") else LinearMove
        self._start(make(self.arm, target, speed, acceleration))

    def _stopping(self, name: str) -> None:
        """Decelerate, in the background or until the arm stands; raises ProgramError."""
        deceleration, background = self._double(0), self.host.read_int(1 + self.offset) == 1
        self.host.note_command(name, [deceleration, float(background)])
        if not deceleration > 0:
            raise ProgramError(f"{name}: deceleration {deceleration:g} is not above 0")
        if self._stop is not None:
            self._stop = None
            self._signal(running=False)
        else:
            self._kill_move()
        # The script stops in joint space until it is first asked for an asynchronous stop; then every stop is linear.
        self._linear_stop = self._linear_stop or background
        motion = (stop_linear if self._linear_stop else stop_joints)(self.arm, deceleration)
        if background:
            self._stop = motion
            self._signal(running=True, started=True)
        else:
            self._blocking = motion

    def _solve(self, pose: Array, name: str, start: Array | None = None) -> Array:
        q = self.arm.solve(pose_matrix(pose), start)
        if q is None:
            raise ProgramError(f"{name}: no inverse kinematics solution")
        return q

    def _set_tcp(self, name: str) -> None:
        self.host.note_command(name, self._vector().tolist())
        if np.any(self.arm.qd):
            raise ProgramError("set_tcp while the arm moves")
        self.arm.tool = pose_matrix(self._vector())

    def _set_payload(self, name: str) -> None:
        self.host.note_command(name, self._vector(0, 4).tolist())
        self.host.set_payload(self._double(0), self._vector(1, 3))

    def _watchdog(self, name: str) -> None:
        self.host.note_command(name, [self._double(0)])
        if not self._double(0) > 0:
            raise ProgramError("rtde_set_watchdog: frequency is not above 0")
        self.host.start_watchdog(self._double(0))

    def _within_limits(self, name: str) -> None:
        self._answer_bool(self.arm.solve(pose_matrix(self._vector())) is not None)

    def _accepted(self, name: str) -> None:
        self.host.note_command(name, [])

    _COMMANDS: dict[int, tuple[str, Callable[[ControlScript, str], None]]] = {
        1: ("movej", _motion),
        2: ("movej_ik", _motion),
        3: ("movel", _motion),
        4: ("movel_fk", _motion),
        8: ("zero_ftsensor", _accepted),
        17: ("set_payload", _set_payload),
        29: ("set_tcp", _set_tcp),
        30: ("get_inverse_kin", lambda s, name: s._answer(s._solve(s._vector(), name, s._vector(6)))),
        31: ("protective_stop", lambda s, name: s.host.protective_stop("asked for by the client")),
        33: ("stopl", _stopping),
        34: ("stopj", _stopping),
        35: ("set_watchdog", _watchdog),
        36: ("is_within_safety_limits", _within_limits),
        40: ("get_tcp_offset", lambda s, name: s._answer(pose_vector(s.arm.tool))),
        43: ("get_forward_kin", lambda s, name: s._answer(s.arm.pose_vector())),
        46: ("get_inverse_kin", lambda s, name: s._answer(s._solve(s._vector(), name))),
        47: ("is_steady", lambda s, name: s._answer_bool(not np.any(s.arm.qd))),
    }
