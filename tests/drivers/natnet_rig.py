"""A fake Motive, and drivers that listen to it."""

from typing import Any

import numpy as np

from drivers.errors import InstrumentError
from drivers.frames import rotation_from_vector
from drivers.interfaces import BodySample
from drivers.natnet.driver import Config, NatNetMocap
from sim_fakes.motive import MotiveFake
from sim_fakes.ur.process import free_host
from tests.simulated.bench import Bench, answered, wait_until


class Motive:
    """The fake, what a driver sends and tells, and the plant that the cameras see; they have no noise."""

    def __init__(self, bench: Bench, **changes: Any) -> None:
        self.bench, self.plant = bench, bench.plant
        self.plant.tip_position = np.array([0.05, -0.08, 0.37])
        self.plant.tip_rotation = rotation_from_vector((0.3, -0.2, 0.9))
        self.plant.markers = np.array([[0.0, 0.0, 0.1], [0.01, -0.02, 0.2], [0.02, -0.04, 0.3]])
        values: dict[str, Any] = {"host": free_host(), "noise": 0.0, "angle_noise": 0.0} | changes
        self.fake: MotiveFake = bench.started(MotiveFake(self.plant, bench.clock, **values))
        self.extra = self.fake.faults.extra
        self.samples: list[BodySample] = []
        self.told: list[str] = []

    def made(self, **changes: Any) -> NatNetMocap:
        """A driver, with other settings in rig.yaml."""
        values = {"server": self.fake.host, "body": "Tip", "mocap_to_base": self.fake.mocap_to_base, "timeout": 1.0}
        config = Config.model_validate(values | {"max_age": 0.25} | changes)
        mocap: NatNetMocap = self.bench.closing(
            NatNetMocap("mocap", config, self.bench.clock, self.samples.append, self.told.append)
        )
        return mocap

    def opened(self, **changes: Any) -> NatNetMocap:
        """The same, opened."""
        mocap = self.made(**changes)
        mocap.open()
        return mocap

    def seen(self, **changes: Any) -> NatNetMocap:
        """The same, with a first valid sample."""
        mocap = self.opened(**changes)
        answered(mocap.latest)
        return mocap

    def frames(self, count: int) -> None:
        """Wait for more samples."""
        goal = len(self.samples) + count
        wait_until(lambda: len(self.samples) >= goal)

    def invalid(self) -> BodySample:
        """Wait for a sample that is invalid."""
        wait_until(lambda: bool(self.samples) and not self.samples[-1].valid)
        return self.samples[-1]


def refused(mocap: NatNetMocap, kind: type[InstrumentError], text: str = "") -> None:
    """Wait until the newest reading is refused for this reason; it may first be for another."""

    def so() -> bool:
        try:
            mocap.latest()
        except kind as e:
            return text in str(e)
        except InstrumentError:
            pass
        return False

    wait_until(so)
