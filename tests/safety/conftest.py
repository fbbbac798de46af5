"""The rig of fakes for the tests of safety, made sound again after each."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from house import House

from lab.verbs.fakes import PATIENT, write_rig
from sim_fakes.rig import FakeRig


@pytest.fixture(scope="session")
def one_house(whole_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> House:
    return House(whole_rig, tmp_path_factory.mktemp("safety") / "rig.yaml")


@pytest.fixture
def house(one_house: House) -> Iterator[House]:
    fakes = one_house.fakes
    # Late for want of processors is not dead; how soon that is noticed is what tests change in their own rig.yaml.
    write_rig(fakes, one_house.rig, {"instruments": PATIENT["instruments"], "limits": {"max_age": 5.0}})
    one_house.rig.with_suffix(".latch").unlink(missing_ok=True)
    fakes.troubles.clear()
    yield one_house
    fakes.switch.end()
    fakes.on_confirm = None
