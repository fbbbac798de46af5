"""What the force sensor's thread tells the guard, through the pipe that carries it."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.ft300s import driver as ft300s
from drivers.interfaces import Vector6, WrenchSample
from lab.files.rig_file import RigFile
from lab.guard.pulse import AGREE, BEAT, FORCE, FORCE_RANGE, FRESH, MOMENT, MOMENT_RANGE, ForceLimit, Listener, Pulse, overload

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


@pytest.mark.parametrize(
    ("samples", "expected"),
    [
        pytest.param([(3, loaded(0, 0.0)), (AGREE, loaded(0, 250.0))], [FORCE], id="before the sensor has its zero"),
        pytest.param([(3, loaded(0, 0.0)), (AGREE, loaded(2, 65.0))], [FORCE], id="the same along z"),
        pytest.param([(3, loaded(0, 0.0)), (AGREE, loaded(4, 12.0))], [MOMENT], id="a moment"),
        pytest.param([(100, loaded(2, 60.0))], [], id="a tool as heavy as the limit is no load"),
        pytest.param(
            [(1, loaded(0, 200.0)), (10, loaded(0, 0.0)), (1, loaded(0, 200.0)), (10, loaded(0, 0.0))], [],
            id="a knock of one sample is none, not even the first",
        ),
        pytest.param(
            [(1, loaded(0, 200.0)), (10, loaded(0, 0.0)), (AGREE, loaded(0, 65.0))], [FORCE], id="after a knock"
        ),
        pytest.param([(AGREE, loaded(1, 305.0))], [FORCE_RANGE], id="beyond the range from the first sample"),
        pytest.param([(AGREE, loaded(3, 31.0))], [MOMENT_RANGE], id="the same of a moment"),
        pytest.param([(5, loaded(0, 0.0)), (5, loaded(0, 59.0, TOOL))], [], id="59 N beyond the zero"),
        pytest.param([(5, loaded(0, 0.0)), (AGREE, loaded(0, 61.0, TOOL))], [FORCE], id="61 N beyond the zero"),
        # The guard lets pass what it hears while nothing is energised; it must hear it again afterwards.
        pytest.param([(5, loaded(0, 0.0)), (AGREE + 10, loaded(0, 250.0))], [FORCE] * 11, id="as long as it lasts"),
    ],
)  # fmt: skip
def test_which_loads_are_told(
    line: tuple[ForceLimit, Listener], samples: list[tuple[int, WrenchSample]], expected: list[bytes]
) -> None:
    limit, listener = line
    for times, sample in samples:
        for _ in range(times):
            limit.judge(sample)
    assert told(listener) == expected


def test_a_value_beyond_the_range_is_told_as_such() -> None:
    assert "range" in overload(FORCE_RANGE, 305.0, RIG) and "range" in overload(MOMENT_RANGE, 31.0, RIG)


def test_a_new_stream_begins_with_its_own_tool(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    limit.judge(loaded(0, 0.0))
    limit.begin()
    for _ in range(5):
        limit.judge(loaded(0, 80.0))
    assert told(listener) == []


def test_samples_alone_are_no_sign_of_life_of_the_program(line: tuple[ForceLimit, Listener]) -> None:
    limit, listener = line
    listener.heard = 0.0
    limit.judge(loaded(0, 0.0))
    records = listener.take()
    assert FRESH in [kind for kind, _ in records]
    assert (listener.heard > 0.0) is any(kind == BEAT for kind, _ in records)
