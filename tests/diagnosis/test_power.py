"""What a plan can tell before it is measured."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.answer.experiments import columns
from diagnosis.data.case import Case
from diagnosis.inference.evidence import KNOWN, NONE, weigh
from diagnosis.judgement import PRIOR_OF_NUMBER, SAME_ODDS, TEMPERATURE
from diagnosis.power import Planned, additions, drawn, foreseen, power, probabilities
from model.effects.catalogue import CATALOGUE
from tests.diagnosis.test_case import ROBOT

EFFECTS = {e: CATALOGUE[e] for e in ("base_tilt", "chamber_azimuth", "spine_slip", "body_modulus", "self_weight")}
PLAN = {
    "protocol": "bending", "spine_lengths": [0.0, 0.2], "pressures": [100e3, 200e3], "chambers": [9, 1, 2], "unload": True,
    "repeats": 2, "rate": 25e3, "tip_mass": 0.053, "vacuums": [80e3],
}  # fmt: skip


@pytest.fixture(scope="module")
def plan() -> Case:
    return foreseen(ROBOT, columns(PLAN, 9, ("x", "y", "z", "qw", "qx", "qy", "qz")))


@pytest.fixture(scope="module")
def design(plan: Case) -> Planned:
    return Planned(plan, EFFECTS)


def test_a_case_is_foreseen_state_by_state(plan: Case) -> None:
    table = columns(PLAN, 9, ())
    assert [r.trial for r in plan.table] == table["trial"].tolist()
    assert [r.branch for r in plan.table] == table["branch"].tolist()
    assert all(r.tip is not None and r.orientation is not None for r in plan.table)
    at = {(r.spine_length, max(r.pressures), r.branch): r.tip for r in plan.table}
    assert at[0.0, 200e3, "load"] is not None and abs(at[0.0, 200e3, "load"][0]) > abs(at[0.0, 100e3, "load"][0] or 0)  # type: ignore[index]


def test_many_worlds_at_once_are_weighed_as_one_is(design: Planned) -> None:
    rng = np.random.default_rng(5)
    readings = [drawn(design, rng, cause, (0.05,))[0] for cause in ("", "base_tilt", "spine_slip", "body_modulus")]
    named, found = probabilities(design, np.array(readings))
    for i, own in enumerate(readings):
        log = []
        for h in named:
            linear = replace(design.linear, observed=own, form_error=design.form_errors(h))
            log.append(weigh(linear, KNOWN, design.problem.parameters, [h])[0].log_evidence)
        shares = [PRIOR_OF_NUMBER[len(h)] / (len(design.effects) if h != NONE else 1) for h in named]
        score = np.array(log) / TEMPERATURE + np.log(shares)
        p = np.exp(score - score.max())
        p /= p.sum() * (1 + SAME_ODDS)
        # one cuts all parameters at their bounds, the other those of what is named
        assert named[int(found[i].argmax())] == named[int(p.argmax())]
        assert found[i] == pytest.approx(p, abs=0.08)


def test_a_large_effect_is_told_and_one_that_carries_little_is_not(design: Planned) -> None:
    found = power(design, tuple(EFFECTS), each=20, clutter=(0.0,))
    of = {e.effect: e for e in found.effects}
    assert set(of) | set(found.unseen) == set(EFFECTS)
    assert of["chamber_azimuth"].carries > 0.9 and (of["chamber_azimuth"].right["large"] or 0) >= 0.8
    assert of["self_weight"].carries < 0.6, of["self_weight"]
    sums = {e.effect: np.mean([v for v in e.right.values() if v is not None]) for e in found.effects}
    assert sums["self_weight"] < sums["chamber_azimuth"]
    assert found.right95[0] <= found.right <= found.right95[1] and abs(found.right - found.stated) < 0.25
    assert all(share >= 0.1 and effect in EFFECTS for effect, _, share in found.pairs)
    assert power(design, tuple(EFFECTS), each=20, clutter=(0.0,)).to_dict() == found.to_dict()


def test_additions_are_of_the_menu_and_sorted_by_what_they_bring_in_time(plan: Case) -> None:
    shares: list[float] = []
    found = additions(plan, {e: EFFECTS[e] for e in ("base_tilt", "spine_slip")}, each=2, progress=shares.append)
    assert {"elongation", "tip_mass", "roll", "hold"} <= {a.experiment.id for a in found}
    assert [a.per_hour for a in found] == sorted((a.per_hour for a in found), reverse=True)
    assert shares[-1] == 1.0 and shares == sorted(shares)
