"""Chambers of one regulator err together, those of different ones do not."""

from dataclasses import replace

import numpy as np

from diagnosis.data.case import states
from diagnosis.inference.prepare import prepare
from diagnosis.inference.reading_noise import regulators
from tests.diagnosis.test_case import ROBOT, case, sweep

ALL = tuple(range(9))


def test_chambers_that_always_read_the_same_have_one_regulator() -> None:
    bend, other = [1, 1, 0, 0, 0, 0, 0, 0, 1], [0, 0, 1, 1, 1, 0, 0, 0, 0]
    pressure = 1e5 * np.array([[0] * 9, bend, other, [1] * 9], float)
    assert sorted(tuple(own) for own in regulators(pressure, pressure)) == [(0, 1, 8), (2, 3, 4), (5, 6, 7)]
    assert [tuple(own) for own in regulators(pressure[:2], pressure[:2])] == [(0, 1, 8)]
    assert [tuple(own) for own in regulators(np.zeros((2, 9)), np.zeros((2, 9)))] == [ALL]


def test_chambers_that_are_inflated_together_and_read_apart_have_two() -> None:
    pressure = 1e5 * np.array([[0] * 9, [1, 1, 0, 0, 0, 0, 0, 0, 1], [1] * 9], float)
    read = pressure + np.array([0, 0, 400, 400, 400, -700, -700, -700, 0])
    assert sorted(tuple(own) for own in regulators(read, pressure)) == [(0, 1, 8), (2, 3, 4), (5, 6, 7)]


def test_with_all_chambers_inflated_each_regulator_moves_the_tip_its_own_way() -> None:
    main = sweep()
    both = [
        replace(r, trial=r.trial + 20, protocol="elongation", pressures=(max(r.pressures),) * 9, tip=(0.0, 0.0, 0.43))
        for r in sweep(2, unload=False)
    ]
    p = prepare(ROBOT, states(case(main + both))[0])
    shared, labels = p.problem.noise.pressure_response, p.labels
    assert shared.shape[1] == 2
    bending = labels.experiment == 0
    assert (np.count_nonzero(shared[bending], axis=1) <= 1).all()
    full = (labels.experiment == 1) & (p.states.highest[labels.state] > 150e3) & (labels.channel == "x")
    # The three chambers of the sweep pull one way, the six others just as much the other way.
    assert (np.sign(shared[full, 0]) == -np.sign(shared[full, 1])).all()
    assert np.abs(shared[full].sum(axis=1)).max() < 0.2 * np.abs(shared[full]).min()
