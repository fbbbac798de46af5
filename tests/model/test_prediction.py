"""States as arrays: the numbers of the forward model, gradients, intervals, the way back, and the learnt residual."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from diagnosis.errors import BadCase
from diagnosis.fit_residual import alike, learn_residual
from model.arrays import Array
from model.effects import CATALOGUE, ForwardModel, Parameter, design_from_columns
from model.errors import BadCondition, BadRobot
from model.prediction import Predictor
from model.prediction.box_minima import box_minima
from model.prediction.campaign import predict_campaign
from model.prediction.inverse import inverse, limits_of
from model.prediction.residual import LearntResidual
from model.robot import Robot, robot_from_dict
from model.stated import Residual
from tests.model.test_stated_effects import POSTERIOR
from tests.simulated.bench import raises

GROUPS = ((9, 1, 2), (3, 4, 5), (6, 7, 8))
AZIMUTH = {"chamber_azimuth": {"angle": {"value": 0.1, "sd": 0.01, "unit": "rad"}}}
PLAIN = {
    **AZIMUTH,
    "marker_offset": {"x": {"value": 0.004, "sd": 0.001, "unit": "m"}},
    "tether_load": {"spring": {"value": 2.0, "sd": 0.3, "unit": "N/m"}},
}
MEMORY = {
    **PLAIN,
    "spine_slip": {"moment": {"value": 0.12, "sd": 0.01, "unit": "N m"}},
    "viscoelastic": {"slow": {"value": 0.04, "sd": 0.01, "unit": "1"}},
}
NOISE = {"floor": 6e-4, "reading": 2e-4, "pressure": 300.0, "spine_length": 1e-3, "spine_stiffness": 0.02}


def robot_with(paper_robot: Robot, effects: dict[str, Any], **more: Any) -> Robot:
    tilt = {"tilt": {"x": {"value": 1e-3, "sd": 1e-3, "unit": "rad"}}}
    posterior = POSTERIOR | {"law_error": 0.05, "discrepancy": 1e-4, "noise": NOISE}
    stated = {"effects": effects, "tolerances": tilt, "posterior": posterior, "markers": [0.2], **more}
    return robot_from_dict({**paper_robot.model_dump(), "area_factor": 1.6, **stated})


def asked(n: int, seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    pressures = np.zeros((n, 9))
    for row in pressures:
        for g in rng.choice(3, 2, replace=False):
            row[[c - 1 for c in GROUPS[g]]] = rng.uniform(20e3, 200e3)
    return pressures, rng.uniform(0.01, 0.29, n)


def columns(pressures: Array, lengths: Array) -> dict[str, NDArray[Any]]:
    n = len(lengths)
    return {"trial": np.arange(n), "spine_length": lengths, **{f"p{c + 1}": pressures[:, c] for c in range(9)}}


@pytest.fixture(scope="module")
def learnt() -> tuple[Residual, float]:
    """What the states of `learnt_states` teach, and what it misses of those left out."""
    return learn_residual(*learnt_states())


@pytest.mark.parametrize("markers", [(), (0.2,)])
def test_a_robot_without_any_uncertainty_has_an_interval_of_no_width(paper_robot: Robot, markers: tuple[float, ...]) -> None:
    robot = paper_robot.model_copy(update={"markers": markers})
    found = predict_campaign(robot, columns(*asked(4)), intervals=True)
    assert found.sd is not None and not found.sd.any() and found.shape.shape == (4, len(markers), 3)
    np.testing.assert_array_equal(found.tip, predict_campaign(robot, columns(*asked(4))).tip)


@pytest.mark.parametrize("effects", [PLAIN, MEMORY], ids=["plain", "with memory"])
def test_states_are_those_of_the_forward_model(paper_robot: Robot, effects: dict[str, Any]) -> None:
    robot = robot_with(paper_robot, effects)
    p, lengths = asked(6)
    found = Predictor(robot, cores=1)(p, lengths, intervals=True)
    read = {name: np.zeros(6) for name in "xyz"}
    forward = ForwardModel(robot, design_from_columns(robot, {**columns(p, lengths), **read}), "per_length")
    np.testing.assert_allclose(found.tip, forward.predict(np.zeros(len(forward.parameters))).reshape(6, 3), atol=1e-9)
    # The forward model's own derivatives give the same intervals.
    other = predict_campaign(robot, columns(p, lengths), intervals=True)
    for name in ("tip", "orientation", "shape"):
        np.testing.assert_allclose(getattr(found, name), getattr(other, name), atol=1e-9, err_msg=name)
    for name in ("model_sd", "sd", "orientation_sd", "shape_sd"):
        np.testing.assert_allclose(getattr(found, name), getattr(other, name), rtol=0.03, err_msg=name)
    low, high = found.interval()
    assert (low < found.tip).all() and (found.tip < high).all() and found.shape.shape == (6, 1, 3)


@pytest.mark.parametrize("effects", [PLAIN, MEMORY], ids=["plain", "with memory"])
def test_gradients_are_those_of_differences(paper_robot: Robot, effects: dict[str, Any]) -> None:
    at = Predictor(robot_with(paper_robot, effects), cores=1)
    p, lengths = asked(3)
    found = at(p, lengths, gradient=True)
    assert found.tip_by_pressure is not None and found.tip_by_length is not None
    for c in (0, 4):
        step = 500.0 * np.eye(9)[c]
        differences = (at(p + step, lengths).tip - at(p - np.minimum(step, p), lengths).tip) / (step + np.minimum(step, p))[
            :, c, None
        ]
        np.testing.assert_allclose(found.tip_by_pressure[:, :, c], differences, atol=2e-8)
    along = (at(p, lengths + 1e-4).tip - at(p, lengths - 1e-4).tip) / 2e-4
    np.testing.assert_allclose(found.tip_by_length, along, rtol=0.01, atol=1e-3)


def test_many_states_on_several_cores_come_back_in_their_order(paper_robot: Robot) -> None:
    at = Predictor(robot_with(paper_robot, AZIMUTH), cores=2)
    p, lengths = asked(9000)
    few = np.array([0, 17, 8999])
    np.testing.assert_allclose(at(p, lengths).tip[few], at(p[few], lengths[few]).tip, atol=1e-5)


def test_what_cannot_be_predicted_is_refused(paper_robot: Robot) -> None:
    at = Predictor(robot_with(paper_robot, AZIMUTH))
    raises(BadCondition, r"arcs: 0\.5 m must lie between 0 and the robot's length 0\.4 m", at, [0.0] * 9, arcs=[0.5])
    raises(BadCondition, "9 chambers", at, [0.0] * 8)
    raises(BadCondition, "intervals=True", at([0.0] * 9).interval)
    with pytest.raises(BadRobot, match="obstacle_azimuth_deg"):
        Predictor(robot_with(paper_robot, {**AZIMUTH, "contact": {"stiffness": {"value": 300.0, "unit": "N/m"}}}))


def test_targets_that_were_reached_are_reached_with_no_more_pressure(paper_robot: Robot) -> None:
    robot = robot_with(paper_robot, AZIMUTH)
    at = Predictor(robot, cores=1)
    p, lengths = asked(8, seed=3)
    found = inverse(at, at(p, lengths).tip, limits_of(robot, GROUPS))
    assert found.reached.all() and (found.pressures.sum(axis=1) <= p.sum(axis=1) * (1 + 1e-4)).all()
    assert (found.pressures >= 0).all() and (found.pressures <= robot.max_pressure).all()
    for group in GROUPS:
        own = found.pressures[:, [c - 1 for c in group]]
        np.testing.assert_array_equal(own, own[:, :1] + 0 * own)
    assert found.prediction.model_sd is not None and (found.prediction.model_sd > 0).all()


def test_each_chamber_keeps_its_own_limit(paper_robot: Robot) -> None:
    most = np.array([50e3, 250e3, 250e3] * 3)
    own = paper_robot.replace(max_pressure=most.tolist())
    found = inverse(Predictor(own, cores=1), [[-0.1, 0.0, np.nan]], limits_of(own))
    assert (found.pressures <= most).all() and (found.pressures[0] > 50e3).any()
    shared = inverse(Predictor(own, cores=1), [[-0.1, 0.0, np.nan]], limits_of(own, GROUPS))
    assert shared.pressures.max() == pytest.approx(50e3)
    with pytest.warns(UserWarning, match="outside 0 to 50 or 250 kPa, .*: 60 kPa of chamber 1 in row 1"):
        assert Predictor(own)([[60e3] * 9, [0.0] + [60e3] * 2 + [0.0] * 6]).outside.tolist() == [True, False]


def test_targets_out_of_reach_are_told_with_the_nearest_point(paper_robot: Robot) -> None:
    robot = robot_with(paper_robot, AZIMUTH)
    nan = float("nan")
    found = inverse(Predictor(robot), [[1.0, 0.0, 0.2], [-0.03, nan, nan]], limits_of(robot, spine=(0.1, 0.1)))
    assert found.reached.tolist() == [False, True] and found.miss[0] > 0.5 and (found.spine_length == 0.1).all()
    # Nothing near does better.
    rng = np.random.default_rng(1)
    other = np.clip(found.pressures[0] + rng.normal(0, 20e3, (200, 9)), 0, robot.max_pressure)
    away = np.linalg.norm(Predictor(robot)(other, 0.1).tip - [1.0, 0.0, 0.2], axis=1)
    assert away.min() > found.miss[0] - 1e-4
    with pytest.raises(BadCondition, match="weights: must be numbers"):
        inverse(Predictor(robot), [[1.0, 0.0, 0.2]], limits_of(robot), weights=[[nan, 1.0, 1.0]])
    with pytest.raises(BadCondition, match="a target is 30 m from the base of a robot of 0.4 m, which looks like mm"):
        inverse(Predictor(robot), [[20.0, 30.0, nan]], limits_of(robot))


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"groups": [(1, 2), (2, 3)]}, "groups"),
        ({"groups": [(10,)]}, "counted from 1 to 9"),
        ({"spine": (0.1, 0.5)}, "must lie between 0 and 0.4 m"),
    ],
)
def test_limits_that_the_robot_does_not_have_are_refused(paper_robot: Robot, more: dict[str, Any], told: str) -> None:
    raises(BadCondition, told, limits_of, paper_robot, **more)


def test_every_effect_of_the_catalogue_can_be_predicted_with(paper_robot: Robot) -> None:
    def small(p: Parameter) -> dict[str, Any]:
        return {"value": float(np.clip(0.3 * p.scale, p.low, p.high)), "sd": 0.1 * p.scale, "unit": p.unit}

    effects = {id: {p.name: small(p) for p in spec.parameters} for id, spec in CATALOGUE.items()}
    robot = robot_with(paper_robot, effects, obstacle_azimuth_deg=180.0)
    found = Predictor(robot, cores=1)([[60e3] * 3 + [0.0] * 6], 0.1, intervals=True)
    assert found.converged.all() and found.sd is not None and np.isfinite(found.sd).all()


def test_states_beyond_the_robot_s_limits_are_marked(paper_robot: Robot) -> None:
    at = Predictor(paper_robot)
    assert paper_robot.max_pressure is not None
    rows = [[60e3] + [0.0] * 8, [paper_robot.max_pressure + 50e3] + [0.0] * 8, [-5e3] + [0.0] * 8, [-200.0] + [0.0] * 8]
    with pytest.warns(UserWarning, match="2 of 4 states have pressures outside 0 to"):
        found = at(rows)
    assert found.outside is not None and found.outside.tolist() == [False, True, True, False]
    ends = {"fitted_pressure": [0.0, 60e3], "fitted_spine_length": [0.0, 0.1], "fitted_tip_mass": [0.02, 0.02]}
    fitted = Predictor(robot_with(paper_robot, AZIMUTH, posterior=POSTERIOR | ends))
    with pytest.warns(UserWarning, match="to which robot.yaml was fitted") as told:
        found = fitted(np.diag([60.5e3, 65e3, 10e3, 10e3]) @ np.eye(4, 9), [0.0, 0.1, 0.2, 0.0], [0.02, 0.02, 0.02, 0.03])
    assert found.outside is not None and found.outside.tolist() == [False, True, True, True]
    outside = ("pressures outside 0 to 60 kPa", "spine lengths outside 0 to 10 cm", "tip masses outside 0.02 kg")
    assert all(f"1 of 4 states have {of}, to which" in str(w.message) for of, w in zip(outside, told, strict=True))


def minimum(curve: Array, score: Array, low: Array, high: Array) -> Array:
    return box_minima(curve[None], -score[None], low[None], high[None])[0]


def problem(seed: int, n: int, alike: float) -> tuple[Array, Array, Array, Array]:
    """Curvature with columns of very different size, more or less alike, and bounds of which many are zero or hold."""
    rng = np.random.default_rng(seed)
    columns = (rng.normal(size=(n + 20, n)) + alike * rng.normal(size=(n + 20, 1))) * 10 ** rng.uniform(-1, 2, n)
    curve = np.eye(n) + columns.T @ columns
    score = columns.T @ rng.normal(size=n + 20) * 30
    low = np.where(rng.random(n) < 0.4, 0.0, -rng.uniform(0.5, 3, n))
    return curve, score, low, rng.uniform(0.5, 3, n)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("alike", [0.0, 10.0])
def test_it_is_the_minimum_within_the_bounds(seed: int, alike: float) -> None:
    curve, score, low, high = problem(seed, 60, alike)
    root = np.linalg.cholesky(curve)
    known = lsq_linear(root.T, np.linalg.solve(root, score), (low, high), method="bvls", tol=1e-14).x
    assert ((known == low) | (known == high)).sum() > 10
    np.testing.assert_allclose(minimum(curve, score, low, high), known, atol=1e-7)


def test_what_is_held_too_early_comes_back() -> None:
    # Alone the second would run out of its bound; it comes back when the first is held.
    curve, score = np.array([[1.0, 0.9], [0.9, 1.0]]), np.array([4.0, 3.2])
    np.testing.assert_allclose(minimum(curve, score, np.array([-1.0, -0.1]), np.array([1.0, 9.0])), [1.0, 2.3])


def learnt_states(n: int = 60, per_trial: float = 3e-4, reading: float = 1e-4) -> tuple[Any, ...]:
    """Trials of six states, and a smooth miss of 2 mm with what trials and readings add."""
    rng = np.random.default_rng(5)
    pressure, length = asked(n, seed=5)
    trial = np.repeat(np.arange(n // 6), 6)
    missed = smooth(pressure, length) + per_trial * rng.normal(size=(n // 6, 3))[trial]
    return trial, pressure, length, missed + reading * rng.normal(size=(n, 3))


def smooth(pressure: Array, length: Array) -> Array:
    first, second, third = pressure[:, [0, 3, 6]].T / 2e5
    return 2e-3 * np.column_stack([np.sin(2 * first) * (1 + length), second**2, np.cos(3 * length) * third])


def test_mean_and_variance_are_those_of_scikit_learn() -> None:
    kernels = pytest.importorskip("sklearn.gaussian_process.kernels")
    from sklearn.gaussian_process import GaussianProcessRegressor

    trial, pressure, length, missed = learnt_states()
    table = np.column_stack([trial, pressure, length, missed])
    own = Residual(amplitude=2e-3, pressure_scale=5e5, length_scale=0.2, trial=0.0, reading=3e-4, learnt=table.tolist())
    kernel = 2e-3**2 * kernels.RBF([5e5] * 9 + [0.2])
    peer = GaussianProcessRegressor(kernel, alpha=3e-4**2, optimizer=None).fit(table[:, 1:-3], missed)
    there, at = asked(20, seed=9)
    mean, sd = peer.predict(np.column_stack([there, at]), return_std=True)
    ours = LearntResidual(own)(there, at, intervals=True)
    assert ours.variance is not None
    assert np.abs(ours.mean - mean).max() < 1e-9
    assert np.abs(np.sqrt(ours.variance) - np.asarray(sd).reshape(20, -1)[:, :1]).max() < 1e-9


def test_scales_are_found_and_left_out_trials_are_predicted_as_by_learning_anew(learnt: tuple[Residual, float]) -> None:
    (trial, pressure, length, missed), (found, left_out) = learnt_states(), learnt
    assert 0.5 < found.trial / 3e-4 < 2 and 0.5 < found.reading / 1e-4 < 2
    there, at = asked(40, seed=11)
    off = LearntResidual(found)(there, at).mean - smooth(there, at)
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.3 * np.sqrt((missed**2).sum(axis=1).mean())
    left = []
    for out in np.unique(trial):
        anew = LearntResidual(found.model_copy(update={"learnt": tuple(s for s in found.learnt if s[0] != out)}))
        own = trial == out
        left.append(missed[own] - anew(pressure[own], length[own]).mean)
    expected = np.sqrt((np.concatenate(left) ** 2).sum(axis=1).mean())
    assert left_out == pytest.approx(expected, rel=1e-4)


def test_predictions_have_the_residual_its_slopes_and_its_interval(paper_robot: Robot, learnt: tuple[Residual, float]) -> None:
    plain, (own, _) = robot_with(paper_robot, AZIMUTH), learnt
    robot = plain.model_copy(update={"residual": own})
    pressure, length = asked(12, seed=2)
    with_it, without = (Predictor(r)(pressure, length, intervals=True, gradient=True) for r in (robot, plain))
    learnt = LearntResidual(own)(pressure, length, intervals=True)
    assert np.abs(with_it.tip - without.tip - learnt.mean).max() < 1e-12
    opened = with_it.model_sd**2 - without.model_sd**2
    assert np.allclose(opened, learnt.variance - 1e-4**2, atol=1e-12)  # in place of the discrepancy
    assert with_it.tip_by_pressure is not None and with_it.tip_by_length is not None
    up, further = pressure.copy(), length + 1e-5
    up[:, 3] += 10.0
    at = Predictor(robot)
    assert np.allclose((at(up, length).tip - with_it.tip) / 10.0, with_it.tip_by_pressure[:, :, 3], atol=3e-10)
    assert np.allclose((at(pressure, further).tip - with_it.tip) / 1e-5, with_it.tip_by_length, atol=2e-4)
    table = predict_campaign(robot, columns(pressure, length), intervals=True)
    bare = predict_campaign(plain, columns(pressure, length), intervals=True)
    assert np.abs(table.tip - bare.tip - learnt.mean).max() < 1e-12


def test_repeats_of_settings_teach_nothing_of_other_settings_and_chambers_miss_each_for_itself() -> None:
    opposite = np.tile(np.eye(3)[:2], 3)  # neither bends a robot of nine chambers
    sweeps = np.vstack([np.eye(9)[:4], opposite])[:, None] * np.array([0.0, 50e3, 100e3, 150e3])[:, None]
    pressure = np.tile(sweeps.reshape(-1, 9), (2, 1))
    trial, length = np.repeat(np.arange(12), 4), np.zeros(48)
    np.testing.assert_array_equal(alike(trial, pressure, length), trial % 6)
    np.testing.assert_array_equal(alike(trial % 2, pressure[:4].repeat(12, axis=0), length)[::12], np.arange(4))
    missed = 1e-4 * np.random.default_rng(1).normal(size=(48, 3))
    missed[:, 0] += 4e-3 * (pressure / 150e3) @ (opposite[0] - opposite[1])
    found, left_out = learn_residual(trial, pressure, length, missed)
    assert left_out > 1e-3
    np.testing.assert_allclose(LearntResidual(found)(120e3 * opposite, np.zeros(2)).mean[:, 0], [9.6e-3, -9.6e-3], atol=5e-4)


def test_far_from_all_states_nothing_is_added_and_the_interval_says_so(learnt: tuple[Residual, float]) -> None:
    own = learnt[0].model_copy(update={"pressure_scale": 1e4})
    far = LearntResidual(own)(np.full((1, 9), 190e3), np.array([0.1]), intervals=True)
    assert np.abs(far.mean).max() < 1e-9 and far.variance is not None
    assert far.variance[0, 0] == pytest.approx(own.amplitude**2)


def test_too_few_states_and_a_wrong_table_are_refused(paper_robot: Robot, learnt: tuple[Residual, float]) -> None:
    trial, pressure, length, missed = learnt_states()
    raises(BadCase, "5 states with a tip in 1 trial", learn_residual, trial[:5], pressure[:5], length[:5], missed[:5])
    with pytest.raises(BadRobot, match=r"residual.amplitude = -1.0 m"):
        robot_from_dict({**paper_robot.model_dump(), "residual": {**learnt[0].model_dump(), "amplitude": -1.0}})
