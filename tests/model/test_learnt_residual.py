"""The learnt residual: scikit-learn's Gaussian process, slopes, what it does to predictions, and what robot.yaml holds."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from diagnosis.errors import BadCase
from diagnosis.fit_residual import learn_residual
from model.errors import BadRobot
from model.prediction import Predictor
from model.prediction.campaign import predict_campaign
from model.prediction.residual import LearntResidual, section_sums
from model.robot import Robot, robot_from_dict
from model.stated import Residual
from tests.model.test_prediction import AZIMUTH, asked, columns, robot_with

Array = NDArray[np.float64]


def learnt_states(robot: Robot, n: int = 60, per_trial: float = 3e-4, reading: float = 1e-4) -> tuple[Any, ...]:
    """Trials of six states, and a smooth miss of 2 mm with what trials and readings add."""
    rng = np.random.default_rng(5)
    pressure, length = asked(n, seed=5)
    trial = np.repeat(np.arange(n // 6), 6)
    missed = smooth(robot, pressure, length) + per_trial * rng.normal(size=(n // 6, 3))[trial]
    return trial, pressure, length, missed + reading * rng.normal(size=(n, 3))


def smooth(robot: Robot, pressure: Array, length: Array) -> Array:
    u = section_sums(robot, pressure) / 6e5
    return 2e-3 * np.column_stack([np.sin(2 * u[:, 0]) * (1 + length), u[:, 1] ** 2, np.cos(3 * length) * u[:, 2]])


def test_mean_and_variance_are_those_of_scikit_learn(paper_robot: Robot) -> None:
    kernels = pytest.importorskip("sklearn.gaussian_process.kernels")
    from sklearn.gaussian_process import GaussianProcessRegressor

    trial, pressure, length, missed = learnt_states(paper_robot)
    u = section_sums(paper_robot, pressure)
    table = np.column_stack([trial, u, length, missed])
    own = Residual(amplitude=2e-3, pressure_scale=5e5, length_scale=0.2, trial=0.0, reading=3e-4, states=table.tolist())
    kernel = 2e-3**2 * kernels.RBF([5e5, 5e5, 5e5, 0.2])
    peer = GaussianProcessRegressor(kernel, alpha=3e-4**2, optimizer=None).fit(np.column_stack([u, length]), missed)
    there, at = asked(20, seed=9)
    mean, sd = peer.predict(np.column_stack([section_sums(paper_robot, there), at]), return_std=True)
    ours = LearntResidual(paper_robot, own)(there, at, intervals=True)
    assert ours.variance is not None
    assert np.abs(ours.mean - mean).max() < 1e-9
    assert np.abs(np.sqrt(ours.variance) - np.asarray(sd).reshape(20, -1)[:, :1]).max() < 1e-9


def test_scales_are_found_and_left_out_trials_are_predicted_as_by_learning_anew(paper_robot: Robot) -> None:
    trial, pressure, length, missed = learnt_states(paper_robot)
    found = learn_residual(paper_robot, trial, pressure, length, missed)
    assert 0.5 < found.residual.trial / 3e-4 < 2 and 0.5 < found.residual.reading / 1e-4 < 2
    there, at = asked(40, seed=11)
    off = LearntResidual(paper_robot, found.residual)(there, at).mean - smooth(paper_robot, there, at)
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.3 * np.sqrt((missed**2).sum(axis=1).mean())
    left = []
    for out in np.unique(trial):
        rest = tuple(s for s in found.residual.states if s[0] != out)
        anew = LearntResidual(paper_robot, found.residual.model_copy(update={"states": rest}))
        own = trial == out
        left.append(missed[own] - anew(pressure[own], length[own]).mean)
    expected = np.sqrt((np.concatenate(left) ** 2).sum(axis=1).mean())
    assert found.left_out == pytest.approx(expected, rel=1e-4)


def test_predictions_have_the_residual_its_slopes_and_its_interval(paper_robot: Robot) -> None:
    plain = robot_with(paper_robot, AZIMUTH)
    own = learn_residual(plain, *learnt_states(plain)).residual
    robot = plain.model_copy(update={"residual": own})
    pressure, length = asked(12, seed=2)
    with_it, without = (Predictor(r)(pressure, length, intervals=True, gradient=True) for r in (robot, plain))
    learnt = LearntResidual(robot, own)(pressure, length, intervals=True)
    assert learnt.variance is not None
    assert np.abs(with_it.tip - without.tip - learnt.mean).max() < 1e-12
    assert with_it.model_sd is not None and without.model_sd is not None
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


def test_far_from_all_states_nothing_is_added_and_the_interval_says_so(paper_robot: Robot) -> None:
    own = learn_residual(paper_robot, *learnt_states(paper_robot)).residual
    own = own.model_copy(update={"pressure_scale": 1e4})
    far = LearntResidual(paper_robot, own)(np.full((1, 9), 190e3), np.array([0.1]), intervals=True)
    assert np.abs(far.mean).max() < 1e-9 and far.variance is not None
    assert far.variance[0, 0] == pytest.approx(own.amplitude**2)


def test_too_few_states_and_a_wrong_table_are_refused(paper_robot: Robot) -> None:
    trial, pressure, length, missed = learnt_states(paper_robot)
    with pytest.raises(BadCase, match="5 states with a tip in 1 trial"):
        learn_residual(paper_robot, trial[:5], pressure[:5], length[:5], missed[:5])
    own = learn_residual(paper_robot, trial, pressure, length, missed).residual.model_dump()
    with pytest.raises(BadRobot, match=r"residual.amplitude = -1.0 m"):
        robot_from_dict({**paper_robot.model_dump(), "residual": {**own, "amplitude": -1.0}})
