"""A diagnosis of a similar robot is the same: names and probabilities, and sizes of the robot's own scale."""

from dataclasses import replace

import pytest

from diagnosis.answer.result import Attribute, Diagnosis
from diagnosis.diagnose import diagnose
from model.effects.catalogue import CATALOGUE
from recordings.trials import Table
from tests.diagnosis.small_campaigns import FEW, RIVALS, SOME, measured, quick
from tests.diagnosis.test_case import Measured
from tests.model.effects.test_similarity import similar


def scaled(campaign: Measured, length: float, modulus: float) -> Measured:
    """The same campaign of a similar robot, seen by cameras as good for its size."""
    rows = (
        replace(
            r,
            pressures=tuple(modulus * p for p in r.pressures),
            rate=modulus * (r.rate or 0.0),
            spine_length=length * r.spine_length,
            tip=None if r.tip is None else (length * r.tip[0], length * r.tip[1], length * r.tip[2]),
        )
        for r in campaign.table
    )
    return Measured(similar(campaign.robot, length, modulus), Table.of(rows))


def test_a_campaign_that_is_done_faster_or_slower_has_the_same_cause_with_the_same_probability() -> None:
    campaign, some = measured(2, 1, FEW, viscoelastic__slow=0.2), {e: CATALOGUE[e] for e in ("viscoelastic", RIVALS[0])}

    def cause(slower: float) -> Attribute:
        rows = [replace(r, t=slower * r.t, hold=slower * r.hold, rate=(r.rate or 0.0) / slower) for r in campaign.table]
        return diagnose(Measured(campaign.robot, Table.of(rows)), quick(some)).attribute

    faster, slower = cause(0.1), cause(10.0)
    assert faster.effects == slower.effects == ("viscoelastic",)
    assert faster.probability == pytest.approx(slower.probability, abs=0.02)


def test_a_similar_robot_has_the_same_cause_with_the_same_probability() -> None:
    campaign = measured(2, 1, FEW, chamber_ballooning__growth=0.12)
    rivals = {effect: SOME[effect] for effect in ("chamber_ballooning", "pressure_offset", "base_tilt")}
    given, small = (diagnose(c, quick(rivals)) for c in (campaign, scaled(campaign, 0.3, 0.2)))

    def growth(d: Diagnosis) -> float:
        return d.attribute.ranking[0].parameters["chamber_ballooning.growth"].value

    assert given.attribute.effects == small.attribute.effects == ("chamber_ballooning",)
    assert small.attribute.conclusion == given.attribute.conclusion
    assert small.attribute.probability == pytest.approx(given.attribute.probability, abs=0.05)
    assert growth(small) == pytest.approx(growth(given), rel=0.05)
