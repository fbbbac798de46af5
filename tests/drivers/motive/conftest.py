"""A fake Motive and drivers that listen to it.

With LAB_TEST_NATNET_SERVER and LAB_TEST_NATNET_BODY (and LAB_TEST_NATNET_LOCAL) the tests that need no fault run
against a real server that sees the body.
"""

import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from natnet_rig import IDENTITY, Make, free_host

from drivers.frames import rotation_from_vector
from drivers.interfaces import BodySample
from drivers.natnet.driver import Config, NatNetMocap
from sim_fakes.motive import MotiveFake
from sim_fakes.plant import Plant
from timing import RigClock

SERVER = os.environ.get("LAB_TEST_NATNET_SERVER")


@pytest.fixture
def plant() -> Plant:
    plant = Plant()
    plant.tip_position = np.array([0.05, -0.08, 0.37])
    plant.tip_rotation = rotation_from_vector((0.3, -0.2, 0.9))
    plant.markers = np.array([[0.0, 0.0, 0.1], [0.01, -0.02, 0.2], [0.02, -0.04, 0.3]])
    return plant


@pytest.fixture
def fake(plant: Plant, request: pytest.FixtureRequest) -> Iterator[MotiveFake]:
    if SERVER:
        pytest.skip("needs the fake server")
    changes = getattr(request, "param", {})
    values: dict[str, Any] = {"host": free_host(), "noise": 0.0, "angle_noise": 0.0} | changes
    fake = MotiveFake(plant, RigClock(10.0), **values)
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def samples() -> list[BodySample]:
    return []


@pytest.fixture
def make(request: pytest.FixtureRequest, samples: list[BodySample]) -> Iterator[Make]:
    made: list[NatNetMocap] = []

    def make(notice: Callable[[str], None] = lambda _: None, **changes: Any) -> NatNetMocap:
        if SERVER:
            values: dict[str, Any] = {"server": SERVER, "body": os.environ.get("LAB_TEST_NATNET_BODY", "Tip")}
            values |= {"local": os.environ.get("LAB_TEST_NATNET_LOCAL", ""), "mocap_to_base": IDENTITY}
        else:
            fake = request.getfixturevalue("fake")
            values = {"server": fake.host, "body": "Tip", "mocap_to_base": fake.mocap_to_base, "timeout": 1.0}
            values["max_age"] = 0.25
        made.append(NatNetMocap("mocap", Config(**values | changes), RigClock(10.0), samples.append, notice))
        return made[-1]

    yield make
    for mocap in made:
        mocap.close()
