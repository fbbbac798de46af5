"""Rigs of fakes live in one process, in a clock that jumps over the time in which everything waits (`timing`): they cost only
their computation, and no load changes what they do. What cannot live there is marked `real`: processes that are killed, signals,
ptys, the makers' libraries. It shares one process of the tests, one after the other."""

from __future__ import annotations

import ast
import contextlib
import functools
import gc
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

from tests.simulated.bench import Bench
from tests.simulated.clock import SimulatedClock

if TYPE_CHECKING:
    from sim_fakes.plant import Plant
    from sim_fakes.rig import FakeRig

HANDLERS = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
"""With which each test begins. A shell that starts the tests behind it has them ignore Ctrl-C, which a program that a test starts
would inherit; and a run that was stopped leaves signals ignored, since its program ends."""

REAL, RODS, ANSWERED = "real", "rods", "one diagnosis"
GROUPS = {
    REAL: (
        "test_cluster.py",
        "test_contract.py",
        "test_fault_matrix.py",
        "test_pages.py",
        "test_ur5.py",
        "test_ur5_faults.py",
    ),
    RODS: ("diagnosis", "model", "test_blind_bench.py", "test_paper.py"),
    ANSWERED: ("test_diagnose_verb.py", "test_diagnosis_page.py", "test_export.py", "test_same_numbers.py"),
}
"""By folder or file: what is real waits for the computer, most of what solves rods compiles the same kernels, and `ANSWERED`
shares one diagnosis. Any other file is a group of its own."""

gc.set_threshold(20_000, 50, 10)
"""Of the libraries' many objects few are ever garbage: looking through them took a tenth of the time."""

os.fsync = lambda fd: None
"""What was written outlives a killed process all the same; a loss of power is not tried here."""

settings.register_profile("lab", deadline=None)
settings.load_profile("lab")


def group(nodeid: str) -> str:
    """The group of a test."""
    place, _, name = nodeid.partition("::")
    path = place.removeprefix("tests/").split("/")
    if name.partition("[")[0] in real_ones(place):
        return REAL
    return next((name for name, places in GROUPS.items() if {path[0], path[-1]} & {*places}), "/".join(path))


@functools.cache
def real_ones(place: str) -> set[str]:
    """Functions of a file that are marked `real` or ask for a real rig; by its text, since who hands out tests imports none."""
    file = Path(__file__).parent.parent / place
    tree = ast.parse(file.read_text(encoding="utf-8")) if file.suffix == ".py" else ast.Module([], [])
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    found = {node.name for node in functions if any("mark.real" in ast.unparse(d) for d in node.decorator_list)}
    asked = {"real_rig", "real_lab", "real_house"}
    for _ in range(3):  # fixtures of fixtures
        more = {node.name for node in functions if asked & {argument.arg for argument in node.args.args}}
        asked |= more
        found |= more
    return found


class ByGroup(LoadScopeScheduling):  # type: ignore[misc]
    """Hands out groups, in the order of their first tests."""

    def _split_scope(self, nodeid: str) -> str:
        return group(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByGroup:
    config.option.loadscopereorder = False
    return ByGroup(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is real begins first, since it takes longest. The collector of garbage passes over all that exists by now."""
    for item in items:
        if "real_rig" in getattr(item, "fixturenames", ()):
            item.add_marker("real")
    items.sort(key=lambda item: group(item.nodeid) != REAL)
    gc.freeze()


@pytest.fixture
def simulated() -> Iterator[SimulatedClock]:
    """The test, and all that it makes, lives in a clock that jumps over the time in which everything waits."""
    with SimulatedClock() as clock:
        yield clock
    clock.close()


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """What a test starts and makes; the mark `speed` gives its clock another speed than twenty times the host's."""
    mark = request.node.get_closest_marker("speed")
    bench = Bench(mark.args[0] if mark else 20.0)
    yield bench
    bench.end()


@pytest.fixture
def plant(bench: Bench) -> Plant:
    """What the fakes act on."""
    return bench.plant


@pytest.fixture
def opened(make: Callable[..., Any]) -> Callable[..., Any]:
    """Makes a driver as `make` of the test's file does, and opens it."""

    def opened(**changes: object) -> Any:
        made = make(**changes)
        made.open()
        return made

    return opened


REAL_TIME = {
    "test_serial_line.py": "ptys and what the system does to them",
    "test_pty_fake.py": "ptys and the computer's own delays",
    "test_ur5.py": "the maker's library, with threads of its own",
    "test_ur5_faults.py": "the maker's library",
    "test_ur5_settings.py": "the maker's library, where no shared arm is asked for",
    "test_ur.py": "the maker's library",
    "test_ur_wire.py": "the maker's library",
    "test_contract.py": "commands and packages as a person has them",
}
"""Of the tests of drivers and fakes, those that keep real time, and what for."""


@pytest.fixture(autouse=True)
def _clock(request: pytest.FixtureRequest) -> None:
    """Drivers and fakes are tried in a simulated clock."""
    near = request.path.parent.name in ("drivers", "sim_fakes") or request.path.name == "test_call_order.py"
    if near and request.path.name not in REAL_TIME:
        request.getfixturevalue("simulated")


@pytest.fixture(scope="session")
def whole_rig() -> Iterator[FakeRig]:
    """All fakes of a rig without effects, in a clock that jumps: started once, and used by tests that live in that clock."""
    from sim_fakes.rig import FakeRig  # with a compiler, which few of the tests need

    kept = contextlib.ExitStack()
    with world():
        running = kept.enter_context(FakeRig(speed=20.0, seed=1))
    yield running  # left meanwhile, so that tests in real time live in the computer's clock
    with world():
        kept.close()


@pytest.fixture(scope="session")
def shared_clock() -> SimulatedClock:
    """The clock of the whole rig, for rigs that several tests share."""
    return world()


REAL_RIG = contextlib.ExitStack()
"""Ended with the last of the tests marked `real`: at twenty times real speed, it takes a tenth of a processor at rest."""


@pytest.fixture(scope="session")
def real_rig() -> Iterator[FakeRig]:
    """The same on real lines, at twenty times real speed, for tests marked `real`: processes, signals, kills."""
    from sim_fakes.rig import FakeRig

    with REAL_RIG:
        yield REAL_RIG.enter_context(FakeRig(speed=20.0, seed=1))


@functools.cache
def world() -> SimulatedClock:
    """The clock of the whole rig."""
    return SimulatedClock()


LIVE_THERE = {"whole_rig", "shared_clock", "house"}
"""What tests ask for that live in that clock."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    names = set(getattr(item, "fixturenames", ()))
    assert not {"whole_rig", "real_rig"} <= names, f"{item.nodeid} asks for a rig of each kind"
    for number, handler in HANDLERS.items():
        signal.signal(number, handler)
    with world() if names & LIVE_THERE and not item.get_closest_marker("real") else contextlib.nullcontext():
        ran = yield
    if nextitem is not None and group(item.nodeid) == REAL != group(nextitem.nodeid):
        REAL_RIG.close()
    return ran
