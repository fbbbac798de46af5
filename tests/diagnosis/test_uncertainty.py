"""What robot.yaml says of how well its numbers are known: a modulus that may be 30 % off is no cause when it is 15 % off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from diagnosis.inference.prepare import prepare
from model.effects import CATALOGUE
from model.robot import Uncertainty
from tests.diagnosis.small_campaigns import FEW, measured, quick
from tests.diagnosis.test_case import ROBOT, states

TWO = {effect: CATALOGUE[effect] for effect in ("body_modulus", "chamber_azimuth")}


def test_a_modulus_that_is_not_well_known_is_no_cause() -> None:
    case = measured(2, 6, FEW, youngs_modulus__excess=0.15)
    options = replace(quick(), catalogue=TWO)
    assert diagnose(case, options).attribute.effects == ("body_modulus",)
    known = ROBOT.model_copy(update={"uncertainty": Uncertainty(youngs_modulus=0.3)})
    assert diagnose(replace(case, robot=known), options).attribute.verdict == "none"


def test_a_tolerance_has_the_width_that_is_stated() -> None:
    case = measured(1, 6, (0.0,))
    known = ROBOT.model_copy(update={"uncertainty": Uncertainty(tilt=np.radians(2), density=0.05)})
    for robot, tilt, density in ((ROBOT, np.radians(0.1), 0.01), (known, np.radians(2), 0.05)):
        infos = {p.name: p for p in prepare(robot, states(case)[0]).forward.parameters}
        assert infos["tilt.x"].sd == pytest.approx(tilt) and infos["density.excess"].sd == pytest.approx(density)
        assert infos["density.excess"].low >= -0.8 and infos["frame_shift.x"].sd == pytest.approx(0.5e-3)
