"""Another simulator in the rod's place: what it predicts, and whether the cause is found on top of it all the same."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from diagnosis.inference.on_baseline import SHARE, Baseline
from diagnosis.inference.prepare import Prepared, prepare
from model.arrays import Array
from model.effects import CATALOGUE
from recordings.trials import ORIENTATION, Table, pressure_columns
from tests.diagnosis.small_campaigns import FEW, Measured, measured, quick
from tests.diagnosis.test_case import ROBOT, states

TURN = {"chamber_azimuth": CATALOGUE["chamber_azimuth"]}
SOME = {effect: CATALOGUE[effect] for effect in ("chamber_azimuth", "pressure_offset", "body_modulus", "precurvature")}


def rod_tips(case: Measured, **excess: float) -> Array:
    """(n, 3) m, by the rod of robot.yaml with what is added to parameters of its model."""
    p = prepare(ROBOT, states(case)[0], catalogue=TURN)
    theta = np.zeros_like(p.problem.parameters.sd)
    for name, value in excess.items():
        theta[p.problem.parameters.names.index(name.replace("__", "."))] = value
    return p.tip(p.problem.forward.predict(theta))


def baseline(case: Measured, tip: Array, **varied: tuple[float, Array]) -> Baseline:
    setting = ("spine_length", *pressure_columns(len(ROBOT.actuators.azimuths_deg)))
    unseen = dict.fromkeys(ORIENTATION, np.full(len(tip), np.nan))
    made = Baseline("theirs", Table({name: case.table[name] for name in setting} | unseen | dict(zip("xyz", tip.T, strict=True))))
    return replace(made, varied={name.replace("__", "."): (step, baseline(case, at)) for name, (step, at) in varied.items()})


def bent_otherwise(case: Measured, by: float) -> Array:
    """Tips of the rod, bent more the more pressure there is in a way that no area factor makes: `by` m at 200 kPa."""
    tips = rod_tips(case)
    highest = np.array([max(r.pressures) for r in case.table])
    out = tips.copy()
    out[:, 2] += by * (highest / 200e3) ** 3
    return out


def prepared(case: Measured, made: Baseline) -> Prepared:
    return prepare(ROBOT, states(case)[0], catalogue=TURN, baseline=made)


def test_at_zero_it_predicts_what_the_simulator_does_and_at_a_whole_share_what_the_rod_does() -> None:
    case = measured(1, 3, FEW)
    tips = bent_otherwise(case, 3e-3)
    p = prepared(case, baseline(case, tips))
    zero = np.zeros_like(p.problem.parameters.sd)
    assert p.tip(p.problem.forward.predict(zero)) == pytest.approx(tips, abs=1e-9)
    assert p.tip(p.given) == pytest.approx(tips, abs=1e-9)
    rod = zero.copy()
    rod[p.problem.parameters.names.index(SHARE)] = 1.0
    factor = p.baseline.area_factor / float(np.mean(ROBOT.area_factor_at(p.states.spine_length))) - 1
    assert p.tip(p.problem.forward.predict(rod)) == pytest.approx(rod_tips(case, area__excess=factor), abs=1e-6)


def test_derivatives_are_those_of_differences_and_its_own_where_it_has_them() -> None:
    case = measured(1, 3, FEW)
    tips = bent_otherwise(case, 3e-3)
    softer = tips + 2e-3 * np.array([1.0, 0.0, 0.5])
    p = prepared(case, baseline(case, tips, youngs_modulus__excess=(0.01, softer)))
    theta = np.zeros_like(p.problem.parameters.sd)
    theta[p.problem.parameters.names.index(SHARE)] = 0.3
    theta[p.problem.parameters.names.index("youngs_modulus.excess")] = 0.01
    slope = p.problem.forward.linearise(theta)[1]
    for name, step in ((SHARE, 1e-3), ("chamber_azimuth.angle", 1e-5), ("youngs_modulus.excess", 1e-5)):
        k = p.problem.parameters.names.index(name)
        there = theta.copy()
        there[k] += step
        change = p.problem.forward.predict(there) - p.problem.forward.predict(theta)
        assert change / step == pytest.approx(slope[:, k], rel=2e-2, abs=2e-4)
    own = p.problem.forward.linearise(np.zeros_like(p.problem.parameters.sd))[1]
    by_modulus = own[:, p.problem.parameters.names.index("youngs_modulus.excess")]
    assert p.tip(by_modulus) == pytest.approx((softer - tips) / 0.01, abs=1e-3)


def test_states_it_does_not_predict_are_left_out_and_it_may_have_been_asked_beside_the_measured_states() -> None:
    case = measured(1, 3, FEW)
    tips = rod_tips(case)
    made = baseline(case, tips)
    lost = tips.copy()
    lost[4] = np.nan
    assert len(prepared(case, baseline(case, lost)).problem.observed) == len(prepared(case, made).problem.observed) - 3
    rows = tuple(replace(r, pressures=tuple(p + 2e3 * (p > 0) for p in r.pressures)) for r in case.table)
    beside = replace(case, table=Table.of(rows))
    p = prepared(case, baseline(beside, rod_tips(beside)))
    assert p.tip(p.given) == pytest.approx(tips, abs=2e-6)


def test_a_cause_is_named_on_a_simulator_with_an_error_of_its_own() -> None:
    case = measured(3, 1, chamber_azimuth__angle=np.radians(8))
    answer = diagnose(case, replace(quick(SOME), baseline=baseline(case, bent_otherwise(case, 4e-3))))
    assert answer.attribute.verdict == "effect" and answer.attribute.effects == ("chamber_azimuth",)
    told = answer.simulator
    assert told is not None and told.name == "theirs" and told.share == pytest.approx(1.0, abs=0.1)
    assert told.not_measured_mm == pytest.approx(told.share * told.beyond_calibration_mm) and told.differs_mm > 1
    assert "theirs differs from the rod of robot.yaml by" in answer.statement


def test_a_simulator_that_is_right_where_the_rod_is_not_is_left_as_it_is() -> None:
    case = measured(3, 2)
    more = bent_otherwise(case, 4e-3) - rod_tips(case)
    rows = tuple(replace(r, tip=tuple((np.array(r.tip) + d).tolist())) for r, d in zip(case.table, more, strict=True))
    bent = replace(case, table=Table.of(rows))
    answer = diagnose(bent, replace(quick(SOME), baseline=baseline(bent, bent_otherwise(case, 4e-3))))
    assert answer.attribute.verdict == "none"
    assert answer.simulator is not None and answer.simulator.share == pytest.approx(0.0, abs=0.1)
