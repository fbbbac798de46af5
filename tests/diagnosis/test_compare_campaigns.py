"""What changed between two campaigns is found beside what both have in common."""

import numpy as np
import pytest

from diagnosis.compare_campaigns import compare_campaigns, sentence
from diagnosis.errors import BadCase
from diagnosis.inference.evidence import NONE
from diagnosis.inference.posterior import UNKNOWN, EffectPosterior
from model.actuators import Chambers
from model.effects import CATALOGUE
from tests.diagnosis.small_campaigns import FEW, Catalogue, few_and_all, measured
from tests.diagnosis.test_case import ROBOT, Measured

BEFORE = {"chamber_ballooning__growth": 0.2}


@few_and_all
def test_the_effect_that_came_is_named_and_the_one_that_was_there_is_not(catalogue: Catalogue) -> None:
    turned = measured(3, 2, FEW, **BEFORE, chamber_azimuth__angle=np.radians(6))
    change = compare_campaigns(turned, measured(3, 1, FEW, **BEFORE), catalogue)
    assert change.effects == change.ranking[0][0] == ("chamber_azimuth",)
    assert change.sizes["chamber_azimuth.angle (change)"] == pytest.approx(np.radians(6), abs=np.radians(1))


@few_and_all
def test_silicone_as_soft_as_a_warmer_day_makes_it_is_no_change(catalogue: Catalogue) -> None:
    warmer = measured(3, 2, FEW, **BEFORE, youngs_modulus__excess=-0.03)
    change = compare_campaigns(warmer, measured(3, 1, FEW, **BEFORE), catalogue)
    assert change.effects == () and change.statement.startswith("No change since the reference")


def test_what_is_told_follows_from_the_probability_that_nothing_changed() -> None:
    def told(nothing: float) -> str:
        ranking = ((("contact",), 0.95 - nothing), (NONE, nothing), (UNKNOWN, 0.05))
        found = EffectPosterior(tuple(sorted(ranking, key=lambda r: -r[1])), {})
        sizes = {"contact.stiffness (change)": 30.0, "contact.distance (change)": -0.002}
        return sentence(found, sizes, CATALOGUE, Chambers.words)

    assert told(0.8).startswith("No change since the reference stands out from the noise (p = 0.80")
    assert told(0.2).startswith("No change since the reference is certain: that nothing changed has p = 0.20")
    assert "most probable otherwise: contact with an obstacle [contact] (p" in told(0.2)
    by = "contact with an obstacle, stiffness by 30 N/m; contact with an obstacle, distance by -2 mm; p = 0.94"
    assert told(0.01).startswith(f"Since the reference contact with an obstacle [contact] changed ({by}")


def test_campaigns_of_different_robots_are_not_compared() -> None:
    reference = measured(3, 1, FEW)
    other = Measured(ROBOT.model_copy(update={"density": 1200.0}), reference.table)
    with pytest.raises(BadCase, match="same robot.yaml"):
        compare_campaigns(other, reference)
