"""The diagnosis put to use, in small: one virtual robot, few targets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.use import MODELS, summary, use
from lab.blind.intervals import clopper_pearson
from lab.blind.sweeps import BASE_SETTLED
from lab.blind.truth import Recipe, draw_one

SMALL = replace(BASE_SETTLED, spine_lengths=(0.0, 0.15, 0.30), pressures=(100e3, 200e3), repeats=2)
OTHER = replace(SMALL, name="other", chambers=(3, 4, 5), repeats=1)


def test_a_robot_with_its_effect_lands_nearer_to_its_targets_than_a_calibrated_one() -> None:
    truth = draw_one(Recipe(1, 5, settled=True, only=("single",)), 0, "single", ("area_moment",), "direct")
    found = use(truth, 4, True, 1, (SMALL, OTHER))
    medians = {name: np.median(found.miss[name]) for name in MODELS}
    assert medians["diagnosed"] < 0.25 * medians["calibrated"] and medians["diagnosed"] < 0.5 * medians["by length"]
    assert np.mean(found.inside) > 0.7
    figures = summary([found])
    assert figures["targets"] == 4 and set(MODELS) <= set(figures)


def test_intervals_of_shares_are_exact() -> None:
    assert clopper_pearson(0, 10)[0] == 0.0 and clopper_pearson(10, 10)[1] == 1.0
    low, high = clopper_pearson(95, 100)
    assert 0.88 < low < 0.89 and 0.98 < high < 0.99
