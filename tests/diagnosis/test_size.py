"""Intervals of sizes that physics bounds, and what robot.yaml says of how well its numbers are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import truncnorm

from diagnosis.answer.size import cut_quantile
from diagnosis.diagnose import diagnose
from diagnosis.inference.prepare import prepare
from model.effects import CATALOGUE
from model.robot import Uncertainty
from tests.diagnosis.small_campaigns import FEW, measured, quick
from tests.diagnosis.test_case import ROBOT, states


@pytest.mark.parametrize(("mean", "low", "high"), [(0.3, -1.0, 2.0), (0.0, 5.0, np.inf), (0.0, -np.inf, -21.0), (4.0, 0.0, 0.5)])
def test_quantiles_of_a_cut_normal_keep_their_digits_however_far_out_the_bounds_are(mean: float, low: float, high: float) -> None:
    cut = truncnorm((low - mean) / 0.7, (high - mean) / 0.7, mean, 0.7)
    for share in (0.05, 0.5, 0.95):
        assert cut_quantile(mean, 0.7, low, high, share) == pytest.approx(cut.ppf(share), rel=1e-9, abs=1e-12)


def test_no_payload_takes_more_off_the_tip_than_hangs_there() -> None:
    case = measured(3, 1, FEW, tip_payload__mass=-0.2)
    p = prepare(ROBOT, states(case)[0]).problem.parameters
    assert p.lower[p.names.index("tip_payload.mass")] == -case.robot.tip_mass
    found = diagnose(case, quick({e: CATALOGUE[e] for e in ("tip_payload", "pressure_offset", "base_tilt")}))
    assert found.attribute.effects != ("tip_payload",) or found.attribute.conclusion != "cause"
    said = [r.parameters.get("tip_payload.mass") for r in found.attribute.ranking]
    assert all(v.value >= -case.robot.tip_mass for v in said if v is not None)


TWO = {effect: CATALOGUE[effect] for effect in ("body_modulus", "chamber_azimuth")}


def test_a_modulus_that_is_not_well_known_is_no_cause() -> None:
    case = measured(2, 6, FEW, youngs_modulus__excess=0.15)
    options = replace(quick(), catalogue=TWO)
    assert diagnose(case, options).attribute.effects == ("body_modulus",)
    known = ROBOT.model_copy(update={"uncertainty": Uncertainty(youngs_modulus=0.3)})
    assert diagnose(replace(case, robot=known), options).attribute.verdict == "none"


def test_a_tolerance_has_the_width_that_is_stated() -> None:
    case = measured(1, 6, (0.0,))
    known = ROBOT.model_copy(update={"uncertainty": Uncertainty(tilt=np.radians(2), density=0.05, area_factor=0.03)})
    for robot, tilt, density, area in ((ROBOT, np.radians(0.1), 0.01, 0.5), (known, np.radians(2), 0.05, 0.03)):
        infos = {p.name: p for p in prepare(robot, states(case)[0]).forward.parameters}
        assert infos["tilt.x"].sd == pytest.approx(tilt) and infos["density.excess"].sd == pytest.approx(density)
        assert infos["area.excess"].sd == pytest.approx(area)
        assert infos["density.excess"].low >= -0.8 and infos["frame_shift.x"].sd == pytest.approx(1.6e-3)
