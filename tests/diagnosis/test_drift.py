"""A drift of the readings over the trials is found with its size; scatter from trial to trial is none."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.data.case import states
from diagnosis.data.drift import drift
from tests.diagnosis.test_diagnose import FINGER, Measured, read


@pytest.mark.parametrize(
    ("along", "deg", "roll", "mm"),
    [
        (4e-3, 0.0, 0.0, 4.0),
        (0.0, 1.0, 0.0, 1e3 * np.radians(1.0) * FINGER.length),
        (0.0, 0.0, 0.0, None),
        (4e-3, 0.0, 40.0, None),  # turned in its mount half way: another setting
    ],
)
def test_a_drift_is_found_whatever_it_is_and_scatter_is_none(along: float, deg: float, roll: float, mm: float | None) -> None:
    table = read(FINGER, repeats=6)
    trials, order = np.unique(table["trial"], return_inverse=True)
    u = order / (len(trials) - 1)
    u = u if not roll else np.round(u)
    own = 0.2e-3 * np.random.default_rng(1).normal(size=(len(trials), 3))[order]
    tip = Rotation.from_rotvec(np.radians(deg) * u[:, None] * [1.0, 0.0, 0.0]).apply(table.tip) + own
    tip[:, 0] += along * u
    campaign, _ = states(Measured(FINGER, table.replaced({**dict(zip("xyz", tip.T, strict=True)), "roll_deg": roll * u})))
    found = list(drift(campaign))
    assert [f.code for f in found] == ([] if mm is None else ["drift"])
    if mm is not None:
        assert found[0].values["mm"] == pytest.approx(mm, rel=0.15)
