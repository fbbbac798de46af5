"""Driver of the cameras."""

from collections.abc import Callable

from pydantic import Field

from drivers.configs import MocapConfig
from drivers.interfaces import BodySample
from drivers.registry import Driver
from timing import Clock

from . import CAMERA_PORT
from .line import Line
from .stream import LineStream


class Config(MocapConfig):
    """How they are reached."""

    server: str
    port: int = Field(CAMERA_PORT, ge=1, le=65535)
    timeout: float = 1.0


class BenchCameras(LineStream):
    """The tip (see `drivers.interfaces.MotionCapture`)."""

    def __init__(
        self, name: str, config: Config, clock: Clock, sink: Callable[[BodySample], None], notice: Callable[[str], None]
    ) -> None:
        super().__init__(name, Line(name, config.server, config.port, config.timeout), "", config.max_age, sink)
        self._clock = clock

    def sample(self, words: list[str]) -> BodySample:
        """One frame."""
        x, y, z, qw, qx, qy, qz, *more = (float(word) for word in words[3:])
        markers = tuple((more[i], more[i + 1], more[i + 2]) for i in range(0, len(more), 3))
        return BodySample(
            self._clock.now(), float(words[0]), int(words[1]), (x, y, z), (qw, qx, qy, qz), 0.0, words[2] == "1", markers
        )

    def usable(self, sample: BodySample) -> bool:
        """Only where the tip was tracked."""
        return sample.valid


DRIVER = Driver("mocap", Config, BenchCameras)
