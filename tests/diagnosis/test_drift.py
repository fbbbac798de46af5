"""A drift of the readings over the trials is found with its size, places of other rows with rows and direction; scatter
from trial to trial is no drift, and what a body does by itself is no shift."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.data import drift, shift
from diagnosis.data.case import states
from diagnosis.diagnose import diagnose
from model.arrays import Array
from recordings.trials import TIP, Table
from tests.diagnosis.small_campaigns import quick
from tests.diagnosis.test_diagnose import FINGER, Measured, columns, read


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
    campaign, _ = states(Measured(FINGER, table.replaced({**columns(TIP, tip), "roll_deg": roll * u})))
    found = list(drift.drift(campaign))
    assert [f.code for f in found] == ([] if mm is None else ["drift"])
    if mm is not None:
        assert found[0].values["mm"] == pytest.approx(mm, rel=0.15)


ROWS = 120


def shifted(begin: int, end: int, by: int, table: Table) -> Table:
    """States whose tips, from `begin` to `end`, are those `by` rows below; none where there is no such row."""
    of, rows = np.arange(ROWS) + by, np.arange(ROWS)
    moved = np.where(((of >= 0) & (of < ROWS))[:, None], table.tip[of.clip(0, ROWS - 1)], np.nan)
    return table.replaced(columns(TIP, np.where(((rows >= begin) & (rows < end))[:, None], moved, table.tip)))


def lagging(pressure: Array, share: float = 0.6) -> Array:
    return np.vstack([pressure[:1], (1 - share) * pressure[1:] + share * pressure[:-1]])


def played(pressure: Array) -> Array:
    """A backlash of half a step."""
    out = pressure.copy()
    for k in range(1, len(out)):
        out[k] = np.clip(out[k - 1], pressure[k] - 22e3, pressure[k] + 22e3)
    return out


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("acting", [None, lambda p: np.clip(p - 20e3, 0.0, None)], ids=["", "dead band"])
@pytest.mark.parametrize(
    ("begin", "end", "by"), [(60, 120, 1), (65, 120, -1), (52, 120, 2), (0, 50, -1), (40, 85, 1), (0, 120, 1)]
)
def test_places_of_other_rows_are_named_with_the_rows(
    begin: int, end: int, by: int, acting: Callable[[Array], Array] | None, noise: float
) -> None:
    table = read(FINGER, acting, repeats=6)
    scatter = noise * FINGER.length / np.sqrt(3) * np.random.default_rng(1).normal(size=(ROWS, 3))
    table = shifted(begin, end, by, table.replaced(columns(TIP, table.tip + scatter)))
    table = table.replaced({"p1": np.where(np.arange(ROWS) == 30, np.nan, table["p1"])})  # one is missing
    (found,) = (f.values for f in shift.shifted(table, FINGER.length))
    assert (found["by"], found["when"]) == (f"{abs(by)} row{'s' * (abs(by) > 1)}", "early" if by > 0 else "late")
    names = [table.place(row) for row in range(ROWS)]
    assert names.index(found["first"]) == pytest.approx(begin, abs=2)
    assert names.index(found["last"]) == pytest.approx(end - 1, abs=2)
    assert found["own_mm"] > 2 * found["mm"]


@pytest.mark.parametrize("from_row", [0, 60])
@pytest.mark.parametrize("law", [lagging, lambda p: lagging(p, 0.8), played, lambda p: p, lambda p: np.clip(p - 20e3, 0.0, None)])
def test_a_lag_or_hysteresis_is_no_shift_also_where_it_begins_at_a_row(law: Callable[[Array], Array], from_row: int) -> None:
    table = read(FINGER, lambda p: np.where((np.arange(ROWS) >= from_row)[:, None], law(p), p), repeats=6)
    assert list(shift.shifted(table, FINGER.length)) == []


def test_a_diagnosis_of_places_of_other_rows_says_so_first_and_is_not_certain() -> None:
    answer = diagnose(Measured(FINGER, shifted(61, 120, 1, read(FINGER, repeats=6))), quick())
    assert answer.headline.startswith("Unclear: positions are logged 1 row early from trial 13 step 2 to trial 24 step 5")
    assert answer.findings[0].severity == "critical" and answer.attribute.conclusion != "cause"
