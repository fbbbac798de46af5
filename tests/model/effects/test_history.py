"""Laws with memory: sliding elements and relaxation against what can be written down, and the path between readings."""

from typing import Any

import numpy as np
import pytest

from model.body import body_of
from model.condition import States
from model.effects.catalogue import CATALOGUE
from model.effects.design import design_from_columns, with_rest
from model.effects.history import DRIVES, History, loading_path
from model.effects.layout import layout_of
from model.effects.quantities import Quantities, baseline
from model.robot import Robot
from tests.model.effects.campaigns import Moved, campaign


def unchanged(robot: Robot, design: States) -> Quantities:
    """The paper's model of a campaign's states."""
    body = body_of(robot)
    layout = layout_of(body, robot.spine is not None)
    return baseline(robot, body, layout, design, np.ones(len(design)), np.array([1.0, 0.0]))


def history(robot: Robot, columns: Any, inner: Any, outer: Any = 0.0) -> History:
    """A history whose drive (n,) is given for the first curvature of both parts; the first state of a trial is at rest."""
    design, rest_of = with_rest(design_from_columns(robot, columns))
    n = len(design)
    drive, one = np.zeros((1, n, DRIVES)), np.ones((1, n, 2))
    drive[0, :, 0], drive[0, :, 4] = inner, outer
    silicone, rest = np.ones((1, n, DRIVES)), np.zeros((1, n, DRIVES))
    path = loading_path(design, rest_of)
    return History(unchanged(robot, design), path, drive, one, one, silicone, rest, np.zeros((1, n, 2, 2)))


def test_between_readings_the_drive_stays_ramps_and_stays(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.1,), levels=(50e3, 100e3), unload=False, rate=25e3, hold=3.0)
    columns["t"] = columns["t"] + np.array([0.0, 4.0, 4.0])
    path = history(paper_robot, columns, 0.0).path
    assert path.before.tolist() == [0, 0, 1]
    assert path.ramp.tolist() == [0.0, 2.0, 2.0]
    assert path.hold.tolist() == [3.0, 3.0, 3.0]
    assert path.stay == pytest.approx([np.inf, 4.0, 0.0])


def test_states_without_a_reading_are_remembered_and_not_read(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.1, 0.2), levels=(50e3, 100e3), rate=25e3, hold=3.0)
    unread = np.arange(len(columns["trial"])) % 5 == 2  # the highest pressures
    every = Moved(paper_robot, columns, None).forward
    made = Moved(paper_robot, {**columns, "unread": unread}, None).forward
    remember = {id for id, spec in CATALOGUE.items() if spec.law.path is not None}
    theta = np.array([0.3 * p.sd * (p.source in remember and p.role == "size") for p in every.parameters])
    read = ~unread[every.observations.row]
    np.testing.assert_allclose(made.predict(theta), every.predict(theta)[read], atol=1e-9)
    np.testing.assert_allclose(made.linearise(theta)[1], every.linearise(theta)[1][read], atol=1e-6)
    assert (made.observe({**columns, "unread": unread}) == every.observe(columns)[read]).all()
    forgotten = Moved(paper_robot, {n: c[~unread] for n, c in columns.items()}, None).forward
    assert np.abs(forgotten.predict(theta) - made.predict(theta)).max() > 1e-4


def test_a_trial_without_a_state_of_rest_gets_one(paper_robot: Robot) -> None:
    design = design_from_columns(paper_robot, campaign(lengths=(0.0, 0.1), levels=(50e3, 100e3), zero=False))
    full, rest_of = with_rest(design)
    assert len(full) == len(design) + 2
    assert rest_of.tolist() == [len(design), len(design) + 1]
    assert not full.pressure[len(design) :].any()
    assert full.spine_length[len(design) :].tolist() == [0.0, 0.1]


def test_what_follows_late_lags_a_ramp_by_its_closed_form(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.1,), levels=(100e3,), rate=25e3, hold=3.0)
    h = history(paper_robot, columns, [0.0, 2.0, 0.0])
    lag = h.path.lag(h.drive, 5.0)[0, :, 0]
    # A ramp to 2 within 4 s, then 3 s at rest: z' = (x - z) / 5 s.
    at_top = 2.0 / 4.0 * 5.0 * (1 - np.exp(-4.0 / 5.0))
    assert lag[1] == pytest.approx(at_top * np.exp(-3.0 / 5.0))
    assert lag[2] == pytest.approx((lag[1] * np.exp(-4.0 / 5.0) - at_top) * np.exp(-3.0 / 5.0))


def test_a_sliding_element_yields_at_its_stroke_and_needs_twice_that_to_yield_back(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.1,), levels=(50e3, 100e3, 150e3))
    h = history(paper_robot, columns, [0.0, 0.5, 3.0, 4.0, 3.0, 2.0, 0.0])
    state = h.path.sliding(h.drive[..., :2], np.array([[1.0]]))[0, :, 0]
    assert state == pytest.approx([0.0, 0.5, 1.0, 1.0, 0.0, -1.0, -1.0])
    parallel = h.path.sliding(h.drive[..., :2], np.array([[1.0, 4.0]]))[0, :, 0]
    assert parallel[1] == pytest.approx(0.5 * (0.5 + 0.125))


def test_extremes_stay_fade_and_are_kept_by_place(paper_robot: Robot) -> None:
    columns = campaign(lengths=(0.0, 0.2), levels=(100e3,))
    bent, inner = [0.0, 3.0, -1.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.5, 0.0]
    for_good, fading = (history(paper_robot, columns, inner, bent).extremes(np.full((1, 1), r))[0] for r in (0.0, 1e-2))
    # The largest and the least add; the part with spine remembers what it was bent to when there was none.
    assert for_good[:, 4] == pytest.approx([0.0, 3.0, 2.0, 2.0, 2.0, 2.0])
    assert for_good[3:, 0] == pytest.approx([2.0, 2.0, 2.0])
    t = columns["t"]
    assert fading[3, 4] == pytest.approx(3.0 * np.exp(-(t[3] - t[1]) / 100) - np.exp(-(t[3] - t[2]) / 100), rel=1e-6)
