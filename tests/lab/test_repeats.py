"""A gauge that has frozen is told from one that is at rest, or resolves too little to show its noise."""

from __future__ import annotations

import numpy as np
import pytest

from lab.rig.repeats import Repeats
from lab.rig.watch import STUCK

POLL = 0.05


def stuck(noise: float, digit: float, frozen: bool, seed: int = 0, level: float = 21_330.0) -> float:
    """The longest that is said of a gauge which shows 30 s of noise (Pa) in digits (Pa), and then perhaps freezes for 3 s."""
    random, repeats, longest = np.random.default_rng(seed), Repeats(), 0.0
    shown = level
    for k in range(660):
        if not frozen or k < 600:
            shown = float(np.rint((level + noise * random.normal()) / digit) * digit)
        repeats.take(shown, k * POLL)
        longest = max(longest, repeats.stuck)
    return longest


@pytest.mark.parametrize(("noise", "digit"), [(107.0, 10.0), (30.0, 10.0), (500.0, 100.0)])
def test_a_noisy_gauge_that_repeats_itself_is_frozen(noise: float, digit: float) -> None:
    assert stuck(noise, digit, True) > STUCK
    assert stuck(noise, digit, False) == 0.0


@pytest.mark.parametrize("offset", [0.0, 0.25, 0.5])
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 0.5, 1.0, 2.0])
def test_a_gauge_of_coarse_resolution_is_no_frozen_one(noise: float, offset: float) -> None:
    for seed in range(20):
        assert stuck(100.0 * noise, 100.0, False, seed, 21_300.0 + 100.0 * offset) <= STUCK


def test_a_pressure_that_changes_and_then_rests_is_no_frozen_gauge() -> None:
    repeats = Repeats()
    for k in range(60):
        repeats.take(100e3 - 1e3 * k, k * POLL)
    for k in range(60, 200):
        repeats.take(40e3, k * POLL)
        assert repeats.stuck == 0.0


def test_what_was_before_a_pause_is_forgotten() -> None:
    random, repeats = np.random.default_rng(1), Repeats()
    for k in range(40):
        repeats.take(float(np.rint(21e3 + 100 * random.normal())), k * POLL)
    repeats.forget()
    for k in range(40, 80):
        repeats.take(21e3, k * POLL)
        assert repeats.stuck == 0.0
