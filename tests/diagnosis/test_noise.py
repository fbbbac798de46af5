"""Noise that lasts: the covariance is the one that is written down, and whitening takes it away."""

import numpy as np
import pytest

from diagnosis.data.noise import Lasting, Noise

TRIAL, STATE = np.repeat([0, 0, 1, 1, 1, -1], 3), np.repeat(np.arange(6), 3)
TIME, CHANNEL = np.repeat([0.0, 20, 0, 10, 40, np.nan], 3), np.tile([0, 1, 2], 6)
OWN, SLOW = np.linspace(1, 2, 18), np.where(TRIAL < 0, 0.0, np.tile([1.5, 0.5, 0.0], 6))
RESPONSE = np.column_stack([np.sin(np.arange(18)), np.cos(np.arange(18))])
EVERY = np.ones(18)
NOISE = Noise(STATE, OWN, RESPONSE, Lasting(TRIAL, TIME, CHANNEL, SLOW, 0.7 * EVERY, 30.0 * EVERY))


def covariance() -> np.ndarray:
    out = np.zeros((18, 18))
    for i in range(18):
        for j in range(18):
            same = STATE[i] == STATE[j]
            kept = 1.0 if same else np.exp(-abs(TIME[i] - TIME[j]) / 30.0) if TRIAL[i] == TRIAL[j] >= 0 else 0.0
            out[i, j] = OWN[i] ** 2 * (i == j) + SLOW[i] * SLOW[j] * kept * (CHANNEL[i] == CHANNEL[j])
            out[i, j] += RESPONSE[i] @ RESPONSE[j] * (0.3 * same + 0.7 * kept)
    return out


def test_whitening_takes_the_covariance_away() -> None:
    white = NOISE.whiten(np.eye(18))
    assert white @ covariance() @ white.T == pytest.approx(np.eye(18), abs=1e-9)
    values = np.linspace(-1, 1, 18)
    assert NOISE.colour(NOISE.whiten(values)) == pytest.approx(values)
    assert NOISE.whiten(values) == pytest.approx(white @ values)


def test_the_determinant_is_that_of_the_covariance() -> None:
    assert NOISE.log_sd == pytest.approx(0.5 * np.linalg.slogdet(covariance())[1])


def test_readings_of_other_trials_have_other_errors() -> None:
    part = TRIAL == 1
    values = np.linspace(0, 1, 18)
    assert NOISE.take(part).whiten(values[part]) == pytest.approx(NOISE.whiten(values)[part])


def test_two_campaigns_have_errors_of_their_own() -> None:
    assert NOISE.lasting is not None
    both = NOISE.lasting.then(NOISE.lasting)
    assert both.block.tolist() == [*TRIAL, *np.where(TRIAL < 0, -1, TRIAL + 2)]
    beside = Noise(np.concatenate([STATE, STATE + 6]), np.tile(OWN, 2), np.tile(RESPONSE, (2, 1)), both)
    values = np.linspace(-1, 1, 18)
    assert beside.whiten(np.tile(values, 2)) == pytest.approx(np.tile(NOISE.whiten(values), 2))
    alone = Noise(STATE, OWN, RESPONSE)
    nothing = Noise(STATE, OWN, RESPONSE, Lasting.none(18))
    assert nothing.whiten(values) == pytest.approx(alone.whiten(values))
