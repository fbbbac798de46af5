"""The controller without any wire: safety, program, registers, and what it reports each cycle.

One cycle lasts 8 ms (CB3) or 2 ms (e-Series) of host time at any speed factor; the arm and the controller's own
time stamp advance by `speed` cycles meanwhile.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from . import variables
from .kinematics import UR5_CB3, UR5E, Array, forward, pose_vector
from .motion import ArmMotion, JointOverspeed, ProgramError
from .script import ControlScript, Host


class Runtime(IntEnum):
    """runtime_state"""

    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


class RobotMode(IntEnum):
    """robot_mode"""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


POWERING, RELEASING = 4.0, 2.0
"""s that the joints take to start, and the brakes to be released."""
INSPECTED = 5.0
"""s after a protective stop before which it cannot be unlocked."""


class Safety(IntEnum):
    """safety_status_bits; the emergency stops also show that there is any, the last three that the safety system stopped it."""

    NORMAL = 1 << 0
    REDUCED = 1 << 1
    PROTECTIVE_STOP = 1 << 2
    RECOVERY = 1 << 3
    SAFEGUARD_STOP = 1 << 4
    SYSTEM_EMERGENCY_STOP = 1 << 5 | 1 << 7
    EMERGENCY_STOP = 1 << 6 | 1 << 7
    VIOLATION = 1 << 8 | 1 << 10
    FAULT = 1 << 9 | 1 << 10
    THREE_POSITION_STOP = 1 << 10 | 1 << 11


SAFETY_MODE: dict[int, tuple[int, str]] = {
    Safety.NORMAL: (1, "NORMAL"),
    Safety.REDUCED: (2, "REDUCED"),
    Safety.PROTECTIVE_STOP: (3, "PROTECTIVE_STOP"),
    Safety.RECOVERY: (4, "RECOVERY"),
    Safety.SAFEGUARD_STOP: (5, "SAFEGUARD_STOP"),
    Safety.SYSTEM_EMERGENCY_STOP: (6, "SYSTEM_EMERGENCY_STOP"),
    Safety.EMERGENCY_STOP: (7, "ROBOT_EMERGENCY_STOP"),
    Safety.VIOLATION: (8, "VIOLATION"),
    Safety.FAULT: (9, "FAULT"),
    Safety.THREE_POSITION_STOP: (13, "SYSTEM_THREE_POSITION_ENABLING_STOP"),
}
"""safety_status_bits -> safety_mode and the dashboard's name for it."""
PAUSING = (
    Safety.SAFEGUARD_STOP, Safety.THREE_POSITION_STOP, Safety.SYSTEM_EMERGENCY_STOP, Safety.EMERGENCY_STOP
)  # fmt: skip
"""What halts a program and lets it go on with its motion once it is cleared."""
WITHOUT_POWER = (Safety.SYSTEM_EMERGENCY_STOP, Safety.EMERGENCY_STOP, Safety.VIOLATION, Safety.FAULT)

UPTIME = 1000.0
"""s; the controller's own clock has nothing to do with the rig's."""

_FUNCTION = re.compile(r"def (\w+)\(\):")
_OFFSET = re.compile(r"global reg_offset_int = # int register offset\n(\d+)")


@dataclass
class ArmCommand:
    """One command the control script took: host-independent time (device stamp, s), name, registers."""

    t: float
    name: str
    values: list[float]


