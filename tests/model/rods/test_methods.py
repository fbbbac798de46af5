"""One call, several methods: they agree where they must, and refuse what they do not know."""

import numpy as np
import pytest

from benchmarks.rod_cases import wild_rods
from model.errors import BadCondition, SolveFailed
from model.rods import FAST, FINE, PAPER, Fast, Form, Method, Paper, Rods, Status, rods, solve
from model.rods.beam import bar_deflection, bending_compliance, shear_compliance
from tests.model.rods.cases import robots
from tests.model.rods.reference import REFERENCE
from tests.simulated.bench import raises

EDGES, BEND, SHEAR = (0.0, 0.1, 0.25, 0.4), (3.0, 2.0, 1.5), (900.0, 700.0, 500.0)
EVERY = pytest.mark.parametrize("method", [FAST, REFERENCE, PAPER], ids=lambda m: type(m).__name__)


def three_parts(**loads: object) -> Rods:
    """A rod of three parts."""
    bend = [(k, k, 2 * k) for k in BEND]
    stretch = [(k, k, 3 * k) for k in SHEAR]
    return rods(Form(3), 1, length=np.diff(EDGES), bend_stiffness=bend, stretch_stiffness=stretch, **loads)  # type: ignore[arg-type]


@EVERY
def test_under_small_loads_every_method_finds_the_same_rod_of_three_elements(method: Method) -> None:
    small = three_parts(
        dead_force=[2e-3, 1e-3, 0.0], tip_moment=[1e-4, -2e-4, 1e-4], dead_moment=[-1e-4, 3e-4, 0.0], tip_force=[1e-3, 0.0, 5e-3],
        load=1e-3 * np.diag([1.0, 2.0, 3.0]), rest_curvature=1e-3 * np.diag([1.0, 1.0, 1.0]),
    )  # fmt: skip
    arcs = [0.0, 0.05, 0.1, 0.3, 0.4]
    exact, found = solve(small, FINE, arc_lengths=arcs), solve(small, method, arc_lengths=arcs)
    assert found.converged.all()
    # Euler's own error at 100 steps is a hundredth of the deflection.
    near = 2e-6 if isinstance(method, Paper) else 2e-7
    assert np.abs(found.tip - exact.tip).max() < near
    assert np.abs(found.shape - exact.shape).max() < near
    assert np.abs(found.orientation - exact.orientation).max() < 20 * near
    assert np.abs(found.base_force - exact.base_force).max() < 1e-5
    assert np.abs(found.base_moment - exact.base_moment).max() < 1e-5


def test_a_cantilever_pushed_at_its_end_gives_by_bending_and_shear() -> None:
    pushed = solve(three_parts(dead_force=[1e-3, 0.0, 0.0]), FINE)
    assert pushed.tip[0, 0] == pytest.approx(1e-3 * (bending_compliance(EDGES, BEND) + shear_compliance(EDGES, SHEAR)), rel=1e-6)
    assert bending_compliance((0.0, 0.4), (2.0,)) == pytest.approx(bar_deflection(0.4, 0.4, 2.0), rel=1e-14)


def test_a_push_short_of_the_end_is_equation_eight() -> None:
    # Up to x a force there is the same as one at the tip with a couple that takes the longer lever back.
    x, push = 0.25, [1e-3, 0.0, 0.0]
    couple = [0.0, -1e-3 * (0.4 - x), 0.0]
    bar = rods(Form(1), 1, length=0.4, bend_stiffness=2.0, stretch_stiffness=1e9, dead_force=push, dead_moment=couple)
    inner = solve(bar, FINE, arc_lengths=[x])
    assert inner.shape[0, 0, 0] == pytest.approx(1e-3 * x**3 / 6, rel=1e-6)
    slope = 1e-3 * x**2 / 4  # beyond x the bar is straight
    assert inner.shape[0, 0, 0] + slope * (0.4 - x) == pytest.approx(1e-3 * bar_deflection(0.4, x, 2.0), rel=1e-6)


@pytest.mark.parametrize("method", [REFERENCE, PAPER], ids=lambda m: type(m).__name__)
def test_a_term_or_a_start_that_a_method_does_not_know_is_refused_by_name(method: Method) -> None:
    tilted = robots(1, 100e3, 0.1)
    tilted.field("base_turn")[:] = (0.0, 0.01, 0.0)
    raises(BadCondition, f"base_turn: .* {type(method).__name__}", solve, tilted, method)
    plain = robots(1, 100e3, 0.1)
    raises(BadCondition, "start", solve, plain, method, start=solve(plain, Fast(remember=True)))


@EVERY
def test_of_no_rods_every_method_finds_nothing(method: Method) -> None:
    found = solve(robots(2, 100e3, 0.1)[np.zeros(2, bool)], method, arc_lengths=[0.1, 0.2])
    assert found.tip.shape == (0, 3) and found.shape.shape == (0, 2, 3) and found.trusted() is found


@EVERY
def test_arc_lengths_beyond_the_rod_are_refused(method: Method) -> None:
    raises(BadCondition, "arc_lengths: 0.5 m of rod 0", solve, robots(1, 100e3, 0.1), method, arc_lengths=[0.5])


def test_what_did_not_converge_holds_nan_and_says_why() -> None:
    found = solve(wild_rods(4, 1).changed(dead_force=[0.0, 0.0, -400.0], load=0.0, tip_moment=0.0), FAST)
    assert not found.converged.any() and np.isnan(found.tip).all()
    assert set(found.status) <= {Status.OTHER_BRANCH, Status.FAILED}
    raises(SolveFailed, "of the load", found.trusted)
