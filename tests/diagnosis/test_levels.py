"""Which pressures were meant to be the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.data.case import states
from diagnosis.data.levels import levels, pressure_gap
from tests.diagnosis.test_case import case, row


def test_a_wide_range_keeps_the_usual_gap() -> None:
    assert pressure_gap([row(1, 1, 0.0, 250e3)]) == 3e3


@pytest.mark.parametrize(("scatter", "gap"), [(50.0, 0.8e3), (500.0, 1.5e3), (5e3, 3e3)])
def test_a_narrow_range_is_told_apart_finely_but_not_finer_than_its_scatter(scatter: float, gap: float) -> None:
    rows = [replace(row(1, i, 0.0, 2.5e3 * i), sd={"p1": scatter, "p9": scatter}) for i in range(1, 17)]
    assert pressure_gap(rows) == pytest.approx(gap)


def test_steps_of_2500_pa_are_states_of_their_own_where_40_kpa_is_the_most() -> None:
    s = states(case([row(t, 1, 0.0, 2.5e3 * t) for t in range(2, 17)]))[0]
    assert len(np.unique(s.condition)) == 15
    assert len(np.unique(levels(s.highest, s.pressure_gap))) == 15


def test_chambers_set_one_by_one_are_no_repeats_because_one_of_them_is_as_high() -> None:
    settings = [(92e3, 20e3, 5e3), (92.3e3, 45e3, 5e3), (91.8e3, 20.4e3, 5.2e3), (40e3, 21e3, 40e3)]
    rows = [replace(row(t, 1, 0.0, 0.0), pressures=(*p, *(0.0,) * 6)) for t, p in enumerate(settings, 1)]
    a, b, again, other = states(case(rows))[0].condition.tolist()
    assert a == again and len({a, b, other}) == 3