@dataclass
class FakeController(Host):
    """State of one controller."""

    version: variables.Version = (3, 15, 8, 106339)
    speed: float = 1.0
    seed: int = 0
    model: str = "UR5"
    serial: str = "20183500000"
    wrench: Array = field(default_factory=lambda: np.zeros(6))
    slider: float = 1.0
    scaling: float = 1.0
    """Share of the programmed speed that its trajectory limiter allows, in reduced mode or by another limit; 0..1."""
    payload: float = 0.8
    """kg"""
    payload_centre: Array = field(default_factory=lambda: np.array([0.0, 0.0, 0.05]))
    """m"""
    starting: str = ""
    """What it says to RTDE clients in place of data: it has not started yet, or nobody has confirmed its safety setup."""
    remote: bool = True
    """The pendant is in remote control; a CB3 has no such switch."""
    safety: int = Safety.NORMAL
    robot_mode: int = RobotMode.RUNNING
    runtime: Runtime = Runtime.STOPPED
    commands: list[ArmCommand] = field(default_factory=list)
    ended: list[str] = field(default_factory=list)
    """Why each program ended, oldest first."""
    stuck: dict[str, float | list[float]] = field(default_factory=dict)
    """Variables that keep one value on the wire."""
    halted: bool = False
    """No cycle passes: arm, program and time stand still."""
    skew: float = 1.0
    """The controller's own clock runs so much faster."""

    def __post_init__(self) -> None:
        self.period = 0.008 if self.version[0] == 3 else 0.002
        self.t = UPTIME
        self.arm = ArmMotion(UR5_CB3 if self.version[0] == 3 else UR5E)
        self.outputs = variables.outputs(self.version)
        self.inputs: dict[str, float | list[float]] = {
            name: [0.0] * 6 if kind == variables.VECTOR6D else 0.0 if kind == variables.DOUBLE else 0
            for name, kind in variables.inputs().items()
        }
        self.out_int = [0] * variables.REGISTERS
        self.out_double = [0.0] * variables.REGISTERS
        self._steps: list[tuple[float, int]] = []
        """Times (s of its own clock) and the robot modes that begin then."""
        self._stopped_at = -math.inf
        self._program: ControlScript | None = None
        self._watchdog: float | None = None
        self._starving = 0.0  # s since a client fed the watchdog
        self._random = np.random.default_rng(self.seed)
        self._measure()

    @property
    def rate(self) -> float:
        """Share of the programmed speed at which the arm moves."""
        return self.slider * self.scaling

    # -- one cycle
    def advance(self, host_seconds: float = math.inf) -> None:
        """One cycle. The watchdog counts the `host_seconds` that it took, a period at most: a late host does not trip it."""
        if self.halted:
            return
        dt = self.period * self.speed  # rig seconds
        self.t += dt * self.skew  # its own clock may run fast
        while self._steps and self._steps[0][0] <= self.t:
            self.robot_mode = self._steps.pop(0)[1]
        try:
            if self._program is not None and self.runtime == Runtime.PLAYING and not self._program.cycle(dt * self.rate):
                self.end_program("stopped by the client")
        except ProgramError as error:
            self.end_program(str(error))
        except JointOverspeed as error:
            self.protective_stop(str(error))
        self._watch(min(host_seconds, self.period))
        self._measure()

    def _watch(self, seconds: float) -> None:
        """Count them since the client last wrote, and end the program after too many."""
        if self._watchdog is None or self.runtime == Runtime.PAUSED:
            return
        self._starving += seconds
        if self._starving > 1.0 / self._watchdog:
            self.end_program(f"watchdog: input registers not written at {self._watchdog:g} Hz")

    def _measure(self) -> None:
        noise = self._random.normal(size=(2, 6))
        self._actual_q = self.arm.q + 1e-5 * noise[0]  # rad
        self._actual_qd = self.rate * self.arm.qd + 1e-4 * noise[1]  # rad/s
        self._actual_tcp: tuple[Array, Array] | None = None

    def _measured_tcp(self) -> tuple[Array, Array]:
        """Pose vector and speed of the tool as measured in this cycle: computed when somebody asks, mostly nobody does."""
        if self._actual_tcp is None:
            pose, jacobian = forward(self.arm.geometry, self._actual_q, self.arm.tool)
            self._actual_tcp = pose_vector(pose), jacobian @ self._actual_qd
        return self._actual_tcp

    # -- safety and program
    def protective_stop(self, reason: str) -> None:
        """The safety system stops the arm; the program is gone."""
        self.safety, self._stopped_at = Safety.PROTECTIVE_STOP, self.t
        self.end_program(f"protective stop: {reason}")

    def safety_stop(self, name: str) -> None:
        """Any state of the safety system, by the dashboard's name. Raises KeyError."""
        self.safety = {words: bits for bits, (_, words) in SAFETY_MODE.items()}[name]
        if self.safety in WITHOUT_POWER:
            self._steps.clear()
            self.robot_mode = RobotMode.POWER_OFF
        if self.safety in PAUSING:
            self.pause()
        elif self.safety not in (Safety.NORMAL, Safety.REDUCED):
            self.end_program(name.lower().replace("_", " "))

    def power(self, on: bool, release: bool = False) -> bool:
        """Switch the joints on, which takes seconds, or off; `release` the brakes too. False where safety forbids it."""
        self._steps.clear()
        if not on:
            self.end_program("powered off")
            self.robot_mode = RobotMode.POWER_OFF
            return True
        if self.safety not in (Safety.NORMAL, Safety.REDUCED):
            return False
        due = self.t
        if self.robot_mode in (RobotMode.POWER_OFF, RobotMode.POWER_ON):
            due += POWERING
            self.robot_mode = RobotMode.POWER_ON
            self._steps.append((due, RobotMode.IDLE))
        if release and self.robot_mode != RobotMode.RUNNING:
            self._steps.append((due + RELEASING, RobotMode.RUNNING))
        return True

    def unlock(self) -> bool:
        """Enable the arm again after a protective stop; False before a person can have checked it."""
        if self.safety == Safety.PROTECTIVE_STOP and self.t - self._stopped_at < INSPECTED:
            return False
        if self.safety == Safety.PROTECTIVE_STOP:
            self.clear()
        return True

    def clear(self) -> None:
        """Somebody at the pendant has cleared the stop, powered on and released the brakes; a paused program goes on."""
        self._steps.clear()
        self.safety, self.robot_mode = Safety.NORMAL, RobotMode.RUNNING
        if self.runtime == Runtime.PAUSED:
            self.runtime = Runtime.PLAYING

    def pause(self) -> None:
        """The program halts where it is, until `clear`."""
        self.arm.halt()
        if self._program is not None:
            self.runtime = Runtime.PAUSED

    def load(self, text: str) -> None:
        """A program arrives; a running one is replaced."""
        if self._program is not None:
            self.end_program("replaced by another program")
        function = _FUNCTION.match(text)
        name = function[1] if function else "?"
        if self.safety not in (Safety.NORMAL, Safety.REDUCED) or self.robot_mode != RobotMode.RUNNING:
            self.ended.append(f"{name} not started: the arm is not ready")
        elif not self.remote:
            self.ended.append(f"{name} not started: the pendant is in local mode")
        elif name != "rtde_control":
            self.ended.append(f"{name}: only the control script is understood")
        else:
            offset = _OFFSET.search(text)
            self.runtime = Runtime.PLAYING
            self._program = ControlScript(self, int(offset[1]) if offset else 0)

    def end_program(self, reason: str) -> None:
        """The arm halts; the reason goes to the log."""
        self._watchdog = None
        self.arm.halt()
        if self._program is not None:
            self._program, self.runtime = None, Runtime.STOPPED
            self.ended.append(reason)

    # -- what the control script needs
    def start_watchdog(self, frequency: float) -> None:
        """End the program when input int 0 is written less often than `frequency` (Hz, host time)."""
        self._watchdog, self._starving = frequency, 0.0

    def set_payload(self, mass: float, centre: Array) -> None:
        """What is at the flange: kg, m."""
        self.payload, self.payload_centre = mass, centre

    def note_command(self, name: str, values: list[float]) -> None:
        """Keep a command for the log."""
        self.commands.append(ArmCommand(self.t, name, values))

    # -- what the wire needs
    def write(self, name: str, value: float | list[float]) -> None:
        """A client wrote an input variable."""
        self.inputs[name] = value
        if name in ("input_int_register_0", "input_int_register_24"):
            self._starving = 0.0
        if name == "speed_slider_fraction" and self.inputs["speed_slider_mask"]:
            self.slider = min(1.0, max(0.0, float(value)))  # type: ignore[arg-type]

    def value(self, name: str) -> float | list[float]:
        """What the controller reports now for an output variable; measured values have the resolution of a float32."""
        if name in self.stuck:
            return self.stuck[name]
        if name.startswith("output_int_register_"):
            return self.out_int[int(name.rsplit("_", 1)[1])]
        if name.startswith("output_double_register_"):
            return self.out_double[int(name.rsplit("_", 1)[1])]
        if name in self.inputs and name.startswith("input_"):
            return self.inputs[name]
        if name in variables.CONSTANT:
            return variables.CONSTANT[name]
        vector = self._vectors(name)
        if vector is not None:
            return vector.tolist()
        scalars: dict[str, float] = {
            "timestamp": self.t,
            "runtime_state": self.runtime,
            "robot_mode": self.robot_mode,
            "safety_mode": SAFETY_MODE[self.safety][0],
            "safety_status": SAFETY_MODE[self.safety][0],
            "payload": self.payload,
            "safety_status_bits": self.safety,
            "robot_status_bits": (self.robot_mode != RobotMode.POWER_OFF) | (self.runtime != Runtime.STOPPED) << 1,
            "speed_scaling": self.scaling,
            "target_speed_fraction": self.slider,
        }
        if name in scalars:
            return scalars[name]
        count = variables.COUNT.get(self.outputs[name], 1)
        return 0 if count == 1 else [0] * count

    def _vectors(self, name: str) -> Array | None:
        """What a variable with several numbers reports, (6,) or (3,); None for any other."""
        match name:
            case "actual_q":
                return _measured(self._actual_q)
            case "actual_qd":
                return _measured(self._actual_qd)
            case "actual_TCP_pose":
                return _measured(self._measured_tcp()[0])
            case "actual_TCP_speed":
                return _measured(self._measured_tcp()[1])
            case "actual_TCP_force":
                return _measured(self.wrench)
            case "payload_cog":
                return self.payload_centre
            case "target_q":
                return self.arm.q
            case "target_qd":
                return self.rate * self.arm.qd
            case "target_TCP_pose":
                return self.arm.pose_vector()
            case "target_TCP_speed":
                return self.rate * self.arm.tcp_speed()
        return None


def _measured(values: Array) -> Array:
    return values.astype(np.float32).astype(np.float64)
