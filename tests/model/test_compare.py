"""The error table."""

import numpy as np
import pytest

from model.compare import error_table
from model.condition import conditions
from model.errors import BadCondition
from model.robot import Robot


def test_errors_are_averaged_per_spine_length_and_axis(paper_robot: Robot) -> None:
    states = conditions(paper_robot, [0.0, 0.1, 0.0], np.zeros(9))
    model = np.zeros((3, 3))
    measured = np.array([[0.012, 0.0, -0.004], [0.003, 0.001, 0.0], [-0.004, 0.0, 0.002]])
    table = error_table(states, measured, model, 0.4)
    first, second = table.rows
    assert (first.spine_length, first.n, second.spine_length, second.n) == (0.0, 2, 0.1, 1)
    assert (first.mean_abs_x, first.mean_abs_z) == pytest.approx((0.008, 0.003))
    assert second.mean_abs_y == pytest.approx(0.001)
    assert first.worst == pytest.approx(np.hypot(0.012, 0.004))
    assert (table.worst_percent_x, table.worst_percent_z) == pytest.approx((2.0, 0.75))
    np.testing.assert_allclose(table.residual, measured)


@pytest.mark.parametrize(("measured", "word"), [(np.zeros((1, 3)), "measured"), (np.full((2, 3), np.nan), "not finite")])
def test_measurements_that_do_not_fit_are_refused(paper_robot: Robot, measured: np.ndarray, word: str) -> None:
    states = conditions(paper_robot, [0.0, 0.1], np.zeros(9))
    with pytest.raises(BadCondition, match=word):
        error_table(states, measured, np.zeros((2, 3)), 0.4)
