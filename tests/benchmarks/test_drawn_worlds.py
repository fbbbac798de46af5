"""Worlds drawn under a design: what is drawn is found."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.drawn_worlds import TEMPERATURES, judged
from diagnosis.data.case import states
from diagnosis.inference.prepare import prepare
from diagnosis.power.worlds import Planned, drawn
from model.effects.catalogue import CATALOGUE
from tests.diagnosis.small_campaigns import FEW, ROBOT, measured

EFFECTS = ("base_tilt", "chamber_azimuth", "spine_slip")


@pytest.fixture(scope="module")
def design() -> Planned:
    own = states(measured(2, 4, FEW))[0]
    return Planned.of(prepare(ROBOT, own, catalogue={e: CATALOGUE[e] for e in EFFECTS}))


def test_readings_hold_what_the_effects_of_a_world_do(design: Planned) -> None:
    far = 0
    for seed in range(6):
        world, done = drawn(design, np.random.default_rng(seed))
        assert set(done) == set(design.effects) <= set(EFFECTS)
        carried = {effect: design.floors(white) for effect, white in done.items()}
        if max(carried.values()) > 5.0:
            assert design.floors(world.readings) > 0.5 * max(carried.values())
            far += 1
    assert far >= 2


def test_a_design_that_tells_its_effects_apart_says_so(design: Planned) -> None:
    found = judged(design, 6, 3, "few")
    assert len(found) == 6 * len(TEMPERATURES) and all(0.0 <= w.stated <= 1.0 + 1e-9 for w in found)
    at_one = [w for w in found if w.temperature == 1.0]
    assert sum(w.right for w in at_one) >= 5
    hottest = [w.stated for w in found if w.temperature == max(TEMPERATURES)]
    assert np.mean(hottest) < np.mean([w.stated for w in at_one])
