"""The rig of fakes for tests of the command."""

import math
from pathlib import Path
from typing import IO, Any

import pytest
from commands import Cli, Done
from diagnosed_case import Answered, answered_once, campaign, folder
from matplotlib.figure import Figure
from virtual_lab import VirtualLab

from lab.cli import main
from lab.pages import figures
from lab.verbs.fakes import PATIENT, write_rig
from sim_fakes.rig import FakeRig


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    """Runs a command in this process."""

    def run(*words: object, code: int | tuple[int, ...] = 0) -> Done:
        capsys.readouterr()
        try:
            ended = main([str(word) for word in words])
        except SystemExit as left:
            ended = int(left.code or 0)
        done = Done(ended, *capsys.readouterr())
        assert ended in (code if isinstance(code, tuple) else (code,)), done.both
        return done

    return run


@pytest.fixture(scope="session")
def answered(tmp_path_factory: pytest.TempPathFactory) -> Answered:
    """The diagnosis that tests share."""
    return answered_once(tmp_path_factory.getbasetemp() / "diagnosis")


@pytest.fixture(scope="session")
def small_case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of fourteen states without an effect, to be read."""
    return folder(tmp_path_factory.mktemp("case") / "case", campaign({}, repeats=1, lengths=(0.0, 0.2)))


@pytest.fixture(scope="session")
def virtual_lab(whole_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> VirtualLab:
    rig = tmp_path_factory.mktemp("rig") / "rig.yaml"
    write_rig(whole_rig, rig)
    return VirtualLab(whole_rig, rig)


@pytest.fixture(scope="session")
def real_lab(real_rig: FakeRig, tmp_path_factory: pytest.TempPathFactory) -> VirtualLab:
    """The same for programs of their own."""
    rig = tmp_path_factory.mktemp("rig") / "rig.yaml"
    # a browser may be long in finding that a hidden tip is seen again
    write_rig(real_rig, rig, {**PATIENT, "limits": {**PATIENT["limits"], "resume_within": 300.0}})
    return VirtualLab(real_rig, rig)


@pytest.fixture(autouse=True)
def _unlocked(request: pytest.FixtureRequest) -> None:
    """What one test left locked does not fail the next."""
    for name in ("virtual_lab", "real_lab"):
        if name in request.fixturenames:
            lab: VirtualLab = request.getfixturevalue(name)
            lab.rig.with_suffix(".latch").unlink(missing_ok=True)


@pytest.fixture(autouse=True)
def _one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command diagnoses in this process alone: another one would take as long to start as a small case to diagnose."""
    monkeypatch.setattr("os.sched_getaffinity", lambda process: {0})


@pytest.fixture(autouse=True)
def _no_hurry(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command says does not depend on how fast this computer is."""
    if request.module.__name__ != "test_console":
        monkeypatch.setattr("lab.console.LONG_STEP", math.inf)


@pytest.fixture
def drawn() -> None:
    """Asked for by tests that look at pictures, or at what a picture does with names from outside."""


@pytest.fixture(autouse=True)
def _undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other tests get empty pictures: an import takes most of its time for the picture of its states."""
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(Figure, "savefig", empty)
        monkeypatch.setattr("lab.pages.import_figure.draw", lambda made, robot, path: figures.save(Figure((1, 1)), path))


def empty(figure: Figure, file: IO[bytes], format: str, **_: Any) -> None:
    """A picture of nothing in place of the figure's."""
    Figure(figsize=(1, 1)).canvas.print_figure(file, format=format)
