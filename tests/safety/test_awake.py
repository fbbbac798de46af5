"""A silence counts only while this process was awake to hear something."""

import pytest

from lab.guard.awake import LONGEST_LOOK, Awake


class Host:
    """The time of a computer, as far as a test lets it go."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_time_that_the_process_was_away_does_not_count() -> None:
    host = Host()
    clock = Awake(host)
    for _ in range(10):
        host.now += 0.1
        clock.look()
    assert clock.now == pytest.approx(1.0)
    host.now += 3600.0  # a paused virtual machine
    assert clock.look() == pytest.approx(1.0 + LONGEST_LOOK)


def test_a_process_that_is_always_late_still_hears_a_silence_in_the_end() -> None:
    host = Host()
    clock = Awake(host)
    for _ in range(10):
        host.now += 5.0
        clock.look()
    assert clock.now == pytest.approx(10 * LONGEST_LOOK)
