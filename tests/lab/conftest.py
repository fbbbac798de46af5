"""A whole rig of fakes at twenty times real speed, started once, without effects."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from virtual_lab import VirtualLab

from lab.fakes import write_rig
from sim_fakes.rig import FakeRig


@pytest.fixture(scope="session")
def virtual_lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualLab]:
    folder = tmp_path_factory.mktemp("rig")
    with FakeRig(speed=20.0, seed=1) as fakes:
        write_rig(fakes, folder / "rig.yaml")
        yield VirtualLab(fakes, folder / "rig.yaml")
