"""What a test of drivers or fakes starts and makes."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest

from sim_fakes.plant import Plant
from timing import RigClock


class Bench:
    """A plant, a clock, and the fakes and drivers of one test, which end with it."""

    def __init__(self, speed: float) -> None:
        self.plant, self.clock = Plant(), RigClock(speed)
        self.ends = contextlib.ExitStack()

    def started(self, fake: Any) -> Any:
        """The fake, started."""
        fake.start()
        self.ends.callback(fake.stop)
        return fake

    def closing(self, driver: Any) -> Any:
        """The driver, or whatever else is closed at the end of the test."""
        self.ends.callback(driver.close)
        return driver

    def end(self) -> None:
        """Close drivers and stop fakes, the last ones first."""
        self.ends.close()


def of_speed(speed: float) -> pytest.MarkDecorator:
    """Mark of tests whose bench has a clock of this speed."""
    return pytest.mark.parametrize("bench", [speed], indirect=True, ids=[""])
