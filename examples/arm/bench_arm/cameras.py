"""Driver of the cameras."""

from collections.abc import Callable

from pydantic import Field

from drivers.configs import MocapConfig
from drivers.errors import BadReply
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
        if len(words) < 10 or len(words) % 3 != 1:
            raise BadReply(self.name, f"sends {len(words)} numbers, needed 10 and 3 a marker; check the cable")
        stamp, frame, seen, x, y, z, qw, qx, qy, qz, *more = self._line.numbers(words)
        markers = tuple((more[i], more[i + 1], more[i + 2]) for i in range(0, len(more), 3))
        return BodySample(self._clock.now(), stamp, round(frame), (x, y, z), (qw, qx, qy, qz), 0.0, seen == 1, markers)

    def usable(self, sample: BodySample) -> bool:
        """Only where the tip was tracked."""
        return sample.valid


DRIVER = Driver("mocap", Config, BenchCameras)
