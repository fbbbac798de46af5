"""What changed between two campaigns is found beside what both have in common."""

from __future__ import annotations

import numpy as np
import pytest

from diagnosis.compare_campaigns import compare_campaigns
from diagnosis.errors import TooLittle
from tests.diagnosis.small_campaigns import FEW, Catalogue, few_and_all, measured
from tests.diagnosis.test_case import ROBOT, Measured

BEFORE = {"chamber_ballooning__growth": 0.2}


@few_and_all
def test_the_effect_that_came_is_named_and_the_one_that_was_there_is_not(catalogue: Catalogue) -> None:
    turned = measured(3, 2, FEW, **BEFORE, chamber_azimuth__angle=np.radians(6))
    change = compare_campaigns(turned, measured(3, 1, FEW, **BEFORE), catalogue)
    assert change.ranking[0][0] == ("chamber_azimuth",)
    assert change.sizes["chamber_azimuth.angle (change)"] == pytest.approx(np.radians(6), abs=np.radians(1))


def test_campaigns_of_different_robots_are_not_compared() -> None:
    reference = measured(3, 1, FEW)
    other = Measured(ROBOT.model_copy(update={"density": 1200.0}), reference.table)
    with pytest.raises(TooLittle, match="same robot.yaml"):
        compare_campaigns(other, reference)
