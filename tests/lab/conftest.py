"""What the tests of the command share: a whole rig of fakes at twenty times real speed, and one diagnosis."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator

import pytest
from diagnosed_case import Answered, campaign, folder
from virtual_lab import VirtualLab

from lab.cli import main
from lab.fakes import write_rig
from sim_fakes.rig import FakeRig


@pytest.fixture(scope="session")
def virtual_lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualLab]:
    folder = tmp_path_factory.mktemp("rig")
    with FakeRig(speed=20.0, seed=1) as fakes:
        write_rig(fakes, folder / "rig.yaml")
        yield VirtualLab(fakes, folder / "rig.yaml")


@pytest.fixture(scope="session")
def answered(tmp_path_factory: pytest.TempPathFactory) -> Answered:
    """One diagnosis for all: a spine credited as by area moments, tried on a campaign with other chambers."""
    root = tmp_path_factory.mktemp("diagnosis")
    effects = {"area_moment.blend": 0.7}
    case = folder(root / "case", campaign(effects))
    other = folder(root / "other", campaign(effects, seed=2, repeats=2, lengths=(0.0, 0.2), chambers=(3, 4, 5)))
    made = Answered(case, other, root / "diagnosis.json", root / "diagnosis.html", root / "next")
    written = ["--json", made.json, "--report", made.page, "--protocols", made.protocols]
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        code = main([str(a) for a in ("diagnose", case, "--holdout", other, *written)])
    return made.with_outcome(code, said.getvalue())
