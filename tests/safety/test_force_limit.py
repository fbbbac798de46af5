"""What the force sensor's thread tells the guard, through the pipe that carries it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.ft300s import driver as ft300s
from drivers.interfaces import Vector6, WrenchSample
from lab.files.rig_file import RigFile
from lab.guard.force_limit import AGREE, ForceLimit, overload
from lab.guard.pulse import BEAT, FORCE, FORCE_RANGE, FRESH, MOMENT, MOMENT_RANGE, Listener, Pulse

RIG = RigFile.model_validate(
    {"name": "desk", "robot": Path("robot.yaml"), "instruments": {"force": {"driver": "ft300s", "port": "/dev/null"}}}
)
TOOL: Vector6 = (1.5, -2.25, 30.0, 0.1, -0.5, 1.0)
ZERO: Vector6 = (0.0,) * 6


@pytest.fixture
def line() -> Iterator[tuple[ForceLimit, Listener]]:
    receive, send = os.pipe()
    pulse, listener = Pulse(send), Listener(receive)
    yield ForceLimit(RIG.limits, ft300s.Config(port="/dev/null"), pulse), listener
    pulse.close()
    os.close(receive)


def loaded(axis: int, by: float, zero: Vector6 = ZERO) -> WrenchSample:
    raw = list(TOOL)
    raw[axis] += by
    return WrenchSample(0.0, (raw[0], raw[1], raw[2], raw[3], raw[4], raw[5]), zero)


def told(listener: Listener) -> list[bytes]:
    return [kind for kind, _ in listener.take() if kind not in (BEAT, FRESH)]


def feed(limit: ForceLimit, sample: WrenchSample, times: int) -> None:
    for _ in range(times):
        limit.judge(sample)


@pytest.mark.parametrize(("axis", "by", "kind"), [(0, 250.0, FORCE), (2, 65.0, FORCE), (4, 12.0, MOMENT)])
def test_a_load_is_told_before_the_sensor_has_its_zero(
    line: tuple[ForceLimit, Listener], axis: int, by: float, kind: bytes
) -> None:
    limit, listener = line
    feed(limit, loaded(0, 0.0), 3)
    assert told(listener) == []
    feed(limit, loaded(axis, by), AGREE)
    assert told(listener) == [kind]


def test_a_tool_as_heavy_as_the_limit_is_no_load(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    feed(limit, loaded(2, 60.0), 100)
    assert told(listener) == []


def test_a_knock_of_one_sample_is_no_load_not_even_the_first(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    feed(limit, loaded(0, 200.0), 1)
    feed(limit, loaded(0, 0.0), 10)
    feed(limit, loaded(0, 200.0), 1)
    feed(limit, loaded(0, 0.0), 10)
    assert told(listener) == []
    feed(limit, loaded(0, 65.0), AGREE)
    assert told(listener) == [FORCE]


@pytest.mark.parametrize(("axis", "by", "kind"), [(1, 305.0, FORCE_RANGE), (3, 31.0, MOMENT_RANGE)])
def test_a_raw_value_beyond_the_sensors_range_is_told_though_it_was_there_from_the_first_sample(
    line: tuple[ForceLimit, Listener], axis: int, by: float, kind: bytes
) -> None:
    limit, listener = line
    feed(limit, loaded(axis, by), AGREE)
    assert told(listener) == [kind]
    assert "range" in overload(kind, by, RIG)


def test_beyond_the_zero_counts_once_there_is_one(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    feed(limit, loaded(0, 0.0), 5)
    feed(limit, loaded(0, 59.0, TOOL), 5)
    assert told(listener) == []
    feed(limit, loaded(0, 61.0, TOOL), AGREE)
    assert told(listener) == [FORCE]


def test_a_load_is_told_as_long_as_it_lasts(line: tuple[ForceLimit, Listener]) -> None:
    """The guard lets pass what it hears while nothing is energised; it must hear it again afterwards."""
    limit, listener = line
    feed(limit, loaded(0, 0.0), 5)
    feed(limit, loaded(0, 250.0), AGREE + 10)
    assert told(listener) == [FORCE] * 11


def test_a_new_stream_begins_with_its_own_tool(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    feed(limit, loaded(0, 0.0), 5)
    limit.begin()
    feed(limit, loaded(0, 80.0), 5)
    assert told(listener) == []


def test_samples_alone_are_no_sign_of_life_of_the_program(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    listener.heard = 0.0
    limit.judge(loaded(0, 0.0))
    records = listener.take()
    assert FRESH in [kind for kind, _ in records]
    assert (listener.heard > 0.0) is any(kind == BEAT for kind, _ in records)
