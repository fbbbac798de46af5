"""When a motor is judged to be stalled."""

import pytest

from drivers.dynamixel.driver import StallWatch


def fed(readings: list[tuple[float, float, float]]) -> list[bool]:
    watch = StallWatch(allowed=1.0, window=10, duration=0.5)
    return [watch.update(t, position, current) for t, position, current in readings]


def test_pushing_without_moving_for_the_duration_is_a_stall() -> None:
    assert fed([(0.0, 0, 0.9), (0.3, 5, -0.9), (0.6, 3, 1.0)]) == [False, False, True]


@pytest.mark.parametrize("readings", [
    [(0.0, 0, 0.9), (0.3, 20, 0.9), (0.6, 40, 0.9), (0.9, 60, 0.9)],
    [(0.0, 0, 0.9), (0.3, 0, 0.1), (0.6, 0, 0.9), (0.9, 0, 0.9)],
    [(0.0, 0, 0.9), (5.0, 0, 0.9)],
], ids=["moving", "not pushing in between", "two late readings only"])  # fmt: skip
def test_anything_less_is_not(readings: list[tuple[float, float, float]]) -> None:
    assert not any(fed(readings))
