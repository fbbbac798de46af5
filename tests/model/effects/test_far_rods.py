"""How equilibria are found that are far from a known one, or close to buckling."""

import numpy as np
import pytest

from model.effects.layout import INNER, OUTER, Layout
from model.effects.solver import _steps, integration_steps, rods_from, solve
from model.robot import Robot
from model.rods import Fast, Rods, Status, rods
from model.rods import columns as col
from tests.model.effects.campaigns import Moved

LENGTH, BEND = 0.4, 0.5
CRITICAL = np.pi**2 * BEND / (4 * LENGTH**2)
"""N, Euler's load of a clamped column."""
NOWHERE, UNIFORM = np.zeros((1, 0, 3)), Layout((0, 0), (INNER, OUTER), {})


def rows(*pushes: float) -> np.ndarray:
    """Columns under shares of Euler's load and a little force sideways."""
    made = rods(
        UNIFORM.form, len(pushes), length=[0.0, LENGTH], bend_stiffness=BEND, stretch_stiffness=2e3,
        dead_force=[[0.02, 0.0, -share * CRITICAL] for share in pushes],
    )  # fmt: skip
    values = made.values.copy()
    for element in UNIFORM.elements:
        values[:, element + col.REST_STRAIN + 2] -= 1.0
    return values


@pytest.mark.parametrize(("loads", "more"), [([0.0, 0.0], [0.8, 0.9]), ([0.7, 0.8], [0.71, 0.81])], ids=["unloaded", "followed"])
def test_a_column_near_buckling_is_reached(loads: list[float], more: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    known_rows, pressed = rows(*loads), rows(*more)
    steps = integration_steps(UNIFORM, known_rows)
    known, exact = solve(UNIFORM, known_rows, NOWHERE, steps), solve(UNIFORM, pressed, NOWHERE, steps)
    assert (exact.solution.margin < 0.5).all() and (exact.solution.status == Status.SOLVED_IN_STEPS).all()
    monkeypatch.setattr(Fast, "_follow", None)
    found = solve(UNIFORM, pressed, NOWHERE, steps, known)
    np.testing.assert_allclose(found.result[:, :3], exact.result[:, :3], atol=1e-6)
    assert found.converged.all()


def test_a_rod_without_an_equilibrium_gets_the_most_steps_without_a_warning() -> None:
    nominal = rods_from(UNIFORM, rows(0.0, 0.0), plain=True)
    with np.errstate(all="raise"):
        free, lost = _steps(nominal, np.array([np.nan, np.inf]))
    assert (lost >= free).all() and lost.sum() > free.sum()


def test_a_rod_bent_by_a_full_turn_gets_steps_short_enough_to_be_found_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    bent = np.repeat(rows(0.0), 3, axis=0)
    for row, angle in zip(bent, (1.0, 4.0, 7.0), strict=True):
        row[UNIFORM.elements[-1] + col.REST_CURVATURE] = angle / LENGTH
    steps = integration_steps(UNIFORM, bent)
    assert (np.diff(steps[:, -1]) > 0).all()
    monkeypatch.setattr(Fast, "_follow", None)
    found = solve(UNIFORM, bent, NOWHERE, steps)
    exact = solve(UNIFORM, bent, NOWHERE, 4 * steps)
    np.testing.assert_allclose(found.result[:, :3], exact.result[:, :3], atol=2e-5)
    by_itself = solve(UNIFORM, bent, NOWHERE, None)
    assert (by_itself.steps == steps).all()
    np.testing.assert_allclose(by_itself.result[:, :3], found.result[:, :3], atol=1e-7)


def test_a_trial_gives_up_what_would_have_to_be_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    free, pressed = rows(0.0, 0.0), rows(0.5, 1.05)
    steps = integration_steps(UNIFORM, free)
    known = solve(UNIFORM, free, NOWHERE, steps)
    monkeypatch.setattr(Fast, "_follow", None)
    found = solve(UNIFORM, pressed, NOWHERE, steps, known, trial=True)
    assert found.converged.tolist() == [True, False]
    assert np.isnan(found.result[1, :3]).all()


def test_who_asks_for_the_whole_waits_for_no_other_state_once_one_has_no_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    free, pressed = rows(0.0, 0.0, 0.0), rows(1.05, 1.06, 1.07)
    steps = integration_steps(UNIFORM, free)
    known, tried = solve(UNIFORM, free, NOWHERE, steps), []

    def lost(self: Fast, rods: Rods, left: np.ndarray, memory: np.ndarray, values: np.ndarray, status: np.ndarray) -> None:
        tried.append(len(left))
        status[left], values[left] = Status.FAILED, np.nan

    monkeypatch.setattr(Fast, "_follow", lost)
    monkeypatch.setattr("model.effects.solver.PARTS", ())
    assert not solve(UNIFORM, pressed, NOWHERE, steps, known, whole=True).converged.any()
    assert tried == [1]


def test_a_state_is_told_where_and_only_where_its_rods_were_found(paper_robot: Robot) -> None:
    pressure = np.array([0.0, 150e3, 300e3, 450e3, 900e3])
    n = len(pressure)
    columns = {"trial": np.ones(n, int), **{c: np.zeros(n) for c in ("spine_length", "x", "y", "z")}}
    columns |= dict.fromkeys(("p1", "p2", "p9"), pressure)
    made = Moved(paper_robot, columns)
    forward = made.forward
    for growth, fast in ((0.0, 0.05), (0.6, 0.0), (1.0, 0.05)):
        theta = made.vector(chamber_ballooning__growth=growth, viscoelastic__fast=fast)
        for trial in (True, False):
            predicted = forward.predict(theta, trial).reshape(n, 3)
            here = forward._solved(theta, trial=trial)
            found = here.bare.converged[:n] & here.final.converged
            np.testing.assert_array_equal(np.isfinite(predicted).all(axis=1), found)
            assert not trial or here.bare.solution.status.max() in (Status.SOLVED, Status.FAILED)
        assert found[:3].all()


def test_a_derivative_as_steep_as_at_a_snap_is_given_as_none(paper_robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    columns = {
        "trial": np.ones(2, int),
        **{c: np.zeros(2) for c in ("spine_length", "x", "y", "z")},
        "p1": np.array([0.0, 100e3]),
    }
    forward = Moved(paper_robot, columns).forward
    usual = forward.linearise(np.zeros(len(forward.parameters)))[1]
    size = np.abs(usual) * np.array([p.sd for p in forward.parameters]) / paper_robot.length
    monkeypatch.setattr("model.effects.forward.STEEP", np.median(size[size > 0]))
    kept = forward.linearise(np.zeros(len(forward.parameters)))[1]
    np.testing.assert_array_equal(kept, np.where(size > np.median(size[size > 0]), 0.0, usual))
    assert 0 < np.count_nonzero(kept) < np.count_nonzero(usual)
