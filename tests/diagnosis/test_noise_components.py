"""Noise: its components come from repeats alone, what lasts is whitened away, and chambers of one regulator err together."""

import math
from dataclasses import replace

import numpy as np
import pytest

from diagnosis.data.case import states
from diagnosis.data.noise import Lasting, Noise, blocks
from diagnosis.data.noise_components import PRESSURE, NoiseComponents, Repeated, Scatter, contrasts, reading_rms
from diagnosis.data.noise_estimate import Loss, estimate_noise, lowest
from diagnosis.inference.prepare import prepare
from diagnosis.inference.reading_noise import regulators
from diagnosis.judgement import COMPONENT_LOG_SD, DRIFT_SD, LASTING_LOGIT_SD, MEMORY_LOG_SD
from model.arrays import Array
from tests.diagnosis.small_campaigns import FEW, measured, moved_by
from tests.diagnosis.test_case import ROBOT, case, sweep

DEFAULT_NOISE = NoiseComponents({"tip": 0.3e-3}, 500.0, {"spine_length": 1e-3}, 1.0, 0)


def repeated(seed: int, sd: float, pressure_sd: float, trial_sd: float, repeats: int = 3, error: float = 0.0) -> Repeated:
    rng = np.random.default_rng(seed)
    conditions = 60
    condition = np.repeat(np.arange(conditions), repeats)
    trial = np.tile(np.arange(repeats), conditions) + repeats * (condition // 10)
    n = condition.size
    per_pascal = np.column_stack([np.linspace(0, 2e-6, n), np.zeros(n), np.linspace(0, 1e-6, n)])
    per_trial = np.column_stack([np.full(n, 0.5), np.zeros(n), np.full(n, -0.2)]) * (condition[:, None] % 10) / 10
    own = trial_sd * rng.normal(size=trial.max() + 1)
    residual = sd * rng.normal(size=(n, 3)) + per_pascal * pressure_sd * rng.normal(size=(n, 1))
    residual += per_trial * own[trial][:, None]
    residual += error * np.sin(condition)[:, None]
    scatter = {"spine_length": Scatter(per_trial[:, :, None], trial)}
    nothing = (np.zeros(n, bool), np.zeros((n, 3, 0)), np.full(n, -1), np.zeros(n))
    return Repeated(residual, condition, ("tip",) * 3, per_pascal[:, :, None], scatter, *nothing)


@pytest.mark.parametrize("error", [0.0, 0.05])
def test_components_are_found_whatever_the_model_gets_wrong(error: float) -> None:
    found = estimate_noise(repeated(1, 0.2e-3, 800.0, 2e-3, error=error), DEFAULT_NOISE)
    assert found.channel["tip"] == pytest.approx(0.2e-3, rel=0.15)
    assert found.pressure == pytest.approx(800, rel=0.2)
    assert found.trial["spine_length"] == pytest.approx(2e-3, rel=0.4)
    assert found.contrasts == 120
    assert found.excess_scatter == pytest.approx(2.0, rel=0.4)


def test_a_robot_whose_trials_have_nothing_of_their_own_has_a_floor_too() -> None:
    found = estimate_noise(replace(repeated(1, 0.2e-3, 1500.0, 0.0), scatter={}), replace(DEFAULT_NOISE, trial={}))
    assert found.trial == {}
    assert found.excess_scatter == pytest.approx(3.0, rel=0.2)


def test_without_repeats_the_usual_values_are_returned_and_said_to_be_no_measurement() -> None:
    data = repeated(1, 0.2e-3, 800.0, 2e-3, repeats=1)
    assert estimate_noise(data, DEFAULT_NOISE) == DEFAULT_NOISE
    assert math.isnan(reading_rms(data, np.ones(3, bool)))


def test_the_rms_of_a_reading_is_its_spread_about_the_mean_of_its_condition() -> None:
    assert reading_rms(repeated(2, 0.3e-3, 0.0, 0.0), np.ones(3, bool)) == pytest.approx(math.sqrt(3) * 0.3e-3, rel=0.1)


def test_what_drifts_over_the_campaign_is_no_noise() -> None:
    data = repeated(3, 0.3e-3, 0.0, 0.0)
    passed = np.tile(np.arange(3) / 2 - 0.5, 60)
    drift = 5e-3 * passed[:, None] * np.array([1.0, 0.0, -0.3])
    moved = replace(data, residual=data.residual + drift)
    known = replace(moved, drift=drift[:, :, None] / 0.02)
    calm, every = reading_rms(data, np.ones(3, bool)), np.ones(3, bool)
    assert reading_rms(moved, every) > 3 * calm and reading_rms(known, every) == pytest.approx(calm, rel=0.05)
    assert estimate_noise(moved, DEFAULT_NOISE).channel["tip"] > 0.7e-3
    assert estimate_noise(known, DEFAULT_NOISE).channel["tip"] == pytest.approx(0.3e-3, rel=0.15)


def test_errors_of_the_pressure_reading_are_no_scatter_of_the_tip() -> None:
    campaign, rng = measured(3, 8, FEW), np.random.default_rng(2)
    rows = [replace(r, pressures=tuple(p + 3e3 * rng.normal() if p > 20e3 else p for p in r.pressures)) for r in campaign.table]
    calm, noisy = (prepare(c.robot, states(c)[0]) for c in (campaign, case(rows)))
    assert noisy.noise_floor == pytest.approx(calm.noise_floor, rel=0.15)
    assert noisy.unit > 1.5 * calm.unit


def test_repeats_at_unequal_pressures_scatter_no_more_under_a_model_whose_gain_is_wrong() -> None:
    rng = np.random.default_rng(2)
    rows = [replace(r, pressures=tuple(p + 1e3 * rng.normal() if p else p for p in r.pressures)) for r in sweep(3, FEW)]
    right, wrong = (prepare(ROBOT, states(moved_by(rows, 8, robot))[0]) for robot in (ROBOT, ROBOT.with_modulus(0.5)))
    assert wrong.noise_components.pressure < 1.3 * right.noise_components.pressure


def wandering(memory: float, tip: float, pressure: float, seed: int = 2) -> Repeated:
    """A sweep of 21 trials of eleven readings ten seconds apart; shares of the variance that are forgotten over a memory, s."""
    rng = np.random.default_rng(seed)
    trial, step = np.repeat(np.arange(21), 11), np.tile(np.arange(11), 21)
    time, n = 300.0 * trial + 10.0 * step, len(trial)
    keep = np.exp(-np.diff(time, prepend=-np.inf) / memory)
    slow = rng.normal(size=(n, 4))
    for i in range(1, n):
        slow[i] = keep[i] * slow[i - 1] + math.sqrt(1 - keep[i] ** 2) * slow[i]
    white, condition = rng.normal(size=(n, 4)), step + 11 * (trial % 7)
    error = np.sqrt([tip] * 3 + [pressure]) * slow + np.sqrt(1 - np.array([tip] * 3 + [pressure])) * white
    per_pascal = np.abs(np.sin(condition / 7.0))[:, None] * np.array([3e-6, 5e-7, 1e-6])
    residual = 0.25e-3 * error[:, :3] + 800.0 * per_pascal * error[:, 3:]
    return Repeated(
        residual, condition, ("tip",) * 3, per_pascal[:, :, None], {}, np.zeros(n, bool), np.zeros((n, 3, 0)),
        blocks(trial, time, 40), time,
    )  # fmt: skip


BARE = replace(DEFAULT_NOISE, trial={})


def test_errors_that_last_are_told_from_those_that_do_not() -> None:
    lasting, passing = (estimate_noise(wandering(60.0, *share), BARE) for share in ((0.6, 0.95), (0.0, 0.0)))
    for found in (lasting, passing):
        assert found.channel["tip"] == pytest.approx(0.25e-3, rel=0.1)
        assert found.pressure == pytest.approx(800.0, rel=0.25)
    assert 25.0 < lasting.memory < 130.0
    assert lasting.lasting["tip"] == pytest.approx(0.6, abs=0.2) and lasting.lasting["pressure"] > 0.75
    # What is left of an error at the next reading.
    assert all(share * math.exp(-10.0 / passing.memory) < 0.1 for share in passing.lasting.values())


def test_without_times_nothing_lasts() -> None:
    data = wandering(60.0, 0.6, 0.95)
    assert estimate_noise(replace(data, block=np.full(len(data.time), -1)), BARE).lasting == {}


def lasting_and_drifting() -> Repeated:
    """All that contrasts can differ by."""
    data = repeated(1, 0.2e-3, 800.0, 2e-3)
    data = replace(data, block=data.scatter["spine_length"].part, time=10.0 * np.arange(len(data.condition)))
    drift = 1e-6 * np.ones((len(data.condition), 3, 1)) * data.time[:, None, None]
    return replace(data, resting=data.condition % 3 == 0, drift=drift)


def covariance(data: Repeated, found: NoiseComponents) -> Array:
    """(k c, k c) of all contrasts, written down as a person would."""
    contrast, c = contrasts(data.condition), data.residual.shape[1]
    together = (data.block[:, None] == data.block[None, :]) & (data.block[:, None] >= 0)
    lasts = np.where(together, np.exp(-np.abs(data.time[:, None] - data.time[None, :]) / found.memory), 0.0)
    np.fill_diagonal(lasts, 1.0)
    quiet = np.diag((contrast**2) @ np.where(data.resting, found.rest**2, 1.0))
    lasts = contrast @ lasts @ contrast.T
    response = np.einsum("kn,ncr->ckr", contrast**2, data.pressure_response)
    k, share = len(contrast), found.lasting[PRESSURE]
    of_pressure = found.pressure**2 * ((1 - share) * np.eye(k) + share * lasts)
    out = np.einsum("ikr,kl,jlr->kilj", response, of_pressure, response)
    for i, kind in enumerate(data.group):
        own = found.lasting[kind]
        out[:, i, :, i] += found.channel[kind] ** 2 * (own * lasts + (1 - own) * quiet)
    wide = [DRIFT_SD * np.einsum("kn,ncd->kcd", contrast, data.drift).reshape(k * c, -1)]
    for name, scatter in data.scatter.items():
        own = (scatter.part[:, None] == np.unique(scatter.part)).astype(float)
        wide.append(found.trial[name] * np.einsum("kn,nca,nt->kcta", contrast, scatter.response, own).reshape(k * c, -1))
    columns = np.hstack(wide)
    return np.asarray(out.reshape(k * c, k * c) + columns @ columns.T)


def test_the_loss_is_that_of_the_covariance_of_all_contrasts() -> None:
    data = lasting_and_drifting()
    loss = Loss(data, contrasts(data.condition), DEFAULT_NOISE)
    value = (contrasts(data.condition) @ data.residual).ravel()
    x = 0.1 * np.array([1.0, -2, 3, 1, -1, 2, 1])
    here, dense = loss(x), covariance(data, loss.components(x))
    prior = np.array([*[COMPONENT_LOG_SD] * 4, *[LASTING_LOGIT_SD] * 2, MEMORY_LOG_SD])
    solved = np.linalg.solve(dense, value)
    said = 0.5 * float(np.linalg.slogdet(dense)[1] + value @ solved + (x / prior) @ (x / prior))
    assert here.value == pytest.approx(said, abs=1e-8 * abs(said))
    steps = 1e-5 * np.eye(len(x))
    by = [(covariance(data, loss.components(x + h)) - covariance(data, loss.components(x - h))) / 2e-5 for h in steps]
    slope = [0.5 * float(np.trace(np.linalg.solve(dense, d)) - solved @ d @ solved) for d in by] + x / prior**2
    assert here.slope == pytest.approx(slope, rel=1e-5, abs=1e-4)
    moved = np.column_stack([d @ solved for d in by])
    information = 0.5 * moved.T @ np.linalg.solve(dense, moved) + np.diag(prior**-2.0)
    assert here.curve == pytest.approx(information, rel=1e-4, abs=1e-4)


def test_the_estimate_is_where_no_step_leads_down() -> None:
    data = lasting_and_drifting()
    loss = Loss(data, contrasts(data.condition), DEFAULT_NOISE)
    x = lowest(loss)
    here, held = loss(x), np.isclose(x, loss.low) | np.isclose(x, loss.high)
    assert (loss.low <= x).all() and (x <= loss.high).all()
    assert np.abs(here.slope[~held]).max() < 1e-3
    assert (here.slope[np.isclose(x, loss.low)] >= 0).all() and (here.slope[np.isclose(x, loss.high)] <= 0).all()
    rng = np.random.default_rng(0)
    around = np.clip(x + 0.1 * rng.normal(size=(20, len(x))), loss.low, loss.high)
    assert min(loss(other).value for other in around) > here.value


def test_a_long_trial_is_cut() -> None:
    trial, time = np.repeat([4, 7], 5), np.array([5.0, 4, 3, 2, 1, 0, 1, 2, np.nan, 4])
    assert blocks(trial, time, 3).tolist() == [1, 1, 0, 0, 0, 2, 2, 2, -1, 3]


TRIAL, STATE = np.repeat([0, 0, 1, 1, 1, -1], 3), np.repeat(np.arange(6), 3)
TIME, CHANNEL = np.repeat([0.0, 20, 0, 10, 40, np.nan], 3), np.tile([0, 1, 2], 6)
OWN, SLOW = np.linspace(1, 2, 18), np.where(TRIAL < 0, 0.0, np.tile([1.5, 0.5, 0.0], 6))
RESPONSE = np.column_stack([np.sin(np.arange(18)), np.cos(np.arange(18))])
EVERY = np.ones(18)
NOISE = Noise(STATE, OWN, RESPONSE, Lasting(TRIAL, TIME, CHANNEL, SLOW, 0.7 * EVERY, 30.0 * EVERY))


def test_whitening_takes_the_covariance_away_and_its_determinant_is_known() -> None:
    white, dense = NOISE.whiten(np.eye(18)), np.zeros((18, 18))
    for i in range(18):
        for j in range(18):
            same = STATE[i] == STATE[j]
            kept = 1.0 if same else np.exp(-abs(TIME[i] - TIME[j]) / 30.0) if TRIAL[i] == TRIAL[j] >= 0 else 0.0
            dense[i, j] = OWN[i] ** 2 * (i == j) + SLOW[i] * SLOW[j] * kept * (CHANNEL[i] == CHANNEL[j])
            dense[i, j] += RESPONSE[i] @ RESPONSE[j] * (0.3 * same + 0.7 * kept)
    assert white @ dense @ white.T == pytest.approx(np.eye(18), abs=1e-9)
    assert NOISE.log_sd == pytest.approx(0.5 * np.linalg.slogdet(dense)[1])
    values = np.linspace(-1, 1, 18)
    assert NOISE.colour(NOISE.whiten(values)) == pytest.approx(values)
    assert NOISE.whiten(values) == pytest.approx(white @ values)


def test_readings_of_other_trials_have_other_errors() -> None:
    part = TRIAL == 1
    values = np.linspace(0, 1, 18)
    assert NOISE.take(part).whiten(values[part]) == pytest.approx(NOISE.whiten(values)[part])


def test_two_campaigns_have_errors_of_their_own() -> None:
    both = NOISE.lasting.then(NOISE.lasting)
    assert both.block.tolist() == [*TRIAL, *np.where(TRIAL < 0, -1, TRIAL + 2)]
    beside = Noise(np.concatenate([STATE, STATE + 6]), np.tile(OWN, 2), np.tile(RESPONSE, (2, 1)), both)
    values = np.linspace(-1, 1, 18)
    assert beside.whiten(np.tile(values, 2)) == pytest.approx(np.tile(NOISE.whiten(values), 2))
    white = Noise(STATE, OWN, RESPONSE, Lasting.none(18)).whiten(np.eye(18))
    of_states = np.diag(OWN**2) + (STATE[:, None] == STATE) * (RESPONSE @ RESPONSE.T)
    assert white @ of_states @ white.T == pytest.approx(np.eye(18))


ALL = tuple(range(9))


def test_chambers_that_always_read_the_same_have_one_regulator_and_those_that_read_apart_have_two() -> None:
    bend, other = [1, 1, 0, 0, 0, 0, 0, 0, 1], [0, 0, 1, 1, 1, 0, 0, 0, 0]
    pressure = 1e5 * np.array([[0] * 9, bend, other, [1] * 9], float)
    assert sorted(tuple(own) for own in regulators(pressure, pressure)) == [(0, 1, 8), (2, 3, 4), (5, 6, 7)]
    assert [tuple(own) for own in regulators(pressure[:2], pressure[:2])] == [(0, 1, 8)]
    assert [tuple(own) for own in regulators(np.zeros((2, 9)), np.zeros((2, 9)))] == [ALL]
    together = pressure[[0, 1, 3]]
    read = together + np.array([0, 0, 400, 400, 400, -700, -700, -700, 0])
    assert sorted(tuple(own) for own in regulators(read, together)) == [(0, 1, 8), (2, 3, 4), (5, 6, 7)]


def test_with_all_chambers_inflated_each_regulator_moves_the_tip_its_own_way() -> None:
    main = sweep()
    both = [
        replace(r, trial=r.trial + 20, protocol="elongation", pressures=(max(r.pressures),) * 9, tip=(0.0, 0.0, 0.43))
        for r in sweep(2, unload=False)
    ]
    p = prepare(ROBOT, states(case(main + both))[0])
    shared, labels, kind = p.problem.noise.pressure_response, p.labels, p.states.kind[p.labels.state]
    assert shared.shape[1] == 2
    bending = kind == 0
    assert (np.count_nonzero(shared[bending], axis=1) <= 1).all()
    full = (kind == 1) & (p.states.highest[labels.state] > 150e3) & (labels.channel == "x")
    # The three chambers of the sweep pull one way, the six others just as much the other way.
    assert (np.sign(shared[full, 0]) == -np.sign(shared[full, 1])).all()
    assert np.abs(shared[full].sum(axis=1)).max() < 0.2 * np.abs(shared[full]).min()
