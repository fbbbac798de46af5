"""The rig of fakes for the tests of safety, made sound again after each."""

from collections.abc import Iterator

import pytest
from house import House

from lab.rig.assembly import Rig
from lab.verbs.fakes import PATIENT, write_rig
from sim_fakes.rig import FakeRig


@pytest.fixture(scope="session")
def simulated_house(whole_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> House:
    return House(whole_rig, tmp_path_factory.mktemp("safety") / "rig.yaml")


@pytest.fixture(scope="session")
def real_house(real_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> House:
    return House(real_rig, tmp_path_factory.mktemp("safety") / "rig.yaml")


@pytest.fixture
def house(request: pytest.FixtureRequest) -> Iterator[House]:
    real = request.node.get_closest_marker("real") is not None
    house: House = request.getfixturevalue("real_house" if real else "simulated_house")
    fakes = house.fakes
    # Late for want of processors is not dead; how soon that is noticed is what tests change in their own rig.yaml.
    changes = {"instruments": PATIENT["instruments"], "limits": {"max_age": 5.0, "pressure_error_time": 60.0}} if real else {}
    write_rig(fakes, house.rig, changes)
    house.rig.with_suffix(".latch").unlink(missing_ok=True)
    fakes.troubles.clear()
    yield house
    fakes.switch.end()
    fakes.on_confirm = None


@pytest.fixture
def small(house: House) -> House:
    """The rig without arm, force sensor and cameras: quick to connect."""
    house.change(without=("arm", "force", "mocap"))
    return house


@pytest.fixture
def rig(small: House) -> Iterator[Rig]:
    """The same, with all its instruments open."""
    with small.opened() as opened:
        yield opened
