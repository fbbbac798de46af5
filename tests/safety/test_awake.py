"""A silence counts only while this process was awake to hear something."""

from __future__ import annotations

import pytest

from lab.guard import awake
from lab.guard.awake import LONGEST_LOOK, Awake


def test_time_that_the_process_was_away_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(awake.time, "monotonic", lambda: now[0])
    clock = Awake()
    for _ in range(10):
        now[0] += 0.1
        clock.look()
    assert clock.now == pytest.approx(1.0)
    now[0] += 3600.0  # a paused virtual machine
    assert clock.look() == pytest.approx(1.0 + LONGEST_LOOK)


def test_a_process_that_is_always_late_still_hears_a_silence_in_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(awake.time, "monotonic", lambda: now[0])
    clock = Awake()
    for _ in range(10):
        now[0] += 5.0
        clock.look()
    assert clock.now == pytest.approx(10 * LONGEST_LOOK)
