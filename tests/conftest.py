"""Tests run in three processes, one for each group of whole rigs at first: with more, rigs starve on two processors. Whatever
runs a whole rig of fakes is in one of three, `WHOLE`, `SAFETY` and `OWN`, which also has what starts rigs of its own: with more
rigs at once some would starve; what would starve a rig (a cluster of processes) is with them. Most of what solves rods shares one
more, since each kind of rod is compiled once, in the process that first needs it; `ANSWERED` shares one diagnosis. On one
processor one process runs it all. All others stay together file by file. What talks to instruments is late when it may not run
at once: it comes before other programs where the system allows it, as the guard does, and all else steps back."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

from lab.guard.child import SESSION, take_place
from timing import SimulatedClock

if TYPE_CHECKING:
    from sim_fakes.rig import FakeRig

signal.signal(signal.SIGINT, signal.default_int_handler)
"""A shell that starts the tests behind it has them ignore Ctrl-C; a program that a test starts would inherit that."""

WHOLE, SAFETY, OWN, CALLS = "whole rig", "safety", "rigs of their own", "call order"
RODS, ANSWERED = "rods", "one diagnosis"
GROUPS = {
    "docs": OWN,
    "safety": SAFETY,
    "test_call_order.py": CALLS,
    "test_call_order_network.py": CALLS,
    "test_contract.py": OWN,
    "test_bad_input.py": WHOLE,
    "test_blind_wire.py": OWN,
    "test_campaign.py": WHOLE,
    "test_check_moves.py": OWN,
    "test_cluster.py": OWN,
    "test_end_to_end.py": WHOLE,
    "test_fault_matrix.py": WHOLE,
    "test_front_door.py": WHOLE,
    "test_investigate_verb.py": WHOLE,
    "test_keys.py": WHOLE,
    "test_own_protocol.py": WHOLE,
    "test_plain_text_on_a_rig.py": OWN,
    "test_printed_tables.py": WHOLE,
    "test_processes.py": WHOLE,
    "test_proposed_experiments.py": WHOLE,
    "test_recorded_run.py": OWN,
    "test_resume.py": OWN,
    "test_three_chambers.py": WHOLE,
    "test_watch.py": OWN,
    "test_who_may_speak.py": OWN,
    "diagnosis": RODS,
    "model": RODS,
    "test_blind_bench.py": RODS,
    "test_diagnose_verb.py": ANSWERED,
    "test_diagnosis_page.py": ANSWERED,
    "test_export.py": ANSWERED,
    "test_paper_findings.py": RODS,
    "test_sampled_evidence.py": RODS,
}
"""By folder or file. (The marks of pytest-xdist 3.8 for groups do nothing with pytest 9.2.)"""
ORDER = (WHOLE, SAFETY, OWN, RODS, CALLS, "drivers", ANSWERED)
"""What takes longest begins first, then what talks to instruments: not every system lets a process that has stepped back come
forward. What solves rods outside of `RODS` comes late: by then they are compiled."""
AT_FIRST = os.getpriority(os.PRIO_PROCESS, 0)
STEPPED_BACK = max(AT_FIRST, 15)
"""Niceness of what talks to instruments, and of all else. Linux schedules by session first (`lab.guard.child`): among sessions
what talks to instruments has the guard's place, and all else that of any other program."""

RUNNING: list[FakeRig] = []
"""Stopped before the first test that steps back, since all that use it are done (`ORDER`): fakes that hardly get a processor
would fall behind, and take what they get from the tests that follow."""

settings.register_profile("lab", deadline=None)
settings.load_profile("lab")


def group(nodeid: str) -> str:
    """The group of a test."""
    path = nodeid.partition("::")[0].removeprefix("tests/").split("/")
    return GROUPS.get(path[-1], GROUPS.get(path[0], "/".join(path)))


class ByGroup(LoadScopeScheduling):  # type: ignore[misc]
    """Hands out groups, in the order of their first tests."""

    def _split_scope(self, nodeid: str) -> str:
        return group(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByGroup:
    config.option.loadscopereorder = False
    return ByGroup(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The groups of `ORDER` first; the pages of the docs last of theirs, since by then the rods they solve are compiled."""

    def place(item: pytest.Item) -> tuple[int, bool]:
        name = group(item.nodeid).partition("/")[0]
        return (*ORDER, name).index(name), "tests/docs/" in item.nodeid

    for item in items:
        if "real_rig" in getattr(item, "fixturenames", ()):
            item.add_marker("real")
    items.sort(key=place)


def pytest_configure(config: pytest.Config) -> None:
    """A process of several has a session of its own."""
    if hasattr(config, "workerinput"):
        os.setsid()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Beside other processes, whatever talks to instruments comes first and all else steps back, without a rig."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        name = group(item.nodeid)
        talks = name in (WHOLE, SAFETY, OWN, CALLS) or name.startswith("drivers/")
        while RUNNING and not talks:
            RUNNING.pop().stop()
        take_place(SESSION if talks else 0, AT_FIRST if talks else STEPPED_BACK)


@pytest.fixture
def simulated() -> Iterator[SimulatedClock]:
    """The test, and all that it makes, lives in a clock that jumps over the time in which everything waits."""
    with SimulatedClock() as clock:
        yield clock
    clock.close()


REAL_TIME = {
    "test_serial_line.py": "ptys and what the system does to them",
    "test_pty_fake.py": "ptys",
    "test_punctual.py": "the computer's own delays",
    "test_ur5.py": "the maker's library, with threads of its own",
    "test_ur5_faults.py": "the maker's library",
    "test_ur5_settings.py": "the maker's library",
    "test_ur5_state.py": "the maker's library",
    "test_ur.py": "the maker's library",
    "test_ur_wire.py": "the maker's library",
    "test_contract.py": "commands and packages as a person has them",
    "test_broken_packages.py": "commands as a person has them",
}
"""Of the tests of drivers and fakes, those that keep real time, and what for."""


@pytest.fixture(autouse=True)
def _clock(request: pytest.FixtureRequest) -> None:
    """Drivers and fakes are tried in a simulated clock."""
    near = request.path.parent.name in ("drivers", "motive", "sim_fakes") or request.path.name == "test_call_order.py"
    if near and request.path.name not in REAL_TIME:
        request.getfixturevalue("simulated")


@pytest.fixture(scope="session")
def whole_rig() -> Iterator[FakeRig]:
    """All fakes of a rig without effects, in a clock that jumps: started once, and used by tests that live in that clock."""
    from sim_fakes.rig import FakeRig  # with a compiler, which few of the tests need

    with world(), FakeRig(speed=20.0, seed=1) as running:
        yield running


@pytest.fixture(scope="session")
def shared_clock() -> SimulatedClock:
    """The clock of the whole rig, for rigs that several tests share."""
    return world()


@pytest.fixture(scope="session")
def real_rig() -> Iterator[FakeRig]:
    """The same on real lines, at twenty times real speed, for tests marked `real`: processes, signals, kills."""
    from sim_fakes.rig import FakeRig

    with FakeRig(speed=20.0, seed=1) as running:
        RUNNING.append(running)
        yield running


@functools.cache
def world() -> SimulatedClock:
    """The clock of the whole rig."""
    return SimulatedClock()


LIVE_THERE = {"whole_rig", "shared_clock", "house"}
"""What tests ask for that live in that clock."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    names = set(getattr(item, "fixturenames", ()))
    with world() if names & LIVE_THERE and not item.get_closest_marker("real") else contextlib.nullcontext():
        return (yield)
