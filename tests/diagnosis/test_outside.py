"""A cause outside the catalogue becomes probable by what relatives and free forms explain, and by nothing else."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from diagnosis.criticism.outside import Related, alike, odds_outside, related
from diagnosis.criticism.relatives import RELATIVES
from diagnosis.data.case import states
from diagnosis.inference.evidence import Hypothesis
from diagnosis.inference.prepare import prepare, table_columns
from diagnosis.inference.search import Search
from diagnosis.judgement import FREE_FORM_ODDS, RELATIVE_ODDS, SAME_ODDS, SEPARATED_EVIDENCE, TEMPERATURE
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns
from model.effects.forward import ForwardModel
from tests.diagnosis.small_campaigns import FEW, measured
from tests.diagnosis.test_case import ROBOT, case


@dataclass(frozen=True)
class Tried:
    """A hypothesis and its log evidence."""

    named: Hypothesis
    log_evidence: float


KNOWN = (Tried((), 90.0), Tried(("marker_offset",), 100.0))
SCALE = Related("camera_scale", (), 100.0)
LEAST = SAME_ODDS + FREE_FORM_ODDS


def odds(among: tuple[Related, ...] = (), free_form: float = 0.0, scatter: float = 1.0) -> float:
    return odds_outside(KNOWN, among, free_form, scatter, len(CATALOGUE))  # type: ignore[arg-type]


def test_a_relative_as_good_as_what_is_named_is_rarer_by_its_prior_odds() -> None:
    assert odds() == pytest.approx(LEAST)
    assert 0.3 * RELATIVE_ODDS < odds((SCALE,)) - LEAST < RELATIVE_ODDS
    better = Related("camera_scale", (), 100.0 + TEMPERATURE)
    assert odds((better,)) - LEAST == pytest.approx(np.e * (odds((SCALE,)) - LEAST))
    assert odds((Related("camera_scale", ("marker_offset",), 100.0),)) - LEAST < 0.05 * RELATIVE_ODDS


def test_free_forms_and_excess_scatter_of_repeats_raise_the_odds() -> None:
    assert odds(free_form=-20.0) == pytest.approx(SAME_ODDS, rel=0.05)
    assert odds(free_form=4 * TEMPERATURE) > 20 * LEAST
    assert odds(scatter=1.9) == odds() and odds(scatter=6.0) == pytest.approx(3 * odds())


def test_what_does_the_same_takes_the_place_of_an_effect_that_is_named() -> None:
    far = Related("lens", (), 100.0 - 2 * SEPARATED_EVIDENCE)
    more = Related("body_length", ("marker_offset",), 99.0)
    assert alike((SCALE, more, far), ("marker_offset",), 100.0) == ("camera_scale",)
    assert alike((SCALE, more), ("marker_offset", "base_tilt"), 101.0) == ("camera_scale", "body_length")
    assert alike((SCALE, far), (), 90.0) == ("camera_scale",) and alike((SCALE, far), (), 99.0) == ()


@pytest.mark.parametrize("id", RELATIVES)
def test_a_relative_of_size_zero_does_nothing_and_moves_some_reading(id: str) -> None:
    design = design_from_columns(ROBOT, table_columns(states(measured(2, 4, FEW))[0]))
    plain, with_it = (ForwardModel(ROBOT, design, "one", effects, every_law=True) for effects in ({}, {id: RELATIVES[id]}))
    theta = np.zeros(len(with_it.parameters))
    y, slope = with_it.linearise(theta, with_it.index(id))
    assert y == pytest.approx(plain.predict(np.zeros(len(plain.parameters))), abs=1e-9)
    assert np.abs(slope).max() > 0


def test_cameras_that_read_too_long_are_a_relative_of_the_nearest_effect() -> None:
    rows = measured(2, 4, FEW).table
    scaled = [replace(r, tip=tuple(1.01 * x for x in r.tip)) for r in rows if r.tip is not None]
    nearest = {e: CATALOGUE[e] for e in ("marker_offset", "body_modulus")}
    prepared = prepare(ROBOT, states(case(scaled))[0], catalogue=nearest)
    search = Search(prepared.problem)
    search.run()
    known = search.found
    asked = [search.with_all_derivatives(known[h]) for h in ((), ("marker_offset",))]
    first = related(prepared, asked, known)[0]
    assert first.relative in ("camera_scale", "body_length")
    assert first.log_evidence > max(c.log_evidence for c in known.values()) - SEPARATED_EVIDENCE
    assert odds_outside(search.tried, related(prepared, asked, known), 0.0, 1.0, 2) > 2 * LEAST
