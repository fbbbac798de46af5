"""Intervals of sizes that physics bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from diagnosis.answer.size import cut_quantile
from diagnosis.diagnose import diagnose
from model.effects import CATALOGUE
from tests.diagnosis.small_campaigns import measured, quick


@pytest.mark.parametrize(("mean", "low", "high"), [(0.3, -1.0, 2.0), (0.0, 5.0, np.inf), (0.0, -np.inf, -21.0), (4.0, 0.0, 0.5)])
def test_quantiles_of_a_cut_normal_keep_their_digits_however_far_out_the_bounds_are(mean: float, low: float, high: float) -> None:
    cut = truncnorm((low - mean) / 0.7, (high - mean) / 0.7, mean, 0.7)
    for share in (0.05, 0.5, 0.95):
        assert cut_quantile(mean, 0.7, low, high, share) == pytest.approx(cut.ppf(share), rel=1e-9, abs=1e-12)


def test_no_payload_takes_more_off_the_tip_than_hangs_there() -> None:
    case = measured(3, 1, tip_payload__mass=-0.2)
    found = diagnose(case, quick({e: CATALOGUE[e] for e in ("tip_payload", "pressure_offset", "base_tilt")}))
    (mass,) = [x for x in found.detail["sizes"] if x["name"] == "tip_payload.mass"]
    assert mass["low"] == -case.robot.tip_mass <= mass["low90"] and mass["impossible"]
    (said,) = [r.parameters["tip_payload.mass"] for r in found.attribute.ranking if r.effects == ("tip_payload",)]
    assert -case.robot.tip_mass <= said.value < 0
