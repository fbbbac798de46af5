"""Declarations: what is refused, and effects that come from elsewhere."""

import numpy as np
import pytest

from model.effects import CATALOGUE, EffectSpec, Law, Parameter
from model.effects.catalogue import announced
from model.effects.spine import shear_spine
from model.errors import BadEffect
from model.robot import Robot


def test_every_effect_says_what_it_is_and_where_it_is_seen() -> None:
    for spec in CATALOGUE.values():
        assert spec.equation and spec.citation and spec.seen_best_in
        assert all(p.low <= s <= p.high for p in spec.parameters for s in p.starts)
        positive = [p for p in spec.parameters if p.sign in ("positive", "blend")]
        assert all(p.low == 0 for p in positive)
        assert all(p.high == 1 for p in positive if p.sign == "blend")
    assert CATALOGUE["pressure_offset"].family_id == CATALOGUE["pressure_deadband"].family_id


@pytest.mark.parametrize("value", [(), None, ("colder",)])
def test_what_is_no_effect_is_refused(value: object) -> None:
    with pytest.raises(BadEffect, match="must be a tuple of EffectSpec"):
        announced(value)


def test_declarations_that_could_never_be_absent_are_refused() -> None:
    with pytest.raises(BadEffect, match="must include zero"):
        Parameter("size", "1", 0.1, 0.5, 1.0)
    with pytest.raises(BadEffect, match="no parameter is a size"):
        EffectSpec("own", "load", "", (Parameter("form", "1", 0.1, -1.0, 1.0, role="shape"),), Law(), "", "")
    with pytest.raises(BadEffect, match="stage"):
        EffectSpec("own", "weather", "", (Parameter("size", "1", 0.1, -1.0, 1.0),), Law(), "", "")  # type: ignore[arg-type]


def test_the_papers_table_asks_for_six_and_a_half_megapascal_and_a_soft_core(paper_robot: Robot) -> None:
    assert paper_robot.spine is not None
    found = shear_spine(paper_robot.spine)
    assert found.modulus == pytest.approx(6.6e6, rel=0.02)
    assert 3 * paper_robot.spine.radius**2 / (4 * found.shear) == pytest.approx(0.0070e-6, rel=0.02)
    engaged = found.engaged(np.array([0.05, 0.3]))
    assert 0.02 < engaged[0] < 0.06 and 0.5 < engaged[1] < 0.6
