"""Driver of the arm."""

import contextlib
import math
from collections.abc import Callable, Sequence

from drivers.configs import ArmConfig
from drivers.errors import BadReply, DeviceFault, InstrumentError, LimitExceeded, NotReady, WrongDevice
from drivers.interfaces import ArmSample, Identity
from drivers.registry import Driver
from timing import Clock

from . import ARM_PORT
from .line import Line
from .stream import LineStream


class Config(ArmConfig):
    """How the arm is reached."""

    host: str
    timeout: float = 1.0


class BenchArm:
    """Motion (see `drivers.interfaces.ArmDriver`)."""

    def __init__(self, name: str, config: Config, clock: Clock) -> None:
        self.name, self._config = name, config
        self._line = Line(name, config.host, ARM_PORT, config.timeout)

    def open(self) -> Identity:
        """Connect."""
        if self._line.is_open:
            raise NotReady(self.name, "is open; close it first")
        self._line.open()
        words = self._line.ask("ID")
        if words != ["ID", "bench-arm"]:
            self._line.close()
            raise WrongDevice(self.name, f"what answers at {self._config.host} is no bench arm; check the address")
        return Identity("Bench", words[1])

    def move_to(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        """Start a straight motion."""
        self._check(pose, speed, acceleration)
        words = " ".join(f"{float(x):.9g}" for x in (*pose, speed, acceleration))
        if self._line.ask(f"GO {words}") != ["OK"]:
            raise DeviceFault(self.name, "does not take the motion; look at its panel")

    def moving(self) -> bool:
        """True until the last motion has ended."""
        return state(self._line)[8] == 1

    def stop(self) -> None:
        """Stop now."""
        if (answer := self._line.ask("STOP")) != ["OK"]:
            raise BadReply(self.name, f"answers STOP by {' '.join(answer)!r}, needed OK; check the cable")

    def standing(self) -> bool:
        """By its speed."""
        return state(self._line)[7] < 1e-4

    def glance(self) -> bool:
        """The same, over a connection of its own."""
        line = Line(self.name, self._config.host, ARM_PORT, self._config.timeout)
        line.open()
        try:
            return state(line)[7] < 1e-4
        finally:
            line.close()

    def close(self) -> None:
        """Stop and disconnect."""
        if self._line.is_open:
            with contextlib.suppress(InstrumentError):
                self.stop()
        self._line.close()

    def _check(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        c = self._config
        inside = all(a <= x <= b for a, x, b in zip(c.workspace_min, pose, c.workspace_max, strict=False))
        if not (inside and all(math.isfinite(x) for x in pose)):
            raise LimitExceeded(self.name, f"pose {tuple(pose)} (m, rad) must lie in the workspace of rig.yaml")
        for what, value, highest, unit in (
            ("speed", speed, c.max_speed, "m/s"),
            ("acceleration", acceleration, c.max_acceleration, "m/s^2"),
        ):
            if not 0 < value <= highest:
                raise LimitExceeded(self.name, f"{what} {value:g} {unit} must be above 0 and at most {highest:g}")


def state(line: Line) -> list[float]:
    """Stamp, pose (6), speed and whether it moves."""
    return told(line, line.ask("POSE"))


def told(line: Line, words: list[str]) -> list[float]:
    """The numbers of a POSE line; raises BadReply."""
    if len(words) != 10 or words[0] != "POSE":
        raise BadReply(line.name, f"sends {' '.join(words)!r}, needed POSE and 9 numbers; check the cable")
    return line.numbers(words[1:])


class BenchArmState(LineStream):
    """The stream of its state."""

    def __init__(self, name: str, config: Config, clock: Clock, sink: Callable[[ArmSample], None]) -> None:
        super().__init__(name, Line(name, config.host, ARM_PORT, config.timeout), "STREAM", config.max_age, sink)
        self._clock = clock

    def sample(self, words: list[str]) -> ArmSample:
        """A POSE line; the arm tells no joint angles, and of its speed the magnitude alone."""
        stamp, x, y, z, rx, ry, rz, speed, _ = told(self._line, words)
        nothing = (0.0, 0.0, 0.0, 0.0, 0.0)
        return ArmSample(self._clock.now(), stamp, (0.0, *nothing), (x, y, z, rx, ry, rz), (speed, *nothing), 1, True)


DRIVER = Driver("arm", Config, BenchArm, make_state=BenchArmState)
