"""Silence as a device's watchdog counts it."""

import pytest

from sim_fakes.punctual import LATE, Silence


def test_silence_is_counted_while_the_fake_is_awake(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("timing.now", lambda: now)
    silence = Silence()
    for _ in range(20):
        now += 0.02
        silence.now()
    assert silence.now() == pytest.approx(0.4)
    now += 5.0  # the computer was busy: what came meanwhile waits to be read
    assert silence.now() == pytest.approx(0.4 + LATE)
    silence.heard()
    assert silence.now() == 0.0
