"""A whole rig of fakes at twenty times real speed, started once, without effects."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from virtual_lab import VirtualLab

from lab.verbs.fakes import PATIENT, write_rig
from sim_fakes.rig import FakeRig


@pytest.fixture(scope="session")
def virtual_lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualLab]:
    rig = tmp_path_factory.mktemp("rig") / "rig.yaml"
    with FakeRig(speed=20.0, seed=1) as fakes:
        write_rig(fakes, rig, PATIENT)  # tests/safety tries the limits themselves
        yield VirtualLab(fakes, rig)


@pytest.fixture(autouse=True)
def _unlocked(request: pytest.FixtureRequest) -> None:
    """What one test left locked does not fail the next."""
    if "virtual_lab" in request.fixturenames:
        lab: VirtualLab = request.getfixturevalue("virtual_lab")
        lab.rig.with_suffix(".latch").unlink(missing_ok=True)
